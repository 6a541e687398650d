//! Data sets: driving logs and runs to train on.
//!
//! A [`Source`] is a Udacity folder or a run, row by row. A [`Selection`] says which of its rows, cameras and labels to
//! use, and with what weight; [`Samples`] holds the result for several sources. A [`Loader`] decodes, augments and
//! preprocesses them on threads of its own, a [`Batch`] at a time, in an order that depends only on the seed.
//!
//! For people, [`inspect()`] reports what is in a data set and decodes every picture, and [`contact_sheet`] and
//! [`steering_chart`] show it; [`convert()`] turns a folder into a run or the other way round; [`divide()`] writes a
//! log of the rows to train on and one of those to validate on, as divided by [`Blocks`]; [`preview()`] shows what
//! augmentation does.
//!
//! | file | holds |
//! |---|---|
//! | `source` | recordings as rows with a label |
//! | `split`, `samples`, `balance` | which rows and cameras count, held out or learnt from, and how often each is drawn |
//! | `lane` | labels from where in its lane the car was |
//! | `places` | where the car was in each row, for pictures of other moments than the row's |
//! | `strip`, `augment` | a picture at the size of the network's input, and how it is changed |
//! | `loader` | batches of numbers, ahead of the training |
//! | `inspect`, `sheet`, `chart`, `preview` | what is in a data set, for people |
//! | `convert`, `divide` | data sets written: a run of a folder, a folder of a run, a log in two |
//!
//! Pictures stay where they are, and no tensor is made here: `train` does that.

mod augment;
mod balance;
mod chart;
mod convert;
mod divide;
#[cfg(test)]
mod fixture;
mod inspect;
mod lane;
mod loader;
mod places;
mod preview;
mod samples;
mod sheet;
mod source;
mod split;
mod strip;

use std::path::PathBuf;

pub use augment::{Augmentation, AugmentationDraw, Rectangle, Shadow};
pub use balance::Balance;
pub use chart::steering_chart;
pub use convert::{Converted, convert};
pub use divide::{Divided, divide};
pub use inspect::{CameraCount, Distribution, Gap, Histogram, Inspection, Intervals, Problem, Size, inspect};
pub use lapwing_core::recording::CameraPosition;
pub use loader::{Batch, Cache, Frames, Inputs, Loader, Numbers, Workers};
pub use preview::preview;
pub(crate) use samples::samples_hash;
pub use samples::{CameraInLane, Label, Sample, Samples, Selection, Set};
pub use sheet::{SHOWN, contact_sheet};
pub use source::{Labelled, Source, check, read};
pub use split::Blocks;

use lapwing_core::{
    perception::{ImageError, PreprocessError},
    recording::RecordingError,
};
use lapwing_sim::locate::LaneTableError;

/// Why data cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The driving log or the run.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The table that says where in its lane the car was.
    #[error(transparent)]
    Lane(#[from] LaneTableError),
    /// A picture that is not there or cannot be read.
    #[error("{picture} cannot be read: {why}; `lapwing dataset inspect --json` lists every such picture")]
    Picture {
        /// The file.
        picture: String,
        /// Why, in the system's words.
        why: String,
    },
    /// A picture that cannot be decoded.
    #[error("{picture}: {why}; `lapwing dataset inspect --json` lists every such picture")]
    Image {
        /// The file.
        picture: String,
        /// What is wrong with it.
        why: ImageError,
    },
    /// A thread that makes batches has failed.
    #[error("a thread that loads pictures failed: {what}")]
    Thread {
        /// Its message.
        what: String,
    },
    /// A picture that does not fit the network's preprocessing.
    #[error("{picture}: {why}")]
    Preprocess {
        /// The file.
        picture: String,
        /// What does not fit.
        why: PreprocessError,
    },
    /// A setting of one data set, with an invalid value.
    #[error("{path}: {name}: expected {expected}, got {got}", path = path.display())]
    Selected {
        /// The data set.
        path: PathBuf,
        /// Which setting.
        name: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
    /// Nothing to work with.
    #[error("{path}: expected rows with pictures and labels, got none", path = path.display())]
    Empty {
        /// The data set.
        path: PathBuf,
    },
    /// Pictures of several sizes.
    #[error("expected pictures of one size, as a network's crop counts their pixels, got {got}: bring all to one size")]
    Sizes {
        /// Each size, and a picture of it.
        got: String,
    },
    /// A data set without any usable row.
    #[error("{path}: expected rows with a picture {aim}, got none of {rows}{}: see `rows`, `cameras` and `blocks`, and `lapwing dataset inspect` for pictures that are missing", told(*blocks), path = path.display())]
    NoneLeft {
        /// The data set.
        path: PathBuf,
        /// How many rows it has.
        rows: usize,
        /// What they are for.
        aim: &'static str,
        /// How rows are held out, if they are.
        blocks: Option<Blocks>,
    },
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
    /// The target already exists.
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
        /// The target.
        path: PathBuf,
        /// What the source can become.
        expected: &'static str,
        /// What the name says.
        got: &'static str,
    },
    /// The work was interrupted.
    #[error("{path}: interrupted; nothing was kept", path = path.display())]
    BrokenOff {
        /// The target.
        path: PathBuf,
    },
    /// A run where only a folder will do.
    #[error("{path}: expected a folder with driving_log.csv, got a run: convert it with `lapwing dataset convert`", path = path.display())]
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
    /// An error of the file system.
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

/// How rows are held out.
fn told(blocks: Option<Blocks>) -> String {
    let how = |Blocks { size, every }| {
        format!(
            " (unless there is separate validation data, the first {size} of every {} rows are held out)",
            size * every
        )
    };
    blocks.map_or_else(String::new, how)
}

#[cfg(test)]
mod tests;
