//! The training loop of a braking network: Adam, by the mean squared error of the paper's network and the cross-entropy of the
//! live one, which learns besides how near what it sees is.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use serde_json::json;
use tch::{Device, Kind, Reduction, Tensor, nn};

use super::{
    BrakingDataError, BrakingRecipe, Part, SpeedFailure, episodes,
    episodes::{Drive, Reader, load},
    state::{self, Position},
    targets::{Wanted, wanted},
    windows::{Batch, Draw, Drawn, Windows, batch, length},
};
use crate::{
    nn::{
        NnError, Precision,
        braking::{Answers, BrakingMetadata, BrakingNetwork, save_braking},
        in_variable_store,
    },
    train::{Optimiser, Schedule, Stepper, TrainError},
};
use lapwing_core::control::BrakeLimits;
use lapwing_score::emergency::{CountingRule, Evaluation, evaluation::guarding_threshold};
use lapwing_sim::braking::Case;

/// Below the upper limit of a guard, its lower one.
const RELEASES: f64 = 0.5;

/// The loss of a window that was not seen yet, in a file.
const UNSEEN: f64 = 1e6;

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
    /// The optimiser.
    #[error(transparent)]
    Optimiser(#[from] TrainError),
    /// The file from which a training is resumed.
    #[error("{}: expected the state of a training, got an error: {why}", path.display())]
    State {
        /// The file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// Another training's state.
    #[error("{}: expected the state of a training by this recipe, got that of another one", path.display())]
    OtherRecipe {
        /// The file.
        path: PathBuf,
    },
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
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Epoch {
    /// From 1.
    pub epoch: usize,
    /// Windows that were learnt from.
    pub windows: usize,
    /// The loss of how much a brake is due, weighted, on them.
    pub loss: f64,
    /// Likewise on validation windows; whole.
    pub validation: f64,
    /// Adam's, at its end.
    pub learning_rate: f64,
    /// Seconds since the training began, without pauses.
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
    /// Between which values its guards brake and rest: the upper one is
    /// [`guarding_threshold`](lapwing_score::emergency::evaluation::guarding_threshold)'s on the validation episodes, among
    /// which laps are harmless.
    pub limits: BrakeLimits,
    /// How good it is on those, at that limit.
    pub validation: Evaluation,
}

/// How a training is run.
#[derive(Debug, Clone, Copy, Default)]
pub struct TrainOptions {
    /// Ends it early, with the best of its epochs, once so much has passed.
    pub most: Option<Duration>,
    /// Goes on where an earlier one ended, if there is its state beside the network's file.
    pub resume: bool,
}

/// Trains a network on a data set and writes it to `path`, and its own state beside it after each epoch. `told` is told of each
/// epoch.
///
/// # Errors
/// [`BrakingTrainError`].
pub fn train(
    recipe: &BrakingRecipe,
    data: &Path,
    path: &Path,
    options: TrainOptions,
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
    let mut learning = Learning::new(recipe, &drives)?;
    let counted = learning.draw.losses.each_ref().map(Vec::len);
    let measured = Measured::new(&held, recipe)?;
    let state = state::path_of(path);
    if options.resume && state.is_file() {
        learning.resume(&state)?;
    }
    let before_s = learning.position.epochs.last().map_or(0.0, |epoch| epoch.seconds);
    let began = Instant::now();
    let is_over = || options.most.is_some_and(|most| began.elapsed() >= most);
    while learning.position.epochs.len() < recipe.epochs && !is_over() {
        let epoch = learning.position.epochs.len() + 1;
        let (loss, windows) = learning.epoch(epoch, &is_over)?;
        let validation = measured.loss(&learning.network)?;
        if !loss.is_finite() || !validation.is_finite() {
            let rate = learning.rate(epoch, 0.0);
            return Err(BrakingTrainError::NotFinite { loss: loss + validation, epoch, rate });
        }
        let seconds = before_s + began.elapsed().as_secs_f64();
        told(learning.judge(Epoch {
            epoch,
            windows,
            loss,
            validation,
            learning_rate: learning.rate(epoch, 1.0),
            seconds,
            best: false,
        })?);
        // An epoch that was cut short is no place to go on from.
        if windows >= recipe.windows_per_epoch {
            learning.save(&state)?;
        }
    }
    learning.take_best();
    // As it will drive.
    learning.network.set_precision(Precision::F32);
    let (network, epochs) = (&learning.network, &learning.position.epochs);
    let judged = episodes(network, &held, SpeedFailure::NONE, |_| {})?;
    let laps: Vec<_> =
        held.iter().zip(&judged).filter(|(drive, _)| drive.story.scenario == Case::Lap.name()).collect();
    let laps: Vec<_> = laps.into_iter().map(|(_, judged)| judged.clone()).collect();
    let fires = guarding_threshold(&judged, &laps).unwrap_or(0.5);
    let limits = BrakeLimits { fires, releases: fires * RELEASES };
    let validation = Evaluation::of(&judged, fires, CountingRule::default(), recipe.seed);
    let kinds = if recipe.emergencies.is_some() { ["emergencies", "others"] } else { ["standing", "moving"] };
    let training = json!({
        "recipe": recipe,
        "data": { "train": told_of(&drives), "validation": told_of(&held),
                  "windows": { kinds[0]: counted[0], kinds[1]: counted[1] } },
        "epochs": epochs.len(), "windows_learnt": epochs.iter().map(|e| e.windows).sum::<usize>(),
        "seconds": epochs.last().map(|e| e.seconds.round()),
    });
    let least = epochs.iter().map(|epoch| epoch.validation).fold(f64::INFINITY, f64::min);
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
    let sha256 = save_braking(path, &metadata, network, Precision::F32)?;
    Ok(Trained { path: path.to_owned(), sha256, epochs: epochs.clone(), limits, validation })
}

/// Episodes and frames, in a checkpoint.
fn told_of(drives: &[Drive]) -> serde_json::Value {
    let frames: usize = drives.iter().map(Drive::frames).sum();
    let emergencies: usize = drives.iter().map(|drive| drive.onsets.len()).sum();
    json!({ "episodes": drives.len(), "frames": frames, "emergencies": emergencies })
}

fn windows_of(
    drives: &[Drive],
    wanted: &[Vec<Wanted>],
    recipe: &BrakingRecipe,
    part: Part,
) -> Result<Windows, BrakingTrainError> {
    let windows = Windows::of(drives, wanted, recipe);
    if windows.len() == 0 {
        return Err(BrakingTrainError::TooShort { frames: length(recipe.network), part });
    }
    Ok(windows)
}

/// How wrong answers are about how much a brake is due: for each window the weighted sum, (B), and the weights, (B).
fn errors(answers: &Answers, batch: &Batch) -> Result<[Tensor; 2], tch::TchError> {
    let each = match answers.blocked {
        Some(_) => answers.due.f_binary_cross_entropy::<Tensor>(&batch.due, None, Reduction::None)?,
        None => answers.due.f_sub(&batch.due)?.f_square()?,
    };
    let summed = |x: &Tensor| x.f_sum_dim_intlist(1i64, false, Kind::Float);
    Ok([summed(&each.f_mul(&batch.weights)?)?, summed(&batch.weights)?])
}

/// How wrong a live network is about what it says besides; none if it says nothing.
fn besides(answers: &Answers, batch: &Batch) -> Result<Option<Tensor>, tch::TchError> {
    let (Some(blocked), Some(near)) = (&answers.blocked, &answers.near) else { return Ok(None) };
    let blocked = blocked.f_binary_cross_entropy::<Tensor>(&batch.blocked, None, Reduction::Mean)?;
    let near = near.f_sub(&batch.near)?.f_square()?.f_mul(&batch.seen)?.f_mean(Kind::Float)?;
    Ok(Some(blocked.f_add(&near)?))
}

/// A network that learns, and all that belongs to it.
struct Learning<'a> {
    recipe: &'a BrakingRecipe,
    drives: &'a [Drive],
    wanted: Vec<Vec<Wanted>>,
    draw: Draw,
    reader: Reader,
    network: BrakingNetwork,
    /// The network of the best epoch.
    best: Vec<(String, Tensor)>,
    stepper: Stepper,
    position: Position,
    _store: nn::VarStore,
}

impl<'a> Learning<'a> {
    fn new(recipe: &'a BrakingRecipe, drives: &'a [Drive]) -> Result<Self, BrakingTrainError> {
        let wanted: Vec<_> = drives.iter().map(|drive| wanted(drive, recipe)).collect();
        let windows = windows_of(drives, &wanted, recipe, Part::Train)?;
        tch::manual_seed(recipe.seed as i64);
        let store = nn::VarStore::new(Device::Cpu);
        let mut network = BrakingNetwork::build(recipe.network, &mut in_variable_store(store.root()))?;
        network.set_precision(recipe.precision);
        let adam = Optimiser { weight_decay: recipe.weight_decay, ..Optimiser::default() };
        let weights = network.tensors().into_iter().filter(|(_, tensor)| tensor.requires_grad()).collect();
        let stepper = Stepper::new(adam, weights)?;
        let best = network.tensors().into_iter().map(|(name, tensor)| Ok((name, tensor.f_detach_copy()?)));
        Ok(Self {
            recipe,
            drives,
            wanted,
            draw: Draw::new(windows, recipe),
            reader: Reader::new(recipe.network.preprocess()).map_err(NnError::from)?,
            best: best.collect::<Result<_, tch::TchError>>()?,
            stepper,
            position: Position {
                recipe: recipe.clone(),
                epochs: vec![],
                steps: 0,
                rate: recipe.learning_rate,
                since_best: 0,
            },
            network,
            _store: store,
        })
    }

    /// The learning rate at a share of an epoch.
    fn rate(&self, epoch: usize, share: f64) -> f64 {
        let done = ((epoch - 1) as f64 + share) / self.recipe.epochs as f64;
        match self.recipe.schedule {
            Schedule::Constant => self.recipe.learning_rate,
            Schedule::Cosine => self.recipe.learning_rate * 0.5 * (1.0 + (std::f64::consts::PI * done).cos()),
            Schedule::Plateau => self.position.rate,
        }
    }

    /// One epoch, or as much of it as there is time for: its mean loss, and its windows.
    fn epoch(&mut self, epoch: usize, is_over: &dyn Fn() -> bool) -> Result<(f64, usize), BrakingTrainError> {
        let recipe = self.recipe;
        // So that a training that is resumed is the same.
        self.draw.begin(epoch);
        tch::manual_seed((recipe.seed as i64) << 32 | epoch as i64);
        let (mut sum, mut weight, mut windows) = (0.0, 0.0, 0);
        while windows < recipe.windows_per_epoch && (windows == 0 || !is_over()) {
            let Some((batch, cards)) = self.draw.batch(self.drives, &self.wanted, recipe, &mut self.reader)? else {
                break;
            };
            let answers = self.network.forward(&batch.frames, &batch.speeds, true)?;
            let [error, weights] = errors(&answers, &batch)?;
            let (errors, weighed) = (error.f_sum(Kind::Float)?, weights.f_sum(Kind::Float)?);
            let mut loss = errors.f_div(&weighed.f_clamp_min(1e-6)?)?;
            if let Some(besides) = besides(&answers, &batch)? {
                loss = loss.f_add(&besides.f_mul_scalar(recipe.besides)?)?;
            }
            self.stepper.forget_gradients();
            loss.f_backward()?;
            self.stepper.step(self.rate(epoch, windows as f64 / recipe.windows_per_epoch as f64))?;
            let each = error.f_detach()?.f_div(&weights.f_clamp_min(1e-6)?)?;
            self.draw.learnt(&cards, &Vec::<f32>::try_from(&each)?);
            sum += errors.f_double_value(&[])?;
            weight += weighed.f_double_value(&[])?;
            windows += recipe.batch;
        }
        Ok((sum / weight, windows))
    }

    /// Keeps the network if it is the best so far, and lowers the learning rate if none was for a while.
    fn judge(&mut self, epoch: Epoch) -> Result<&Epoch, BrakingTrainError> {
        let Self { recipe, network, best, position, .. } = self;
        let least = position.epochs.iter().map(|epoch| epoch.validation).fold(f64::INFINITY, f64::min);
        let is_best = epoch.validation < least;
        if is_best {
            position.since_best = 0;
            copy(best, &network.tensors())?;
        } else {
            position.since_best += 1;
        }
        if position.since_best >= recipe.patience {
            position.rate *= recipe.falls_to;
            position.since_best = 0;
        }
        position.steps = self.stepper.steps;
        position.epochs.push(Epoch { best: is_best, ..epoch });
        Ok(position.epochs.last().expect("one was just added"))
    }

    fn take_best(&mut self) {
        if !self.position.epochs.is_empty() {
            // Tensors of the same shapes.
            let _ = copy(&self.network.tensors(), &self.best);
        }
    }

    /// All that is stored.
    fn tensors(&self) -> Result<Vec<(String, Tensor)>, tch::TchError> {
        let losses = self.draw.losses.each_ref().map(|losses| Tensor::f_from_slice(losses));
        let [apart, others] = losses;
        let losses = [("losses.apart".to_owned(), apart?), ("losses.others".to_owned(), others?)];
        let best = self.best.iter().map(|(name, tensor)| (format!("best.{name}"), tensor.shallow_clone()));
        let moments = self.stepper.state().map(|(name, tensor)| (name, tensor.shallow_clone()));
        Ok(self.network.tensors().into_iter().chain(best).chain(moments).chain(losses).collect())
    }

    fn save(&self, path: &Path) -> Result<(), BrakingTrainError> {
        let mut tensors = self.tensors()?;
        // What was not seen has no finite loss, and a file only finite numbers.
        for (name, tensor) in &mut tensors {
            if name.starts_with("losses.") {
                *tensor = tensor.f_clamp_max(UNSEEN)?;
            }
        }
        state::save(path, &self.position, tensors)
    }

    fn resume(&mut self, path: &Path) -> Result<(), BrakingTrainError> {
        let tensors = self.tensors()?;
        let position = state::load(path, &tensors)?;
        // A longer training of the same kind goes on, too, if its learning rate does not depend on its length.
        if position.recipe != *self.recipe {
            return Err(BrakingTrainError::OtherRecipe { path: path.to_owned() });
        }
        for (name, tensor) in &tensors {
            match name.as_str() {
                "losses.apart" => self.draw.losses[0] = Vec::try_from(tensor)?,
                "losses.others" => self.draw.losses[1] = Vec::try_from(tensor)?,
                _ => {}
            }
        }
        self.stepper.steps = position.steps;
        self.position = position;
        Ok(())
    }
}

/// Copies tensors into others of the same shapes, in the same order.
fn copy(to: &[(String, Tensor)], from: &[(String, Tensor)]) -> Result<(), tch::TchError> {
    tch::no_grad(|| {
        to.iter().zip(from).try_for_each(|((_, to), (_, from))| to.shallow_clone().f_copy_(from).map(drop))
    })
}

/// What is chosen by: the same windows each time, and no chance in them.
struct Measured<'a> {
    recipe: &'a BrakingRecipe,
    drives: &'a [Drive],
    wanted: Vec<Vec<Wanted>>,
    drawn: Vec<Drawn>,
}

