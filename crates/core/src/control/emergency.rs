//! When a guard's warnings become braking, and when braking ends.
//!
//! ```text
//! value ─▶ over the upper limit twice in a row ─▶ brakes (standstill's rule) ─▶ calm, stood, handed over ─▶ rests
//! ```
//! It never latches: once the car has stood for [`STANDS_S`] and no emergency brake is due, or for [`HELD_S`] whatever the
//! guard goes on saying, the pilot has the throttle back.

use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{KnownSpeed, Standstill, standstill::STANDING_BELOW};
use crate::units::{Mph, Throttle};

/// This many values in a row above the upper limit are an emergency: one alone may be noise.
pub const TO_FIRE: u32 = 2;

/// This many in a row below the lower limit end it. At 15 Hz a third of a second: what a driver's brake outlasts a
/// danger by, and longer than a network's value dips.
pub const TO_RELEASE: u32 = 5;

/// It brakes for at least this long, in seconds: the 10 frames that Itu and Danescu label.
pub const LEAST_S: f64 = 0.67;

/// A car that has stood for this long, in seconds, is the pilot's again, unless an emergency brake is still due …
pub const STANDS_S: f64 = 1.5;

/// … and after this long in any case, in seconds: a guard may be wrong for good.
pub const HELD_S: f64 = 30.0;

/// A car slower than this is not braked anew: its brake would be the reverse gear, and the pilot must be able to leave.
pub const SLOWEST: Mph = Mph::constant(1.5);

/// Name of the guard whose value is the inverse of the time to collision, per second.
pub const TIME_TO_COLLISION: &str = "time to collision";

/// Between which values a guard brakes and rests.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BrakeLimits {
    /// At this value or above, an emergency brake is due.
    pub fires: f64,
    /// Below this one, at most [`BrakeLimits::fires`], it no longer is.
    pub releases: f64,
}

/// Why a guard let go of the brake.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Release {
    /// Its value fell.
    Calm,
    /// The car has stood for a while.
    Stood,
    /// A human took over, or the pilot is switched off.
    HandedOver,
}

/// What an emergency brake changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BrakeChange {
    /// It brakes from now on.
    Began {
        /// The guard's value.
        value: f64,
    },
    /// It no longer does, after this long.
    Ended(Release, Duration),
}

/// The brake that a guard presses.
#[derive(Debug, Clone)]
pub struct EmergencyBrake {
    limits: BrakeLimits,
    /// Values in a row at or above the upper limit.
    high: u32,
    pressed: Option<Pressed>,
}

#[derive(Debug, Clone, Default)]
struct Pressed {
    since: Duration,
    /// Values in a row below the lower limit.
    low: u32,
    /// Whether the last value was below the upper one.
    is_past: bool,
    stands_since: Option<Duration>,
    standstill: Standstill,
}

impl EmergencyBrake {
    /// A brake at rest.
    pub fn new(limits: BrakeLimits) -> Self {
        Self { limits, high: 0, pressed: None }
    }

    /// Whether it brakes.
    pub fn is_pressed(&self) -> bool {
        self.pressed.is_some()
    }

    /// Takes what is known of this moment: the guard's value, none if it has nothing new to say.
    pub fn update(&mut self, at: Duration, speed: Mph, value: Option<f64>) -> Option<BrakeChange> {
        let Some(pressed) = &mut self.pressed else {
            let value = value?;
            let is_high = value >= self.limits.fires && speed >= SLOWEST;
            self.high = if is_high { self.high + 1 } else { 0 };
            return (self.high >= TO_FIRE).then(|| {
                self.pressed = Some(Pressed { since: at, ..Pressed::default() });
                BrakeChange::Began { value }
            });
        };
        if let Some(value) = value {
            pressed.low = if value < self.limits.releases { pressed.low + 1 } else { 0 };
            pressed.is_past = value < self.limits.fires;
        }
        pressed.stands_since = (speed < STANDING_BELOW).then(|| pressed.stands_since.unwrap_or(at));
        let after = |since: Duration| at.saturating_sub(since).as_secs_f64();
        let most = if pressed.is_past { STANDS_S } else { HELD_S };
        if pressed.stands_since.is_some_and(|since| after(since) >= most) {
            return self.release(at, Release::Stood);
        }
        let is_calm = pressed.low >= TO_RELEASE && after(pressed.since) >= LEAST_S;
        if is_calm { self.release(at, Release::Calm) } else { None }
    }

