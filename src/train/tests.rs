//! Small trainings, whole.

use std::{fs, path::Path};

use super::*;
use crate::{
    dataset::{Augmentation, DatasetError, Selection},
    nn::Checkpoint,
};

/// A drive of `rows` rows: a bright bar stands as far to the side as is steered.
fn folder(dir: &Path, rows: usize, steering: impl Fn(usize) -> f64) {
    fs::create_dir(dir.join("IMG")).unwrap();
    let mut log = String::new();
    for row in 0..rows {
        let steering = steering(row);
        let bar = 160.0 + steering * 120.0;
        let pixel = |x: u32| if (f64::from(x) - bar).abs() < 20.0 { [230u8, 220, 200] } else { [60, 70, 80] };
        let pixels: Vec<u8> = (0..160).flat_map(|_| (0..320).flat_map(pixel)).collect();
        let mut jpeg = vec![];
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 75)
            .encode(&pixels, 320, 160, image::ExtendedColorType::Rgb8)
            .unwrap();
        fs::write(dir.join(format!("IMG/{row}.jpg")), jpeg).unwrap();
        log += &format!("{row}.jpg,,,{steering},0.5,0,15\n");
    }
    fs::write(dir.join("driving_log.csv"), log).unwrap();
}

fn swaying(row: usize) -> f64 {
    (row as f64 * 0.7).sin()
}

fn recipe(data: &Path) -> Recipe {
    Recipe {
        epochs: 3,
        batch: 8,
        seed: 5,
        ema: Some(0.9),
        blocks: crate::dataset::Blocks { size: 5, every: 4 },
        augment: Augmentation { flip: 0.5, ..Augmentation::none() },
        data: vec![Selection::of(data)],
        ..Recipe::default()
    }
}

fn on(_: Progress<'_>) -> Go {
    Go::On
}

#[test]
fn a_network_learns_where_a_bar_stands_and_its_checkpoint_says_how() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 60, swaying);
    let out = dir.path().join("out");
    let mut trainer = Trainer::new(Recipe { epochs: 8, ..recipe(dir.path()) }, &out, false).unwrap();
    assert_eq!(trainer.sizes(), (45, 15));
    let outcome = trainer.run(&mut on).unwrap();
    assert!(outcome.finished);
    let history = trainer.history();
    assert_eq!(history.len(), 8);
    let (first, last) = (history[0].validation.raw, outcome.kept.unwrap().validation.raw);
    assert!(last.mse < first.mse / 4.0 && last.r.unwrap() > 0.9, "{first:?} {last:?}");

    let checkpoint = Checkpoint::load(&outcome.model).unwrap();
    assert_eq!(checkpoint.sha256, outcome.sha256);
    assert_eq!(serde_json::from_str::<Recipe>(&checkpoint.metadata.training).unwrap().seed, 5);
    let said: Epoch = serde_json::from_str(&checkpoint.metadata.result).unwrap();
    assert!(said.best);
    // What was measured in training is what the file answers.
    let samples = crate::dataset::Samples::open(
        &recipe(dir.path()).data,
        crate::dataset::Set::Validation,
        Some(recipe(dir.path()).blocks),
        &crate::dataset::Balance::default(),
    );
    let samples = std::sync::Arc::new(samples.unwrap());
    let cache = crate::dataset::Cache::new(&samples, 0);
    let inputs = crate::dataset::Inputs::plain(checkpoint.metadata.preprocess.clone(), 1);
    let (measured, answers) = measure(&checkpoint.network, &samples, &cache, &inputs).unwrap();
    assert_eq!(answers.len(), 15);
    assert!((measured.raw.mse - said.validation.raw.mse).abs() < 1e-6, "{measured:?} {said:?}");
    assert_eq!(fs::read_to_string(out.join("log.csv")).unwrap().lines().count(), 9);
}

