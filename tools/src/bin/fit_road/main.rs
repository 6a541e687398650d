//! Fits a track's course to a real drive: its bends, its hills, and where on it each picture was taken.
//!
//! ```sh
//! J=../shared/recordings/jungle
//! cargo run --release -p lapwing-tools --bin fit_road -- $J $J-rest --from 936 --heading 0.45 --out fitted
//! cargo run --release -p lapwing-tools --bin fit_road -- $J $J-rest --from 936 --finer --rounds 18 --out fitted
//! cargo run --release -p lapwing-tools --bin judge_road -- $J --track my.toml --poses fitted/poses.csv
//! ```
//! ```text
//! track ─▶ course: control points ─┐
//! stands: where each picture was ──┴▶ where the lines should be seen ─▶ found some pixels beside ─┐
//! log: how far the car went and turned ──────────────────────────────────────────────────────────┴▶ least squares
//!    ▲                                                                                                   │
//!    └──────────────── course and stands, a little better ◀──────────────────────────────────────────────┘
//! ```
//! First it goes along the drive, some metres at a time, with the last 45 m of pictures and the road ahead of them free;
//! then over the whole drive at once, which also closes the lap. The state is saved as it goes; the same command goes on
//! from it. It writes, to the folder `--out`:
//!
//! | file | holds |
//! |---|---|
//! | `state.json` | control points and stands so far |
//! | `points.toml` | the fitted control points, as a track's file has them |
//! | `poses.csv` | where each picture was taken on the fitted track, and how well it is explained |
//! | `sheet.png` | some pictures, with the lines where they are expected (magenta) and found (green) |
//!
//! | module | holds |
//! |---|---|
//! | `lines` | the painted lines, searched for in a picture |
//! | `witness` | residuals and their derivatives: of pictures and of the log |
//! | `solve` | the least squares |
//! | `fit` | a step of the fit, and what is known beforehand |
//! | `search` | where a car is at first, and again where it was lost |
//!
//! Roads are drawn without a cross slope, so none is fitted: where the real one leans, the stands' roll takes it up.

#![allow(clippy::print_stdout)] // its result, for us to read

mod fit;
mod lines;
mod search;
mod sheet;
mod solve;
mod witness;

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use glam::DVec3;
use lapwing_sim::track::{Theme, Track};
use lapwing_tools::{
    course::{Course, Stand},
    drive::Drive,
};

use crate::{
    fit::{Fit, Step, Trust},
    lines::{Line, Mark},
};

/// Fits a track's control points to the pictures of a real drive.
#[derive(Debug, Parser)]
struct Args {
    /// Udacity folders that follow one another.
    #[arg(required = true)]
    recordings: Vec<PathBuf>,
    /// The track as it is known: a name or a file.
    #[arg(long, default_value = "jungle")]
    track: String,
    /// Only that many of its first rows.
    #[arg(long, default_value_t = usize::MAX)]
    rows: usize,
    /// Where the drive begins, in metres along the road as it is known.
    #[arg(long)]
    from: f64,
    /// Radians clockwise from the road's direction that the car heads at first.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    heading: f64,
    /// The bends are not known: the track is no more than the way that the car went.
    #[arg(long)]
    unknown: bool,
    /// How far the road may climb from how it is known, in metres: a standard deviation.
    #[arg(long, default_value_t = 3.0)]
    hills: f64,
    /// Steps over the whole drive.
    #[arg(long, default_value_t = 12)]
    rounds: usize,
    /// With control points twice as close; the state of a fit with the given ones is taken over.
    #[arg(long)]
    finer: bool,
    /// Rows, from and to, where the fit went wrong: they are placed again from the last to the first, as the road that
    /// they see is known from the pictures behind them.
    #[arg(long, num_args = 2, value_names = ["FROM", "TO"])]
    back: Vec<usize>,
    /// Where results are written.
    #[arg(long)]
    out: PathBuf,
    /// The first row on the sheet.
    #[arg(long, default_value_t = 0)]
    look: usize,
    /// Every how many-th row is on it; by default they are spread over the drive.
    #[arg(long)]
    every: Option<usize>,
}