    /// The throttle in place of the pilot's; none at rest.
    pub fn throttle(&mut self, at: Duration, speed: KnownSpeed) -> Option<Throttle> {
        self.pressed.as_mut().map(|pressed| pressed.standstill.update(at, speed))
    }

    /// Lets go, if it brakes.
    pub fn release(&mut self, at: Duration, why: Release) -> Option<BrakeChange> {
        self.high = 0;
        let pressed = self.pressed.take()?;
        Some(BrakeChange::Ended(why, at.saturating_sub(pressed.since)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: BrakeLimits = BrakeLimits { fires: 0.5, releases: 0.25 };

    /// What happens at 15 Hz with these values and speeds: the index, and `+` or why it ended.
    fn changes(moments: &[(f64, f64)]) -> Vec<(usize, Option<Release>)> {
        let mut brake = EmergencyBrake::new(LIMITS);
        let mut happened = vec![];
        for (i, (value, mph)) in moments.iter().enumerate() {
            let at = Duration::from_secs_f64(i as f64 / 15.0);
            match brake.update(at, Mph::new(*mph).unwrap(), Some(*value)) {
                Some(BrakeChange::Began { .. }) => happened.push((i, None)),
                Some(BrakeChange::Ended(why, _)) => happened.push((i, Some(why))),
                None => {}
            }
        }
        happened
    }

    #[test]
    fn two_values_in_a_row_press_the_brake_and_one_does_not() {
        assert_eq!(changes(&[(0.9, 20.0), (0.4, 20.0), (0.9, 20.0), (0.1, 20.0)]), []);
        assert_eq!(changes(&[(0.0, 20.0), (0.5, 20.0), (0.6, 20.0)]), [(2, None)]);
    }

    #[test]
    fn between_the_limits_it_holds_and_below_them_it_lets_go_after_a_while() {
        let mut moments = vec![(0.9, 20.0); 2];
        moments.extend([(0.3, 15.0); 20]);
        assert_eq!(changes(&moments), [(1, None)]);
        moments.extend([(0.2, 12.0), (0.3, 12.0)]);
        moments.extend([(0.1, 12.0); 5]);
        assert_eq!(changes(&moments), [(1, None), (28, Some(Release::Calm))]);
    }

    #[test]
    fn a_standing_car_is_the_pilots_again_whatever_the_guard_says_and_is_not_held_for_good() {
        let mut moments = vec![(0.9, 20.0); 2];
        let mut calmer = moments.clone();
        calmer.extend([(0.4, 0.0); 30]);
        // 1.5 s after the first moment at rest.
        assert_eq!(changes(&calmer), [(1, None), (25, Some(Release::Stood))]);
        moments.extend([(0.9, 0.0); 460]);
        assert_eq!(changes(&moments), [(1, None), (452, Some(Release::Stood))], "30 s after it");
        moments.extend([(0.9, 1.0), (0.9, 1.6), (0.9, 2.0)]);
        assert_eq!(changes(&moments).last(), Some(&(464, None)), "moving on into it is braked again");
    }

    #[test]
    fn a_guard_that_falls_silent_lets_go_of_a_standing_car() {
        let mut brake = EmergencyBrake::new(LIMITS);
        let at = |i: u32| Duration::from_secs(1) * i / 15;
        let fast = Mph::new(20.0).unwrap();
        assert_eq!(brake.update(at(0), fast, Some(0.9)), None);
        assert_eq!(brake.update(at(1), fast, Some(0.9)), Some(BrakeChange::Began { value: 0.9 }));
        assert_eq!(brake.throttle(at(1), KnownSpeed::Now(fast)), Some(Throttle::MIN));
        let ended = (2..500).find_map(|i| brake.update(at(i), Mph::ZERO, None));
        assert!(matches!(ended, Some(BrakeChange::Ended(Release::Stood, _))), "{ended:?}");
        assert_eq!(brake.throttle(at(500), KnownSpeed::Now(fast)), None);
    }
}
