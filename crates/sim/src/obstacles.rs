//! What the car can hit: oriented boxes on the ground plane.
//!
//! Points are `(x, z)` of Unity's axes; yaw is clockwise from +z, in radians.
//! Heights are the judge's business: see [`super::judge`].

use glam::{DVec2, DVec3};

use lapwing_core::car::{FRONT_AXLE_M, REAR_AXLE_M};

use super::{
    scene::Actor,
    vehicle::{BODY, Car},
};

/// How far ahead of the car's origin the middle of its body is, in metres: halfway between
/// the axles.
pub const BODY_CENTRE_M: f64 = (FRONT_AXLE_M - REAR_AXLE_M) / 2.0;
/// How far ahead of the car's origin its front bumper is, in metres.
pub const FRONT_M: f64 = BODY_CENTRE_M + BODY.z / 2.0;

/// Anything slower than this along an axis stands still on it, in m/s.
const STILL: f64 = 1e-9;

/// A rectangle on the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Box2 {
    /// Its middle: x and z, in metres.
    pub centre: DVec2,
    /// Half its width and half its length, in metres.
    pub half: DVec2,
    /// Where its length points, radians clockwise from +z.
    pub yaw: f64,
}

/// The unit vector of a yaw, as x and z.
pub(super) fn ahead(yaw: f64) -> DVec2 {
    let (sin, cos) = yaw.sin_cos();
    DVec2::new(sin, cos)
}

/// A point seen from above.
pub(super) fn flat(point: DVec3) -> DVec2 {
    DVec2::new(point.x, point.z)
}

impl Box2 {
    /// The footprint of something beside the road.
    pub fn of_actor(actor: &Actor) -> Self {
        let size = actor.size();
        Self { centre: flat(actor.position), half: DVec2::new(size.x, size.z) / 2.0, yaw: actor.yaw }
    }

    /// The footprint of the car's body.
    pub fn of_car(car: &Car) -> Self {
        Self {
            centre: flat(car.position) + ahead(car.yaw) * BODY_CENTRE_M,
            half: DVec2::new(BODY.x, BODY.z) / 2.0,
            yaw: car.yaw,
        }
    }

    /// The same box, extended by `metres` at its front.
    pub fn lengthened(self, metres: f64) -> Self {
        Self {
            centre: self.centre + ahead(self.yaw) * (metres / 2.0),
            half: self.half + DVec2::new(0.0, metres / 2.0),
            yaw: self.yaw,
        }
    }

    /// The unit vectors across, to the right, and along.
    fn axes(&self) -> [DVec2; 2] {
        let along = ahead(self.yaw);
        [DVec2::new(along.y, -along.x), along]
    }

    /// Its corners: front left, front right, rear right, rear left.
    pub fn corners(&self) -> [DVec2; 4] {
        let [across, along] = self.axes();
        let (across, along) = (across * self.half.x, along * self.half.y);
        [
            self.centre + along - across,
            self.centre + along + across,
            self.centre - along + across,
            self.centre - along - across,
        ]
    }

    /// Whether they share a point. By the separating axis theorem two rectangles are apart exactly if their projections
    /// on one of the four directions of their sides are.
    pub fn touches(&self, other: &Self) -> bool {
        let between = other.centre - self.centre;
        if between.length_squared() > (self.half.length() + other.half.length()).powi(2) {
            return false; // even the circles around them are apart
        }
        self.shadows(other).all(|(axis, reach)| between.dot(axis).abs() <= reach)
    }

    /// In how many seconds they begin to touch if `other` moves relative to this one at `velocity`, in m/s, and neither
    /// turns: 0 if they touch now, none if they never will.
    pub fn meets(&self, other: &Self, velocity: DVec2) -> Option<f64> {
        let between = other.centre - self.centre;
        let (mut from, mut until) = (0.0_f64, f64::INFINITY);
        // They touch while their projections overlap on every axis; on each axis that is one interval of time.
        for (axis, reach) in self.shadows(other) {
            let (apart, speed) = (between.dot(axis), velocity.dot(axis));
            if speed.abs() > STILL {
                let (one, another) = ((-reach - apart) / speed, (reach - apart) / speed);
                from = from.max(one.min(another));
                until = until.min(one.max(another));
            } else if apart.abs() > reach {
                return None;
            }
        }
        (from <= until).then_some(from)
    }

