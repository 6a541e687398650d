//! Recordings on disk: one drive is one run, an MCAP file, written while driving and read back for scoring and replay;
//! and Udacity's own folders, read as they are and written.
//!
//! [`Recording::open`] takes either and yields [`Moment`]s: when, what was seen and told, what was steered and by whom,
//! what happened before, and, where a moment does not go on from the one before, why ([`Break`]). Whoever scores, learns,
//! inspects, replays or drives along reads that and need not know what the recording is.
//!
//! ```text
//! run (.mcap) ─▶ RunReader: items ─▶ Entries: steps and events ─┐
//!                                                               ├▶ Recording: moments
//! folder, CSV ─▶ DrivingLog: rows ──────────────────────────────┘
//! ```
//! A [`Recorder`] takes [`Item`]s from the driving loop and never holds it up; its own thread writes them. A
//! [`RunReader`] yields the same items again, a file cut off by a crash up to its last whole chunk; [`Entries`] joins each
//! telemetry with its picture and its answer. [`udacity`] reads `driving_log.csv` in all the shapes that simulators,
//! locales and scripts leave it in, and writes it as the simulator's own recorder does.
//!
//! Nothing here decodes a picture, judges a run or knows a model: frames are JPEG bytes as received.
//!
//! # To read more
//! **What another simulator reports** is no matter of recordings: it becomes a
//! [`Telemetry`](crate::protocol::Telemetry) in [`protocol`](crate::protocol), where its
//! [`Dialect`](crate::protocol::Dialect) stands, and a run holds that. A number that is new is an optional field of
//! [`Truth`](crate::protocol::Truth) with `#[serde(default)]`, so that earlier runs read as before.
//!
//! **Another dialect of the driving log** is a matter of `udacity::line`: a column is a `Column` with the name that a
//! header calls it by, its range, and a field of [`udacity::Row`]; how numbers are written is decided in `join_numbers`.
//! Every log of `tests/driving_logs.rs` must read as before.
//!
//! **Another kind of recording** (a bag, a folder of another recorder) is a third source in `open`: say in `is_run` and
//! its like what a path leads to, make a [`RunHeader`] with a [`RunKind`] of its own, and yield moments. It fills in
//!
//! - the time since the beginning, which counts no time that is left out, and the local time where it is known;
//! - where each picture's bytes are, read only when they are asked for, or that it is not recorded;
//! - the telemetry, and the command with who decided it: [`Moment::steering`] follows from that;
//! - each [`Break`], by [`LONGEST_GAP`] where only the clock tells.
//!
//! For scoring it says the same as items ([`Recording::next_item`]), with [`EventRecord::Break`] where it is broken.
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
mod entries;
mod format;
mod items;
mod moment;
mod open;
mod queue;
mod reader;
mod recorder;
mod schema;
pub mod udacity;
mod writer;

pub use entries::{Entries, Entry, Step};
pub use format::FORMAT_VERSION;
pub use items::{Item, ModelId, RunHeader, RunKind};
pub use moment::{Break, LONGEST_GAP, Moment, Picture};
pub use open::{Recording, is_run_name, recordings_in};
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
        "{:?}: expected a folder with a path in UTF-8 without quotes or line breaks, because a driving log cannot hold any other",
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
