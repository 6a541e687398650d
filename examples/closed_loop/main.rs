//! Is the autonomy that `lapwing replay --closed-loop` finds the one that the road finds?
//!
//! ```text
//! cargo run --release --example closed_loop -- --out closed_loop.svg
//! ```
//!
//! The expert drives a lap in the simulator, recorded as the stock recorder does, with three cameras. Then each of ten
//! or more pilots drives along that recording, and the same road in the simulator itself: autonomy after Bojarski et
//! al. in both, put back where it is more than the limit off the line. With `--weave 1.6` the recorded car weaves, as
//! people do, and the line is the lane's middle, as it was in truth; with `--from-path` it is the recorded path. The pilots are the shipped models, and the
//! built-in one with defined handicaps (`pilots`), so that anyone finds the same. Prints a table and Spearman's rank
//! correlation, and draws one against the other.

mod pilots;
mod worlds;

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
    time::Instant,
};

use anyhow::{Context, Result, anyhow};
use clap::Parser;
use lapwing_core::{config::ControlSettings, driver::Driver, units::Mph};
use lapwing_learn::nn::runtime;
use lapwing_score::judged;
use lapwing_score::{
    drawing::chart::{Axis, Chart, Marks, Series},
    score::{Figure, Scorecard},
};
use lapwing_sim::{
    along::{DEFAULT_LIMIT_M, Limit, RecordedWorld, Yaw},
    locate::LocatedDrive,
    record::RecordOptions,
    track::Track,
};

use self::{
    pilots::Handicapped,
    worlds::{Kept, record},
};

/// Ranks pilots along a recording and on the road.
#[derive(Parser)]
struct Arguments {
    /// The road: lake, jungle, mountain, random:SEED, or a track file.
    #[arg(long, default_value = "lake")]
    track: String,
    /// How fast, in mph.
    #[arg(long, default_value_t = 20.0)]
    speed: f64,
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
    /// middle, as it was in truth.
    #[arg(long, default_value_t = 0.0)]
    weave: f64,
    /// With --weave, measure from the recorded path all the same.
    #[arg(long)]
    from_path: bool,
    /// Record by the centre camera alone.
    #[arg(long)]
    one_camera: bool,
    /// Where to draw: FILE.svg or FILE.png.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// What one pilot came to.
struct Matched {
    pilot: String,
    replay: Scorecard,
    road: Scorecard,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    runtime::set_threads(1);
    let track = Track::open(&arguments.track)?;
    let folder = tempfile::tempdir()?;
    let recording = folder.path().join(track.file().name.replace([':', '/', '\\'], "-"));
    let speed = Mph::new(arguments.speed).context("--speed")?;
    let options =
        RecordOptions { side_cameras: !arguments.one_camera, weave_m: arguments.weave, ..RecordOptions::at(speed) };
    let located = record(&track, arguments.seconds, options, &recording)?;
    let located = (arguments.weave > 0.0 && !arguments.from_path).then_some(located);
    let pilots = pilots::all(&arguments.models, arguments.quick)?;

