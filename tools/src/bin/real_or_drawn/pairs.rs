//! The same places, real and drawn.

use std::{path::Path, sync::Arc};

use anyhow::{Context, Result, ensure};
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    recording::{Moment, Recording},
};
use lapwing_sim::{
    camera::{Camera, JPEG_QUALITY, Renderer, Scenery, Shot, encode_jpeg},
    conditions::Conditions,
    locate::{LaneTable, Pose},
    track::Track,
};
use rayon::prelude::*;

/// The road is divided into pieces of this length, in metres. Of each, the first quarter is held out, and the parts next
/// to that are not learnt from, since the same things are seen from there.
const PIECE_M: f64 = 240.0;
/// How much of a piece is held out, in metres.
const HELD_OUT_M: f64 = 60.0;
/// Metres before and after a held-out part that are not learnt from.
const MARGIN_M: f64 = 20.0;

/// One place.
#[derive(Debug, Clone)]
pub struct Pair {
    /// Where the car is.
    pub pose: Pose,
    /// Metres along the road.
    pub place_m: f64,
    /// Number of the moment in the recording, from 0.
    pub moment: usize,
    /// The recorded picture, and ours.
    pub frames: [Frame; 2],
}

impl Pair {
    fn in_piece_m(&self) -> f64 {
        self.place_m.rem_euclid(PIECE_M)
    }

    /// Whether the network is asked about it.
    pub fn held_out(&self) -> bool {
        self.in_piece_m() < HELD_OUT_M
    }

    /// Whether the network learns from it.
    pub fn learnt(&self) -> bool {
        (HELD_OUT_M + MARGIN_M..PIECE_M - MARGIN_M).contains(&self.in_piece_m())
    }
}

/// Reads at most `places` pictures whose place is known, evenly spread, and draws what our camera sees there under
/// `drawn`; without these conditions, codes the real ones again instead.
///
/// # Errors
/// A recording or a table that cannot be read, or that do not belong together; a picture that is not 320x160.
pub fn read(
    recording: &Path,
    lane: &Path,
    places: usize,
    drawn: Option<&Conditions>,
) -> Result<(Arc<Track>, Vec<Pair>)> {
    let table = LaneTable::of(recording, lane, Track::open)?;
    let track = Arc::clone(&table.track);
    let moments: Vec<Moment> = Recording::open(recording)?.collect::<Result<_, _>>()?;
    let known: Vec<(usize, Pose)> = table.rows.iter().filter_map(|(moment, pose)| Some((*moment, (*pose)?))).collect();
    let every = known.len().div_ceil(places.max(1)).max(1);
    let scenery = Arc::new(Scenery::new(&track));
    let chosen: Vec<(usize, Pose)> = known.into_iter().step_by(every).collect();
    let pairs: Vec<Pair> = chosen
        .into_par_iter()
        .map_init(
            || Renderer::new(Arc::clone(&scenery)),
            |renderer, (moment, pose)| {
                let recorded = moments.get(moment).with_context(|| format!("moment {moment}: not in the recording"))?;
                let picture = recorded.pictures[0].as_ref().with_context(|| format!("moment {moment}: no picture"))?;
                let (mut real, mut other) = (Frame::default(), Frame::default());
                decode_jpeg(&picture.read()?, &mut real)?;
                let size = (real.width(), real.height());
                ensure!(size == (320, 160), "moment {moment}: expected 320x160 pixels, got {size:?}");
                if let Some(conditions) = drawn {
                    let car = pose.car(&track);
                    let time_s = recorded.at.as_secs_f64();
                    let shot = Shot { car: &car, actors: &[], conditions, seed: 1, time_s };
                    renderer.render(&Camera::CENTER, &shot, &mut other);
                } else {
                    other.clone_from(&real);
                }
                let jpeg = encode_jpeg(&other, JPEG_QUALITY);
                decode_jpeg(&jpeg, &mut other)?;
                let place_m = pose.s_m.rem_euclid(track.length());
                Ok(Pair { pose, place_m, moment, frames: [real, other] })
            },
        )
        .collect::<Result<_>>()?;
    ensure!(!pairs.is_empty(), "{}: expected a place in it, got none", lane.display());
    println!("{} places of {}, every {every}. of those that are known", pairs.len(), recording.display());
    Ok((track, pairs))
}