#[test]
fn a_training_that_was_stopped_goes_on_as_if_it_had_not_been() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let (whole, parts) = (dir.path().join("whole"), dir.path().join("parts"));
    let with_cosine = || {
        let mut recipe = recipe(dir.path());
        recipe.optimiser.schedule = Schedule::Cosine;
        recipe
    };
    // Both begin with the same weights; libtorch's dice are everybody's, and other tests roll them, too.
    Trainer::new(with_cosine(), &whole, false).unwrap().run(&mut |_| Go::Stop).unwrap();
    fs::create_dir(&parts).unwrap();
    fs::copy(whole.join("state.safetensors"), parts.join("state.safetensors")).unwrap();
    let outcome = Trainer::new(with_cosine(), &whole, true).unwrap().run(&mut on).unwrap();
    let mut steps = 0;
    let stopped = Trainer::new(with_cosine(), &parts, true)
        .unwrap()
        .run(&mut |progress| {
            steps += u32::from(matches!(progress, Progress::Step { .. }));
            if steps == 6 { Go::Stop } else { Go::On } // in the middle of the second epoch
        })
        .unwrap();
    assert!(!stopped.finished);
    let again = Trainer::new(with_cosine(), &parts, true).unwrap().run(&mut on).unwrap();
    assert!(again.finished);
    let weights = |path: &Path| {
        let network = Checkpoint::load(path).unwrap().network;
        network.tensors().into_iter().map(|(_, t)| Vec::<f32>::try_from(t.flatten(0, -1)).unwrap()).collect::<Vec<_>>()
    };
    assert!(weights(&outcome.model) == weights(&again.model), "not the same to the last bit");
}

#[test]
fn stopped_in_its_first_epoch_it_leaves_a_network_that_answers() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let out = dir.path().join("out");
    let outcome = Trainer::new(recipe(dir.path()), &out, false).unwrap().run(&mut |_| Go::Stop).unwrap();
    assert!(!outcome.finished && outcome.kept.is_none());
    Checkpoint::load(&outcome.model).unwrap();
    let error = Trainer::new(recipe(dir.path()), &out, false).unwrap_err().to_string();
    assert!(error.contains("--resume"), "{error}");
}

#[test]
fn patience_ends_a_training_that_gets_no_better() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let mut still = Recipe { epochs: 50, patience: Some(2), ema: None, ..recipe(dir.path()) };
    still.optimiser.learning_rate = 1e-30;
    let mut trainer = Trainer::new(still, &dir.path().join("out"), false).unwrap();
    assert!(trainer.run(&mut on).unwrap().finished);
    assert_eq!(trainer.history().len(), 3);
}

#[test]
fn a_loss_that_is_no_number_is_told_with_the_step_and_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let mut wild = Recipe { epochs: 20, ..recipe(dir.path()) };
    wild.optimiser.kind = OptimiserKind::Sgd;
    wild.optimiser.learning_rate = 100.0;
    let error = Trainer::new(wild, &dir.path().join("out"), false).unwrap().run(&mut on).unwrap_err();
    assert!(matches!(error, TrainError::NotFinite { rate: 100.0, .. }), "{error}");
    assert!(error.to_string().contains("optimiser.clip"), "{error}");
}

#[test]
fn labels_that_steer_to_one_side_are_refused_unless_pictures_are_mirrored() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, |row| 0.1 + 0.001 * row as f64);
    let one_sided = Recipe { augment: Augmentation::none(), ..recipe(dir.path()) };
    let error = Trainer::new(one_sided, &dir.path().join("out"), false).unwrap_err();
    assert!(matches!(error, TrainError::OneSided { rows: 30, .. }), "{error}");
    Trainer::new(recipe(dir.path()), &dir.path().join("mirrored"), false).unwrap();
    let straight = tempfile::tempdir().unwrap();
    folder(straight.path(), 40, |_| 0.0);
    let error = Trainer::new(recipe(straight.path()), &dir.path().join("straight"), false).unwrap_err();
    assert!(matches!(error, TrainError::OneSided { .. }), "{error}");
}

#[test]
fn data_that_is_not_there_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let error = Trainer::new(recipe(&dir.path().join("nowhere")), &dir.path().join("out"), false).unwrap_err();
    assert!(matches!(&error, TrainError::Dataset(DatasetError::Recording(_))), "{error}");
    assert!(error.to_string().contains("nowhere"), "{error}");
    assert!(!dir.path().join("out").exists(), "nothing is left of a training that did not begin");
}
