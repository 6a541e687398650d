//! Folders and runs as lists of rows.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use bytes::Bytes;
use jiff::civil::DateTime;
use serde::{Deserialize, Serialize};

use super::{DatasetError, LONGEST_GAP};
use lapwing_core::{
    protocol::CameraImage,
    recording::udacity::DrivingLog,
    recording::{By, Moment, RunReader, is_run, read_picture},
    units::{Mph, Steering},
};

/// One of the three cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Camera {
    /// In the middle.
    Center,
    /// 0.8 m to the left.
    Left,
    /// 0.8 m to the right.
    Right,
}

impl Camera {
    /// All of them, as [`Row::pictures`] has them.
    pub const ALL: [Self; 3] = [Self::Center, Self::Left, Self::Right];

    /// Which way a picture of it must be steered beside the centre's label: the left camera's to the right.
    pub fn sign(self) -> f64 {
        match self {
            Self::Center => 0.0,
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }
}

/// Where the bytes of a picture are.
#[derive(Debug, Clone)]
pub enum Picture {
    /// In a file.
    File(PathBuf),
    /// JPEG, as a run holds them.
    Bytes(Bytes),
}

impl Picture {
    /// Its bytes.
    ///
    /// # Errors
    /// [`DatasetError::Picture`] where the file cannot be read.
    pub fn read(&self) -> Result<Bytes, DatasetError> {
        match self {
            Self::File(path) => read_picture(path)
                .map_err(|why| DatasetError::Picture { picture: path.display().to_string(), why: why.to_string() }),
            Self::Bytes(bytes) => Ok(bytes.clone()),
        }
    }

    /// What it is called in messages.
    pub fn name(&self) -> String {
        match self {
            Self::File(path) => path.display().to_string(),
            Self::Bytes(_) => "a picture of the run".into(),
        }
    }
}

/// One moment of a drive, with its label.
#[derive(Debug, Clone)]
pub struct Row {
    /// Time since the first row.
    pub at: Duration,
    /// Pictures in the order of [`Camera::ALL`].
    pub pictures: [Option<Picture>; 3],
    /// What was steered.
    pub steering: Steering,
    /// -1 (full brake) to 1 (full throttle).
    pub acceleration: f64,
    /// How fast the car was.
    pub speed: Mph,
    /// Number of the drive that it belongs to: between two numbers time is missing. A pause longer than
    /// [`LONGEST_GAP`], a clock that goes back (two logs joined), moments of a run that have no picture or no label.
    pub drive: u32,
    /// Number of the stretch within the drive: no sequence of pictures goes over its end. It ends where a camera's
    /// pictures begin or end, and, of rows that are learnt from, where others are that are not.
    pub stretch: u32,
}

/// A data set: the rows of a Udacity folder or of a run.
#[derive(Debug, Clone)]
pub struct Source {
    /// What it was read from.
    pub path: PathBuf,
    /// Its rows in time; at least one.
    pub rows: Vec<Row>,
}

/// Whether there is a data set, as far as can be told before all of it is read.
///
/// # Errors
/// [`DatasetError::Recording`].
pub fn check(path: &Path) -> Result<(), DatasetError> {
    if is_run(path) {
        RunReader::open(path)?;
    } else {
        DrivingLog::open(path)?;
    }
    Ok(())
}

impl Source {
    /// Reads a folder with `driving_log.csv`, such a file, or a run (`.mcap`). Pictures of folders stay where they
    /// are; those of a run are kept in memory as JPEG.
    ///
    /// # Errors
    /// [`DatasetError::Recording`], [`DatasetError::Empty`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, DatasetError> {
        let path = path.as_ref();
        let rows = if is_run(path) { run(path)? } else { folder(path)? };
        if rows.is_empty() {
            return Err(DatasetError::Empty { path: path.to_owned() });
        }
        let mut source = Self { path: path.to_owned(), rows };
        source.end_stretches_where(|_, row| row.pictures.each_ref().map(Option::is_some));
        Ok(source)
    }

    /// Takes out the pictures whose files are not there, and says how many they were.
    pub(super) fn forget_missing(&mut self) -> usize {
        let mut missing = 0;
        for picture in self.rows.iter_mut().flat_map(|row| &mut row.pictures) {
            if matches!(picture, Some(Picture::File(path)) if !path.is_file()) {
                *picture = None;
                missing += 1;
            }
        }
        self.end_stretches_where(|_, row| row.pictures.each_ref().map(Option::is_some));
        missing
    }

