//! Who says a steering angle for a frame.
//!
//! [`load`] reads a file, [`built_in`] the shipped one, into a [`Model`], of which any number of independent
//! pilots drive with the same weights, each on a thread of its own if need be.
//! A [`Pilot`] takes a decoded frame and answers with a [`Prediction`]: what the
//! network said, unclamped, and how long it took. What is made of it, throttle
//! included, is `control`'s and `driver`'s.

mod constant;
mod error;
mod model;
pub mod network;
pub mod torchscript;

use std::time::Duration;

pub use constant::ConstantPilot;
pub use error::PilotError;
pub use model::{Model, built_in, load};

use crate::{perception::Frame, units::Mph};

/// What a pilot says for one frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Prediction {
    /// Normalised steering, positive to the right: finite, but beyond -1 and 1 where the network goes there.
    pub steering: f64,
    /// From the frame to a network's input.
    pub preprocess: Duration,
    /// From the input to the answer.
    pub forward: Duration,
}

/// Says a steering angle for a frame.
///
/// A pilot may remember earlier frames; one pilot drives one car. It learns the
/// time from the [`Clock`](crate::units::Clock) it was made with, and only to
/// measure itself.
pub trait Pilot: Send {
    /// The steering for what the car sees now, at the speed it has now.
    ///
    /// # Errors
    /// [`PilotError`] where the frame does not suit the pilot or the network has no finite answer.
    fn steer(&mut self, frame: &Frame, speed: Mph) -> Result<Prediction, PilotError>;

    /// Forgets all frames seen: another run begins.
    fn reset(&mut self);
}
