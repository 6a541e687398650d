//! `lapwing suite`: many drives, over all cores, and `lapwing merge`: what they came to.

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

use super::{Ended, Interrupted, world};
use crate::{
    cli,
    config::{Layers, Settings},
    drive,
    driver::Driver,
    nn::{self, runtime},
    pilot::{self, Model, Pilot, PurePursuit},
    simulator::{
        track::Track,
        world::{Ending, Simulation},
    },
    suite::{Cell, Contestant, Done, Results, Suite, groups, render, table},
    units::Mph,
};

pub(super) fn run(arguments: &cli::Suite, config: Option<&Path>) -> anyhow::Result<Ended> {
    let layers = super::undriven_layers(config)?;
    let named = || arguments.suite.display().to_string();
    let text = fs::read_to_string(&arguments.suite).with_context(named)?;
    let suite = Suite::parse(&text).with_context(named)?;
    let mut models = BTreeMap::new();
    for contestant in &suite.pilots {
        if let Some(model) = model_of(contestant)? {
            models.insert(contestant.name.clone(), model);
        }
    }
    let sha256 = |contestant: &Contestant| models.get(&contestant.name).map(|model| model.sha256().to_owned());
    let mut cells = suite.cells(sha256);
    // What is wrong with a track or conditions is said before the first drive, not hours later.
    let tracks = suite.tracks.iter().map(|track| Ok((track.clone(), track_sha256(track)?)));
    let tracks: BTreeMap<_, _> = tracks.collect::<anyhow::Result<_>>()?;
    let beside = suite.pilots.iter().map(|pilot| Ok((pilot.name.clone(), beside(pilot)?)));
    let beside: BTreeMap<_, _> = beside.collect::<anyhow::Result<_>>()?;
    for cell in &mut cells {
        let (flags, settings) = resolved(&layers, cell)?;
        cell.settings = json!({
            "lapwing": env!("CARGO_PKG_VERSION"), "control": settings.control, "simulator": settings.simulator,
            "beside_model_sha256": beside[&cell.pilot],
        });
        cell.world = json!({ "conditions": world::conditions(&flags)?, "track_sha256": tracks[&cell.track] });
    }
    let mut ids = BTreeSet::new();
    cells.retain(|cell| ids.insert(cell.id()));
    let results = Results::open(&arguments.out)?;
    let mut open = VecDeque::new();
    let mut before = 0;
    for (_, cell) in cells.iter().enumerate().filter(|(i, _)| arguments.shard.is_none_or(|shard| shard.has(*i))) {
        match results.get(cell)? {
            Some(_) => before += 1,
            None => open.push_back(cell.clone()),
        }
    }
    tracing::info!("{} cells, {before} of them driven before", before + open.len());
    // Each drive has one thread, and the same bytes on every machine.
    runtime::set_threads(1);
    let interrupted = super::interrupted();
    drive_all(&Course { layers, models }, open, &results, arguments.jobs, &interrupted)?;
    if interrupted.is_pressed() {
        bail!("interrupted; the same command goes on where it was");
    }
    // Of what else lies in the folder nothing belongs to this suite.
    let done = cells.iter().filter_map(|cell| results.get(cell).transpose()).collect::<Result<_, _>>()?;
    report(done, &arguments.out, arguments.html.as_deref(), arguments.json)
}

/// The hash of a track's file; of one that comes with Lapwing none.
fn track_sha256(track: &str) -> anyhow::Result<Option<String>> {
    Track::open(track)?;
    if !Path::new(track).is_file() {
        return Ok(None);
    }
    let bytes = fs::read(track).with_context(|| track.to_owned())?;
    Ok(Some(nn::sha256_hex(&bytes)))
}

/// The hash of what lies beside a TorchScript model and says how its frames are prepared.
fn beside(contestant: &Contestant) -> anyhow::Result<Option<String>> {
    let Some(path) = contestant.model.as_ref().filter(|path| path.extension().is_some_and(|e| e == "pt")) else {
        return Ok(None);
    };
    let side = path.with_extension("toml");
    let bytes = fs::read(&side).with_context(|| side.display().to_string())?;
    Ok(Some(nn::sha256_hex(&bytes)))
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

/// `lapwing merge`: the results of several folders in one.
pub(super) fn merge(arguments: &cli::Merge) -> anyhow::Result<Ended> {
    let target = Results::open(&arguments.out)?;
    for folder in &arguments.folders {
        if !folder.join("cells").is_dir() {
            bail!("{}: expected the folder of a suite, with cells in it", folder.display());
        }
        for done in Results::open(folder)?.all()? {
            match target.get(&done.cell)? {
                Some(other) if other.fingerprint != done.fingerprint => {
                    bail!(
                        "{}: driven twice, with other frames: {} and {}",
                        done.cell,
                        other.fingerprint,
                        done.fingerprint
                    );
                }
                Some(_) => {}
                None => target.keep(&done)?,
            }
        }
    }
    report(target.all()?, &arguments.out, arguments.html.as_deref(), arguments.json)
}

fn report(done: Vec<Done>, out: &Path, html: Option<&Path>, as_json: bool) -> anyhow::Result<Ended> {
    let groups = groups(&done);
    let text = serde_json::to_string_pretty(&json!({ "schema": "lapwing.suite/1", "groups": groups }))?;
    let write = |path: &Path, text: &str| fs::write(path, text).with_context(|| path.display().to_string());
    write(&out.join("suite.json"), &text)?;
    write(html.unwrap_or(&out.join("suite.html")), &render(&groups)?)?;
    super::print(&if as_json { text } else { table(&groups) });
    Ok(Ended::Passed)
}

fn model_of(contestant: &Contestant) -> anyhow::Result<Option<Model>> {
    Ok(match &contestant.model {
        _ if contestant.expert => None,
        Some(path) => Some(pilot::load(path, Instant::now)?),
        None => Some(pilot::built_in(Instant::now)?),
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
    jobs: Option<usize>,
    interrupted: &Interrupted,
) -> anyhow::Result<()> {
    let jobs = jobs.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)).max(1);
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
    let driven = drive::run(&mut simulation, &mut driver, None, |simulation, _, _| {
        interrupted.end(simulation);
        Ok(())
    });
    let drive::Drive { card, fingerprint, .. } = driven.map_err(|error| anyhow::anyhow!(error))?;
    if matches!(simulation.ending(), Some(Ending::Interrupted)) {
        return Ok(None);
    }
    let card = serde_json::to_value(card)?;
    Ok(Some(Done::new(cell, card, fingerprint, began.elapsed().as_secs_f64())))
}
