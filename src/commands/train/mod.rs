//! `lapwing train`.

mod rounds;

use std::{
    collections::VecDeque,
    fs,
    io::{self, IsTerminal},
    path::Path,
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};

use super::{Ended, Interrupted, outputs, record, terminal, world};
use crate::cli;
use lapwing_core::{config::ConfigError, words::count};
use lapwing_learn::{
    dataset::{self, Augmentation, Selection},
    train::{Go, Metrics, Progress, Recipe, SimulatedData, TimedEpoch, TrainOutcome, Trainer},
};
use lapwing_sim::{locate::LaneTable, record::RecordReport, track::Track, world::Ending};

pub(super) fn run(arguments: cli::Train, config: Option<&Path>) -> anyhow::Result<Ended> {
    let recipe = recipe(&arguments)?;
    check(&recipe, &arguments.out, arguments.resume, config)?;
    let interrupted = super::interrupted();
    for recording in &recipe.record {
        make(recording, config, &interrupted)?;
    }
    let outcome = learn(recipe.clone(), &arguments.out, arguments.resume, &interrupted)?;
    let outcome = match &recipe.closed_loop {
        Some(closed_loop) if outcome.finished => {
            rounds::run(&recipe, closed_loop, &arguments.out, outcome, config, &interrupted)?
        }
        _ => outcome,
    };
    if arguments.json {
        super::print(&super::sorted_json(&outcome)?)?;
    } else {
        let kept = outcome.kept.as_ref().map_or_else(
            || "no epoch was finished".to_owned(),
            |epoch| format!("epoch {}, validation {}", epoch.number, told(&epoch.validation.raw)),
        );
        super::print(&format!("{} ({kept})", outcome.model.display()))?;
        if !outcome.finished {
            say!("stopped; to resume: lapwing train --resume --out {}", terminal::pasted(&arguments.out));
        }
    }
    Ok(if outcome.finished { Ended::Passed } else { Ended::Failed })
}

/// Follows a recipe in a folder to its end, and shows how it goes.
fn learn(recipe: Recipe, out: &Path, resume: bool, interrupted: &Interrupted) -> anyhow::Result<TrainOutcome> {
    let epochs = recipe.epochs;
    let mut trainer = Trainer::new(recipe, out, resume)?;
    let (training, validation) = trainer.sizes();
    tracing::info!("{} for training, {validation} held out", count(training, "sample"));
    trainer.history().iter().for_each(|epoch| say(epoch, epochs));
    let bar = TrainBar::new();
    let mut speed = SampleRate::default();
    let outcome = trainer.run(&mut |progress| {
        match progress {
            Progress::Step { epoch, step, steps, samples, loss } => {
                bar.show(epoch, epochs, step, steps, speed.of(samples), loss);
            }
            Progress::Epoch(epoch) => bar.0.suspend(|| say(epoch, epochs)),
        }
        if interrupted.is_pressed() { Go::Stop } else { Go::On }
    });
    bar.0.finish_and_clear();
    Ok(outcome?)
}

fn say(TimedEpoch { epoch, images_per_s, .. }: &TimedEpoch, epochs: usize) {
    say!(
        "epoch {:>3}/{epochs}  train {}  validation {}  9-frame mean {}  {:.0} images/s{}",
        epoch.number,
        told(&epoch.training),
        told(&epoch.validation.raw),
        told(&epoch.validation.smooth),
        images_per_s,
        if epoch.best { "  best" } else { "" },
    );
}

fn told(metrics: &Metrics) -> String {
    let r = metrics.r.map_or_else(|| "-".to_owned(), |r| format!("{r:.3}"));
    format!("MSE {:.4} MAE {:.4} r {r}", metrics.mse, metrics.mae)
}

