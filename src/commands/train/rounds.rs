//! Rounds in closed loop: the network drives, what it saw is labelled by the expert, and it learns from that.
//!
//! Each round has a folder of its own in the training's folder, `round-1` and so on: the lessons, each a data set with its
//! table of places, and the training that goes on from the weights of the round before. A round that was broken off is
//! resumed: lessons and epochs that are complete are not repeated. The last round's network is copied to `final.safetensors`.

use std::{fs, path::Path, time::Instant};

use anyhow::{Context, bail};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{super::undriven_layers, Interrupted, learn, own_road, whole};
use crate::locating;
use lapwing_core::{
    config::{ControlSettings, Settings},
    drive::Eventful,
    driver::Driver,
    files,
    recording::udacity::DrivingLogWriter,
    units::Mph,
    words::count,
};
use lapwing_learn::{
    dataset,
    models::{self, LoadedModel},
    nn::runtime,
    train::{ClosedLoop, Lesson, PracticeAlong, PracticeDrive, Recipe, TrainOutcome},
};
use lapwing_sim::{
    along::{Limit, RecordedWorld, Yaw},
    locate::{LaneTable, LaneTableError},
    record::{self, RecordOptions, RecordReport},
    spec::WorldSpec,
    track::Track,
    world::{Ending, Simulation},
};

/// What is left of a lesson in its folder, beside the data.
const REPORT_NAME: &str = "lesson.json";
/// The network of the last round, in the training's folder, where `model.safetensors` is the one before the rounds.
const FINAL_NAME: &str = "final.safetensors";
/// The noise on the expert's steering is as large as the network's errors, but not less or more than this: without noise
/// nothing is learnt about recovering, and with more the car leaves the road.
const NOISE: (f64, f64) = (0.03, 0.2);
/// A lesson of fewer rows is left out: it may be that all of them are held out.
const FEWEST_ROWS: u64 = 100;
/// The error if every drive is too short.
const TOO_SHORT: &str = "closed_loop: no drive is long enough to learn from: raise closed_loop.drive.seconds, or widen closed_loop.along.rows";

/// A lesson that was driven.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Driven {
    rows: u64,
    put_back: u32,
    disagreement: Option<f64>,
}

/// Checks everything that the rounds need, so that no training is wasted.
pub(super) fn check(closed_loop: &ClosedLoop, config: Option<&Path>) -> anyhow::Result<()> {
    let hz = undriven_layers(config)?.resolve()?.simulator.hz;
    let drives = closed_loop.drive.iter().map(|drive| (drive.seconds * hz).ceil() as u64);
    let rows = |(first, end): (usize, usize)| end.saturating_sub(first) as u64;
    let along = closed_loop.along.iter().map(|along| along.rows.map_or(u64::MAX, rows));
    if closed_loop.rounds > 0 && drives.chain(along).all(|most| most < FEWEST_ROWS) {
        bail!(TOO_SHORT);
    }
    for drive in &closed_loop.drive {
        Track::open(&drive.track)?;
        spec(drive, 0).conditions()?;
    }
    for along in &closed_loop.along {
        dataset::check(&along.path)?;
        along_table(along)?;
    }
    Ok(())
}

fn along_table(along: &PracticeAlong) -> Result<LaneTable, LaneTableError> {
    LaneTable::of(&along.path, &along.lane, |name| Track::called(name, along.track.as_deref()))
}

/// All rounds, after the training that ended so; returns how the last one ended.
pub(super) fn run(
    recipe: &Recipe,
    closed_loop: &ClosedLoop,
    out: &Path,
    mut outcome: TrainOutcome,
    config: Option<&Path>,
    interrupted: &Interrupted,
) -> anyhow::Result<TrainOutcome> {
    let settings = undriven_layers(config)?.resolve()?;
    let mut lessons = vec![];
    let mut noise = record::NOISE;
    for round in 1..=closed_loop.rounds {
        let folder = out.join(format!("round-{round}"));
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        let model = models::load(&outcome.model, Instant::now)?;
        let round_of = Round { number: round, closed_loop, model: &model, noise, settings: &settings, interrupted };
        // libtorch rounds differently with another number of threads, and the same seed must give the same lessons.
        let threads = runtime::libtorch().threads;
        runtime::set_threads(1);
        let driven = round_of.drive(&folder);
        runtime::set_threads(u16::try_from(threads).unwrap_or(u16::MAX));
        let driven = driven?;
        noise = apart(driven.iter().map(|(_, driven)| driven)).unwrap_or(noise).clamp(NOISE.0, NOISE.1);
        let (long, short): (Vec<_>, Vec<_>) = driven.into_iter().partition(|(_, driven)| driven.rows >= FEWEST_ROWS);
        for (lesson, driven) in short {
            let (path, rows) = (lesson.path.display(), count(driven.rows, "row"));
            say!("{path}: nothing is learnt from it: expected a drive of at least {FEWEST_ROWS} rows, got {rows}");
        }
        if lessons.is_empty() && long.is_empty() {
            bail!(TOO_SHORT);
        }
        lessons.extend(long.into_iter().map(|(lesson, _)| lesson));
        let next = recipe.of_round(closed_loop, &outcome.model, &lessons);
        // If there is nothing to resume, this begins.
        outcome = learn(next, &folder, true, interrupted)?;
        if !outcome.finished {
            return Ok(outcome);
        }
    }
    if closed_loop.rounds > 0 {
        let last = out.join(FINAL_NAME);
        let bytes = fs::read(&outcome.model).with_context(|| outcome.model.display().to_string())?;
        files::write(&last, &bytes).with_context(|| format!("{}: cannot be written", last.display()))?;
        outcome.model = last;
    }
    Ok(outcome)
}

