//! What happens on the road in a run: a small TOML file.
//!
//! A [`Scenario`] says where our car begins and how fast, and what everything else does: parked, a lead car that
//! brakes, cruising, crossing. It is written in road coordinates that suit any track: `ahead_m` counts along the road
//! from where our car begins, `offset_m` to the right of the line it drives on. Each number may be a range or a list to
//! choose from ([`Draw`]); [`Scenario::settle`] draws them from a seed; [`Scenario::cases`] lists all choices, like the
//! table of a test protocol. [`super::traffic`] plays it.
//!
//! ```toml
//! name = "braking-ahead"
//! description = "The car ahead brakes."
//! duration_s = 30.0
//!
//! [ego]
//! speed_kmh = 48.0
//!
//! [[actor]]
//! script = "lead"
//! gap_m = [10.0, 40.0]                       # drawn from the seed
//! onset_s = [3.0, 8.0]
//! deceleration = { one_of = [2.0, 6.0] }     # a choice
//! ```

mod draw;

use serde::{Deserialize, Serialize};

use super::{
    scene::{ActorKind, Looks},
    track::Track,
};
pub use draw::Draw;
use lapwing_core::{
    units::{MPS_PER_KMH, MPS_PER_MPH},
    words::{did_you_mean, suggesting},
};

/// A run's start and everything else on the road.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Its name.
    pub name: String,
    /// What happens, and which protocol it follows.
    pub description: String,
    /// On which track, looked for from the current folder if it is a file; any if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub track: Option<String>,
    /// Our car.
    pub ego: Ego,
    /// Goes into every draw together with the run's own seed. 0 by default.
    #[serde(default)]
    pub seed: u64,
    /// When it is over, in seconds.
    pub duration_s: f64,
    /// From which wardrobe everything is drawn. Plain by default.
    #[serde(default, skip_serializing_if = "is_plain")]
    pub looks: Looks,
    /// Everything else, in the order in which hits name it.
    #[serde(default, rename = "actor")]
    pub actors: Vec<Script>,
}

/// Our car at the start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ego {
    /// Metres along the road; the track's start if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub s_m: Option<Draw>,
    /// Metres to the right of the road's middle; the track's driving line if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_m: Option<Draw>,
    /// How fast it rolls at the start, km/h. 0 by default.
    pub speed_kmh: Draw,
    /// The speed to hold, km/h; the speed at the start if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_kmh: Option<Draw>,
}

impl Default for Ego {
    fn default() -> Self {
        Self { s_m: None, offset_m: None, speed_kmh: Draw::Exactly(0.0), target_kmh: None }
    }
}

impl Ego {
    /// Distance along the road and offset at which it begins, in metres.
    pub fn start(&self, track: &Track) -> (f64, f64) {
        let start = track.file().start;
        let s = self
            .s_m
            .as_ref()
            .map_or_else(|| track.locate(glam::DVec3::new(start.x, start.y, start.z), None).station.s, Draw::value);
        (s, self.offset_m.as_ref().map_or(track.file().driving_line_m, Draw::value))
    }

    /// How fast it rolls at the start, mph.
    pub fn speed_mph(&self) -> f64 {
        self.speed_kmh.value() * MPS_PER_KMH / MPS_PER_MPH
    }

    /// The speed to hold, mph.
    pub fn target_mph(&self) -> f64 {
        self.target_kmh.as_ref().unwrap_or(&self.speed_kmh).value() * MPS_PER_KMH / MPS_PER_MPH
    }
}

/// What something on the road does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "script", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Script {
    /// Stands.
    Parked {
        /// What it is.
        kind: ActorKind,
        /// Metres along the road from our car's start to its middle.
        ahead_m: Draw,
        /// Metres to the right of our car's line. 0 by default.
        #[serde(default)]
        offset_m: Draw,
        /// Degrees clockwise from the road's direction. 0 by default.
        #[serde(default)]
        yaw_deg: Draw,
    },
    /// Drives ahead of our car at a constant gap, then brakes.
    Lead {
        /// What it is. A car by default.
        #[serde(default = "a_car")]
        kind: ActorKind,
        /// From our front bumper to its rear, in metres, at the start and held until the onset.
        gap_m: Draw,
        /// Metres to the right of our car's line. 0 by default.
        #[serde(default)]
        offset_m: Draw,
        /// Its speed at the start, km/h; our car's if absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        speed_kmh: Option<Draw>,
        /// When it brakes, in seconds from the start.
        onset_s: Draw,
        /// How hard, in m/s2, positive.
        deceleration: Draw,
        /// Seconds from the onset until it brakes that hard, building up evenly. 0 by default.
        #[serde(default)]
        build_up_s: Draw,
        /// The speed down to which it brakes, km/h. 0 by default.
        #[serde(default)]
        final_kmh: Draw,
    },
    /// Drives along the road at a constant speed.
    Cruise {
        /// What it is. A car by default.
        #[serde(default = "a_car")]
        kind: ActorKind,
        /// Metres along the road from our car's start to its middle; negative is behind.
        ahead_m: Draw,
        /// Metres to the right of our car's line. 0 by default.
        #[serde(default)]
        offset_m: Draw,
        /// Its speed, km/h.
        speed_kmh: Draw,
        /// Whether it comes towards our car. Not by default.
        #[serde(default)]
        oncoming: bool,
    },
    /// Drives ahead of our car at a constant gap, then slows down and leaves the lane sideways.
    TurnOff {
        /// What it is. A car by default.
        #[serde(default = "a_car")]
        kind: ActorKind,
        /// From our front bumper to its rear, in metres, at the start and held until the onset.
        gap_m: Draw,
        /// When it slows down, in seconds from the start.
        onset_s: Draw,
        /// How hard it slows down, in m/s2, positive.
        deceleration: Draw,
        /// The speed down to which it slows, and at which it turns, km/h.
        final_kmh: Draw,
        /// The steepest angle at which it leaves, in degrees from the road: 90 turns into a side road, 10 changes lane.
        angle_deg: Draw,
        /// Where it is at last, metres to the right of our car's line: it follows the road again there.
        to_m: Draw,
    },
    /// Crosses the road and stops on the other side.
    Cross {
        /// What it is. An adult by default.
        #[serde(default = "an_adult")]
        kind: ActorKind,
        /// Metres along the road from our car's start to the line on which it crosses.
        ahead_m: Draw,
        /// Where it waits, metres to the right of our car's line.
        from_m: Draw,
        /// Where it stops, metres to the right of our car's line.
        to_m: Draw,
        /// Its speed, km/h.
        speed_kmh: Draw,
        /// Metres over which it accelerates evenly to that speed. 0 by default.
        #[serde(default)]
        run_up_m: Draw,
        /// When it sets off, in seconds from the start. Alternative to `share`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        at_s: Option<Draw>,
        /// It sets off so that our car, at constant speed, would hit its middle at this share of our car's width,
        /// counted from the side it comes from: 0.25 and 0.75 in CPNA-25 and -75; below 0 or above 1 our car just
        /// misses it. Alternative to `at_s`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        share: Option<Draw>,
    },
}

