//! Telemetry: one message from a simulator as typed values with units, and
//! written as the stock build and the builds of the SelfOracle family write it.

use std::fmt::{self, Write};

use bytes::Bytes;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, de::Error};

use super::{
    Undrivable,
    number::{Culture, NotANumber},
};
use crate::units::{Degrees, Metres, Mph, OutOfRange, PathPoint, Throttle};

/// One message from a simulator, decoded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Telemetry {
    /// The steering angle in effect: the last command, times 25 degrees.
    #[serde(rename = "steering_deg")]
    pub steering: Degrees,
    /// The throttle in effect, 0 to 1: braking is never reported.
    pub throttle: Throttle,
    /// Speed, never negative: reversing cannot be told from going forward.
    #[serde(rename = "speed_mph")]
    pub speed: Mph,
    /// The centre camera's picture. Recorded beside the telemetry, not in it.
    #[serde(skip)]
    pub image: CameraImage,
    /// What forks report beyond the stock build.
    #[serde(default, skip_serializing_if = "Truth::is_empty")]
    pub truth: Truth,
}

/// A camera picture as received, still to be decoded by `perception`.
#[derive(Clone, PartialEq, Eq)]
pub enum CameraImage {
    /// Base64 text from the wire, not yet checked.
    Base64(Bytes),
    /// JPEG bytes, as a recording holds them.
    Jpeg(Bytes),
}

impl Default for CameraImage {
    fn default() -> Self {
        Self::Jpeg(Bytes::new())
    }
}

impl fmt::Debug for CameraImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Base64(bytes) => write!(f, "Base64({} bytes)", bytes.len()),
            Self::Jpeg(bytes) => write!(f, "Jpeg({} bytes)", bytes.len()),
        }
    }
}

/// Ground truth that some forks send. Absent is `None`, never 0.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Truth {
    /// Cross-track error: distance from the centre line.
    #[serde(rename = "cte_m", skip_serializing_if = "Option::is_none")]
    pub cte: Option<Metres>,
    /// The cross-track error a step ahead (udacity-gym).
    #[serde(rename = "next_cte_m", skip_serializing_if = "Option::is_none")]
    pub next_cte: Option<Metres>,
    /// Lap number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lap: Option<u32>,
    /// Waypoint last passed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub waypoint: Option<u32>,
    /// Sector of the track (udacity-gym).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sector: Option<u32>,
    /// Whether the car is in a crash now.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crashed: Option<bool>,
    /// Times out of bounds so far (`tot_obes`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub out_of_bounds: Option<u32>,
    /// Crashes so far.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crashes: Option<u32>,
    /// Brake in effect, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "a_brake")]
    pub brake: Option<f64>,
    /// Distance driven.
    #[serde(rename = "distance_m", skip_serializing_if = "Option::is_none")]
    pub distance: Option<Metres>,
    /// The simulator's own time, in seconds: 0 to [`Truth::LONGEST_S`].
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "a_time")]
    pub sim_time_s: Option<f64>,
    /// Time to collision with anything on the road ahead, in seconds: 0 to [`Truth::CLEAR_S`], which also means longer
    /// or never. Worlds without a scenario do not report it.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "a_time")]
    pub time_to_collision_s: Option<f64>,
    /// Distance from the front bumper to what is ahead in the car's way, standing or moving: 0 to [`Truth::CLEAR_M`],
    /// which also means that there is nothing. Worlds without a scenario do not report it.
    #[serde(rename = "gap_m", skip_serializing_if = "Option::is_none")]
    pub gap: Option<Metres>,
    /// Angle between the car's heading and the road's.
    #[serde(rename = "heading_error_deg", skip_serializing_if = "Option::is_none")]
    pub heading_error: Option<Degrees>,
    /// Position x (right), y (up), z (forward), Unity's axes.
    #[serde(rename = "position_m", skip_serializing_if = "Option::is_none")]
    pub position: Option<[Metres; 3]>,
    /// The collider that was hit, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hit: Option<String>,
    /// The track's name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track: Option<String>,
    /// The simulator's timestamp, as it wrote it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<String>,
    /// The line to drive, a point every metre, beginning beside the car. Worlds in this process report it to a pilot
    /// that follows it; it is neither sent nor recorded.
    #[serde(skip)]
    pub path: Vec<PathPoint>,
}

impl Truth {
    /// The longest time to collision that is reported, in seconds.
    pub const CLEAR_S: f64 = 60.0;

    /// The longest gap that is reported, in metres.
    pub const CLEAR_M: f64 = 200.0;

    /// The longest time that means anything, in seconds: thirty years, and exact to a tenth of a microsecond.
    pub const LONGEST_S: f64 = 1e9;

    /// Whether a number is a valid time in seconds.
    pub fn is_time(s: &f64) -> bool {
        (0.0..=Self::LONGEST_S).contains(s)
    }

    /// Whether a number is a valid brake.
    pub(super) fn is_brake(brake: &f64) -> bool {
        (0.0..=1.0).contains(brake)
    }

