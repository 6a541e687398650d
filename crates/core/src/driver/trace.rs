//! What the driver tells of one answer.

use std::time::Duration;

use bytes::Bytes;

use crate::control::ThrottleOutput;

/// Who made the answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum By {
    /// The pilot.
    #[default]
    Pilot,
    /// The human, at the simulator's keys.
    Human,
    /// The rule for frames that cannot be used.
    Safety,
    /// Nobody: the pilot is off until it is armed.
    Nobody,
}

/// Something worth an event in the run and a line in the log.
#[derive(Debug, Clone, PartialEq)]
pub enum Happening {
    /// The human took over.
    TakeoverBegan,
    /// The human let go.
    TakeoverEnded {
        /// How long the human drove.
        after: Duration,
        /// Whether the pilot now waits to be armed.
        pilot_off: bool,
    },
    /// A frame that could not be used.
    BadFrame {
        /// What was wrong with it.
        why: String,
        /// The how manieth in a row, from 1.
        in_a_row: u32,
    },
    /// Too many bad frames in a row: the car is being stopped.
    BrakingToStandstill,
}

/// What the driver tells of one answer.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// Who made the answer.
    pub by: By,
    /// The JPEG bytes as received, where the base64 could be read.
    pub jpeg: Option<Bytes>,
    /// The pilot's raw output, not clamped.
    pub prediction: Option<f64>,
    /// The speed controller's terms.
    pub throttle: Option<ThrottleOutput>,
    /// Time from base64 to pixels.
    pub decode: Duration,
    /// Time from pixels to the network's input.
    pub preprocess: Duration,
    /// Time of the forward pass.
    pub forward: Duration,
    /// Time of the whole answer.
    pub total: Duration,
    /// What else happened.
    pub happenings: Vec<Happening>,
}