    /// The directions of both boxes' sides, and along each the distance of their middles at which their projections
    /// touch.
    fn shadows(&self, other: &Self) -> impl Iterator<Item = (DVec2, f64)> {
        let (own, others) = (self.axes(), other.axes());
        let (half, others_half) = (self.half, other.half);
        let shadow =
            |axes: [DVec2; 2], half: DVec2, on: DVec2| axes[0].dot(on).abs() * half.x + axes[1].dot(on).abs() * half.y;
        let reach = move |on| (on, shadow(own, half, on) + shadow(others, others_half, on));
        own.into_iter().chain(others).map(reach)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, SQRT_2};

    use super::*;
    use crate::scene::ActorKind;

    fn square(x: f64, z: f64, half: f64, yaw: f64) -> Box2 {
        Box2 { centre: DVec2::new(x, z), half: DVec2::splat(half), yaw }
    }

    #[test]
    fn boxes_touch_where_no_direction_separates_them() {
        let still = square(0.0, 0.0, 1.0, 0.0);
        let long = |x, z, yaw| Box2 { centre: DVec2::new(x, z), half: DVec2::new(0.5, 3.0), yaw };
        for (name, other, expected) in [
            ("inside", square(0.1, -0.2, 0.1, 1.0), true),
            ("side by side, just touching", square(1.999, 0.0, 1.0, 0.0), true),
            ("side by side, just apart", square(2.001, 0.0, 1.0, 0.0), false),
            ("a corner just into a side", square(1.0 + SQRT_2 - 0.001, 0.0, 1.0, FRAC_PI_4), true),
            ("a corner just short of a side", square(1.0 + SQRT_2 + 0.001, 0.0, 1.0, FRAC_PI_4), false),
            // The circles around them overlap, and so do their shadows on the first box's sides.
            ("corner to corner, apart on the diagonal only", square(1.75, 1.75, 1.0, FRAC_PI_4), false),
            ("corner to corner, touching on the diagonal", square(1.70, 1.70, 1.0, FRAC_PI_4), true),
            ("its long side ahead", long(0.0, 3.9, 0.0), true),
            ("its long side across, ahead", long(0.0, 1.6, FRAC_PI_2), false),
            ("its long side across, to the right", long(3.9, 0.0, FRAC_PI_2), true),
            ("crossing without a corner inside the other", long(0.0, 0.0, 0.3), true),
            ("far away", square(1e6, 0.0, 1.0, 0.3), false),
        ] {
            assert_eq!(still.touches(&other), expected, "{name}");
            assert_eq!(other.touches(&still), expected, "{name}, the other way round");
        }
    }

    #[test]
    fn boxes_touch_wherever_a_corner_of_one_lies_in_the_other() {
        // Compared with the plain definition, over a grid of places and angles.
        let a = Box2 { centre: DVec2::new(3.0, -2.0), half: DVec2::new(1.2, 2.2), yaw: 0.7 };
        let holds = |b: &Box2, point: DVec2| {
            let [across, along] = b.axes();
            let seen = point - b.centre;
            seen.dot(across).abs() <= b.half.x && seen.dot(along).abs() <= b.half.y
        };
        let mut inside = 0;
        for i in 0..4000_i32 {
            let centre = a.centre + DVec2::new(f64::from(i % 20) - 9.5, f64::from(i / 20 % 20) - 9.5) * 0.45;
            let b = Box2 { centre, half: DVec2::new(0.3, 0.9), yaw: f64::from(i / 400) * 0.61 };
            if b.corners().iter().any(|&corner| holds(&a, corner)) || a.corners().iter().any(|&c| holds(&b, c)) {
                assert!(a.touches(&b), "{b:?}");
                inside += 1;
            } else if a.touches(&b) {
                // Only a cross has no corner inside; then the middles are near.
                assert!(centre.distance(a.centre) < 2.2 + 0.9, "{b:?}");
            }
        }
        assert!(inside > 300, "{inside}");
    }

