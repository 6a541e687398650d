//! How well the pictures of a real drive lie on a track: each camera is followed by itself, and the side cameras must
//! come out where they sit on the car.
//!
//! ```sh
//! cargo run --release -p lapwing-tools --bin judge_road -- ../shared/recordings/jungle --poses fitted/poses.csv
//! ```

#![allow(clippy::print_stdout)] // its result, for us to read

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Result, bail, ensure};
use clap::Parser;
use lapwing_core::perception::Frame;
use lapwing_sim::{
    camera::{Camera, Scenery},
    locate::{Known, Located, Overlay, Pose},
    track::Track,
};
use lapwing_tools::drive::Drive;
use rayon::prelude::*;

/// How far along the road a piece's start may be off, in metres.
const FIRST_M: f64 = 3.0;

/// Follows a real drive along a track by its pictures, and says how well they agree with it.
#[derive(Debug, Parser)]
struct Args {
    /// Udacity folders that follow one another.
    #[arg(required = true)]
    recordings: Vec<PathBuf>,
    /// The track: a name or a file.
    #[arg(long, default_value = "jungle")]
    track: String,
    /// Where the car is in each row, about: the poses.csv of `fit_road`.
    #[arg(long)]
    poses: PathBuf,
    /// The drive is followed in pieces of that many rows. Each camera begins each piece where the poses say that the
    /// centre camera is, so a camera that gets lost does so for one piece only.
    #[arg(long, default_value_t = 100)]
    piece: usize,
    /// Only that many rows.
    #[arg(long, default_value_t = usize::MAX)]
    rows: usize,
    /// Only the centre camera, where there is no other.
    #[arg(long)]
    center: bool,
    /// Every how many-th row is listed.
    #[arg(long, default_value_t = 50)]
    every: usize,
}

/// Reads where the car is in each row.
fn poses(path: &Path) -> Result<Vec<Pose>> {
    let pose = |line: &str| -> Result<Pose> {
        let numbers: Vec<f64> = line.split(',').take(5).map(str::parse).collect::<Result<_, _>>()?;
        let [_, s_m, offset_m, heading_rad, _] = numbers[..] else {
            bail!("poses: expected five numbers, got {line:?}")
        };
        Ok(Pose { s_m, offset_m, heading_rad, pitch_rad: 0.0 })
    };
    fs::read_to_string(path)?.lines().skip(1).map(pose).collect()
}

fn main() -> Result<()> {
    let args = Args::parse();
    let track = Arc::new(Track::open(&args.track)?);
    let scenery = Arc::new(Scenery::new(&track));
    let poses = poses(&args.poses)?;
    let located = |camera: usize| -> Result<Vec<Located>> {
        let drive = Drive::read(&args.recordings, camera, args.rows)?;
        let count = drive.frames.len();
        ensure!(poses.len() >= count, "poses: expected {count} or more, got {}", poses.len());
        let piece = |from: usize| -> Result<Vec<Located>> {
            let mut overlay = Overlay::new(Arc::clone(&track), Arc::clone(&scenery), (320, 160));
            let picture = |i: usize, frame: &mut Frame| -> Result<()> {
                frame.clone_from(&drive.frames[from + i]);
                Ok(())
            };
            let start = Known { picture: 0, pose: poses[from], deviation_m: FIRST_M };
            overlay.follow(&[start], &drive.motions[from..(from + args.piece).min(count)], picture)
        };
        let starts: Vec<usize> = (0..count).step_by(args.piece.max(1)).collect();
        let pieces: Vec<_> = starts.into_par_iter().map(piece).collect::<Result<_>>()?;
        Ok(pieces.concat())
    };
    let cameras: &[usize] = if args.center { &[0] } else { &[0, 1, 2] };
    let all: Vec<Vec<Located>> = cameras.iter().map(|&camera| located(camera)).collect::<Result<_>>()?;
    let center = &all[0];
    let mounts = [Camera::CENTER, Camera::LEFT, Camera::RIGHT].map(|camera| camera.mount.position.x);
    let off = |i: usize, camera: usize| {
        all[camera][i].pose.offset_m - center[i].pose.offset_m - mounts[camera] * center[i].pose.heading_rad.cos()
    };
    for (i, here) in center.iter().enumerate().step_by(args.every) {
        let sides: Vec<String> = (1..all.len()).map(|camera| format!("{:+.2}", off(i, camera))).collect();
        println!(
            "{i}: {:.1} m, {:+.2} m right, {:+.1} degrees, pitch {:+.1}, agreement {:.2}, sides off by {sides:?}",
            here.pose.s_m,
            here.pose.offset_m,
            here.pose.heading_rad.to_degrees(),
            here.fit.pose.pitch_rad.to_degrees(),
            here.fit.agreement
        );
    }
    let share = |name: &str, mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values.get(((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1)));
        let at = |share: f64| at(share).copied().unwrap_or(f64::NAN);
        println!("{name}: 5 % {:.3}, median {:.3}, 95 % {:.3}", at(0.05), at(0.5), at(0.95));
    };
    share("pitch in degrees, smoothed", {
        let pitch: Vec<f64> = center.iter().map(|here| here.fit.pose.pitch_rad.to_degrees()).collect();
        pitch.windows(9).map(|near| near.iter().sum::<f64>() / 9.0).collect()
    });
    share("agreement", center.iter().map(|here| here.fit.agreement).collect());
    share("pitch in degrees", center.iter().map(|here| here.fit.pose.pitch_rad.to_degrees()).collect());
    share("place off by single pictures, m", center.iter().map(|h| (h.fit.pose.s_m - h.pose.s_m).abs()).collect());
    if all.len() > 1 {
        let errors = (0..center.len()).flat_map(|i| (1..all.len()).map(move |camera| (i, camera)));
        share("sides off, m", errors.map(|(i, camera)| off(i, camera).abs()).collect());
    }
    Ok(())
}
