//! What of the road's traffic can be seen from the car.
//!
//! Something is seen if enough of its outline, drawn from above, is in the centre camera's field of view and nothing in between hides
//! most of its height. The ground is taken to be flat, so hills hide nothing here; night and rain end the view at a distance.

use glam::DVec2;

use crate::{
    camera::Camera,
    conditions::Conditions,
    obstacles::{Box2, ahead, flat},
    scene::Actor,
    vehicle::Car,
    world::Simulation,
};

/// So many of the five points of an outline, corners and middle, must be seen.
const SEEN_OF_FIVE: usize = 2;
/// Something is hidden by what covers this share of its height, from below.
const HIDDEN_SHARE: f64 = 0.8;
/// The distance of sight, in metres, on a fair day; in the heaviest rain; by the light of the headlights alone, which at 50 m
/// is a tenth of what it is near the car (`camera::weather`).
const DAY_M: f64 = 150.0;
const RAIN_M: f64 = 100.0;
const NIGHT_M: f64 = 50.0;

/// A look from the car.
#[derive(Debug)]
pub struct Sight<'a> {
    eye: DVec2,
    yaw: f64,
    half_angle: f64,
    reach_m: f64,
    actors: &'a [Actor],
}

impl<'a> Sight<'a> {
    /// The centre camera's in a world.
    pub fn of(world: &'a Simulation) -> Self {
        Self::from(world.car(), world.actors(), &world.setup().conditions)
    }

    /// The view of the centre camera of this car, among these actors.
    pub(super) fn from(car: &Car, actors: &'a [Actor], conditions: &Conditions) -> Self {
        let Camera { lens, mount, .. } = Camera::CENTER;
        let ratio = lens.width as f64 / lens.height as f64;
        Self {
            eye: flat(car.position) + ahead(car.yaw) * mount.position.z,
            yaw: car.yaw,
            half_angle: (ratio * (lens.vertical_fov_deg / 2.0).to_radians().tan()).atan(),
            reach_m: DAY_M + (RAIN_M - DAY_M) * conditions.rain + (NIGHT_M - DAY_M) * conditions.night,
            actors,
        }
    }

    /// How far one sees in this weather and light, in metres.
    pub fn reach_m(&self) -> f64 {
        self.reach_m
    }

    /// The actors that are seen.
    pub fn seen(&self) -> Vec<Actor> {
        (0..self.actors.len()).filter(|&i| self.sees(i)).map(|i| self.actors[i]).collect()
    }

    /// Whether one of them is.
    pub(super) fn sees(&self, i: usize) -> bool {
        let actor = &self.actors[i];
        let outline = Box2::of_actor(actor);
        let (eye_m, away) = (Camera::CENTER.mount.position.y, |of: &Actor| flat(of.position).distance(self.eye));
        // The line of sight falls beyond what is lower than the eye, and rises beyond what is higher.
        let hiding = |other: &&Actor| {
            let covered_m = eye_m + (other.size().y - eye_m) * away(actor) / away(other);
            !std::ptr::eq(*other, actor) && other.kind.is_obstacle() && covered_m >= HIDDEN_SHARE * actor.size().y
        };
        let boxes: Vec<Box2> = self.actors.iter().filter(hiding).map(Box2::of_actor).collect();
        let shows = |point: &DVec2| {
            let way = *point - self.eye;
            let aside = ahead(self.yaw).angle_to(way).abs();
            let line = Box2 {
                centre: self.eye + way / 2.0,
                half: DVec2::new(0.01, way.length() / 2.0),
                yaw: way.x.atan2(way.y),
            };
            aside < self.half_angle && way.length() < self.reach_m && !boxes.iter().any(|hidden| line.touches(hidden))
        };
        outline.corners().iter().chain([&outline.centre]).filter(|point| shows(point)).count() >= SEEN_OF_FIVE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::ActorKind;
    use glam::DVec3;

    fn at(kind: ActorKind, right: f64, along: f64) -> Actor {
        Actor { kind, position: DVec3::new(right, 0.0, along), yaw: 0.0, speed: 0.0, look: 0 }
    }

    #[test]
    fn what_stands_behind_a_car_is_hidden_and_what_is_higher_or_beside_is_not() {
        let child = at(ActorKind::Child, 3.2, 32.0);
        let seen = |actors: &[Actor], conditions: &Conditions| {
            Sight::from(&Car::default(), actors, conditions).seen().iter().map(|actor| actor.kind).collect::<Vec<_>>()
        };
        let day = Conditions::default();
        assert_eq!(seen(&[child], &day), [ActorKind::Child]);
        assert_eq!(seen(&[child, at(ActorKind::Car, 3.1, 28.0)], &day), [ActorKind::Car]);
        assert_eq!(seen(&[child, at(ActorKind::Car, -3.1, 28.0)], &day).len(), 2);
        assert_eq!(seen(&[child, at(ActorKind::Cone, 3.1, 28.0)], &day).len(), 2);
        assert_eq!(seen(&[at(ActorKind::Car, 0.0, -20.0)], &day).len(), 0, "behind");
        assert_eq!(seen(&[at(ActorKind::Car, 30.0, 10.0)], &day).len(), 0, "beside the picture");
        let night = Conditions { night: 1.0, ..day };
        assert_eq!(seen(&[at(ActorKind::Car, 0.0, 70.0), at(ActorKind::Car, 0.0, 40.0)], &night).len(), 1);
    }
}
