//! A training of a braking network, from a recipe and a data set to a file.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{
    BrakingDataError, BrakingRecipe, Part, SpeedFailure, episodes,
    episodes::{Drive, digest, load, retell_all},
    learning::{Learning, Measured, pretrained},
    state,
};
use crate::{
    nn::{
        NnError, Precision,
        braking::{BrakingArchitecture, BrakingError, BrakingMetadata, save_braking},
        runtime,
    },
    train::TrainError,
};
use lapwing_core::control::BrakeLimits;
use lapwing_score::emergency::{
    CountingRule, Evaluation,
    evaluation::{LimitRule, chosen_limits},
};
use lapwing_sim::braking::{Case, EPISODES_NAME};

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
    /// The optimiser.
    #[error(transparent)]
    Optimiser(#[from] TrainError),
    /// The file of `pretrained`.
    #[error("pretrained: {0}")]
    Pretrained(#[from] BrakingError),
    /// Another network's.
    #[error("pretrained: {}: expected a {expected} network, as in the recipe, got {got}", path.display())]
    OtherNetwork {
        /// The file.
        path: PathBuf,
        /// The recipe's.
        expected: &'static str,
        /// The file's.
        got: &'static str,
    },
    /// The file from which a training is resumed.
    #[error("{}: expected the state of a training, got an error: {why}", path.display())]
    State {
        /// The file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// The state of an earlier training would be lost.
    #[error("{} is the state of an earlier training: resume it (--resume), or choose another file", .0.display())]
    StateThere(PathBuf),
    /// A network would be lost.
    #[error("{} exists, but without a resume state: nothing is overwritten, choose another file", .0.display())]
    NetworkThere(PathBuf),
    /// Another training's state.
    #[error("{}: expected the state of a training by this recipe, got that of another one", path.display())]
    OtherRecipe {
        /// The file.
        path: PathBuf,
    },
    /// Another data set's.
    #[error(
        "{}: the state is of a training on other episodes, expected those of {}: name the data set that it is of, or choose \
         another file for the network",
        path.display(),
        table.display()
    )]
    OtherEpisodes {
        /// The file.
        path: PathBuf,
        /// The table of the data set that was named.
        table: PathBuf,
    },
    /// No episode is long enough.
    #[error("expected episodes of at least {frames} frames in the part {part}, got none")]
    TooShort {
        /// How long a window is.
        frames: usize,
        /// The part.
        part: Part,
    },
    /// Nothing to learn.
    #[error("expected emergencies in the part {0}, got none: no pedal goes down fast")]
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
    /// Between which values its guards brake and rest:
    /// [`chosen_limits`]'s on the validation episodes, among
    /// which laps are harmless.
    pub limits: BrakeLimits,
    /// By which rule.
    pub rule: LimitRule,
    /// How good it is on those, at that limit.
    pub validation: Evaluation,
}

/// How a training is run.
#[derive(Debug, Clone, Copy, Default)]
pub struct TrainOptions {
    /// Ends it early, with the best of its epochs, once so much has passed.
    pub most: Option<Duration>,
    /// Goes on where an earlier one ended, if there is its state beside the network's file; if there is neither, a warning is logged.
    pub resume: bool,
    /// Threads of each of libtorch's operations while it learns, at least 1: other numbers round differently.
    pub threads: u16,
}

/// Trains a network on a data set and writes it to `path`, and its own state beside it after each whole epoch; if there is none,
/// the state before the first. `told` is told of each epoch.
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
    // Before the data, which takes a while.
    let from = pretrained(recipe)?;
    let state = state::path_of(path);
    let goes_on = match (state.exists(), options.resume) {
        (true, true) => true,
        (true, false) => return Err(BrakingTrainError::StateThere(state)),
        (false, _) if path.exists() => return Err(BrakingTrainError::NetworkThere(path.to_owned())),
        (false, true) => {
            tracing::warn!("{}: no resume state: the training starts from the beginning", state.display());
            false
        }
        (false, false) => false,
    };
    let architecture = recipe.network;
    let most = recipe.episodes.unwrap_or(usize::MAX);
    let mut drives = load(data, Part::Train, most, architecture)?;
    let held = load(data, Part::Validation, recipe.validation_episodes.unwrap_or(most), architecture)?;
    for (drives, part) in [(&drives, Part::Train), (&held, Part::Validation)] {
        if !drives.iter().any(|drive| drive.due.iter().any(|due| *due)) {
            return Err(BrakingTrainError::NoEmergency(part));
        }
    }
    if architecture == BrakingArchitecture::Live {
        retell_all(data, &mut drives)?;
    }
    let mut learning = Learning::new(recipe, &drives, from.as_ref())?;
    let counted = learning.draw.losses.each_ref().map(Vec::len);
    let measured = Measured::new(&held, recipe)?;
    learning.position.episodes_read = Some(digest(data)?);
    if goes_on {
        learning.resume(&state, &data.join(EPISODES_NAME))?;
    } else if recipe.pretrained.is_some() {
        learning.ask()?;
    }
    let beginning = if goes_on || options.most.is_none() { None } else { Some(learning.encoded()?) };
    runtime::set_threads(options.threads);
    let before_s = learning.position.epochs.last().map_or(0.0, |epoch| epoch.seconds);
    let began = Instant::now();
    let is_over = || options.most.is_some_and(|most| began.elapsed() >= most);
    while learning.position.epochs.len() < recipe.epochs && !is_over() {
        let epoch = learning.position.epochs.len() + 1;
        let (loss, windows) = learning.epoch(epoch, &is_over)?;
        let validation = measured.loss(&learning.mean)?;
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
    // So that what is written can be resumed in any case.
    if let Some(beginning) = beginning.filter(|_| !state.exists()) {
        state::write(&state, &beginning)?;
    }
    warn_if_cut_short(&learning.position.epochs, recipe);
    learning.take_best()?;
    // Episodes are judged side by side.
    runtime::set_threads(1);
    let (network, epochs) = (&learning.mean, &learning.position.epochs);
    let judged = episodes(network, &held, SpeedFailure::NONE, |_| {})?;
    let laps: Vec<_> = held.iter().zip(&judged).filter(|(drive, _)| drive.story.scenario == Case::Lap.name()).collect();
    let laps: Vec<_> = laps.into_iter().map(|(_, judged)| judged.clone()).collect();
    let middle = BrakeLimits { fires: 0.5, releases: 0.5 * RELEASES };
    let (limits, rule) = chosen_limits(&judged, &laps, RELEASES).unwrap_or((middle, LimitRule::BestF1));
    let validation = Evaluation::of(&judged, limits, CountingRule::default(), recipe.seed);
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
        "part": "validation", "loss": least, "threshold": limits.fires, "precision": validation.precision.value,
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
    Ok(Trained { path: path.to_owned(), sha256, epochs: epochs.clone(), limits, rule, validation })
}

