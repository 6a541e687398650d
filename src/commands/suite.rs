//! `lapwing suite`: many drives, over all cores, and `lapwing merge`: what they came to.

mod merge;
#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    fs,
    io::{self, IsTerminal},
    path::Path,
    sync::{
        Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

pub(super) use merge::run as merge;

use super::{Ended, Interrupted, outputs, world};
use crate::cli;
use lapwing_core::{
    config::{Layers, Settings},
    driver::Driver,
    hash,
    pilot::{Pilot, PurePursuit},
    units::Mph,
    words::count,
};
use lapwing_learn::models;
use lapwing_learn::{models::Model, nn::runtime};
use lapwing_score::judged;
use lapwing_score::suite::{Cell, Contestant, Done, Outcome, Plan, Results, Suite, groups, render, table};
use lapwing_sim::{
    conditions::Conditions,
    track::Track,
    world::{Ending, Simulation},
};

pub(super) fn run(arguments: &cli::Suite, config: Option<&Path>) -> anyhow::Result<Ended> {
    let layers = super::allowing(super::undriven_layers(config)?, &arguments.trust)?;
    let settings = layers.clone().resolve()?;
    let named = || arguments.suite.display().to_string();
    let suite = Suite::parse(&super::text_of(&arguments.suite)?).with_context(named)?;
    arguments.html.as_deref().map_or(Ok(()), outputs::check)?;
    outputs::check_folder(&arguments.out)?;
    let mut models = BTreeMap::new();
    for contestant in &suite.pilots {
        if let Some(model) = contestant.model.as_ref().filter(|_| !contestant.expert) {
            super::refuse_strangers_code(&named(), model, false, &settings)?;
        }
        if let Some(model) = model_of(contestant)? {
            super::suits_our_cameras(&model)?;
            models.insert(contestant.name.clone(), model);
        }
    }
    let sha256 = |contestant: &Contestant| models.get(&contestant.name).map(|model| model.sha256().to_owned());
    let cells = planned(&suite, &layers, sha256)?;
    let results = Results::open(&arguments.out)?;
    let plan = Plan::new(&cells);
    results.keep_plan(&plan)?;
    let mut open = VecDeque::new();
    let mut before = 0;
    for (_, cell) in cells.iter().enumerate().filter(|(i, _)| arguments.shard.is_none_or(|shard| shard.has(*i))) {
        match results.get(cell)? {
            Some(_) => before += 1,
            None => open.push_back(cell.clone()),
        }
    }
    tracing::info!("{}, {before} of them already driven", count(before + open.len(), "cell"));
    // Each drive has one thread, and the same bytes on every machine.
    runtime::set_threads(1);
    let interrupted = super::interrupted();
    drive_all(&Course { layers, models }, open, &results, arguments.jobs, &interrupted)?;
    if interrupted.is_pressed() {
        bail!("interrupted; the same command goes on where it was");
    }
    // Of what else lies in the folder nothing belongs to this suite.
    let done: Vec<_> = cells.iter().filter_map(|cell| results.get(cell).transpose()).collect::<Result<_, _>>()?;
    let found = Found { planned: Some(plan.count()), missing: plan.missing(&done).len(), done };
    found.report(&arguments.out, arguments.html.as_deref(), arguments.json)?;
    Ok(Ended::Passed)
}

/// The cells of a suite, with all that they depend on; none that would only be another one over again.
fn planned(
    suite: &Suite,
    layers: &Layers,
    sha256: impl Fn(&Contestant) -> Option<String>,
) -> anyhow::Result<Vec<Cell>> {
    let mut cells = suite.cells(sha256);
    // What is wrong with a track or conditions is said before the first drive, not hours later.
    let tracks = suite.tracks.iter().map(|track| Ok((track.clone(), track_sha256(track)?)));
    let tracks: BTreeMap<_, _> = tracks.collect::<anyhow::Result<_>>()?;
    let beside = suite.pilots.iter().map(|pilot| Ok((pilot.name.clone(), beside(pilot)?)));
    let beside: BTreeMap<_, _> = beside.collect::<anyhow::Result<_>>()?;
    for cell in &mut cells {
        let (flags, settings) = resolved(layers, cell)?;
        cell.settings = json!({
            "lapwing": env!("CARGO_PKG_VERSION"), "control": settings.control, "simulator": settings.simulator,
            "beside_model_sha256": beside[&cell.pilot],
        });
        cell.world = json!({ "conditions": world::conditions(&flags)?, "track_sha256": tracks[&cell.track] });
    }
    let mut ids = BTreeSet::new();
    cells.retain(|cell| ids.insert(cell.id()));
    let all = cells.len();
    let cells = told_apart(cells, |cell| cell);
    if let left_out @ 1.. = all - cells.len() {
        tracing::info!("skipped {}: a different seed would not change their drives", count(left_out, "cell"));
    }
    Ok(cells)
}

/// Those, in their order, of which no earlier one was the same drive under another seed.
fn told_apart<T>(mut all: Vec<T>, cell: impl Fn(&T) -> &Cell) -> Vec<T> {
    let mut known = BTreeSet::new();
    all.retain(|one| whatever_the_seed(cell(one)).is_none_or(|id| known.insert(id)));
    all
}

/// An id of the drive that a cell is under every seed; none where the seed makes another one of it.
fn whatever_the_seed(cell: &Cell) -> Option<String> {
    let mut cell = Cell { seed: 0, ..cell.clone() };
    if cell.model_sha256.is_none() {
        // The expert looks at no picture, and conditions change nothing else.
        cell.world = cell.world["track_sha256"].take();
    } else {
        let conditions: Conditions = serde_json::from_value(cell.world["conditions"].clone()).ok()?;
        if conditions.left_to_chance() {
            return None;
        }
    }
    Some(cell.id())
}

/// The hash of a track's file; of one that comes with Lapwing none.
fn track_sha256(track: &str) -> anyhow::Result<Option<String>> {
    Track::open(track)?;
    if !Path::new(track).is_file() {
        return Ok(None);
    }
    let bytes = fs::read(track).with_context(|| track.to_owned())?;
    Ok(Some(hash::sha256(&bytes)))
}

/// The hash of what lies beside a TorchScript model and says how its frames are prepared.
fn beside(contestant: &Contestant) -> anyhow::Result<Option<String>> {
    let Some(path) = contestant.model.as_ref().filter(|path| path.extension().is_some_and(|e| e == "pt")) else {
        return Ok(None);
    };
    let side = path.with_extension("toml");
    let bytes = fs::read(&side).with_context(|| side.display().to_string())?;
    Ok(Some(hash::sha256(&bytes)))
}

/// A cell's world as flags, and all settings.
fn resolved(layers: &Layers, cell: &Cell) -> anyhow::Result<(cli::World, Settings)> {
    let flags = cli::World {
        track: Some(cell.track.clone()),
        seed: cell.seed,
        conditions: (cell.conditions != "fair").then(|| cell.conditions.clone()),
        scenario: None,
        hz: None,
        on_crash: None,
        max_time: Some(cell.longest_s),
    };
    let mut settings = world::layers(layers.clone(), &flags)?.resolve()?;
    settings.control.speed_mph = Mph::saturating(cell.speed_mph);
    Ok((flags, settings))
}

/// What results there are, and what is known of those that are not.
struct Found {
    done: Vec<Done>,
    planned: Option<usize>,
    missing: usize,
}

impl Found {
    fn report(self, out: &Path, html: Option<&Path>, as_json: bool) -> anyhow::Result<()> {
        let outcome = Outcome::new(groups(&self.done), self.planned, self.missing);
        let text = serde_json::to_string_pretty(&outcome)?;
        // One that fails takes no other with it.
        let json = outputs::write(&out.join("suite.json"), &text);
        let html = outputs::write(html.unwrap_or(&out.join("suite.html")), &render(&outcome)?);
        let printed = super::print(&if as_json { text } else { table(&outcome.groups) });
        json.and(html)?;
        Ok(printed?)
    }
}

fn model_of(contestant: &Contestant) -> anyhow::Result<Option<Model>> {
    Ok(match &contestant.model {
        _ if contestant.expert => None,
        Some(path) => Some(models::load(path, Instant::now)?),
        None => Some(models::built_in(Instant::now)?),
    })
}

/// What all drives share.
struct Course {
    layers: Layers,
    models: BTreeMap<String, Model>,
}

fn drive_all(
    course: &Course,
    open: VecDeque<Cell>,
    results: &Results,
    jobs: Option<u16>,
    interrupted: &Interrupted,
) -> anyhow::Result<()> {
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = jobs.map_or_else(cores, usize::from).min(open.len().max(1));
    let bar = if io::stderr().is_terminal() { ProgressBar::new(open.len() as u64) } else { ProgressBar::hidden() };
    let template = "{wide_bar} {pos}/{len} {msg}, {eta} left";
    bar.set_style(ProgressStyle::with_template(template).expect("the template is written here"));
    let open = Mutex::new(open);
    let next = || open.lock().ok().and_then(|mut open| open.pop_front());
    // The first error ends all.
    let failed = AtomicBool::new(false);
    let one = |cell: Cell| -> anyhow::Result<()> {
        let name = cell.to_string();
        bar.set_message(name.clone());
        if let Some(done) = drive_one(course, cell, interrupted).context(name)? {
            results.keep(&done)?;
            bar.inc(1);
        }
        Ok(())
    };
    let work = || -> anyhow::Result<()> {
        while !interrupted.is_pressed() && !failed.load(Ordering::Relaxed) {
            let Some(cell) = next() else { break };
            one(cell).inspect_err(|_| failed.store(true, Ordering::Relaxed))?;
        }
        Ok(())
    };
    let ended = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs).map(|_| scope.spawn(work)).collect();
        workers.into_iter().map(|worker| worker.join()).collect::<Vec<_>>()
    });
    bar.finish_and_clear();
    for worker in ended {
        worker.map_err(|_| anyhow::anyhow!("a thread panicked; what it said stands above"))??;
    }
    Ok(())
}

/// Drives a cell; `None` where Ctrl-C came between.
fn drive_one(course: &Course, cell: Cell, interrupted: &Interrupted) -> anyhow::Result<Option<Done>> {
    let began = Instant::now();
    let (flags, settings) = resolved(&course.layers, &cell)?;
    let setup = world::setup(&settings, &flags, Some(cell.laps))?;
    let pilot: Box<dyn Pilot> = match course.models.get(&cell.pilot) {
        Some(model) => model.pilot(),
        None => Box::new(PurePursuit::default()),
    };
    let mut driver = Driver::new(pilot, &settings.control, Instant::now);
    let mut simulation = Simulation::new(setup)?;
    let driven = judged::run(&mut simulation, &mut driver, None, |simulation, _, _| {
        interrupted.end(simulation);
        Ok(())
    });
    let judged::Drive { card, fingerprint, .. } = driven.map_err(|error| anyhow::anyhow!(error))?;
    if matches!(simulation.ending(), Some(Ending::Interrupted)) {
        return Ok(None);
    }
    let card = serde_json::to_value(card)?;
    Ok(Some(Done::new(cell, card, fingerprint, began.elapsed().as_secs_f64())))
}
