//! The motion of a car on its wheels, and the arithmetic of angles and closed roads.
//!
//! The bicycle model has two wheels in one track that roll without slipping. Angles and curvatures are positive to the
//! right.

use std::{
    collections::VecDeque,
    f64::consts::{PI, TAU},
};

use crate::car::{GRAVITY, WHEELBASE_M};

/// A deceleration is measured over at least this long, in seconds: speeds are told a frame at a time, and of the simulator's own
/// steps of 0.02 s a frame has three or four.
const OVER_S: f64 = 0.2;

/// The curvature, in 1/m, that a steering angle of the front wheels gives.
pub fn curvature(steering_deg: f64) -> f64 {
    steering_deg.to_radians().tan() / WHEELBASE_M
}

/// The steering angle of the front wheels, in degrees, that gives a curvature in 1/m.
pub fn steering_deg(curvature: f64) -> f64 {
    (WHEELBASE_M * curvature).atan().to_degrees()
}

/// How fast the car turns, in radians a second, at a speed (m/s) and a steering angle of the front wheels.
pub fn yaw_rate(mps: f64, steering_deg: f64) -> f64 {
    mps * steering_deg.to_radians().tan() / WHEELBASE_M
}

/// How a car moved from one telemetry to the next.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Metres driven.
    pub way_m: f64,
    /// Radians turned, clockwise as seen from above: by a bicycle with the reported steering.
    pub turn_rad: f64,
}

/// An angle in radians, wrapped to -PI to PI: the shorter way around.
pub fn turn(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

/// A distance along a closed road, the shorter way around: from minus half its length up to half its length.
pub fn around(metres: f64, length_m: f64) -> f64 {
    let half = length_m / 2.0;
    (metres + half).rem_euclid(length_m) - half
}

/// `y` at `x` on the straight lines between points of rising `x`; before the first and after the last it is theirs.
/// There must be at least two.
pub fn between<P>(points: &[P], x: f64, x_of: impl Fn(&P) -> f64, y_of: impl Fn(usize) -> f64) -> f64 {
    let after = points.partition_point(|point| x_of(point) <= x).clamp(1, points.len() - 1);
    let (before, until) = (x_of(&points[after - 1]), x_of(&points[after]));
    let share = ((x - before) / (until - before)).clamp(0.0, 1.0);
    let (from, to) = (y_of(after - 1), y_of(after));
    from + share * (to - from)
}

/// The hardest deceleration over at least 0.2 s, by speeds told a frame at a time.
#[derive(Debug, Clone, Default)]
pub struct Deceleration {
    /// Times in seconds and speeds in m/s: the last, and those before it that are not too old.
    recent: VecDeque<(f64, f64)>,
    hardest: f64,
}

impl Deceleration {
    /// Begins again, from this time in seconds and speed in m/s if there is one; the hardest deceleration so far stays.
    pub fn restart(&mut self, from: Option<(f64, f64)>) {
        self.recent = from.into_iter().collect();
    }

    /// The car's speed, in m/s, at a time in seconds.
    pub fn measure(&mut self, at_s: f64, mps: f64) {
        let is_far_enough = |then: f64| at_s - then >= OVER_S - 1e-9;
        self.recent.push_back((at_s, mps));
        // The latest that is far enough back is what is measured from.
        while self.recent.get(1).is_some_and(|(then, _)| is_far_enough(*then)) {
            self.recent.pop_front();
        }
        if let Some((then, was)) = self.recent.front().filter(|(then, _)| is_far_enough(*then)) {
            self.hardest = self.hardest.max((was - mps) / (at_s - then) / GRAVITY);
        }
    }

    /// The hardest, in g; 0 if the car never became slower.
    pub fn hardest_g(&self) -> f64 {
        self.hardest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::car::FULL_STEERING_DEG;

    #[test]
    fn the_hardest_deceleration_is_that_of_a_fifth_of_a_second_and_none_from_before_a_restart() {
        let mut braking = Deceleration::default();
        // 15 frames a second; one speed is told a step late, which looks like 2 g from one frame to the next.
        for (i, mps) in [10.0, 10.0, 9.6, 8.3, 8.0, 7.5].into_iter().enumerate() {
            braking.measure(i as f64 / 15.0, mps);
        }
        assert!((braking.hardest_g() - 2.1 / 0.2 / GRAVITY).abs() < 1e-9, "{}", braking.hardest_g());
        braking.restart(Some((1.0, 5.0)));
        braking.measure(1.1, 0.0);
        assert!(braking.hardest_g() < 1.1, "0.1 s is too short");
        braking.measure(1.2, 0.0);
        assert!((braking.hardest_g() - 5.0 / 0.2 / GRAVITY).abs() < 1e-9);
    }

    #[test]
    fn full_lock_turns_the_rear_axle_on_a_circle_of_6_15_m() {
        assert!((1.0 / curvature(FULL_STEERING_DEG) - 6.155).abs() < 1e-3);
        assert!((steering_deg(curvature(-12.5)) + 12.5).abs() < 1e-12);
        assert!((yaw_rate(6.155, FULL_STEERING_DEG) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn an_angle_and_a_way_around_are_taken_the_shorter_way() {
        assert!((turn(1.5 * PI) + 0.5 * PI).abs() < 1e-12);
        assert_eq!((around(90.0, 100.0), around(-10.0, 100.0), around(50.0, 100.0)), (-10.0, -10.0, -50.0));
    }

    #[test]
    fn between_two_points_goes_straight_and_beyond_the_ends_stays() {
        let (xs, ys) = ([0.0, 1.0, 3.0], [0.0, 10.0, 20.0]);
        let at = |x| between(&xs, x, |x| *x, |i| ys[i]);
        assert_eq!([-1.0, 0.5, 1.0, 2.0, 9.0].map(at), [0.0, 5.0, 10.0, 15.0, 20.0]);
    }
}
