//! Pilots: they give a steering angle for a frame.
//!
//! A [`Model`] makes any number of independent pilots, each on a thread of its own if need be; `lapwing-learn` reads
//! models from files. A [`Pilot`] takes a [`View`], a decoded frame above all, and answers with a [`Prediction`]: the
//! network's output, unclamped, and how long it took. `control` and `driver` turn that into a command, throttle
//! included.
//!
//! [`PurePursuit`] is the pilot that needs no network and no picture: it follows the line that this project's own
//! worlds report. It is the expert that records training data, and drives the first lap of anyone who has no model yet.

mod constant;
mod error;
mod pure_pursuit;

use std::time::Duration;

pub use constant::ConstantPilot;
pub use error::PilotError;
pub use pure_pursuit::{PurePursuit, Pursuit, PursuitGains};

use crate::{
    perception::Frame,
    units::{Degrees, Mph, PathPoint},
};

/// What a pilot may know of this moment.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The picture; for a pilot that needs none, an earlier or an empty one.
    pub frame: &'a Frame,
    /// The speed now.
    pub speed: Mph,
    /// The line to drive, from beside the car on; empty where the world reports none.
    pub path: &'a [PathPoint],
    /// By what a pilot can tell how late its commands take effect; `None` if it is not to allow for that.
    pub in_effect: Option<InEffect>,
}

/// The steering that was in effect when a picture was taken, and when the picture came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InEffect {
    /// Time since the run began.
    pub at: Duration,
    /// The angle of the front wheels, positive to the right.
    pub steering: Degrees,
}

impl<'a> View<'a> {
    /// A picture seen from a standing car in a world that reports no path.
    pub fn of(frame: &'a Frame) -> Self {
        Self { frame, speed: Mph::ZERO, path: &[], in_effect: None }
    }
}

/// A pilot's output for one frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Prediction {
    /// Normalised steering, positive to the right: finite, but beyond -1 and 1 where the network goes there.
    pub steering: f64,
    /// The highest speed that the pilot allows, if it judges that at all.
    pub speed_limit: Option<Mph>,
    /// How far ahead of its picture the road was shown to the network, because commands take effect late.
    pub ahead: Duration,
    /// From the frame to a network's input.
    pub preprocess: Duration,
    /// From the input to the answer.
    pub forward: Duration,
}

/// Gives a steering angle for what a car sees.
///
/// A pilot may remember earlier frames; one pilot drives one car. It reads the time from the
/// [`Clock`](crate::units::Clock) it was made with, and only to measure itself.
pub trait Pilot: Send {
    /// The steering for what the car sees now, at the speed it has now.
    ///
    /// # Errors
    /// [`PilotError`] if the view does not suit the pilot or the network has no finite answer.
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError>;

    /// Whether it looks at the picture at all; if not, none needs to be decoded.
    fn needs_picture(&self) -> bool {
        true
    }

    /// Forgets all frames seen: another run begins.
    fn reset(&mut self);
}

/// Makes pilots: weights in memory, read once.
pub trait Model: Send + Sync {
    /// What it is and where it comes from, for people.
    fn name(&self) -> &str;

    /// SHA-256 of its file in lower-case hexadecimal; a run names its model by it.
    fn sha256(&self) -> &str;

    /// A new pilot for one car.
    fn pilot(&self) -> Box<dyn Pilot>;
}
