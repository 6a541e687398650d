//! From steering, speed and a human's hands to throttle. Pure state machines:
//! no clock, no settings file; time since the start of the run is handed in.

mod handover;
mod speed;
mod standstill;

pub use handover::{Change, Handover};
pub use speed::{Pi, PiGains, Quadratic, SpeedController, ThrottleOutput};
pub use standstill::{Speed, Standstill};

use crate::units::Mph;

/// Below this speed the car's brake is its reverse gear (`CarController`: brake torque only above 5 mph).
pub const REVERSES_BELOW: Mph = Mph::constant(5.0);
