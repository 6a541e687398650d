//! A world by name, before it becomes a [`Setup`]: as the flags of a drive, the cell of a suite and a recipe's
//! recording specify it.

use std::{path::Path, sync::Arc};

use lapwing_core::config::{self, ConfigError, SimulatorSettings};

use crate::{
    camera::Scenery,
    conditions::{Conditions, ConditionsError},
    scenario::{Scenario, ScenarioError},
    track::{Track, TrackError},
    world::Setup,
};

/// Which world, by names.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldSpec {
    /// As [`Track::open`] takes it. Default: the scenario's, or that of the settings.
    pub track: Option<String>,
    /// The seed of everything random.
    pub seed: u64,
    /// `random`, a file (`.toml`), or a list as [`Conditions::parse`] takes it. Default: fair weather.
    pub conditions: Option<String>,
    /// A built-in scenario by name, or a file (`.toml`). Default: no other traffic.
    pub scenario: Option<String>,
    /// Laps after which a drive ends. Default: one, or none if there is a scenario.
    pub laps: Option<u32>,
    /// Time after which it ends, in simulated seconds. Default: the scenario's duration.
    pub longest_s: Option<f64>,
}

/// Why a world cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum SpecError {
    /// No such track.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// No such track as the scenario names.
    #[error("{scenario}: track: {source}")]
    ScenarioTrack {
        /// The scenario that was asked for.
        scenario: String,
        /// What is wrong with its track.
        source: Box<TrackError>,
    },
    /// No such conditions.
    #[error("{given}")]
    Conditions {
        /// What was asked for.
        given: String,
        /// What is wrong with it.
        source: ConditionsError,
    },
    /// The file of the conditions cannot be read.
    #[error("{path}")]
    ConditionsFile {
        /// The file.
        path: String,
        /// Why not.
        source: ConfigError,
    },
    /// No such scenario.
    #[error(transparent)]
    Scenario(ScenarioError),
    /// The file of the scenario is not valid.
    #[error("--scenario {path}")]
    ScenarioFile {
        /// The file.
        path: String,
        /// Why not.
        source: ScenarioError,
    },
    /// The file of the scenario cannot be read.
    #[error(transparent)]
    Read(ConfigError),
}

impl WorldSpec {
    /// The world, ready to drive.
    ///
    /// # Errors
    /// [`SpecError`].
    pub fn setup(&self, settings: &SimulatorSettings) -> Result<Setup, SpecError> {
        // Settled here, so that its speeds are known before the drive.
        let scenario = self.scenario.as_deref().map(scenario).transpose()?.map(|s| s.settle(self.seed));
        let of_scenario = scenario.as_ref().and_then(|scenario| scenario.track.as_deref());
        let track = match (&self.track, of_scenario) {
            (None, Some(name)) => Track::open(name).map_err(|source| SpecError::ScenarioTrack {
                scenario: self.scenario.clone().unwrap_or_default(),
                source: Box::new(source),
            })?,
            (given, _) => Track::open(given.as_deref().unwrap_or(&settings.track))?,
        };
        let longest_s = self.longest_s.or(scenario.as_ref().map(|s| s.duration_s));
        let scenery = Arc::new(Scenery::new(&track));
        Ok(Setup {
            // One lap if nothing else ends the run.
            laps: self.laps.or(scenario.is_none().then_some(1)),
            scenario,
            conditions: self.conditions()?,
            seed: self.seed,
            hz: settings.hz,
            longest_s,
            on_crash: settings.on_crash,
            rules: settings.rules.clone(),
            ..Setup::new(Arc::new(track), scenery)
        })
    }

    /// Light, weather and camera faults.
    ///
    /// # Errors
    /// [`SpecError::Conditions`] and [`SpecError::ConditionsFile`].
    pub fn conditions(&self) -> Result<Conditions, SpecError> {
        let Some(given) = self.conditions.as_deref() else { return Ok(Conditions::default()) };
        let wrong = |source| SpecError::Conditions { given: given.into(), source };
        match given.trim() {
            "fair" => Ok(Conditions::default()),
            "random" => Ok(Conditions::random(self.seed)),
            path if path.ends_with(".toml") => {
                let unreadable = |source| SpecError::ConditionsFile { path: path.into(), source };
                Conditions::from_file(&config::text_of(Path::new(path)).map_err(unreadable)?).map_err(wrong)
            }
            list => Conditions::parse(list).map_err(wrong),
        }
    }
}

fn scenario(name: &str) -> Result<Scenario, SpecError> {
    let path = Path::new(name);
    if path.extension().is_some_and(|extension| extension == "toml") {
        let text = config::text_of(path).map_err(SpecError::Read)?;
        return Scenario::parse(&text)
            .and_then(Scenario::with_name_of_its_own)
            .map_err(|source| SpecError::ScenarioFile { path: name.into(), source });
    }
    Scenario::named(name).map_err(SpecError::Scenario)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_track_that_is_named_wins_over_the_scenarios_and_both_over_the_settings() {
        let settings = SimulatorSettings { track: "jungle".into(), ..SimulatorSettings::default() };
        let track = |spec: WorldSpec| spec.setup(&settings).unwrap().track.file().name.clone();
        assert_eq!(track(WorldSpec::default()), "jungle");
        assert_eq!(track(WorldSpec { track: Some("lake".into()), ..WorldSpec::default() }), "lake");
    }

    #[test]
    fn a_track_that_is_not_there_is_said_to_be_the_scenarios() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        let mine = Scenario { name: "mine".into(), track: Some("laek".into()), ..Scenario::named("ccrs").unwrap() };
        std::fs::write(&path, toml::to_string(&mine).unwrap()).unwrap();
        let path = path.display().to_string();
        let spec = WorldSpec { scenario: Some(path.clone()), ..WorldSpec::default() };
        let error = spec.setup(&SimulatorSettings::default()).unwrap_err().to_string();
        assert!(error.starts_with(&format!("{path}: track: unknown track")), "{error}");
    }

    #[test]
    fn one_lap_ends_a_drive_unless_something_else_does() {
        let setup = |spec: WorldSpec| spec.setup(&SimulatorSettings::default()).unwrap();
        assert_eq!(setup(WorldSpec::default()).laps, Some(1));
        let scenario = setup(WorldSpec { scenario: Some("ccrs".into()), ..WorldSpec::default() });
        assert_eq!(scenario.laps, None);
        assert!(scenario.longest_s.is_some());
    }

    #[test]
    fn what_is_wrong_is_said_with_where_it_was_asked_for() {
        let error = |conditions: &str| {
            let spec = WorldSpec { conditions: Some(conditions.into()), ..WorldSpec::default() };
            spec.conditions().unwrap_err().to_string()
        };
        assert_eq!(error("fog=1"), "fog=1");
        assert_eq!(error("/nowhere.toml"), "/nowhere.toml");
    }
}
