//! What a person at a page may ask of a drive, and what a drive can do.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use lapwing_core::{
    config::SpeedLaw,
    protocol::Command,
    units::{Mph, Steering, Throttle},
};

/// The fastest set speed that a page may ask for, in mph; the stock car reaches 30.
pub const FASTEST_MPH: f64 = 100.0;

/// One request. As JSON it is an object whose `control` names it: `{"control":"set-speed","mph":12}`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "control", rename_all = "kebab-case")]
pub enum Control {
    /// Hold another speed.
    SetSpeed {
        /// Above 0, at most [`FASTEST_MPH`].
        mph: f64,
    },
    /// Compute the throttle by another law.
    SpeedLaw {
        /// Which.
        law: SpeedLaw,
    },
    /// Let another pilot drive.
    Pilot {
        /// Its place among those that whoever started the program named.
        index: usize,
    },
    /// Switch the pilot off.
    TakeOver,
    /// Let the pilot drive again.
    Arm,
    /// Brake to a standstill, until the pilot is armed.
    Stop,
    /// Begin a run.
    StartRun,
    /// End the run; the car is braked until another one begins.
    EndRun,
    /// Let time stand still.
    Pause,
    /// Let it go on.
    Resume,
    /// One telemetry, then stand still.
    Step,
    /// Begin anew at the start.
    Reset,
    /// Begin anew in another world.
    World(WorldChoice),
    /// Keep what is driven by hand as training data, or no longer.
    Record {
        /// Whether.
        on: bool,
    },
}

/// A world, by names that the drive offers; what is absent stays as it is.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, Serialize)]
#[serde(default)]
pub struct WorldChoice {
    /// One of [`Offered::tracks`], `random:SEED` or `random-lanes:SEED`.
    pub track: Option<String>,
    /// Light, weather and camera faults, of [`Offered::weather`].
    pub weather: Option<BTreeMap<String, f64>>,
    /// One of [`Offered::scenarios`], or an empty text for none.
    pub scenario: Option<String>,
}

/// Why a request is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refused {
    /// The drive cannot do that.
    #[error("{0}")]
    Cannot(String),
    /// A value is not one that the drive offers.
    #[error("{what}: expected {expected}, got {got}")]
    Value {
        /// Of what.
        what: &'static str,
        /// What it may be.
        expected: String,
        /// What it is.
        got: String,
    },
    /// The request is no control.
    #[error("expected a control as JSON: {0}")]
    Unknown(String),
    /// No drive has this number.
    #[error("expected the number of a drive that is open, got {0}")]
    Gone(u64),
    /// The driver has not taken what was asked before.
    #[error("expected the drive to take earlier requests first; it has {0} of them")]
    Busy(usize),
    /// As many runs as may be are being shown to models.
    #[error("expected fewer than {0} comparisons at a time, got as many: close another page first")]
    Comparing(u32),
}

impl Refused {
    /// No pilot has this place.
    pub(super) fn no_pilot(index: usize, pilots: usize) -> Self {
        let expected = format!("the place of one of {pilots} pilots, from 0");
        Self::Value { what: "index", expected, got: index.to_string() }
    }
}

/// What a drive may be asked for besides its driver's own controls.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Offered {
    /// Tracks by name.
    pub tracks: Vec<String>,
    /// Scenarios by name.
    pub scenarios: Vec<String>,
    /// What the weather is made of.
    pub weather: Vec<WeatherRange>,
}

/// A condition and its range.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WeatherRange {
    /// Its name.
    pub name: String,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// The value that changes nothing.
    pub fair: f64,
}

/// Which controls a drive has; those that it lacks, with the reason in words.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Abilities(BTreeMap<&'static str, Option<&'static str>>);

const ONLY_SIMULATED: &str =
    "only lapwing drive --page and lapwing record --page can do this, because they run the simulator themselves";
const ONLY_RECORD: &str = "only lapwing record --page keeps training data";
const RUN_IS_WORLD: &str = "Reset ends this run and begins another";

