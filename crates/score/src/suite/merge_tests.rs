use std::{fs, path::PathBuf};

use serde_json::{Value, json};

use super::*;
use crate::suite::{Suite, render};

const SUITE: &str = r#"
tracks = ["lake"]
conditions = ["fair", "latency_ms=100", "noise=4", "random"]
seeds = 3

[[pilot]]
name = "network"

[[pilot]]
name = "expert"
expert = true
"#;

fn left_to_chance(cell: &Cell) -> bool {
    matches!(cell.conditions.as_str(), "noise=4" | "random")
}

/// Twelve: two pilots under four conditions, and two of the network's under two more seeds.
fn cells() -> Vec<Cell> {
    let cells = Suite::parse(SUITE).unwrap().cells(|pilot| (!pilot.expert).then(|| "00ff".to_owned()));
    told_apart(cells, |cell| cell, left_to_chance)
}

/// Folders of parts, and of what is merged from them.
struct Folders(tempfile::TempDir);

impl Folders {
    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// A part that has driven these.
    fn part(&self, name: &str, cells: &[Cell], plan: Option<&Plan>) -> Results {
        let results = Results::open(&self.path(name)).unwrap();
        plan.iter().for_each(|plan| results.keep_plan(plan).unwrap());
        for cell in cells {
            let card = json!({"completion": 1.0, "time_s": 10.0});
            results.keep(&Done::new(cell.clone(), card, cell.id(), 1.5)).unwrap();
        }
        results
    }

    /// Whether the merge is whole, and its outcome.
    fn merge(&self, parts: &[&str], out: &str) -> (bool, Value) {
        let folders: Vec<_> = parts.iter().map(|part| self.path(part)).collect();
        let merged = merge(&folders, &self.path(out), left_to_chance).unwrap();
        assert!(render(&merged.outcome, "").unwrap().contains("</html>"));
        (merged.is_whole(), serde_json::to_value(&merged.outcome).unwrap())
    }
}

#[test]
fn merge_says_what_is_missing_and_writes_what_is_there() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    let plan = Plan::new(&cells);
    folders.part("one", &cells[..5], Some(&plan));
    folders.part("two", &cells[5..], Some(&plan));
    let (whole, suite) = folders.merge(&["one"], "half");
    assert!(!whole);
    assert_eq!((&suite["planned"], &suite["missing"]), (&json!(12), &json!(7)));
    assert!(!suite["groups"].as_array().unwrap().is_empty());
    let (whole, suite) = folders.merge(&["one", "two"], "whole");
    assert_eq!((whole, &suite["planned"], &suite["missing"]), (true, &json!(12), &json!(0)));
    // The merged folder has its plan, too.
    assert!(folders.merge(&["whole"], "copy").0);
    assert!(folders.merge(&["two"], "half").0, "the half is whole now");
}

#[test]
fn merge_counts_a_file_that_cannot_be_read_as_missing_and_goes_on() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    let plan = Plan::new(&cells);
    let spoil = |part: &str, cell: &Cell| {
        fs::write(folders.path(part).join(format!("cells/{}.json", cell.id())), "{").unwrap();
    };
    folders.part("one", &cells, Some(&plan));
    spoil("one", &cells[2]);
    let (whole, suite) = folders.merge(&["one"], "whole");
    assert_eq!((whole, &suite["planned"], &suite["missing"]), (false, &json!(12), &json!(1)));
    // Without a plan only such a file is known to be missing.
    folders.part("old", &cells, None);
    let (whole, suite) = folders.merge(&["old"], "of old");
    assert_eq!((whole, &suite["planned"], &suite["missing"]), (true, &Value::Null, &json!(0)));
    spoil("old", &cells[2]);
    let (whole, suite) = folders.merge(&["old"], "of spoilt");
    assert_eq!((whole, &suite["planned"], &suite["missing"]), (false, &Value::Null, &json!(1)));
    // Another part that has the result fills in; the corrupt file is reported all the same.
    folders.part("other", &cells[2..3], Some(&plan));
    let (whole, suite) = folders.merge(&["one", "other"], "mwhole");
    assert_eq!((whole, &suite["missing"]), (false, &json!(0)));
    // And so is a plan that cannot be read.
    fs::write(folders.path("other").join("plan.json"), "").unwrap();
    assert!(!folders.merge(&["other"], "of other").0);
}

#[test]
fn what_no_part_plans_any_more_is_left_out() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    folders.part("one", &cells, Some(&Plan::new(&cells[..9])));
    let (whole, suite) = folders.merge(&["one"], "merged");
    assert_eq!((whole, &suite["planned"], &suite["missing"]), (true, &json!(9), &json!(0)));
    let runs = |suite: &Value| {
        let groups = suite["groups"].as_array().unwrap().iter();
        groups.map(|group| group["figures"]["completion"]["runs"].as_u64().unwrap()).sum::<u64>()
    };
    assert_eq!(runs(&suite), 9);
}

