//! Is the autonomy that `lapwing replay --closed-loop` finds the one that the road finds?
//!
//! ```text
//! cargo run --release --example closed_loop -- --out closed_loop.svg
//! ```
//!
//! The expert drives in the simulator, recorded as the stock recorder does, with three cameras. Then each of ten or more
//! pilots drives along that recording, and the same road in the simulator itself, put back where it is more than the
//! limit off the line. Beside it stands what the same pilot's steering is worth open loop: its error against the recorded
//! one. `--track`, `--speed` and `--weave` take several values: all combinations are recorded. Where the recorded car
//! weaves, as people do, the line is the lane's middle, as it was in truth; with `--located` it is the lane found in the
//! pictures, as on real recordings; with `--from-path`, the recorded path. The pilots are the shipped models, and the
//! built-in one with defined handicaps (`handicap`, `pilots`), so that anyone finds the same. Prints tables with Spearman's
//! rank correlation (`rank`, `report`), and draws the ranks.

mod handicap;
mod pilots;
mod rank;
mod report;
mod worlds;

use std::{
    path::PathBuf,
    sync::atomic::{AtomicUsize, Ordering},
    time::Instant,
};

use anyhow::{Context, Result, anyhow};
use clap::Parser;
use lapwing::{known, locating};
use lapwing_core::{
    config::ControlSettings,
    drive,
    driver::Driver,
    recording::CameraPosition,
    replay::{Answers, Rate, Replay, ReplayReport},
    units::Mph,
};
use lapwing_learn::nn::runtime;
use lapwing_score::judged;
use lapwing_sim::{
    along::{DEFAULT_LIMIT_M, Limit, RecordedWorld, Yaw},
    locate::LocatedDrive,
    record::RecordOptions,
    track::Track,
};

use self::{
    pilots::Pilot,
    rank::{Compared, Driven},
    worlds::{Kept, Road},
};

/// Ranks pilots along a recording and on the road.
#[derive(Parser)]
struct Arguments {
    /// The roads: lake, jungle, mountain, random:SEED, random-lanes:SEED, or track files.
    #[arg(long, num_args = 1.., default_value = "lake")]
    track: Vec<String>,
    /// How fast, in mph.
    #[arg(long, num_args = 1.., default_value = "20")]
    speed: Vec<f64>,
    /// Seconds that are driven at most; a lap without.
    #[arg(long)]
    seconds: Option<f64>,
    /// How far off the line a car is put back, in metres.
    #[arg(long, default_value_t = DEFAULT_LIMIT_M)]
    limit: f64,
    /// Further models (.safetensors), besides those in models/.
    #[arg(long, num_args = 1..)]
    models: Vec<PathBuf>,
    /// Leave the ResNet50 out, which takes as long as all others together.
    #[arg(long)]
    quick: bool,
    /// The recorded turning from the steering alone.
    #[arg(long)]
    by_steering: bool,
    /// How far the recorded car weaves to each side of the line, in metres; offsets are then measured from the lane's
    /// middle, as it was in truth unless `--located` or `--from-path` is given.
    #[arg(long, num_args = 1.., default_value = "0")]
    weave: Vec<f64>,
    /// With --weave, measure from the recorded path all the same.
    #[arg(long)]
    from_path: bool,
    /// With --weave, measure from where the lane is found in the pictures.
    #[arg(long, conflicts_with = "from_path")]
    located: bool,
    /// Record by the centre camera alone.
    #[arg(long)]
    one_camera: bool,
    /// Where to draw: FILE.svg or FILE.png.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// A drive of the expert, and the road that it was recorded on.
struct Recorded<'a> {
    road: &'a Road,
    speed: Mph,
    folder: PathBuf,
    /// Where the car was, if offsets are measured from there.
    located: Option<LocatedDrive>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    runtime::set_threads(1);
    let pilots = pilots::all(&arguments.models, arguments.quick)?;
    let mut all = vec![];
    for name in &arguments.track {
        let road = Road::new(Track::open(name)?);
        for &speed in &arguments.speed {
            let mph = Mph::new(speed).context("--speed")?;
            for &weave_m in &arguments.weave {
                let folder = tempfile::tempdir()?;
                let options = RecordOptions { side_cameras: !arguments.one_camera, weave_m, ..RecordOptions::at(mph) };
                let path = folder.path().join("recording");
                let told = road.record(arguments.seconds, options, &path)?;
                let located = if weave_m == 0.0 || arguments.from_path {
                    None
                } else if arguments.located {
                    let roads = known::Roads::with(std::slice::from_ref(name));
                    let found = locating::locate(&path, CameraPosition::Center, &roads, || {})?.drive();
                    Some(found.with_context(|| format!("{name}: the lane was not found in the recorded pictures"))?)
                } else {
                    Some(told)
                };
                let recorded = Recorded { road: &road, speed: mph, folder: path, located };
                let weaves = if weave_m > 0.0 { format!(", weaving {weave_m} m") } else { String::new() };
                let drives = compare(&arguments, &recorded, &pilots)?;
                let compared = Compared { name: format!("{name}, {speed} mph{weaves}"), drives };
                report::print_drives(&compared);
                all.push(compared);
            }
        }
    }
    report::print_correlations(&all);
    if let Some(path) = &arguments.out {
        report::draw(&all).sheet(720, 560).write(path)?;
        println!("\ndrawn: {}", path.display());
    }
    Ok(())
}

