//! Real pictures beside rendered ones of the same places: do the road's edges lie in the same columns?
//!
//! ```sh
//! cargo run --release -p lapwing-tools --bin compare_camera -- ../shared/recordings/lake --track lake --out compared
//! ```
//! The real car's place is found from the recording itself: see `lapwing_tools::survey`. Its offset and yaw are fitted
//! to the edges in rows 84 to 96, 104 to 116, 124 and 126 of the real picture; rows 80, 100 and 120, which are
//! compared, take no part in that. The edges are found by the same detector in the real and in the rendered picture,
//! both as JPEG of quality 75. Of the recording, only the contact sheet is written, to a folder that you name.
//!
//! Rows 80, 100 and 120 are held out for the poses only: the detector's rule about the bank was chosen, and the lines'
//! offsets were surveyed, with these rows in view.

#![allow(clippy::print_stdout)] // its result, for us to read

mod compare;
mod sheet;

use std::{error::Error, fs, path::PathBuf, sync::Arc};

use clap::Parser;
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    recording::udacity::{DrivingLog, Row},
};
use lapwing_sim::{
    camera::{Camera, Renderer, Scenery, Shot, encode_jpeg},
    conditions::Conditions,
    track::Track,
    vehicle::Car,
};
use lapwing_tools::survey::{Detector, FIT_ROWS, Fix, Sighting, SurveyLens, localise};

use crate::compare::{CameraComparison, Pair, ROWS};

/// Compares real pictures with rendered ones of the same places.
#[derive(Debug, Parser)]
struct Args {
    /// A Udacity folder: driving_log.csv and IMG.
    recording: PathBuf,
    /// On which track it was made.
    #[arg(long, default_value = "lake")]
    track: String,
    /// Where it begins, in metres along the road, where the bends alone do not say.
    #[arg(long)]
    from: Option<f64>,
    /// Only that many of its first rows.
    #[arg(long, default_value_t = 2000)]
    rows: usize,
    /// Every how many-th of them is compared.
    #[arg(long, default_value_t = 5)]
    every: usize,
    /// Degrees down that the rendering camera looks, instead of the simulator's own.
    #[arg(long)]
    pitch: Option<f64>,
    /// Where the contact sheet is written.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Where each row's place is written, as CSV.
    #[arg(long)]
    poses: Option<PathBuf>,
}

/// Fits worse than this many columns are due to the detector or the road, not the camera.
const GOOD_FIT: f64 = 3.0;
/// Pictures on the contact sheet.
const SHOWN: usize = 16;

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let track = Track::named(&args.track)?;
    let mut log = DrivingLog::open(&args.recording)?;
    log.rows.truncate(args.rows);
    let detector = Detector::new(track.file().theme);
    let mut frame = Frame::default();
    let mut moments = Vec::with_capacity(log.rows.len());
    for row in &log.rows {
        moments.push(moment(row, detector, &mut frame)?);
    }
    let lens = SurveyLens::stock();
    let (odometry, fixes) = localise(&track, &lens, &moments, args.from)?;
    println!(
        "{} rows of {}: begin at {:.1} m, scale {:.4}, steering agrees with the road's bends by {:.3}",
        fixes.len(),
        args.recording.display(),
        odometry.from_m,
        odometry.scale,
        odometry.correlation
    );
    if let Some(path) = &args.poses {
        fs::write(path, poses(&fixes))?;
    }

    let scenery = Arc::new(Scenery::new(&track));
    let mut renderer = Renderer::new(scenery);
    let mut camera = Camera::CENTER;
    camera.mount.pitch_deg = args.pitch.unwrap_or(camera.mount.pitch_deg);
    let mut comparison = CameraComparison::default();
    let mut shown = Vec::new();
    let usable = |i: &usize| fixes[*i].residual < GOOD_FIT && fixes[*i].seen >= 10;
    let compared: Vec<usize> = (0..fixes.len()).step_by(args.every.max(1)).filter(usable).collect();
    let between = compared.len().div_ceil(SHOWN).max(1);
    for (n, &i) in compared.iter().enumerate() {
        decode_jpeg(&fs::read(&log.rows[i].center)?, &mut frame)?;
        let mut rendered = Frame::default();
        let car = car(&track, &fixes[i], &moments[i]);
        let shot = Shot { car: &car, actors: &[], conditions: &Conditions::default(), seed: 1, time_s: moments[i].at };
        renderer.render(&camera, &shot, &mut rendered);
        decode_jpeg(&encode_jpeg(&rendered, 75), &mut rendered)?;
        let pair = Pair::new(&track, &lens, detector, fixes[i].pose, [&frame, &rendered]);
        comparison.add(&pair);
        if n % between == between / 2 {
            let text = format!("row {i}  {:.0} m  {:+.2} m", fixes[i].pose.s, fixes[i].pose.offset);
            shown.push(sheet::Tile { text, frames: [frame.clone(), rendered], edges: pair.edges.clone() });
        }
    }
    let all = (0..fixes.len()).step_by(args.every.max(1)).count();
    println!(
        "compared {} of {all} pictures: those whose pose explains the edges in rows {FIT_ROWS:?} to a median of \
         {GOOD_FIT} columns; rows {ROWS:?} took no part in finding it",
        compared.len()
    );
    print!("{comparison}");
    if let Some(folder) = &args.out {
        fs::create_dir_all(folder)?;
        let path = folder.join(format!("{}.png", args.track));
        sheet::write(&shown, &path)?;
        println!("{}", path.display());
    }
    Ok(())
}

fn moment(row: &Row, detector: Detector, frame: &mut Frame) -> Result<Sighting, Box<dyn Error>> {
    decode_jpeg(&fs::read(&row.center)?, frame)?;
    Ok(Sighting {
        at: row.at.as_secs_f64(),
        speed: row.speed.metres_per_second().get(),
        steering: row.steering.get(),
        paved: detector.paved(frame),
        edges: detector.find(frame, &FIT_ROWS),
    })
}

/// The simulator's car at a place of the real one.
fn car(track: &Track, fix: &Fix, moment: &Sighting) -> Car {
    let station = track.at(fix.pose.s);
    Car {
        position: track.point(fix.pose.s, fix.pose.offset),
        yaw: station.yaw + fix.pose.yaw,
        speed: moment.speed,
        pitch: station.grade.atan(),
        ..Car::default()
    }
}

fn poses(fixes: &[Fix]) -> String {
    let mut text = String::from("row,s_m,offset_m,yaw_rel_rad,residual_px,edges\n");
    for (i, Fix { pose, residual, seen }) in fixes.iter().enumerate() {
        text += &format!("{i},{:.2},{:.3},{:.4},{residual:.2},{seen}\n", pose.s, pose.offset, pose.yaw);
    }
    text
}
