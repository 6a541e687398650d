//! Time to collision with what is ahead, if nobody changes speed or path, and the gap to it.
//!
//! The time to collision of Hayward, Near miss determination through use of a scale of danger (1972), from the true
//! places and sizes. The road is straightened for it: our car continues along the road at its present offset, and
//! everything else moves straight on, so a car parked beside a bend is not on a collision course. Boxes keep their
//! headings.

use glam::{DVec2, DVec3};

use super::{
    obstacles::{Box2, ahead},
    scene::Actor,
    track::{Place, Track},
    traffic::signed,
    vehicle::Car,
};

/// Places at which the curvature of a path is looked up.
const BENDS: usize = 8;
/// What our car passes later than this, in seconds, it never passes.
const LONGEST_S: f64 = 10.0;
/// Speeds no farther apart than this are the same, in m/s.
const SAME_MPS: f64 = 1e-3;

/// Seconds until the car hits the first of the actors ahead of it, 0 if it touches one now; infinite if it hits none.
pub fn time_to_collision(track: &Track, car: &Car, place: &Place, actors: &[Actor]) -> f64 {
    let (body, velocity) = straightened(car, place);
    let until = |actor: &Actor| {
        let actor = beside_straight_road(track, place, actor);
        let other = Box2::of_actor(&actor);
        let is_ahead = other.centre.y > body.centre.y;
        is_ahead.then(|| body.meets(&other, ahead(actor.yaw) * actor.speed - velocity)).flatten()
    };
    obstacles(actors).filter_map(until).fold(f64::INFINITY, f64::min)
}

/// What is in the car's way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InTheWay {
    /// From the front bumper to it, in metres; below 0 where it is touched.
    pub gap_m: f64,
    /// How fast it moves along the road, in m/s; below 0 towards the car.
    pub speed_mps: f64,
}

/// The nearest of the actors that stands in the car's way now or moves along it, with so many metres to spare on each
/// side: our car continues along the road at its present offset.
pub fn in_the_way(track: &Track, car: &Car, place: &Place, actors: &[Actor], spare_m: f64) -> Option<InTheWay> {
    let (body, _) = straightened(car, place);
    let (front_m, reach_m) = (body.centre.y + body.half.y, body.half.x + spare_m);
    let found = |actor: &Actor| {
        let actor = beside_straight_road(track, place, actor);
        let other = Box2::of_actor(&actor);
        let corners = other.corners();
        let least = |number: fn(&DVec2) -> f64| corners.iter().map(number).fold(f64::INFINITY, f64::min);
        let (left_m, right_m, rear_m) = (least(|c| c.x), -least(|c| -c.x), least(|c| c.y));
        let middle_m = body.centre.x;
        let is_in_it = left_m < middle_m + reach_m && right_m > middle_m - reach_m && other.centre.y > body.centre.y;
        is_in_it.then(|| InTheWay { gap_m: rear_m - front_m, speed_mps: actor.speed * actor.yaw.cos() })
    };
    obstacles(actors).filter_map(found).min_by(|a, b| a.gap_m.total_cmp(&b.gap_m))
}

/// How our car gets past something, if nobody changes speed or path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pass {
    /// Metres between its side and ours now, measured across the road; below 0 where they overlap.
    pub room_m: f32,
    /// The least room while our car is beside it; `room_m` if it never is.
    pub least_m: f32,
    /// Seconds until the front of our car reaches it, 0 while they are beside each other; infinite if that is not within 10 s.
    pub until_s: f32,
}

/// How our car gets past an actor, if our car continues along the road at its present offset.
pub fn pass(track: &Track, car: &Car, place: &Place, actor: &Actor) -> Pass {
    let (body, velocity) = straightened(car, place);
    let actor = beside_straight_road(track, place, actor);
    let other = Box2::of_actor(&actor);
    let reach = |half: fn(DVec2) -> f64| {
        let out = |b: &Box2| b.corners().iter().map(|corner| half(*corner - b.centre)).fold(0.0, f64::max);
        out(&body) + out(&other)
    };
    let (across, along) = (reach(|v| v.x), reach(|v| v.y));
    let (apart, closing) = (other.centre - body.centre, ahead(actor.yaw) * actor.speed - velocity);
    let room_m = |after_s: f64| (apart.x + closing.x * after_s).abs() - across;
    let now_m = room_m(0.0);
    // From when on until when they are beside each other.
    let [from_s, until_s] = if closing.y.abs() > SAME_MPS {
        let [a, b] = [(-along - apart.y) / closing.y, (along - apart.y) / closing.y];
        [a.min(b).max(0.0), a.max(b)]
    } else if apart.y.abs() <= along {
        [0.0, f64::INFINITY]
    } else {
        [f64::INFINITY; 2]
    };
    if from_s > until_s || from_s > LONGEST_S {
        return Pass { room_m: now_m as f32, least_m: now_m as f32, until_s: f32::INFINITY };
    }
    // Where it crosses our middle in between, nothing is left.
    let crosses_s = -apart.x / closing.x;
    let crosses = closing.x.abs() > SAME_MPS && (from_s..=until_s).contains(&crosses_s);
    let last_m = if until_s.is_finite() { room_m(until_s) } else { now_m };
    let least_m = if crosses { -across } else { room_m(from_s).min(last_m) };
    Pass { room_m: now_m as f32, least_m: least_m as f32, until_s: from_s as f32 }
}

