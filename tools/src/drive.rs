//! A recorded drive: its pictures, and how the car moved between them.

use anyhow::{Context, Result};
use lapwing_core::{
    motion::{Motion, curvature},
    perception::{Frame, decode_jpeg},
    recording::{Moment, Recording},
};
use rayon::prelude::*;

/// A drive, or several that follow one another without a gap.
#[derive(Debug, Default)]
pub struct Drive {
    /// The pictures.
    pub frames: Vec<Frame>,
    /// How the car came to each from the one before.
    pub motions: Vec<Motion>,
}

impl Drive {
    /// Reads the pictures of a camera, 0 to 2, of Udacity folders that follow one another; not more than `rows`.
    pub fn read(folders: &[std::path::PathBuf], camera: usize, rows: usize) -> Result<Self> {
        let mut drive = Self::default();
        let mut usual = Vec::new();
        for folder in folders {
            let moments: Vec<Moment> = Recording::open(folder)?.collect::<Result<_, _>>()?;
            let motion = |i: usize| {
                let (now, before) = (&moments[i], &moments[i.saturating_sub(1)]);
                let mps = |moment: &Moment| moment.telemetry.speed.metres_per_second().get();
                let way_m = (now.at - before.at).as_secs_f64() * (mps(now) + mps(before)) / 2.0;
                let steering_deg = before.steering().map_or(0.0, |steering| steering.degrees().get());
                Motion { way_m, turn_rad: way_m * curvature(steering_deg) }
            };
            let mut motions: Vec<Motion> = (0..moments.len()).map(motion).collect();
            if let (Some(&last), Some(first)) = (usual.last(), motions.first_mut()) {
                *first = last; // the folders' clocks do not tell how long it was, but it was one interval
            }
            usual.clone_from(&motions);
            let pictures: Vec<Frame> = moments
                .par_iter()
                .map(|moment| {
                    let picture = moment.pictures[camera].as_ref().context("a row has no picture of this camera")?;
                    let mut frame = Frame::default();
                    decode_jpeg(&picture.read()?, &mut frame)?;
                    Ok(frame)
                })
                .collect::<Result<_>>()?;
            drive.frames.extend(pictures);
            drive.motions.append(&mut motions);
        }
        drive.frames.truncate(rows);
        drive.motions.truncate(rows);
        Ok(drive)
    }
}
