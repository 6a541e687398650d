//! The training loop of a braking network: mean squared error, Adam, a learning rate that falls where the loss no longer does.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use serde_json::json;
use tch::{Device, Kind, Tensor, nn, nn::OptimizerConfig};

use super::{
    BrakingDataError, BrakingRecipe, Part, SpeedFailure, episodes,
    episodes::{Drive, Reader, load},
    windows::{Batch, Draw, Drawn, Windows, batch, length, targets},
};
use crate::nn::{
    NnError, Precision,
    braking::{BrakingMetadata, BrakingNetwork, save_braking},
    in_variable_store,
};
use lapwing_core::control::BrakeLimits;
use lapwing_score::emergency::{CountingRule, Evaluation, evaluation::best_threshold};

/// Below the upper limit of a guard, its lower one.
const RELEASES: f64 = 0.5;

/// Why a braking network cannot be trained.
#[derive(Debug, thiserror::Error)]
pub enum BrakingTrainError {
    /// The recipe is not TOML, or has unknown keys.
    #[error("the recipe: {0}")]
    Recipe(String),
    /// A setting with an invalid value.
    #[error("{name}: expected {expected}, got {got}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
    /// The data.
    #[error(transparent)]
    Data(#[from] BrakingDataError),
    /// The network or its file.
    #[error(transparent)]
    Network(#[from] NnError),
    /// libtorch.
    #[error(transparent)]
    Torch(#[from] tch::TchError),
    /// No episode is long enough.
    #[error("expected episodes of at least {frames} frames in the part {part:?}, got none")]
    TooShort {
        /// How long a window is.
        frames: usize,
        /// The part.
        part: Part,
    },
    /// Nothing to learn.
    #[error("expected emergencies in the part {0:?}, got none: no pedal goes down fast")]
    NoEmergency(Part),
    /// The loss is no longer a number.
    #[error("the loss became {loss} in epoch {epoch}: lower the learning rate, now {rate}")]
    NotFinite {
        /// What it became.
        loss: f64,
        /// From 1.
        epoch: usize,
        /// The learning rate.
        rate: f64,
    },
}

/// What an epoch came to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Epoch {
    /// From 1.
    pub epoch: usize,
    /// Windows that were learnt from.
    pub windows: usize,
    /// Mean squared error, weighted, on them.
    pub loss: f64,
    /// Likewise on validation windows; whole.
    pub validation: f64,
    /// Adam's.
    pub learning_rate: f64,
    /// Seconds since the training began.
    pub seconds: f64,
    /// Whether it is the best so far, which is kept.
    pub best: bool,
}

/// A trained network.
#[derive(Debug)]
pub struct Trained {
    /// Where it is.
    pub path: PathBuf,
    /// SHA-256 of the file.
    pub sha256: String,
    /// All epochs.
    pub epochs: Vec<Epoch>,
    /// Between which values its guards brake and rest: the upper one has the best F1 by activations on the validation
    /// episodes.
    pub limits: BrakeLimits,
    /// How good it is on those, at that limit.
    pub validation: Evaluation,
}

/// Trains a network on a data set and writes it to `path`. It ends early, with the best of its epochs, once `most` has
/// passed; `told` is told of each epoch.
///
/// # Errors
/// [`BrakingTrainError`].
pub fn train(
    recipe: &BrakingRecipe,
    data: &Path,
    path: &Path,
    most: Option<Duration>,
    mut told: impl FnMut(&Epoch),
) -> Result<Trained, BrakingTrainError> {
    recipe.check()?;
    let architecture = recipe.network;
    let read = |part| load(data, part, recipe.episodes.unwrap_or(usize::MAX), architecture);
    let (drives, held) = (read(Part::Train)?, read(Part::Validation)?);
    for (drives, part) in [(&drives, Part::Train), (&held, Part::Validation)] {
        if !drives.iter().any(|drive| drive.due.iter().any(|due| *due)) {
            return Err(BrakingTrainError::NoEmergency(part));
        }
    }
    let windows = windows_of(&drives, recipe, Part::Train)?;
    let counted = (windows.standing.len(), windows.moving.len());
    tch::manual_seed(recipe.seed as i64);
    let store = nn::VarStore::new(Device::Cpu);
    let network = BrakingNetwork::build(architecture, &mut in_variable_store(store.root()))?;
    let mut adam = nn::Adam::default().build(&store, recipe.learning_rate)?;
    let mut learning = Learning {
        recipe,
        wanted: drives.iter().map(|drive| targets(drive, recipe)).collect(),
        drives: &drives,
        draw: Draw::new(windows, recipe.standing, recipe.seed),
        reader: Reader::new(architecture.preprocess()).map_err(NnError::from)?,
    };
    let measured = Measured::new(&held, recipe)?;
    let (mut epochs, mut best, mut rate, mut since_best) = (vec![], None::<Vec<Tensor>>, recipe.learning_rate, 0);
    let mut least = f64::INFINITY;
    let began = Instant::now();
    let is_over = || most.is_some_and(|most| began.elapsed() >= most);
    for epoch in 1..=recipe.epochs {
        let (loss, windows) = learning.epoch(&network, &mut adam, &is_over)?;
        let validation = measured.loss(&network)?;
        if !loss.is_finite() || !validation.is_finite() {
            return Err(BrakingTrainError::NotFinite { loss: loss + validation, epoch, rate });
        }
        let is_best = validation < least;
        if is_best {
            least = validation;
            since_best = 0;
            best = Some(network.tensors().iter().map(|(_, tensor)| tensor.f_detach_copy()).collect::<Result<_, _>>()?);
        } else {
            since_best += 1;
        }
        let seconds = began.elapsed().as_secs_f64();
        epochs.push(Epoch { epoch, windows, loss, validation, learning_rate: rate, seconds, best: is_best });
        told(epochs.last().expect("one was just added"));
        if since_best >= recipe.patience {
            rate *= recipe.falls_to;
            since_best = 0;
            adam.set_lr(rate);
        }
        if is_over() {
            break;
        }
    }
    if let Some(best) = best {
        tch::no_grad(|| {
            network.tensors().into_iter().zip(&best).for_each(|((_, mut tensor), kept)| tensor.copy_(kept));
        });
    }
    let judged = episodes(&network, &held, SpeedFailure::NONE, |_| {})?;
    let fires = best_threshold(&judged).unwrap_or(0.5);
    let limits = BrakeLimits { fires, releases: fires * RELEASES };
    let validation = Evaluation::of(&judged, fires, CountingRule::default(), recipe.seed);
    let training = json!({
        "recipe": recipe,
        "data": { "train": told_of(&drives), "validation": told_of(&held),
                  "windows": { "standing": counted.0, "moving": counted.1 } },
        "epochs": epochs.len(), "windows_learnt": epochs.iter().map(|e| e.windows).sum::<usize>(),
        "seconds": epochs.last().map(|e| e.seconds.round()),
    });
    let result = json!({
        "part": "validation", "loss": least, "threshold": fires, "precision": validation.precision.value,
        "recall": validation.recall.value, "f1": validation.f1.value, "event_f1": validation.event_f1.value,
        "false_alarms_per_h": validation.false_alarms_per_h.value, "episodes": validation.episodes,
    });
    let metadata = BrakingMetadata {
        preprocess: architecture.preprocess(),
        limits,
        training: training.to_string(),
        result: result.to_string(),
    };
    let sha256 = save_braking(path, &metadata, &network, Precision::F32)?;
    Ok(Trained { path: path.to_owned(), sha256, epochs, limits, validation })
}

/// Episodes and frames, in a checkpoint.
fn told_of(drives: &[Drive]) -> serde_json::Value {
    let frames: usize = drives.iter().map(Drive::frames).sum();
    let emergencies: usize = drives.iter().map(|drive| drive.onsets.len()).sum();
    json!({ "episodes": drives.len(), "frames": frames, "emergencies": emergencies })
}

fn windows_of(drives: &[Drive], recipe: &BrakingRecipe, part: Part) -> Result<Windows, BrakingTrainError> {
    let frames = length(recipe.network);
    let windows = Windows::of(drives, frames);
    if windows.len() == 0 { Err(BrakingTrainError::TooShort { frames, part }) } else { Ok(windows) }
}

/// Weighted mean squared error: the sum of errors and that of weights.
fn errors(answers: &Tensor, batch: &Batch) -> Result<(Tensor, Tensor), tch::TchError> {
    let squares = answers.f_sub(&batch.targets)?.f_square()?;
    Ok((squares.f_mul(&batch.weights)?.f_sum(Kind::Float)?, batch.weights.f_sum(Kind::Float)?))
}

/// What is learnt from.
struct Learning<'a> {
    recipe: &'a BrakingRecipe,
    drives: &'a [Drive],
    wanted: Vec<Vec<bool>>,
    draw: Draw,
    reader: Reader,
}

impl Learning<'_> {
    /// One epoch, or as much of it as there is time for: its mean loss, and its windows.
    fn epoch(
        &mut self,
        network: &BrakingNetwork,
        adam: &mut nn::Optimizer,
        is_over: &dyn Fn() -> bool,
    ) -> Result<(f64, usize), BrakingTrainError> {
        let Self { recipe, drives, wanted, draw, reader } = self;
        let (mut sum, mut weight, mut windows) = (0.0, 0.0, 0);
        while windows < recipe.windows_per_epoch && (windows == 0 || !is_over()) {
            let Some(batch) = draw.batch(drives, wanted, recipe, reader)? else { break };
            let answers = network.forward(&batch.frames, &batch.speeds, true)?;
            let (error, weights) = errors(&answers, &batch)?;
            adam.backward_step(&error.f_div(&weights)?);
            sum += error.f_double_value(&[])?;
            weight += weights.f_double_value(&[])?;
            windows += recipe.batch;
        }
        Ok((sum / weight, windows))
    }
}

