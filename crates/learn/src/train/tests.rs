//! Small trainings, from start to end.

use std::{fs, path::Path};

use super::*;
use crate::{
    dataset::{Augmentation, DatasetError, Selection},
    nn::Checkpoint,
};
use lapwing_core::perception::{Frame, Preprocessor, decode_jpeg};

/// A drive of `rows` rows: a bright bar is as far to the side as the steering.
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

/// The recipe of a network that locates, and the table of a drive of `rows` rows whose car is the farther left the farther
/// right the bar stands, and faces to the right there.
fn locating(dir: &Path, rows: usize) -> Recipe {
    let mut table = String::from("moment,at_s,track,reversed,place_m,offset_m,heading_deg\n");
    for row in 0..rows {
        let right = swaying(row);
        table += &format!("{row},{},lake,false,{},{},{}\n", 0.067 * row as f64, 300 + row, -1.5 * right, 6.0 * right);
    }
    let lane = dir.join("lane.csv");
    fs::write(&lane, table).unwrap();
    let data = vec![Selection { lane: Some(lane), ..Selection::of(dir) }];
    Recipe { network: "lane".into(), data, augment: Augmentation::none(), ..recipe(dir) }
}

#[test]
fn a_network_learns_where_in_its_lane_the_car_is_to_the_left_or_to_the_right_and_how_sure_that_is() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 60, swaying);
    let recipe = Recipe { epochs: 12, ..locating(dir.path(), 60) };
    let mut trainer = Trainer::new(recipe, &dir.path().join("out"), false).unwrap();
    let outcome = trainer.run(&mut on).unwrap();
    let kept = outcome.kept.unwrap().validation.raw;
    assert!(kept.r.unwrap() > 0.9, "{kept:?}");

    let checkpoint = Checkpoint::load(&outcome.model).unwrap();
    let mut eye = Preprocessor::new(checkpoint.metadata.preprocess.clone()).unwrap();
    let mut look = |row: usize| {
        let (mut frame, mut input) = (Frame::default(), vec![]);
        decode_jpeg(&fs::read(dir.path().join(format!("IMG/{row}.jpg"))).unwrap(), &mut frame).unwrap();
        eye.apply(&frame, &mut input).unwrap();
        let input = tch::Tensor::from_slice(&input).view([1, 3, 44, 160]);
        let answer = checkpoint.network.forward(&input, None, false).unwrap().view([-1]);
        Vec::<f64>::try_from(answer.to_kind(tch::Kind::Double)).unwrap()
    };
    // The bar is right at row 2, and left at row 5: the car is on the other side.
    let (right, left) = (look(2), look(5));
    assert!(swaying(2) > 0.9 && swaying(5) < -0.3);
    assert!(right[0] < -0.8 && right[1] > 2.0, "{right:?}");
    assert!(left[0] > 0.2 && left[1] < -0.5, "{left:?}");
    for [offset_log, heading_log] in [[right[2], right[3]], [left[2], left[3]]] {
        let (offset_sd_m, heading_sd_deg) = ((offset_log / 2.0).exp(), (heading_log / 2.0).exp());
        assert!(offset_sd_m > 0.005 && offset_sd_m < 1.0 && heading_sd_deg < 5.0, "{right:?} {left:?}");
    }
}

#[test]
fn a_network_that_locates_wants_places_and_pictures_that_stay_where_they_are() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 20, swaying);
    let recipe = locating(dir.path(), 20);
    let error = |recipe: Recipe| Trainer::new(recipe, &dir.path().join("out"), false).unwrap_err().to_string();
    let flipped = Recipe { augment: Augmentation { flip: 0.5, ..Augmentation::none() }, ..recipe.clone() };
    assert!(error(flipped).starts_with("augment.flip: expected 0 for a network that locates the lane"));
    let shifted = Recipe { augment: Augmentation { translate: 0.5, ..Augmentation::none() }, ..recipe.clone() };
    assert!(error(shifted).starts_with("augment.translate: expected 0"));
    let placeless = Recipe { data: vec![Selection::of(dir.path())], ..recipe };
    assert!(error(placeless).starts_with("lane: expected the table of places of each data set"));
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
    let (first, last) = (history[0].epoch.validation.raw, outcome.kept.unwrap().validation.raw);
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
    // Both begin with the same weights; libtorch's random generator is global, and other tests use it, too.
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
    let refused = |name: &str| {
        let error = Trainer::new(recipe(straight.path()), &dir.path().join(name), false).unwrap_err();
        assert!(matches!(error, TrainError::OneSided { .. }), "{error}");
    };
    refused("straight");
    // The offset of side cameras is nobody's steering.
    let log: String = (0..40).map(|row| format!("{row}.jpg,{row}.jpg,{row}.jpg,0,0.5,0,15\n")).collect();
    fs::write(straight.path().join("driving_log.csv"), log).unwrap();
    refused("three cameras");
}

