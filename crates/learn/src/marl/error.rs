//! Why agents cannot learn or drive.

use std::{
    fmt::Display,
    path::{Path, PathBuf},
};

use crate::{nn::NnError, train::TrainError};

/// Why a training or a policy fails.
#[derive(Debug, thiserror::Error)]
pub enum MarlError {
    /// An error of the file system.
    #[error("cannot {doing} {}: {source}", path.display())]
    Io {
        /// What was tried, a verb with its object.
        doing: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file that is not what it should be.
    #[error("{}: {why}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What was expected and found.
        why: String,
    },
    /// A recipe that is none, or has a key that nothing reads.
    #[error("{}: {why}", path.display())]
    Recipe {
        /// The file.
        path: PathBuf,
        /// What was expected and found.
        why: String,
    },
    /// A setting with an invalid value.
    #[error("{name}: expected {expected}, got {got}")]
    Setting {
        /// Which.
        name: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
    /// The loss is no longer a number.
    #[error("the loss became {loss} in update {update}: lower the learning rate (now {rate})")]
    NotFinite {
        /// What it became.
        loss: f64,
        /// Which update, from 1.
        update: u64,
        /// Learning rate in it.
        rate: f64,
    },
    /// A network's tensor in a file.
    #[error(transparent)]
    Network(#[from] NnError),
    /// The optimiser.
    #[error(transparent)]
    Optimiser(#[from] TrainError),
}

impl MarlError {
    /// For `map_err`.
    pub(super) fn io(doing: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::Io { doing, path: path.to_owned(), source }
    }
}

impl From<tch::TchError> for MarlError {
    fn from(error: tch::TchError) -> Self {
        Self::Network(error.into())
    }
}

/// Checks some settings, each with its name, that must all be as expected; the error is about the first that is not.
pub(super) fn expect<T: Copy + Display>(
    settings: impl IntoIterator<Item = (&'static str, T)>,
    expected: &'static str,
    is_valid: impl Fn(T) -> bool,
) -> Result<(), MarlError> {
    match settings.into_iter().find(|(_, value)| !is_valid(*value)) {
        Some((name, got)) => Err(MarlError::Setting { name, expected, got: got.to_string() }),
        None => Ok(()),
    }
}

/// The same of numbers that must be above zero, and no infinity.
pub(super) fn expect_above_zero(settings: impl IntoIterator<Item = (&'static str, f64)>) -> Result<(), MarlError> {
    expect(settings, "a number above 0", |number| number > 0.0 && number.is_finite())
}