fn is_plain(looks: &Looks) -> bool {
    *looks == Looks::Plain
}

fn a_car() -> ActorKind {
    ActorKind::Car
}

fn an_adult() -> ActorKind {
    ActorKind::Pedestrian
}

/// Why a scenario cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// No scenario of that name.
    #[error(
        "unknown scenario: expected {}, or a file ending in .toml, got {got:?}{}",
        Scenario::NAMES.join(", "),
        did_you_mean(got, Scenario::NAMES)
    )]
    Unknown {
        /// The name.
        got: String,
    },
    /// Not the TOML of a scenario.
    #[error("scenario file: {}", suggesting(&.0.to_string()))]
    Toml(#[from] toml::de::Error),
    /// A value that is not valid in a scenario.
    #[error("scenario {name}: {what}: expected {expected}, got {got}")]
    Value {
        /// The scenario.
        name: String,
        /// Which value.
        what: String,
        /// What it should be.
        expected: String,
        /// What it is.
        got: String,
    },
}

impl Scenario {
    /// Names of the scenarios that come with Lapwing.
    pub const NAMES: [&str; 16] = [
        "ccrs",
        "ccrm",
        "ccrb",
        "cpna",
        "cpfa",
        "cpla",
        "child",
        "cbna",
        "cbla",
        "gentle-stop",
        "parked",
        "turn-off",
        "oncoming",
        "steel-plate",
        "pass-through",
        "bystanders",
    ];

    /// A scenario that comes with Lapwing.
    ///
    /// # Errors
    /// [`ScenarioError::Unknown`] for a name that is not one of [`Scenario::NAMES`].
    pub fn named(name: &str) -> Result<Self, ScenarioError> {
        Self::parse(match name {
            "ccrs" => include_str!("ccrs.toml"),
            "ccrm" => include_str!("ccrm.toml"),
            "ccrb" => include_str!("ccrb.toml"),
            "cpna" => include_str!("cpna.toml"),
            "cpfa" => include_str!("cpfa.toml"),
            "cpla" => include_str!("cpla.toml"),
            "child" => include_str!("child.toml"),
            "cbna" => include_str!("cbna.toml"),
            "cbla" => include_str!("cbla.toml"),
            "gentle-stop" => include_str!("gentle-stop.toml"),
            "parked" => include_str!("parked.toml"),
            "turn-off" => include_str!("turn-off.toml"),
            "oncoming" => include_str!("oncoming.toml"),
            "steel-plate" => include_str!("steel-plate.toml"),
            "pass-through" => include_str!("pass-through.toml"),
            "bystanders" => include_str!("bystanders.toml"),
            _ => return Err(ScenarioError::Unknown { got: name.to_owned() }),
        })
    }

    /// Reads TOML.
    ///
    /// # Errors
    /// [`ScenarioError::Toml`] with line and column, [`ScenarioError::Value`] if a number makes no sense.
    pub fn parse(text: &str) -> Result<Self, ScenarioError> {
        let scenario: Self = toml::from_str(text)?;
        scenario.check()?;
        Ok(scenario)
    }

    /// The same, unless it is called as one that comes with Lapwing and is another: drives are compared by the scenario's name.
    pub(crate) fn with_name_of_its_own(self) -> Result<Self, ScenarioError> {
        if Self::named(&self.name).is_ok_and(|known| known != self) {
            let (name, got) = (self.name.clone(), format!("{:?}", self.name));
            let expected =
                "a name of its own, as drives are compared by it and this one comes with Lapwing: rename it".to_owned();
            return Err(ScenarioError::Value { name, what: "name".into(), expected, got });
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests;
