//! Settings of the headless simulator.

use serde::{Deserialize, Serialize};

use crate::car;

/// `[simulator]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatorSettings {
    /// `lake`, `jungle`, `mountain`, `random:SEED`, `random-lanes:SEED`, or the path of a track file. Default `lake`.
    pub track: String,
    /// Telemetries a second of simulated time. Default 15, as the stock recorder.
    pub hz: f64,
    /// What happens after a crash. Default `stop`.
    pub on_crash: OnCrash,
    /// What counts as a crash.
    pub rules: Rules,
}

/// What happens after a crash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum OnCrash {
    /// The run ends.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    #[default]
    Stop,
    /// The car is put at the next waypoint and the run continues, as in SelfOracle's build. In this mode leaving the
    /// road counts as a crash, too.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Reset,
}

impl Default for SimulatorSettings {
    fn default() -> Self {
        Self { track: "lake".into(), hz: 15.0, on_crash: OnCrash::Stop, rules: Rules::default() }
    }
}

/// `[simulator.rules]`: what counts as off the road, stuck and so on. The defaults are those of the forks.
#[derive(Serialize, Deserialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct Rules {
    /// How far from the road's middle the car's origin may be, in metres. Half the road's width by default; forks use
    /// 3.0 and 7.0.
    pub off_road_m: Option<f64>,
    /// A car below this speed is stuck, mph …
    pub stuck_mph: f64,
    /// … if it stays below it for this long, with throttle all the while, in seconds: 120 game frames at 60 Hz.
    pub stuck_s: f64,
    /// How long after the start or a reset it may stand, in seconds.
    pub grace_s: f64,
    /// How near something ahead of the front must be for the car to count as waiting for it, in metres: twice the
    /// distance at which drivers stop in a queue.
    pub waiting_m: f64,
    /// How far it may face away from the road's direction, in degrees.
    pub wrong_way_deg: f64,
    /// For how long it may do so, in seconds.
    pub wrong_way_s: f64,
    /// Metres between waypoints, rounded so that they divide the road.
    pub waypoint_spacing_m: f64,
    /// Seconds without contact after which touching the same thing is another collision.
    pub apart_s: f64,
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            off_road_m: None,
            stuck_mph: car::STUCK_MPH,
            stuck_s: car::STUCK_S,
            grace_s: car::GRACE_S,
            waiting_m: 6.0,
            wrong_way_deg: 90.0,
            wrong_way_s: 1.0,
            waypoint_spacing_m: 20.0,
            apart_s: 1.0,
        }
    }
}

/// A rule whose value is out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("rule {rule}: expected {min} to {max}, got {got}")]
pub struct RulesError {
    /// The rule's key.
    pub rule: &'static str,
    /// Smallest value allowed.
    pub min: f64,
    /// Largest value allowed.
    pub max: f64,
    /// The value given.
    pub got: f64,
}

impl Rules {
    /// Checks rules that came from a file.
    ///
    /// # Errors
    /// [`RulesError`] for the first that is not finite or out of range.
    pub fn check(&self) -> Result<(), RulesError> {
        for (rule, min, max, got) in [
            ("off_road_m", 0.1, 100.0, self.off_road_m.unwrap_or(1.0)),
            ("stuck_mph", 0.0, 30.0, self.stuck_mph),
            ("stuck_s", 0.1, 3600.0, self.stuck_s),
            ("grace_s", 0.0, 3600.0, self.grace_s),
            ("waiting_m", 0.0, 100.0, self.waiting_m),
            ("wrong_way_deg", 30.0, 180.0, self.wrong_way_deg),
            ("wrong_way_s", 0.0, 3600.0, self.wrong_way_s),
            ("waypoint_spacing_m", 5.0, 500.0, self.waypoint_spacing_m),
            ("apart_s", 0.0, 3600.0, self.apart_s),
        ] {
            if !(min..=max).contains(&got) {
                return Err(RulesError { rule, min, max, got });
            }
        }
        Ok(())
    }
}
