//! Folders and runs as moments of a drive, one after the other.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use bytes::Bytes;
use jiff::civil::DateTime;

use super::DatasetError;
use lapwing_core::{
    protocol::CameraImage,
    recording::{By, Moments, RunReader, Step, is_run, read_picture, udacity},
    units::Steering,
};

/// Names of the cameras, in the order in which a moment has its pictures.
pub(super) const CAMERAS: [&str; 3] = ["center", "left", "right"];

/// Where the bytes of a picture are.
#[derive(Debug, Clone)]
pub(super) enum Picture {
    File(PathBuf),
    Jpeg(Bytes),
    /// A telemetry whose picture was not recorded.
    NotRecorded,
}

impl Picture {
    /// Its bytes, or why there are none.
    pub(super) fn read(&self) -> Result<Bytes, String> {
        match self {
            Self::File(path) => read_picture(path).map_err(|e| e.to_string()),
            Self::Jpeg(bytes) => Ok(bytes.clone()),
            Self::NotRecorded => Err("not recorded".into()),
        }
    }
}

/// What was there at one moment.
#[derive(Debug, Clone)]
pub(super) struct Moment {
    /// Counted from 0.
    pub row: usize,
    /// Line in the CSV file, counted from 1.
    pub line: Option<usize>,
    /// Time since the first row.
    pub at: Duration,
    /// When it was, by whatever clock the recording has; not of a row whose pictures' names hold no time.
    pub taken_at: Option<DateTime>,
    /// In the order of [`CAMERAS`].
    pub pictures: [Option<Picture>; 3],
    /// In effect.
    pub steering: Steering,
    /// In effect, in mph.
    pub speed_mph: f64,
    /// Who answered it, in a run.
    pub answered: Option<&'static str>,
}

/// The moments of a data set.
pub(super) enum Drive {
    Folder(std::iter::Enumerate<std::vec::IntoIter<udacity::Row>>),
    Run { moments: Box<Moments>, row: usize },
}

impl Drive {
    /// Opens a folder with `driving_log.csv`, such a file, or a run.
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        if is_run(path) {
            Ok(Self::Run { moments: Box::new(RunReader::open(path)?.moments()), row: 0 })
        } else {
            Ok(Self::Folder(udacity::DrivingLog::open(path)?.rows.into_iter().enumerate()))
        }
    }

    /// How many moments are still to come, where that is known.
    pub(super) fn left(&self) -> Option<usize> {
        match self {
            Self::Folder(rows) => Some(rows.len()),
            Self::Run { moments, row } => {
                moments.run().telemetries().map(|all| usize::try_from(all).unwrap_or(usize::MAX).saturating_sub(*row))
            }
        }
    }

    /// Where a run ends before its orderly end, once it has been read.
    pub(super) fn truncated(&self) -> Option<String> {
        match self {
            Self::Folder(_) => None,
            Self::Run { moments, .. } => moments.truncated().map(ToString::to_string),
        }
    }
}

impl Iterator for Drive {
    type Item = Result<Moment, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self {
            Self::Folder(rows) => rows.next().map(|(row, of_log)| Ok(of_folder(row, of_log))),
            Self::Run { moments, row } => loop {
                match moments.next()? {
                    Ok(lapwing_core::recording::Moment::Step(step)) => {
                        *row += 1;
                        return Some(Ok(of_run(*row - 1, step)));
                    }
                    Ok(lapwing_core::recording::Moment::Event { .. }) => {}
                    Err(error) => return Some(Err(error.into())),
                }
            },
        }
    }
}

fn of_folder(row: usize, of_log: udacity::Row) -> Moment {
    Moment {
        row,
        line: Some(of_log.line),
        at: of_log.at,
        taken_at: of_log.taken_at,
        pictures: [Some(of_log.center), of_log.left, of_log.right].map(|path| path.map(Picture::File)),
        steering: of_log.steering,
        speed_mph: of_log.speed.get(),
        answered: None,
    }
}

fn of_run(row: usize, step: Step) -> Moment {
    let picture = match step.telemetry.image {
        CameraImage::Jpeg(jpeg) if step.frame_recorded => Picture::Jpeg(jpeg),
        _ => Picture::NotRecorded,
    };
    let answered = match step.command.map(|command| command.by) {
        None => "nobody",
        Some(By::Pilot) => "pilot",
        Some(By::Human) => "human",
        Some(By::Safe) => "safe",
        Some(By::Off) => "off",
    };
    // A run's clock never jumps: any day will do to count from.
    let taken_at = DateTime::constant(2000, 1, 1, 0, 0, 0, 0).checked_add(step.at).ok();
    Moment {
        row,
        line: None,
        at: step.at,
        taken_at,
        pictures: [Some(picture), None, None],
        steering: step.telemetry.steering.steering(),
        speed_mph: step.telemetry.speed.get(),
        answered: Some(answered),
    }
}
