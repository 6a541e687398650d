//! What Cargo cannot enforce: import directions within a crate, and what a crate stands on by way of others.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// Crate and module, and which of the crate's own modules it may import. What a crate may know of others is in its
/// `Cargo.toml`. Modules of `sim` know one another as the world they make up.
const MAY_IMPORT: [(&str, &[&str]); 48] = [
    ("core/car", &[]),
    ("core/hash", &[]),
    ("core/motion", &["car"]),
    ("core/units", &["car"]),
    ("core/files", &[]),
    ("core/words", &[]),
    ("core/stats", &[]),
    ("core/config", &["car", "units", "words"]),
    ("core/protocol", &["units"]),
    ("core/client", &["protocol", "units", "words"]),
    ("core/perception", &["units"]),
    ("core/pilot", &["car", "motion", "perception", "units", "words"]),
    ("core/control", &["car", "units"]),
    ("core/turn", &["control", "protocol", "units", "words"]),
    ("core/guard", &["control", "perception", "units"]),
    ("core/driver", &["units", "config", "protocol", "perception", "pilot", "control", "guard", "turn"]),
    ("core/recording", &["car", "files", "motion", "pilot", "units", "protocol", "turn", "words"]),
    ("core/drive", &["config", "driver", "hash", "pilot", "protocol", "recording", "turn", "units"]),
    ("core/replay", &["drive", "files", "perception", "protocol", "recording", "stats", "turn", "units", "words"]),
    ("score/odometry", &[]),
    ("score/score", &["odometry"]),
    ("score/judged", &["score"]),
    ("score/results", &["score"]),
    ("score/suite", &["judged", "score"]),
    ("score/drawing", &[]),
    ("score/emergency", &["drawing", "score"]),
    ("learn/nn", &[]),
    ("learn/braking", &["nn", "train"]),
    ("learn/models", &["nn"]),
    ("learn/dataset", &[]),
    ("learn/train", &["dataset", "nn"]),
    ("learn/marl", &["nn", "train"]),
    ("learn/evaluate", &["dataset", "models", "nn", "train"]),
    ("learn/explain", &["models", "nn"]),
    ("live/bridge", &["page", "viewers", "websocket"]),
    ("live/page", &["places", "websocket"]),
    ("live/places", &[]),
    ("live/viewers", &["page", "places", "websocket"]),
    ("live/websocket", &[]),
    ("lapwing/course", &[]),
    ("lapwing/doctor", &[]),
    ("lapwing/film", &[]),
    ("lapwing/real_time", &[]),
    ("lapwing/staged", &["real_time"]),
    ("lapwing/map", &[]),
    ("lapwing/known", &[]),
    ("lapwing/top_view", &[]),
    ("lapwing/locating", &["known"]),
];

/// Packages that bring libtorch, an async runtime or C++: `core`, `sim` and `score` are built without.
const HEAVY: [&str; 7] = ["tch", "torch-sys", "tokio", "axum", "openh264-sys2", "cxx", "link-cplusplus"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn sources(dir: &Path) -> Vec<PathBuf> {
    let mut files = vec![];
    for entry in fs::read_dir(dir).unwrap().map(|e| e.unwrap().path()) {
        if entry.is_dir() {
            files.extend(sources(&entry));
        } else if entry.extension().is_some_and(|e| e == "rs") {
            files.push(entry);
        }
    }
    files
}

/// (crate/path below src, text without comments)
fn code() -> Vec<(String, String)> {
    let without_comments =
        |text: String| text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    let crates = ["core", "sim", "score", "learn", "live"].map(|name| (name, root().join("crates").join(name)));
    let all = crates.into_iter().chain([("lapwing", root().to_owned())]).flat_map(|(name, folder)| {
        let src = folder.join("src");
        let named = move |path: PathBuf| {
            let below = path.strip_prefix(&src).unwrap().to_str().unwrap();
            (format!("{name}/{below}"), without_comments(fs::read_to_string(&path).unwrap()))
        };
        sources(&folder.join("src")).into_iter().map(named)
    });
    all.collect()
}

/// Modules named after `crate::` in a text, those in braces included.
fn imports(text: &str) -> BTreeSet<String> {
    let identifier = |s: &str| s.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut found = BTreeSet::new();
    for (at, word) in text.match_indices("crate::") {
        let rest = &text[at + word.len()..];
        let Some(group) = rest.strip_prefix('{') else {
            found.insert(identifier(rest));
            continue;
        };
        let (mut depth, mut start) = (0, true);
        for (i, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => start = true,
                c if start && depth == 0 && c.is_alphabetic() => {
                    found.insert(identifier(&group[i..]));
                    start = false;
                }
                _ => {}
            }
        }
    }
    found
}