    #[test]
    fn boxes_meet_when_their_sides_have_come_together() {
        let still = square(0.0, 0.0, 1.0, 0.0);
        for (name, other, velocity, expected) in [
            ("head on", square(0.0, 12.0, 1.0, 0.0), (0.0, -5.0), Some(2.0)),
            ("head on, touching by a hair", square(1.999, 12.0, 1.0, 0.0), (0.0, -5.0), Some(2.0)),
            ("passing by a hair", square(2.001, 12.0, 1.0, 0.0), (0.0, -5.0), None),
            ("going away", square(0.0, 12.0, 1.0, 0.0), (0.0, 5.0), None),
            ("standing apart", square(0.0, 12.0, 1.0, 0.0), (0.0, 0.0), None),
            ("standing on each other", square(0.5, 0.5, 1.0, 0.0), (0.0, 0.0), Some(0.0)),
            ("a corner first", square(0.0, 11.0 + SQRT_2, 1.0, FRAC_PI_4), (0.0, -5.0), Some(2.0)),
            ("from the side and ahead at once", square(7.0, 12.0, 1.0, 0.0), (-2.5, -5.0), Some(2.0)),
            ("across, before it comes", square(7.0, 12.0, 1.0, 0.0), (-5.0, -5.0), None),
        ] {
            let velocity = DVec2::from(velocity);
            for met in [still.meets(&other, velocity), other.meets(&still, -velocity)] {
                let same = met.zip(expected).is_none_or(|(met, expected)| (met - expected).abs() < 1e-9);
                assert!(same && met.is_some() == expected.is_some(), "{name}: {met:?}, expected {expected:?}");
            }
        }
    }

    #[test]
    fn boxes_touch_from_the_moment_on_at_which_they_meet() {
        let car = Box2 { centre: DVec2::ZERO, half: DVec2::new(1.2, 2.2), yaw: 0.4 };
        let mut met = 0;
        for i in 0..2000_i32 {
            let centre = DVec2::new(f64::from(i % 40) - 20.0, f64::from(i / 40) - 25.0);
            let velocity = DVec2::new(f64::from(i % 7) - 3.0, f64::from(i % 5) - 2.0);
            let other = Box2 { centre, half: DVec2::new(0.3, 0.9), yaw: f64::from(i) };
            let then = |s: f64| car.touches(&Box2 { centre: centre + velocity * s, ..other });
            match car.meets(&other, velocity) {
                Some(0.0) => assert!(then(0.0)),
                Some(s) => {
                    met += 1;
                    assert!(!then(s - 1e-6) && then(s + 1e-6), "{other:?} in {s} s");
                }
                None => assert!((0..200).all(|tenth| !then(f64::from(tenth) / 10.0)), "{other:?} at {velocity}"),
            }
        }
        assert!(met > 100, "{met}");
    }

    #[test]
    fn the_cars_front_is_where_its_body_ends() {
        let car = Car { position: DVec3::new(10.0, 3.0, 20.0), yaw: FRAC_PI_2, ..Car::default() };
        let [front_left, front_right, rear_right, _] = Box2::of_car(&car).corners();
        let near = |point: DVec2, x: f64, z: f64| assert!(point.distance(DVec2::new(x, z)) < 1e-9, "{point}");
        near(front_left, 12.07, 21.215); // facing +x, left is +z
        near(front_right, 12.07, 18.785);
        near(rear_right, 7.60, 18.785);
        assert!((FRONT_M - 2.07).abs() < 1e-9);
    }

    #[test]
    fn an_actors_box_is_as_large_as_its_kind() {
        let actor =
            Actor { kind: ActorKind::Barrier, position: DVec3::new(1.0, 9.0, 2.0), yaw: 0.0, speed: 0.0, look: 0 };
        let footprint = Box2::of_actor(&actor);
        assert_eq!(footprint.corners()[1], DVec2::new(2.0, 2.2));
        assert_eq!(footprint.lengthened(2.0).corners()[1], DVec2::new(2.0, 4.2));
        assert_eq!(footprint.lengthened(2.0).corners()[2], footprint.corners()[2]);
    }
}