/// The root of the mean square over all rows in which the network drove.
fn apart<'a>(driven: impl Iterator<Item = &'a Driven>) -> Option<f64> {
    let (squares, rows) = driven
        .filter_map(|driven| Some((driven.disagreement?.powi(2), driven.rows as f64)))
        .fold((0.0, 0.0), |(sum, all), (square, rows)| (sum + square * rows, all + rows));
    (rows > 0.0).then(|| (squares / rows).sqrt())
}

/// Which world, in which round.
fn spec(drive: &PracticeDrive, round: usize) -> WorldSpec {
    WorldSpec {
        track: Some(drive.track.clone()),
        // Another one in each round, so that each shows other places and other weather.
        seed: drive.seed.wrapping_mul(1000).wrapping_add(round as u64),
        conditions: drive.conditions.clone(),
        longest_s: Some(drive.seconds),
        ..WorldSpec::default()
    }
}

struct Round<'a> {
    number: usize,
    closed_loop: &'a ClosedLoop,
    model: &'a LoadedModel,
    noise: f64,
    settings: &'a Settings,
    interrupted: &'a Interrupted,
}

impl Round<'_> {
    /// All lessons of the round, each with its folder: as many at a time as there are processors.
    fn drive(&self, folder: &Path) -> anyhow::Result<Vec<(Lesson, Driven)>> {
        let ClosedLoop { drive, along, .. } = self.closed_loop;
        let on_roads = drive.par_iter().enumerate().map(|(i, drive)| {
            let path = folder.join(format!("drive-{}", i + 1));
            let driven = lesson(&path, |partial| self.on_road(drive, partial))?;
            Ok((Lesson { path, track: own_road(&drive.track) }, driven))
        });
        let along_recordings = along.par_iter().enumerate().map(|(i, along)| {
            let path = folder.join(format!("along-{}", i + 1));
            let driven = lesson(&path, |partial| self.along(along, partial))?;
            Ok((Lesson { path, track: along.track.clone() }, driven))
        });
        let driven = on_roads.chain(along_recordings).collect::<anyhow::Result<Vec<_>>>()?;
        let rows: u64 = driven.iter().map(|(_, driven)| driven.rows).sum();
        let put_back: u32 = driven.iter().map(|(_, driven)| driven.put_back).sum();
        let apart = apart(driven.iter().map(|(_, driven)| driven)).unwrap_or(0.0);
        say!(
            "round {:>3}/{}  {}, {}, put back {}, steering {apart:.3} from the expert's",
            self.number,
            self.closed_loop.rounds,
            count(driven.len(), "drive"),
            count(rows, "row"),
            count(put_back, "time"),
        );
        Ok(driven)
    }

    fn driver(&self, speed: Mph) -> Driver {
        let control = ControlSettings { speed_mph: speed, ..self.settings.control };
        Driver::new(self.model.pilot(), &control, Instant::now)
    }

    fn on_road(&self, drive: &PracticeDrive, folder: &Path) -> anyhow::Result<RecordReport> {
        let speed = Mph::saturating(drive.speed);
        let setup = spec(drive, self.number).setup(&self.settings.simulator)?;
        let mut simulation = Simulation::new(setup)?;
        let log = DrivingLogWriter::create(folder, jiff::Zoned::now().datetime())?;
        let options = RecordOptions {
            recovery: true,
            noise: self.noise,
            expert: self.closed_loop.expert_share(self.number),
            anywhere: true,
            ..RecordOptions::at(speed)
        };
        Ok(record::record(&mut simulation, &mut self.driver(speed), log, options, |simulation| {
            if self.interrupted.is_pressed() {
                simulation.interrupt();
            }
        })?)
    }

    fn along(&self, along: &PracticeAlong, folder: &Path) -> anyhow::Result<RecordReport> {
        let (first, end) = along.rows.unwrap_or((0, usize::MAX));
        let located = along_table(along)?.drive(first..end);
        let limit = Some(Limit::Metres(along.limit_m));
        let gearing = locating::gearing(&along.path, &located)?;
        let mut world = RecordedWorld::open(&along.path, limit, Yaw::Pictures, Some(located))?.geared(gearing);
        let log = DrivingLogWriter::create(folder, jiff::Zoned::now().datetime())?;
        let mut driver = self.driver(self.settings.control.speed_mph);
        Ok(record::along(&mut world, &mut driver, log, || self.interrupted.is_pressed())?)
    }
}

/// Drives a lesson into a folder unless that exists.
fn lesson(path: &Path, drive: impl FnOnce(&Path) -> anyhow::Result<RecordReport>) -> anyhow::Result<Driven> {
    let report = path.join(REPORT_NAME);
    if path.exists() {
        let text = fs::read_to_string(&report).with_context(|| report.display().to_string())?;
        return serde_json::from_str(&text).with_context(|| report.display().to_string());
    }
    tracing::info!("driving {}", path.display());
    whole(path, |partial| {
        let RecordReport { rows, put_back, disagreement, ending, .. } = drive(partial)?;
        if ending == Ending::Interrupted {
            bail!("interrupted while {} was driven: nothing of it is kept", path.display());
        }
        let driven = Driven { rows, put_back, disagreement };
        let report = partial.join(REPORT_NAME);
        fs::write(&report, serde_json::to_string(&driven)?).with_context(|| report.display().to_string())?;
        Ok(driven)
    })
}
