//! The forks of the simulator, and how each is recognised.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The simulator's dialect, recognised by the fields of its first telemetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Dialect {
    /// The stock simulator of Udacity's term 1: 2016 and 2017 builds and their ports to Unity 2019 and 2020.
    Term1,
    /// Term 2's PID project: adds the cross-track error, wants numbers, adds a bias of one degree itself.
    Term2Pid,
    /// SelfOracle and its successors: laps, waypoints and crashes.
    SelfOracle,
    /// The forks of maxitwo and steflamb: position and collisions, sent by a timer at 20 Hz.
    Positioned,
    /// udacity-gym: `car_telemetry`, sent by a timer; answered with `action`.
    UdacityGym,
}

/// Simulators of Udacity's other projects: a field that only their telemetry has, and what they are called.
const OTHERS: [(&str, &str); 6] = [
    ("sensor_measurement", "the term 2 Kalman filter simulator (EKF and UKF projects)"),
    ("hunter_x", "the term 2 Run Away Robot simulator (UKF project)"),
    ("sense_x", "the term 2 Kidnapped Vehicle simulator (particle filter project)"),
    ("ptsx", "the term 2 MPC simulator"),
    ("previous_path_x", "the term 3 Path Planning simulator"),
    ("dbw_enable", "the term 3 System Integration simulator"),
];

/// Why a simulator cannot be driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Undrivable {
    /// Known, and without a picture in its telemetry.
    #[error(
        "this is {name}: its telemetry has {sign} and no camera image, and Lapwing drives by the camera. \
         Start the term 1 simulator in autonomous mode"
    )]
    Other {
        /// What it is called.
        name: &'static str,
        /// The field of its telemetry that identifies it.
        sign: &'static str,
    },
    /// Without a picture and not known.
    #[error(
        "this telemetry has no image: no simulator that Lapwing knows sends that. Is it the term 1 simulator in \
         autonomous mode?"
    )]
    NoImage,
}

impl Dialect {
    /// Recognises the dialect by an event's name and the fields of its payload; an error says why Lapwing cannot drive
    /// it.
    pub(super) fn detect(event: &str, has: impl Fn(&str) -> bool) -> Result<Self, Undrivable> {
        Ok(match () {
            () if event == "car_telemetry" => Self::UdacityGym,
            () if has("pos_x") => Self::Positioned,
            () if has("lapNumber") => Self::SelfOracle,
            () if has("cte") && has("image") => Self::Term2Pid,
            () if has("image") => Self::Term1,
            () => {
                let known = OTHERS.into_iter().find(|(sign, _)| has(sign));
                return Err(known.map_or(Undrivable::NoImage, |(sign, name)| Undrivable::Other { name, sign }));
            }
        })
    }

    /// Whether a timer sends the telemetry, whatever the answers, instead of one for each answer.
    pub fn is_timer_driven(self) -> bool {
        matches!(self, Self::Positioned | Self::UdacityGym)
    }
}

impl fmt::Display for Dialect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Term1 => "term 1 (stock)",
            Self::Term2Pid => "term 2 PID",
            Self::SelfOracle => "SelfOracle-style",
            Self::Positioned => "pos_x-style (maxitwo, steflamb)",
            Self::UdacityGym => "udacity-gym",
        })
    }
}
