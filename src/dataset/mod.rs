//! Recordings as data sets: looked over, converted, split.
//!
//! [`inspect()`] says what is in a Udacity folder or a run, every picture decoded, and [`contact_sheet`] and
//! [`steering_chart`] show it. [`convert()`] makes the one of the other. [`divide()`] writes a log of the rows to learn
//! from and one of those to validate by, as [`Blocks`] has them; pictures stay where they are.

mod chart;
mod convert;
mod divide;
#[cfg(test)]
mod fixture;
mod inspect;
mod moments;
mod sheet;
mod split;

use std::path::PathBuf;

pub use chart::steering_chart;
pub use convert::{Converted, convert};
pub use divide::{Divided, divide};
pub use inspect::{CameraCount, Gap, Histogram, Inspection, Intervals, LONGEST_GAP, Problem, Size, Spread, inspect};
pub use sheet::{SHOWN, contact_sheet};
pub use split::Blocks;

use crate::recording::RecordingError;

/// What keeps a data set from being read or written.
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
    /// Nothing to work with.
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
    /// Something is where something new is to be written.
    #[error("{path}: expected nothing there yet, got {got}: nothing is overwritten, choose another name", path = path.display())]
    Exists {
        /// The place.
        path: PathBuf,
        /// What is there.
        got: &'static str,
    },
    /// A conversion from a thing to the same thing.
    #[error("{path}: expected the name of {expected}, got that of {got}: a folder becomes a run (.mcap), a run a folder", path = path.display())]
    Target {
        /// Where it was to go.
        path: PathBuf,
        /// What the source can become.
        expected: &'static str,
        /// What the name says.
        got: &'static str,
    },
    /// A run where only a folder will do.
    #[error("{path}: expected a folder with driving_log.csv, got a run: make one of it with `lapwing dataset convert`", path = path.display())]
    Run {
        /// The run.
        path: PathBuf,
    },
    /// A log too short for both halves of a split.
    #[error("{path}: expected rows for training and for validation, got {rows} rows, all of them for {half}: choose smaller blocks", path = path.display())]
    OneHalf {
        /// The log.
        path: PathBuf,
        /// How many rows it has.
        rows: usize,
        /// The only half with rows.
        half: &'static str,
    },
    /// The file system says no.
    #[error("cannot {doing} {path}: {why}", path = path.display())]
    Io {
        /// What was tried, a verb.
        doing: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        why: std::io::Error,
    },
}