    let next = AtomicUsize::new(0);
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let mut rows: Vec<(usize, Matched)> = std::thread::scope(|scope| {
        let work = || {
            let mut rows = Vec::new();
            while let Some(pilot) = pilots.get(next.load(Ordering::Relaxed)) {
                let index = next.fetch_add(1, Ordering::Relaxed);
                let pilot = pilots.get(index).unwrap_or(pilot);
                if index < pilots.len() {
                    rows.push((index, one(&arguments, &track, (&recording, located.clone()), speed, pilot)?));
                    eprintln!("{} driven", pilot.name);
                }
            }
            Ok(rows)
        };
        let threads: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let joined = threads.into_iter().map(|t| t.join().map_err(|_| anyhow!("a thread that drives died"))?);
        joined.collect::<Result<Vec<Vec<_>>>>().map(|rows| rows.into_iter().flatten().collect())
    })?;
    rows.sort_by_key(|(index, _)| *index);
    let rows: Vec<Matched> = rows.into_iter().map(|(_, row)| row).collect();
    print(&arguments, &rows);
    if let Some(path) = &arguments.out {
        draw(&arguments, &rows).sheet(720, 560).write(path)?;
        println!("drawn: {}", path.display());
    }
    Ok(())
}

fn one(
    a: &Arguments,
    track: &Track,
    (recording, located): (&Path, Option<LocatedDrive>),
    speed: Mph,
    pilot: &Handicapped,
) -> Result<Matched> {
    let control = ControlSettings { speed_mph: speed, ..ControlSettings::default() };
    let yaw = if a.by_steering { Yaw::Steering } else { Yaw::Pictures };
    let mut along = RecordedWorld::open(recording, Some(Limit::Metres(a.limit)), yaw, located)?;
    let mut driver = Driver::new(pilot.pilot(), &control, Instant::now);
    let replay = judged::run(&mut along, &mut driver, &mut [])?.card;
    let mut road = Kept::new(track, a.limit, a.seconds)?;
    let mut driver = Driver::new(pilot.pilot(), &control, Instant::now);
    let road = judged::run(&mut road, &mut driver, &mut [])?.card;
    Ok(Matched { pilot: pilot.name.clone(), replay, road })
}

fn autonomy(card: &Scorecard) -> f64 {
    card.value(Figure::Autonomy).unwrap_or(f64::NAN)
}

fn print(arguments: &Arguments, rows: &[Matched]) {
    let (replay, road): (Vec<f64>, Vec<f64>) =
        rows.iter().map(|row| (autonomy(&row.replay), autonomy(&row.road))).unzip();
    let ranks = (ranks(&replay), ranks(&road));
    println!("{} at {} mph, put back beyond {} m", arguments.track, arguments.speed, arguments.limit);
    println!(
        "| pilot | autonomy along the recording | on the road | interventions | on the road | mean offset | on the road | 95th percentile | on the road | largest | on the road | rank | on the road |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (i, row) in rows.iter().enumerate() {
        let value = |card: &Scorecard, figure| card.value(figure).unwrap_or(f64::NAN);
        println!(
            "| {} | {:.1} % | {:.1} % | {} | {} | {:.2} m | {:.2} m | {:.2} m | {:.2} m | {:.2} m | {:.2} m | {} | {} |",
            row.pilot,
            100.0 * replay[i],
            100.0 * road[i],
            value(&row.replay, Figure::Interventions),
            value(&row.road, Figure::Interventions),
            value(&row.replay, Figure::MeanCte),
            value(&row.road, Figure::MeanCte),
            value(&row.replay, Figure::P95Cte),
            value(&row.road, Figure::P95Cte),
            value(&row.replay, Figure::MaxCte),
            value(&row.road, Figure::MaxCte),
            ranks.0[i],
            ranks.1[i],
        );
    }
    match correlation(&ranks.0, &ranks.1) {
        none if none.is_nan() => println!("rank correlation (Spearman): none, as all of them rank alike"),
        correlation => println!("rank correlation (Spearman): {correlation:.3} of {} pilots", rows.len()),
    }
}

/// Ranks from 1, the best first; equal values share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let rank = |value: &f64| {
        let better = values.iter().filter(|other| *other > value).count();
        let equal = values.iter().filter(|other| *other == value).count();
        better as f64 + (equal as f64 + 1.0) / 2.0
    };
    values.iter().map(rank).collect()
}

/// Pearson's, which of ranks is Spearman's.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(&a, &b)| f(a - ma, b - mb)).sum::<f64>();
    sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt()
}

fn draw(arguments: &Arguments, rows: &[Matched]) -> Chart {
    let percent = |label: &str| Axis::new(label).from_to(0.0, 100.0);
    let title = format!("Autonomy of {} pilots on {} at {} mph", rows.len(), arguments.track, arguments.speed);
    let mut chart =
        Chart::new(title, percent("along a recording of the road, %"), percent("on the road in the simulator, %"));
    chart.series.push(Series::new("the same in both", Marks::Line(vec![(0.0, 0.0), (100.0, 100.0)])));
    let points = rows.iter().map(|row| (100.0 * autonomy(&row.replay), 100.0 * autonomy(&row.road))).collect();
    chart.series.push(Series::new("a pilot each", Marks::Points(points)));
    chart
}
