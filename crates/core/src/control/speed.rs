//! Throttle from speed: `drive.py`'s PI controller and Lu's quadratic law.

use super::REVERSES_BELOW;
use crate::units::{Mph, Steering, Throttle};

/// A speed controller's output, with its terms for the run's record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThrottleOutput {
    /// Proportional term, in throttle.
    pub p: f64,
    /// Integral term, in throttle.
    pub i: f64,
    /// Their sum, clamped.
    pub throttle: Throttle,
    /// Whether the clamp changed it.
    pub saturated: bool,
}

/// Clamps to what the car can do without reversing.
fn clamped(p: f64, i: f64, speed: Mph) -> ThrottleOutput {
    let wanted = p + i;
    let lowest = if speed > REVERSES_BELOW { -1.0 } else { 0.0 };
    let throttle = Throttle::saturating(wanted.clamp(lowest, 1.0));
    ThrottleOutput { p, i, throttle, saturated: throttle.get() != wanted }
}

/// The gains of [`Pi`], per telemetry as in `drive.py`, whatever the frame rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PiGains {
    /// Throttle per mph of error.
    pub kp: f64,
    /// Throttle per mph of summed error.
    pub ki: f64,
}

impl Default for PiGains {
    /// `drive.py`'s.
    fn default() -> Self {
        Self { kp: 0.1, ki: 0.002 }
    }
}

/// The PI controller of Udacity's `drive.py` (`SimplePIController`): one update per telemetry, `kp * error + ki * sum
/// of errors`, clamped. The sum is held while the output is clamped and the error would push it further.
#[derive(Debug, Clone)]
pub struct Pi {
    gains: PiGains,
    set_speed: Mph,
    /// Sum of errors, mph.
    integral: f64,
}

impl Pi {
    /// A controller at rest.
    pub fn new(gains: PiGains, set_speed: Mph) -> Self {
        Self { gains, set_speed, integral: 0.0 }
    }

    /// Advances by one telemetry. With a limit below the set speed, the controller holds the limit instead and leaves
    /// the sum of errors alone, which belongs to the set speed.
    pub fn update(&mut self, speed: Mph, limit: Option<Mph>) -> ThrottleOutput {
        let PiGains { kp, ki } = self.gains;
        if let Some(limit) = limit.filter(|limit| *limit < self.set_speed) {
            return clamped(kp * (limit.get() - speed.get()), ki * self.integral, speed);
        }
        let error = self.set_speed.get() - speed.get();
        let output = clamped(kp * error, ki * (self.integral + error), speed);
        let pushes_on = output.saturated && (output.p + output.i - output.throttle.get()) * error * ki.signum() > 0.0;
        if pushes_on {
            return clamped(kp * error, ki * self.integral, speed);
        }
        self.integral += error;
        output
    }
}

/// Lu's law divides by the limit, and a pilot's limit may be zero.
const SLOWEST_LIMIT_MPH: f64 = 0.1;

/// Lu's law: `throttle = 1 - steering² - (speed / limit)²` (End to End Learning for Self-Driving Cars).
#[derive(Debug, Clone)]
pub struct Quadratic {
    limit: Mph,
}

impl Quadratic {
    /// The law for a limit above 0 mph.
    pub fn new(limit: Mph) -> Self {
        Self { limit }
    }

    /// Throttle for the steering about to be commanded and the current speed. `limit` replaces the law's own if it is
    /// lower.
    pub fn update(&self, steering: Steering, speed: Mph, limit: Option<Mph>) -> ThrottleOutput {
        let limit = limit.map_or(self.limit.get(), |limit| limit.get().clamp(SLOWEST_LIMIT_MPH, self.limit.get()));
        let share = speed.get() / limit;
        clamped(1.0 - steering.get().powi(2) - share * share, 0.0, speed)
    }
}

/// One of the speed laws.
#[derive(Debug, Clone)]
pub enum SpeedController {
    /// `drive.py`'s.
    Pi(Pi),
    /// Lu's.
    Quadratic(Quadratic),
}

