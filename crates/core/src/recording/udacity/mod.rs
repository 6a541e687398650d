//! Udacity's own data sets: a folder with `driving_log.csv` and the pictures in `IMG`.
//!
//! The simulator writes the log without a header, with absolute paths of the machine it ran on and in the number format
//! of the player's locale; people then move, join and edit it. All of that is read, each line on its own, so that logs
//! joined from several sources read too:
//!
//! - with or without a header, which then gives the order of the columns (`center`, `left`, `right`, `steering`,
//!   `throttle`, `brake`, `speed`; others are ignored); each part of a joined log may have its own;
//! - `,` or `, ` between the fields, with or without quotes; LF, CRLF or CR; with
//!   or without a byte order mark and a final newline;
//! - any path of Windows, macOS or Linux, or none: only the file name counts, and it is looked up in `IMG` beside the
//!   log, or beside the log itself where there is no `IMG`. Only if there is no such file, but there is one at the
//!   path in the log (from the log's folder, if it is relative), is that one used: so a log can refer to pictures
//!   elsewhere;
//! - decimal points and decimal commas, also where they are mixed up with the commas between fields.
//!
//! Pictures are opened on request ([`Row::jpeg`]), and need not exist.
//!
//! [`DrivingLogWriter`] writes such folders, exactly as the simulator's recorder does.

mod line;
mod writer;

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use bytes::Bytes;
use jiff::{
    Timestamp,
    civil::{Date, DateTime, Time},
    tz::TimeZone,
};

use self::line::{Bad, Column, Columns};
pub use self::writer::{DrivingLogWriter, NewRow};
use super::{Break, CommandRecord, Item, RecordingError, RunHeader, RunKind, read_file, read_picture, with_newlines};
use crate::{
    protocol::{CameraImage, Telemetry, Truth},
    units::{Mph, Steering, Throttle},
};

/// What the log in a folder is called.
pub const LOG_NAME: &str = "driving_log.csv";
/// The name of the folder of pictures beside it.
pub const IMAGES: &str = "IMG";

/// Time between two rows whose picture names hold no time: the simulator records 15 times a second at most.
pub const FALLBACK_INTERVAL: Duration = Duration::from_nanos(1_000_000_000 / 15);

/// Key of a run's settings, where it was made from a log: how many of the rows were [untimed](DrivingLog::untimed).
pub(super) const UNTIMED: &str = "untimed";

/// The longest log that is read, in bytes: a week's driving.
const MOST_LOG: u64 = 1 << 30;

/// A driving log, read whole.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivingLog {
    /// The CSV file.
    pub path: PathBuf,
    /// Its rows, in its order; at least one.
    pub rows: Vec<Row>,
}

/// One moment of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Line in the CSV file, counted from 1.
    pub line: usize,
    /// Time since the first row, by the pictures' names. If a name holds no time, or the row does not continue from the
    /// one before, [`FALLBACK_INTERVAL`] passes.
    pub at: Duration,
    /// Why it does not continue from the row before, by the times in the pictures' names.
    pub broken: Option<Break>,
    /// Picture of the centre camera.
    pub center: PathBuf,
    /// Picture of the left camera.
    pub left: Option<PathBuf>,
    /// Picture of the right camera.
    pub right: Option<PathBuf>,
    /// Steering in effect.
    pub steering: Steering,
    /// Throttle in effect.
    pub throttle: Throttle,
    /// Brake in effect, 0 to 1.
    pub brake: f64,
    /// Speed.
    pub speed: Mph,
    /// Local time of the picture, to the millisecond, from its name: `center_2018_07_16_17_11_43_382.jpg`.
    pub taken_at: Option<DateTime>,
}

