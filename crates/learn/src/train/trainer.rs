//! The training loop.

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use tch::{Device, Kind, Reduction, Tensor, nn::VarStore, no_grad};

use super::{
    Keep, Metrics, Recipe, Tensors, TrainError,
    events::Events,
    log,
    measure::{BATCH, labels, measure},
    optimiser::Stepper,
    origin::Origin,
    preparation,
    progress::{Epoch, Go, Progress, TimedEpoch, TrainOutcome},
    state::{self, MODEL, Position, STATE, Stored},
};
use crate::{
    dataset::{Batch, Cache, Inputs, Loader, Samples, Workers, samples_hash},
    nn::{self, Architecture, Design, Metadata, Network, NnError, Precision, in_variable_store},
};
use lapwing_core::{
    files,
    hash::sha256,
    perception::{Crop, Resize},
};

/// Plateau: epochs without a better error, and the factor applied then.
const PLATEAU: (usize, f64) = (3, 0.1);

/// A training in its folder.
#[derive(Debug)]
pub struct Trainer {
    recipe: Recipe,
    origin: Origin,
    out: PathBuf,
    device: Device,
    inputs: Inputs,
    network: Network,
    /// The mean over past weights; measured and saved if there is one.
    average: Option<Network>,
    stepper: Stepper,
    training: (Arc<Samples>, Arc<Cache>),
    validation: (Arc<Samples>, Arc<Cache>),
    position: Position,
    /// Keep the variables alive.
    _stores: Vec<VarStore>,
    /// Holds the folder.
    _lock: Option<File>,
}

/// (B, outputs) for a batch; the speed is used only if the network takes it.
pub(super) fn forward(network: &Network, batch: &Tensors, train: bool) -> Result<Tensor, NnError> {
    network.forward(&batch.frames, network.design().speed.then_some(&batch.speed), train)
}

/// What is in the folder, and the network: all that is known without data.
fn begun(recipe: &Recipe, out: &Path, resume: bool) -> Result<(Option<Stored>, Architecture, Design), TrainError> {
    recipe.check()?;
    let stored = preparation::stored(out, resume)?;
    let before = stored.as_ref().and_then(|stored| stored.origin.as_ref());
    before.map_or(Ok(()), |origin| origin.check_recipe(recipe, out))?;
    if let Some(done) = stored.as_ref().map(|stored| stored.position.epoch).filter(|done| *done > recipe.epochs) {
        let got = format!("{}, and {done} are done", recipe.epochs);
        return Err(TrainError::Setting { name: "epochs", expected: "at least as many as are done", got });
    }
    let architecture = Architecture::named(&recipe.network)
        .ok_or_else(|| NnError::UnknownArchitecture { got: recipe.network.clone() })?;
    let mut design = Design { speed: recipe.speed_input, ..Design::of(architecture) };
    if let Some((height, width)) = recipe.input {
        design.preprocess.resize = Resize { height, width, ..design.preprocess.resize };
    }
    if let Some((top, bottom)) = recipe.crop {
        design.preprocess.crop = Some(Crop::rows(top, bottom));
    }
    design.validate()?;
    preparation::check_labels_kept(recipe, architecture)?;
    if let Some(path) = recipe.pretrained.as_ref().filter(|_| stored.is_none()) {
        fs::File::open(path).map_err(|source| NnError::Read { path: path.clone(), source })?;
    }
    Ok((stored, architecture, design))
}

impl Trainer {
    /// Checks whether a training could begin, as far as possible without its data, which may still have to be recorded.
    ///
    /// # Errors
    /// [`TrainError`].
    pub fn check(recipe: &Recipe, out: &Path, resume: bool) -> Result<(), TrainError> {
        begun(recipe, out, resume).map(drop)
    }