#[test]
fn a_run_that_only_one_part_kept_is_kept() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    let plan = Plan::new(&cells);
    folders.part("without", &cells, Some(&plan));
    let with = folders.part("with", &cells, Some(&plan));
    let run = Results::run_name(&cells[0]);
    fs::create_dir_all(with.file("runs")).unwrap();
    fs::write(with.file(&run), "a run").unwrap();
    let mut done = with.get(&cells[0]).unwrap().unwrap();
    // What a result says of its run's place is not followed.
    done.run = Some("../elsewhere".into());
    with.keep(&done).unwrap();
    for (parts, out) in [(["without", "with"], "one"), (["with", "without"], "other")] {
        folders.merge(&parts, out);
        assert_eq!(fs::read(folders.path(out).join(&run)).unwrap(), b"a run", "{out}");
    }
}

#[test]
fn a_result_whose_run_was_deleted_is_merged_without_it() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    let part = folders.part("one", &cells, Some(&Plan::new(&cells)));
    let mut done = part.get(&cells[0]).unwrap().unwrap();
    done.run = Some(Results::run_name(&cells[0]));
    part.keep(&done).unwrap();
    assert!(folders.merge(&["one"], "merged").0);
    let merged = Results::open(&folders.path("merged")).unwrap();
    assert_eq!(merged.get(&cells[0]).unwrap().unwrap().run, None);
}

#[test]
fn parts_that_drove_a_cell_differently_are_named_and_nothing_is_copied() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    folders.part("one", &cells[..5], None);
    let other = folders.part("other", &cells[4..], None);
    let mut done = other.get(&cells[4]).unwrap().unwrap();
    done.fingerprint = "ab".into();
    other.keep(&done).unwrap();
    let parts = ["one", "other"].map(|part| folders.path(part));
    let error = merge(&parts, &folders.path("merged"), left_to_chance).unwrap_err().to_string();
    for part in &parts {
        assert!(error.contains(&part.display().to_string()), "{error}");
    }
    assert!(error.contains(&format!("delete cells/{}.json in one of them", cells[4].id())), "{error}");
    assert_eq!(fs::read_dir(folders.path("merged/cells")).unwrap().count(), 0);
}

#[test]
fn a_result_that_no_part_plans_any_more_need_not_be_readable() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    let part = folders.part("one", &cells, Some(&Plan::new(&cells[..9])));
    fs::write(part.file(&format!("cells/{}.json", cells[10].id())), "{").unwrap();
    let (whole, suite) = folders.merge(&["one"], "merged");
    assert_eq!((whole, &suite["planned"], &suite["missing"]), (true, &json!(9), &json!(0)));
}

#[test]
fn the_same_drive_under_ten_seeds_counts_once() {
    // As it was driven before the other seeds were left out.
    let folders = Folders(tempfile::tempdir().unwrap());
    let every = |cell: &Cell| (0..10).map(|seed| Cell { seed, ..cell.clone() }).collect::<Vec<_>>();
    let cells = cells();
    let of = |conditions: &str| cells.iter().find(|cell| cell.pilot == "network" && cell.conditions == conditions);
    folders.part("old", &[every(of("fair").unwrap()), every(of("noise=4").unwrap())].concat(), None);
    let (whole, suite) = folders.merge(&["old"], "whole");
    assert!(whole);
    let completion = |i: usize| suite["groups"][i]["figures"]["completion"].clone();
    assert_eq!(
        (&suite["groups"][0]["conditions"], &suite["groups"][1]["conditions"]),
        (&json!("fair"), &json!("noise=4"))
    );
    assert_eq!((&completion(0)["runs"], &completion(0)["confidence"]), (&json!(1), &Value::Null));
    assert_eq!(completion(1)["runs"], json!(10));
    assert_eq!(fs::read_dir(folders.path("whole/cells")).unwrap().count(), 20, "none is thrown away");
}

#[test]
fn runs_that_were_kept_come_along() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    let part = folders.part("one", &cells[..2], None);
    let mut kept = part.get(&cells[0]).unwrap().unwrap();
    kept.run = Some(Results::run_name(&cells[0]));
    fs::write(part.room_for_run(&cells[0]).unwrap(), "a run").unwrap();
    part.keep(&kept).unwrap();
    folders.merge(&["one"], "whole");
    let whole = Results::open(&folders.path("whole")).unwrap();
    let run = whole.get(&cells[0]).unwrap().unwrap().run.unwrap();
    assert_eq!(fs::read_to_string(whole.file(&run)).unwrap(), "a run");
    assert_eq!(fs::read_dir(folders.path("whole").join("runs")).unwrap().count(), 1);
}
