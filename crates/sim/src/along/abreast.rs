//! Two cars side by side: the recorded one and the virtual one.

use glam::DVec3;

use super::warp::Beside;
use crate::vehicle::{Car, STEP_S};
use lapwing_core::units::Steering;

/// The recorded car, and the virtual one abreast of it at the recorded speed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Abreast {
    recorded: Car,
    driven: Car,
    beside: Beside,
    /// Where the recorded car has come to, from where this began.
    place: (DVec3, f64),
}

/// What the recorded car did during a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct RecordedStep {
    /// Metres a second.
    pub speed: f64,
    /// What was steered.
    pub steering: Steering,
    /// How fast it turned by its pictures or by where it was in its lane, in radians a second, positive to the right.
    pub yaw_rate: Option<f64>,
    /// Metres a second to its right, if it is known where in its lane it was.
    pub aside: Option<f64>,
}

impl Abreast {
    /// Where the driven car is.
    pub(super) fn beside(&self) -> Beside {
        self.beside
    }

    /// Where the recorded car has come to, in the world in which it was at the origin at first, and its yaw.
    pub(super) fn place(&self) -> (DVec3, f64) {
        self.place
    }

    /// Puts the driven car beside the recorded one, with its motion.
    pub(super) fn put_back(&mut self, beside: Beside) {
        self.driven = self.recorded;
        self.beside = beside;
    }

    /// Puts the driven car elsewhere, in a motion of its own: it follows a bend without slipping.
    pub(super) fn put(&mut self, beside: Beside, yaw_rate: f64) {
        self.driven = Car { yaw_rate, lateral_speed: 0.0, ..self.recorded };
        self.beside = beside;
    }

    /// One step of [`STEP_S`].
    pub(super) fn step(&mut self, recorded: RecordedStep, steering: Steering) {
        let RecordedStep { speed, yaw_rate, aside, .. } = recorded;
        let Beside { offset_m, heading_rad, .. } = self.beside;
        self.recorded.step_at(speed, recorded.steering);
        // What the pictures show overrides what the steering says; the tyres slip accordingly.
        self.recorded.yaw_rate = yaw_rate.unwrap_or(self.recorded.yaw_rate);
        let aside = aside.unwrap_or(self.recorded.lateral_speed);
        let gone =
            Beside { offset_m: STEP_S * aside, ahead_m: STEP_S * speed, heading_rad: STEP_S * self.recorded.yaw_rate };
        self.place = gone.from(self.place);
        // To stay abreast, the car further out in a bend goes faster.
        let (sin, cos) = heading_rad.sin_cos();
        let forward = (speed - self.recorded.yaw_rate * offset_m + self.driven.lateral_speed * sin) / cos.max(0.3);
        self.driven.step_at(forward.max(0.0), steering);
        self.beside = Beside {
            offset_m: offset_m + STEP_S * (forward * sin + self.driven.lateral_speed * cos - aside),
            heading_rad: heading_rad + STEP_S * (self.driven.yaw_rate - self.recorded.yaw_rate),
            ..self.beside
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn along(steps: usize, seen: impl Fn(f64) -> Option<f64>, recorded: f64, driven: f64) -> Beside {
        let mut pair = Abreast::default();
        for i in 0..steps {
            let yaw_rate = seen(i as f64 * STEP_S);
            let was = RecordedStep { speed: 9.0, steering: Steering::saturating(recorded), yaw_rate, aside: None };
            pair.step(was, Steering::saturating(driven));
        }
        pair.beside()
    }

    #[test]
    fn whoever_steers_as_recorded_stays_on_the_path() {
        assert_eq!(along(500, |_| None, 0.2, 0.2), Beside::default());
    }

    #[test]
    fn whoever_steers_further_right_comes_out_on_the_right_and_faces_there() {
        for (recorded, driven, sign) in [(0.0, 0.05, 1.0), (0.2, 0.15, -1.0), (-0.2, -0.15, 1.0), (-0.1, -0.2, -1.0)] {
            let beside = along(50, |_| None, recorded, driven);
            assert!(
                beside.offset_m * sign > 0.05 && beside.heading_rad * sign > 0.01,
                "{recorded} {driven} {beside:?}"
            );
        }
    }

    #[test]
    fn what_the_pictures_show_wins_over_the_recorded_steering() {
        // The car turned left though its recorded steering was straight, so going straight leads off to the right.
        let beside = along(50, |_| Some(-0.1), 0.0, 0.0);
        assert!(beside.offset_m > 0.3 && (beside.heading_rad - 0.1).abs() < 0.02, "{beside:?}");
    }

    #[test]
    fn beside_is_where_two_free_cars_would_be_in_a_bend() {
        let mut pair = Abreast::default();
        for i in 0..125 {
            let driven = if i < 75 { 0.33 } else { 0.3 };
            let steering = Steering::saturating(0.3);
            let recorded = RecordedStep { speed: 9.0, steering, yaw_rate: None, aside: None };
            pair.step(recorded, Steering::saturating(driven));
        }
        // Each car keeps its own place in the world, too.
        let apart = pair.driven.position - pair.recorded.position;
        let ahead = pair.recorded.ahead();
        let (right, along) = (apart.x * ahead.z - apart.z * ahead.x, apart.dot(ahead));
        let Beside { offset_m, heading_rad, .. } = pair.beside();
        assert!(right.abs() > 0.2 && (offset_m - right).abs() < 0.05, "{offset_m}, {right}");
        assert!(along.abs() < 0.1, "not abreast by {along} m");
        assert!((heading_rad - (pair.driven.yaw - pair.recorded.yaw)).abs() < 1e-9);
    }
}
