//! How far `lapwing score` is to be believed where a run reports neither position nor collisions.
//!
//! ```sh
//! cargo run --release --example blind
//! ```
//!
//! drives the three tracks a hundred times in random weather: experts and PilotNet, the small CNN, PilotNet with pictures
//! that come half a second to one and a half late, and pilots that do not look. Each run is recorded as the stock build
//! would have it, scored from that file alone, and held against what the judge in the simulator saw. Exit status 1 where
//! a track is named wrongly, a completion is further off than 2 percentage points, a lap count differs, or collisions
//! are found with a precision or recall below 0.9. After `--` stand the runs to drive, of 0 to 99, and `--keep DIR`, where
//! they stay, to be looked into.

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

use lapwing::known::known_road;
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
    score::{self, Figure, Scorecard, Scorer},
};
use lapwing_sim::{
    camera::Scenery,
    conditions::Conditions,
    track::Track,
    world::{Setup, Simulation},
};

type Error = Box<dyn std::error::Error + Send + Sync>;

const RUNS: usize = 100;
/// Points of completion that an estimate may be off.
const COMPLETION: f64 = 0.02;
/// A collision is found where one is suspected within so many seconds of it.
const SAME_S: f64 = 2.0;
/// Least precision and recall of collisions.
const COLLISIONS: f64 = 0.9;

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
    worlds: Vec<(Arc<Track>, Arc<Scenery>)>,
    known: Vec<Arc<Road>>,
    pilotnet: LoadedModel,
    cps: LoadedModel,
}

struct BlindDrive {
    run: usize,
    who: Who,
    mph: f64,
    truth: Scorecard,
    /// By the judge's waypoints.
    completion: f64,
    found: Scorecard,
    /// When the car seems to have collided, in seconds.
    suspected: Vec<f64>,
}