/// Going along the drive: the pictures that are free at a time, and how many more each time.
const WINDOW: usize = 90;
const MORE: usize = 2;
/// How far ahead lines are searched for then, and later, in metres.
const NEAR_M: f64 = 15.0;
const FAR_M: f64 = 45.0;
/// Steps taken then: each time so many.
const ALONG: Step = Step { reach_px: 9.0, robust_px: 4.0, known_ahead: false };
const STEPS: usize = 2;
/// Rows between two savings of the state.
const SAVED: usize = 100;
/// Where the jungle's lines are: the edge line's middle, in metres from the road's edge, and widths in metres.
const EDGE_IN_M: f64 = 0.15;
const EDGE_M: f64 = 0.14;
const DASH_M: f64 = 0.16;
/// Where leaves begin on the mountain, in metres from the road's middle, and how wide they lie: so wide that the car's nose
/// points neither up nor down on average.
const LEAVES_AT_M: f64 = 4.55;
const LEAVES_M: f64 = 0.6;
/// Drivers keep a little closer to the road's middle than to the middle of their lane.
const LEFT_OF_LANE_M: f64 = 0.2;
/// Pictures on the sheet.
const SHOWN: usize = 18;

fn main() -> Result<()> {
    let args = Args::parse();
    fs::create_dir_all(&args.out)?;
    let track = Track::open(&args.track)?;
    let drive = Drive::read(&args.recordings, 0, args.rows)?;
    let way_m = drive.motions.iter().map(|motion| motion.way_m).sum::<f64>();
    println!("{} pictures, {way_m:.0} m", drive.frames.len());
    let mut fit = begun(&args, &track, &drive);
    let state = args.out.join("state.json");
    if state.exists() {
        load(&mut fit, &state)?;
        println!("goes on from {} pictures", fit.stands.len());
    }
    if let [from, to] = args.back[..] {
        ensure!(from < to && to < fit.stands.len(), "--back: expected rows of the fit so far, got {from} to {to}");
        backwards(&mut fit, from, to);
    }
    along(&mut fit, &state)?;
    whole(&mut fit, args.rounds, &state)?;
    write(&fit, &track, &args)
}

/// A fit that has seen nothing yet.
fn begun<'a>(args: &Args, track: &Track, drive: &'a Drive) -> Fit<'a> {
    let file = track.file();
    let mut given = Course::of(track);
    let (mut flat_m, mut smooth_m, mut smooth_height_m) = (1.5, 1.5, 1.5);
    if args.unknown {
        (flat_m, smooth_m, smooth_height_m) = (20.0, 0.5, 0.15);
    }
    if args.finer {
        given = given.finer();
        (smooth_m, smooth_height_m) = (0.3, 0.3);
    }
    let line = |offset_m, width_m, mark| Line { offset_m, width_m, mark };
    let lines = if file.theme == Theme::Mountain {
        vec![line(LEAVES_AT_M, LEAVES_M, Mark::Leaves(1.0)), line(-LEAVES_AT_M, LEAVES_M, Mark::Leaves(-1.0))]
    } else {
        let edge_m = track.half_width() - EDGE_IN_M;
        vec![
            line(edge_m, EDGE_M, Mark::Edge(1.0)),
            line(0.0, DASH_M, Mark::Middle),
            line(-edge_m, EDGE_M, Mark::Edge(-1.0)),
        ]
    };
    Fit {
        drive,
        lines,
        first: [given.beside(track.point(args.from, 0.0)), file.driving_line_m, args.heading, 0.0, 0.0],
        course: given.clone(),
        given,
        stands: Vec::new(),
        trust: Trust { flat_m, height_m: args.hills, bends_known: !args.unknown, smooth_m, smooth_height_m },
        lane_m: Some(file.driving_line_m - LEFT_OF_LANE_M),
        far_m: NEAR_M,
    }
}

/// Goes on along the drive to its end.
fn along(fit: &mut Fit<'_>, state: &Path) -> Result<()> {
    let count = fit.drive.frames.len();
    while fit.stands.len() < count {
        fit.extend(fit.stands.len() + MORE);
        let until = fit.stands.len();
        for _ in 0..STEPS {
            fit.step(until.saturating_sub(WINDOW)..until, ALONG).context("nothing is seen of the road")?;
        }
        if until.is_multiple_of(SAVED) || until == count {
            save(fit, state)?;
            let ([t, offset_m, heading, ..], explained) = (fit.stands[until - 1], fit.explained(until - 1));
            println!("{until}: at {t:.1} knots, {offset_m:+.1} m, {heading:+.2} rad: {explained}");
        }
    }
    Ok(())
}

