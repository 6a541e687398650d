//! Guards: they watch the road beside the pilot and say whether an emergency brake is due.
//!
//! ```text
//! Frame, speed, time to collision ─▶ Guard ─▶ value ─▶ EmergencyBrake ─▶ throttle in place of the pilot's
//! ```
//! A [`Guard`] gives one number for what it sees; [`EmergencyBrake`](crate::control::EmergencyBrake) decides by it when
//! to brake and for how long. The [`Driver`](crate::driver::Driver) shows the guard the frame that it decoded for the
//! pilot. `lapwing-learn` reads guards that are networks; [`TimeToCollision`] needs neither network nor picture, but a
//! world that tells the truth.

mod time_to_collision;

use std::time::Duration;

pub use time_to_collision::TimeToCollision;

use crate::{
    control::BrakeLimits,
    perception::{Frame, PreprocessError},
    units::Mph,
};

/// What a guard may know of this moment.
#[derive(Debug, Clone, Copy)]
pub struct Watched<'a> {
    /// The simulator's own time where it tells it, otherwise the time since the run began. If it goes back or leaps,
    /// what was seen before does not lead here.
    pub at: Duration,
    /// The picture; for a guard that needs none, an earlier or an empty one.
    pub frame: &'a Frame,
    /// The speed now.
    pub speed: Mph,
    /// Seconds until the car would hit something, where the world reports it.
    pub time_to_collision_s: Option<f64>,
    /// Metres to what is ahead in the car's way, where the world reports it.
    pub gap_m: Option<f64>,
}

/// Says how much an emergency brake is due.
///
/// A guard may remember earlier frames; one guard watches over one car.
pub trait Guard: Send {
    /// What it is called in the run's events.
    fn name(&self) -> &str;

    /// Above which values the car is braked, and below which no longer.
    fn limits(&self) -> BrakeLimits;

    /// How much an emergency brake is due now, on the guard's own scale; finite. `None` if it has nothing new to say:
    /// it has not seen enough yet, or looks less often than frames come.
    ///
    /// # Errors
    /// [`GuardError`] if it cannot watch. The pilot then drives without it.
    fn watch(&mut self, now: &Watched<'_>) -> Result<Option<f64>, GuardError>;

    /// Whether it looks at the picture at all.
    fn needs_picture(&self) -> bool {
        true
    }

    /// Forgets all that it saw: another run begins, or nothing was seen for a while.
    fn reset(&mut self);
}

/// Makes guards: read once, for any number of cars.
pub trait GuardModel: Send + Sync {
    /// What it is and where it comes from, for people.
    fn name(&self) -> &str;

    /// SHA-256 of its file in lower-case hexadecimal, if it has one.
    fn sha256(&self) -> Option<&str>;

    /// A new guard for one car.
    fn guard(&self) -> Box<dyn Guard>;
}

/// Why a guard cannot watch.
#[derive(Debug, thiserror::Error)]
pub enum GuardError {
    /// A guard that brakes by the time to collision needs to be told it.
    #[error(
        "expected telemetry with a time to collision, got telemetry without it: this guard works with Lapwing's own simulator and a scenario"
    )]
    NoTimeToCollision,
    /// The frame does not fit the preprocessing.
    #[error(transparent)]
    Preprocess(#[from] PreprocessError),
    /// The forward pass fails.
    #[error(transparent)]
    Network(Box<dyn std::error::Error + Send + Sync>),
    /// NaN or infinity.
    #[error("expected a finite value to brake by, got {0}")]
    NotFinite(f64),
}
