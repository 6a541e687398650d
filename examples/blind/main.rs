//! How far `lapwing score` is to be believed where a run reports neither position nor collisions.
//!
//! ```sh
//! cargo run --release --example blind
//! ```
//!
//! drives the three tracks a hundred times in random weather, half of the runs the other way round: experts and PilotNet, the
//! small CNN, PilotNet with pictures that come half a second to one and a half late, and pilots that do not look. Every fifth
//! run has a second drive joined to it, on another road. Each is recorded as other builds would have it, with steering that lags
//! and is geared otherwise, scored from that file alone, and held against what the judge in the simulator saw. Exit status 1
//! where a road is named wrongly, fewer than nine of ten intervals of laps hold the truth, or collisions are found with a
//! precision or recall below 0.9. After `--` stand the runs to drive, of 0 to 99, and `--keep DIR`, where they stay, to be
//! looked into; `--steering` keeps the scorer from looking at the pictures for how the car turned; `--laps N` sets
//! the laps of each run's first drive, and `--gear X` how the steering of every run is geared.

mod build;
mod report;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{
        Arc, Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Instant,
};

use lapwing::{known, locating};
use lapwing_core::{
    config::ControlSettings,
    driver::Driver,
    pilot::{ConstantPilot, Pilot, PurePursuit},
    protocol::Dialect,
    recording::{EventRecord, Item, Recorder, RecorderOptions, Recording, RunHeader, RunKind},
    units::{Mph, Steering},
};
use lapwing_learn::models;
use lapwing_learn::{models::LoadedModel, nn::runtime};
use lapwing_score::judged::{self, Judged};
use lapwing_score::{
    odometry::Road,
    score::{self, Scorecard, Scorer},
};
use lapwing_sim::{
    camera::Scenery,
    conditions::Conditions,
    track::Track,
    world::{Setup, Simulation},
};

type Error = Box<dyn std::error::Error + Send + Sync>;

const RUNS: usize = 100;

#[derive(Clone, Copy)]
enum Who {
    Expert,
    PilotNet,
    Cps,
    Late(f64),
    Constant(f64),
}

impl Who {
    /// One for each run: a quarter each good, good with a network, bad, terrible.
    fn of(run: usize) -> Self {
        match run / 3 % 8 {
            0 => Self::Expert,
            1 | 2 => Self::PilotNet,
            3 | 4 => Self::Cps,
            5 => Self::Late([500.0, 900.0, 1500.0][run / 24 % 3]),
            6 => Self::Late(700.0),
            _ => Self::Constant([0.0, 0.15, -0.15, -0.06, 0.06][run / 24 % 5]),
        }
    }

    fn name(self) -> String {
        match self {
            Self::Expert => "expert".into(),
            Self::PilotNet => "pilotnet".into(),
            Self::Cps => "cps".into(),
            Self::Late(ms) => format!("pilotnet, {ms} ms late"),
            Self::Constant(steering) => format!("steering {steering}"),
        }
    }
}

struct Roads {
    /// Each track and what stands beside it, in its own direction and the other way round.
    worlds: Vec<[(Arc<Track>, Arc<Scenery>); 2]>,
    known: Vec<Arc<Road>>,
    pilotnet: LoadedModel,
    cps: LoadedModel,
    /// Whether the scorer may look at how the car turned by its pictures.
    sees: bool,
    /// Laps of each run's first drive; otherwise one or two.
    laps: Option<u32>,
    /// How steering is geared; otherwise as [`build::Build::of`] says.
    gear: Option<f64>,
}

/// A drive, as it was.
struct Driven {
    track: String,
    reversed: bool,
    /// Along the road, in laps; `None` if the car left it.
    laps: Option<f64>,
    truth: Scorecard,
    /// By the judge's waypoints.
    completion: f64,
}

/// A run, and what is found of it.
struct BlindRun {
    run: usize,
    who: Who,
    mph: f64,
    drives: Vec<Driven>,
    found: Scorecard,
    /// When the car seems to have collided, in seconds.
    suspected: Vec<f64>,
}

fn main() -> Result<ExitCode, Error> {
    runtime::set_threads(1);
    let mut roads = Roads {
        worlds: vec![],
        known: known::Roads::default().both_ways()?,
        pilotnet: models::built_in(Instant::now)?,
        cps: models::load("models/cps.safetensors", Instant::now)?,
        sees: true,
        laps: None,
        gear: None,
    };
    for name in Track::NAMES {
        let track = Track::named(name)?;
        let reversed = track.reversed()?;
        let worlds = [track, reversed].map(|track| {
            let scenery = Arc::new(Scenery::new(&track));
            (Arc::new(track), scenery)
        });
        roads.worlds.push(worlds);
    }
    let scratch = tempfile::tempdir()?;
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let mut value = |flag: &str| {
        let at = args.iter().position(|arg| arg == flag).filter(|at| at + 1 < args.len())?;
        args.drain(at..at + 2).nth(1)
    };
    let keep = value("--keep").map(PathBuf::from);
    roads.laps = value("--laps").map(|laps| laps.parse()).transpose()?;
    roads.gear = value("--gear").map(|gear| gear.parse()).transpose()?;
    if let Some(at) = args.iter().position(|arg| arg == "--steering") {
        args.remove(at);
        roads.sees = false;
    }
    let folder = keep.as_deref().unwrap_or(scratch.path());
    let runs: Vec<usize> = args.iter().map(|run| run.parse()).collect::<Result<_, _>>()?;
    let runs = if runs.is_empty() { (0..RUNS).collect() } else { runs };
    let (next, rows) = (AtomicUsize::new(0), Mutex::new(vec![]));
    let work = || -> Result<(), Error> {
        loop {
            let Some(&run) = runs.get(next.fetch_add(1, Ordering::Relaxed)) else { return Ok(()) };
            let row = blind(&roads, run, folder, keep.is_some())?;
            eprintln!("{}", report::told(&row));
            rows.lock().map_err(|_| "a thread panicked")?.push(row);
        }
    };
    let workers = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        let threads: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        threads.into_iter().try_for_each(|thread| thread.join().unwrap_or_else(|_| Err("a thread panicked".into())))
    })?;
    let mut rows = rows.into_inner().map_err(|_| "a thread panicked")?;
    rows.sort_by_key(|row| row.run);
    Ok(report::report(&rows))
}