#[test]
fn data_that_is_not_there_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let error = Trainer::new(recipe(&dir.path().join("nowhere")), &dir.path().join("out"), false).unwrap_err();
    assert!(matches!(&error, TrainError::Dataset(DatasetError::Recording(_))), "{error}");
    assert!(error.to_string().contains("nowhere"), "{error}");
    assert!(!dir.path().join("out").exists(), "nothing is left of a training that did not begin");
}

/// Trains for this many steps and stops; 4 steps are an epoch of [`recipe`] on 40 rows.
fn stopped(recipe: Recipe, out: &Path, resume: bool, after: u32) -> TrainOutcome {
    let mut steps = 0;
    let mut watch = |progress: Progress<'_>| {
        steps += u32::from(matches!(progress, Progress::Step { .. }));
        if steps == after { Go::Stop } else { Go::On }
    };
    Trainer::new(recipe, out, resume).unwrap().run(&mut watch).unwrap()
}

#[test]
fn a_pass_whose_results_could_not_be_written_is_told_as_it_was_when_they_can() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let [out, whole] = ["out", "whole"].map(|name| dir.path().join(name));
    let two = || {
        let mut two = Recipe { epochs: 2, ..recipe(dir.path()) };
        two.optimiser.schedule = Schedule::Cosine;
        two
    };
    // Both begin with the same weights; libtorch's random generator is global, and other tests use it, too.
    stopped(two(), &whole, false, 1);
    fs::create_dir(&out).unwrap();
    fs::copy(whole.join("state.safetensors"), out.join("state.safetensors")).unwrap();
    stopped(two(), &whole, true, u32::MAX);
    // As if the disk were full once the state has been saved.
    fs::create_dir(out.join("log.csv")).unwrap();
    Trainer::new(two(), &out, true).unwrap().run(&mut |_| Go::On).unwrap_err();
    fs::remove_dir(out.join("log.csv")).unwrap();
    stopped(two(), &out, true, u32::MAX);
    // But for the time and what depends on it.
    let told = |out: &Path| {
        let log = fs::read_to_string(out.join("log.csv")).unwrap();
        let lines = log.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        let lines: Vec<_> = lines.collect();
        let timed = |name: &str| name.contains("seconds") || name.contains("images");
        let kept: Vec<usize> = (0..lines[0].len()).filter(|i| !timed(&lines[0][*i])).collect();
        lines.iter().map(|line| kept.iter().map(|i| line[*i].clone()).collect::<Vec<_>>()).collect::<Vec<_>>()
    };
    assert_eq!(told(&out), told(&whole));
    assert!(told(&out)[0].len() >= 6, "{:?}", told(&out)[0]);
}

#[test]
fn a_training_goes_on_by_its_own_recipe_and_on_its_own_data_only() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let out = dir.path().join("out");
    stopped(recipe(dir.path()), &out, false, 4);
    let refused = |change: fn(&mut Recipe)| {
        let mut other = recipe(dir.path());
        change(&mut other);
        Trainer::new(other, &out, true).unwrap_err().to_string()
    };
    for (change, named) in [
        ((|r| r.batch = 9) as fn(&mut Recipe), "batch: expected 8, got 9"),
        (|r| r.network = "cps".into(), "network: expected \"pilotnet\", got \"cps\""),
        (|r| r.optimiser.kind = OptimiserKind::Sgd, "optimiser.kind: expected \"adam\", got \"sgd\""),
        (|r| r.optimiser.schedule = Schedule::Plateau, "optimiser.schedule: expected \"constant\", got \"plateau\""),
        (|r| r.data[0].smooth = 3, "data[0].smooth: expected 1, got 3"),
        (|r| r.ema = None, "ema: expected 0.9, got none"),
        (|r| r.keep = Keep::Last, "keep: expected \"best\", got \"last\""),
    ] {
        let error = refused(change);
        assert!(error.contains(&format!("already holds a training with another recipe: {named}: ")), "{error}");
    }
    let more = Recipe { epochs: 4, cache_mib: 1, ..recipe(dir.path()) };
    Trainer::new(more, &out, true).unwrap();
    stopped(recipe(dir.path()), &out, true, u32::MAX);
    let error = refused(|r| r.epochs = 1);
    assert_eq!(error, "epochs: expected at least as many as are done, got 1, and 3 are done");
    let log = fs::read_to_string(dir.path().join("driving_log.csv")).unwrap();
    fs::write(dir.path().join("driving_log.csv"), log.replacen("0.jpg,,,0,", "0.jpg,,,0.01,", 1)).unwrap();
    let error = refused(|_| ());
    assert!(error.contains("expected 30 and 10 held out, got as many with other labels"), "{error}");
    fs::write(dir.path().join("driving_log.csv"), log.lines().take(39).collect::<Vec<_>>().join("\n")).unwrap();
    let error = refused(|_| ());
    assert!(error.contains("expected 30 and 10 held out, got 29 and 10 held out: undo"), "{error}");
}

