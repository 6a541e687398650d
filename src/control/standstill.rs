//! Brake to a standstill without reversing.

use std::time::Duration;

use super::REVERSES_BELOW;
use crate::units::{Mph, Throttle};

/// The car counts as standing below this speed.
const STANDING_BELOW: Mph = Mph::constant(0.7);

/// A rise above the slowest speed seen by more than this is the car reversing, not noise of four decimals.
const RISE_MPH: f64 = 0.05;

/// From the top speed of 30 mph the car stops in about 1.5 s at 1 g; with no speed known this is long enough.
const BLIND_BRAKING: Duration = Duration::from_secs(2);

/// Full brake down to 5 mph, kept on until the car stands or its speed rises
/// again (below 5 mph the brake is the reverse gear, and reversing shows as a
/// positive speed), then nothing.
#[derive(Debug, Clone, Default)]
pub struct Standstill {
    blind_since: Option<Duration>,
    slowest: Option<Mph>,
    released: bool,
}

impl Standstill {
    /// The throttle for this moment; `speed` is `None` where the telemetry told none.
    pub fn update(&mut self, at: Duration, speed: Option<Mph>) -> Throttle {
        match speed {
            Some(speed) => {
                self.blind_since = None;
                let slowest = self.slowest.map_or(speed, |s| if speed < s { speed } else { s });
                self.slowest = Some(slowest);
                if speed > REVERSES_BELOW {
                    self.released = false; // rolling again, downhill: the brake is a brake
                    self.slowest = Some(speed);
                } else if speed < STANDING_BELOW || speed.get() > slowest.get() + RISE_MPH {
                    self.released = true;
                }
            }
            None => {
                let since = *self.blind_since.get_or_insert(at);
                self.released |= at.saturating_sub(since) >= BLIND_BRAKING;
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
        speeds.iter().map(|s| standstill.update(Duration::ZERO, Some(Mph::new(*s).unwrap())).get()).collect()
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
    fn with_no_speed_known_the_brake_is_held_for_two_seconds() {
        let mut standstill = Standstill::default();
        let mut at = |ms| standstill.update(Duration::from_millis(ms), None).get();
        assert_eq!([at(5000), at(6999), at(7000), at(60_000)], [-1.0, -1.0, 0.0, 0.0]);
    }
}
