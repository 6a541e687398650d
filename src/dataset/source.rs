//! Folders and runs as lists of rows.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::{DatasetError, LONGEST_GAP, moments::is_run};
use crate::{
    recording::{By, Moment, RunReader, udacity::DrivingLog},
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
            Self::File(path) => fs::read(path)
                .map(Bytes::from)
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
    /// Number of the drive that it belongs to: rows of another number are no neighbours.
    pub drive: u32,
}

/// A data set: the rows of a Udacity folder or of a run.
#[derive(Debug, Clone)]
pub struct Source {
    /// What it was read from.
    pub path: PathBuf,
    /// Its rows in time; at least one.
    pub rows: Vec<Row>,
}

impl Source {
    /// Reads a folder with `driving_log.csv`, such a file, or a run (`.mcap`). Pictures of folders stay where they
    /// are; those of a run are kept in memory as JPEG.
    ///
    /// # Errors
    /// [`DatasetError::Recording`], [`DatasetError::Empty`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, DatasetError> {
        let path = path.as_ref();
        let mut rows = if is_run(path) { run(path)? } else { folder(path)? };
        if rows.is_empty() {
            return Err(DatasetError::Empty { path: path.to_owned() });
        }
        let mut drive = 0;
        for i in 1..rows.len() {
            if rows[i].at.saturating_sub(rows[i - 1].at) > LONGEST_GAP {
                drive += 1;
            }
            rows[i].drive = drive;
        }
        Ok(Self { path: path.to_owned(), rows })
    }

    /// Indices of `count` rows up to and with row `i`, oldest first; the first of a drive stands for those before it.
    pub fn sequence(&self, i: usize, count: usize) -> impl Iterator<Item = usize> + '_ {
        let first = (0..i).rev().take_while(|k| self.rows[*k].drive == self.rows[i].drive).take(count - 1).last();
        let first = first.unwrap_or(i);
        (0..count).rev().map(move |back| i.saturating_sub(back).max(first))
    }

    /// Mean steering of the `width` rows around row `i` that belong to its drive; `width` is odd.
    pub fn mean_steering(&self, i: usize, width: usize) -> f64 {
        let reach = width / 2;
        let around = &self.rows[i.saturating_sub(reach)..(i + reach + 1).min(self.rows.len())];
        let same = around.iter().filter(|row| row.drive == self.rows[i].drive);
        let (sum, count) = same.fold((0.0, 0.0), |(sum, count), row| (sum + row.steering.get(), count + 1.0));
        sum / count
    }
}

fn folder(path: &Path) -> Result<Vec<Row>, DatasetError> {
    let rows = DrivingLog::open(path)?.rows;
    Ok(rows
        .into_iter()
        .map(|row| Row {
            at: row.at,
            pictures: [Some(row.center), row.left, row.right].map(|path| path.map(Picture::File)),
            steering: row.steering,
            acceleration: row.throttle.get() - row.brake,
            speed: row.speed,
            drive: 0,
        })
        .collect())
}

fn run(path: &Path) -> Result<Vec<Row>, DatasetError> {
    let mut rows = Vec::new();
    for moment in RunReader::open(path)?.moments() {
        let Moment::Step(step) = moment? else { continue };
        let crate::protocol::CameraImage::Jpeg(jpeg) = &step.telemetry.image else { continue };
        // What nobody steered is no label.
        let Some(command) = step.command.filter(|c| matches!(c.by, By::Pilot | By::Human)) else { continue };
        rows.push(Row {
            at: step.at,
            pictures: [Some(Picture::Bytes(jpeg.clone())), None, None],
            steering: command.steering,
            acceleration: command.throttle.get(),
            speed: step.telemetry.speed,
            drive: 0,
        });
    }
    Ok(rows)
}
