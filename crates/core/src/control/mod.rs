//! From steering, speed and a human's hands to throttle. Pure state machines:
//! no clock, no settings file; time since the start of the run is handed in.

mod emergency;
mod handover;
mod speed;
mod standstill;
mod warned;

pub use emergency::{BrakeChange, BrakeLimits, EmergencyBrake, HELD_S, Release, TIME_TO_COLLISION, TO_FIRE};
pub use handover::{Handover, HandoverChange};
pub use speed::{Pi, PiGains, Quadratic, SpeedController, ThrottleOutput};
pub use standstill::{KnownSpeed, Standstill};
pub use warned::Warned;

use crate::{car, units::Mph};

/// [`car::REVERSES_BELOW_MPH`], as speeds are compared here.
const REVERSES_BELOW: Mph = Mph::constant(car::REVERSES_BELOW_MPH);
