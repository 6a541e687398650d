//! Finds collisions and being stuck from speed and throttle alone.

use crate::score::smoothness::GAP_S;
use lapwing_core::{
    car::{GRACE_S, STUCK_MPH, STUCK_S, STUCK_THROTTLE},
    units::MPS_PER_MPH,
};

/// The hardest that the car slows down by itself, in m/s2: coasting uphill, and braking. Brakes of the stock build
/// reach 8.5 in real drives, tyres 11.
const ROLLS: f64 = 6.0;
const BRAKES: f64 = 12.0;
/// Speed lost beyond that in a collision, in m/s.
const LOST: f64 = 1.0;
/// Another one within this many seconds is the same collision: cars bounce.
const APART_S: f64 = 2.0;

/// Watches speeds and throttles.
#[derive(Debug, Clone, Default)]
pub(super) struct Impacts {
    last: Option<(f64, f64)>,
    throttle: f64,
    first_s: Option<f64>,
    slow_since: Option<f64>,
    is_stuck: bool,
    /// Their times, in seconds.
    pub collisions: Vec<f64>,
    /// Their times, in seconds.
    pub stuck: Vec<f64>,
    /// What the last speed suggests, in words.
    pub suspicion: Option<&'static str>,
}

impl Impacts {
    /// When there was a collision, or the car was stuck, in seconds, in order.
    pub fn times(&self) -> Vec<f64> {
        let mut times: Vec<f64> = self.collisions.iter().chain(&self.stuck).copied().collect();
        times.sort_by(f64::total_cmp);
        times
    }

    /// The throttle in the answer, negative to brake.
    pub fn command(&mut self, throttle: f64) {
        self.throttle = throttle;
    }

    /// The next speed belongs to another drive.
    pub fn cut(&mut self) {
        self.last = None;
    }

    /// The speed in m/s at a time in s. Times never go back.
    pub fn speed(&mut self, at: f64, mps: f64) {
        let first = *self.first_s.get_or_insert(at);
        self.suspicion = None;
        if let Some((before, was)) = self.last.filter(|(before, _)| at - before <= GAP_S) {
            let explained = (at - before) * if self.throttle < 0.0 { BRAKES } else { ROLLS };
            let lost = was - mps - explained;
            if lost > LOST && self.collisions.last().is_none_or(|last| at - last > APART_S) {
                self.collisions.push(at);
                self.suspicion = Some("probably a collision: the car lost speed faster than it can by itself");
            }
        }
        self.last = Some((at, mps));
        let tries = mps < STUCK_MPH * MPS_PER_MPH && self.throttle >= STUCK_THROTTLE && at - first > GRACE_S;
        if !tries {
            (self.slow_since, self.is_stuck) = (None, false);
        } else if at - *self.slow_since.get_or_insert(at) >= STUCK_S && !self.is_stuck {
            self.is_stuck = true;
            self.stuck.push(at);
            self.suspicion = Some("probably stuck: the car stands under throttle");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Speeds at 15 Hz, with the throttle.
    fn watched(speeds: impl IntoIterator<Item = (f64, f64)>) -> Impacts {
        let mut impacts = Impacts::default();
        for (i, (mps, throttle)) in speeds.into_iter().enumerate() {
            impacts.speed(i as f64 / 15.0, mps);
            impacts.command(throttle);
        }
        impacts
    }

    #[test]
    fn a_car_that_stands_from_one_telemetry_to_the_next_has_hit_something() {
        let drive = (0..30).map(|_| (8.0, 0.3)).chain((0..10).map(|_| (0.0, 0.3)));
        assert_eq!(watched(drive).collisions, [2.0]);
    }

    #[test]
    fn braking_as_hard_as_tyres_hold_is_no_collision() {
        let drive = (0..12).map(|i| ((9.0 - 11.0 * f64::from(i) / 15.0).max(0.0), -1.0));
        assert_eq!(watched(drive).collisions, [0.0; 0]);
    }

    #[test]
    fn bouncing_is_one_collision_and_the_next_one_another() {
        let speeds = [9.0, 5.0, 2.0, 3.0, 0.5].into_iter().chain([8.0; 40]).chain([1.0]);
        assert_eq!(watched(speeds.map(|mps| (mps, 0.5))).collisions.len(), 2);
    }

    #[test]
    fn stuck_is_who_stands_with_throttle_for_two_seconds_and_not_who_starts_or_waits() {
        let starts = (0..60).map(|_| (0.0, 0.3));
        assert_eq!(watched(starts).stuck.len(), 0);
        let drives = || (0..90).map(|_| (5.0, 0.3));
        assert_eq!(watched(drives().chain((0..40).map(|_| (0.1, 0.3)))).stuck.len(), 1);
        assert_eq!(watched(drives().chain((0..40).map(|_| (0.1, 0.0)))).stuck.len(), 0);
    }
}
