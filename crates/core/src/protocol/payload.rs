//! The payload of a `telemetry` event: from its known fields to a [`Telemetry`].

mod fields;

use std::borrow::Cow;

use bytes::Bytes;
use serde_json::value::RawValue;

use self::fields::{KnownFields, Scalar};
use super::{CameraImage, Dialect, Telemetry, TelemetryError, Truth, number, packet::cut};
use crate::units::{MetresPerSecond, SpeedUnit};

/// A telemetry's payload with its fields as received. It borrows from the message.
pub struct Payload<'a>(KnownFields<'a>);

impl<'a> Payload<'a> {
    /// Reads the payload of a `telemetry` (or `car_telemetry`) event. `None` is a
    /// human driving: `null`, `{}` or no payload at all.
    ///
    /// # Errors
    /// [`TelemetryError::Json`] for anything but an object.
    pub fn read(payload: Option<&'a RawValue>) -> Result<Option<Self>, TelemetryError> {
        let Some(payload) = payload.map(RawValue::get).filter(|p| *p != "null") else {
            return Ok(None);
        };
        if payload.trim_start_matches('{').trim() == "}" {
            return Ok(None);
        }
        let fields = serde_json::from_str(payload)
            .map_err(|e| TelemetryError::Json { got: payload.chars().take(40).collect(), why: cut(&e.to_string()) })?;
        Ok(Some(Self(fields)))
    }

    /// Which simulator sends a first telemetry with these fields in this event.
    ///
    /// # Errors
    /// [`TelemetryError::Undrivable`] for one that cannot be driven by camera.
    pub fn dialect(&self, event: &str) -> Result<Dialect, TelemetryError> {
        Dialect::detect(event, |name| self.0.get(name).is_some()).map_err(TelemetryError::Undrivable)
    }

    /// What separates the decimals of its numbers, if they are written as the simulator writes them.
    pub fn decimal_separator(&self) -> Option<char> {
        let Some(Scalar::Text(speed)) = self.0.get("speed") else { return None };
        number::decimal_separator(speed)
    }

    /// The telemetry. `message` is the text that the payload was borrowed from:
    /// the image is a slice of it, not a copy.
    ///
    /// # Errors
    /// [`TelemetryError`], which names the field, what was expected and what came.
    pub fn telemetry(&self, message: &Bytes, speed_unit: SpeedUnit) -> Result<Telemetry, TelemetryError> {
        let fields = &self.0;
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
        Ok(Telemetry {
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
                brake: fields.number("brake").ok().filter(Truth::is_brake),
                distance: fields.optional("distance"),
                sim_time_s: fields
                    .number("sim_time_us")
                    .map(|us| us / 1e6)
                    .or_else(|_| fields.number("sim_time"))
                    .ok()
                    .filter(Truth::is_time),
                time_to_collision_s: fields.number("ttc").ok().filter(Truth::is_time),
                gap: fields.optional("gap"),
                heading_error: fields.optional("ang_diff"),
                position: position(),
                hit: fields.text("hit").filter(|hit| hit != "none"),
                track: fields.text("track"),
                timestamp: fields.text("timestamp"),
                path: Vec::new(),
            },
        })
    }
}

/// Whether `part` lies inside `whole`'s memory.
fn contains(whole: &Bytes, part: &str) -> bool {
    let (whole, part) = (whole.as_ptr_range(), part.as_bytes().as_ptr_range());
    whole.start <= part.start && part.end <= whole.end
}

#[cfg(test)]
mod tests;
