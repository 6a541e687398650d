//! Telemetry: one message from a simulator as typed values with units, and
//! written as the stock build writes it.

use std::{borrow::Cow, fmt};

use bytes::Bytes;
use serde::{
    Deserialize, Serialize,
    de::{IgnoredAny, MapAccess, SeqAccess, Visitor},
};
use serde_json::value::RawValue;

use super::{
    dialect::{Detected, Dialect},
    number::{self, Culture, NotANumber},
};
use crate::units::{Degrees, Metres, MetresPerSecond, Mph, OutOfRange, SpeedUnit, Throttle};

/// One message from a simulator, decoded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// What forks tell beyond the stock build.
    #[serde(default, skip_serializing_if = "Truth::is_empty")]
    pub truth: Truth,
}

/// A camera picture as it came, still to be decoded by `perception`.
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
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
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
    #[serde(skip_serializing_if = "Option::is_none")]
    pub brake: Option<f64>,
    /// Distance driven.
    #[serde(rename = "distance_m", skip_serializing_if = "Option::is_none")]
    pub distance: Option<Metres>,
    /// The simulator's own time, in seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sim_time_s: Option<f64>,
    /// Angle between the car's heading and the road's.
    #[serde(rename = "heading_error_deg", skip_serializing_if = "Option::is_none")]
    pub heading_error: Option<Degrees>,
    /// Position x (right), y (up), z (forward), Unity's axes.
    #[serde(rename = "position_m", skip_serializing_if = "Option::is_none")]
    pub position: Option<[Metres; 3]>,
    /// The collider that is hit, if one is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hit: Option<String>,
    /// The track's name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track: Option<String>,
    /// The simulator's timestamp, as it wrote it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<String>,
}

impl Truth {
    /// Whether nothing was told beyond the stock build.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// A telemetry that cannot be read. The bridge answers it with a safe command.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TelemetryError {
    /// The payload is not what its kind should be.
    #[error("expected an object of telemetry, got {got:?}: {why}")]
    Json {
        /// The beginning of the payload.
        got: String,
        /// What the JSON reader says.
        why: String,
    },
    /// A field that every telemetry has is not there.
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
    Unsupported(&'static str),
}

/// One value of the payload.
enum Scalar<'a> {
    Text(Cow<'a, str>),
    Number(f64),
    Null,
    Other,
}

/// The fields that mean something, in the order of `values`.
const FIELDS: [&str; 24] = [
    "steering_angle",
    "throttle",
    "speed",
    "image",
    "cte",
    "next_cte",
    "lapNumber",
    "lap",
    "currentWayPoint",
    "sector",
    "crash",
    "tot_obes",
    "tot_crashes",
    "brake",
    "distance",
    "sim_time",
    "ang_diff",
    "pos_x",
    "pos_y",
    "pos_z",
    "hit",
    "track",
    "timestamp",
    "ptsx",
];

/// The payload's known fields; unknown ones are skipped without being kept.
struct Fields<'a> {
    values: [Option<Scalar<'a>>; FIELDS.len()],
}

impl<'a> Fields<'a> {
    fn get(&self, name: &str) -> Option<&Scalar<'a>> {
        let i = FIELDS.iter().position(|f| *f == name)?;
        self.values[i].as_ref().filter(|v| !matches!(v, Scalar::Null))
    }

    /// A number that must be there.
    fn number(&self, name: &'static str) -> Result<f64, TelemetryError> {
        match self.get(name) {
            None => Err(TelemetryError::Missing(name)),
            Some(Scalar::Number(value)) => Ok(*value),
            Some(Scalar::Text(text)) => number::parse(text).map_err(|e| TelemetryError::NotANumber(name, e)),
            Some(_) => Err(TelemetryError::Kind(name)),
        }
    }

    fn quantity<Q: TryFrom<f64, Error = OutOfRange>>(&self, name: &'static str) -> Result<Q, TelemetryError> {
        Q::try_from(self.number(name)?).map_err(|e| TelemetryError::OutOfRange(name, e))
    }

    /// A number that a fork may leave out, leave empty or get wrong; ground truth is never worth a bad frame.
    fn optional<Q: TryFrom<f64>>(&self, name: &'static str) -> Option<Q> {
        Q::try_from(self.number(name).ok()?).ok()
    }

    fn count(&self, name: &'static str) -> Option<u32> {
        self.number(name).ok().filter(|v| (0.0..=f64::from(u32::MAX)).contains(v)).map(|v| v as u32)
    }

