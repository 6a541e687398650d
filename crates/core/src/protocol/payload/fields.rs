//! The known fields of a payload, read off the JSON without keeping the rest.

use std::{borrow::Cow, fmt};

use serde::{
    Deserialize,
    de::{IgnoredAny, MapAccess, SeqAccess, Visitor},
};

use crate::{
    protocol::{TelemetryError, number},
    units::OutOfRange,
};

/// One value of the payload.
pub(super) enum Scalar<'a> {
    Text(Cow<'a, str>),
    Number(f64),
    Null,
    Other,
}

/// The known fields, in the order of `values`.
const FIELDS: [&str; 32] = [
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
    "sim_time_us",
    "ttc",
    "gap",
    "ang_diff",
    "pos_x",
    "pos_y",
    "pos_z",
    "hit",
    "track",
    "timestamp",
    // These identify simulators that cannot be driven, see `dialect`.
    "ptsx",
    "sensor_measurement",
    "hunter_x",
    "sense_x",
    "previous_path_x",
    "dbw_enable",
];

/// The payload's known fields; unknown ones are skipped without being kept.
pub(super) struct KnownFields<'a> {
    values: [Option<Scalar<'a>>; FIELDS.len()],
}

impl<'a> KnownFields<'a> {
    pub(super) fn get(&self, name: &str) -> Option<&Scalar<'a>> {
        let i = FIELDS.iter().position(|f| *f == name)?;
        self.values[i].as_ref().filter(|v| !matches!(v, Scalar::Null))
    }

    /// A required number.
    pub(super) fn number(&self, name: &'static str) -> Result<f64, TelemetryError> {
        match self.get(name) {
            None => Err(TelemetryError::Missing(name)),
            Some(Scalar::Number(value)) => Ok(*value),
            Some(Scalar::Text(text)) => number::parse(text).map_err(|e| TelemetryError::NotANumber(name, e)),
            Some(_) => Err(TelemetryError::Kind(name)),
        }
    }

    pub(super) fn quantity<Q: TryFrom<f64, Error = OutOfRange>>(
        &self,
        name: &'static str,
    ) -> Result<Q, TelemetryError> {
        Q::try_from(self.number(name)?).map_err(|e| TelemetryError::OutOfRange(name, e))
    }

    /// A number that a fork may leave out, leave empty or get wrong; ground truth is never worth a bad frame.
    pub(super) fn optional<Q: TryFrom<f64>>(&self, name: &'static str) -> Option<Q> {
        Q::try_from(self.number(name).ok()?).ok()
    }

    pub(super) fn count(&self, name: &'static str) -> Option<u32> {
        self.number(name).ok().filter(|v| (0.0..=f64::from(u32::MAX)).contains(v)).map(|v| v as u32)
    }

    pub(super) fn text(&self, name: &str) -> Option<String> {
        match self.get(name)? {
            Scalar::Text(text) if !text.is_empty() => Some(text.chars().take(200).collect()),
            Scalar::Number(value) => Some(value.to_string()),
            _ => None,
        }
    }
}

impl<'de> Deserialize<'de> for Scalar<'de> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ScalarVisitor;
        impl<'de> Visitor<'de> for ScalarVisitor {
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
        deserializer.deserialize_any(ScalarVisitor)
    }
}

impl<'de> Deserialize<'de> for KnownFields<'de> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct FieldsVisitor;
        impl<'de> Visitor<'de> for FieldsVisitor {
            type Value = KnownFields<'de>;
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
                Ok(KnownFields { values })
            }
        }
        deserializer.deserialize_map(FieldsVisitor)
    }
}

#[derive(Deserialize)]
struct Key<'a>(#[serde(borrow)] Cow<'a, str>);
