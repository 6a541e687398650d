//! The interface between a driver and the world that it drives in.

use std::time::Duration;

use super::{Answer, Telemetry, TelemetryError};

/// What a world shows at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Time since the run began.
    pub at: Duration,
    /// What was seen.
    pub sight: Sight,
}

/// What was seen.
#[derive(Debug, Clone, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly every sight is a telemetry; a box would cost an allocation a frame"
)]
pub enum Sight {
    /// A telemetry that could be read; its image may yet be broken.
    Telemetry(Telemetry),
    /// The simulator says that a human drives.
    HumanDrives,
    /// A telemetry that could not be read.
    Unreadable(TelemetryError),
}

/// Something that yields telemetry and takes commands: a recording, the headless simulator.
pub trait World {
    /// Why it cannot continue; [`Infallible`](std::convert::Infallible) if it always can.
    type Error: std::error::Error + Send + Sync + 'static;

    /// The next moment, or `None` at the end.
    ///
    /// # Errors
    /// If the world cannot continue.
    fn observe(&mut self) -> Result<Option<Observation>, Self::Error>;

    /// Takes the answer to the last observation.
    fn apply(&mut self, answer: Answer);

    /// The observation that has waited longest gets no answer: the one that came cannot be read.
    fn unanswered(&mut self) {}
}