/// The recipe's file, then the flags.
fn recipe(arguments: &cli::Train) -> anyhow::Result<Recipe> {
    let left = arguments.out.join("recipe.toml");
    let read = |path: &Path| {
        let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
        Recipe::parse(&text).with_context(|| path.display().to_string())
    };
    let mut recipe = match &arguments.recipe {
        Some(path) => read(path)?,
        // Flags that are not given again keep their values.
        None if arguments.resume && left.exists() => read(&left)?,
        None if arguments.resume && arguments.data.is_empty() => anyhow::bail!(
            "{}: expected a training to resume, got none; start one with --data or --recipe",
            arguments.out.display()
        ),
        None => Recipe::default(),
    };
    if !arguments.data.is_empty() {
        recipe.data = arguments.data.iter().map(|text| selection(text)).collect::<Result<_, _>>()?;
        recipe.record.clear();
    }
    if !arguments.lane.is_empty() {
        let (lanes, data) = (arguments.lane.len(), recipe.data.len());
        if lanes != data {
            let why = format!("expected one file for each of {}, got {lanes}", count(data, "data set"));
            return Err(ConfigError::Value { layer: "--lane".into(), why }.into());
        }
        recipe.data.iter_mut().zip(&arguments.lane).for_each(|(data, lane)| data.lane = Some(lane.clone()));
    }
    if !arguments.validation.is_empty() {
        recipe.validation = arguments.validation.iter().map(Selection::of).collect();
    }
    for data in &mut recipe.data {
        set(&mut data.side_offset, arguments.side_offset);
        set(&mut data.smooth, arguments.smooth);
    }
    set(&mut recipe.network, arguments.network.clone());
    set_some(&mut recipe.input, arguments.input);
    recipe.speed_input |= arguments.speed_input;
    set_some(&mut recipe.pretrained, arguments.pretrained.clone());
    recipe.freeze_backbone |= arguments.freeze_backbone;
    set(&mut recipe.epochs, arguments.epochs);
    set(&mut recipe.batch, arguments.batch);
    set_some(&mut recipe.samples_per_epoch, arguments.samples_per_epoch);
    set_some(&mut recipe.validation_samples, arguments.validation_samples);
    set(&mut recipe.seed, arguments.seed);
    set(&mut recipe.optimiser.kind, arguments.optimiser);
    set(&mut recipe.optimiser.learning_rate, arguments.learning_rate);
    set(&mut recipe.optimiser.schedule, arguments.schedule);
    set(&mut recipe.optimiser.weight_decay, arguments.weight_decay);
    set_some(&mut recipe.optimiser.clip, arguments.clip);
    set_some(&mut recipe.patience, arguments.patience);
    set_some(&mut recipe.ema, arguments.ema);
    set(&mut recipe.precision, arguments.precision);
    set(&mut recipe.keep, arguments.keep);
    set(&mut recipe.balance.keep_zero, arguments.keep_zero);
    set(&mut recipe.balance.flatten, arguments.flatten);
    set(&mut recipe.balance.large_angles, arguments.large_angles);
    set(&mut recipe.cache_mib, arguments.cache_mib);
    if let Some(track) = &arguments.track {
        Track::open(track)?;
    }
    let Recipe { record, data, validation, closed_loop, .. } = &mut recipe;
    for data in data.iter_mut().chain(validation) {
        let recorded = record.iter().find(|recording| is_in(&data.path, &recording.out));
        match recorded {
            Some(recording) => data.track = own_road(&recording.track),
            None => set_some(&mut data.track, arguments.track.clone()),
        }
    }
    for along in closed_loop.iter_mut().flat_map(|closed_loop| &mut closed_loop.along) {
        set_some(&mut along.track, arguments.track.clone());
    }
    if let Some(names) = &arguments.augment {
        only(&mut recipe.augment, names)?;
    }
    if let Some(rounds) = arguments.closed_loop {
        recipe.closed_loop.get_or_insert_default().rounds = rounds;
    }
    if let Some(closed_loop) = recipe.closed_loop.take() {
        recipe.closed_loop = Some(closed_loop.with_drives_of(&recipe));
    }
    Ok(recipe)
}

fn set<T>(setting: &mut T, flag: Option<T>) {
    if let Some(value) = flag {
        *setting = value;
    }
}

fn set_some<T>(setting: &mut Option<T>, flag: Option<T>) {
    if flag.is_some() {
        *setting = flag;
    }
}

/// `DIR` or `DIR@WEIGHT`.
fn selection(text: &str) -> anyhow::Result<Selection> {
    match text.rsplit_once('@') {
        Some((path, weight)) if !Path::new(text).exists() => {
            let why = format!("expected a number after the @, got {weight:?}");
            let weight = weight.parse().map_err(|_| ConfigError::Value { layer: format!("--data {text}"), why })?;
            Ok(Selection { weight, ..Selection::of(path) })
        }
        _ => Ok(Selection::of(text)),
    }
}

