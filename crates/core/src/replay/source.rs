//! Runs and Udacity folders as one kind of world.

use std::{
    io,
    path::{Path, PathBuf},
    str::FromStr,
    time::{Duration, Instant},
};

use crate::{
    drive::Eventful,
    protocol::{Answer, CameraImage, Observation, Sight, Telemetry, Truth, World},
    recording::udacity::{DrivingLog, Row},
    recording::{Moment, Moments, RecordingError, RunReader, is_run, read_picture},
    turn::{By, EventRecord},
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

/// A recording as a world: yields what was recorded, whatever is answered.
pub struct Replay {
    source: Source,
    rate: Rate,
    began: Option<Instant>,
    shown: u64,
    skipped: u64,
    /// What was steered at the moment observed last.
    recorded: Option<Steering>,
    /// The pilot was armed before it.
    armed: Option<Duration>,
    interrupted: bool,
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
        Ok(Self { source, rate, began: None, shown: 0, skipped: 0, recorded: None, armed: None, interrupted: false })
    }

    /// How many frames there are, where that is known beforehand.
    pub fn frames(&self) -> Option<u64> {
        match &self.source {
            Source::Run(moments) => moments.run().telemetries(),
            Source::Folder { frames, .. } => Some(*frames),
        }
    }

    /// What was steered at the moment observed last; absent where the recording does not tell.
    pub fn recorded(&self) -> Option<Steering> {
        self.recorded
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
                let jpeg = read_picture(&row.center)
                    .map_err(|source| ReplayError::Image { path: row.center.clone(), source })?;
                let telemetry = Telemetry {
                    steering: row.steering.degrees(),
                    throttle: row.throttle,
                    speed: row.speed,
                    image: CameraImage::Jpeg(jpeg),
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
                        Moment::Event { at, event: EventRecord::PilotArmed } => self.armed = Some(at),
                        Moment::Event { .. } => {}
                    }
                }
                Ok(None)
            }
        }
    }
}

impl Eventful for Replay {
    /// Of all events only that a person armed the pilot: what else happened then says nothing of who is asked now.
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)> {
        self.armed.take().map(|at| (at, EventRecord::PilotArmed)).into_iter().collect()
    }

    fn interrupt(&mut self) {
        self.interrupted = true;
    }
}

impl World for Replay {
    type Error = ReplayError;

    fn observe(&mut self) -> Result<Option<Observation>, ReplayError> {
        if self.interrupted {
            return Ok(None);
        }
        let Some((observation, recorded)) = self.next()? else { return Ok(None) };
        let began = *self.began.get_or_insert_with(Instant::now);
        pace(self.rate, began, self.shown, observation.at);
        self.recorded = recorded;
        self.shown += 1;
        Ok(Some(observation))
    }

    /// What was recorded stays as it was.
    fn apply(&mut self, _: Answer) {}
}

/// Waits until `at` after `began`, at `rate`.
fn pace(rate: Rate, began: Instant, frame: u64, at: Duration) {
    let due = match rate {
        Rate::Max => return,
        Rate::Real => at,
        Rate::Hz(hz) => Duration::from_secs_f64(frame as f64 / hz),
    };
    std::thread::sleep((began + due).saturating_duration_since(Instant::now()));
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
