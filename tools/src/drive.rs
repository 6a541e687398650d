//! A recorded drive: its pictures, and how the car moved between them.

use anyhow::{Context, Result};
use lapwing_core::{
    car::GRAVITY,
    motion::Motion,
    perception::{Frame, decode_jpeg},
    recording::{Moment, Recording},
};
use lapwing_sim::along::{Pyramid, turn};
use rayon::prelude::*;

/// A drive, or several that follow one another without a gap.
#[derive(Debug, Default)]
pub struct Drive {
    /// The pictures.
    pub frames: Vec<Frame>,
    /// How the car came to each from the one before: it turned as the pictures show, else as it was steered.
    pub motions: Vec<Motion>,
    /// How steeply each place climbs: [`climbs`].
    pub climbs: Vec<Option<f64>>,
}

/// How the stock car speeds up on level ground, in m/s², by throttle, speed and steering times speed: fitted to 2578 rows
/// of the jungle, whose accelerations it explains with the track's slopes to 0.3 m/s².
const PUSH: [f64; 4] = [0.25, 5.64, -0.15, -0.16];
/// Rows before and after a place over which its acceleration is taken.
const AROUND: usize = 4;
/// A car slower than this, in m/s, may stand against something.
const SLOW_MPS: f64 = 2.0;
/// Slopes steeper than this are no slopes but impacts.
const STEEPEST: f64 = 0.4;

/// How steeply the road climbs around each moment, as the sine of the slope, by how much slower the car became than it would
/// have on level ground; none where it brakes, stands or may have hit something.
pub fn climbs(moments: &[Moment]) -> Vec<Option<f64>> {
    (0..moments.len()).map(|i| climb(moments, i)).collect()
}

fn climb(moments: &[Moment], i: usize) -> Option<f64> {
    let near = moments.get(i.checked_sub(AROUND)?..=i + AROUND)?;
    let mps = |moment: &Moment| moment.telemetry.speed.metres_per_second().get();
    let passed_s = (near[2 * AROUND].at - near[0].at).as_secs_f64();
    let throttle = |moment: &Moment| moment.decided().map(|command| command.throttle.get());
    let throttles: Vec<f64> = near.iter().map(throttle).collect::<Option<_>>()?;
    if !(0.1..2.0).contains(&passed_s)
        || near.iter().any(|moment| mps(moment) < SLOW_MPS)
        || throttles.iter().any(|&throttle| throttle < 0.0)
    {
        return None;
    }
    let mean = |of: &dyn Fn(&Moment) -> f64| near.iter().map(of).sum::<f64>() / near.len() as f64;
    let steered = mean(&|moment| moment.steering().map_or(0.0, |steering| steering.get().abs()));
    let speed = mps(&moments[i]);
    let throttle = throttles.iter().sum::<f64>() / throttles.len() as f64;
    let level = PUSH[0] + PUSH[1] * throttle + PUSH[2] * speed + PUSH[3] * steered * speed;
    let climb = (level - (mps(&near[2 * AROUND]) - mps(&near[0])) / passed_s) / GRAVITY;
    (climb.abs() < STEEPEST).then_some(climb)
}

impl Drive {
    /// Reads the pictures of a camera, 0 to 2, of Udacity folders that follow one another; not more than `rows`.
    pub fn read(folders: &[std::path::PathBuf], camera: usize, rows: usize) -> Result<Self> {
        let mut drive = Self::default();
        let mut usual = Vec::new();
        for folder in folders {
            let moments: Vec<Moment> = Recording::open(folder)?.collect::<Result<_, _>>()?;
            let motion = |i: usize| moments[i].motion_from(&moments[i.saturating_sub(1)], None);
            let mut motions: Vec<Motion> = (0..moments.len()).map(motion).collect();
            if let (Some(&last), Some(first)) = (usual.last(), motions.first_mut()) {
                *first = last; // the folders' clocks do not tell how long it was, but it was one interval
            }
            usual.clone_from(&motions);
            drive.climbs.extend(climbs(&moments));
            let pictures: Vec<Frame> = moments
                .par_iter()
                .map(|moment| {
                    let picture = moment.pictures[camera].as_ref().context("a row has no picture of this camera")?;
                    let mut frame = Frame::default();
                    decode_jpeg(&picture.read()?, &mut frame)?;
                    Ok(frame)
                })
                .collect::<Result<_>>()?;
            let seen: Vec<Option<Pyramid>> = pictures.par_iter().map(Pyramid::of).collect();
            motions.par_iter_mut().skip(1).zip(seen.par_windows(2)).for_each(|(motion, pair)| {
                let pair = pair[0].as_ref().zip(pair[1].as_ref());
                if let Some(turned) = pair.and_then(|(before, now)| turn(before, now, motion.way_m)) {
                    motion.turn_rad = turned.yaw;
                }
            });
            drive.frames.extend(pictures);
            drive.motions.append(&mut motions);
        }
        drive.frames.truncate(rows);
        drive.motions.truncate(rows);
        drive.climbs.truncate(rows);
        Ok(drive)
    }
}