    /// Ends each stretch also where neighbours differ in this.
    pub(super) fn end_stretches_where<T: PartialEq>(&mut self, of: impl Fn(usize, &Row) -> T) {
        let mut stretch = 0;
        let mut before: Option<(T, u32, u32)> = None;
        for (i, row) in self.rows.iter_mut().enumerate() {
            let now = (of(i, row), row.drive, row.stretch);
            stretch += u32::from(before.is_some_and(|before| before != now));
            row.stretch = stretch;
            before = Some(now);
        }
    }

    fn one_stretch(&self, i: usize, k: usize) -> bool {
        let (a, b) = (&self.rows[i], &self.rows[k]);
        (a.drive, a.stretch) == (b.drive, b.stretch)
    }

    /// Indices of `count` rows up to and with row `i`, oldest first; the first of a stretch stands for those before it.
    pub fn sequence(&self, i: usize, count: usize) -> impl Iterator<Item = usize> + '_ {
        let first = (0..i).rev().take_while(|k| self.one_stretch(i, *k)).take(count.saturating_sub(1)).last();
        let first = first.unwrap_or(i);
        (0..count).rev().map(move |back| i.saturating_sub(back).max(first))
    }

    /// Mean steering of the `width` rows around row `i` that belong to its drive; `width` is odd.
    pub fn mean_steering(&self, i: usize, width: usize) -> f64 {
        self.mean(i, width, |k| self.rows[k].drive == self.rows[i].drive)
    }

    /// The same of the rows of its stretch alone, in which nothing is that may not be learnt from.
    pub(super) fn mean_of_stretch(&self, i: usize, width: usize) -> f64 {
        self.mean(i, width, |k| self.one_stretch(i, k))
    }

    fn mean(&self, i: usize, width: usize, counts: impl Fn(usize) -> bool) -> f64 {
        let reach = width / 2;
        // Not by way of another drive: what lies behind it is no neighbour.
        let before = (i.saturating_sub(reach)..i).rev().take_while(|k| counts(*k));
        let after = (i..self.rows.len()).take(reach + 1).take_while(|k| counts(*k));
        let all = before.chain(after).map(|k| self.rows[k].steering.get());
        let (sum, count) = all.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0));
        sum / count
    }
}

fn folder(path: &Path) -> Result<Vec<Row>, DatasetError> {
    let mut rows: Vec<Row> = Vec::new();
    let (mut drive, mut last_taken) = (0, None);
    for row in DrivingLog::open(path)?.rows {
        // By the names of the pictures: where they jump, the log's own time goes on as if they had not.
        if !rows.is_empty() && !follows(last_taken, row.taken_at) {
            drive += 1;
        }
        last_taken = row.taken_at;
        rows.push(Row {
            at: row.at,
            pictures: [Some(row.center), row.left, row.right].map(|path| path.map(Picture::File)),
            steering: row.steering,
            acceleration: row.throttle.get() - row.brake,
            speed: row.speed,
            drive,
            stretch: 0,
        });
    }
    Ok(rows)
}

/// Whether the second of two pictures may have been taken right after the first.
fn follows(from: Option<DateTime>, to: Option<DateTime>) -> bool {
    match (from, to) {
        (Some(from), Some(to)) => Duration::try_from(to.duration_since(from)).is_ok_and(|passed| passed <= LONGEST_GAP),
        (None, None) => true,
        _ => false,
    }
}

fn run(path: &Path) -> Result<Vec<Row>, DatasetError> {
    let mut rows: Vec<Row> = Vec::new();
    let (mut drive, mut left_out) = (0, false);
    for moment in RunReader::open(path)?.moments() {
        let Moment::Step(step) = moment? else { continue };
        // What nobody steered is no label.
        let command = step.command.filter(|c| matches!(c.by, By::Pilot | By::Human));
        let (CameraImage::Jpeg(jpeg), true, Some(command)) = (&step.telemetry.image, step.frame_recorded, command)
        else {
            left_out = true;
            continue;
        };
        let paused = rows.last().is_some_and(|last| step.at.saturating_sub(last.at) > LONGEST_GAP);
        if paused || (left_out && !rows.is_empty()) {
            drive += 1;
        }
        left_out = false;
        rows.push(Row {
            at: step.at,
            pictures: [Some(Picture::Bytes(jpeg.clone())), None, None],
            steering: command.steering,
            acceleration: command.throttle.get(),
            speed: step.telemetry.speed,
            drive,
            stretch: 0,
        });
    }
    Ok(rows)
}