fn wrong_augment(why: String) -> anyhow::Result<()> {
    Err(ConfigError::Value { layer: "--augment".into(), why }.into())
}

/// Switches off all changes but those named.
fn only(augmentation: &mut Augmentation, names: &[String]) -> anyhow::Result<()> {
    let all: Vec<&str> = names.iter().map(String::as_str).collect();
    let names: Vec<&str> = all.iter().copied().filter(|name| *name != "none").collect();
    if !names.is_empty() && names.len() < all.len() {
        return wrong_augment(format!("expected none alone, got {:?}", all.join(",")));
    }
    if let Some(unknown) = names.iter().find(|name| !Augmentation::NAMES.contains(name)) {
        return wrong_augment(format!("expected {} or none, got {unknown:?}", Augmentation::NAMES.join(", ")));
    }
    augmentation.late = 0.0;
    let defaults = &mut Augmentation::default();
    for name in Augmentation::NAMES {
        let probability = augmentation.probability(name).zip(defaults.probability(name));
        let Some((probability, default)) = probability else { continue };
        *probability = match names.contains(&name) {
            false => 0.0,
            true if *probability == 0.0 => *default,
            true => *probability,
        };
    }
    Ok(())
}

/// The file of a road of one's own; other roads are known by their names.
fn own_road(track: &str) -> Option<String> {
    track.ends_with(".toml").then(|| track.to_owned())
}

fn is_in(path: &Path, folder: &Path) -> bool {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    absolute(path).starts_with(absolute(folder))
}

/// Checks everything that a training needs except the data that it records itself, so that no hour of recording is
/// wasted.
fn check(recipe: &Recipe, out: &Path, resume: bool, config: Option<&Path>) -> anyhow::Result<()> {
    recipe.check()?;
    outputs::check_folder(out)?;
    recipe.closed_loop.as_ref().map_or(Ok(()), |closed_loop| rounds::check(closed_loop, config))?;
    let made: Vec<_> = recipe.record.iter().filter(|recording| !recording.out.exists()).collect();
    if made.is_empty() {
        return Ok(()); // the rest is checked when the training begins, which is at once
    }
    Trainer::check(recipe, out, resume)?;
    for data in recipe.data.iter().chain(&recipe.validation) {
        let is_made = |path: &Path| made.iter().any(|recording| is_in(path, &recording.out));
        if is_made(&data.path) {
            continue;
        }
        dataset::check(&data.path)?;
        if let Some(lane) = data.lane.as_ref().filter(|lane| !is_made(lane)) {
            LaneTable::of(&data.path, lane, |name| Track::called(name, data.track.as_deref()))?;
        }
    }
    for recording in made {
        let arguments = arguments(recording, &recording.out);
        Track::open(&recording.track)?;
        world::spec(&arguments.world, None).conditions()?;
        outputs::check_folder(&recording.out)?;
    }
    Ok(())
}

/// The arguments of `lapwing record` for a recording into that folder.
fn arguments(recording: &SimulatedData, out: &Path) -> cli::Record {
    let SimulatedData { track, laps, speed, seed, recovery, conditions, stances, .. } = recording.clone();
    let track = Some(track);
    let world = cli::WorldFlags { track, seed, conditions, scenario: None, hz: None, on_crash: None, max_time: None };
    cli::Record {
        world,
        laps: Some(laps),
        out: out.to_owned(),
        speed,
        recovery,
        stances,
        #[cfg(feature = "bridge")]
        page: cli::PageFlags::default(),
    }
}