#[test]
fn imports_are_read_in_all_their_forms() {
    let text = "use crate::units::Mph;\nuse crate::{config::{self, A}, pilot::Model};\nlet x = crate::nn::f();";
    assert_eq!(imports(text), ["config", "nn", "pilot", "units"].map(String::from).into());
}

#[test]
fn modules_import_only_what_the_map_allows() {
    let mut wrong = vec![];
    for (name, text) in code() {
        let (package, path) = name.split_once('/').unwrap();
        let module = path.split(['/', '.']).next().unwrap();
        if package == "sim" || matches!(module, "lib" | "main" | "allocator" | "cli" | "commands") {
            continue;
        }
        let Some((_, allowed)) = MAY_IMPORT.iter().find(|(known, _)| *known == format!("{package}/{module}")) else {
            wrong.push(format!("{name}: the module {module} is not in the map"));
            continue;
        };
        for import in imports(&text) {
            if import != module && !allowed.contains(&import.as_str()) {
                wrong.push(format!("{name} imports {import}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn every_module_is_in_the_docs_of_its_crate() {
    for (module, _) in MAY_IMPORT {
        let (package, module) = module.split_once('/').unwrap();
        let folder = if package == "lapwing" { root().to_owned() } else { root().join("crates").join(package) };
        let docs = fs::read_to_string(folder.join("src/lib.rs")).unwrap();
        assert!(docs.contains(&format!("mod {module};")), "{package} has no {module}");
        let in_docs = docs.lines().any(|line| line.starts_with("//!") && line.contains(&format!("[`{module}`]")));
        assert!(in_docs || package == "live", "{module} is not in the docs of {package}");
    }
}

#[test]
fn only_commands_know_errors_without_a_type() {
    let named = |(name, text): &(String, String)| text.contains("anyhow") && !name.starts_with("lapwing/commands");
    let wrong: Vec<_> = code().into_iter().filter(named).map(|(name, _)| name).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The lines of `cargo tree`, each package once.
fn cargo_tree(arguments: &[&str]) -> BTreeSet<String> {
    let mut tree = Command::new(env!("CARGO"));
    let tree = tree.args(["tree", "--offline", "--locked", "--prefix", "none"]).args(arguments);
    let out = tree.current_dir(root()).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap().lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect()
}

#[test]
fn the_simulator_and_the_scores_are_built_without_libtorch_async_and_cplusplus() {
    for package in ["lapwing-core", "lapwing-sim", "lapwing-score"] {
        let listed = cargo_tree(&["--edges", "normal,build", "--format", "{p}", "-p", package]);
        let names: BTreeSet<_> = listed.iter().filter_map(|line| line.split(' ').next()).collect();
        assert!(names.contains("serde"), "{listed:?}");
        assert_eq!(HEAVY.into_iter().filter(|heavy| names.contains(heavy)).collect::<Vec<_>>(), [""; 0], "{package}");
    }
}

/// Else `make drive` after `make test` compiles most of it once more, four minutes on two cores.
#[test]
fn the_program_and_the_tests_are_built_from_the_same_crates_with_the_same_features() {
    let program = cargo_tree(&["--edges", "normal,build", "--format", "{p} {f}", "-p", "lapwing"]);
    let tests = cargo_tree(&["--edges", "normal,build,dev", "--format", "{p} {f}", "--workspace"]);
    let others: Vec<_> = program.difference(&tests).collect();
    assert!(others.is_empty(), "a dependency of tests asks these for more features: {others:#?}");
}

#[test]
fn every_wheel_of_libtorch_is_pinned_on_every_platform() {
    let script = fs::read_to_string(root().join("scripts/libtorch.py")).unwrap();
    let wheels = script.matches("[\"manylinux").count() + script.matches("[\"macosx").count();
    let is_hash = |text: &&str| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
    assert_eq!((wheels, script.split('"').filter(is_hash).count()), (7, 7));
}
