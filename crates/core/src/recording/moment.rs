//! One moment of a drive, whatever it was recorded in.

use std::{fmt, io, path::PathBuf, time::Duration};

use bytes::Bytes;
use jiff::civil::DateTime;
use serde::{Deserialize, Serialize};

use super::{By, CommandRecord, EventRecord, ReleasedAtOnce, read_picture};
use crate::{
    motion::{Motion, curvature},
    protocol::Telemetry,
    units::Steering,
};

/// A longer time between two moments is a gap: nothing is concluded from one about the other. Recorders write eight
/// moments a second or more, and the longest interval in real recordings is 0.3 s; a driver who is not seen for a
/// second may have done anything.
pub const LONGEST_GAP: Duration = Duration::from_secs(1);

/// One moment of a recording.
#[derive(Debug, Clone)]
pub struct Moment {
    /// Its number in the recording, counted from 0.
    pub row: usize,
    /// Line in the CSV file, counted from 1.
    pub line: Option<usize>,
    /// Time since the recording began, without time that a driving log leaves out.
    pub at: Duration,
    /// Local time; absent in a row whose pictures' names hold none.
    pub taken_at: Option<DateTime>,
    /// Those of the centre, left and right cameras; `None` if the recording has no such camera.
    pub pictures: [Option<Picture>; 3],
    /// What the simulator reported, without the picture.
    pub telemetry: Telemetry,
    /// The answer; in a driving log, what the human did.
    pub command: Option<CommandRecord>,
    /// What has happened since the previous moment, in order.
    pub before: Vec<(Duration, EventRecord)>,
    /// Why it does not continue from the previous moment, if it does not.
    pub broken: Option<Break>,
}

impl Moment {
    /// The steering in effect from here on, to learn from and compare with: what a pilot or a human decided on seeing
    /// this. `None` if nobody steered: a safe answer, a pilot that is off, no answer at all. (The telemetry reports
    /// what was decided one moment earlier.)
    pub fn steering(&self) -> Option<Steering> {
        self.decided().map(|command| command.steering)
    }

    /// The command of a pilot or a human.
    pub fn decided(&self) -> Option<&CommandRecord> {
        self.command.as_ref().filter(|command| matches!(command.by, By::Pilot | By::Human))
    }

    /// The command that the car followed from here on, which may be a safe one. `None` if the pilot was off or nothing was
    /// answered.
    pub fn followed(&self) -> Option<&CommandRecord> {
        self.command.as_ref().filter(|command| command.by != By::Off)
    }

    /// How the car came here from the moment before, by its speeds and the steering that was in effect. `keys` is the keyboard that
    /// steered, if its steering is zero at once when a key is released ([`released_at_once`](super::released_at_once)).
    pub fn motion_from(&self, before: &Self, keys: Option<&ReleasedAtOnce>) -> Motion {
        let mps = |moment: &Self| moment.telemetry.speed.metres_per_second().get();
        let apart_s = self.at.saturating_sub(before.at).as_secs_f64();
        let way_m = apart_s * (mps(self) + mps(before)) / 2.0;
        let steered = match (before.steering(), self.steering(), keys) {
            (Some(was), Some(is), Some(keys)) => Some(Steering::saturating(keys.mean(was.get(), is.get(), apart_s))),
            (was, ..) => was,
        };
        // Without an answer, what was steered is told by the next telemetry.
        let steering_deg = steered.map_or(self.telemetry.steering.get(), |steering| steering.degrees().get());
        Motion { way_m, turn_rad: way_m * curvature(steering_deg) }
    }

    /// Whether the centre camera's picture is there.
    pub fn is_seen(&self) -> bool {
        matches!(self.pictures[0], Some(Picture::File(_) | Picture::Jpeg(_)))
    }
}

/// One of the three cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraPosition {
    /// In the middle.
    Center,
    /// 0.8 m to the left.
    Left,
    /// 0.8 m to the right.
    Right,
}

impl CameraPosition {
    /// All cameras, in the order of [`Moment::pictures`].
    pub const ALL: [Self; 3] = [Self::Center, Self::Left, Self::Right];

