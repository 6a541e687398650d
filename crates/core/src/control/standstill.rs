//! Brake to a standstill without reversing.

use std::time::Duration;

use super::REVERSES_BELOW;
use crate::{
    car::GRAVITY,
    units::{MPS_PER_MPH, Mph, Throttle},
};

/// The car counts as standing below this speed.
pub(super) const STANDING_BELOW: Mph = Mph::constant(0.7);

/// A rise above the slowest speed seen by more than this is the car reversing, not noise of four decimals.
const RISE_MPH: f64 = 0.05;

/// How fast full brake takes speed off: 1 g, in mph a second. The car's brakes lock the wheels, its grip does no better.
const BRAKING_MPH_PER_S: f64 = GRAVITY / MPS_PER_MPH;

/// What is known of the car's speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KnownSpeed {
    /// Reported by this telemetry.
    Now(Mph),
    /// Not reported now; this is the last one reported, if any.
    Last(Option<Mph>),
}

/// Full brake down to 5 mph, kept on until the car is stationary or its speed rises again (below 5 mph the brake is the
/// reverse gear, and reversing shows as a positive speed), then nothing. If no speed is reported, full brake for the
/// time it takes to slow from the last known speed to 5 mph, then nothing: the car coasts to a stop.
#[derive(Debug, Clone, Default)]
pub struct Standstill {
    /// When a speed was last reported, or when braking began without one.
    blind_since: Option<Duration>,
    slowest: Option<Mph>,
    released: bool,
}

impl Standstill {
    /// The throttle for this moment, `at` since the start of the run.
    pub fn update(&mut self, at: Duration, speed: KnownSpeed) -> Throttle {
        match speed {
            KnownSpeed::Now(speed) => {
                self.blind_since = Some(at);
                let slowest = self.slowest.map_or(speed, |s| if speed < s { speed } else { s });
                self.slowest = Some(slowest);
                if speed > REVERSES_BELOW {
                    self.released = false; // rolling downhill again, too fast for the brake to reverse
                    self.slowest = Some(speed);
                } else if speed < STANDING_BELOW || speed.get() > slowest.get() + RISE_MPH {
                    self.released = true;
                }
            }
            KnownSpeed::Last(last) => {
                let blind = at.saturating_sub(*self.blind_since.get_or_insert(at)).as_secs_f64();
                let left = last.unwrap_or(Mph::ZERO).get() - blind * BRAKING_MPH_PER_S;
                self.released |= left <= REVERSES_BELOW.get();
            }
        }
        if self.released { Throttle::ZERO } else { Throttle::MIN }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn throttles(speeds: &[f64]) -> Vec<f64> {
        let mut standstill = Standstill::default();
        speeds.iter().map(|s| standstill.update(Duration::ZERO, KnownSpeed::Now(Mph::new(*s).unwrap())).get()).collect()
    }

    #[test]
    fn the_brake_is_held_until_the_car_stands() {
        assert_eq!(throttles(&[20.0, 5.1, 4.9, 2.0, 0.69, 0.0]), [-1.0, -1.0, -1.0, -1.0, 0.0, 0.0]);
    }

    #[test]
    fn a_rising_speed_below_5_mph_is_reversing_and_ends_it() {
        assert_eq!(throttles(&[6.0, 1.5, 0.9, 1.2, 1.5]), [-1.0, -1.0, -1.0, 0.0, 0.0]);
    }

    #[test]
    fn a_car_that_rolls_off_again_is_braked_again() {
        assert_eq!(throttles(&[6.0, 0.5, 3.0, 5.5, 4.8]), [-1.0, 0.0, 0.0, -1.0, -1.0]);
    }

    #[test]
    fn with_no_speed_told_the_brake_is_held_for_as_long_as_it_takes_from_the_last_one() {
        let blind = |last: Option<f64>, ms: &[u64]| -> Vec<f64> {
            let (mut standstill, last) = (Standstill::default(), last.map(|v| Mph::new(v).unwrap()));
            ms.iter().map(|ms| standstill.update(Duration::from_millis(*ms), KnownSpeed::Last(last)).get()).collect()
        };
        // 25 mph at 21.9 mph a second.
        assert_eq!(blind(Some(30.0), &[5000, 6100, 6200, 60_000]), [-1.0, -1.0, 0.0, 0.0]);
        assert_eq!(blind(Some(4.0), &[0, 100]), [0.0, 0.0]);
        assert_eq!(blind(None, &[0, 100]), [0.0, 0.0], "a car never seen moving stands");
    }
}