    fn text(&self, name: &str) -> Option<String> {
        match self.get(name)? {
            Scalar::Text(text) if !text.is_empty() => Some(text.chars().take(200).collect()),
            Scalar::Number(value) => Some(value.to_string()),
            _ => None,
        }
    }
}

impl<'de> Deserialize<'de> for Scalar<'de> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct V;
        impl<'de> Visitor<'de> for V {
            type Value = Scalar<'de>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a value")
            }
            fn visit_borrowed_str<E>(self, v: &'de str) -> Result<Self::Value, E> {
                Ok(Scalar::Text(Cow::Borrowed(v)))
            }
            fn visit_str<E>(self, v: &str) -> Result<Self::Value, E> {
                Ok(Scalar::Text(Cow::Owned(v.to_owned())))
            }
            fn visit_f64<E>(self, v: f64) -> Result<Self::Value, E> {
                Ok(Scalar::Number(v))
            }
            fn visit_i64<E>(self, v: i64) -> Result<Self::Value, E> {
                Ok(Scalar::Number(v as f64))
            }
            fn visit_u64<E>(self, v: u64) -> Result<Self::Value, E> {
                Ok(Scalar::Number(v as f64))
            }
            fn visit_bool<E>(self, v: bool) -> Result<Self::Value, E> {
                Ok(Scalar::Number(f64::from(u8::from(v))))
            }
            fn visit_unit<E>(self) -> Result<Self::Value, E> {
                Ok(Scalar::Null)
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
                while seq.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Scalar::Other)
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(Scalar::Other)
            }
        }
        deserializer.deserialize_any(V)
    }
}

impl<'de> Deserialize<'de> for Fields<'de> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct V;
        impl<'de> Visitor<'de> for V {
            type Value = Fields<'de>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of telemetry")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut values = [const { None }; FIELDS.len()];
                while let Some(Key(key)) = map.next_key()? {
                    match FIELDS.iter().position(|f| *f == key) {
                        Some(i) => values[i] = Some(map.next_value()?),
                        None => drop(map.next_value::<IgnoredAny>()?),
                    }
                }
                Ok(Fields { values })
            }
        }
        deserializer.deserialize_map(V)
    }
}

#[derive(Deserialize)]
struct Key<'a>(#[serde(borrow)] Cow<'a, str>);

/// Reads the payload of a `telemetry` (or `car_telemetry`) event.
///
/// `message` is the text that `payload` was borrowed from: the image is a slice
/// of it, not a copy. `known` is the dialect of this connection if one has been
/// told already; otherwise this telemetry tells it. `Ok(None)` is a human
/// driving: `null`, `{}` or no payload at all.
///
/// # Errors
/// [`TelemetryError`], which names the field, what was expected and what came.
pub fn decode_telemetry(
    message: &Bytes,
    event: &str,
    payload: Option<&RawValue>,
    known: Option<Dialect>,
    speed_unit: SpeedUnit,
) -> Result<Option<(Dialect, Telemetry)>, TelemetryError> {
    let Some(payload) = payload.map(RawValue::get).filter(|p| *p != "null") else {
        return Ok(None);
    };
    if payload.trim_start_matches('{').trim() == "}" {
        return Ok(None);
    }
    let fields: Fields<'_> = serde_json::from_str(payload)
        .map_err(|e| TelemetryError::Json { got: payload.chars().take(40).collect(), why: e.to_string() })?;
    let dialect = match known {
        Some(dialect) => dialect,
        None => match Dialect::detect(event, |name| fields.get(name).is_some()) {
            Detected::Known(dialect) => dialect,
            Detected::Unsupported(why) => return Err(TelemetryError::Unsupported(why)),
        },
    };
    let speed = match speed_unit {
        SpeedUnit::Mph => fields.quantity("speed")?,
        SpeedUnit::MetresPerSecond => fields.quantity::<MetresPerSecond>("speed")?.mph(),
    };
    let image = match fields.get("image") {
        None => return Err(TelemetryError::Missing("image")),
        Some(Scalar::Text(Cow::Borrowed(text))) if contains(message, text) => message.slice_ref(text.as_bytes()),
        Some(Scalar::Text(text)) => Bytes::copy_from_slice(text.as_bytes()),
        Some(_) => return Err(TelemetryError::Kind("image")),
    };
    let position = || Some([fields.optional("pos_x")?, fields.optional("pos_y")?, fields.optional("pos_z")?]);
    let telemetry = Telemetry {
        steering: fields.quantity("steering_angle")?,
        throttle: fields.quantity("throttle")?,
        speed,
        image: CameraImage::Base64(image),
        truth: Truth {
            cte: fields.optional("cte"),
            next_cte: fields.optional("next_cte"),
            lap: fields.count("lapNumber").or_else(|| fields.count("lap")),
            waypoint: fields.count("currentWayPoint"),
            sector: fields.count("sector"),
            crashed: fields.number("crash").ok().map(|v| v != 0.0),
            out_of_bounds: fields.count("tot_obes"),
            crashes: fields.count("tot_crashes"),
            brake: fields.number("brake").ok(),
            distance: fields.optional("distance"),
            sim_time_s: fields.number("sim_time").ok(),
            heading_error: fields.optional("ang_diff"),
            position: position(),
            hit: fields.text("hit").filter(|hit| hit != "none"),
            track: fields.text("track"),
            timestamp: fields.text("timestamp"),
        },
    };
    Ok(Some((dialect, telemetry)))
}

