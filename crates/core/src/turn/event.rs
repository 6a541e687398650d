//! What happens in a drive besides telemetry and commands.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::control::{HandoverChange, Release};

/// What happens in a run besides telemetry and commands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum EventRecord {
    /// A person took the wheel.
    TakeoverBegan,
    /// And gave it back.
    TakeoverEnded {
        /// How long they had it.
        duration_s: f64,
    },
    /// A telemetry or picture that could not be used.
    BadFrame {
        /// What was wrong.
        why: String,
        /// Its number among bad frames in a row, from 1.
        count_in_row: u32,
    },
    /// Too many bad frames in a row: the car is being stopped.
    BrakingToStandstill,
    /// A guard brakes from here on, in place of the pilot.
    GuardBrakes {
        /// Which guard.
        guard: String,
        /// How much an emergency brake is due, on the guard's own scale, …
        value: f64,
        /// … and where that begins to be an emergency.
        fires: f64,
        /// How fast the car is.
        speed_mph: f64,
    },
    /// It no longer does: the pilot has the throttle again.
    GuardReleases {
        /// How long it braked, by the simulator's clock, if it reports one.
        after_s: f64,
        /// Why it stopped.
        why: Release,
        /// How fast the car is; absent if that was not told.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        speed_mph: Option<f64>,
    },
    /// The disk was too slow; written by the recorder itself once there was room again.
    FramesNotRecorded {
        /// How many frames are missing before this.
        count: u64,
    },
    /// What comes next does not continue from what came before, though their times do not show it: the run was made
    /// from a driving log that joins several drives.
    Break {
        /// The time between them by the log's own clock, below 0 if that was set back; absent if it does not say.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seconds: Option<f64>,
    },
    /// An answer was sent without a telemetry, to wake a simulator that waits for one.
    Kick,
    /// The pilot was switched off.
    PilotOff {
        /// By what.
        why: String,
    },
    /// The pilot was switched on.
    PilotArmed,
    /// Somebody stops the car: full brake to a standstill, until the pilot is armed.
    EmergencyStop,
    /// Another set speed is held from here on.
    SpeedSet {
        /// Which.
        mph: f64,
    },
    /// Another law computes the throttle from here on.
    SpeedLawSet {
        /// Its name, as in the settings.
        law: String,
    },
    /// Another pilot drives from here on.
    PilotSet {
        /// Its name.
        name: String,
        /// SHA-256 of its file; absent if it has none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sha256: Option<String>,
    },
    /// An event of the simulator that is no telemetry.
    Simulator {
        /// Its name on the wire.
        name: String,
        /// Its payload, as text; cut to 2000 characters.
        payload: String,
    },
    /// The course to drive; comes before the first telemetry, if the world knows it.
    Course {
        /// The track's name.
        track: String,
        /// Length of a lap, in metres.
        length_m: f64,
        /// Waypoints around it, counted by the telemetry's `waypoint`.
        waypoints: u32,
        /// Laps asked for; none if only time ends the run.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        laps: Option<u32>,
        /// From the road's middle to its edge, in metres.
        edge_m: f64,
        /// The script of the other traffic, by name.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        scenario: Option<String>,
    },
    /// A lap was completed.
    Lap {
        /// Its number, from 1.
        number: u32,
        /// How long it took.
        time_s: f64,
    },
    /// The car hit something.
    Collision {
        /// What.
        with: String,
        /// How fast the two met.
        speed_mph: f64,
        /// How fast the car itself was; earlier versions did not record it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        own_mph: Option<f64>,
    },
    /// From here on, in a drive along a recording: what offsets are measured from, and how far from it the car may be.
    MeasuredFrom {
        /// What they are measured from.
        line: MeasuredLine,
        /// What the car must not pass.
        edge: LimitEdge,
        /// Where that is, in metres to the right of the line: on the left, below 0, …
        left_m: f64,
        /// … and on the right.
        right_m: f64,
    },
    /// The car left the road, or passed its limit along a recording.
    OffRoad {
        /// How far from the road's middle it was, positive to the right; along a recording from the line that
        /// `measured-from` names.
        offset_m: f64,
    },
    /// The car came back to the road.
    BackOnRoad {
        /// How long it was off.
        after_s: f64,
    },
    /// The car is stuck.
    Stuck,
    /// The car moves again.
    Moving,
    /// The car drives against the direction of the track.
    WrongWay,
    /// The car drives in the direction of the track again.
    RightWay,
    /// The car was put back on the road.
    Reset {
        /// The waypoint.
        waypoint: u32,
    },
    /// A note by a person or a script.
    Note {
        /// The words.
        text: String,
    },
    /// The run ended in an orderly way.
    RunEnded {
        /// By what.
        #[serde(deserialize_with = "present_words")]
        why: String,
    },
}

