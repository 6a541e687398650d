//! Who answered, and the answer as runs hold it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::units::{Steering, Throttle};

/// Who decided a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// The model.
    #[default]
    Pilot,
    /// A person at the simulator's keyboard.
    Human,
    /// Nobody: the safe answer to a frame that cannot be used.
    Safe,
    /// Nobody: the pilot is switched off.
    Off,
}

/// An answer to the simulator and how it came about.
///
/// JSON has no NaN: a number here that is not finite reads back as `None`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CommandRecord {
    /// Who decided.
    pub by: By,
    /// The steering sent.
    pub steering: Steering,
    /// The throttle sent.
    pub throttle: Throttle,
    /// The network's raw output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prediction: Option<f64>,
    /// The proportional part of the speed controller's output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p: Option<f64>,
    /// Its integral part.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub i: Option<f64>,
    /// Whether the speed controller's output was cut to the throttle's range.
    pub saturated: bool,
    /// How far ahead of its picture the road was shown to the network, because commands take effect late.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ahead_ns: Option<u64>,
    /// How much an emergency brake is due, as a guard sees it, on its own scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brake_due: Option<f64>,
    /// Time in the guard, if one watched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guard_ns: Option<u64>,
    /// Time to decode base64 and JPEG.
    pub decode_ns: u64,
    /// Time to crop, scale and normalise.
    pub preprocess_ns: u64,
    /// Time in the network.
    pub forward_ns: u64,
    /// Total time in the driver.
    pub driver_ns: u64,
    /// From message in to answer out, as far as it is known when this is recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latency_ns: Option<u64>,
}

impl CommandRecord {
    /// What a person at the wheel did, without prediction, controller or latency.
    pub fn of_human(steering: Steering, throttle: Throttle) -> Self {
        Self {
            by: By::Human,
            steering,
            throttle,
            prediction: None,
            p: None,
            i: None,
            saturated: false,
            ahead_ns: None,
            brake_due: None,
            guard_ns: None,
            decode_ns: 0,
            preprocess_ns: 0,
            forward_ns: 0,
            driver_ns: 0,
            latency_ns: None,
        }
    }
}
