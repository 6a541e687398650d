//! Runs and Udacity folders as one kind of world.

use std::{
    collections::VecDeque,
    fs, io,
    path::{Path, PathBuf},
    str::FromStr,
    time::{Duration, Instant},
};

use super::pace;
use crate::{
    protocol::{Answer, CameraImage, Observation, Sight, Telemetry, Truth, World},
    recording::{
        By, EventRecord, Moment, Moments, RecordingError, RunReader, is_run,
        udacity::{DrivingLog, Row},
    },
    units::Steering,
};

/// How fast a recording is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rate {
    /// As it was recorded.
    Real,
    /// As fast as the driver answers.
    Max,
    /// So many frames a second.
    Hz(f64),
}

impl FromStr for Rate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "real" => Ok(Self::Real),
            "max" => Ok(Self::Max),
            hz => match hz.parse() {
                Ok(hz) if (0.01..=10_000.0).contains(&hz) => Ok(Self::Hz(hz)),
                _ => Err("expected real, max, or frames a second from 0.01 to 10000".into()),
            },
        }
    }
}

/// A recording that cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The run or the driving log.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// An image of a driving log.
    #[error("{path}: expected the image of a driving log's row, got an error: {source}")]
    Image {
        /// The image.
        path: PathBuf,
        /// Why it cannot be read.
        source: io::Error,
    },
}

/// What was answered to one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Answered {
    /// Number of the frame, from 0.
    pub frame: u64,
    /// Time since the recording began.
    pub at: Duration,
    /// What was steered when it was recorded; absent where the recording does not tell.
    pub recorded: Option<Steering>,
    /// What is answered now.
    pub answer: Answer,
}

/// A recording as a world: yields what was recorded and keeps what is answered.
pub struct Replay {
    source: Source,
    rate: Rate,
    began: Option<Instant>,
    shown: u64,
    skipped: u64,
    /// The pilot was armed since the last look.
    armed: bool,
    /// Shown and not yet answered.
    waiting: VecDeque<(u64, Duration, Option<Steering>)>,
    answers: Vec<Answered>,
}

enum Source {
    Run(Box<Moments>),
    Folder { rows: std::vec::IntoIter<Row>, frames: u64 },
}

impl Replay {
    /// Opens a run (a file) or a Udacity folder (a folder, or its CSV).
    ///
    /// # Errors
    /// [`ReplayError`], with file, line and field.
    pub fn open(path: &Path, rate: Rate) -> Result<Self, ReplayError> {
        let source = if is_run(path) {
            Source::Run(Box::new(RunReader::open(path)?.moments()))
        } else {
            let rows = DrivingLog::open(path)?.rows;
            Source::Folder { frames: rows.len() as u64, rows: rows.into_iter() }
        };
        Ok(Self {
            source,
            rate,
            began: None,
            shown: 0,
            skipped: 0,
            armed: false,
            waiting: VecDeque::new(),
            answers: vec![],
        })
    }

    /// How many frames there are, where that is known beforehand.
    pub fn frames(&self) -> Option<u64> {
        match &self.source {
            Source::Run(moments) => moments.run().telemetries(),
            Source::Folder { frames, .. } => Some(*frames),
        }
    }

    /// What has been answered.
    pub fn answers(&self) -> &[Answered] {
        &self.answers
    }

    /// Whether the pilot was armed by hand before the moment observed last; says so once.
    pub fn take_armed(&mut self) -> bool {
        std::mem::take(&mut self.armed)
    }

    /// Telemetries skipped for want of a frame, and why the recording ends early if it does.
    pub fn losses(&self) -> (u64, Option<String>) {
        let cut_off = match &self.source {
            Source::Run(moments) => moments.truncated().map(ToString::to_string),
            Source::Folder { .. } => None,
        };
        (self.skipped, cut_off)
    }

    fn next(&mut self) -> Result<Option<(Observation, Option<Steering>)>, ReplayError> {
        match &mut self.source {
            Source::Folder { rows, .. } => {
                let Some(row) = rows.next() else { return Ok(None) };
                let jpeg =
                    fs::read(&row.center).map_err(|source| ReplayError::Image { path: row.center.clone(), source })?;
                let telemetry = Telemetry {
                    steering: row.steering.degrees(),
                    throttle: row.throttle,
                    speed: row.speed,
                    image: CameraImage::Jpeg(jpeg.into()),
                    truth: Truth::default(),
                };
                Ok(Some((Observation { at: row.at, sight: Sight::Telemetry(telemetry) }, Some(row.steering))))
            }
            Source::Run(moments) => {
                for moment in moments {
                    match moment? {
                        Moment::Step(step) if !step.frame_recorded => self.skipped += 1,
                        Moment::Step(step) => {
                            // What nobody steered is nothing to compare with.
                            let driven = |by| matches!(by, By::Pilot | By::Human);
                            let recorded = step.command.filter(|c| driven(c.by)).map(|c| c.steering);
                            let sight = Sight::Telemetry(step.telemetry);
                            return Ok(Some((Observation { at: step.at, sight }, recorded)));
                        }
                        Moment::Event { at, event: EventRecord::TakeoverBegan } => {
                            return Ok(Some((Observation { at, sight: Sight::HumanDrives }, None)));
                        }
                        Moment::Event { event: EventRecord::PilotArmed, .. } => self.armed = true,
                        Moment::Event { .. } => {}
                    }
                }
                Ok(None)
            }
        }
    }
}

impl World for Replay {
    fn observe(&mut self) -> Result<Option<Observation>, Box<dyn std::error::Error + Send + Sync>> {
        let Some((observation, recorded)) = self.next()? else { return Ok(None) };
        let began = *self.began.get_or_insert_with(Instant::now);
        pace(self.rate, began, self.shown, observation.at);
        self.waiting.push_back((self.shown, observation.at, recorded));
        self.shown += 1;
        Ok(Some(observation))
    }

    fn apply(&mut self, answer: Answer) {
        if let Some((frame, at, recorded)) = self.waiting.pop_front() {
            self.answers.push(Answered { frame, at, recorded, answer });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_real_max_or_frames_a_second() {
        assert_eq!("real".parse(), Ok(Rate::Real));
        assert_eq!("max".parse(), Ok(Rate::Max));
        assert_eq!("15".parse(), Ok(Rate::Hz(15.0)));
        for text in ["", "fast", "0", "-1", "NaN", "inf"] {
            assert!(text.parse::<Rate>().is_err(), "{text}");
        }
    }
}
