//! Checks before a training begins.

use std::path::Path;

use super::{
    Recipe, TrainError,
    state::{MODEL, STATE, Stored},
};
use crate::{
    dataset::{Augmentation, DatasetError, Inputs, Samples, Selection, Set},
    nn::Architecture,
};
use lapwing_core::words::count;

/// The state to resume from, if any.
pub(super) fn stored(out: &Path, resume: bool) -> Result<Option<Stored>, TrainError> {
    let (state, model) = (out.join(STATE), out.join(MODEL));
    match (state.exists(), resume) {
        (true, true) => Stored::open(&state).map(Some),
        (true, false) => Err(TrainError::Exists(out.to_owned())),
        (false, _) if model.exists() => Err(TrainError::ModelThere(model)),
        (false, _) => Ok(None),
    }
}

/// Checks that pictures are not changed in ways that their labels do not follow: a mirrored or shifted picture is of no
/// place in the lane, as the cameras look and the lanes lie a little to the right.
pub(super) fn check_labels_kept(recipe: &Recipe, architecture: Architecture) -> Result<(), TrainError> {
    let wrong = |name, got: f64| {
        let expected = "0 for a network that locates the lane: its labels do not follow";
        Err(TrainError::Setting { name, expected, got: got.to_string() })
    };
    match recipe.augment {
        _ if !architecture.locates() => Ok(()),
        Augmentation { flip, .. } if flip > 0.0 => wrong("augment.flip", flip),
        Augmentation { translate, .. } if translate > 0.0 => wrong("augment.translate", translate),
        _ => Ok(()),
    }
}

/// Opens the training and the validation data.
pub(super) fn data(recipe: &Recipe, architecture: Architecture) -> Result<(Samples, Samples), TrainError> {
    let blocks = recipe.validation.is_empty().then_some(recipe.blocks);
    if let Some(both) = recipe.validation.iter().find(|of| recipe.data.iter().any(|data| overlap(data, of))) {
        let (name, expected) = ("validation", "rows that are not in the training data");
        return Err(DatasetError::Setting { name, expected, got: format!("{} of data", both.path.display()) }.into());
    }
    if architecture.locates()
        && let Some(unknown) = recipe.data.iter().chain(&recipe.validation).find(|data| data.lane.is_none())
    {
        let (name, expected) = ("lane", "the table of places of each data set, for a network that locates the lane");
        let got = format!("none for {}", unknown.path.display());
        return Err(DatasetError::Setting { name, expected, got }.into());
    }
    let mut training = Samples::open(&recipe.data, Set::Training, blocks, &recipe.balance)?;
    if recipe.augment.late > 0.0 {
        training.place()?;
    }
    check_sides(&training, recipe.augment.flip)?;
    let mut validation = if recipe.validation.is_empty() {
        Samples::open(&recipe.data, Set::Validation, blocks, &recipe.balance)?
    } else {
        Samples::open(&recipe.validation, Set::All, None, &recipe.balance)?
    };
    // A standing car sees the same again, which is no copy.
    if let Some((shared, picture)) =
        validation.shared_with(&training).filter(|(n, _)| 100 * n > validation.samples.len())
    {
        tracing::warn!(
            "{shared} of {}, such as {picture}, are in the data to learn from, too: the validation error is lower than on \
             pictures never seen; leave out what is there twice",
            count(validation.samples.len(), "held-out picture"),
        );
    }
    if let Some(count) = recipe.validation_samples {
        validation.thin_out(count);
    }
    Ok((training, validation))
}

/// Whether two selections have rows in common.
fn overlap(a: &Selection, b: &Selection) -> bool {
    let (from, to) = (a.rows.unwrap_or((0, usize::MAX)), b.rows.unwrap_or((0, usize::MAX)));
    a.place() == b.place() && from.0 < to.1 && to.0 < from.1
}

/// Checks that there is memory for the waiting batches and the one being trained on.
pub(super) fn check_room(recipe: &Recipe, inputs: &Inputs) -> Result<(), TrainError> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut numbers = inputs.preprocess.shape().into_iter().chain([inputs.frames, recipe.batch, 2 * threads + 1]);
    let numbers = numbers.try_fold(1usize, usize::checked_mul).unwrap_or(usize::MAX);
    Vec::<f32>::new()
        .try_reserve_exact(numbers)
        .map_err(|why| TrainError::Memory { batch: recipe.batch, why: why.to_string() })
}

/// Checks that the recorded steering goes to both sides: a side camera's offset does not count.
fn check_sides(samples: &Samples, flip: f64) -> Result<(), TrainError> {
    let steering =
        || samples.samples.iter().map(|of| samples.sources[of.source as usize].rows[of.row as usize].steering);
    let (least, most) =
        steering().fold((f64::MAX, f64::MIN), |(least, most), x| (least.min(x.get()), most.max(x.get())));
    let both = least < -0.01 && most > 0.01;
    if both || (flip > 0.0 && most.abs().max(least.abs()) > 0.01) {
        return Ok(());
    }
    Err(TrainError::OneSided { least, most, rows: samples.samples.len() })
}
