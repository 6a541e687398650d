//! Shows the pictures of a recording to a network.

use std::path::Path;

use rayon::prelude::*;

use super::{ByNetwork, NetworkLane};
use crate::locating::{LocateError, pictures::decoded};
use lapwing_core::{
    perception::Frame,
    recording::{CameraPosition, Picture, Recording},
};
use lapwing_learn::{
    models::{LaneFinder, LaneModel, LaneSeen},
    nn::runtime::set_threads,
};

/// Pictures that a thread looks at in one go.
const BLOCK: usize = 32;

/// Shows a network the pictures of one of the cameras. `looked_at` is called for each.
///
/// # Errors
/// What cannot be read of the run or the driving log, and a network that does not answer.
pub fn look(
    path: &Path,
    camera: CameraPosition,
    model: &LaneModel,
    looked_at: impl Fn() + Sync,
) -> Result<ByNetwork, LocateError> {
    let mut moments = Recording::open(path)?.seen();
    let blocks = std::iter::from_fn(|| {
        let block = moments.by_ref().take(BLOCK).map(|moment| Ok(moment?.pictures[camera as usize].take()));
        match block.collect::<Result<Vec<Option<Picture>>, LocateError>>() {
            Ok(block) if block.is_empty() => None,
            block => Some(block.map(|block| (model.finder(), block))),
        }
    });
    let mut seen: Vec<(usize, Vec<Option<NetworkLane>>)> = blocks
        .enumerate()
        .par_bridge()
        .map(|(i, block)| {
            let (mut finder, block) = block?;
            set_threads(1); // each processor has a picture of its own
            Ok((i, each(&mut finder, &block, &looked_at)?))
        })
        .collect::<Result<_, LocateError>>()?;
    seen.sort_by_key(|(i, _)| *i);
    Ok(ByNetwork { model: model.name().to_owned(), rows: seen.into_iter().flat_map(|(_, rows)| rows).collect() })
}

fn each(
    finder: &mut LaneFinder,
    block: &[Option<Picture>],
    looked_at: &impl Fn(),
) -> Result<Vec<Option<NetworkLane>>, LocateError> {
    let mut frame = Frame::default();
    let see = |picture: &Option<Picture>| {
        looked_at();
        // The first way counts the pictures that cannot be looked at, and says why.
        if decoded(picture.as_ref(), &mut frame).is_err() {
            return Ok(None);
        }
        let LaneSeen { offset_m, heading_deg, offset_sd_m, heading_sd_deg } = finder.look(&frame)?;
        Ok(Some(NetworkLane { offset_m, heading_deg, deviation: (offset_sd_m, heading_sd_deg) }))
    };
    block.iter().map(see).collect()
}