fn header(run: usize) -> RunHeader {
    RunHeader {
        seed: Some(run as u64),
        dialect: Some(Dialect::Term1),
        ..RunHeader::new(RunKind::Driven, serde_json::Value::Null, jiff::Timestamp::now())
    }
}

/// Drives and scores one run.
fn blind(roads: &Roads, run: usize, folder: &Path, keep: bool) -> Result<BlindRun, Error> {
    let who = Who::of(run);
    let mph: f64 = [20.0, 15.0, 25.0, 30.0][(run / 3 + run / 24) % 4];
    let laps = roads.laps.unwrap_or(1 + (run / 24 % 2) as u32);
    let mut plans = vec![(run % 3, who, mph, laps)];
    if run % 5 == 4 {
        plans.push(((run + 1) % 3, Who::Expert, 20.0, 1));
    }
    let (mut drives, mut paths) = (vec![], vec![]);
    for (i, (road, who, mph, laps)) in plans.into_iter().enumerate() {
        let name = folder.join(format!("{run}-{i}"));
        let (driven, path) = drive(roads, (road, (run + i) / 3 % 2), run, (who, mph, laps), &name)?;
        drives.push(driven);
        paths.push(path);
    }
    let path = folder.join(format!("{run}.mcap"));
    let build = build::Build::of(run);
    let build = build::Build { gear: roads.gear.unwrap_or(build.gear), ..build };
    build::rewrite(&paths.iter().map(PathBuf::as_path).collect::<Vec<_>>(), build, header(run), &path)?;
    let again = path.clone();
    let scorer = Scorer::on(&roads.known, Some(laps));
    let turns = move || locating::turns(&again).map_err(|error| error.to_string());
    let scorer = if roads.sees { scorer.seeing(turns) } else { scorer };
    let mut suspected = vec![];
    let found = score::of_recording(&mut Recording::open(&path)?, scorer, |at, item| {
        if matches!(item, Item::Event(EventRecord::Note { text }) if text.starts_with("probably a collision")) {
            suspected.push(at.as_secs_f64());
        }
    })?;
    paths.iter().try_for_each(std::fs::remove_file)?;
    if !keep {
        std::fs::remove_file(&path)?;
    }
    Ok(BlindRun { run, who, mph, drives, found, suspected })
}

/// Drives one drive, on a road in its own direction (0) or the other way round (1), and records it.
fn drive(
    roads: &Roads,
    (road, way): (usize, usize),
    run: usize,
    (who, mph, laps): (Who, f64, u32),
    to: &Path,
) -> Result<(Driven, PathBuf), Error> {
    let (track, scenery) = roads.worlds[road][way].clone();
    let name = Track::NAMES[road];
    let mph = if name == "jungle" { mph.min(20.0) } else { mph };
    let mut conditions = Conditions::random(run as u64);
    if let Who::Late(ms) = who {
        conditions.latency_ms = ms;
    }
    let setup = Setup {
        laps: Some(laps),
        longest_s: Some(300.0 * f64::from(laps.max(2))),
        seed: run as u64,
        stock: true,
        conditions,
        ..Setup::new(track.clone(), scenery)
    };
    let pilot: Box<dyn Pilot> = match who {
        Who::Expert => Box::new(PurePursuit::default()),
        Who::PilotNet | Who::Late(_) => roads.pilotnet.pilot(),
        Who::Cps => roads.cps.pilot(),
        Who::Constant(steering) => Box::new(ConstantPilot::new(Steering::saturating(steering))),
    };
    let control =
        ControlSettings { speed_mph: Mph::new(mph)?, compensate_latency: false, ..ControlSettings::default() };
    let mut driver = Driver::new(pilot, &control, Instant::now);
    let recorder = Recorder::create(to, header(run), RecorderOptions::default())?;
    let mut world = Simulation::new(setup)?;
    let driven = judged::run(&mut world, &mut driver, &mut [&mut &recorder]);
    let recorded = recorder.finish();
    let Judged { card: truth, .. } = driven?;
    let judge = world.judge();
    let progress = f64::from(judge.laps()) + judge.waypoint() as f64 / judge.waypoints() as f64;
    let along = (!judge.off_road()).then(|| judge.progress_m() / track.length());
    let driven = Driven {
        track: name.to_owned(),
        reversed: way == 1,
        laps: along,
        truth,
        completion: (progress / f64::from(laps)).min(1.0),
    };
    Ok((driven, recorded.path))
}
