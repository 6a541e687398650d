//! Driving logs as something to learn from.
//!
//! A [`Source`] is a Udacity folder or a run, row by row. A [`Selection`] says which of its rows, cameras and labels
//! count and how much; [`Samples`] holds the outcome for several sources at once. A [`Loader`] decodes, augments and
//! preprocesses them on threads of its own, a [`Batch`] at a time, in an order that the seed alone decides.
//!
//! Nothing is copied and nothing is changed on disk, and no tensor is made here: `train` does that.

mod augment;
mod loader;
mod samples;
mod source;
mod split;

use std::path::PathBuf;

pub use augment::{Augmentation, Change, Rectangle, Shadow};
pub use loader::{Batch, Cache, Inputs, Loader};
pub use samples::{Balance, Sample, Samples, Selection, Set};
pub use source::{Camera, LONGEST_GAP, Picture, Row, Source};
pub use split::Blocks;

use crate::{
    perception::{ImageError, PreprocessError},
    recording::RecordingError,
};

/// What keeps data from being learnt from.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The driving log or the run.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A picture that is not there or cannot be read.
    #[error("{picture} cannot be read: {why}; `lapwing dataset inspect` lists every such picture")]
    Picture {
        /// The file.
        picture: String,
        /// Why, in the system's words.
        why: String,
    },
    /// A picture that cannot be decoded.
    #[error("{picture}: {why}; `lapwing dataset inspect` lists every such picture")]
    Image {
        /// The file.
        picture: String,
        /// What is wrong with it.
        why: ImageError,
    },
    /// A picture that does not suit the network's preprocessing.
    #[error("{picture}: {why}")]
    Preprocess {
        /// The file.
        picture: String,
        /// What does not suit.
        why: PreprocessError,
    },
    /// Nothing to learn from.
    #[error("{path}: expected rows with pictures and labels, got none", path = path.display())]
    Empty {
        /// The data set.
        path: PathBuf,
    },
    /// A number that makes no sense.
    #[error("{name}: expected {expected}, got {got}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
}

#[cfg(test)]
mod tests;
