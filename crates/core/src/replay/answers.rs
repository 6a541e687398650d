//! The answers to a recording, from a driver in this process or from a bridge.

use std::{collections::VecDeque, time::Duration};

use super::{Replay, ReplayError};
use crate::{
    drive::{Observer, ObserverError},
    perception::{self, Frame, ImageError},
    protocol::{Answer, CameraImage, Command, Observation, Sight, World},
    turn::{By, EventRecord, Turn},
    units::Steering,
};

/// The answer to one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Answered {
    /// Its moment's number in the recording, from 0, as other verbs print it; for a human's driving, that of the moment after it, or
    /// at the end that of the last.
    pub frame: u64,
    /// Time since the recording began.
    pub at: Duration,
    /// What was steered when it was recorded; absent if the recording does not say.
    pub recorded: Option<Steering>,
    /// The answer now.
    pub response: Response,
}

/// A driver's answer to a frame. Only the first is the pilot's.
#[derive(Debug, Clone, PartialEq)]
pub enum Response {
    /// The pilot saw the frame, and this is its command.
    Steer(Command),
    /// A human drives.
    Human,
    /// The pilot waits to be armed: nobody decided this command.
    Off(Command),
    /// No pilot saw the frame: it cannot be read, or the pilot has no answer to it. The command that the driver sends
    /// instead is there for safety and says nothing about a pilot.
    Bad {
        /// What is wrong with it.
        why: String,
    },
}

impl Response {
    /// That of a driver in this process, which reports who answered.
    fn of(turn: &Turn) -> Self {
        match (turn.answer, turn.trace.by) {
            (Answer::Manual, _) => Self::Human,
            (Answer::Steer(command), By::Off) => Self::Off(command),
            (Answer::Steer(_), By::Safe) => {
                let why = turn.trace.events.iter().find_map(|event| match event {
                    EventRecord::BadFrame { why, .. } => Some(why.clone()),
                    _ => None,
                });
                Self::Bad { why: why.unwrap_or_default() }
            }
            (Answer::Steer(command), _) => Self::Steer(command),
        }
    }
}

/// Keeps what a driver in this process answers.
#[derive(Debug, Default)]
pub struct Answers {
    answers: Vec<Answered>,
    times: Vec<Duration>,
}

impl Answers {
    /// What has been answered.
    pub fn answers(&self) -> &[Answered] {
        &self.answers
    }

    /// What has been answered, and the driver's time for each.
    pub fn into_parts(self) -> (Vec<Answered>, Vec<Duration>) {
        (self.answers, self.times)
    }
}

impl Observer<Replay> for Answers {
    fn turn(&mut self, replay: &Replay, turn: &Turn) -> Result<(), ObserverError> {
        for event in &turn.trace.events {
            tracing::debug!("at {:.2} s: {event:?}", turn.at().as_secs_f64());
        }
        let (frame, recorded) = (replay.row(), replay.recorded());
        let response = replay.missing().map_or_else(|| Response::of(turn), |why| Response::Bad { why: why.into() });
        self.answers.push(Answered { frame, at: turn.at(), recorded, response });
        self.times.push(turn.trace.total);
        Ok(())
    }
}

/// A recording for a bridge, whose answers it keeps. There is no turn to look at: a bridge reports neither who answered
/// nor how, and may be answering several frames.
pub struct ForBridge {
    replay: Replay,
    /// Shown and not yet answered.
    waiting: VecDeque<Unanswered>,
    answers: Vec<Answered>,
    /// Memory for pictures that are decoded here.
    scratch: Frame,
}

struct Unanswered {
    frame: u64,
    at: Duration,
    recorded: Option<Steering>,
    image: Option<CameraImage>,
    /// Why the image cannot be read.
    missing: Option<String>,
}

impl ForBridge {
    /// From the recording's beginning.
    pub fn new(replay: Replay) -> Self {
        Self { replay, waiting: VecDeque::new(), answers: vec![], scratch: Frame::default() }
    }

    /// What has been answered.
    pub fn answers(&self) -> &[Answered] {
        &self.answers
    }

    /// Gives away what has been answered.
    pub fn into_answers(self) -> Vec<Answered> {
        self.answers
    }

    /// The recording.
    pub fn replay(&self) -> &Replay {
        &self.replay
    }

    /// Settles the frame that has waited longest.
    fn settle(&mut self, response: Response) {
        if let Some(Unanswered { frame, at, recorded, .. }) = self.waiting.pop_front() {
            self.answers.push(Answered { frame, at, recorded, response });
        }
    }
}

impl World for ForBridge {
    type Error = ReplayError;

    fn observe(&mut self) -> Result<Option<Observation>, ReplayError> {
        let Some(observation) = self.replay.observe()? else { return Ok(None) };
        let image = match &observation.sight {
            Sight::Telemetry(telemetry) => Some(telemetry.image.clone()),
            Sight::HumanDrives | Sight::Unreadable(_) => None,
        };
        let (frame, at, recorded) = (self.replay.row(), observation.at, self.replay.recorded());
        let missing = self.replay.missing().map(str::to_owned);
        self.waiting.push_back(Unanswered { frame, at, recorded, image, missing });
        Ok(Some(observation))
    }

    fn unanswered(&mut self) {
        self.settle(Response::Bad { why: "its answer could not be read".into() });
    }

    /// A picture that cannot be read was seen by no network behind the bridge, whatever it answers.
    fn apply(&mut self, answer: Answer) {
        let response = match answer {
            Answer::Manual => Response::Human,
            Answer::Steer(command) => {
                let shown = self.waiting.front();
                let image = shown.and_then(|shown| shown.image.as_ref());
                let missing = shown.and_then(|shown| shown.missing.clone());
                match image.map_or(Ok(()), |image| readable(image, &mut self.scratch)) {
                    Ok(()) => Response::Steer(command),
                    Err(why) => Response::Bad { why: missing.unwrap_or_else(|| format!("image: {why}")) },
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