impl Abilities {
    /// Those of a simulator at the other end of a connection.
    pub fn of_a_connection() -> Self {
        Self::without(&[
            ("pause", ONLY_SIMULATED),
            ("step", ONLY_SIMULATED),
            ("reset", ONLY_SIMULATED),
            ("world", ONLY_SIMULATED),
            ("record", ONLY_RECORD),
        ])
    }

    /// Those of the headless simulator, which keeps training data or not.
    pub fn of_the_simulator(records: bool) -> Self {
        let lacks = [("start-run", RUN_IS_WORLD), ("end-run", RUN_IS_WORLD), ("record", ONLY_RECORD)];
        Self::without(&lacks[..if records { 2 } else { 3 }])
    }

    fn without(lacks: &[(&'static str, &'static str)]) -> Self {
        let all = NAMES.map(|name| (name, lacks.iter().find(|(lack, _)| *lack == name).map(|(_, why)| *why)));
        Self(all.into())
    }

    /// Why no pilot is armed once the run has ended: what begins another.
    pub(super) fn begins_another(&self) -> Refused {
        let how = if self.check("reset").is_ok() { "Reset" } else { "Start" };
        Refused::Cannot(format!("the run has ended: {how} begins another"))
    }

    fn check(&self, name: &str) -> Result<(), Refused> {
        match self.0.get(name) {
            Some(Some(why)) => Err(Refused::Cannot((*why).to_owned())),
            _ => Ok(()),
        }
    }
}

/// All controls as they are shown; `steer` is driving by hand, which is a stream and no request.
const NAMES: [&str; 14] = [
    "set-speed",
    "speed-law",
    "pilot",
    "take-over",
    "arm",
    "stop",
    "steer",
    "start-run",
    "end-run",
    "pause",
    "step",
    "reset",
    "world",
    "record",
];

impl Control {
    /// Reads a request.
    ///
    /// # Errors
    /// [`Refused::Unknown`].
    pub fn read(json: &[u8]) -> Result<Self, Refused> {
        serde_json::from_slice(json).map_err(|error| Refused::Unknown(error.to_string()))
    }

