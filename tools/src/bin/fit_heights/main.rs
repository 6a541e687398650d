//! Mends a track's heights, whose crests and dips `fit_road` found in pictures: those tell long climbs badly, as a camera that is
//! pitched with the road sees the same on every slope.
//!
//! ```sh
//! J=../shared/recordings/jungle
//! cargo run --release -p lapwing-tools --bin fit_heights -- --track jungle --waypoints ../shared/tracks/jungle_1m.csv \
//!     --drive $J lanes/jungle.csv --drive $J-rest lanes/jungle-rest.csv
//! ```
//! ```text
//! the track's heights: crests and dips ──────────────────────────────┐
//! waypoints of the scene: heights, each of them off by metres ───────┼▶ least squares ▶ heights
//! drives: where the car became slower than on level ground ──────────┘
//!         (their places: lapwing locate DIR --csv)
//! ```
//! To be run once on what `fit_road` found: each time, crests and dips yield a little to the waypoints. Prints the control points
//! as a track's file has them, and on stderr how well the slopes explain the drives, before and after.

#![allow(clippy::print_stdout, clippy::print_stderr)] // its result, for us to read

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use glam::DVec3;
use lapwing_core::recording::{Moment, Recording};
use lapwing_sim::{locate::LaneTable, track::Track};
use lapwing_tools::{course::Course, drive, linear::cholesky};

/// Standard deviation of a waypoint's height, in metres.
const WAYPOINT_M: f64 = 2.0;
/// Standard deviation by which four neighbouring control points may move otherwise than smoothly: of the third difference of
/// their moves, in metres. So crests and dips stay.
const SMOOTH_M: f64 = 0.1;
/// Standard deviation of a slope by the speed, as its sine: 0.05, but neighbouring rows err alike.
const CLIMB: f64 = 0.15;
/// Steps of Gauss and Newton: the problem is nearly linear.
const STEPS: usize = 5;
/// Waypoints so far from the road on the ground plane belong to another part of it, in metres.
const ELSEWHERE_M: f64 = 8.0;
/// The road crosses itself: waypoints so far above or below it belong to the other road, in metres.
const CROSSING_M: f64 = 6.0;

/// Mends a track's heights.
#[derive(Debug, Parser)]
struct Args {
    /// The track: a name or a file.
    #[arg(long, default_value = "jungle")]
    track: String,
    /// The scene's waypoints: a table with the columns x, y_up and z.
    #[arg(long)]
    waypoints: PathBuf,
    /// A recording, and where the car was in each of its pictures: the table of `lapwing locate --csv`. As often as need be.
    #[arg(long = "drive", num_args = 2, value_names = ["DIR", "LANE"])]
    drives: Vec<PathBuf>,
}

/// Where a drive says how steep the road is: the spline's parameter and the sine of the slope.
type Climb = (f64, f64);
/// Where a waypoint lies beside the road: the spline's parameter and its height.
type Waypoint = (f64, f64);

fn main() -> Result<()> {
    let args = Args::parse();
    let track = Track::open(&args.track)?;
    let given = Course::of(&track);
    let waypoints = waypoints(&args.waypoints, &given)?;
    let drives = args.drives.as_chunks::<2>().0;
    let climbs: Vec<Vec<Climb>> =
        drives.iter().map(|[recording, lane]| climbs(recording, lane, &track, &given)).collect::<Result<_>>()?;
    let all: Vec<Climb> = climbs.concat();
    let mut course = given.clone();
    for _ in 0..STEPS {
        course =
            step(&course, &given, &waypoints, &all).context("expected what determines the heights, got too little")?;
    }
    for ([recording, _], climbs) in drives.iter().zip(&climbs) {
        let [before, after] = [&given, &course].map(|course| unexplained(course, climbs));
        let rows = climbs.len();
        eprintln!("{}: {rows} slopes by the speed, off by {before:.3} before and {after:.3} now", recording.display());
    }
    let moved = given.points.iter().zip(&course.points).map(|(before, after)| (after.y - before.y).abs());
    eprintln!("control points moved by {:.2} m at most", moved.fold(0.0, f64::max));
    print!("{course}");
    Ok(())
}

