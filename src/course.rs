//! A suite's drives in our simulator, by our models: the glue between [`lapwing_score::suite`], the worlds and
//! the networks.

use std::{collections::BTreeMap, convert::Infallible, fs, io, path::Path, path::PathBuf, time::Instant};

use serde_json::json;

use lapwing_core::{
    config::{ConfigError, Layers, Settings},
    drive::{StopWhen, TurnError},
    driver::Driver,
    hash::sha256,
    pilot::{Pilot, PurePursuit},
    recording::{ModelId, Recorder, RecordingError, RunHeader},
    units::Mph,
};
use lapwing_learn::models::{self, LoadedModel, ModelError};
use lapwing_score::{
    judged::{self, Judged},
    suite::{self, Cell, Contestant, Stop, Suite},
};
use lapwing_sim::{
    conditions::Conditions,
    scenario::ScenarioError,
    spec::{SpecError, WorldSpec},
    track::{Track, TrackError},
    world::{Ending, Setup, Simulation},
};

/// Why a cell of a suite cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum CourseError {
    /// Settings that cannot be used.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// A world that cannot be set up.
    #[error("{0}")]
    Spec(#[from] SpecError),
    /// A track that cannot be opened.
    #[error("{0}")]
    Track(#[from] TrackError),
    /// A scenario that does not fit its track.
    #[error("{0}")]
    Scenario(#[from] ScenarioError),
    /// A model that cannot be used.
    #[error("{0}")]
    Model(#[from] ModelError),
    /// A file that a drive depends on cannot be read.
    #[error("{}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The drive was interrupted.
    #[error("{0}")]
    Drive(#[from] TurnError<Infallible>),
    /// Its run cannot be recorded.
    #[error("{0}")]
    Recording(#[from] RecordingError),
}

/// What a run says of itself: settings, world, and the pilot with its model.
pub type Heading = fn(&Settings, &Setup, (&str, Option<ModelId>)) -> RunHeader;

/// The state that all drives of a suite share.
pub struct SimulatedCourse {
    layers: Layers,
    models: BTreeMap<String, LoadedModel>,
    /// The hash of each track's file.
    tracks: BTreeMap<String, Option<String>>,
    /// For each pilot, the hash of the file next to its model.
    beside: BTreeMap<String, Option<String>>,
    heading: Heading,
}

impl SimulatedCourse {
    /// The course of a suite, under these settings, with the models of its pilots by name; see [`model_of`].
    ///
    /// # Errors
    /// [`CourseError`], if a track or a file beside a model cannot be read.
    pub fn new(
        suite: &Suite,
        layers: Layers,
        models: BTreeMap<String, LoadedModel>,
        heading: Heading,
    ) -> Result<Self, CourseError> {
        // Errors in a track are reported before the first drive, not hours later.
        let tracks = suite.tracks.iter().map(|track| Ok((track.clone(), track_sha256(track)?)));
        let tracks = tracks.collect::<Result<_, CourseError>>()?;
        let beside = suite.pilots.iter().map(|pilot| Ok((pilot.name.clone(), beside(pilot)?)));
        Ok(Self { layers, models, tracks, beside: beside.collect::<Result<_, CourseError>>()?, heading })
    }

    /// A cell's world, and all settings.
    fn resolved(&self, cell: &Cell) -> Result<(WorldSpec, Settings), CourseError> {
        let spec = WorldSpec {
            track: Some(cell.track.clone()),
            seed: cell.seed,
            conditions: Some(cell.conditions.clone()),
            scenario: None,
            laps: Some(cell.laps),
            longest_s: Some(cell.longest_s),
        };
        let mut settings = self.layers.clone().set("--track", "simulator.track", &cell.track)?.resolve()?;
        settings.control.speed_mph = Mph::saturating(cell.speed_mph);
        Ok((spec, settings))
    }
}

impl suite::Course for SimulatedCourse {
    type Error = CourseError;

    fn model_sha256(&self, pilot: &Contestant) -> Option<String> {
        self.models.get(&pilot.name).map(|model| model.sha256().to_owned())
    }

    fn resolve(&self, cell: &mut Cell) -> Result<(), CourseError> {
        let (spec, settings) = self.resolved(cell)?;
        cell.settings = json!({
            "lapwing": concat!(env!("CARGO_PKG_VERSION"), "+", env!("LAPWING_SOURCES")),
            "control": settings.control, "perception": settings.perception, "simulator": settings.simulator,
            "beside_model_sha256": self.beside.get(&cell.pilot),
        });
        cell.world = json!({ "conditions": spec.conditions()?, "track_sha256": self.tracks.get(&cell.track) });
        Ok(())
    }

    fn left_to_chance(&self, cell: &Cell) -> bool {
        left_to_chance(cell)
    }

    fn drive(&self, cell: &Cell, run: Option<&Path>, stop: Stop<'_>) -> Result<Option<Judged>, CourseError> {
        let (spec, settings) = self.resolved(cell)?;
        let setup = spec.setup(&settings.simulator)?;
        let model = self.models.get(&cell.pilot);
        let pilot: Box<dyn Pilot> = model.map_or_else(|| Box::new(PurePursuit::default()) as _, LoadedModel::pilot);
        let header = || {
            let mut header = (self.heading)(&settings, &setup, (&cell.pilot, model.map(|model| ModelId::of(model))));
            header.config["cell"] = json!({ "pilot": cell.pilot, "conditions": cell.conditions });
            header
        };
        let options = || setup.recorder(settings.recording.queue);
        let recorder = run.map(|run| Recorder::create_file(run, header(), options())).transpose()?;
        let mut driver = Driver::new(pilot, &settings.control, Instant::now);
        let mut simulation = Simulation::new(setup)?;
        let driven = judged::run(&mut simulation, &mut driver, &mut [&mut recorder.as_ref(), &mut StopWhen(stop)]);
        let ended = recorder.and_then(|recorder| recorder.finish().error);
        let driven = driven?;
        ended.map_or(Ok(()), Err)?;
        Ok((!matches!(simulation.ending(), Some(Ending::Interrupted))).then_some(driven))
    }
}

/// Whether another seed would change a cell's pictures, judging by its conditions.
pub fn left_to_chance(cell: &Cell) -> bool {
    let conditions = serde_json::from_value(cell.world["conditions"].clone());
    // Conditions of another version may depend on chance.
    conditions.map_or(true, |conditions: Conditions| conditions.left_to_chance())
}

/// The model of a contestant; none for the expert.
///
/// # Errors
/// [`ModelError`].
pub fn model_of(pilot: &Contestant) -> Result<Option<LoadedModel>, ModelError> {
    Ok(match &pilot.model {
        _ if pilot.expert => None,
        Some(path) => Some(models::load(path, Instant::now)?),
        None => Some(models::built_in(Instant::now)?),
    })
}

/// The hash of a track's file; none for one that comes with Lapwing.
fn track_sha256(track: &str) -> Result<Option<String>, CourseError> {
    Track::open(track)?;
    let path = Path::new(track);
    path.is_file().then(|| sha256_of(path)).transpose()
}

/// The hash of the file next to a model made elsewhere that says how its frames are prepared.
fn beside(pilot: &Contestant) -> Result<Option<String>, CourseError> {
    let foreign = pilot.model.as_ref().filter(|path| models::is_foreign(path));
    foreign.map(|path| sha256_of(&path.with_extension("toml"))).transpose()
}

fn sha256_of(path: &Path) -> Result<String, CourseError> {
    Ok(sha256(fs::read(path).map_err(|source| CourseError::Read { path: path.to_owned(), source })?))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use lapwing_core::{config::ControlSettings, recording::RunKind};
    use lapwing_score::{score::Figure, suite::Planned};
    use lapwing_sim::camera::Scenery;

    const SUITE: &str = r#"
    tracks = ["lake"]
    conditions = ["fair", "latency_ms=100", "noise=4", "random"]
    seeds = [7, 3, 5]

    [[pilot]]
    name = "network"

    [[pilot]]
    name = "expert"
    expert = true
    "#;

    fn heading(_: &Settings, _: &Setup, _: (&str, Option<ModelId>)) -> RunHeader {
        RunHeader::new(RunKind::Driven, json!({}), jiff::Timestamp::UNIX_EPOCH)
    }

    fn cells() -> Vec<Cell> {
        cells_of(SUITE)
    }

    fn cells_of(suite: &str) -> Vec<Cell> {
        let suite = Suite::parse(suite).unwrap();
        let model = |pilot: &Contestant| Some((pilot.name.clone(), model_of(pilot).unwrap()?));
        let models = suite.pilots.iter().filter_map(model).collect();
        Planned::new(&suite, &SimulatedCourse::new(&suite, Layers::default(), models, heading).unwrap()).unwrap().cells
    }

    #[test]
    fn the_first_seed_alone_is_driven_where_another_one_changes_nothing() {
        let cells = cells();
        let seeds = |pilot: &str, conditions: &str| {
            let of = |cell: &&Cell| cell.pilot == pilot && cell.conditions == conditions;
            cells.iter().filter(of).map(|cell| cell.seed).collect::<Vec<_>>()
        };
        for (conditions, expected) in
            [("fair", &[3][..]), ("latency_ms=100", &[3]), ("noise=4", &[3, 5, 7]), ("random", &[3, 5, 7])]
        {
            assert_eq!(seeds("network", conditions), expected, "{conditions}");
            assert_eq!(seeds("expert", conditions), [3], "{conditions}: it looks at no picture");
        }
        // The drive has the same name as without the others.
        let alone = cells_of(&SUITE.replace("[7, 3, 5]", "[3]"));
        assert_eq!(alone.len(), 8);
        assert!(alone.iter().all(|cell| cells.contains(cell)));
    }

    #[test]
    fn the_seed_changes_a_drive_under_the_conditions_that_say_so_and_the_experts_figures_under_none() {
        let track = Arc::new(Track::open("lake").unwrap());
        let scenery = Arc::new(Scenery::new(&track));
        let now = Instant::now;
        for (text, by_chance) in [
            ("", false),
            ("sun_height_deg=20,sun_azimuth_deg=90,brightness=0.8,haze=0.5,night=0.5,blur=1,latency_ms=100", false),
            ("grain=2,verge=0.5,warmth=-1,shadows=0.5", false),
            ("rain=0.5", true),
            ("noise=4", true),
            ("dropped=0.5", true),
        ] {
            let conditions = Conditions::parse(text).unwrap();
            let drive = |seed| {
                let setup = Setup::new(track.clone(), scenery.clone());
                let setup = Setup { conditions: conditions.clone(), seed, longest_s: Some(2.0), ..setup };
                let mut driver = Driver::new(Box::new(PurePursuit::default()), &ControlSettings::default(), now);
                judged::run(&mut Simulation::new(setup).unwrap(), &mut driver, &mut []).unwrap()
            };
            let (one, other) = (drive(1), drive(2));
            assert_eq!(one.driven.fingerprint != other.driven.fingerprint, by_chance, "{text}");
            assert_eq!(conditions.left_to_chance(), by_chance, "{text}");
            for figure in Figure::ALL {
                assert_eq!(one.card.value(figure), other.card.value(figure), "{text}: {}", figure.key());
            }
        }
    }
}
