//! Runs on disk: one drive is one MCAP file, written while driving and read
//! back for scoring and replay; and Udacity's own folders, read as they are and written.
//!
//! A [`Recorder`] takes [`Item`]s from the driving loop and never holds it up;
//! its own thread writes them. A [`RunReader`] yields the same items again, a
//! file cut off by a crash up to its last whole chunk, and joins them into
//! [`Moment`]s for replay. [`udacity`] reads `driving_log.csv` in all the
//! shapes that simulators, locales and scripts leave it in, and writes it as
//! the simulator's own recorder does.
//!
//! Nothing here decodes a picture, judges a run or knows a model: frames are
//! JPEG bytes as received.
//!
//! # The run file
//! | what | where | form |
//! |---|---|---|
//! | how the run was made | metadata `lapwing.run`, the file's first record after its header | [`RunHeader`] as text |
//! | the picture | `/camera/center` | protobuf `foxglove.CompressedImage` |
//! | what the simulator told | `/telemetry` | JSON, [`Telemetry`](crate::protocol::Telemetry) |
//! | what it was answered | `/command` | JSON, [`CommandRecord`] |
//! | what happened besides | `/event` | JSON, [`EventRecord`] |
//! | what was counted | metadata `lapwing.summary`, after a clean end only | numbers as text |
//!
//! A message's log time is the wall clock at the run's start plus the time
//! since then, so it never jumps with the wall clock.

use std::{
    fs::{self, File},
    io::{self, Read},
    path::{Path, PathBuf},
    time::Duration,
};

use bytes::Bytes;

mod container;
mod format;
mod items;
mod moments;
mod queue;
mod reader;
mod recorder;
mod schema;
pub mod udacity;
mod writer;

pub use format::FORMAT_VERSION;
pub use items::{Item, ModelId, RunHeader, RunKind};
pub use moments::{Moment, Moments, Step};
pub use reader::{RunReader, Truncation};
pub use recorder::{Recorder, RecorderOptions, RecorderStatus, RecordingReport};

pub use crate::turn::{By, CommandRecord, EventRecord};

/// The longest picture that is read, in bytes, from a file or a run. The stock simulator's take some 12 kB.
pub const MOST_PICTURE: usize = 16 << 20;

/// What keeps a run or a data set from being written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file system says no.
    #[error("cannot {doing} {}: {source}", path.display())]
    Io {
        /// What was tried, a verb.
        doing: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The run's file could not be written to its end; what is in it up to then can be read.
    #[error("{}: the run is recorded up to here only: {source}", path.display())]
    Write {
        /// The run's file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Not an MCAP file at all.
    #[error("{}: expected a run (an MCAP file), got {got}", path.display())]
    NotARun {
        /// The file.
        path: PathBuf,
        /// What it is instead, and what to do with such a thing.
        got: &'static str,
    },
    /// An MCAP file that does not say how it was made.
    #[error("{}: expected the metadata record lapwing.run, got none: {why}", path.display())]
    NoHeader {
        /// The file.
        path: PathBuf,
        /// Why it may be missing.
        why: String,
    },
    /// A run of a later Lapwing.
    #[error("{}: expected a run of format version {FORMAT_VERSION} or older, got {got}: update lapwing to read it", path.display())]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its format version.
        got: u32,
    },
    /// A field of `lapwing.run` that cannot be read.
    #[error("{}: {field} in lapwing.run: expected {expected}, got {got:?}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// What it should hold.
        expected: &'static str,
        /// What it holds; empty where it is not there.
        got: String,
    },
    /// A message that does not parse.
    #[error("{}: {channel} at {:.3} s: {why}", path.display(), at.as_secs_f64())]
    Message {
        /// The file.
        path: PathBuf,
        /// The channel's topic.
        channel: String,
        /// Time since the run began.
        at: Duration,
        /// What was expected, and what came.
        why: String,
    },
    /// A field of a driving log that cannot be read.
    #[error("{}, line {line}, {field}: expected {expected}, got {got:?}: {help}", path.display())]
    Log {
        /// The CSV file.
        path: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// Column, or what else the line is judged by.
        field: String,
        /// What should be there.
        expected: String,
        /// What is there, cut to a length fit for a message.
        got: String,
        /// What to do.
        help: &'static str,
    },
    /// A folder that is to be recorded into has a driving log already.
    #[error("{}: expected no driving log yet, got one: nothing is overwritten, choose another folder", path.display())]
    LogExists {
        /// The CSV file.
        path: PathBuf,
    },
    /// A folder whose path cannot stand in a driving log.
    #[error(
        "{:?}: expected a folder with a path in UTF-8 without quotes or line breaks, for no driving log can hold another",
        path
    )]
    LogFolder {
        /// The folder.
        path: PathBuf,
    },
    /// A picture that cannot be read.
    #[error("{} cannot be read: {why}; `lapwing dataset inspect` lists every such picture", path.display())]
    Picture {
        /// The picture.
        path: PathBuf,
        /// What was expected, and what came.
        why: String,
    },
    /// Neither a run nor a data set.
    #[error("{}: expected a run (.mcap), or a folder with driving_log.csv, got {got}", path.display())]
    NoSource {
        /// The path.
        path: PathBuf,
        /// What is there.
        got: &'static str,
    },
    /// A driving log without a row.
    #[error("{}: expected rows of a driving log, got none", path.display())]
    NoRows {
        /// The CSV file.
        path: PathBuf,
    },
}

/// Whether a path is that of a run, by its ending or by being a file that is no CSV; others are Udacity folders.
pub fn is_run(path: &Path) -> bool {
    let ends = |ending: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    ends("mcap") || path.is_file() && !ends("csv")
}

/// The bytes of a picture's file, whatever the path leads to: to a picture, or to an error at once.
///
/// # Errors
/// The system's; and where it is no file (a device or a pipe would be read forever), or one longer than [`MOST_PICTURE`].
pub fn read_picture(path: &Path) -> io::Result<Bytes> {
    read_file(path, "a picture", MOST_PICTURE as u64).map(Bytes::from)
}

/// The bytes of a file that is one, and of at most so many bytes.
fn read_file(path: &Path, what: &str, most: u64) -> io::Result<Vec<u8>> {
    let wrong = |why: String| Err(io::Error::new(io::ErrorKind::InvalidData, why));
    // Before it is opened: to open a pipe waits for its other end.
    let metadata = fs::metadata(path)?;
    if !metadata.is_file() {
        let got = if metadata.is_dir() { "a folder" } else { "a device or a pipe" };
        return wrong(format!("expected {what}, got {got}"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return wrong(format!("expected {what} of at most {most} bytes, got {}", metadata.len()));
    }
    Ok(bytes)
}

impl RecordingError {
    /// For `map_err`.
    fn io(doing: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { doing, path: path.to_owned(), source }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_read_up_to_sixteen_mebibytes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("center.jpg");
        fs::write(&path, b"\xff\xd8").unwrap();
        assert_eq!(read_picture(&path).unwrap(), &b"\xff\xd8"[..]);
        File::create(&path).unwrap().set_len(MOST_PICTURE as u64).unwrap();
        assert_eq!(read_picture(&path).unwrap().len(), MOST_PICTURE);
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let error = read_picture(&path).unwrap_err().to_string();
        assert_eq!(error, "expected a picture of at most 16777216 bytes, got 1099511627776");
        assert_eq!(read_picture(dir.path()).unwrap_err().to_string(), "expected a picture, got a folder");
    }
}
