//! Recordings on disk: one drive is one run, an MCAP file, written while driving and read back for scoring and replay;
//! and Udacity's own folders, read as they are and written.
//!
//! [`Recording::open`] takes either and yields [`Moment`]s: the time, what was seen and reported, what was steered and
//! by whom, what happened before, and, if a moment does not continue from the one before, why ([`Break`]). Scoring,
//! training, inspection, replay and driving along all read these, and need not know what kind of recording it is.
//!
//! ```text
//! run (.mcap) ─▶ RunReader: items ─▶ Entries: steps and events ─┐
//!                                                               ├▶ Recording: moments
//! folder, CSV ─▶ DrivingLog: rows ──────────────────────────────┘
//! ```
//! A [`Recorder`] takes [`Item`]s from the driving loop and never blocks it; its own thread writes them. A [`RunFile`]
//! takes them from a world that can wait, and gives the same bytes for the same items. A
//! [`RunReader`] yields the same items again; of a file cut off by a crash, those up to the last whole chunk.
//! [`Entries`] joins each telemetry with its picture and its answer. [`udacity`] reads `driving_log.csv` in all the
//! shapes that simulators, locales and scripts leave it in, and writes it as the simulator's own recorder does.
//!
//! Nothing here decodes a picture, judges a run or knows a model: frames are JPEG bytes as received.
//!
//! # How to read more
//! **Another simulator's messages** do not concern recordings: [`protocol`](crate::protocol), which defines the
//! [`Dialect`](crate::protocol::Dialect)s, turns them into [`Telemetry`](crate::protocol::Telemetry), and a run holds
//! that. A new number becomes an optional field of [`Truth`](crate::protocol::Truth) with `#[serde(default)]`, so that
//! earlier runs read as before.
//!
//! **Another dialect of the driving log** belongs in `udacity::line`: a column is a `Column` with its name in headers,
//! its range, and a field of [`udacity::Row`]; `join_numbers` decides how numbers are written. Every log of
//! `tests/driving_logs.rs` must read as before.
//!
//! **Another kind of recording** (a bag, a folder of another recorder) is a third source in `open`: recognise its paths
//! beside `is_run`, make a [`RunHeader`] with a [`RunKind`] of its own, and yield moments. It fills in
//!
//! - the time since the beginning, without any time that is left out, and the local time if it is known;
//! - where each picture's bytes are, which are read only on request, or that it is not recorded;
//! - the telemetry, and the command with who decided it: [`Moment::steering`] follows from that;
//! - each [`Break`], by [`LONGEST_GAP`] if only the clock shows it.
//!
//! For scoring it yields the same as items ([`Recording::next_item`]), with an [`EventRecord::Break`] at each break.
//!
//! # The run file
//! | what | where | form |
//! |---|---|---|
//! | how the run was made | metadata `lapwing.run`, the file's first record after its header | [`RunHeader`] as text |
//! | the picture | `/camera/center` | protobuf `foxglove.CompressedImage` |
//! | what the simulator reported | `/telemetry` | JSON, [`Telemetry`](crate::protocol::Telemetry) |
//! | the answer | `/command` | JSON, [`CommandRecord`] |
//! | what else happened | `/event` | JSON, [`EventRecord`] |
//! | the events in words | `/log` | protobuf `foxglove.Log` |
//! | where the car is | `/tf` | protobuf `foxglove.FrameTransform` |
//! | the road and the car, once | `/scene` | protobuf `foxglove.SceneUpdate` |
//! | what was counted | metadata `lapwing.summary`, after a clean end only | numbers as text |
//!
//! The last three are for viewers and are not read back. [`Messages`] makes all of them, for a file as for those who look
//! on while it is driven.
//!
//! A message's log time is the wall clock at the run's start plus the time
//! since then, so it never jumps with the wall clock.

use std::{
    borrow::Cow,
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
mod keys;
mod messages;
mod moment;
mod open;
mod queue;
mod reader;
mod recorder;
mod run_file;
mod scene;
mod schema;
pub mod udacity;
mod writer;

pub use entries::{Entries, Entry, Step};
pub use format::{Channel, FORMAT_VERSION, Schema};
pub use items::{Item, ModelId, RunHeader, RunKind};
pub use keys::{ReleasedAtOnce, released_at_once};
pub use messages::{EncodeError, Encoded, Messages};
pub use moment::{Break, CameraPosition, LONGEST_GAP, Moment, Picture};
pub use open::{Recording, folders_with_recordings, instead_of_recordings, is_run_name, recordings_in};
pub use reader::{RunReader, Truncation};
pub use recorder::{Recorder, RecorderOptions, RecorderStatus, RecordingReport};
pub use run_file::RunFile;
pub use scene::Roadway;

pub use crate::turn::{By, CommandRecord, EventRecord};

/// The longest picture that is read, in bytes, from a file or a run. The stock simulator's take about 12 kB.
pub const MOST_PICTURE: usize = 16 << 20;

/// What happened to a run that is not there any more.
const GONE: &str = "it was deleted or moved away while it was recorded";

/// Why a run or a data set cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// An error of the file system.
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
    #[error("{}: the rest of the run is not recorded: {source}", path.display())]
    Write {
        /// The run's file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// There is no file of the run's name any more.
    #[error("{}: the run is gone: {GONE}", path.display())]
    Gone {
        /// The file that there was.
        path: PathBuf,
    },
    /// Not an MCAP file at all.
    #[error("{}: expected a run (an MCAP file), got {got}", path.display())]
    NotARun {
        /// The file.
        path: PathBuf,
        /// What it is instead, and what to do about it.
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
    /// The folder to record into already has a driving log.
    #[error("{}: there is a driving log already; nothing is overwritten: choose another folder", path.display())]
    LogExists {
        /// The CSV file.
        path: PathBuf,
    },
    /// A folder whose path cannot be written in a driving log.
    #[error(
        "{:?}: expected a folder with a path in UTF-8 without quotes or line breaks, because a driving log cannot hold any other",
        path
    )]
    LogFolder {
        /// The folder.
        path: PathBuf,
    },
    /// A picture that cannot be read.
    #[error("{} cannot be read: {why}; `lapwing dataset inspect --json` lists every such picture", path.display())]
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
        got: String,
    },
    /// A driving log without a row.
    #[error("{}: expected rows of a driving log, got none", path.display())]
    NoRows {
        /// The CSV file.
        path: PathBuf,
    },
}

/// Reads a picture's file, or fails at once if the path leads to anything else.
///
/// # Errors
/// The system's; also for anything but a file (a device or a pipe would be read forever), or a file longer than
/// [`MOST_PICTURE`].
pub fn read_picture(path: &Path) -> io::Result<Bytes> {
    read_file(path, "a picture", MOST_PICTURE as u64).map(Bytes::from)
}

/// The text of a table with each line ended by a newline: some programs still end it by a carriage return alone. CRLF stays, and so
/// does the text unless it has such lines.
pub fn with_newlines(text: Cow<'_, str>) -> Cow<'_, str> {
    let ends_a_line = |(at, _): (usize, &str)| !text[at + 1..].starts_with(['\r', '\n']);
    if text.match_indices('\r').any(ends_a_line) {
        text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace('\r', "\n").into()
    } else {
        text
    }
}

/// Reads a regular file of at most `most` bytes.
fn read_file(path: &Path, what: &str, most: u64) -> io::Result<Vec<u8>> {
    let wrong = |why: String| Err(io::Error::new(io::ErrorKind::InvalidData, why));
    // Checked before it is opened: opening a pipe waits for its other end.
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
