//! A network that learns: Adam, by the mean squared error of the paper's network and the cross-entropy of the live one, which
//! learns besides how near what it sees is.

use std::{
    path::Path,
    thread::{self, ScopedJoinHandle},
};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Reduction, Tensor, nn};

use super::{
    BrakingRecipe, BrakingTrainError, Epoch, Part, SpeedFailure, episodes,
    episodes::{Drive, Reader},
    state::{self, Position, Stored},
    targets::{Wanted, wanted},
    windows::{Batch, Draw, Drawn, LEAST_WEIGHT, Windows, batch, length},
};
use crate::{
    nn::{
        NnError, Precision,
        braking::{Answers, BrakingArchitecture, BrakingCheckpoint, BrakingNetwork},
        in_variable_store,
    },
    train::{Optimiser, Schedule, Stepper},
};

/// Running means begin with as few steps as they have: after so many, they keep one half.
const WARM_UP_STEPS: f64 = 10.0;

/// PyTorch's bound on the logarithms of a cross-entropy.
const LEAST_LOGARITHM: f64 = -100.0;

/// What a state calls the losses of the windows of the two kinds.
const LOSSES: [&str; 2] = ["losses.apart", "losses.others"];

/// The loss of a window that was not seen yet, in a file.
const UNSEEN: f64 = 1e6;

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
    let (Some(blocked), Some(shows)) = (&answers.blocked, &answers.shows) else { return Ok(None) };
    let blocked = blocked.f_binary_cross_entropy::<Tensor>(&batch.blocked, None, Reduction::Mean)?;
    Ok(Some(blocked.f_add(&batch.told.error(shows)?)?))
}

/// The learning rate once this share of an epoch is done.
fn rate(recipe: &BrakingRecipe, position: &Position, epoch: usize, share: f64) -> f64 {
    let done = ((epoch - 1) as f64 + share) / recipe.epochs as f64;
    match recipe.schedule {
        Schedule::Plateau => position.rate,
        schedule => recipe.learning_rate * schedule.factor(done, 1.0),
    }
}

/// Takes a step at this learning rate, and returns each window's weighted [`errors`] and the weights.
fn learn(
    recipe: &BrakingRecipe,
    network: &BrakingNetwork,
    stepper: &mut Stepper,
    batch: &Batch,
    rate: f64,
) -> Result<[Tensor; 2], BrakingTrainError> {
    let answers = network.forward(&batch.frames, &batch.speeds, true)?;
    let [error, weights] = errors(&answers, batch)?;
    let weighed = weights.f_sum(Kind::Float)?.f_clamp_min(LEAST_WEIGHT)?;
    let mut loss = error.f_sum(Kind::Float)?.f_div(&weighed)?;
    if let Some(besides) = besides(&answers, batch)? {
        loss = loss.f_add(&besides.f_mul_scalar(recipe.besides)?)?;
    }
    stepper.forget_gradients();
    loss.f_backward()?;
    stepper.step(rate)?;
    Ok([error.f_detach()?, weights])
}

/// Moves the running means towards the weights: the fewer steps were taken, the faster.
fn average(
    recipe: &BrakingRecipe,
    stepper: &Stepper,
    mean: &BrakingNetwork,
    network: &BrakingNetwork,
) -> Result<(), tch::TchError> {
    let steps = stepper.steps as f64;
    let kept = recipe.average.min(steps / (steps + WARM_UP_STEPS));
    tch::no_grad(|| {
        let both = mean.tensors().into_iter().zip(network.tensors());
        both.into_iter().try_for_each(|((_, mut mean), (_, now))| mean.f_lerp_(&now, 1.0 - kept).map(drop))
    })
}

/// A network that learns, and all that belongs to it.
pub(super) struct Learning<'a> {
    recipe: &'a BrakingRecipe,
    drives: &'a [Drive],
    wanted: Vec<Vec<Wanted>>,
    pub(super) draw: Draw,
    reader: Reader,
    network: BrakingNetwork,
    /// The network whose weights are the running means of the other's: it is the one that is judged and kept.
    pub(super) mean: BrakingNetwork,
    /// Its weights after the best epoch.
    best: Vec<(String, Tensor)>,
    stepper: Stepper,
    pub(super) position: Position,
    _store: nn::VarStore,
}

