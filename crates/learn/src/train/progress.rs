//! The progress of a training, step by step and epoch by epoch, and its result.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{Measured, Metrics};

/// The result of an epoch. A checkpoint contains it, so it must not depend on a clock: the same training gives the same
/// file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Epoch {
    /// From 1.
    pub number: usize,
    /// At its end.
    pub learning_rate: f64,
    /// On the training set, relative to the labels of the augmented pictures, while the weights changed.
    pub training: Metrics,
    /// On the held-out labels, at its end.
    pub validation: Measured,
    /// Whether it is the best so far.
    pub best: bool,
}

/// An epoch and the time it took, as in the log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TimedEpoch {
    /// Its result.
    #[serde(flatten)]
    pub epoch: Epoch,
    /// How long its training took, without validation.
    pub seconds: f64,
    /// Samples a second.
    pub images_per_s: f64,
}

/// An event during training.
#[derive(Debug)]
pub enum Progress<'a> {
    /// A step was taken.
    Step {
        /// From 1.
        epoch: usize,
        /// Steps taken in this epoch.
        step: usize,
        /// Steps of an epoch.
        steps: usize,
        /// Samples of this step.
        samples: usize,
        /// Its mean squared error.
        loss: f64,
    },
    /// An epoch ended.
    Epoch(&'a TimedEpoch),
}

/// Whether to continue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Go {
    /// Yes.
    On,
    /// No: keep what there is and end.
    Stop,
}

/// How a training ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrainOutcome {
    /// The checkpoint.
    pub model: PathBuf,
    /// Its SHA-256.
    pub sha256: String,
    /// The epoch whose weights these are, as the checkpoint says; absent if none was finished.
    pub kept: Option<Epoch>,
    /// Whether all epochs were completed, or patience ended it; otherwise it can be resumed.
    pub finished: bool,
}