#[test]
fn to_go_on_where_nothing_is_is_to_begin_and_a_lonely_checkpoint_stays() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let out = dir.path().join("out");
    assert_eq!(Trainer::new(recipe(dir.path()), &out, true).unwrap().history().len(), 0);
    fs::write(out.join("model.safetensors"), "precious").unwrap();
    for resume in [false, true] {
        let error = Trainer::new(recipe(dir.path()), &out, resume).unwrap_err().to_string();
        assert!(error.contains("model.safetensors exists, but without a resume state"), "{error}");
    }
    assert_eq!(fs::read(out.join("model.safetensors")).unwrap(), b"precious");
}

#[test]
fn a_training_with_pauses_leaves_what_one_without_leaves() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let (whole, parts) = (dir.path().join("whole"), dir.path().join("parts"));
    stopped(recipe(dir.path()), &whole, false, 1);
    fs::create_dir(&parts).unwrap();
    fs::copy(whole.join("state.safetensors"), parts.join("state.safetensors")).unwrap();
    let at_once = stopped(recipe(dir.path()), &whole, true, 0);
    for _ in 0..2 {
        let paused = stopped(recipe(dir.path()), &parts, true, 4);
        // The checkpoint is that of a complete epoch, whatever was begun after it.
        let model = fs::read(&paused.model).unwrap();
        assert_eq!(paused.kept, state::epoch_of(&model));
    }
    let last = stopped(recipe(dir.path()), &parts, true, 0);
    assert!(last.finished && at_once.finished);
    assert_eq!(last.sha256, at_once.sha256, "{:?} {:?}", last.kept, at_once.kept);
    let numbers = |out: &Path| {
        let log = fs::read_to_string(out.join("log.csv")).unwrap();
        log.lines().map(|line| line.split(',').next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(numbers(&parts), ["epoch", "1", "2", "3"]);
    assert_eq!(numbers(&whole), numbers(&parts));
    // Run once more, a finished training reports its result and leaves its folder as it is.
    let files = || fs::read_dir(&parts).unwrap().count();
    let before = files();
    assert_eq!(stopped(recipe(dir.path()), &parts, true, 0), last);
    assert_eq!(files(), before);
}

#[test]
fn an_epoch_that_is_repeated_after_a_kill_stands_once_on_the_curves() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let out = dir.path().join("out");
    stopped(recipe(dir.path()), &out, false, 4);
    let state = fs::read(out.join("state.safetensors")).unwrap();
    stopped(recipe(dir.path()), &out, true, 0);
    // As if it had been killed before it saved what it had written.
    fs::write(out.join("state.safetensors"), state).unwrap();
    stopped(recipe(dir.path()), &out, true, 0);
    assert_eq!(events::tests::steps_shown(&out, "mse/training"), [1, 2, 3]);
}

#[test]
fn a_validation_error_that_is_no_number_ends_the_training_and_is_not_kept() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let out = dir.path().join("out");
    // One step per epoch: the loss of the second is still a number, but the weights after it are not.
    let mut wild = Recipe { batch: 64, ema: None, ..recipe(dir.path()) };
    wild.optimiser.kind = OptimiserKind::Sgd;
    wild.optimiser.learning_rate = 100.0;
    wild.optimiser.weight_decay = 1.0;
    let mut trainer = Trainer::new(wild, &out, false).unwrap();
    let TrainError::Validation { epoch, mse } = trainer.run(&mut on).unwrap_err() else { panic!() };
    assert!(!mse.is_finite() && trainer.history().len() == epoch - 1);
    let model = fs::read(out.join("model.safetensors")).unwrap();
    let last = trainer.history().last().map(|timed| &timed.epoch);
    assert_eq!(state::epoch_of(&model).as_ref(), last, "the last whole epoch is kept");
}