impl SpeedController {
    /// Throttle for the steering about to be commanded and the current speed. `limit` is the highest speed that the
    /// pilot allows for the road ahead; it replaces the set speed for this step if it is lower.
    pub fn update(&mut self, steering: Steering, speed: Mph, limit: Option<Mph>) -> ThrottleOutput {
        match self {
            Self::Pi(pi) => pi.update(speed, limit),
            Self::Quadratic(quadratic) => quadratic.update(steering, speed, limit),
        }
    }

    /// Another set speed, or limit, from now on. What the PI controller has summed up stays.
    pub fn set_speed(&mut self, speed: Mph) {
        match self {
            Self::Pi(pi) => pi.set_speed = speed,
            Self::Quadratic(quadratic) => quadratic.limit = speed,
        }
    }

    /// Back to rest, between runs.
    pub fn reset(&mut self) {
        if let Self::Pi(pi) = self {
            pi.integral = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mph(value: f64) -> Mph {
        Mph::new(value).unwrap()
    }

    #[test]
    fn the_pi_controller_answers_as_drive_py_does_where_nothing_saturates() {
        // SimplePIController(0.1, 0.002) with set_desired(9), run in Python on these speeds.
        let mut pi = Pi::new(PiGains::default(), mph(9.0));
        for (speed, expected) in [
            (0.0, 0.918_000_000_000_000_1),
            (0.5, 0.885),
            (1.8, 0.769_4),
            (4.2, 0.539),
            (7.0, 0.263),
            (8.5, 0.114),
            (9.2, 0.043_6),
            (10.4, -0.079_200_000_000_000_05),
            (9.1, 0.050_599_999_999_999_964),
        ] {
            let output = pi.update(mph(speed), None);
            assert!((output.throttle.get() - expected).abs() < 1e-12, "{speed} mph: {output:?}, expected {expected}");
            assert!(!output.saturated);
        }
    }

    #[test]
    fn the_integral_does_not_wind_up_while_the_throttle_is_full() {
        let mut pi = Pi::new(PiGains::default(), mph(30.0));
        for _ in 0..10_000 {
            let output = pi.update(mph(0.0), None);
            assert_eq!((output.throttle, output.saturated, output.i), (Throttle::MAX, true, 0.0));
        }
        assert_eq!(pi.update(mph(29.0), None).throttle.get(), 0.1 + 0.002);
    }

    #[test]
    fn no_controller_reverses_the_car() {
        let mut pi = Pi::new(PiGains::default(), mph(2.0));
        assert_eq!(pi.update(mph(4.9), None).throttle, Throttle::ZERO);
        assert!(pi.update(mph(5.1), None).throttle < Throttle::ZERO);
        assert_eq!(Quadratic::new(mph(3.0)).update(Steering::ZERO, mph(4.0), None).throttle, Throttle::ZERO);
    }

    #[test]
    fn lus_law_is_one_less_the_squares() {
        let law = Quadratic::new(mph(20.0));
        assert_eq!(law.update(Steering::new(-0.5).unwrap(), mph(10.0), None).throttle.get(), 0.5);
        let fast = law.update(Steering::MAX, mph(30.0), None);
        assert_eq!((fast.throttle, fast.saturated), (Throttle::MIN, true));
    }

    #[test]
    fn a_lower_limit_is_the_set_speed_for_as_long_as_it_holds_and_a_higher_one_is_none() {
        let mut pi = Pi::new(PiGains::default(), mph(20.0));
        pi.update(mph(19.0), None);
        for _ in 0..100 {
            let slower = pi.update(mph(14.0), Some(mph(12.0)));
            assert_eq!((slower.p, slower.i), (0.1 * -2.0, 0.002), "the sum of errors rests");
        }
        assert_eq!(pi.update(mph(19.0), Some(mph(25.0))).throttle.get(), 0.1 + 0.004);

        let law = Quadratic::new(mph(20.0));
        assert_eq!(law.update(Steering::ZERO, mph(5.0), Some(mph(10.0))).throttle.get(), 0.75);
        assert_eq!(law.update(Steering::ZERO, mph(10.0), Some(mph(40.0))).throttle.get(), 0.75);
        assert_eq!(law.update(Steering::ZERO, mph(10.0), Some(Mph::ZERO)).throttle, Throttle::MIN);
    }
}
