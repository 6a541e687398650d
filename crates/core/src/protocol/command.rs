//! Commands: steering and throttle in every dialect, and how the
//! simulator's own client reads them.

use std::fmt::Write;

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::{
    Dialect,
    number::{self, Culture},
};
use crate::units::{Steering, Throttle};

/// The number of laps after which a SelfOracle build ends its episode; it wants one in every answer.
/// Large, because the bridge does not end anybody's drive.
pub const MAX_LAPS: u32 = 1_000_000;

/// Steering and throttle, both normalised.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Command {
    /// -1 full left to 1 full right.
    pub steering: Steering,
    /// 1 full power to -1 full brake; below 5 mph negative reverses.
    pub throttle: Throttle,
}

/// The answer to a telemetry. Either variant returns the simulator's token.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer {
    /// The pilot drives.
    Steer(Command),
    /// The human does.
    Manual,
}

impl Answer {
    /// The event's name and its payload as JSON, in the dialect of a simulator.
    /// `None` is a dialect not yet known; it is answered as the stock simulator is.
    pub fn event(self, dialect: Option<Dialect>) -> (&'static str, String) {
        let Self::Steer(Command { steering, throttle }) = self else {
            return ("manual", "{}".into());
        };
        let dialect = dialect.unwrap_or(Dialect::Term1);
        // Term 2 wants bare numbers; the notation is valid JSON, too.
        let quote = if dialect == Dialect::Term2Pid { "" } else { "\"" };
        let mut json = String::with_capacity(128);
        let mut field = |lead: char, name: &str, value: f64| {
            write!(json, "{lead}\"{name}\":{quote}").expect("writing to a String cannot fail");
            number::write_universal(&mut json, value);
            json.push_str(quote);
        };
        field('{', "steering_angle", steering.get());
        field(',', "throttle", throttle.get());
        if dialect == Dialect::SelfOracle {
            // No anomaly detector runs here: full confidence, no loss.
            field(',', "confidence", 1.0);
            field(',', "loss", 0.0);
            write!(json, ",\"max_laps\":\"{MAX_LAPS}\"").expect("writing to a String cannot fail");
        }
        json.push('}');
        (if dialect == Dialect::UdacityGym { "action" } else { "steer" }, json)
    }

    /// The whole text message, `42["name",{…}]`.
    pub fn encode(self, dialect: Option<Dialect>) -> String {
        let (name, payload) = self.event(dialect);
        format!(r#"42["{name}",{payload}]"#)
    }
}

/// Why the stock simulator swallows a `steer` and loses its token.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SteerError {
    /// The field is not in the payload.
    #[error("the simulator loses this answer: {0} is missing")]
    Missing(&'static str),
    /// A JSON number or something else where the simulator wants a string.
    #[error("the simulator loses this answer: expected {0} as a string, got {1}")]
    NotAString(&'static str, String),
    /// Text that `float.Parse` does not read in the player's culture.
    #[error("the simulator loses this answer: {0}: {1}")]
    NotANumber(&'static str, number::NotANumber),
}

impl Command {
    /// Reads the payload of a `steer` as the stock simulator does in `culture`.
    ///
    /// # Errors
    /// [`SteerError`] if the simulator would swallow it.
    pub fn parse_as_simulator(payload: Option<&RawValue>, culture: Culture) -> Result<Self, SteerError> {
        let fields: serde_json::Map<String, serde_json::Value> =
            payload.and_then(|p| serde_json::from_str(p.get()).ok()).unwrap_or_default();
        let field = |name: &'static str| match fields.get(name) {
            None => Err(SteerError::Missing(name)),
            Some(serde_json::Value::String(text)) => {
                culture.float_parse(text).map_err(|e| SteerError::NotANumber(name, e))
            }
            Some(other) => Err(SteerError::NotAString(name, other.to_string().chars().take(40).collect())),
        };
        // The simulator clamps both where it applies them.
        Ok(Self {
            steering: Steering::saturating(field("steering_angle")?),
            throttle: Throttle::saturating(field("throttle")?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(steering: f64, throttle: f64) -> Answer {
        Answer::Steer(Command {
            steering: Steering::new(steering).unwrap(),
            throttle: Throttle::new(throttle).unwrap(),
        })
    }

    #[test]
    fn each_dialect_gets_its_literal_bytes() {
        let answer = command(-0.1234, 0.3);
        for (dialect, text) in [
            (None, r#"42["steer",{"steering_angle":"-1234e-4","throttle":"3000e-4"}]"#),
            (Some(Dialect::Term1), r#"42["steer",{"steering_angle":"-1234e-4","throttle":"3000e-4"}]"#),
            (Some(Dialect::Positioned), r#"42["steer",{"steering_angle":"-1234e-4","throttle":"3000e-4"}]"#),
            (Some(Dialect::Term2Pid), r#"42["steer",{"steering_angle":-1234e-4,"throttle":3000e-4}]"#),
            (
                Some(Dialect::SelfOracle),
                r#"42["steer",{"steering_angle":"-1234e-4","throttle":"3000e-4","confidence":"10000e-4","loss":"0e-4","max_laps":"1000000"}]"#,
            ),
            (Some(Dialect::UdacityGym), r#"42["action",{"steering_angle":"-1234e-4","throttle":"3000e-4"}]"#),
        ] {
            assert_eq!(answer.encode(dialect), text);
            assert_eq!(Answer::Manual.encode(dialect), r#"42["manual",{}]"#);
        }
    }

    #[test]
    fn term_2_numbers_are_json() {
        let text = command(0.5, -1.0).encode(Some(Dialect::Term2Pid));
        let value: serde_json::Value = serde_json::from_str(&text[2..]).unwrap();
        assert_eq!(value[1]["steering_angle"], 0.5);
        assert_eq!(value[1]["throttle"], -1.0);
    }

    #[test]
    fn the_simulator_reads_our_answer_in_every_culture() {
        let text = command(-0.5, 0.25).encode(None);
        let Ok(super::super::Packet::Event(event)) = super::super::Packet::parse(&text) else { panic!("{text}") };
        for culture in Culture::ALL {
            let Command { steering, throttle } = Command::parse_as_simulator(event.payload, culture).unwrap();
            assert_eq!((steering.get(), throttle.get()), (-0.5, 0.25), "{}", culture.name);
        }
    }

    #[test]
    fn the_simulator_swallows_numbers_and_missing_fields() {
        let raw = |text: &str| RawValue::from_string(text.into()).unwrap();
        let parse = |text: &str| Command::parse_as_simulator(Some(&raw(text)), Culture::ALL[0]).unwrap_err();
        assert_eq!(parse(r#"{"throttle":"1"}"#), SteerError::Missing("steering_angle"));
        assert_eq!(
            parse(r#"{"steering_angle":0.5,"throttle":"1"}"#),
            SteerError::NotAString("steering_angle", "0.5".into())
        );
        assert!(matches!(parse(r#"{"steering_angle":"NaN","throttle":"1"}"#), SteerError::NotANumber(..)));
    }
}