#[test]
fn what_cannot_be_written_is_an_error_that_leaves_what_was() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let out = dir.path().join("out");
    stopped(recipe(dir.path()), &out, false, 4);
    let state = fs::read(out.join("state.safetensors")).unwrap();
    let mut trainer = Trainer::new(recipe(dir.path()), &out, true).unwrap();
    let away = dir.path().join("away");
    fs::rename(&out, &away).unwrap();
    let error = trainer.run(&mut on).unwrap_err();
    assert!(matches!(error, TrainError::Io { doing: "write the training's state", .. }), "{error}");
    fs::rename(&away, &out).unwrap();
    assert!(fs::read(out.join("state.safetensors")).unwrap() == state);
    if cfg!(unix) {
        let beside = Trainer::new(recipe(dir.path()), &out, true).map(drop).unwrap_err().to_string();
        assert!(beside.contains("another lapwing is writing into this folder"), "{beside}");
    }
    drop(trainer);
    assert!(Trainer::new(recipe(dir.path()), &out, true).unwrap().run(&mut on).unwrap().finished);
    // A file where the folder would be.
    let error = Trainer::new(recipe(dir.path()), &dir.path().join("driving_log.csv"), false).unwrap_err();
    assert!(matches!(error, TrainError::Io { .. }), "{error}");
}

#[test]
fn what_is_measured_by_is_not_learnt_from() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let of = |rows| Selection { rows: Some(rows), ..Selection::of(dir.path()) };
    let open = |data, validation: Selection| {
        let recipe = Recipe { data: vec![data], validation: vec![validation], ..recipe(dir.path()) };
        let out = tempfile::tempdir().unwrap();
        Trainer::new(recipe, out.path(), false).map(|trainer| trainer.sizes())
    };
    // No blocks are held out of the data beside it.
    assert_eq!(open(of((0, 30)), of((30, 40))).unwrap(), (30, 10));
    let error = open(of((0, 30)), Selection::of(dir.path().join("."))).unwrap_err().to_string();
    assert!(error.starts_with("validation: expected rows that are not in the training data, got "), "{error}");
}

fn resnet(data: &Path) -> Recipe {
    Recipe { network: "resnet18".into(), input: Some((33, 64)), ema: None, epochs: 1, ..recipe(data) }
}

#[test]
fn batch_norm_never_goes_by_a_single_sample() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let sizes = |recipe: Recipe| {
        let trainer = Trainer::new(recipe, &dir.path().join("out"), false).unwrap();
        trainer.batches(0, 0).unwrap().map(|batch| batch.unwrap().size).collect::<Vec<_>>()
    };
    // 30 samples.
    assert_eq!(sizes(Recipe { batch: 29, ..resnet(dir.path()) }), [29]);
    assert_eq!(sizes(Recipe { batch: 28, ..resnet(dir.path()) }), [28, 2]);
    assert_eq!(sizes(Recipe { batch: 29, ..recipe(dir.path()) }), [29, 1], "PilotNet has none");
    let one = Recipe { batch: 1, ..resnet(dir.path()) };
    let error = Trainer::new(one, &dir.path().join("one"), false).unwrap_err().to_string();
    assert!(error.starts_with("batch: expected at least 2 samples"), "{error}");
}

#[test]
fn with_a_frozen_backbone_only_what_is_behind_it_learns() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 20, swaying);
    let first = stopped(resnet(dir.path()), &dir.path().join("first"), false, 0);
    let frozen = Recipe {
        network: "resnet18-gru".into(),
        pretrained: Some(first.model.clone()),
        freeze_backbone: true,
        ema: Some(0.5),
        ..resnet(dir.path())
    };
    let second = stopped(frozen, &dir.path().join("second"), false, 0);
    let [first, second] = [first, second].map(|outcome| Checkpoint::load(outcome.model).unwrap().network.tensors());
    let mut moved = 0;
    for (name, now) in second {
        let Some((_, before)) = first.iter().find(|(other, _)| *other == name) else { continue };
        let behind = name.starts_with("head.");
        assert_eq!(now.equal(before), !behind, "{name}");
        moved += u32::from(behind);
    }
    assert_eq!(moved, 6);
    let without = Recipe {
        pretrained: Some(dir.path().join("first/model.safetensors")),
        freeze_backbone: true,
        ..recipe(dir.path())
    };
    assert!(Trainer::new(without, &dir.path().join("third"), false).is_err(), "PilotNet has no backbone");
}

#[test]
fn a_batch_that_no_memory_holds_is_told_before_it_is_tried() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 40, swaying);
    let huge =
        Recipe { network: "resnet18-stack".into(), input: Some((4096, 4096)), batch: 65_536, ..recipe(dir.path()) };
    let error = Trainer::new(huge, &dir.path().join("out"), false).unwrap_err();
    assert!(matches!(error, TrainError::Memory { batch: 65_536, .. }), "{error}");
    let error = TrainError::from(tch::TchError::Torch("DefaultCPUAllocator: can't allocate memory".into()));
    assert!(matches!(error.at_batch(7), TrainError::Memory { batch: 7, .. }));
}
