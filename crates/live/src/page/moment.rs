//! What pages see of a drive at one moment: made by the one who drives, shared by all who look, never changed.

use std::{sync::Arc, time::Duration};

use bytes::Bytes;
use serde::{Serialize, Serializer, ser::SerializeMap};

use super::{
    control::{Abilities, Offered},
    counts::{Counts, STAGES, times},
};
use lapwing_core::{
    config::SpeedLaw,
    driver::Hands,
    protocol::{Answer, Dialect},
    recording::Recorder,
    turn::{By, Turn},
};
use lapwing_score::score::Scorer;

/// A drive now.
#[derive(Debug, Clone, Default)]
pub(super) struct Moment {
    pub status: Arc<Status>,
    /// The last turn; none before the first.
    pub turn: Option<Facts>,
    /// The camera's picture as it came.
    pub jpeg: Option<Bytes>,
    /// What has happened lately, the oldest first.
    pub events: Arc<[Happened]>,
    pub counts: Counts,
    /// The scorer as it was up to a second ago.
    pub scorer: Option<Arc<Scorer>>,
}

/// Where a drive is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Phase {
    /// Its model is still loading.
    #[default]
    Waiting,
    /// A run is under way.
    Driving,
    /// Its run was ended by a person, and the next one has not begun.
    Ended,
}

/// What changes seldom.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub(super) struct Status {
    /// Who is at the other end.
    pub title: String,
    pub dialect: Option<String>,
    pub phase: Phase,
    /// Number of the run, from 1.
    pub run: u32,
    pub hands: &'static str,
    /// The pilot's place among the page's.
    pub pilot: usize,
    pub set_speed_mph: f64,
    pub speed_law: SpeedLaw,
    pub paused: bool,
    /// Rows of training data kept so far; none if none are kept.
    pub recorded: Option<u64>,
    pub recording: bool,
    /// The file of the run; none where none is wanted.
    pub file: Option<RunFileStatus>,
    /// The track's name, where it is told.
    pub track: Option<String>,
    pub scenario: Option<String>,
    pub can: Abilities,
    pub offered: Offered,
}

/// The file of a run while it is written, as pages are told.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RunFileStatus {
    /// Its name; none if it could not be made.
    pub name: Option<String>,
    /// Frames and other items that did not make it into the file.
    pub not_recorded: u64,
    /// What is wrong at the moment; none while it is being written.
    pub trouble: Option<String>,
}

impl RunFileStatus {
    /// One that could not be made.
    pub fn unmade(why: &str) -> Self {
        Self { name: None, not_recorded: 0, trouble: Some(why.to_owned()) }
    }
}

impl From<&Recorder> for RunFileStatus {
    fn from(recorder: &Recorder) -> Self {
        let status = recorder.status();
        Self {
            name: recorder.path().file_name().map(|name| name.to_string_lossy().into_owned()),
            not_recorded: status.lost(),
            trouble: status.failed,
        }
    }
}

/// A dialect as people call it.
pub(super) fn dialect(dialect: Option<Dialect>) -> Option<String> {
    dialect.map(|dialect| dialect.to_string())
}

/// Who drives, as pages are told.
pub(super) fn hands(hands: Hands) -> &'static str {
    match hands {
        Hands::Pilot => "pilot",
        Hands::Human => "human",
        Hands::Off => "off",
        Hands::Stopped => "stopped",
    }
}

/// The numbers of a turn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Facts {
    /// Its number in this drive, from 1.
    pub n: u64,
    /// Seconds of the run.
    #[serde(serialize_with = "short")]
    pub t: f64,
    #[serde(serialize_with = "shorts")]
    pub speed_mph: Option<f64>,
    /// The steering and the throttle in effect, as reported.
    #[serde(serialize_with = "shorts")]
    pub steering_deg: Option<f64>,
    #[serde(serialize_with = "shorts")]
    pub throttle: Option<f64>,
    /// The command: steering and throttle, normalised; none while a human drives at the simulator.
    pub command: Option<[f32; 2]>,
    pub by: By,
    /// Cross-track error, in metres.
    #[serde(serialize_with = "shorts")]
    pub cte: Option<f64>,
    /// From above: x and z, in metres.
    pub at: Option<[f32; 2]>,
    pub lap: Option<u32>,
    #[serde(serialize_with = "shorts")]
    pub brake_due: Option<f64>,
    #[serde(serialize_with = "stages")]
    pub ms: [Option<Duration>; STAGES.len()],
    /// Turns a second, over the last second or so.
    #[serde(serialize_with = "short")]
    pub hz: f64,
}

impl Facts {
    pub fn of(turn: &Turn, n: u64, hz: f64) -> Self {
        let telemetry = turn.telemetry();
        let truth = telemetry.map(|telemetry| &telemetry.truth);
        Self {
            n,
            t: turn.at().as_secs_f64(),
            speed_mph: telemetry.map(|telemetry| telemetry.speed.get()),
            steering_deg: telemetry.map(|telemetry| telemetry.steering.get()),
            throttle: telemetry.map(|telemetry| telemetry.throttle.get()),
            command: match turn.answer {
                Answer::Steer(command) => Some([command.steering.get() as f32, command.throttle.get() as f32]),
                Answer::Manual => None,
            },
            by: turn.trace.by,
            cte: truth.and_then(|truth| truth.cte).map(|cte| cte.get()),
            at: truth.and_then(|truth| truth.position).map(|[x, _, z]| [x.get() as f32, z.get() as f32]),
            lap: truth.and_then(|truth| truth.lap),
            brake_due: turn.trace.brake_due,
            ms: times(turn),
            hz,
        }
    }
}

/// Something that happened, for people.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Happened {
    /// Its number in this drive, from 1.
    pub n: u64,
    /// Number of the run.
    pub run: u32,
    /// Seconds of the run.
    #[serde(serialize_with = "short")]
    pub t: f64,
    pub kind: String,
    pub words: String,
}

/// A page shows fewer digits than a number has.
pub(super) fn few_digits(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn short<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(few_digits(*value))
}

fn shorts<S: Serializer>(value: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    match value {
        Some(value) => short(value, serializer),
        None => serializer.serialize_none(),
    }
}

fn stages<S: Serializer>(times: &[Option<Duration>; STAGES.len()], serializer: S) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(None)?;
    for (stage, time) in STAGES.into_iter().zip(times) {
        let Some(time) = time else { continue };
        map.serialize_entry(stage, &((time.as_secs_f64() * 1e7).round() / 1e4))?;
    }
    map.end()
}
