//! The import directions of `lib.rs`'s map, read off the sources.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

/// What every module may import besides.
const UNDER_ALL: [&str; 2] = ["files", "words"];

/// Module, and what it may import.
const MAY_IMPORT: [(&str, &[&str]); 24] = [
    ("allocator", &[]),
    ("units", &[]),
    ("files", &[]),
    ("words", &[]),
    ("config", &["units"]),
    ("protocol", &["units"]),
    ("perception", &["units"]),
    ("nn", &["perception"]),
    ("pilot", &["perception", "nn", "units"]),
    ("control", &["units"]),
    ("driver", &["units", "config", "protocol", "perception", "nn", "pilot", "control"]),
    ("recording", &["units", "protocol"]),
    ("odometry", &["perception"]),
    ("score", &["config", "odometry", "perception", "protocol", "recording", "units"]),
    ("suite", &["score"]),
    ("drawing", &["perception"]),
    ("dataset", &["drawing", "perception", "protocol", "recording", "units"]),
    ("simulator", &["config", "drawing", "odometry", "perception", "pilot", "protocol", "recording", "units"]),
    ("drive", &["driver", "protocol", "recording", "score", "units"]),
    ("replay", &["recording", "driver", "perception", "protocol", "score", "simulator", "units"]),
    ("train", &["dataset", "nn", "perception"]),
    (
        "bridge",
        &[
            "drive",
            "driver",
            "recording",
            "config",
            "control",
            "odometry",
            "perception",
            "pilot",
            "protocol",
            "score",
            "units",
        ],
    ),
    ("cli", &["nn", "protocol", "replay", "suite", "train"]),
    (
        "commands",
        &[
            "bridge",
            "cli",
            "config",
            "control",
            "dataset",
            "drawing",
            "drive",
            "driver",
            "nn",
            "odometry",
            "perception",
            "pilot",
            "protocol",
            "recording",
            "replay",
            "score",
            "simulator",
            "suite",
            "train",
            "units",
        ],
    ),
];

/// Crates that are named in some places only.
const ONLY_IN: [(&str, &[&str]); 4] = [
    ("tch", &["nn", "pilot/network.rs", "pilot/torchscript", "train"]),
    ("axum", &["bridge"]),
    ("socketioxide", &["bridge"]),
    ("anyhow", &["commands"]),
];

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

/// (path below src, text without comments)
fn code() -> Vec<(String, String)> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let without_comments =
        |text: String| text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    sources(&src)
        .into_iter()
        .map(|p| {
            let name = p.strip_prefix(&src).unwrap().to_str().unwrap().to_owned();
            (name, without_comments(fs::read_to_string(&p).unwrap()))
        })
        .collect()
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
        let module = name.split(['/', '.']).next().unwrap();
        if matches!(module, "lib" | "main") {
            continue;
        }
        let Some((_, allowed)) = MAY_IMPORT.iter().find(|(m, _)| *m == module) else {
            wrong.push(format!("{name}: the module {module} is not in the map"));
            continue;
        };
        for import in imports(&text) {
            let known = import == module || allowed.contains(&import.as_str());
            if !known && !UNDER_ALL.contains(&import.as_str()) {
                wrong.push(format!("{name} imports {import}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn every_module_of_the_map_is_there_and_in_the_crates_docs() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let docs = fs::read_to_string(src.join("lib.rs")).unwrap();
    for (module, _) in MAY_IMPORT {
        assert!(src.join(format!("{module}.rs")).exists() || src.join(module).join("mod.rs").exists(), "{module}");
        assert!(docs.contains(&format!("[`{module}`]")), "{module} is not in lib.rs's map");
    }
}

#[test]
fn some_crates_are_named_in_their_rooms_only() {
    let mut wrong = vec![];
    for (name, text) in code() {
        for (dependency, rooms) in ONLY_IN {
            // A longer name that ends alike is another crate (`tch::` in `switch::`).
            let named = text
                .match_indices(&format!("{dependency}::"))
                .any(|(at, _)| !text[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_'));
            if named && !rooms.iter().any(|room| name.starts_with(room)) {
                wrong.push(format!("{name} names {dependency}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn every_wheel_of_libtorch_is_pinned_on_every_platform() {
    let script = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/libtorch.py")).unwrap();
    let wheels = script.matches("[\"manylinux").count() + script.matches("[\"macosx").count();
    let is_hash = |text: &&str| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
    assert_eq!((wheels, script.split('"').filter(is_hash).count()), (7, 7));
}