/// Warns of a training that ended within an epoch, or before the first.
fn warn_if_cut_short(epochs: &[Epoch], recipe: &BrakingRecipe) {
    let whole = recipe.windows_per_epoch;
    match epochs.last() {
        None => {
            tracing::warn!(
                "time limit reached before the first pass: the network has learnt nothing; --resume starts the first pass"
            )
        }
        Some(Epoch { epoch, windows, .. }) if *windows < whole => {
            tracing::warn!("pass {epoch} was cut short, after {windows} of {whole} windows: --resume starts it again");
        }
        Some(_) => {}
    }
}

/// Episodes and frames, in a checkpoint.
fn told_of(drives: &[Drive]) -> serde_json::Value {
    let frames: usize = drives.iter().map(Drive::frames).sum();
    let emergencies: usize = drives.iter().map(|drive| drive.onsets.len()).sum();
    json!({ "episodes": drives.len(), "frames": frames, "emergencies": emergencies })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use lapwing_sim::braking::{DataOptions, record};

    /// A data set of one hazard, to learn from and to choose by.
    fn data() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let options = DataOptions { hours: 0.001, seed: 3, ..DataOptions::default() };
        record(folder.path(), options, |_, _| true).unwrap();
        let table = folder.path().join(EPISODES_NAME);
        let text = fs::read_to_string(&table).unwrap();
        let (heading, row) = (text.lines().next().unwrap(), text.lines().nth(1).unwrap());
        let [train, validation] = ["train", "validation"].map(|part| row.replacen(",train,", &format!(",{part},"), 1));
        assert!(row.contains(",train,") && row.contains(",hazard,"), "{row}");
        fs::write(table, format!("{heading}\n{train}\n{validation}\n")).unwrap();
        folder
    }

    #[test]
    fn a_training_that_ends_within_its_first_pass_begins_it_again_when_it_is_resumed() {
        let data = data();
        let text = "network = \"brake-live\"\nwindows_per_epoch = 100000\nbatch = 2\nvalidation_windows = 1";
        let recipe = BrakingRecipe::read(text).unwrap();
        let out = tempfile::tempdir().unwrap();
        let path = out.path().join("brake.safetensors");
        let run = |most: Duration, resume: bool| {
            let (mut epochs, options) = (vec![], TrainOptions { most: Some(most), resume, threads: 1 });
            train(&recipe, data.path(), &path, options, |epoch| epochs.push(epoch.epoch)).map(|_| epochs)
        };
        // Over before it begins.
        assert_eq!(run(Duration::ZERO, false).unwrap(), [0; 0]);
        let state = out.path().join("brake.state.safetensors");
        let beginning = fs::read(&state).unwrap();
        assert!(matches!(run(Duration::ZERO, false), Err(BrakingTrainError::StateThere(_))));
        assert_eq!(run(Duration::from_secs(1), true).unwrap(), [1]);
        assert!(fs::read(&state).unwrap() == beginning, "no pass is whole");
        assert_eq!(run(Duration::from_secs(1), true).unwrap(), [1]);
        // Likewise if the first part of it is learnt at once.
        fs::remove_file(&state).unwrap();
        fs::remove_file(&path).unwrap();
        assert_eq!(run(Duration::from_secs(1), false).unwrap(), [1]);
        assert!(fs::read(&state).unwrap() == beginning);
    }

    #[test]
    fn a_folder_without_a_data_set_is_told_how_to_record_one() {
        let folder = tempfile::tempdir().unwrap();
        let error = load(folder.path(), Part::Train, 1, BrakingArchitecture::Live).unwrap_err().to_string();
        let told = format!("record one (lapwing brake record --out {})", folder.path().display());
        assert!(error.ends_with(&told) && error.contains("expected the table of a data set"), "{error}");
    }
}