impl<'a> Measured<'a> {
    fn new(drives: &'a [Drive], recipe: &'a BrakingRecipe) -> Result<Self, BrakingTrainError> {
        let wanted: Vec<_> = drives.iter().map(|drive| wanted(drive, recipe)).collect();
        let windows = windows_of(drives, &wanted, recipe, Part::Validation)?;
        let [apart, others] = Windows::weights(recipe, windows.apart.len() as f64 / windows.len() as f64);
        let of = |windows: Vec<_>, weight: f64| {
            windows.into_iter().map(move |window| Drawn { window, unknown: 0.0, weight, change: None })
        };
        let all: Vec<Drawn> = of(windows.apart, apart).chain(of(windows.others, others)).collect();
        let every = all.len().div_ceil(recipe.validation_windows);
        let drawn = all.into_iter().step_by(every).collect();
        Ok(Self { recipe, drives, wanted, drawn })
    }

    fn loss(&self, network: &BrakingNetwork) -> Result<f64, BrakingTrainError> {
        let Self { recipe, drives, wanted, drawn } = self;
        let mut reader = Reader::new(recipe.network.preprocess()).map_err(NnError::from)?;
        let mut random = ChaCha8Rng::seed_from_u64(0); // no speed fails
        let (mut sum, mut weight) = (0.0, 0.0);
        for drawn in drawn.chunks(recipe.batch) {
            let batch = batch(drawn, drives, wanted, recipe, &mut reader, &mut random)?;
            let answers = tch::no_grad(|| network.forward(&batch.frames, &batch.speeds, false))?;
            let [error, weights] = errors(&answers, &batch)?;
            sum += error.f_sum(Kind::Float)?.f_double_value(&[])?;
            weight += weights.f_sum(Kind::Float)?.f_double_value(&[])?;
        }
        Ok(sum / weight)
    }
}