/// Those of the actors that cannot be driven over.
pub(crate) fn obstacles(actors: &[Actor]) -> impl Iterator<Item = &Actor> {
    actors.iter().filter(|actor| actor.kind.is_obstacle())
}

const fn straight(right: f64, along: f64) -> DVec3 {
    DVec3::new(right, 0.0, along)
}

/// The car's body on the straightened road, and its velocity.
fn straightened(car: &Car, place: &Place) -> (Box2, DVec2) {
    let yaw = car.yaw - place.station.yaw;
    let body = Box2::of_car(&Car { position: straight(place.offset, 0.0), yaw, ..*car });
    (body, DVec2::new(0.0, car.speed * yaw.cos()))
}

/// Something on the straightened road.
fn beside_straight_road(track: &Track, from: &Place, actor: &Actor) -> Actor {
    let there = track.locate(actor.position, None);
    let position = straight(there.offset, way(track, from, there.station.s));
    Actor { position, yaw: actor.yaw - there.station.yaw, ..*actor }
}

/// Metres from the car to `s` along its own line, which in a bend is longer or shorter than the road's middle.
fn way(track: &Track, from: &Place, s: f64) -> f64 {
    let way = signed(track, from.station.s, s);
    let at = |i: usize| from.station.s + way * (i as f64 + 0.5) / BENDS as f64;
    let bend: f64 = (0..BENDS).map(|i| 1.0 - track.at(at(i)).curvature * from.offset).sum();
    way * (bend / BENDS as f64).max(0.2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{obstacles::FRONT_M, scene::ActorKind};

    /// Our car on the lake's line at a speed in m/s, and its place.
    fn on(track: &Track, s: f64, speed: f64) -> (Car, Place) {
        let station = track.at(s);
        (
            Car { position: track.point(s, 0.0), yaw: station.yaw, speed, ..Car::default() },
            Place { station, offset: 0.0 },
        )
    }

    fn beside(track: &Track, kind: ActorKind, s: f64, offset: f64, turned: f64, speed: f64) -> Actor {
        Actor { kind, position: track.point(s, offset), yaw: track.at(s).yaw + turned, speed, look: 0 }
    }

    #[test]
    fn gap_over_closing_speed_wherever_on_the_road() {
        let track = Track::named("lake").unwrap();
        for s in (0..1000).step_by(37).map(f64::from) {
            let (car, place) = on(&track, s, 10.0);
            let until = |actor: Actor| time_to_collision(&track, &car, &place, &[actor]);
            let gap = 30.0 - FRONT_M - 2.2;
            let standing = until(beside(&track, ActorKind::Car, s + 30.0, 0.0, 0.0, 0.0));
            assert!((standing - gap / 10.0).abs() < 0.05, "at {s} m: {standing} s");
            let slower = until(beside(&track, ActorKind::Car, s + 30.0, 0.0, 0.0, 6.0));
            assert!((slower - gap / 4.0).abs() < 0.15, "at {s} m: {slower} s");
            let parked_beside = until(beside(&track, ActorKind::Car, s + 30.0, 3.115, 0.0, 0.0));
            assert_eq!(parked_beside, f64::INFINITY, "at {s} m");
        }
    }

    #[test]
    fn in_the_way_is_what_would_be_touched_and_nothing_beside_it_or_driven_over() {
        let track = Track::named("lake").unwrap();
        let (car, place) = on(&track, 20.0, 10.0);
        let found = |actors: &[Actor]| in_the_way(&track, &car, &place, actors, 0.0);
        let ahead = beside(&track, ActorKind::Car, 50.0, 0.0, 0.0, 4.0);
        let parked = beside(&track, ActorKind::Car, 40.0, 3.115, 0.0, 0.0);
        let plate = beside(&track, ActorKind::SteelPlate, 30.0, 0.0, 0.0, 0.0);
        let InTheWay { gap_m, speed_mps } = found(&[parked, plate, ahead]).unwrap();
        assert!((gap_m - (30.0 - FRONT_M - 2.2)).abs() < 0.3, "{gap_m} m");
        assert!((speed_mps - 4.0).abs() < 0.05, "{speed_mps} m/s");
        assert_eq!(found(&[parked, plate]), None);
        assert!(in_the_way(&track, &car, &place, &[parked], 2.0).is_some(), "two metres to spare are asked for");
        assert_eq!(time_to_collision(&track, &car, &place, &[plate]), f64::INFINITY);
    }

    #[test]
    fn one_who_crosses_is_met_or_just_missed() {
        let track = Track::named("lake").unwrap();
        let (car, place) = on(&track, 20.0, 10.0);
        // Its side is reached after 2.768 s, when one who walks 4 m to the middle at 1.39 m/s is 0.15 m short of it.
        let crossing = |from: f64, speed: f64| {
            let walker = beside(&track, ActorKind::Pedestrian, 50.0, from, -std::f64::consts::FRAC_PI_2, speed);
            time_to_collision(&track, &car, &place, &[walker])
        };
        assert!((crossing(4.0, 1.39) - 2.768).abs() < 0.02, "{}", crossing(4.0, 1.39));
        assert_eq!(crossing(8.0, 1.39), f64::INFINITY, "it comes too late");
        assert_eq!(crossing(4.0, 0.0), f64::INFINITY, "it waits");
    }

    #[test]
    fn a_pass_tells_the_room_beside_something_now_and_when_our_car_is_there() {
        let track = Track::named("lake").unwrap();
        let (car, place) = on(&track, 20.0, 10.0);
        let passing = |actor: Actor| pass(&track, &car, &place, &actor);
        let parked = passing(beside(&track, ActorKind::Car, 50.0, 3.0, 0.0, 0.0));
        let room_m = 3.0 - 0.9 - crate::vehicle::BODY.x / 2.0;
        assert!((f64::from(parked.room_m) - room_m).abs() < 0.02 && parked.least_m == parked.room_m, "{parked:?}");
        assert!((f64::from(parked.until_s) - (30.0 - FRONT_M - 2.2) / 10.0).abs() < 0.03, "{parked:?}");
        // From 4 m beside somebody is hit; from 8 m they come too late; who waits leaves the room that there is now.
        let crossing = |from: f64, speed: f64| {
            passing(beside(&track, ActorKind::Pedestrian, 50.0, from, -std::f64::consts::FRAC_PI_2, speed))
        };
        let (hit, late, waits) = (crossing(4.0, 1.39), crossing(8.0, 1.39), crossing(4.0, 0.0));
        assert!(hit.room_m > 2.0 && hit.least_m < 0.0, "{hit:?}");
        assert!(late.room_m > 6.0 && (1.5..3.0).contains(&late.least_m), "{late:?}");
        assert!(waits.least_m == waits.room_m && waits.until_s.is_finite(), "{waits:?}");
        // As fast as we are.
        let lead = passing(beside(&track, ActorKind::Car, 50.0, 0.0, 0.0, 10.0));
        assert!(lead.room_m < 0.0 && lead.until_s.is_infinite(), "{lead:?}");
    }

    #[test]
    fn what_is_behind_or_as_fast_is_not_hit_and_what_is_touched_is_hit_now() {
        let track = Track::named("lake").unwrap();
        let (car, place) = on(&track, 50.0, 10.0);
        let until =
            |s, speed| time_to_collision(&track, &car, &place, &[beside(&track, ActorKind::Car, s, 0.0, 0.0, speed)]);
        assert_eq!(until(30.0, 20.0), f64::INFINITY, "from behind");
        assert_eq!(until(60.0, 15.0), f64::INFINITY, "it drives away");
        assert_eq!(until(54.0, 0.0), 0.0);
        let nearest = [70.0, 60.0, 80.0].map(|s| beside(&track, ActorKind::Car, s, 0.0, 0.0, 0.0));
        assert_eq!(time_to_collision(&track, &car, &place, &nearest), until(60.0, 0.0));
        assert_eq!(time_to_collision(&track, &car, &place, &[]), f64::INFINITY);
    }
}