    /// Opens the data and draws the first weights. If `resume`, continues the training in `out`, or begins one if there
    /// is none; the recipe must be the one that the training there began with, except for settings that do not affect
    /// training: more epochs (unless the schedule is a cosine over them), patience, cache, how weights are stored.
    ///
    /// # Errors
    /// [`TrainError`].
    pub fn new(recipe: Recipe, out: &Path, resume: bool) -> Result<Self, TrainError> {
        let hold = || files::lock(out, false).map_err(TrainError::io("train in it", out));
        // Before its state is read; a new folder is not made until all is known to be right.
        let held = hold()?;
        let (stored, architecture, design) = begun(&recipe, out, resume)?;
        let before = stored.as_ref().and_then(|stored| stored.origin.as_ref());
        let inputs = Inputs {
            preprocess: design.preprocess.clone(),
            frames: architecture.frames(),
            bf16: recipe.precision == Precision::Bf16,
            channels_last: recipe.channels_last,
        };
        let (training, validation) = preparation::data(&recipe, architecture)?;
        let samples = (training.samples.len(), validation.samples.len());
        let hash = samples_hash([&training.samples, &validation.samples]);
        before.map_or(Ok(()), |origin| origin.check_samples(samples, &hash, out))?;
        preparation::check_room(&recipe, &inputs)?;
        let with_cache = |samples: Samples, share: usize| {
            let cache = Cache::new(&samples, (recipe.cache_mib << 20) / 5 * share);
            (Arc::new(samples), cache)
        };
        let (training, validation) = (with_cache(training, 4), with_cache(validation, 1));

        let device = Device::cuda_if_available();
        if inputs.bf16 && device == Device::Cpu && !nn::runtime::knows_bf16() {
            tracing::warn!("this processor does not support bf16: training is many times faster with precision f32");
        }
        tch::manual_seed(recipe.seed as i64);
        let fresh = || {
            let store = VarStore::new(device);
            let network = Network::build(&design, &mut in_variable_store(store.root()))?;
            Ok::<_, TrainError>((store, network))
        };
        let (store, mut network) = fresh()?;
        if let Some(path) = recipe.pretrained.as_ref().filter(|_| stored.is_none()) {
            let taken = nn::load_pretrained(&network, path).map_err(TrainError::of_pretrained(path))?;
            tracing::info!("{taken} of {} tensors are taken from {}", network.tensors().len(), path.display());
        }
        match recipe.frozen_stages() {
            0 => {}
            stages => network.freeze(stages)?,
        }
        if network.normalises_by_batch() {
            let got = recipe.batch.min(recipe.samples_per_epoch.unwrap_or(samples.0));
            if got < 2 {
                let (name, expected) = ("batch", "at least 2 samples: batch norm depends on how they differ");
                return Err(TrainError::Setting { name, expected, got: got.to_string() });
            }
        }
        let mut stores = vec![store];
        let average = match recipe.ema {
            None => None,
            Some(_) => {
                let (store, average) = fresh()?;
                stores.push(store);
                copy(&network, &average, 0.0)?;
                Some(average)
            }
        };
        let weights = network.tensors().into_iter().filter(|(_, tensor)| tensor.requires_grad()).collect();
        let stepper = Stepper::new(recipe.optimiser.clone(), weights)?;
        let position = Position { factor: 1.0, ..Position::default() };
        let mut trainer = Self {
            origin: Origin { recipe: recipe.clone(), samples, hash: Some(hash) },
            recipe,
            out: out.to_owned(),
            device,
            inputs,
            network,
            average,
            stepper,
            training,
            validation,
            position,
            _stores: stores,
            _lock: None,
        };
        if let Some(stored) = stored {
            stored.copy_to(&borrow(&trainer.state()))?;
            trainer.position = stored.position;
            trainer.stepper.steps = trainer.position.steps;
        }
        fs::create_dir_all(out).map_err(TrainError::io("make the training's folder", out))?;
        trainer._lock = held.map_or_else(hold, |held| Ok(Some(held)))?;
        let path = out.join("recipe.toml");
        let text = toml::to_string(&trainer.recipe).map_err(|why| TrainError::Recipe(why.to_string()))?;
        files::write(&path, text.as_bytes()).map_err(TrainError::io("write the recipe", &path))?;
        Ok(trainer)
    }

    /// Samples of training and validation.
    pub fn sizes(&self) -> (usize, usize) {
        (self.training.0.samples.len(), self.validation.0.samples.len())
    }

    /// The batches of an epoch, 0 being the first, from this step on.
    ///
    /// # Errors
    /// [`TrainError::Dataset`].
    pub fn batches(&self, epoch: usize, from: usize) -> Result<Loader, TrainError> {
        let count = self.recipe.samples_per_epoch.unwrap_or(self.training.0.samples.len());
        let mut order = self.training.0.draw(count, self.recipe.seed, epoch as u64);
        if self.network.normalises_by_batch() && order.len() % self.recipe.batch == 1 {
            // The statistics of a last batch with a single sample would be noise.
            order.pop();
        }
        Ok(Loader::start(
            Arc::clone(&self.training.0),
            Arc::clone(&self.training.1),
            self.inputs.clone(),
            self.recipe.augment.clone(),
            order,
            self.recipe.batch,
            (self.recipe.seed, epoch as u64, from),
            Workers::all(self.device != Device::Cpu),
        )?)
    }

    /// Epochs done so far.
    pub fn history(&self) -> &[TimedEpoch] {
        &self.position.history
    }

