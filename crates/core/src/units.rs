//! Quantities with their unit in the type and a checked way in.
//!
//! Numbers enter from wires, files and flags; here they are checked once: they must be finite, and in a range beyond
//! which they make no sense for any simulator, car or track. Everything downstream trusts them.

use std::{fmt, time::Instant};

use serde::{Deserialize, Serialize};

use crate::car::FULL_STEERING_DEG;

/// Metres per second in one mile per hour.
pub const MPS_PER_MPH: f64 = 0.447_04;

/// Metres per second in one kilometre per hour.
pub const MPS_PER_KMH: f64 = 1.0 / 3.6;

/// How pure code gets the time: it is handed in, as `Instant::now` in the program and as a frozen clock in tests.
pub type Clock = fn() -> Instant;

/// A number that is not a value of its quantity.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("expected {quantity} from {min} to {max}{unit}, got {got:?}")]
pub struct OutOfRange {
    /// What the number should be, with its article.
    pub quantity: &'static str,
    /// Unit of the bounds and of `got`, after a space.
    pub unit: &'static str,
    /// Smallest value allowed.
    pub min: f64,
    /// Largest value allowed.
    pub max: f64,
    /// The offending number, possibly not finite.
    pub got: f64,
}

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $quantity:literal, $unit:literal, $min:expr, $max:expr) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default, Serialize, Deserialize)]
        #[serde(try_from = "f64", into = "f64")]
        pub struct $name(f64);

        impl $name {
            /// Smallest value.
            pub const MIN: Self = Self($min);
            /// Largest value.
            pub const MAX: Self = Self($max);
            /// Zero.
            pub const ZERO: Self = Self(0.0);

            /// Checks the number.
            ///
            /// # Errors
            /// [`OutOfRange`] if it is not finite or outside the quantity's range.
            pub fn new(value: f64) -> Result<Self, OutOfRange> {
                // Written so that NaN fails.
                if (Self::MIN.0..=Self::MAX.0).contains(&value) {
                    Ok(Self(value + 0.0)) // -0 becomes 0
                } else {
                    Err(OutOfRange { quantity: $quantity, unit: $unit, min: $min, max: $max, got: value })
                }
            }

            /// A value written in the source; one out of range does not compile.
            pub const fn constant(value: f64) -> Self {
                assert!(value >= $min && value <= $max);
                Self(value)
            }

            /// The nearest value of the quantity; NaN becomes zero.
            pub fn saturating(value: f64) -> Self {
                if value.is_nan() { Self::ZERO } else { Self(value.clamp(Self::MIN.0, Self::MAX.0) + 0.0) }
            }

            /// The bare number, in the quantity's unit.
            pub const fn get(self) -> f64 {
                self.0
            }
        }

        impl schemars::JsonSchema for $name {
            fn schema_name() -> std::borrow::Cow<'static, str> {
                stringify!($name).into()
            }

            fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
                schemars::json_schema!({ "type": "number", "minimum": $min, "maximum": $max })
            }
        }

        impl TryFrom<f64> for $name {
            type Error = OutOfRange;
            fn try_from(value: f64) -> Result<Self, OutOfRange> {
                Self::new(value)
            }
        }

        impl From<$name> for f64 {
            fn from(value: $name) -> f64 {
                value.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(&self.0, f)?;
                f.write_str($unit)
            }
        }
    };
}

quantity! {
    /// Speed in miles per hour, as the simulator reports it. The car reaches 30; 1000 is beyond any fork's.
    Mph, "a speed", " mph", -1000.0, 1000.0
}
quantity! {
    /// Speed in metres per second.
    MetresPerSecond, "a speed", " m/s", -447.04, 447.04
}
quantity! {
    /// An angle in degrees; a steering angle is positive to the right.
    Degrees, "an angle", " degrees", -360.0, 360.0
}
quantity! {
    /// A length or a coordinate in metres.
    Metres, "a length", " m", -1.0e6, 1.0e6
}
quantity! {
    /// Normalised steering: -1 full left, 1 full right, times [`FULL_STEERING_DEG`].
    Steering, "a steering command", "", -1.0, 1.0
}
quantity! {
    /// Normalised throttle: 1 full power, negative brakes (below 5 mph: reverses).
    Throttle, "a throttle", "", -1.0, 1.0
}

impl Mph {
    /// The same speed in metres per second.
    pub fn metres_per_second(self) -> MetresPerSecond {
        MetresPerSecond::saturating(self.0 * MPS_PER_MPH)
    }
}

impl MetresPerSecond {
    /// The same speed in miles per hour.
    pub fn mph(self) -> Mph {
        Mph::saturating(self.0 / MPS_PER_MPH)
    }
}

impl Steering {
    /// The angle of the front wheels that this command asks for.
    pub fn degrees(self) -> Degrees {
        Degrees::saturating(self.0 * FULL_STEERING_DEG)
    }
}

impl Degrees {
    /// The command that asks for this steering angle, saturated at full lock.
    pub fn steering(self) -> Steering {
        Steering::saturating(self.0 / FULL_STEERING_DEG)
    }
}

/// A point of the line to drive, in the car's own frame: the origin is the car's, its nose points ahead.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PathPoint {
    /// Metres ahead of the car's origin.
    pub ahead_m: f64,
    /// Metres to the right of it.
    pub right_m: f64,
    /// How the line bends there: 1/m, positive to the right.
    pub curvature_per_m: f64,
}

/// What a fork means by `speed`: the stock build mph, some `pos_x` forks metres per second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum SpeedUnit {
    /// Miles per hour.
    #[default]
    #[serde(rename = "mph")]
    Mph,
    /// Metres per second.
    #[serde(rename = "m/s")]
    MetresPerSecond,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_outside_the_range_names_quantity_range_and_number() {
        let error = Steering::new(1.5).unwrap_err();
        assert_eq!(error.to_string(), "expected a steering command from -1 to 1, got 1.5");
        assert!(Mph::new(f64::NAN).is_err());
        assert!(Mph::new(f64::INFINITY).is_err());
    }

    #[test]
    fn saturation_keeps_to_the_range_and_turns_nan_into_nought() {
        assert_eq!(Throttle::saturating(7.0), Throttle::MAX);
        assert_eq!(Throttle::saturating(f64::NEG_INFINITY), Throttle::MIN);
        assert_eq!(Throttle::saturating(f64::NAN), Throttle::ZERO);
    }

    #[test]
    fn full_steering_is_25_degrees() {
        assert_eq!(Steering::MAX.degrees().get(), 25.0);
        assert_eq!(Degrees::new(-12.5).unwrap().steering().get(), -0.5);
        assert_eq!(Degrees::new(40.0).unwrap().steering(), Steering::MAX);
    }

    #[test]
    fn one_mile_per_hour_is_0_44704_metres_per_second() {
        assert_eq!(Mph::new(1.0).unwrap().metres_per_second().get(), 0.447_04);
        assert!((MetresPerSecond::new(13.4112).unwrap().mph().get() - 30.0).abs() < 1e-12);
    }

    #[test]
    fn negative_nought_is_nought() {
        assert!(Steering::new(-0.0).unwrap().get().is_sign_positive());
    }
}