/// What is chosen by: the same windows each time, and no chance in them.
struct Measured<'a> {
    recipe: &'a BrakingRecipe,
    drives: &'a [Drive],
    wanted: Vec<Vec<bool>>,
    drawn: Vec<Drawn>,
}

impl<'a> Measured<'a> {
    fn new(drives: &'a [Drive], recipe: &'a BrakingRecipe) -> Result<Self, BrakingTrainError> {
        let windows = windows_of(drives, recipe, Part::Validation)?;
        let (standing, moving) = (windows.standing.len(), windows.moving.len());
        // Standing and moving weigh the same in all.
        let weight = |count: usize| (standing + moving) as f64 / (2.0 * count as f64);
        let of = |windows: Vec<_>, weight: f64| {
            windows.into_iter().map(move |window| Drawn { window, unknown: 0.0, weight })
        };
        let all: Vec<Drawn> =
            of(windows.standing, weight(standing)).chain(of(windows.moving, weight(moving))).collect();
        let every = all.len().div_ceil(recipe.validation_windows);
        let drawn = all.into_iter().step_by(every).collect();
        Ok(Self { recipe, drives, wanted: drives.iter().map(|drive| targets(drive, recipe)).collect(), drawn })
    }

    fn loss(&self, network: &BrakingNetwork) -> Result<f64, BrakingTrainError> {
        let Self { recipe, drives, wanted, drawn } = self;
        let mut reader = Reader::new(recipe.network.preprocess()).map_err(NnError::from)?;
        let mut random = ChaCha8Rng::seed_from_u64(0); // no speed fails
        let (mut sum, mut weight) = (0.0, 0.0);
        for drawn in drawn.chunks(recipe.batch) {
            let batch = batch(drawn, drives, wanted, recipe, &mut reader, &mut random)?;
            let answers = tch::no_grad(|| network.forward(&batch.frames, &batch.speeds, false))?;
            let (error, weights) = errors(&answers, &batch)?;
            sum += error.f_double_value(&[])?;
            weight += weights.f_double_value(&[])?;
        }
        Ok(sum / weight)
    }
}