/// The network from whose weights is learnt on, if there is one; it is of the recipe's kind.
pub(super) fn pretrained(recipe: &BrakingRecipe) -> Result<Option<BrakingNetwork>, BrakingTrainError> {
    let Some(path) = &recipe.pretrained else { return Ok(None) };
    let read = BrakingCheckpoint::read(path)?.network;
    let (expected, got) = (recipe.network.name(), read.architecture().name());
    if expected == got {
        Ok(Some(read))
    } else {
        Err(BrakingTrainError::OtherNetwork { path: path.clone(), expected, got })
    }
}

impl<'a> Learning<'a> {
    /// From the weights of a network of the recipe's kind, or from random ones.
    pub(super) fn new(
        recipe: &'a BrakingRecipe,
        drives: &'a [Drive],
        from: Option<&BrakingNetwork>,
    ) -> Result<Self, BrakingTrainError> {
        let wanted: Vec<_> = drives.iter().map(|drive| wanted(drive, recipe)).collect();
        let windows = windows_of(drives, &wanted, recipe, Part::Train)?;
        tch::manual_seed(recipe.seed as i64);
        let store = nn::VarStore::new(Device::cuda_if_available());
        let mut network = BrakingNetwork::build(recipe.network, &mut in_variable_store(store.root()))?;
        if let Some(from) = from {
            copy(&network.tensors(), &from.tensors())?;
        }
        let copies = &mut |name: &str, _: &[i64], _| {
            let tensors = network.tensors();
            let tensor = tensors.iter().find(|(own, _)| own == name).map(|(_, tensor)| tensor.f_detach_copy());
            Ok(tensor.expect("both are of the same architecture")?)
        };
        let mut mean = BrakingNetwork::build(recipe.network, copies)?;
        network.set_precision(recipe.precision);
        mean.set_precision(recipe.precision);
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
                episodes_read: None,
            },
            network,
            mean,
            _store: store,
        })
    }

    /// Asks the network about every window, unchanged and with all speeds known: what it knows least is drawn first.
    pub(super) fn ask(&mut self) -> Result<(), BrakingTrainError> {
        let said = episodes(&self.mean, self.drives, SpeedFailure::NONE, |_| {})?;
        let wanted = &self.wanted;
        self.draw.judge(length(self.recipe.network), |drive, frame| {
            let (said, wanted) = (&said[drive], &wanted[drive][frame]);
            let (value, due) = (said.values[frame], f64::from(wanted.due));
            let error = if self.recipe.network == BrakingArchitecture::Stacked {
                (value - due).powi(2)
            } else {
                let logarithm = |share: f64| share.ln().max(LEAST_LOGARITHM);
                -due * logarithm(value) - (1.0 - due) * logarithm(1.0 - value)
            };
            [error, f64::from(wanted.weight)]
        });
        Ok(())
    }

    /// The learning rate at a share of an epoch.
    pub(super) fn rate(&self, epoch: usize, share: f64) -> f64 {
        rate(self.recipe, &self.position, epoch, share)
    }

    /// One epoch, or as much of it as there is time for: its mean loss, and its windows.
    pub(super) fn epoch(
        &mut self,
        epoch: usize,
        is_over: &dyn Fn() -> bool,
    ) -> Result<(f64, usize), BrakingTrainError> {
        let Self { recipe, drives, wanted, draw, reader, network, mean, stepper, position, .. } = self;
        // So that a training that is resumed is the same.
        draw.begin(epoch);
        tch::manual_seed((recipe.seed as i64) << 32 | epoch as i64);
        let device = network.device();
        let (mut sum, mut weight, mut windows) = (0.0, 0.0, 0);
        let mut next = draw.batch(drives, wanted, recipe, reader)?;
        while let Some((batch, cards)) = next {
            let rate = rate(recipe, position, epoch, windows as f64 / recipe.windows_per_epoch as f64);
            windows += recipe.batch;
            let is_last = windows >= recipe.windows_per_epoch;
            // While the network learns from one batch, the next is drawn by the losses known before it.
            let (learnt, ahead) = thread::scope(|scope| {
                let ahead = (!is_last).then(|| scope.spawn(|| draw.batch(drives, wanted, recipe, reader)));
                let learnt = batch
                    .on(device)
                    .map_err(Into::into)
                    .and_then(|batch| learn(recipe, network, stepper, &batch, rate));
                (learnt, ahead.map(ScopedJoinHandle::join))
            });
            let [error, weights] = learnt?;
            average(recipe, stepper, mean, network)?;
            let each = error.f_div(&weights.f_clamp_min(LEAST_WEIGHT)?)?;
            draw.learnt(&cards, &Vec::<f32>::try_from(&each)?);
            sum += error.f_sum(Kind::Float)?.f_double_value(&[])?;
            weight += weights.f_sum(Kind::Float)?.f_double_value(&[])?;
            next = match ahead {
                Some(ahead) if !is_over() => ahead.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?,
                _ => None,
            };
        }
        Ok((sum / weight, windows))
    }

    /// Keeps the network if it is the best so far, and lowers the learning rate if none was for a while.
    pub(super) fn judge(&mut self, epoch: Epoch) -> Result<&Epoch, BrakingTrainError> {
        let Self { recipe, mean, best, position, .. } = self;
        let least = position.epochs.iter().map(|epoch| epoch.validation).fold(f64::INFINITY, f64::min);
        let is_best = epoch.validation < least;
        if is_best {
            position.since_best = 0;
            copy(best, &mean.tensors())?;
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

    /// Goes back to the best epoch, as it will drive.
    pub(super) fn take_best(&mut self) -> Result<(), BrakingTrainError> {
        if !self.position.epochs.is_empty() {
            copy(&self.mean.tensors(), &self.best)?;
        }
        self.mean.set_precision(Precision::F32);
        Ok(())
    }

    /// All that is stored.
    fn tensors(&self) -> Result<Vec<(String, Tensor)>, tch::TchError> {
        let losses = self.draw.losses.each_ref().map(|losses| Tensor::f_from_slice(losses));
        let [apart, others] = losses;
        let losses = [(LOSSES[0].to_owned(), apart?), (LOSSES[1].to_owned(), others?)];
        let best = self.best.iter().map(|(name, tensor)| (format!("best.{name}"), tensor.shallow_clone()));
        let mean = self.mean.tensors().into_iter().map(|(name, tensor)| (format!("mean.{name}"), tensor));
        let moments = self.stepper.state().map(|(name, tensor)| (name, tensor.shallow_clone()));
        Ok(self.network.tensors().into_iter().chain(mean).chain(best).chain(moments).chain(losses).collect())
    }

    /// Its state, as a file holds it.
    pub(super) fn encoded(&self) -> Result<Vec<u8>, BrakingTrainError> {
        let mut tensors = self.tensors()?;
        // What was not seen has no finite loss, and a file only finite numbers.
        for (name, tensor) in &mut tensors {
            if name.starts_with("losses.") {
                *tensor = tensor.f_clamp_max(UNSEEN)?;
            }
        }
        state::encode(&self.position, tensors)
    }

    pub(super) fn save(&self, path: &Path) -> Result<(), BrakingTrainError> {
        state::write(path, &self.encoded()?)
    }

    /// Goes on from a state of a training by the same recipe on the same episodes, which are those of `table`.
    pub(super) fn resume(&mut self, path: &Path, table: &Path) -> Result<(), BrakingTrainError> {
        let stored = Stored::read(path)?;
        let position = &stored.position;
        // A longer training goes on from a shorter one, if its learning rate does not depend on its length.
        let epochs = if self.recipe.schedule == Schedule::Cosine { position.recipe.epochs } else { self.recipe.epochs };
        if (BrakingRecipe { epochs, ..position.recipe.clone() }) != *self.recipe {
            return Err(BrakingTrainError::OtherRecipe { path: path.to_owned() });
        }
        let [own, its] = [&self.position.episodes_read, &position.episodes_read];
        let mut is_other = own.is_some() && its.is_some() && own != its;
        for (name, losses) in LOSSES.into_iter().zip(&self.draw.losses) {
            is_other |= stored.shape(name)?.is_some_and(|shape| shape != [losses.len()]);
        }
        if is_other {
            return Err(BrakingTrainError::OtherEpisodes { path: path.to_owned(), table: table.to_owned() });
        }
        let tensors = self.tensors()?;
        stored.copy_to(&tensors)?;
        for (name, tensor) in &tensors {
            match name.as_str() {
                name if name == LOSSES[0] => self.draw.losses[0] = Vec::try_from(tensor)?,
                name if name == LOSSES[1] => self.draw.losses[1] = Vec::try_from(tensor)?,
                _ => {}
            }
        }
        self.stepper.steps = stored.position.steps;
        let episodes = self.position.episodes_read.take();
        self.position = Position { episodes_read: episodes, ..stored.position };
        Ok(())
    }
}

/// Copies tensors into others of the same shapes, in the same order.
fn copy(to: &[(String, Tensor)], from: &[(String, Tensor)]) -> Result<(), tch::TchError> {
    tch::no_grad(|| to.iter().zip(from).try_for_each(|((_, to), (_, from))| to.shallow_clone().f_copy_(from).map(drop)))
}

/// What is chosen by: the same windows each time, and no chance in them.
pub(super) struct Measured<'a> {
    recipe: &'a BrakingRecipe,
    drives: &'a [Drive],
    wanted: Vec<Vec<Wanted>>,
    drawn: Vec<Drawn>,
}