/// Each pilot's drives, as many at a time as there are processors.
fn compare(arguments: &Arguments, recorded: &Recorded<'_>, pilots: &[Pilot]) -> Result<Vec<Driven>> {
    let next = AtomicUsize::new(0);
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let mut drives: Vec<(usize, Driven)> = std::thread::scope(|scope| {
        let work = || {
            let mut drives = Vec::new();
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                let Some(pilot) = pilots.get(index) else { return Ok(drives) };
                drives.push((index, drive_both(arguments, recorded, pilot)?));
                eprintln!("{} driven", pilot.name);
            }
        };
        let threads: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let joined = threads.into_iter().map(|t| t.join().map_err(|_| anyhow!("a thread that drives died"))?);
        joined.collect::<Result<Vec<Vec<_>>>>().map(|drives| drives.into_iter().flatten().collect())
    })?;
    drives.sort_by_key(|(index, _)| *index);
    Ok(drives.into_iter().map(|(_, driven)| driven).collect())
}

/// Along the recording, closed loop and open loop, and on the road.
fn drive_both(arguments: &Arguments, recorded: &Recorded<'_>, pilot: &Pilot) -> Result<Driven> {
    let Recorded { road, speed, folder, located } = recorded;
    let control = ControlSettings { speed_mph: *speed, compensate_latency: false, ..ControlSettings::default() };
    let driver = || Driver::new(pilot.ready(), &control, Instant::now);
    let yaw = if arguments.by_steering { Yaw::Steering } else { Yaw::Pictures };
    let limit = Some(Limit::Metres(arguments.limit));
    let mut along = RecordedWorld::open(folder, limit, yaw, located.clone())?;
    let replay = judged::run(&mut along, &mut driver(), &mut [])?.card;
    let mut road = Kept::new(road, arguments.limit, arguments.seconds)?;
    let road = judged::run(&mut road, &mut driver(), &mut [])?.card;
    let (mut open, mut answers) = (Replay::open(folder, Rate::Max)?, Answers::default());
    drive::run(&mut open, &mut driver(), &mut [&mut answers])?;
    let (answers, times) = answers.into_parts();
    let names = (folder.display().to_string(), pilot.name.clone());
    let report = ReplayReport::new(names, &answers, open.losses(), (&times, times.iter().sum()));
    let steering = *report.agreement().map_err(|why| anyhow!("{}: {why}", pilot.name))?;
    Ok(Driven { pilot: pilot.name.clone(), replay, road, steering })
}