/// Places the pictures from `from` up to `to` again, the last one first.
fn backwards(fit: &mut Fit<'_>, from: usize, to: usize) {
    fit.forget(from, to);
    for i in (from..to).rev() {
        fit.precede(i);
        let window = i..(i + WINDOW).min(fit.stands.len());
        for _ in 0..=STEPS {
            if fit.step(window.clone(), Step { known_ahead: true, ..ALONG }).is_none() {
                println!("{i}: nothing is seen of the road");
            }
        }
    }
}

/// Steps over the whole drive.
fn whole(fit: &mut Fit<'_>, rounds: usize, state: &Path) -> Result<()> {
    (fit.far_m, fit.lane_m) = (FAR_M, None);
    for round in 0..rounds {
        if round == rounds / 3 {
            println!("{} pictures placed anew", fit.search_again());
        }
        let reach_px = if round < rounds / 2 { 6.0 } else { 4.0 };
        let step = Step { reach_px, robust_px: 2.5, known_ahead: false };
        let sum = fit.step(0..fit.stands.len(), step).context("the course is not determined")?;
        println!("round {round}: sum of squares {sum:.0}");
        save(fit, state)?;
    }
    Ok(())
}

fn save(fit: &Fit<'_>, path: &Path) -> Result<()> {
    let points: Vec<[f64; 3]> = fit.course.points.iter().map(DVec3::to_array).collect();
    let unfinished = path.with_extension("unfinished");
    fs::write(&unfinished, serde_json::to_string(&(points, &fit.stands))?)?;
    Ok(fs::rename(unfinished, path)?)
}

fn load(fit: &mut Fit<'_>, path: &Path) -> Result<()> {
    let (points, stands): (Vec<[f64; 3]>, Vec<Stand>) = serde_json::from_str(&fs::read_to_string(path)?)?;
    fit.course.points = points.into_iter().map(DVec3::from_array).collect();
    fit.stands = stands;
    if fit.course.points.len() * 2 == fit.given.points.len() {
        fit.course = fit.course.finer();
        fit.stands.iter_mut().for_each(|stand| stand[0] *= 2.0);
    }
    let (expected, got) = (fit.given.points.len(), fit.course.points.len());
    ensure!(expected == got, "{}: expected {expected} control points, got {got}", path.display());
    ensure!(fit.stands.len() <= fit.drive.frames.len(), "{}: more rows than the drive has", path.display());
    Ok(())
}

/// Writes and prints what was found.
fn write(fit: &Fit<'_>, track: &Track, args: &Args) -> Result<()> {
    fs::write(args.out.join("points.toml"), fit.course.to_string())?;

    let mut file = track.file().clone();
    file.control_points = fit.course.points.iter().map(DVec3::to_array).collect();
    let fitted = Track::new(file)?;
    let mut poses = String::from("row,s_m,offset_m,heading_rad,pitch_rad,roll_rad,expected,found,off_px\n");
    let (mut expected, mut found, mut near) = (0, 0, None);
    for (i, &[t, offset_m, heading, pitch, roll]) in fit.stands.iter().enumerate() {
        let place = fitted.locate(fit.course.point(t, 0.0), near).station.s;
        near = Some(place);
        let explained = fit.explained(i);
        (expected, found) = (expected + explained.expected, found + explained.found);
        poses += &format!("{i},{place:.2},{offset_m:.3},{heading:.4},{pitch:.4},{roll:.4},");
        poses += &format!("{},{},{:.2}\n", explained.expected, explained.found, explained.off_px);
    }
    fs::write(args.out.join("poses.csv"), poses)?;
    println!("{found} of {expected} pieces of lines found; {:.1} m long, was {:.1} m", fitted.length(), track.length());

    let outwards: Vec<(f64, f64)> = (0..fit.stands.len()).flat_map(|i| fit.outwards(i)).collect();
    for (from, to) in [(0.0, 6.0), (6.0, 10.0), (10.0, 16.0), (16.0, 30.0)] {
        let mut here: Vec<f64> =
            outwards.iter().filter(|(_, away_m)| (from..to).contains(away_m)).map(|(out_m, _)| *out_m).collect();
        here.sort_by(f64::total_cmp);
        let median = here.get(here.len() / 2).copied().unwrap_or_default();
        println!(
            "{from} to {to} m away, lines at the edges are found {median:+.2} m further out than expected (median)"
        );
    }

    let every = args.every.unwrap_or(fit.stands.len() / SHOWN).max(1);
    let shown: Vec<usize> = (args.look..fit.stands.len()).step_by(every).take(SHOWN).collect();
    sheet::write(fit, &shown, &args.out.join("sheet.png"))
}