impl<'a> Measured<'a> {
    pub(super) fn new(drives: &'a [Drive], recipe: &'a BrakingRecipe) -> Result<Self, BrakingTrainError> {
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

    pub(super) fn loss(&self, network: &BrakingNetwork) -> Result<f64, BrakingTrainError> {
        let Self { recipe, drives, wanted, drawn } = self;
        let reader = Reader::new(recipe.network.preprocess()).map_err(NnError::from)?;
        let mut random = ChaCha8Rng::seed_from_u64(0); // no speed fails
        let (mut sum, mut weight) = (0.0, 0.0);
        for drawn in drawn.chunks(recipe.batch) {
            let batch = batch(drawn, drives, wanted, recipe, &reader, &mut random)?.on(network.device())?;
            let answers = tch::no_grad(|| network.forward(&batch.frames, &batch.speeds, false))?;
            let [error, weights] = errors(&answers, &batch)?;
            sum += error.f_sum(Kind::Float)?.f_double_value(&[])?;
            weight += weights.f_sum(Kind::Float)?.f_double_value(&[])?;
        }
        Ok(sum / weight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        braking::{
            told,
            windows::tests::{drive, recipe, seen},
        },
        nn::braking::{BrakingMetadata, save_braking},
    };
    use lapwing_core::control::BrakeLimits;

    fn begun<'a>(recipe: &'a BrakingRecipe, drives: &'a [Drive]) -> Learning<'a> {
        Learning::new(recipe, drives, pretrained(recipe).unwrap().as_ref()).unwrap()
    }

    #[test]
    fn a_training_that_is_resumed_has_all_that_it_had_and_draws_what_it_would_have_drawn() {
        let drives = [drive()];
        let recipe =
            recipe("windows_per_epoch = 16\nemergencies = 0.5\nrivals = 2\nbesides = 1.0\naverage = 0.9\nflip = 0.5");
        let dir = tempfile::tempdir().unwrap();
        let state = dir.path().join("brake.state.safetensors");
        let mut before = begun(&recipe, &drives);
        let (loss, windows) = before.epoch(1, &|| false).unwrap();
        let told = Epoch { epoch: 1, windows, loss, validation: loss, learning_rate: 0.0, seconds: 0.0, best: false };
        before.judge(told).unwrap();
        before.save(&state).unwrap();
        let mut after = begun(&recipe, &drives);
        after.resume(&state, Path::new("data/episodes.csv")).unwrap();
        assert_eq!((&after.position, after.stepper.steps), (&before.position, 2));
        for ((name, a), (_, b)) in before.tensors().unwrap().iter().zip(&after.tensors().unwrap()) {
            assert_eq!(a.clamp_max(UNSEEN), b.clamp_max(UNSEEN), "{name}");
        }
        let next = |learning: &mut Learning<'_>| {
            learning.draw.begin(2);
            let drawn = learning.draw.batch(&drives, &learning.wanted, &recipe, &learning.reader);
            let (batch, cards) = drawn.unwrap().unwrap();
            (batch.frames, batch.speeds, cards)
        };
        assert_eq!(next(&mut before), next(&mut after));
    }

    #[test]
    fn a_training_by_another_recipe_or_on_other_episodes_is_not_resumed_and_the_error_says_which() {
        let (drives, more) = ([drive()], [drive(), drive()]);
        let recipe = recipe("");
        let dir = tempfile::tempdir().unwrap();
        let state = dir.path().join("brake.state.safetensors");
        let mut before = begun(&recipe, &drives);
        before.position.episodes_read = Some("00ff".into());
        before.save(&state).unwrap();
        let resumed = |recipe: &BrakingRecipe, drives: &[Drive], episodes: Option<&str>| {
            let mut learning = begun(recipe, drives);
            learning.position.episodes_read = episodes.map(str::to_owned);
            learning.resume(&state, Path::new("data/episodes.csv")).map_err(|error| error.to_string())
        };
        let other = BrakingRecipe { batch: 4, ..recipe.clone() };
        let error = resumed(&other, &more, Some("00ee")).unwrap_err();
        assert!(error.ends_with("expected the state of a training by this recipe, got that of another one"), "{error}");
        let told = "the state is of a training on other episodes, expected those of data/episodes.csv";
        for (drives, episodes) in [(&drives[..], Some("00ee")), (&more, Some("00ff")), (&more, None)] {
            let error = resumed(&recipe, drives, episodes).unwrap_err();
            assert!(error.contains(told), "{error}");
        }
        // As if one of the two were of an earlier version.
        assert_eq!(resumed(&recipe, &drives, None), Ok(()));
        assert_eq!(resumed(&recipe, &drives, Some("00ff")), Ok(()));
    }

    /// A file of a network of random weights.
    fn file_of(recipe: &BrakingRecipe, drives: &[Drive], dir: &Path) -> std::path::PathBuf {
        let path = dir.join("first.safetensors");
        let metadata = BrakingMetadata {
            preprocess: recipe.network.preprocess(),
            limits: BrakeLimits { fires: 0.5, releases: 0.25 },
            training: "none".into(),
            result: "none".into(),
        };
        save_braking(&path, &metadata, &begun(recipe, drives).network, Precision::F32).unwrap();
        path
    }

    #[test]
    fn a_network_that_learns_more_begins_as_it_was_and_knows_of_each_window_how_wrong_it_is() {
        let drives = [drive()];
        let dir = tempfile::tempdir().unwrap();
        let first = recipe("seed = 3\nemergencies = 0.5\ndue_weight = 2.0\nnear_s = [2.4, 1.3]\nlead = 1.0");
        let more = BrakingRecipe { seed: 4, pretrained: Some(file_of(&first, &drives, dir.path())), ..first.clone() };
        let mut learning = begun(&more, &drives);
        for ((name, a), (_, b)) in learning.mean.tensors().iter().zip(&begun(&first, &drives).network.tensors()) {
            assert_eq!(a, b, "{name}");
        }
        learning.ask().unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let windows = Windows::of(&drives, &learning.wanted, &more);
        for (windows, losses) in [windows.apart, windows.others].into_iter().zip(&learning.draw.losses) {
            assert!(windows.len() > 1 && losses.iter().any(|loss| (loss - losses[0]).abs() > 1e-3), "{losses:?}");
            for (window, loss) in windows.into_iter().zip(losses) {
                let drawn = [Drawn { window, unknown: 0.0, weight: 1.0, change: None }];
                let batch = batch(&drawn, &drives, &learning.wanted, &more, &learning.reader, &mut random).unwrap();
                let batch = batch.on(learning.mean.device()).unwrap();
                let answers = learning.mean.forward(&batch.frames, &batch.speeds, false).unwrap();
                let [error, weight] = errors(&answers, &batch).unwrap().map(|x| x.double_value(&[0]));
                assert!((error / weight - f64::from(*loss)).abs() < 1e-4, "{window:?}: {} {loss}", error / weight);
            }
        }
    }

    #[test]
    fn of_another_network_or_of_none_nothing_can_be_learnt_on() {
        let drives = [drive()];
        let dir = tempfile::tempdir().unwrap();
        let file = file_of(&recipe(""), &drives, dir.path());
        let error = |network, file| {
            let recipe = BrakingRecipe { network, pretrained: Some(file), ..recipe("") };
            pretrained(&recipe).expect_err("it must be refused").to_string()
        };
        let stacked = error(BrakingArchitecture::Stacked, file);
        assert!(stacked.ends_with("expected a brake-stacked network, as in the recipe, got brake-live"), "{stacked}");
        let missing = error(BrakingArchitecture::Live, "/nowhere/first.safetensors".into());
        assert!(missing.starts_with("pretrained: /nowhere/first.safetensors cannot be read"), "{missing}");
    }

    #[test]
    fn the_papers_network_takes_a_step_too() {
        let recipe = BrakingRecipe::read(
            "network = \"brake-stacked\"\nwindows_per_epoch = 4\nbatch = 2\nspeed_dropout = 0.5\nvalidation_windows = 2",
        );
        let (recipe, drives) = (recipe.unwrap(), [seen(300 * 300)]);
        let mut learning = begun(&recipe, &drives);
        let measured = Measured::new(&drives, &recipe).unwrap();
        let before = measured.loss(&learning.mean).unwrap();
        let (loss, windows) = learning.epoch(1, &|| false).unwrap();
        let after = measured.loss(&learning.mean).unwrap();
        assert_eq!((windows, learning.stepper.steps), (4, 2));
        assert!(loss.is_finite() && loss > 0.0 && (before - after).abs() > 1e-6, "{loss}, {before} to {after}");
    }

    #[test]
    fn the_papers_network_learns_by_the_mean_square_of_its_errors() {
        let numbers = |numbers: &[f32]| Tensor::from_slice(numbers).view([-1, 1]);
        let answers = Answers { due: numbers(&[0.5, 1.0, -2.0]), blocked: None, shows: None };
        let (recipe, drives) = (recipe(""), [drive()]);
        let mut learning = begun(&recipe, &drives);
        learning.draw.begin(1);
        let drawn = learning.draw.batch(&drives, &learning.wanted, &recipe, &learning.reader);
        let (batch, _) = drawn.unwrap().unwrap();
        let batch = Batch { due: numbers(&[0.0, 1.0, 1.0]), weights: numbers(&[1.0, 1.0, 2.0]), ..batch };
        let [summed, weights] = errors(&answers, &batch).unwrap().map(|x| Vec::<f32>::try_from(&x).unwrap());
        assert_eq!((summed, weights), (vec![0.25, 0.0, 18.0], vec![1.0, 1.0, 2.0]));
    }

    #[test]
    fn the_learning_rate_falls_where_the_validation_loss_does_not_for_so_many_passes() {
        let (recipe, drives) = (recipe("patience = 2\nfalls_to = 0.1\nlearning_rate = 1e-3"), [drive()]);
        let mut learning = begun(&recipe, &drives);
        let rates = [0.5, 0.6, 0.5, 0.4, 0.45, 0.41, 0.43].map(|validation| {
            let told =
                Epoch { epoch: 1, windows: 1, loss: 1.0, validation, learning_rate: 0.0, seconds: 0.0, best: false };
            learning.judge(told).unwrap();
            learning.position.rate
        });
        let expected = [1e-3, 1e-3, 1e-4, 1e-4, 1e-4, 1e-5, 1e-5];
        assert!(rates.iter().zip(expected).all(|(rate, expected)| (rate / expected - 1.0).abs() < 1e-9), "{rates:?}");
    }

    #[test]
    fn what_frames_show_is_learnt_besides() {
        let text = "network = \"brake-live\"\nwindows_per_epoch = 16\nbatch = 8\nlearning_rate = 3e-3\nbesides = 1.0\nflip = 0.5";
        let recipe = BrakingRecipe::read(text).unwrap();
        let mut drive = drive();
        drive.shown = vec![told::tests::shown(); drive.frames()];
        let drives = [drive];
        let mut learning = begun(&recipe, &drives);
        let wrong = |learning: &mut Learning<'_>| {
            learning.draw.begin(99);
            let drawn = learning.draw.batch(&drives, &learning.wanted, &recipe, &learning.reader);
            let batch = drawn.unwrap().unwrap().0.on(learning.network.device()).unwrap();
            let answers = learning.network.forward(&batch.frames, &batch.speeds, true).unwrap();
            batch.told.error(&answers.shows.unwrap()).unwrap().double_value(&[])
        };
        let before = wrong(&mut learning);
        for epoch in 1..9 {
            learning.epoch(epoch, &|| false).unwrap();
        }
        let after = wrong(&mut learning);
        assert!(after < 0.5 * before, "{before} to {after}");
    }
}
