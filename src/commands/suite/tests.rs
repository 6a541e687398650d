use std::{path::PathBuf, sync::Arc};

use serde_json::{Value, json};

use super::*;
use lapwing_core::config::Control;
use lapwing_score::judged;
use lapwing_score::score::Figure;
use lapwing_sim::{camera::Scenery, world::Setup};

const SUITE: &str = r#"
tracks = ["lake"]
conditions = ["fair", "latency_ms=100", "noise=4", "random"]
seeds = [7, 3, 5]

[[pilot]]
name = "network"

[[pilot]]
name = "expert"
expert = true
"#;

fn cells() -> Vec<Cell> {
    cells_of(SUITE)
}

fn cells_of(suite: &str) -> Vec<Cell> {
    let sha256 = |contestant: &Contestant| (!contestant.expert).then(|| "00ff".to_owned());
    planned(&Suite::parse(suite).unwrap(), &Layers::default(), sha256).unwrap()
}

#[test]
fn the_first_seed_alone_is_driven_where_another_one_changes_nothing() {
    let cells = cells();
    let seeds = |pilot: &str, conditions: &str| {
        let of = |cell: &&Cell| cell.pilot == pilot && cell.conditions == conditions;
        cells.iter().filter(of).map(|cell| cell.seed).collect::<Vec<_>>()
    };
    for (conditions, expected) in
        [("fair", &[3][..]), ("latency_ms=100", &[3]), ("noise=4", &[3, 5, 7]), ("random", &[3, 5, 7])]
    {
        assert_eq!(seeds("network", conditions), expected, "{conditions}");
        assert_eq!(seeds("expert", conditions), [3], "{conditions}: it looks at no picture");
    }
    // What is driven goes by the name that it has without the others.
    let alone = cells_of(&SUITE.replace("[7, 3, 5]", "[3]"));
    assert_eq!(alone.len(), 8);
    assert!(alone.iter().all(|cell| cells.contains(cell)));
}

#[test]
fn the_seed_changes_a_drive_under_the_conditions_that_say_so_and_the_experts_figures_under_none() {
    let track = Arc::new(Track::open("lake").unwrap());
    let scenery = Arc::new(Scenery::new(&track));
    let now = Instant::now;
    for (text, by_chance) in [
        ("", false),
        ("sun_height_deg=20,sun_azimuth_deg=90,brightness=0.8,haze=0.5,night=0.5,blur=1,latency_ms=100", false),
        ("rain=0.5", true),
        ("noise=4", true),
        ("dropped=0.5", true),
    ] {
        let conditions = Conditions::parse(text).unwrap();
        let drive = |seed| {
            let setup = Setup::new(track.clone(), scenery.clone());
            let setup = Setup { conditions: conditions.clone(), seed, longest_s: Some(2.0), ..setup };
            let mut driver = Driver::new(Box::new(PurePursuit::default()), &Control::default(), now);
            judged::run(&mut Simulation::new(setup).unwrap(), &mut driver, None, |_, _, _| Ok(())).unwrap()
        };
        let (one, other) = (drive(1), drive(2));
        assert_eq!(one.fingerprint != other.fingerprint, by_chance, "{text}");
        assert_eq!(conditions.left_to_chance(), by_chance, "{text}");
        for figure in Figure::ALL {
            assert_eq!(one.card.value(figure), other.card.value(figure), "{text}: {}", figure.key());
        }
    }
}

/// Folders of parts, and of what is put together from them.
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

    /// How merging ends, and what it writes.
    fn merge(&self, parts: &[&str], out: &str) -> (Ended, Value) {
        let folders = parts.iter().map(|part| self.path(part)).collect();
        let arguments = cli::Merge { folders, out: self.path(out), html: None, json: false };
        let ended = merge(&arguments).unwrap();
        let suite = fs::read(self.path(out).join("suite.json")).unwrap();
        assert!(self.path(out).join("suite.html").is_file());
        (ended, serde_json::from_slice(&suite).unwrap())
    }
}

#[test]
fn merge_says_what_is_missing_and_writes_what_is_there() {
    let folders = Folders(tempfile::tempdir().unwrap());
    let cells = cells();
    let plan = Plan::new(&cells);
    folders.part("one", &cells[..5], Some(&plan));
    folders.part("two", &cells[5..], Some(&plan));
    let (ended, suite) = folders.merge(&["one"], "half");
    assert_eq!(ended, Ended::Failed);
    assert_eq!((&suite["planned"], &suite["missing"]), (&json!(12), &json!(7)));
    assert!(!suite["groups"].as_array().unwrap().is_empty());
    let (ended, suite) = folders.merge(&["one", "two"], "whole");
    assert_eq!((ended, &suite["planned"], &suite["missing"]), (Ended::Passed, &json!(12), &json!(0)));
    // What is put together knows its plan too.
    assert_eq!(folders.merge(&["whole"], "copy").0, Ended::Passed);
    assert_eq!(folders.merge(&["two"], "half").0, Ended::Passed, "the half is whole now");
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
    let (ended, suite) = folders.merge(&["one"], "whole");
    assert_eq!((ended, &suite["planned"], &suite["missing"]), (Ended::Failed, &json!(12), &json!(1)));
    // Without a plan such a file is all that is known to be missing.
    folders.part("old", &cells, None);
    let (ended, suite) = folders.merge(&["old"], "of old");
    assert_eq!((ended, &suite["planned"], &suite["missing"]), (Ended::Passed, &Value::Null, &json!(0)));
    spoil("old", &cells[2]);
    let (ended, suite) = folders.merge(&["old"], "of spoilt");
    assert_eq!((ended, &suite["planned"], &suite["missing"]), (Ended::Failed, &Value::Null, &json!(1)));
    // Another part that has it helps; that the file is corrupt is said all the same.
    folders.part("other", &cells[2..3], Some(&plan));
    let (ended, suite) = folders.merge(&["one", "other"], "mended");
    assert_eq!((ended, &suite["missing"]), (Ended::Failed, &json!(0)));
    // And so is a plan that cannot be read.
    fs::write(folders.path("other").join("plan.json"), "").unwrap();
    assert_eq!(folders.merge(&["other"], "of other").0, Ended::Failed);
}

#[test]
fn the_same_drive_under_ten_seeds_counts_once() {
    // As it was driven before the other seeds were left out.
    let folders = Folders(tempfile::tempdir().unwrap());
    let every = |cell: &Cell| (0..10).map(|seed| Cell { seed, ..cell.clone() }).collect::<Vec<_>>();
    let cells = cells();
    let of = |conditions: &str| cells.iter().find(|cell| cell.pilot == "network" && cell.conditions == conditions);
    folders.part("old", &[every(of("fair").unwrap()), every(of("noise=4").unwrap())].concat(), None);
    let (ended, suite) = folders.merge(&["old"], "whole");
    assert_eq!(ended, Ended::Passed);
    let completion = |i: usize| suite["groups"][i]["figures"]["completion"].clone();
    assert_eq!(
        (&suite["groups"][0]["conditions"], &suite["groups"][1]["conditions"]),
        (&json!("fair"), &json!("noise=4"))
    );
    assert_eq!((&completion(0)["runs"], &completion(0)["confidence"]), (&json!(1), &Value::Null));
    assert_eq!(completion(1)["runs"], json!(10));
    assert_eq!(fs::read_dir(folders.path("whole/cells")).unwrap().count(), 20, "none is thrown away");
}
