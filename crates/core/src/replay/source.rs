//! Runs and Udacity folders as one kind of world.

use std::{
    collections::VecDeque,
    io,
    path::{Path, PathBuf},
    str::FromStr,
    time::{Duration, Instant},
};

use bytes::Bytes;

use crate::{
    drive::Eventful,
    protocol::{Answer, CameraImage, Observation, Sight, Truth, World},
    recording::{Moment, Picture, Recording, RecordingError},
    turn::EventRecord,
    units::Steering,
};

/// How fast a recording is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rate {
    /// As it was recorded.
    Real,
    /// As fast as the driver answers.
    Max,
    /// This many frames a second.
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
    /// The images of a driving log: none can be read, and this is the first.
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
    recording: Recording,
    /// What happened before the moment that is shown next, and that moment.
    events: VecDeque<(Duration, EventRecord)>,
    moment: Option<Moment>,
    rate: Rate,
    began: Option<Instant>,
    shown: u64,
    /// The number in the recording of the moment observed last.
    row: u64,
    skipped: u64,
    /// What was steered at the moment observed last.
    recorded: Option<Steering>,
    /// Whether a picture was read, why the first one that could not be could not, and the same of the moment observed last.
    shows: bool,
    lost: Option<ReplayError>,
    missing: Option<String>,
    /// The pilot was armed before it.
    armed: Option<Duration>,
    interrupted: bool,
}

impl Replay {
    /// Opens a run (a file) or a Udacity folder (a folder, or its CSV).
    ///
    /// # Errors
    /// [`ReplayError`], with file, line and field.
    pub fn open(path: &Path, rate: Rate) -> Result<Self, ReplayError> {
        Ok(Self {
            recording: Recording::open(path)?,
            events: VecDeque::new(),
            moment: None,
            rate,
            began: None,
            shown: 0,
            row: 0,
            skipped: 0,
            recorded: None,
            shows: false,
            lost: None,
            missing: None,
            armed: None,
            interrupted: false,
        })
    }

    /// How many frames there are, if that is known beforehand.
    pub fn frames(&self) -> Option<u64> {
        self.recording.left()
    }

    /// The number in the recording of the moment observed last, from 0: for a human's driving, of the moment after it, or at the end
    /// of the last.
    pub fn row(&self) -> u64 {
        self.row
    }

    /// What was steered at the moment observed last; absent if the recording does not say.
    pub fn recorded(&self) -> Option<Steering> {
        self.recorded
    }

    /// Why the picture of the moment observed last cannot be read, if so: its image is empty.
    pub fn missing(&self) -> Option<&str> {
        self.missing.as_deref()
    }

    /// Telemetries skipped for want of a frame, and why the recording ends early if it does.
    pub fn losses(&self) -> (u64, Option<String>) {
        let cut_off = self.recording.truncated().map(ToString::to_string);
        (self.skipped, cut_off)
    }

    fn next(&mut self) -> Result<Option<(Observation, Option<Steering>)>, ReplayError> {
        loop {
            while let Some((at, event)) = self.events.pop_front() {
                match event {
                    EventRecord::TakeoverBegan => {
                        return Ok(Some((Observation { at, sight: Sight::HumanDrives }, None)));
                    }
                    EventRecord::PilotArmed => self.armed = Some(at),
                    _ => {}
                }
            }
            if let Some(moment) = self.moment.take() {
                if moment.is_seen() {
                    return Ok(Some(self.shown(moment)));
                }
                self.skipped += 1;
            }
            match self.recording.next().transpose()? {
                Some(mut moment) => {
                    self.events.extend(std::mem::take(&mut moment.before));
                    self.row = moment.row as u64;
                    self.moment = Some(moment);
                }
                None => {
                    self.events.extend(self.recording.events_after());
                    if self.events.is_empty() {
                        return self.lost.take().filter(|_| !self.shows).map_or(Ok(None), Err);
                    }
                }
            }
        }
    }

    /// A moment with its picture as an observation, and what was steered then, if anybody steered.
    fn shown(&mut self, moment: Moment) -> (Observation, Option<Steering>) {
        let recorded = moment.steering();
        let Moment { at, mut telemetry, pictures: [picture, ..], .. } = moment;
        let picture = picture.unwrap_or(Picture::NotRecorded);
        let read = picture.read();
        self.shows |= read.is_ok();
        self.missing = read.as_ref().err().map(|why| format!("{picture}: {why}"));
        let jpeg = read.unwrap_or_else(|source| {
            let path = PathBuf::from(picture.to_string());
            self.lost.get_or_insert(ReplayError::Image { path, source });
            Bytes::new()
        });
        telemetry.image = CameraImage::Jpeg(jpeg);
        if self.recording.log().is_some() {
            telemetry.truth = Truth::default(); // no simulator reports the brake as the recorder does
        }
        (Observation { at, sight: Sight::Telemetry(telemetry) }, recorded)
    }
}

impl Eventful for Replay {
    /// Only that a person armed the pilot: no other event of the past affects who is asked now.
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

    /// Ignored: what was recorded stays as it was.
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