fn main() -> Result<ExitCode, Error> {
    runtime::set_threads(1);
    let mut roads = Roads {
        worlds: vec![],
        known: vec![],
        pilotnet: models::built_in(Instant::now)?,
        cps: models::load("models/cps.safetensors", Instant::now)?,
    };
    for name in Track::NAMES {
        let track = Track::named(name)?;
        roads.known.push(Arc::new(known_road(name)?));
        roads.worlds.push((Arc::new(track.clone()), Arc::new(Scenery::new(&track))));
    }
    let scratch = tempfile::tempdir()?;
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let keep = args.iter().position(|arg| arg == "--keep").filter(|at| at + 1 < args.len());
    let keep = keep.map(|at| args.drain(at..at + 2).nth(1).map(PathBuf::from).unwrap_or_default());
    let folder = keep.as_deref().unwrap_or(scratch.path());
    let runs: Vec<usize> = args.iter().map(|run| run.parse()).collect::<Result<_, _>>()?;
    let runs = if runs.is_empty() { (0..RUNS).collect() } else { runs };
    let (next, rows) = (AtomicUsize::new(0), Mutex::new(vec![]));
    let work = || -> Result<(), Error> {
        loop {
            let Some(&run) = runs.get(next.fetch_add(1, Ordering::Relaxed)) else { return Ok(()) };
            let row = drive(&roads, run, folder, keep.is_some())?;
            eprintln!("{}", told(&row));
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
    Ok(report(&rows))
}

/// Drives and scores one run.
fn drive(roads: &Roads, run: usize, folder: &Path, keep: bool) -> Result<BlindDrive, Error> {
    let who = Who::of(run);
    let (track, scenery) = roads.worlds[run % roads.worlds.len()].clone();
    let mph: f64 = [20.0, 15.0, 25.0, 30.0][(run / 3 + run / 24) % 4];
    let mph = if track.file().name == "jungle" { mph.min(20.0) } else { mph };
    let laps = 1 + (run / 24 % 2) as u32;
    let mut conditions = Conditions::random(run as u64);
    if let Who::Late(ms) = who {
        conditions.latency_ms = ms;
    }
    let setup = Setup {
        laps: Some(laps),
        longest_s: Some(600.0),
        seed: run as u64,
        stock: true,
        conditions,
        ..Setup::new(track, scenery)
    };
    let pilot: Box<dyn Pilot> = match who {
        Who::Expert => Box::new(PurePursuit::default()),
        Who::PilotNet | Who::Late(_) => roads.pilotnet.pilot(),
        Who::Cps => roads.cps.pilot(),
        Who::Constant(steering) => Box::new(ConstantPilot::new(Steering::saturating(steering))),
    };
    let control = ControlSettings { speed_mph: Mph::new(mph)?, ..ControlSettings::default() };
    let mut driver = Driver::new(pilot, &control, Instant::now);
    let header = RunHeader {
        kind: RunKind::Driven,
        name_hint: None,
        dialect: Some(Dialect::Term1),
        model: None,
        seed: Some(run as u64),
        config: serde_json::Value::Null,
        lapwing: env!("CARGO_PKG_VERSION").to_owned(),
        started: jiff::Timestamp::now(),
    };
    let recorder = Recorder::create(&folder.join(run.to_string()), header, RecorderOptions::default())?;
    let mut world = Simulation::new(setup)?;
    let driven = judged::run(&mut world, &mut driver, &mut [&mut &recorder]);
    let recorded = recorder.finish();
    let Judged { card: truth, .. } = driven?;
    let judge = world.judge();
    let progress = f64::from(judge.laps()) + judge.waypoint() as f64 / judge.waypoints() as f64;
    let completion = (progress / f64::from(laps)).min(1.0);
    let scorer = Scorer::on(&roads.known, Some(laps));
    let mut suspected = vec![];
    let found = score::of_recording(&mut Recording::open(&recorded.path)?, scorer, |at, item| {
        if matches!(item, Item::Event(EventRecord::Note { text }) if text.starts_with("a collision")) {
            suspected.push(at.as_secs_f64());
        }
    })?;
    if !keep {
        std::fs::remove_file(&recorded.path)?;
    }
    Ok(BlindDrive { run, who, mph, truth, completion, found, suspected })
}

fn figure(card: &Scorecard, figure: Figure) -> f64 {
    card.value(figure).unwrap_or(f64::NAN)
}

fn told(row: &BlindDrive) -> String {
    let BlindDrive { run, who, mph, truth, completion, found, .. } = row;
    let track = |card: &Scorecard| card.track.clone().unwrap_or_else(|| "-".into());
    let both = |of: Figure| format!("{:>6} {:>6}", figure(truth, of), figure(found, of));
    format!(
        "{run:>3}  {:<24} {mph:>2}  {:<8} {:<8}  {}  {}  {}  {}{}",
        who.name(),
        track(truth),
        track(found),
        format_args!("{:>6.1} {:>6.1}", 100.0 * completion, 100.0 * figure(found, Figure::Completion)),
        both(Figure::Laps),
        both(Figure::Collisions),
        truth.ended.as_deref().unwrap_or("-"),
        if wrong(row).is_empty() { String::new() } else { format!("  WRONG: {}", wrong(row).join(", ")) },
    )
}

/// How far off the completion is, if there is any.
fn off(row: &BlindDrive) -> Option<f64> {
    Some((row.found.value(Figure::Completion)? - row.completion).abs())
}

/// How far off each lap's time is, in seconds.
fn lap_times_off(row: &BlindDrive) -> impl Iterator<Item = f64> {
    let (truth, found) = (&row.truth.lap_times_s, &row.found.lap_times_s);
    let pairs = truth.iter().zip(found).filter(|_| truth.len() == found.len());
    pairs.map(|(truth, found)| (truth - found).abs())
}

/// What of a run is not as the judge saw it, collisions left aside.
fn wrong(row: &BlindDrive) -> Vec<&'static str> {
    let BlindDrive { truth, found, .. } = row;
    [
        (truth.track != found.track, "track"),
        (off(row).is_none_or(|off| off > COMPLETION), "completion"),
        (truth.value(Figure::Laps) != found.value(Figure::Laps), "laps"),
    ]
    .into_iter()
    .filter_map(|(wrong, what)| wrong.then_some(what))
    .collect()
}

fn report(rows: &[BlindDrive]) -> ExitCode {
    println!(
        "run  pilot                   mph  track    found     completion %    laps           collisions     ended"
    );
    for row in rows {
        println!("{}", told(row));
    }
    let (mut both, mut told, mut seen) = (0.0, 0.0, 0.0);
    for BlindDrive { truth, suspected, .. } in rows {
        let struck = figure(truth, Figure::Collisions);
        // A run ends with its collision.
        let right = suspected.iter().any(|at| (at - figure(truth, Figure::TimeS)).abs() < SAME_S);
        both += if right { struck } else { 0.0 };
        (told, seen) = (told + suspected.len() as f64, seen + struck);
    }
    let (precision, recall) = (both / f64::max(told, 1.0), both / f64::max(seen, 1.0));
    let right = |what: &str| rows.iter().filter(|row| !wrong(row).contains(&what)).count();
    let n = rows.len();
    let worst = rows.iter().filter_map(off).fold(0.0, f64::max);
    println!("track named right     {} of {n}", right("track"));
    println!("completion within 2 % {} of {n}, worst {:.1} points off", right("completion"), 100.0 * worst);
    println!("lap counts equal      {} of {n}", right("laps"));
    let mut times: Vec<f64> = rows.iter().flat_map(lap_times_off).collect();
    times.sort_by(f64::total_cmp);
    if let (Some(middle), Some(worst)) = (times.get(times.len() / 2), times.last()) {
        println!("lap times             {} laps, {middle:.1} s off in the median, {worst:.1} s at worst", times.len());
    }
    println!(
        "collisions            precision {precision:.2} ({both} of {told}), recall {recall:.2} ({both} of {seen})"
    );
    let good = rows.iter().all(|row| wrong(row).is_empty()) && precision >= COLLISIONS && recall >= COLLISIONS;
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