    /// Trains to the end, or until `watch` says stop.
    ///
    /// # Errors
    /// [`TrainError`]; what was saved before stays.
    pub fn run(&mut self, watch: &mut dyn FnMut(Progress<'_>) -> Go) -> Result<TrainOutcome, TrainError> {
        let mut events = None;
        let mut finished = true;
        while self.position.epoch < self.recipe.epochs {
            if self.recipe.patience.is_some_and(|patience| self.position.waited >= patience) {
                break;
            }
            let Some(epoch) = self.epoch(watch)? else {
                finished = false;
                break;
            };
            self.close_epoch(epoch, &mut events)?;
            let epoch = self.position.history.last().expect("an epoch was closed");
            if watch(Progress::Epoch(epoch)) == Go::Stop && self.position.epoch < self.recipe.epochs {
                finished = false;
                break;
            }
        }
        let model = self.out.join(MODEL);
        if !model.exists() {
            // Stopped in the first epoch, or the file was removed: these weights are better than none.
            self.save_model(&model)?;
        }
        let bytes = fs::read(&model).map_err(TrainError::io("read the model", &model))?;
        Ok(TrainOutcome { model, sha256: sha256(&bytes), kept: state::epoch_of(&bytes), finished })
    }

    /// One pass; `None` if it was stopped, with its state saved.
    fn epoch(&mut self, watch: &mut dyn FnMut(Progress<'_>) -> Go) -> Result<Option<TimedEpoch>, TrainError> {
        let number = self.position.epoch;
        let loader = self.batches(number, self.position.step)?;
        let steps = loader.batches();
        let began = Instant::now();
        // That of the last step, if all of them are done and only the results were not written.
        let mut rate = self.learning_rate((self.position.steps - 1).max(0), steps);
        for batch in loader {
            let tensors = self.tensors(batch?)?;
            let batch = tensors.batch();
            rate = self.learning_rate(self.position.steps, steps);
            let (loss, answer) = self.learn(&tensors, rate).map_err(|error| error.at_batch(self.recipe.batch))?;
            self.position.step += 1;
            self.position.steps += 1;
            if !loss.is_finite() {
                return Err(TrainError::NotFinite { loss, epoch: number + 1, step: self.position.step, rate });
            }
            self.position.answers.extend(answer);
            let label = labels(self.network.architecture())[0];
            self.position.labels.extend(batch.labels(label).iter().map(|x| f64::from(*x)));
            let progress =
                Progress::Step { epoch: number + 1, step: self.position.step, steps, samples: batch.size, loss };
            if watch(progress) == Go::Stop && self.position.step < steps {
                self.position.seconds += began.elapsed().as_secs_f64();
                self.save_state()?;
                return Ok(None);
            }
        }
        self.position.seconds += began.elapsed().as_secs_f64();
        let Position { seconds, answers, labels, .. } = &self.position;
        let shown = self.average.as_ref().unwrap_or(&self.network);
        let measured = measure(shown, &self.validation.0, &self.validation.1, &self.inputs);
        let (validation, _) = measured.map_err(|error| error.at_batch(BATCH))?;
        let mse = validation.raw.mse;
        if !mse.is_finite() {
            return Err(TrainError::Validation { mse, epoch: number + 1 });
        }
        let epoch = Epoch {
            number: number + 1,
            learning_rate: rate,
            training: Metrics::of(answers, labels),
            validation,
            best: self.position.best.is_none_or(|best| mse < best),
        };
        Ok(Some(TimedEpoch { epoch, seconds: *seconds, images_per_s: answers.len() as f64 / seconds.max(1e-9) }))
    }

    /// A batch as this training takes it.
    ///
    /// # Errors
    /// Those of [`Tensors::new`].
    pub fn tensors(&self, batch: Batch) -> Result<Tensors, TrainError> {
        Tensors::new(batch, &self.inputs, labels(self.network.architecture()), self.device)
    }

    /// Updates the weights by one step of the width `rate`, unless the loss is not a number. Returns the loss and the
    /// first numbers answered before.
    ///
    /// # Errors
    /// [`TrainError::Network`].
    pub fn learn(&mut self, tensors: &Tensors, rate: f64) -> Result<(f64, Vec<f64>), TrainError> {
        // Dropout depends only on the step, so that a resumed training draws the same.
        tch::manual_seed((self.recipe.seed as i64).wrapping_mul(1_000_003).wrapping_add(self.position.steps));
        let answer = forward(&self.network, tensors, true)?.f_to_kind(Kind::Float)?;
        let loss = match self.network.architecture() {
            Architecture::Lane => nn::lane::loss(&answer, &tensors.labels)?,
            _ => answer.f_mse_loss(&tensors.labels, Reduction::Mean)?,
        };
        let value = loss.f_double_value(&[])?;
        if value.is_finite() {
            self.stepper.forget_gradients();
            loss.f_backward()?;
            self.stepper.step(rate)?;
            if let (Some(average), Some(share)) = (&self.average, self.recipe.ema) {
                // At first the mean follows quickly, as the initial weights are noise.
                let steps = self.position.steps as f64;
                copy(&self.network, average, share.min((1.0 + steps) / (10.0 + steps)))?;
            }
        }
        let first = answer.f_detach()?.f_select(1, 0)?.f_to_device(Device::Cpu)?.f_to_kind(Kind::Double)?;
        Ok((value, Vec::try_from(&first)?))
    }

    /// That of the step after so many, with this many in a pass.
    fn learning_rate(&self, done: i64, steps: usize) -> f64 {
        let o = &self.recipe.optimiser;
        let done = done as f64 / (steps * self.recipe.epochs) as f64;
        o.learning_rate * o.schedule.factor(done, self.position.factor)
    }

    /// Saves the results of an epoch. The state comes last: if it is not written, the epoch is repeated, and everything
    /// else is written again.
    fn close_epoch(&mut self, timed: TimedEpoch, events: &mut Option<Events>) -> Result<(), TrainError> {
        if !self.out.join(STATE).exists() {
            self.save_state()?; // so that the folder never holds a model without its resume state
        }
        self.position.epoch += 1;
        self.position.step = 0;
        // Not before: where the state just saved is resumed from, the pass is closed anew, with what was answered in it.
        self.position.seconds = 0.0;
        self.position.answers.clear();
        self.position.labels.clear();
        let best = timed.epoch.best;
        if best {
            (self.position.best, self.position.waited) = (Some(timed.epoch.validation.raw.mse), 0);
        } else {
            self.position.waited += 1;
            if self.position.waited.is_multiple_of(PLATEAU.0) {
                self.position.factor *= PLATEAU.1;
            }
        }
        self.position.history.push(timed);
        if best || self.recipe.keep == Keep::Last {
            self.save_model(&self.out.join(MODEL))?;
        }
        log::write(&self.out.join("log.csv"), &self.position.history)?;
        let write = || -> std::io::Result<()> {
            let events = match events {
                Some(events) => events,
                none => none.insert(Events::create(&self.out, log::now(), self.position.epoch as i64)?),
            };
            self.position.history.last().map_or(Ok(()), |timed| log::curves(events, timed))
        };
        write().map_err(TrainError::io("write the events", &self.out))?;
        self.save_state()
    }

    fn save_model(&self, path: &Path) -> Result<(), TrainError> {
        let network = self.average.as_ref().unwrap_or(&self.network);
        let outputs = network.architecture().outputs().iter().map(|name| (*name).to_owned());
        let json = |value: serde_json::Result<String>| value.map_err(|why| TrainError::Recipe(why.to_string()));
        let result = self.position.history.last().map(|timed| &timed.epoch);
        let metadata = Metadata {
            preprocess: self.inputs.preprocess.clone(),
            outputs: outputs.collect(),
            training: json(serde_json::to_string(&self.recipe))?,
            result: json(serde_json::to_string(&result))?,
        };
        nn::save(path, &metadata, network, self.recipe.stored)?;
        Ok(())
    }

    /// All tensors needed to resume.
    fn state(&self) -> Vec<(String, Tensor)> {
        let weights = self.network.tensors().into_iter().map(|(name, tensor)| (format!("weights.{name}"), tensor));
        let average = self.average.iter().flat_map(Network::tensors);
        let average = average.map(|(name, tensor)| (format!("average.{name}"), tensor));
        let moments = self.stepper.state().map(|(name, tensor)| (name, tensor.shallow_clone()));
        weights.chain(average).chain(moments).collect()
    }

    fn save_state(&self) -> Result<(), TrainError> {
        state::save(&self.out.join(STATE), &self.position, &self.origin, &borrow(&self.state()))
    }
}

fn borrow(tensors: &[(String, Tensor)]) -> Vec<(String, &Tensor)> {
    tensors.iter().map(|(name, tensor)| (name.clone(), tensor)).collect()
}

/// Moves the weights of `to` towards those of `from`, keeping `share` of their old values. Buffers are copied.
fn copy(from: &Network, to: &Network, share: f64) -> Result<(), TrainError> {
    no_grad(|| {
        for ((_, from), (_, mut to)) in from.tensors().into_iter().zip(to.tensors()) {
            let share = if from.requires_grad() { share } else { 0.0 };
            let _ = to.f_lerp_(&from.detach(), 1.0 - share)?;
        }
        Ok(())
    })
}
