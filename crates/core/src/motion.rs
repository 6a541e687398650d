//! The motion of a car on its wheels, and the arithmetic of angles and closed roads.
//!
//! The bicycle model has two wheels in one track that roll without slipping. Angles and curvatures are positive to the
//! right.

use std::f64::consts::{PI, TAU};

use crate::car::WHEELBASE_M;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::car::FULL_STEERING_DEG;

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
