//! Errors that end a training early.

use std::path::PathBuf;

use crate::{dataset::DatasetError, nn::NnError};

/// Why a training failed.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The recipe is not TOML, or has unknown keys.
    #[error("the recipe: {0}")]
    Recipe(String),
    /// A setting with an invalid value.
    #[error("{name}: expected {expected}, got {got}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
    /// The data.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The network or its file.
    #[error(transparent)]
    Network(#[from] NnError),
    /// The weights to start from.
    #[error("pretrained weights {path}: {source}", path = path.display())]
    Pretrained {
        /// Their file.
        path: PathBuf,
        /// What is wrong with them.
        source: NnError,
    },
    /// All labels are the same, or all steer to one side, and no picture is mirrored.
    #[error(
        "expected labels that steer to both sides, got steering from {least:.3} to {most:.3} in {rows} samples: a network would learn to steer only that way; add data, or mirror pictures (augment.flip)"
    )]
    OneSided {
        /// The least.
        least: f64,
        /// The largest.
        most: f64,
        /// Samples.
        rows: usize,
    },
    /// The loss is no longer a number.
    #[error(
        "the loss became {loss} in epoch {epoch}, step {step}: lower the learning rate (now {rate}) or clip gradients (optimiser.clip); the last whole epoch, if there is one, is saved"
    )]
    NotFinite {
        /// What it became.
        loss: f64,
        /// From 1.
        epoch: usize,
        /// From 1.
        step: usize,
        /// Learning rate at that step.
        rate: f64,
    },
    /// The validation error is no longer a number.
    #[error(
        "the validation error became {mse} in epoch {epoch}: lower the learning rate or clip gradients (optimiser.clip); the last whole epoch, if there is one, is saved"
    )]
    Validation {
        /// What it became.
        mse: f64,
        /// From 1.
        epoch: usize,
    },
    /// No memory for a step, or for measuring.
    #[error("not enough memory for a batch of {batch}: use a smaller batch, input or cache (cache_mib): {why}")]
    Memory {
        /// Samples in a step.
        batch: usize,
        /// What the system or libtorch says.
        why: String,
    },
    /// A file of the training's folder.
    #[error("{path}: cannot {doing}: {source}", path = path.display())]
    Io {
        /// What failed.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// There is already a training in that folder.
    #[error("{path} already holds a training: resume it (--resume), or choose another folder", path = .0.display())]
    Exists(PathBuf),
    /// The training in that folder is a different one.
    #[error(
        "{folder} already holds a training with another recipe: {differences}: resume it (--resume alone), or choose another folder",
        folder = folder.display()
    )]
    OtherRecipe {
        /// The training's folder.
        folder: PathBuf,
        /// All that differs, with expected and got.
        differences: String,
    },
    /// The samples are not those that the training in that folder began with.
    #[error(
        "{folder}: the samples have changed since this training began: expected {expected}, got {got}: undo the change, or begin a new training in another folder",
        folder = folder.display()
    )]
    OtherData {
        /// The training's folder.
        folder: PathBuf,
        /// Samples then.
        expected: String,
        /// Samples now.
        got: String,
    },
    /// A checkpoint without a resume state, where one would be written.
    #[error("{path} exists, but without a resume state: nothing is overwritten, choose another folder", path = .0.display())]
    ModelThere(PathBuf),
    /// A resume state of another network, or an unreadable one.
    #[error("{path}: {why}; the training cannot be resumed from it", path = path.display())]
    State {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        why: String,
    },
}

impl TrainError {
    pub(super) fn io<'a>(doing: &'static str, path: &'a std::path::Path) -> impl FnOnce(std::io::Error) -> Self + 'a {
        move |source| Self::Io { doing, path: path.to_owned(), source }
    }

    /// Names the file where the error itself does not.
    pub(super) fn of_pretrained(path: &std::path::Path) -> impl FnOnce(NnError) -> Self + '_ {
        |source| match source {
            NnError::Read { .. } | NnError::NoneFits { .. } => Self::Network(source),
            source => Self::Pretrained { path: path.to_owned(), source },
        }
    }

    /// Reports a lack of memory as such.
    pub(super) fn at_batch(self, batch: usize) -> Self {
        match self {
            Self::Network(NnError::Torch(why))
                if ["memory", "bad_alloc"].iter().any(|w| why.to_lowercase().contains(w)) =>
            {
                Self::Memory { batch, why }
            }
            other => other,
        }
    }
}

impl From<tch::TchError> for TrainError {
    fn from(error: tch::TchError) -> Self {
        Self::Network(error.into())
    }
}