impl DrivingLog {
    /// Reads a log: a CSV file, or the `driving_log.csv` of a folder.
    ///
    /// # Errors
    /// [`RecordingError::NoSource`], [`RecordingError::Io`], [`RecordingError::Log`]
    /// with the line and field that cannot be read, [`RecordingError::NoRows`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let none = |got: &str| RecordingError::NoSource { path: path.to_owned(), got: got.to_owned() };
        let is_there = |path: &Path| path.try_exists().map_err(RecordingError::io("read the driving log", path));
        let path = match path.is_dir().then(|| path.join(LOG_NAME)) {
            Some(log) if !is_there(&log)? => {
                let runs = super::recordings_in(path).is_ok_and(|inside| !inside.is_empty());
                if runs {
                    return Err(none("a folder of runs: name the runs in it"));
                }
                let told = super::instead_of_recordings(path);
                return Err(none(told.as_deref().unwrap_or("a folder without one")));
            }
            Some(log) => log,
            None if !is_there(path)? => return Err(none("nothing: no such file or folder")),
            None => path.to_owned(),
        };
        let bytes =
            read_file(&path, "a driving log", MOST_LOG).map_err(RecordingError::io("read the driving log", &path))?;
        let beside = path.parent().unwrap_or(Path::new(""));
        let images = images_beside(beside);
        let folders = Folders { log: beside, images: images.as_deref().unwrap_or(beside) };
        // Only folders have names in encodings other than UTF-8, and folders do not matter.
        let text = if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
            Err((1, Bad::utf_16()))
        } else {
            Ok(with_newlines(String::from_utf8_lossy(&bytes)))
        };
        let rows = text.and_then(|text| read(&text, folders)).map_err(|(line, bad)| RecordingError::Log {
            path: path.clone(),
            line,
            field: bad.field,
            expected: bad.expected.chars().take(200).collect(), // a header may name any number of columns
            got: bad.got.chars().take(120).collect(),
            help: bad.help,
        })?;
        if rows.is_empty() { Err(RecordingError::NoRows { path }) } else { Ok(Self { path, rows }) }
    }
}

/// The folder of pictures beside a log. Archives and tools that copy may have renamed it to `img`.
pub(super) fn images_beside(folder: &Path) -> Option<PathBuf> {
    let exact = folder.join(IMAGES);
    if exact.is_dir() {
        return Some(exact);
    }
    let is_like =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.eq_ignore_ascii_case(IMAGES)) && path.is_dir();
    fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path()).filter(is_like).min()
}

impl DrivingLog {
    /// The header of a run made from it, which also says how many rows are [`untimed`](Self::untimed), if any.
    pub fn header(&self) -> RunHeader {
        let mut config = serde_json::json!({ "converted_from": LOG_NAME });
        if let untimed @ 1.. = self.untimed() {
            config[UNTIMED] = untimed.into();
        }
        RunHeader::new(RunKind::DrivingLog, config, self.started())
    }

    /// How many rows have a time that is assumed: the names of their pictures hold none, and neither do those of the row before
    /// or behind, so that [`FALLBACK_INTERVAL`] is taken to lie between. What depends on how fast time passed cannot be told of
    /// them.
    pub fn untimed(&self) -> usize {
        // A row with a time and one without do not continue from one another.
        let stretches = self.rows.chunk_by(|_, next| next.broken.is_none());
        stretches.filter(|rows| rows.len() > 1 && rows[0].taken_at.is_none()).map(<[Row]>::len).sum()
    }

    /// When the first picture was taken, by its name in local time; otherwise, when the log was last written.
    fn started(&self) -> Timestamp {
        let named = self.rows.first().and_then(|row| row.taken_at);
        let named = named.and_then(|taken| taken.to_zoned(TimeZone::system()).ok()).map(|taken| taken.timestamp());
        let written = || fs::metadata(&self.path).and_then(|m| m.modified()).ok().and_then(|t| t.try_into().ok());
        named.or_else(written).unwrap_or(Timestamp::UNIX_EPOCH)
    }
}

impl Row {
    /// The bytes of the centre camera's picture.
    ///
    /// # Errors
    /// [`RecordingError::Picture`] if it cannot be read, or is not a JPEG.
    pub fn jpeg(&self) -> Result<Bytes, RecordingError> {
        let wrong = |why: String| RecordingError::Picture { path: self.center.clone(), why };
        let bytes = read_picture(&self.center).map_err(|e| wrong(e.to_string()))?;
        let got = match &bytes[..] {
            [0xff, 0xd8, ..] => return Ok(bytes),
            [] => "an empty file",
            [0x89, b'P', b'N', b'G', ..] => "a PNG: convert it",
            _ => "another kind of file",
        };
        Err(wrong(format!("expected a JPEG, got {got}")))
    }

    /// The row as telemetry, as a simulator would send it.
    pub fn telemetry(&self) -> Telemetry {
        Telemetry {
            steering: self.steering.degrees(),
            throttle: self.throttle,
            speed: self.speed,
            image: CameraImage::default(),
            truth: Truth { brake: Some(self.brake), ..Truth::default() },
        }
    }

    /// The row as a command: a human drove.
    pub fn command(&self) -> CommandRecord {
        CommandRecord::of_human(self.steering, Throttle::saturating(self.throttle.get() - self.brake))
    }

    /// The row as items of a run, all at its time: a break from the row before, if there is one, then the rest.
    pub fn items(&self, jpeg: Option<Bytes>) -> impl Iterator<Item = Item> {
        let broken = self.broken.map(|broken| Item::Event(broken.event()));
        let (telemetry, command) = (Item::Telemetry(self.telemetry()), Item::Command(self.command()));
        [broken, Some(telemetry), jpeg.map(Item::Frame), Some(command)].into_iter().flatten()
    }
}