/// The heights with which the sum of squares is least, if all derivatives were constant.
fn step(course: &Course, given: &Course, waypoints: &[Waypoint], climbs: &[Climb]) -> Option<Course> {
    let n = course.points.len();
    let (mut left, mut right) = (vec![0.0; n * n], vec![0.0; n]);
    let mut add = |residual: f64, weight: f64, by: &[(usize, f64)]| {
        for &(k, of_k) in by {
            right[k] -= weight * residual * of_k;
            for &(l, of_l) in by {
                left[k * n + l] += weight * of_k * of_l;
            }
        }
    };
    for &(t, height_m) in waypoints {
        add(
            course.at(t).position.y - height_m,
            WAYPOINT_M.powi(-2) / waypoints.len() as f64 * n as f64,
            &course.height_by(t),
        );
    }
    for &(t, expected) in climbs {
        let (climb, by) = course.climb_by(t);
        let off = climb - expected;
        add(off, (CLIMB * (1.0 + (off / CLIMB).powi(2)).sqrt()).powi(-2), &by);
    }
    let moved = |k: usize| course.points[k % n].y - given.points[k % n].y;
    for k in 0..n {
        let by = [-1.0, 3.0, -3.0, 1.0];
        let residual = (0..4).map(|j| by[j] * moved(k + j)).sum();
        add(residual, SMOOTH_M.powi(-2), &std::array::from_fn::<_, 4, _>(|j| ((k + j) % n, by[j])));
    }
    let steps = cholesky(left, right)?;
    let points = course.points.iter().zip(steps).map(|(point, by)| *point + DVec3::Y * by).collect();
    Some(Course { points })
}

/// The root mean square of what a course leaves unexplained of the slopes.
fn unexplained(course: &Course, climbs: &[Climb]) -> f64 {
    let squares = climbs.iter().map(|&(t, expected)| (course.climb_by(t).0 - expected).powi(2));
    (squares.sum::<f64>() / climbs.len().max(1) as f64).sqrt()
}

/// What a drive says, where its place is known.
fn climbs(recording: &Path, lane: &Path, track: &Track, course: &Course) -> Result<Vec<Climb>> {
    let table = LaneTable::of(recording, lane, Track::open)?;
    let (name, expected) = (&table.track.file().name, &track.file().name);
    ensure!(name == expected, "{}: expected places on {expected}, got places on {name}", lane.display());
    let moments: Vec<Moment> = Recording::open(recording)?.collect::<Result<_, _>>()?;
    let climbs = drive::climbs(&moments);
    let known = table.rows.iter().filter_map(|(moment, pose)| {
        let pose = (*pose)?;
        // Against the track's direction, what climbs for it falls for the car.
        let climb = climbs.get(*moment).copied().flatten()? * pose.direction();
        Some((course.beside(track.at(pose.s_m).position), climb))
    });
    Ok(known.collect())
}

/// The scene's waypoints, each beside the road.
fn waypoints(path: &Path, course: &Course) -> Result<Vec<Waypoint>> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let mut lines = text.lines();
    let heading: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name: &str| {
        let found = heading.iter().position(|column| *column == name);
        found.with_context(|| format!("{}: expected the column {name}, got {heading:?}", path.display()))
    };
    let columns = [column("x")?, column("y_up")?, column("z")?];
    let mut found = Vec::new();
    for (i, line) in lines.enumerate() {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |column: usize| fields.get(column).and_then(|field| field.parse().ok());
        let numbers: Option<Vec<f64>> = columns.into_iter().map(number).collect();
        let numbers =
            numbers.with_context(|| format!("{}: line {}: expected numbers, got {line:?}", path.display(), i + 2))?;
        let point = DVec3::from_slice(&numbers);
        let t = course.beside(point);
        let off = course.at(t).position - point;
        if off.x.hypot(off.z) < ELSEWHERE_M && off.y.abs() < CROSSING_M {
            found.push((t, point.y));
        }
    }
    Ok(found)
}