/// Whether `part` lies inside `whole`'s memory.
fn contains(whole: &Bytes, part: &str) -> bool {
    let (whole, part) = (whole.as_ptr_range(), part.as_bytes().as_ptr_range());
    whole.start <= part.start && part.end <= whole.end
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

#[cfg(test)]
mod tests {
    use super::{super::Packet, *};

    fn decode(text: &str) -> Result<Option<(Dialect, Telemetry)>, TelemetryError> {
        let message = Bytes::copy_from_slice(text.as_bytes());
        let text = std::str::from_utf8(&message).unwrap();
        let Ok(Packet::Event(event)) = Packet::parse(text) else { panic!("not an event: {text}") };
        decode_telemetry(&message, &event.name, event.payload, None, SpeedUnit::Mph)
    }

    fn known(text: &str) -> (Dialect, Telemetry) {
        decode(text).unwrap().unwrap()
    }

    const STOCK: &str =
        r#"42["telemetry",{"steering_angle":"-1.2500","throttle":"0.3000","speed":"30.1903","image":"/9j/4AAQ"}]"#;

    #[test]
    fn the_stock_builds_telemetry_is_read() {
        let (dialect, telemetry) = known(STOCK);
        assert_eq!(dialect, Dialect::Term1);
        assert_eq!(telemetry.steering.get(), -1.25);
        assert_eq!(telemetry.throttle.get(), 0.3);
        assert_eq!(telemetry.speed.get(), 30.1903);
        assert_eq!(telemetry.image, CameraImage::Base64(Bytes::from_static(b"/9j/4AAQ")));
        assert!(telemetry.truth.is_empty());
    }

    #[test]
    fn the_image_is_a_slice_of_the_message() {
        let message = Bytes::from_static(STOCK.as_bytes());
        let Ok(Packet::Event(event)) = Packet::parse(STOCK) else { panic!() };
        let (_, telemetry) =
            decode_telemetry(&message, "telemetry", event.payload, None, SpeedUnit::Mph).unwrap().unwrap();
        let CameraImage::Base64(image) = telemetry.image else { panic!() };
        assert!(message.as_ptr_range().contains(&image.as_ptr()));
    }

    #[test]
    fn what_we_write_as_the_stock_build_is_its_literal_text() {
        let (_, telemetry) = known(STOCK);
        assert_eq!(encode_telemetry(&telemetry, "/9j/4AAQ", Culture::ALL[0]), STOCK);
        let german = encode_telemetry(&telemetry, "/9j/4AAQ", Culture::named("de-DE").unwrap());
        assert_eq!(known(&german).1, telemetry);
    }

    #[test]
    fn null_an_empty_object_and_no_payload_are_a_human_driving() {
        for text in [r#"42["telemetry",null]"#, r#"42["telemetry",{}]"#, r#"42["telemetry",{ }]"#, r#"42["telemetry"]"#]
        {
            assert_eq!(decode(text), Ok(None), "{text}");
        }
    }

    #[test]
    fn forks_are_told_apart_by_their_first_telemetry() {
        let with = |extra: &str| {
            known(&format!(
                r#"42["telemetry",{{"steering_angle":"0.0000","throttle":"0.0000","speed":"1.0000","image":"x",{extra}}}]"#
            ))
        };
        let (dialect, telemetry) = with(r#""cte":"-0.7598""#);
        assert_eq!((dialect, telemetry.truth.cte.unwrap().get()), (Dialect::Term2Pid, -0.7598));

        let (dialect, telemetry) = with(
            r#""lapNumber":"2","currentWayPoint":"17","crash":"1","tot_obes":"3","tot_crashes":"4","cte":"1,2500","distance":"5.5","sim_time":"60.2","ang_diff":"-3.1""#,
        );
        assert_eq!(dialect, Dialect::SelfOracle);
        let truth = telemetry.truth;
        assert_eq!((truth.lap, truth.waypoint, truth.crashed), (Some(2), Some(17), Some(true)));
        assert_eq!((truth.out_of_bounds, truth.crashes, truth.sim_time_s), (Some(3), Some(4), Some(60.2)));
        assert_eq!(truth.cte.unwrap().get(), 1.25);

        let (dialect, telemetry) =
            with(r#""pos_x":"1.0","pos_y":"2.0","pos_z":"-3.0","hit":"none","cte":"","track":"lake","lapNumber":"1""#);
        assert_eq!(dialect, Dialect::Positioned);
        assert_eq!(telemetry.truth.position.unwrap().map(Metres::get), [1.0, 2.0, -3.0]);
        assert_eq!((telemetry.truth.cte, telemetry.truth.hit), (None, None));

        let gym =
            STOCK.replace("telemetry", "car_telemetry").replace("}]", r#","timestamp":"12","lap":1,"sector":2}]"#);
        let (dialect, telemetry) = known(&gym);
        assert_eq!(dialect, Dialect::UdacityGym);
        assert_eq!((telemetry.truth.lap, telemetry.truth.sector), (Some(1), Some(2)));
    }

    #[test]
    fn simulators_without_a_camera_are_refused_in_words() {
        let error = decode(r#"42["telemetry",{"ptsx":[1,2],"ptsy":[3,4],"speed":1.5}]"#).unwrap_err();
        assert!(error.to_string().contains("term 2 MPC"), "{error}");
        let error = decode(r#"42["telemetry",{"speed":"1.5"}]"#).unwrap_err();
        assert!(error.to_string().contains("no image"), "{error}");
    }

    #[test]
    fn a_bad_field_is_named_with_what_it_holds() {
        let bad = |from: &str, to: &str| decode(&STOCK.replace(from, to)).unwrap_err().to_string();
        assert_eq!(bad(r#""speed":"30.1903","#, ""), "expected the field speed, got none");
        assert_eq!(bad("30.1903", "NaN"), r#"speed: expected a number, got "NaN""#);
        assert_eq!(bad("30.1903", "1e30"), "speed: expected a speed from -1000 to 1000 mph, got 1e30");
        assert_eq!(bad(r#""0.3000""#, "[]"), "throttle: expected a number or text, got another kind of JSON");
        assert_eq!(bad(r#""/9j/4AAQ""#, "7"), "image: expected a number or text, got another kind of JSON");
    }

    #[test]
    fn escapes_numbers_and_unknown_fields_are_taken_in_stride() {
        let text =
            STOCK.replace("/9j/", r"\/9j\/").replace(r#""30.1903""#, "30.25").replace("}]", r#","x":{"y":[1]}}]"#);
        let (_, telemetry) = known(&text);
        assert_eq!(telemetry.speed.get(), 30.25);
        assert_eq!(telemetry.image, CameraImage::Base64(Bytes::from_static(b"/9j/4AAQ")));
    }

    #[test]
    fn speed_in_metres_per_second_is_converted() {
        let message = Bytes::from_static(STOCK.as_bytes());
        let Ok(Packet::Event(event)) = Packet::parse(STOCK) else { panic!() };
        let (_, telemetry) =
            decode_telemetry(&message, "telemetry", event.payload, None, SpeedUnit::MetresPerSecond).unwrap().unwrap();
        assert!((telemetry.speed.get() - 30.1903 / 0.447_04).abs() < 1e-9);
    }

    #[test]
    fn mangled_telemetry_is_read_or_refused_and_never_panics() {
        let mut seed = 1u32;
        let mut random = |below: usize| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as usize % below
        };
        const BITS: [&str; 12] = ["\"", "{", "}", "[", "]", "\\", "null", "-", "1e9", ",", "\u{a0}", "\\ud800"];
        let mut refused = 0;
        for _ in 0..20_000 {
            let mut text = STOCK.to_owned();
            for _ in 0..=random(4) {
                let at = (0..=random(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
                if random(3) == 0 {
                    text.truncate(at.max(3));
                } else {
                    text.insert_str(at.max(2), BITS[random(BITS.len())]);
                }
            }
            let message = Bytes::from(text.clone());
            match Packet::parse(&text) {
                Ok(Packet::Event(event)) => {
                    let result = decode_telemetry(&message, &event.name, event.payload, None, SpeedUnit::Mph);
                    refused += u32::from(result.is_err_and(|e| !e.to_string().is_empty()));
                }
                other => refused += u32::from(other.is_err()),
            }
        }
        assert!(refused > 10_000, "{refused}");
    }
}