/// Records simulated data unless it exists: completely, or nothing of it is kept.
fn make(recording: &SimulatedData, config: Option<&Path>, interrupted: &Interrupted) -> anyhow::Result<()> {
    let SimulatedData { out, track, laps, speed, .. } = recording;
    if out.exists() {
        return Ok(());
    }
    if let Some(stances) = recording.stances {
        let pictures = count(stances, "stance");
        tracing::info!("recording {}: {pictures} on {track}", out.display());
        return whole(out, |partial| {
            let (made, _) = record::stances(&arguments(recording, partial), stances, config, interrupted)?;
            if made < stances {
                bail!("interrupted while {} was recorded: nothing of it is kept", out.display());
            }
            Ok(())
        });
    }
    let laps = count(*laps, "lap");
    tracing::info!("recording {}: {laps} of {track} at {speed} mph", out.display());
    whole(out, |partial| {
        let (RecordReport { ending, laps: driven, .. }, _) =
            record::record(&arguments(recording, partial), config, interrupted)?;
        match ending {
            Ending::Interrupted => bail!("interrupted while {} was recorded: nothing of it is kept", out.display()),
            _ if driven < recording.laps => {
                bail!("{}: expected {laps}, got {driven}; the drive ended: {ending}", out.display())
            }
            _ => Ok(()),
        }
    })
}

/// Makes a folder under another name until it is whole: if that fails, nothing of it is kept.
fn whole<T>(out: &Path, make: impl FnOnce(&Path) -> anyhow::Result<T>) -> anyhow::Result<T> {
    let mut name = out.to_owned().into_os_string();
    name.push(".partial");
    let partial = Path::new(&name);
    let remove = || match fs::remove_dir_all(partial) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("{}: cannot be removed", partial.display()))
        }
        _ => Ok(()),
    };
    remove()?;
    let made = make(partial).and_then(|made| {
        fs::rename(partial, out).with_context(|| format!("{}: cannot be renamed", partial.display()))?;
        Ok(made)
    });
    if made.is_err() {
        remove()?;
    }
    made
}

/// Samples a second over the last few steps.
#[derive(Default)]
struct SampleRate(VecDeque<(Instant, usize)>);

impl SampleRate {
    fn of(&mut self, samples: usize) -> f64 {
        let now = Instant::now();
        self.0.push_back((now, samples));
        while self.0.len() > 2 && self.0.front().is_some_and(|(at, _)| now - *at > Duration::from_secs(10)) {
            self.0.pop_front();
        }
        let first = self.0.front().map_or(now, |(at, _)| *at);
        let count: usize = self.0.iter().skip(1).map(|(_, samples)| samples).sum();
        count as f64 / (now - first).as_secs_f64().max(1e-9)
    }
}

struct TrainBar(ProgressBar);

impl TrainBar {
    fn new() -> Self {
        let bar = if io::stderr().is_terminal() { ProgressBar::new(1) } else { ProgressBar::hidden() };
        let template = "{wide_bar} {pos}/{len} {msg}, {eta} left";
        bar.set_style(ProgressStyle::with_template(template).expect("the template is written here"));
        Self(bar)
    }

    /// The bar spans all epochs, so that the time left is that of the training.
    fn show(&self, epoch: usize, epochs: usize, step: usize, steps: usize, speed: f64, loss: f64) {
        self.0.set_length((steps * epochs) as u64);
        self.0.set_position(((epoch - 1) * steps + step) as u64);
        if !self.0.is_hidden() {
            self.0.set_message(format!("epoch {epoch}/{epochs}, loss {loss:.4}, {speed:.0} images/s"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_that_are_named_are_the_only_ones_and_those_of_a_recipe_keep_their_probability() {
        let recipe = Augmentation { flip: 0.3, shadow: 0.0, late: 0.4, ..Augmentation::default() };
        let kept = |names: &[&str]| {
            let mut augmentation = recipe.clone();
            only(&mut augmentation, &names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>()).unwrap();
            augmentation
        };
        let Augmentation { flip, translate, brightness, shadow, erase, late, .. } = kept(&["flip", "shadow"]);
        assert_eq!([flip, translate, brightness, shadow, erase, late], [0.3, 0.0, 0.0, 0.5, 0.0, 0.0]);
        let Augmentation { flip, translate, brightness, shadow, erase, late, .. } = kept(&["none"]);
        assert_eq!([flip, translate, brightness, shadow, erase, late], [0.0; 6]);
        let unknown = only(&mut recipe.clone(), &["flop".into()]).unwrap_err().to_string();
        assert_eq!(unknown, "--augment: expected flip, translate, brightness, shadow, erase or none, got \"flop\"");
        let both = only(&mut recipe.clone(), &["none".into(), "flip".into()]).unwrap_err().to_string();
        assert_eq!(both, "--augment: expected none alone, got \"none,flip\"");
    }
}
