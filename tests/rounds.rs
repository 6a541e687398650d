//! Training in closed loop, with the whole program.

use std::{fs, path::Path, process::Command, sync::LazyLock};

use lapwing_core::hash::sha256;
use tempfile::{TempDir, tempdir};

use crate::support::ring;

/// A small network that learns from the expert's drive in the middle of the mountain road, as one camera saw it, drives
/// there and along that recording, and learns again.
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
path = "road"
lane = "road/lane.csv"
cameras = ["center"]
[closed_loop]
rounds = 2
epochs = 4
learning_rate = 0.001
[[closed_loop.drive]]
track = "mountain"
seconds = 15
conditions = "latency_ms=100"
[[closed_loop.along]]
path = "road"
lane = "road/lane.csv"
rows = [0, 110]
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

/// The data set, made once.
static DATA: LazyLock<TempDir> = LazyLock::new(|| {
    let dir = tempdir().unwrap();
    let (code, text) = lapwing(dir.path(), &["record", "--track", "mountain", "--max-time", "20", "--out", "road"]);
    assert_eq!(code, Some(0), "{text}");
    dir
});

/// A folder with the data set and the recipe.
fn prepared() -> TempDir {
    let dir = tempdir().unwrap();
    std::os::unix::fs::symlink(DATA.path().join("road"), dir.path().join("road")).unwrap();
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

fn weights(path: &Path) -> String {
    sha256(fs::read(path).unwrap())
}

#[test]
fn a_network_learns_from_its_own_drives_and_a_round_that_is_resumed_is_the_same() {
    let dir = prepared();
    let folder = dir.path();
    let told = trained(folder, "with", &[]);
    assert!(told.contains("with/final.safetensors"), "{told}");
    let with = folder.join("with/final.safetensors");
    assert_eq!(weights(&with), weights(&folder.join("with/round-2/model.safetensors")));
    let first_of_all = folder.join("with/model.safetensors");
    assert_ne!(weights(&with), weights(&first_of_all), "the rounds go on learning");

    // Resumed, it has nothing left to do; without its last round, it drives and learns that again, the same way.
    let (first, last) = (weights(&folder.join("with/round-1/model.safetensors")), weights(&with));
    let lesson = |round: usize| folder.join(format!("with/round-{round}/drive-1/driving_log.csv"));
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
    let text = said("track = \"mountain\"", "track = \"moon\"");
    assert!(text.contains("moon"), "{text}");
    let text = said("lane = \"road/lane.csv\"\nrows", "lane = \"none.csv\"\nrows");
    assert!(text.contains("none.csv"), "{text}");
    let text = said("latency_ms=100", "latency=100");
    assert!(text.contains("latency"), "{text}");
}

#[test]
fn on_a_road_of_ones_own_it_learns_and_a_drive_too_short_to_learn_from_is_named() {
    let dir = tempdir().unwrap();
    let folder = dir.path();
    fs::write(folder.join("ring.toml"), ring("my ring")).unwrap();
    let (code, text) = lapwing(folder, &["record", "--track", "ring.toml", "--max-time", "8", "--out", "road"]);
    assert_eq!(code, Some(0), "{text}");
    let train = "train --data road --lane road/lane.csv --network cps --augment flip --epochs 1 --batch 32 \
                 --samples-per-epoch 64 --validation-samples 32";
    let train: Vec<_> = train.split(' ').collect();
    let (code, text) = lapwing(folder, &[&train[..], &["--out", "unknown"]].concat());
    assert!(
        code != Some(0)
            && text.contains("if it is a road of your own, name its file with --track, or track in a recipe"),
        "{text}"
    );
    let (code, text) = lapwing(folder, &[&train[..], &["--track", "ring.toml", "--out", "known"]].concat());
    assert_eq!(code, Some(0), "{text}");

    // The roads of its drives are known.
    let drive = |seconds: u32| format!("[[closed_loop.drive]]\ntrack = \"ring.toml\"\nseconds = {seconds}\n");
    let recipe = |drives: &str| {
        let text = fs::read_to_string(folder.join("known/recipe.toml")).unwrap();
        fs::write(folder.join("recipe.toml"), format!("{text}[closed_loop]\nrounds = 1\nepochs = 1\n{drives}"))
            .unwrap();
    };
    recipe(&(drive(8) + &drive(2)));
    let text = trained(folder, "rounds", &[]);
    let short = "drive-2: nothing is learnt from it: expected a drive of at least 100 rows, got ";
    assert!(text.contains(short) && text.contains("rounds/final.safetensors"), "{text}");
    let learnt = fs::read_to_string(folder.join("rounds/round-1/recipe.toml")).unwrap();
    assert_eq!((learnt.matches("drive-1").count(), learnt.matches("drive-2").count()), (2, 0), "{learnt}");
    recipe(&drive(2));
    let (code, text) = lapwing(folder, &["train", "--recipe", "recipe.toml", "--out", "short"]);
    assert!(code == Some(1) && text.contains("closed_loop: no drive is long enough to learn from"), "{text}");
    assert!(!folder.join("short").exists(), "it is refused before the training");
}

#[test]
fn without_a_recipe_it_drives_along_the_data_whose_lane_is_given() {
    let dir = prepared();
    let folder = dir.path();
    let train = "train --data road --network cps --augment none --epochs 1 --batch 32 --samples-per-epoch 64 \
                 --validation-samples 32 --closed-loop 1 --out out";
    let train: Vec<_> = train.split(' ').collect();
    let (code, text) = lapwing(folder, &train);
    assert!(code != Some(0) && text.contains("give --lane") && !folder.join("out").exists(), "{text}");
    let (code, text) = lapwing(folder, &[&train[..], &["--lane", "road/lane.csv"]].concat());
    assert_eq!(code, Some(0), "{text}");
    assert!(folder.join("out/round-1/along-1/driving_log.csv").exists(), "{text}");
    assert!(text.contains("out/final.safetensors"), "{text}");
}