    /// Whether there is nothing to record beyond what the stock build reports; the path is never recorded.
    pub fn is_empty(&self) -> bool {
        *self == Self { path: self.path.clone(), ..Self::default() }
    }
}

fn a_time<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    within(deserializer, Truth::is_time, "a time from 0 to 1e9 seconds")
}

fn a_brake<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    within(deserializer, Truth::is_brake, "a brake from 0 to 1")
}

fn within<'de, D: Deserializer<'de>>(
    deserializer: D,
    is_one: impl Fn(&f64) -> bool,
    expected: &str,
) -> Result<Option<f64>, D::Error> {
    match Option::<f64>::deserialize(deserializer)? {
        Some(got) if !is_one(&got) => Err(D::Error::custom(format_args!("expected {expected}, got {got}"))),
        value => Ok(value),
    }
}

/// A telemetry that cannot be read. The bridge answers it with a safe command.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TelemetryError {
    /// The payload is not an object.
    #[error("expected an object of telemetry, got {got:?}: {why}")]
    Json {
        /// The beginning of the payload.
        got: String,
        /// What the JSON reader says.
        why: String,
    },
    /// A field that every telemetry has is missing.
    #[error("expected the field {0}, got none")]
    Missing(&'static str),
    /// A field that should be text or a number is neither.
    #[error("{0}: expected a number or text, got another kind of JSON")]
    Kind(&'static str),
    /// The field's text is no number.
    #[error("{0}: {1}")]
    NotANumber(&'static str, NotANumber),
    /// The field's number means nothing.
    #[error("{0}: {1}")]
    OutOfRange(&'static str, OutOfRange),
    /// A simulator that cannot be driven by camera.
    #[error("{0}")]
    Undrivable(Undrivable),
}

/// Writes telemetry as the stock build does in a player's culture, key order and all.
///
/// `image` is base64. Only what the stock build sends is written.
pub fn encode_telemetry(telemetry: &Telemetry, image: &str, culture: Culture) -> String {
    format!(
        r#"42["telemetry",{{"steering_angle":"{}","throttle":"{}","speed":"{}","image":"{image}"}}]"#,
        culture.n4(telemetry.steering.get()),
        culture.n4(telemetry.throttle.get()),
        culture.n4(telemetry.speed.get()),
    )
}

/// Writes telemetry as the builds of the SelfOracle family do, ground truth and all.
///
/// `image` is base64. Truth that is `None` is left out. Without a lap number this is the stock build's text: bridges
/// recognise this family by `lapNumber`, and other truth alone would look like a dialect that is answered differently.
///
/// Keys come in the order of that family's `CommandServer.cs`, the picture last. Its bridges read counts and `sim_time`
/// with Python's `int()` and the rest with `float()`. So `sim_time` is in whole seconds, and `distance`, which soon
/// exceeds a thousand, has no grouping. Lapwing adds keys that others ignore: `sim_time_us`, the time in full, and,
/// if a scenario is played, `ttc`, the time to collision in seconds, and `gap`, the metres to what is ahead.
pub fn encode_superset(telemetry: &Telemetry, image: &str, culture: Culture) -> String {
    let truth = &telemetry.truth;
    if truth.lap.is_none() {
        return encode_telemetry(telemetry, image, culture);
    }
    let mut text = String::with_capacity(image.len() + 512);
    text.push_str(r#"42["telemetry",{"#);
    let mut field = |key: &str, value: Option<String>| {
        if let Some(value) = value {
            write!(text, r#""{key}":"{value}","#).expect("writing to a String cannot fail");
        }
    };
    let n4 = |value: f64| Some(culture.n4(value));
    let count = |count: u32| Some(count.to_string());
    field("steering_angle", n4(telemetry.steering.get()));
    field("throttle", n4(telemetry.throttle.get()));
    field("speed", n4(telemetry.speed.get()));
    field("lapNumber", truth.lap.and_then(count));
    field("currentWayPoint", truth.waypoint.and_then(count));
    field("crash", truth.crashed.and_then(|crashed| count(crashed.into())));
    field("tot_obes", truth.out_of_bounds.and_then(count));
    field("tot_crashes", truth.crashes.and_then(count));
    field("distance", truth.distance.map(|distance| culture.f4(distance.get())));
    field("cte", truth.cte.and_then(|cte| n4(cte.get())));
    field("brake", truth.brake.and_then(n4));
    field("sim_time", truth.sim_time_s.map(|s| format!("{:.0}", s.floor())));
    field("ang_diff", truth.heading_error.and_then(|error| n4(error.get())));
    field("ttc", truth.time_to_collision_s.and_then(n4));
    field("gap", truth.gap.and_then(|gap| n4(gap.get())));
    field("sim_time_us", truth.sim_time_s.map(|s| format!("{:.0}", s * 1e6)));
    text.push_str(r#""image":""#);
    text.push_str(image);
    text.push_str(r#""}]"#);
    text
}