/// Where a log and its pictures are.
#[derive(Clone, Copy)]
struct Folders<'a> {
    log: &'a Path,
    images: &'a Path,
}

/// The rows of a log's text; an error comes with its line.
fn read(text: &str, folders: Folders<'_>) -> Result<Vec<Row>, (usize, Bad)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text.lines().enumerate().map(|(i, line)| (i + 1, line)).filter(|(_, l)| !l.trim().is_empty());
    let Some(first) = lines.clone().next() else { return Ok(Vec::new()) };
    let mut layout = match Columns::from_header(first.1).map_err(|bad| (first.0, bad))? {
        Some(layout) => {
            lines.next();
            layout
        }
        None => Columns::default(),
    };
    let mut rows: Vec<Row> = Vec::new();
    for (number, line) in lines {
        let mut row = match row(&layout, line, folders) {
            Ok(row) => row,
            // A log is joined here that has a header, too.
            Err(bad) => match Columns::from_header(line) {
                Ok(Some(next)) => {
                    layout = next;
                    continue;
                }
                _ => return Err((number, bad)),
            },
        };
        row.line = number;
        if let Some(previous) = rows.last() {
            row.broken = Break::between(previous.taken_at, row.taken_at);
            let passed = interval(previous.taken_at, row.taken_at).filter(|_| row.broken.is_none());
            row.at = previous.at + passed.unwrap_or(FALLBACK_INTERVAL);
        }
        rows.push(row);
    }
    Ok(rows)
}

fn row(layout: &Columns, line: &str, folders: Folders<'_>) -> Result<Row, Bad> {
    let fields = layout.fields(line)?;
    let image = |column: Column| match fields.get(column) {
        None | Some("") => Ok(None),
        Some(written) => line::file_name(written).map(|name| Some((name, written))).ok_or_else(|| Bad {
            field: column.to_string(),
            expected: "the name of a picture (.jpg, .jpeg or .png)".into(),
            got: written.into(),
            help: "columns are center, left, right, steering, throttle, brake, speed unless a header says otherwise",
        }),
    };
    let (name, written) = image(Column::Center)?.ok_or_else(|| Bad {
        field: Column::Center.to_string(),
        expected: "the name of a picture".into(),
        got: String::new(),
        help: "remove the line, it has no picture",
    })?;
    let resolve = |(name, written): (&str, &str)| {
        let beside = folders.images.join(name);
        // An absolute path replaces the folder. Most paths are those of another system, and need no look at the disk.
        let is_ours = Path::new(written).is_absolute() || (written.contains('/') && !written.contains([':', '\\']));
        let elsewhere = || folders.log.join(written);
        match is_ours && !beside.is_file() && elsewhere().is_file() {
            true => elsewhere(),
            false => beside,
        }
    };
    Ok(Row {
        line: 0,
        at: Duration::ZERO,
        broken: None,
        taken_at: taken_at(name),
        center: resolve((name, written)),
        left: image(Column::Left)?.map(resolve),
        right: image(Column::Right)?.map(resolve),
        steering: fields.quantity(Column::Steering, Steering::new)?,
        throttle: fields.quantity(Column::Throttle, Throttle::new)?,
        // The brake has no type of its own; it is a throttle that cannot be negative.
        brake: fields.quantity(Column::Brake, line::brake)?,
        speed: fields.quantity(Column::Speed, Mph::new)?,
    })
}

/// The time that passed, if both rows have one.
fn interval(from: Option<DateTime>, to: Option<DateTime>) -> Option<Duration> {
    Duration::try_from(to?.duration_since(from?)).ok()
}

/// The time in a picture's name: its last seven numbers, year to millisecond.
fn taken_at(name: &str) -> Option<DateTime> {
    let (stem, _) = name.rsplit_once('.')?;
    let mut parts = stem.rsplit('_');
    let mut part = || parts.next()?.parse::<i16>().ok();
    let (ms, s, min, h, d, m, y) = (part()?, part()?, part()?, part()?, part()?, part()?, part()?);
    let small = |n: i16| i8::try_from(n).ok();
    let date = Date::new(y, small(m)?, small(d)?).ok()?;
    let nanosecond = i32::from(ms).checked_mul(1_000_000)?;
    Some(DateTime::from_parts(date, Time::new(small(h)?, small(min)?, small(s)?, nanosecond).ok()?))
}

#[cfg(test)]
mod tests;
