//! Training in closed loop, with the whole program.

use std::{fs, path::Path, process::Command, sync::Arc, time::Instant};

use lapwing_core::{
    config::ControlSettings, driver::Driver, hash::sha256, recording::udacity::DrivingLogWriter, units::Mph,
};
use lapwing_learn::models;
use lapwing_sim::{
    camera::Scenery,
    record::{RecordOptions, RecordReport, record},
    track::Track,
    world::{Setup, Simulation},
};

/// A small network that learns from half a minute on the lake, drives there and along that recording, and learns again.
const RECIPE: &str = r#"
network = "cps"
epochs = 4
batch = 32
cache_mib = 256
[augment]
flip = 0.0
translate = 0.0
brightness = 0.0
shadow = 0.0
erase = 0.0
[[data]]
path = "lake"
lane = "lake/lane.csv"
[closed_loop]
rounds = 2
epochs = 4
learning_rate = 0.001
[[closed_loop.drive]]
track = "lake"
seconds = 20
[[closed_loop.drive]]
track = "lake"
seconds = 20
seed = 1
conditions = "latency_ms=100"
[[closed_loop.along]]
path = "lake"
lane = "lake/lane.csv"
rows = [0, 150]
"#;

fn lapwing(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(arguments)
        .current_dir(folder)
        .env("OMP_NUM_THREADS", "1")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    (output.status.code(), text)
}

/// A folder with a data set and the recipe.
fn prepared() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    // Cut off before a lap: 1, with the rows written.
    let (code, text) = lapwing(dir.path(), &["record", "--max-time", "30", "--out", "lake"]);
    assert_eq!(code, Some(1), "{text}");
    fs::write(dir.path().join("recipe.toml"), RECIPE).unwrap();
    dir
}

fn trained(folder: &Path, out: &str, more: &[&str]) -> String {
    let mut arguments = vec!["train", "--recipe", "recipe.toml", "--out", out];
    arguments.extend(more);
    let (code, text) = lapwing(folder, &arguments);
    assert_eq!(code, Some(0), "{text}");
    text
}

/// How a network does on a stretch of the lake on which it has not driven.
fn driven(model: &Path) -> RecordReport {
    let track = Arc::new(Track::named("lake").unwrap());
    let scenery = Arc::new(Scenery::new(&track));
    let setup = Setup { laps: None, longest_s: Some(20.0), seed: 77, ..Setup::new(track, scenery) };
    let mut world = Simulation::new(setup).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let log = DrivingLogWriter::create(dir.path(), jiff::civil::date(2026, 11, 23).at(8, 0, 0, 0)).unwrap();
    let model = models::load(model, Instant::now).unwrap();
    let mut driver = Driver::new(model.pilot(), &ControlSettings::default(), Instant::now);
    let options = RecordOptions {
        recovery: true,
        side_cameras: false,
        expert: 0.0,
        anywhere: true,
        ..RecordOptions::at(Mph::constant(20.0))
    };
    record(&mut world, &mut driver, log, options, |_| ()).unwrap()
}

fn weights(path: &Path) -> String {
    sha256(&fs::read(path).unwrap())
}

#[test]
fn a_network_that_learns_from_its_own_drives_does_better_than_one_that_learns_as_long_without_and_repeats_nothing() {
    let dir = prepared();
    let folder = dir.path();
    let told = trained(folder, "with", &[]);
    assert!(told.contains("with/round-2/model.safetensors"), "{told}");
    // As many steps and more without: the epochs of the training and of both rounds.
    trained(folder, "without", &["--closed-loop", "0", "--epochs", "20"]);
    let with = folder.join("with/round-2/model.safetensors");
    let (better, worse) = (driven(&with), driven(&folder.join("without/model.safetensors")));
    println!("with {better:?}\nwithout {worse:?}");
    assert!(better.disagreement.unwrap() < 0.8 * worse.disagreement.unwrap(), "{better:?} {worse:?}");
    assert!(better.put_back <= worse.put_back, "{better:?} {worse:?}");

    // Resumed, it has nothing left to do; without its last round, it drives and learns that again, the same way.
    let (first, last) = (weights(&folder.join("with/round-1/model.safetensors")), weights(&with));
    let lesson = |round: usize| folder.join(format!("with/round-{round}/drive-2/driving_log.csv"));
    let drove = fs::metadata(lesson(1)).unwrap().modified().unwrap();
    let rows = |path: &Path| {
        let numbers = |line: &str| line.split(',').skip(3).map(str::to_owned).collect::<Vec<_>>();
        fs::read_to_string(path).unwrap().lines().map(numbers).collect::<Vec<_>>()
    };
    let steered = rows(&lesson(2));
    fs::remove_dir_all(folder.join("with/round-2")).unwrap();
    let (code, text) = lapwing(folder, &["train", "--resume", "--out", "with"]);
    assert_eq!(code, Some(0), "{text}");
    assert_eq!(fs::metadata(lesson(1)).unwrap().modified().unwrap(), drove, "it is not driven again");
    assert_eq!(weights(&folder.join("with/round-1/model.safetensors")), first);
    assert_eq!(rows(&lesson(2)), steered, "the same seed, the same lesson");
    assert_eq!(weights(&with), last);
}

#[test]
fn what_the_rounds_lack_is_said_before_anything_is_trained() {
    let dir = prepared();
    let folder = dir.path();
    let said = |from: &str, to: &str| {
        fs::write(folder.join("wrong.toml"), RECIPE.replace(from, to)).unwrap();
        let (code, text) = lapwing(folder, &["train", "--recipe", "wrong.toml", "--out", "out"]);
        assert!(code != Some(0) && !folder.join("out").exists(), "{text}");
        text
    };
    let text = said("track = \"lake\"", "track = \"moon\"");
    assert!(text.contains("moon"), "{text}");
    let text = said("path = \"lake\"\nlane = \"lake/lane.csv\"\nrows", "path = \"lake\"\nlane = \"none.csv\"\nrows");
    assert!(text.contains("none.csv"), "{text}");
    let text = said("latency_ms=100", "latency=100");
    assert!(text.contains("latency"), "{text}");
}