    fn name(&self) -> &'static str {
        match self {
            Self::SetSpeed { .. } => "set-speed",
            Self::SpeedLaw { .. } => "speed-law",
            Self::Pilot { .. } => "pilot",
            Self::TakeOver => "take-over",
            Self::Arm => "arm",
            Self::Stop => "stop",
            Self::StartRun => "start-run",
            Self::EndRun => "end-run",
            Self::Pause | Self::Resume => "pause",
            Self::Step => "step",
            Self::Reset => "reset",
            Self::World(_) => "world",
            Self::Record { .. } => "record",
        }
    }

    /// Checks it against what a drive can do and offers: no text of a request goes any further than this unless it
    /// equals one that is offered.
    ///
    /// # Errors
    /// [`Refused::Cannot`] and [`Refused::Value`].
    pub fn check(&self, can: &Abilities, offered: &Offered, pilots: usize) -> Result<(), Refused> {
        can.check(self.name())?;
        let value = |what, expected: String, got: String| Err(Refused::Value { what, expected, got });
        match self {
            Self::SetSpeed { mph } if !(*mph > 0.0 && *mph <= FASTEST_MPH) => {
                value("mph", format!("a speed above 0, up to {FASTEST_MPH} mph"), format!("{mph:?}"))
            }
            Self::Pilot { index } if *index >= pilots => Err(Refused::no_pilot(*index, pilots)),
            Self::World(WorldChoice { track, weather, scenario }) => {
                let is_track = |name: &str| {
                    let seed = ["random:", "random-lanes:"].iter().find_map(|kind| name.strip_prefix(kind));
                    offered.tracks.iter().any(|offered| offered == name)
                        || seed.is_some_and(|seed| seed.parse::<u64>().is_ok())
                };
                if let Some(track) = track.as_ref().filter(|track| !is_track(track)) {
                    return value(
                        "track",
                        format!("{}, random:SEED or random-lanes:SEED", offered.tracks.join(", ")),
                        format!("{track:?}"),
                    );
                }
                let is_scenario = |name: &str| name.is_empty() || offered.scenarios.iter().any(|one| one == name);
                if let Some(scenario) = scenario.as_ref().filter(|scenario| !is_scenario(scenario)) {
                    return value("scenario", offered.scenarios.join(", "), format!("{scenario:?}"));
                }
                for (name, got) in weather.iter().flatten() {
                    let Some(range) = offered.weather.iter().find(|range| range.name == *name) else {
                        let names: Vec<_> = offered.weather.iter().map(|range| &*range.name).collect();
                        return value("weather", names.join(", "), format!("{name:?}"));
                    };
                    if !(range.min..=range.max).contains(got) {
                        return value(
                            "weather",
                            format!("{name} from {} to {}", range.min, range.max),
                            format!("{got:?}"),
                        );
                    }
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

/// The wheel in a person's hands: steering and throttle, normalised, or nothing once they let go.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub(super) struct ByHand {
    steering: f64,
    throttle: f64,
}

impl ByHand {
    pub fn command(self) -> Command {
        Command { steering: Steering::saturating(self.steering), throttle: Throttle::saturating(self.throttle) }
    }
}

/// A set speed that was checked.
pub(super) fn speed(mph: f64) -> Mph {
    Mph::saturating(mph)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offered() -> Offered {
        Offered {
            tracks: vec!["lake".into()],
            scenarios: vec!["ccrs".into()],
            weather: vec![WeatherRange { name: "rain".into(), min: 0.0, max: 1.0, fair: 0.0 }],
        }
    }

    fn asked(json: &str, can: &Abilities) -> Result<(), Refused> {
        Control::read(json.as_bytes())?.check(can, &offered(), 2)
    }

    #[test]
    fn a_control_is_named_and_its_value_is_in_range() {
        let can = Abilities::of_the_simulator(true);
        for good in [
            r#"{"control":"set-speed","mph":12.5}"#,
            r#"{"control":"speed-law","law":"quadratic"}"#,
            r#"{"control":"pilot","index":1}"#,
            r#"{"control":"take-over"}"#,
            r#"{"control":"stop"}"#,
            r#"{"control":"world","track":"random:7","weather":{"rain":0.5},"scenario":""}"#,
            r#"{"control":"record","on":true}"#,
        ] {
            assert_eq!(asked(good, &can), Ok(()), "{good}");
        }
        for bad in [
            r#"{"control":"set-speed","mph":0}"#,
            r#"{"control":"set-speed","mph":1e9}"#,
            r#"{"control":"set-speed"}"#,
            r#"{"control":"pilot","index":2}"#,
            r#"{"control":"pilot","index":-1}"#,
            r#"{"control":"launch"}"#,
            r#"{"control":"world","weather":{"rain":2}}"#,
            r#"{"control":"world","weather":{"snow":1}}"#,
            "[]",
            "",
        ] {
            assert!(asked(bad, &can).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_world_is_one_that_is_offered_and_never_a_path() {
        let can = Abilities::of_the_simulator(false);
        for path in ["/etc/passwd", "../track.toml", "track.toml", "random:x", "random", "random-lanes:../x", "lake "] {
            for key in ["track", "scenario"] {
                let json = serde_json::json!({ "control": "world", key: path }).to_string();
                let error = asked(&json, &can).unwrap_err().to_string();
                assert!(error.contains("expected") && error.contains("got"), "{error}");
            }
        }
    }

    #[test]
    fn what_a_drive_cannot_do_is_refused_with_the_reason() {
        let error = asked(r#"{"control":"pause"}"#, &Abilities::of_a_connection()).unwrap_err();
        assert_eq!(error, Refused::Cannot(ONLY_SIMULATED.into()));
        let error = asked(r#"{"control":"end-run"}"#, &Abilities::of_the_simulator(false)).unwrap_err();
        assert_eq!(error, Refused::Cannot(RUN_IS_WORLD.into()));
        assert!(asked(r#"{"control":"record","on":true}"#, &Abilities::of_the_simulator(false)).is_err());
    }
}
