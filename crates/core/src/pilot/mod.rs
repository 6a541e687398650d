//! Pilots: they give a steering angle for a frame.
//!
//! A [`Model`] is that of which any number of independent pilots drive, each on a thread of its own if need be;
//! `lapwing-learn` reads such from files.
//! A [`Pilot`] takes a [`View`], a decoded frame above all, and answers with a [`Prediction`]: what the
//! network said, unclamped, and how long it took. What is made of it, throttle
//! included, is `control`'s and `driver`'s.
//!
//! [`PurePursuit`] is the pilot that needs no network and no picture: it follows the line that a world
//! of our own tells. The expert of recordings, and the first lap of anyone who has no model yet.

mod constant;
mod error;
mod pure_pursuit;

use std::time::Duration;

pub use constant::ConstantPilot;
pub use error::PilotError;
pub use pure_pursuit::{PurePursuit, Pursuit, PursuitGains};

use crate::{
    perception::Frame,
    units::{Mph, PathPoint},
};

/// What a pilot may know of this moment.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The picture. One seen earlier, or none, for a pilot that says it needs no picture.
    pub frame: &'a Frame,
    /// The speed now.
    pub speed: Mph,
    /// The line to drive, from beside the car on; empty where the world reports none.
    pub path: &'a [PathPoint],
}

impl<'a> View<'a> {
    /// A picture seen from a standing car in a world that tells no path.
    pub fn of(frame: &'a Frame) -> Self {
        Self { frame, speed: Mph::ZERO, path: &[] }
    }
}

/// What a pilot says for one frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Prediction {
    /// Normalised steering, positive to the right: finite, but beyond -1 and 1 where the network goes there.
    pub steering: f64,
    /// The fastest that the pilot would be, where it judges that at all.
    pub speed_limit: Option<Mph>,
    /// From the frame to a network's input.
    pub preprocess: Duration,
    /// From the input to the answer.
    pub forward: Duration,
}

/// Says a steering angle for what a car sees.
///
/// A pilot may remember earlier frames; one pilot drives one car. It learns the
/// time from the [`Clock`](crate::units::Clock) it was made with, and only to
/// measure itself.
pub trait Pilot: Send {
    /// The steering for what the car sees now, at the speed it has now.
    ///
    /// # Errors
    /// [`PilotError`] where the view does not suit the pilot or the network has no finite answer.
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError>;

    /// Whether it looks at the picture at all; if not, none need be decoded for it.
    fn needs_picture(&self) -> bool {
        true
    }

    /// Forgets all frames seen: another run begins.
    fn reset(&mut self);
}

/// What pilots are made of: weights in memory, read once.
pub trait Model: Send + Sync {
    /// What it is and where it comes from, for people.
    fn name(&self) -> &str;

    /// SHA-256 of its file in lower-case hexadecimal; a run names its model by it.
    fn sha256(&self) -> &str;

    /// A pilot of its own for one car.
    fn pilot(&self) -> Box<dyn Pilot>;
}