    /// Direction of the correction to the centre's label for its pictures: the left camera's is to the right.
    pub fn sign(self) -> f64 {
        match self {
            Self::Center => 0.0,
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }
}

/// Where the bytes of a picture are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Picture {
    /// In a file, which need not be there.
    File(PathBuf),
    /// In memory, as a run holds them.
    Jpeg(Bytes),
    /// Nowhere: the telemetry is recorded without it.
    NotRecorded,
}

impl Picture {
    /// Its bytes.
    ///
    /// # Errors
    /// Those of [`read_picture`]; [`io::ErrorKind::NotFound`] if it is not recorded.
    pub fn read(&self) -> io::Result<Bytes> {
        match self {
            Self::File(path) => read_picture(path),
            Self::Jpeg(bytes) => Ok(bytes.clone()),
            Self::NotRecorded => Err(io::Error::new(io::ErrorKind::NotFound, "not recorded")),
        }
    }
}

impl fmt::Display for Picture {
    /// What it is called in messages.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::Jpeg(_) | Self::NotRecorded => f.write_str("a picture of the run"),
        }
    }
}

/// Why a moment does not continue from the one before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Break {
    /// Nothing is recorded for this long, which is longer than [`LONGEST_GAP`].
    Gap(Duration),
    /// The clock goes back by this much: another drive is joined.
    Back(Duration),
    /// Another drive is joined, after an unknown time.
    Joined,
    /// The car was put elsewhere.
    PutBack,
    /// A human took over, and what they do before the simulator reports something again is not recorded.
    TakenOver,
    /// This many moments just before have no picture. The drive continues; a sequence of pictures does not.
    Unseen(usize),
}

impl Break {
    /// The break between two rows of a driving log, by their times. A row with a time and one without come from two
    /// drives.
    pub(super) fn between(from: Option<DateTime>, to: Option<DateTime>) -> Option<Self> {
        match (from, to) {
            (Some(from), Some(to)) => {
                let passed = to.duration_since(from);
                match Duration::try_from(passed) {
                    Ok(passed) => Self::after(passed),
                    Err(_) => Some(Self::Back(passed.unsigned_abs())),
                }
            }
            (None, None) => None,
            _ => Some(Self::Joined),
        }
    }

    /// A gap, if this much time counts as one.
    pub(super) fn after(passed: Duration) -> Option<Self> {
        (passed > LONGEST_GAP).then_some(Self::Gap(passed))
    }

    /// What an event says about the moment that follows.
    pub fn told(event: &EventRecord) -> Option<Self> {
        match event {
            EventRecord::Break { seconds: None } => Some(Self::Joined),
            EventRecord::Break { seconds: Some(seconds) } => Some(match Duration::try_from_secs_f64(seconds.abs()) {
                Ok(passed) if *seconds < 0.0 => Self::Back(passed),
                Ok(passed) => Self::Gap(passed),
                Err(_) => Self::Joined,
            }),
            EventRecord::Reset { .. } => Some(Self::PutBack),
            EventRecord::TakeoverBegan => Some(Self::TakenOver),
            _ => None,
        }
    }

    /// As the event that states it in a run.
    pub(super) fn event(self) -> EventRecord {
        EventRecord::Break { seconds: self.seconds() }
    }

    /// The time that passed by the recording's own clock, below 0 if that was set back.
    pub fn seconds(self) -> Option<f64> {
        match self {
            Self::Gap(passed) => Some(passed.as_secs_f64()),
            Self::Back(passed) => Some(-passed.as_secs_f64()),
            Self::Joined | Self::PutBack | Self::TakenOver | Self::Unseen(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_break_comes_back_from_the_event_that_a_run_says_it_by() {
        let s = Duration::from_secs_f64;
        for broken in [Break::Gap(s(1.5)), Break::Back(s(3600.25)), Break::Joined] {
            assert_eq!(Break::told(&broken.event()), Some(broken));
        }
        // A file may say anything.
        assert_eq!(Break::told(&EventRecord::Break { seconds: Some(f64::NAN) }), Some(Break::Joined));
        assert_eq!(Break::told(&EventRecord::Break { seconds: Some(-1e300) }), Some(Break::Joined));
        assert_eq!(Break::told(&EventRecord::Kick), None);
    }

    #[test]
    fn a_second_is_no_gap_yet() {
        assert_eq!(Break::after(LONGEST_GAP), None);
        let longer = LONGEST_GAP + Duration::from_millis(1);
        assert_eq!(Break::after(longer), Some(Break::Gap(longer)));
    }
}
