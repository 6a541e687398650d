//! What learning costs: the step alone on tensors in memory, the loader alone, and both as `lapwing train` has them.

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use divan::{Bencher, counter::ItemsCount};
use lapwing_learn::{
    dataset::Selection,
    nn::Precision,
    train::{Recipe, Trainer},
};

use super::jpeg;

const BATCH: usize = 64;
/// Batches of an epoch.
const STEPS: usize = 16;

/// Those worth measuring: without bf16 in the processor a sample takes half a minute.
fn precisions() -> &'static [&'static str] {
    if lapwing_learn::nn::runtime::knows_bf16() { &["f32", "bf16"] } else { &["f32"] }
}

/// A data set of the bench's picture, 40 for each step: after the first pass the cache holds them all.
fn folder(dir: &Path) {
    fs::create_dir(dir.join("IMG")).unwrap();
    let picture = jpeg();
    let mut log = String::new();
    for row in 0..40 * STEPS {
        fs::write(dir.join(format!("IMG/{row}.jpg")), &picture).unwrap();
        log += &format!("{row}.jpg,,,{},0.5,0,15\n", (row as f64 * 0.1).sin());
    }
    fs::write(dir.join("driving_log.csv"), log).unwrap();
}

pub(super) fn trainer(dir: &Path, precision: &str) -> Trainer {
    folder(dir);
    let precision = if precision == "bf16" { Precision::Bf16 } else { Precision::F32 };
    let recipe = Recipe {
        batch: BATCH,
        samples_per_epoch: Some(BATCH * STEPS),
        precision,
        data: vec![Selection::of(dir)],
        ..Recipe::default()
    };
    Trainer::new(recipe, &dir.join("out"), false).unwrap()
}

/// PilotNet's step on tensors that lie ready: what training could reach.
#[divan::bench(args = precisions(), sample_count = 5, sample_size = 1, min_time = Duration::from_secs(3))]
fn step_in_memory(bencher: Bencher, precision: &str) {
    let dir = tempfile::tempdir().unwrap();
    let mut trainer = trainer(dir.path(), precision);
    let batch = trainer.batches(0, 0).unwrap().next().unwrap().unwrap();
    let tensors = trainer.tensors(batch).unwrap();
    bencher.counter(ItemsCount::new(BATCH * STEPS)).bench_local(|| {
        for _ in 0..STEPS {
            trainer.learn(&tensors, 1e-3).unwrap();
        }
    });
}

/// The same step fed by the loader, all five augmentations on: what training reaches.
#[divan::bench(args = precisions(), sample_count = 5, sample_size = 1, min_time = Duration::from_secs(3))]
fn train(bencher: Bencher, precision: &str) {
    let dir = tempfile::tempdir().unwrap();
    let mut trainer = trainer(dir.path(), precision);
    let mut epoch = 0;
    bencher.counter(ItemsCount::new(BATCH * STEPS)).bench_local(|| {
        for batch in trainer.batches(epoch, 0).unwrap() {
            let tensors = trainer.tensors(batch.unwrap()).unwrap();
            trainer.learn(&tensors, 1e-3).unwrap();
        }
        epoch += 1;
    });
}

/// Both in turn, a pass each, for what slows a machine down for a while slows both: prints, of each pair of passes, how
/// many of the images that the step alone learns from training does, sorted.
#[divan::bench(args = precisions(), sample_count = 15, sample_size = 1)]
fn train_against_step(bencher: Bencher, precision: &str) {
    let dir = tempfile::tempdir().unwrap();
    let mut trainer = trainer(dir.path(), precision);
    let batch = trainer.batches(0, 0).unwrap().next().unwrap().unwrap();
    let ready = trainer.tensors(batch).unwrap();
    let mut epoch = 0;
    let mut shares = Vec::new();
    bencher.counter(ItemsCount::new(2 * BATCH * STEPS)).bench_local(|| {
        let began = Instant::now();
        for _ in 0..STEPS {
            trainer.learn(&ready, 1e-3).unwrap();
        }
        let step = began.elapsed();
        for batch in trainer.batches(epoch, 0).unwrap() {
            let tensors = trainer.tensors(batch.unwrap()).unwrap();
            trainer.learn(&tensors, 1e-3).unwrap();
        }
        shares.push(step.as_secs_f64() / (began.elapsed() - step).as_secs_f64());
        epoch += 1;
    });
    shares.remove(0); // the pass that fills the cache
    shares.sort_by(f64::total_cmp);
    eprintln!("{shares:.2?}");
}

/// The loader alone: decode, augment, preprocess, on all cores.
#[divan::bench(sample_count = 5, sample_size = 1, min_time = Duration::from_secs(3))]
fn load(bencher: Bencher) {
    let dir = tempfile::tempdir().unwrap();
    let trainer = trainer(dir.path(), "f32");
    let mut epoch = 0;
    bencher.counter(ItemsCount::new(BATCH * STEPS)).bench_local(|| {
        assert_eq!(trainer.batches(epoch, 0).unwrap().count(), STEPS);
        epoch += 1;
    });
}
