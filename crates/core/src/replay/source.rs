//! Runs and Udacity folders as one kind of world.

use std::{
    collections::VecDeque,
    io,
    path::{Path, PathBuf},
    str::FromStr,
    time::{Duration, Instant},
};

use super::pace;
use crate::{
    driver::{By as DrivenBy, Happening, Trace},
    perception::{self, Frame, ImageError},
    protocol::{Answer, CameraImage, Command, Observation, Sight, Telemetry, Truth, World},
    recording::udacity::{DrivingLog, Row},
    recording::{By, EventRecord, Moment, Moments, RecordingError, RunReader, is_run, read_picture},
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

/// What became of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Answered {
    /// Number of the frame, from 0.
    pub frame: u64,
    /// Time since the recording began.
    pub at: Duration,
    /// What was steered when it was recorded; absent where the recording does not tell.
    pub recorded: Option<Steering>,
    /// What is answered now.
    pub response: Response,
}

/// What a driver makes of a frame. Only the first is the pilot's word.
#[derive(Debug, Clone, PartialEq)]
pub enum Response {
    /// The pilot saw the frame, and this is its command.
    Steer(Command),
    /// A human drives.
    Human,
    /// The pilot waits to be armed: this command is nobody's.
    Off(Command),
    /// No pilot saw the frame: it cannot be read, or the pilot has no answer to it. What the driver sends instead is
    /// there for safety and says nothing about a pilot.
    Bad {
        /// What is wrong with it.
        why: String,
    },
}

impl Response {
    /// Of a driver in this process, which tells who answered.
    pub fn of(answer: Answer, trace: &Trace) -> Self {
        match (answer, trace.by) {
            (Answer::Manual, _) => Self::Human,
            (Answer::Steer(command), DrivenBy::Nobody) => Self::Off(command),
            (Answer::Steer(_), DrivenBy::Safety) => {
                let why = trace.happenings.iter().find_map(|happening| match happening {
                    Happening::BadFrame { why, .. } => Some(why.clone()),
                    _ => None,
                });
                Self::Bad { why: why.unwrap_or_default() }
            }
            (Answer::Steer(command), _) => Self::Steer(command),
        }
    }
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
    waiting: VecDeque<Shown>,
    answers: Vec<Answered>,
    /// Memory for pictures that are looked at here.
    scratch: Frame,
}

struct Shown {
    frame: u64,
    at: Duration,
    recorded: Option<Steering>,
    image: Option<CameraImage>,
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
            scratch: Frame::default(),
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

    /// Takes what became of the frame that has waited longest.
    pub(super) fn settle(&mut self, response: Response) {
        if let Some(Shown { frame, at, recorded, .. }) = self.waiting.pop_front() {
            self.answers.push(Answered { frame, at, recorded, response });
        }
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
        let image = match &observation.sight {
            Sight::Telemetry(telemetry) => Some(telemetry.image.clone()),
            Sight::HumanDrives | Sight::Unreadable(_) => None,
        };
        self.waiting.push_back(Shown { frame: self.shown, at: observation.at, recorded, image });
        self.shown += 1;
        Ok(Some(observation))
    }

    fn unanswered(&mut self) {
        self.settle(Response::Bad { why: "its answer could not be read".into() });
    }

    /// Takes the answer of a bridge, which does not tell what it is worth: a picture that cannot be read was seen by no
    /// network behind it.
    fn apply(&mut self, answer: Answer) {
        let response = match answer {
            Answer::Manual => Response::Human,
            Answer::Steer(command) => {
                let image = self.waiting.front().and_then(|shown| shown.image.as_ref());
                match image.map_or(Ok(()), |image| readable(image, &mut self.scratch)) {
                    Ok(()) => Response::Steer(command),
                    Err(why) => Response::Bad { why: format!("image: {why}") },
                }
            }
        };
        self.settle(response);
    }
}

fn readable(image: &CameraImage, scratch: &mut Frame) -> Result<(), ImageError> {
    match image {
        CameraImage::Jpeg(jpeg) => perception::decode_jpeg(jpeg, scratch),
        CameraImage::Base64(text) => perception::decode_jpeg(&perception::decode_base64(text)?, scratch),
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