/// What the offsets of a drive along a recording are measured from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MeasuredLine {
    /// The middle of the lane.
    Lane,
    /// The path that the recorded car drove; runs of earlier versions know no other.
    #[default]
    RecordedPath,
}

/// What a car along a recording must not pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LimitEdge {
    /// The road's edge.
    Road,
    /// A distance that was asked for, or the default one where the road is not known.
    Metres,
}

/// Why a run ended, in today's words: older runs say it in words that readers would not understand.
fn present_words<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let why = String::deserialize(deserializer)?;
    Ok(if why == "its time is over" { "time limit reached".into() } else { why })
}

/// How many characters of a text in an event are recorded: text from the wire may be a megabyte long.
const MAX_TEXT: usize = 2000;

impl EventRecord {
    /// The course of a drive along the path of a recording of this name, from which the car may be `limit_m` away. It
    /// is only a path, which ends somewhere; the run's header says so.
    pub fn recorded_path(recording: &str, length_m: f64, waypoints: u32, limit_m: f64) -> Self {
        let track = format!("{recording} (recorded)");
        Self::Course { track, length_m, waypoints, laps: None, edge_m: limit_m, scenario: None }
    }

    /// Cuts every text to [`MAX_TEXT`].
    pub(crate) fn shorten(&mut self) {
        let cut = |text: &mut String| {
            if let Some((end, _)) = text.char_indices().nth(MAX_TEXT) {
                text.truncate(end);
                text.shrink_to_fit();
            }
        };
        match self {
            Self::BadFrame { why: text, .. }
            | Self::PilotOff { why: text }
            | Self::RunEnded { why: text }
            | Self::GuardBrakes { guard: text, .. }
            | Self::SpeedLawSet { law: text }
            | Self::PilotSet { name: text, .. }
            | Self::Note { text } => cut(text),
            Self::Simulator { name, payload } => {
                cut(name);
                cut(payload);
            }
            Self::TakeoverBegan
            | Self::TakeoverEnded { .. }
            | Self::BrakingToStandstill
            | Self::GuardReleases { .. }
            | Self::FramesNotRecorded { .. }
            | Self::Break { .. }
            | Self::Kick
            | Self::PilotArmed
            | Self::EmergencyStop
            | Self::SpeedSet { .. }
            | Self::Course { .. }
            | Self::MeasuredFrom { .. }
            | Self::Lap { .. }
            | Self::Collision { .. }
            | Self::OffRoad { .. }
            | Self::BackOnRoad { .. }
            | Self::Stuck
            | Self::Moving
            | Self::WrongWay
            | Self::RightWay
            | Self::Reset { .. } => {}
        }
    }
}

impl From<HandoverChange> for EventRecord {
    fn from(change: HandoverChange) -> Self {
        match change {
            HandoverChange::TakeoverBegan => Self::TakeoverBegan,
            HandoverChange::TakeoverEnded(after) => Self::TakeoverEnded { duration_s: after.as_secs_f64() },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_one_json_object_told_apart_by_kind() {
        let text = |event: EventRecord| serde_json::to_string(&event).unwrap();
        assert_eq!(text(EventRecord::Kick), r#"{"kind":"kick"}"#);
        assert_eq!(
            text(EventRecord::BadFrame { why: "no JPEG".into(), count_in_row: 2 }),
            r#"{"kind":"bad-frame","why":"no JPEG","count_in_row":2}"#
        );
        assert_eq!(text(EventRecord::FramesNotRecorded { count: 3 }), r#"{"kind":"frames-not-recorded","count":3}"#);
    }
}
