use std::{fs, path::Path, time::Duration};

use serde_json::json;

use super::*;
use crate::{judged::Judged, score::Scorer};
use lapwing_core::{drive::DriveDigest, protocol::Telemetry};

const SUITE: &str = r#"
tracks = ["lake", "jungle"]
conditions = ["fair", "noise=4"]
speeds_mph = [20, 30]
seeds = 3

[[pilot]]
name = "built in"

[[pilot]]
name = "expert"
expert = true
"#;

fn cells(text: &str) -> Vec<Cell> {
    let sha256 = |pilot: &Contestant| (!pilot.expert).then(|| "00ff".to_owned());
    Suite::parse(text).unwrap().cells(sha256)
}

#[test]
fn a_suite_is_every_combination_once() {
    let cells = cells(SUITE);
    assert_eq!(cells.len(), 2 * 2 * 2 * 3 * 2);
    let ids: std::collections::BTreeSet<_> = cells.iter().map(Cell::id).collect();
    assert_eq!(ids.len(), cells.len());
    assert_eq!(cells[0].to_string(), "built in on lake, fair, 20 mph, seed 0");
}

#[test]
fn a_cell_is_another_one_as_soon_as_anything_is_that_its_drive_depends_on() {
    let cell = cells(SUITE).remove(0);
    let changed = [
        Cell { model_sha256: Some("00fe".into()), ..cell.clone() },
        Cell { settings: json!({"kp": 0.2}), ..cell.clone() },
        Cell { laps: 2, ..cell.clone() },
        Cell { world: json!({"fog": 1}), ..cell.clone() },
    ];
    assert!(changed.iter().all(|other| other.id() != cell.id()));
    assert_eq!(cell.clone().id(), cell.id());
}

#[test]
fn shards_share_a_suite_out_and_leave_nothing() {
    let cells = cells(SUITE);
    let shards: Vec<Shard> = ["1/5", "2/5", "3/5", "4/5", "5/5"].map(|text| text.parse().unwrap()).into();
    for i in 0..cells.len() {
        assert_eq!(shards.iter().filter(|shard| shard.has(i)).count(), 1);
    }
    for wrong in ["0/5", "6/5", "1", "a/b", "1/0"] {
        assert!(wrong.parse::<Shard>().unwrap_err().to_string().contains("such as 2/8"), "{wrong}");
    }
}

#[test]
fn what_is_wrong_in_a_suite_is_said() {
    let error = |text: &str| Suite::parse(text).unwrap_err().to_string();
    assert_eq!(error("tracks = []\n[[pilot]]\nname = \"a\""), "suite: tracks: expected at least one, got none");
    let twice = "tracks = [\"lake\"]\n[[pilot]]\nname = \"a\"\n[[pilot]]\nname = \"a\"";
    assert_eq!(error(twice), "suite: pilot: expected distinct names, got \"a\" twice");
    let unnamed = twice.replace("\"a\"", "\" \"");
    assert_eq!(error(&unnamed), "suite: pilot: expected a name on one line, without spaces around it, got \" \"");
    let fast = "tracks = [\"lake\"]\nspeeds_mph = [0]\n[[pilot]]\nname = \"a\"";
    assert_eq!(error(fast), "suite: speeds_mph: expected speeds from 0.1 to 1000, got 0");
    assert!(error("track = \"lake\"").contains("unknown field `track`"));
    assert!(error("track = \"lake\"").ends_with("; did you mean \"tracks\"?"));
}

#[test]
fn a_suite_has_limits_that_are_said_before_it_is_laid_out() {
    let error = |line: &str| {
        let text = format!("tracks = [\"lake\", \"jungle\"]\n{line}\n[[pilot]]\nname = \"a\"");
        Suite::parse(&text).unwrap_err().to_string()
    };
    assert_eq!(error("seeds = 9223372036854775807"), "suite: seeds: expected at most 100000, got 9223372036854775807");
    assert_eq!(
        error("seeds = 60000"),
        "suite: cells: expected at most 100000, got 120000: 2 (tracks) x 1 (conditions) x 1 (speeds_mph) x 1 (pilot) x \
         60000 (seeds)"
    );
    assert!(
        error("seeds = -1").contains("expected a number of seeds, or a list of seeds from 0"),
        "{}",
        error("seeds = -1")
    );
    assert!(error("seeds = []").contains("seeds: expected at least one, got none"));
}

fn done(cell: &Cell, completion: f64) -> Done {
    Done::new(cell.clone(), json!({"completion": completion, "time_s": 10.0, "collisions": null}), "ab".into(), 1.5)
}

#[test]
fn results_come_back_and_what_is_none_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let results = Results::open(dir.path()).unwrap();
    let cells = cells(SUITE);
    assert_eq!(results.get(&cells[0]).unwrap(), None);
    results.keep(&done(&cells[0], 0.5)).unwrap();
    assert_eq!(results.get(&cells[0]).unwrap(), Some(done(&cells[0], 0.5)));
    let all = |results: &Results| results.all().unwrap();
    assert_eq!(all(&results).len(), 1);
    // The remains of a killed write are not a result.
    fs::write(dir.path().join("cells/half.partial"), "{").unwrap();
    assert_eq!(all(&results).len(), 1);
    // Nor is a file damaged by a failing disk: its cell is driven again.
    fs::write(dir.path().join(format!("cells/{}.json", cells[1].id())), "").unwrap();
    assert_eq!(results.get(&cells[1]).unwrap(), None);
    results.keep(&done(&cells[1], 0.5)).unwrap();
    fs::write(dir.path().join("cells/other.json"), "{}").unwrap();
    let (readable, not): (Vec<_>, Vec<_>) = all(&results).into_iter().partition(Result::is_ok);
    assert_eq!((readable.len(), not.len()), (2, 1), "one file that is none takes no other with it");
    let (id, error) = not[0].as_ref().map_err(|(id, error)| (id.clone(), error.to_string())).unwrap_err();
    assert_eq!(id, "other");
    assert!(error.contains("other.json: expected the result of a cell (lapwing.cell/1), got missing field"), "{error}");
    assert!(Results::open(Path::new("/proc/nowhere")).unwrap_err().to_string().contains("cannot make the folder"));
}

#[test]
fn a_plan_knows_what_is_missing_and_takes_in_other_plans() {
    let dir = tempfile::tempdir().unwrap();
    let results = Results::open(dir.path()).unwrap();
    assert_eq!(results.plan().unwrap(), None, "as of results from before there were plans");
    let cells = cells(SUITE);
    let (mut plan, rest) = (Plan::new(&cells[..3]), Plan::new(&cells[2..4]));
    results.keep_plan(&rest).unwrap();
    results.keep_plan(&plan).unwrap();
    assert_eq!(results.plan().unwrap(), Some(plan.clone()), "the last one");
    plan.add(rest);
    assert!(plan.count() == 4 && plan.has(&cells[3].id()) && !plan.has(&cells[4].id()));
    let there = [0, 2].map(|i| done(&cells[i], 1.0));
    let missing = ["expert on lake, fair, 20 mph, seed 0", "expert on lake, fair, 30 mph, seed 0"];
    assert_eq!(plan.missing(&there), missing);
    fs::write(dir.path().join("plan.json"), "{\"schema\": \"lapwing.plan/9\", \"cells\": []}").unwrap();
    let error = results.plan().unwrap_err().to_string();
    assert!(error.contains("plan.json: expected the plan of a suite (lapwing.plan/1), got lapwing.plan/9"), "{error}");
}

#[test]
fn groups_are_over_seeds_and_the_table_has_a_line_for_each() {
    let mut cells = cells(SUITE);
    for cell in &mut cells {
        let (track, mph) = (&cell.track, cell.speed_mph);
        cell.settings = json!({ "simulator": { "track": track }, "control": { "speed_mph": mph } });
    }
    let all: Vec<_> = cells.iter().map(|cell| done(cell, 0.4 + 0.2 * cell.seed as f64)).collect();
    let groups = groups(&all);
    assert_eq!(groups.len(), 16);
    let completion = groups[0].figures["completion"];
    assert!((completion.spread.mean - 0.6).abs() < 1e-9 && completion.spread.runs == 3);
    assert!(!groups[0].figures.contains_key("collisions"), "not measurable is no zero");
    // Random weather differs with each seed but forms one group; other settings form another group, with a name that
    // says so.
    let varied = |settings: u32| {
        let cells =
            cells.iter().filter(|cell| cell.pilot == "expert" && cell.track == "lake" && cell.speed_mph == 20.0);
        let cells = cells.filter(|cell| cell.conditions == "fair");
        let cells = cells.map(move |cell| Cell { settings: json!(settings), world: json!(cell.seed), ..cell.clone() });
        cells.map(|cell| done(&cell, 1.0)).collect::<Vec<_>>()
    };
    let one = varied(1);
    assert_eq!(super::groups(&one).len(), 1);
    let both = super::groups(&[one, varied(2)].concat());
    assert_eq!(both.len(), 2);
    assert!(both[0].pilot.starts_with("expert (settings ") && both[0].pilot != both[1].pilot, "{}", both[0].pilot);
    let table = table(&groups);
    assert_eq!(table.lines().count(), 17);
    assert!(table.lines().nth(1).unwrap().starts_with("built in  jungle  fair"), "{table}");
    assert!(table.contains("60 % [10.3, 100]"), "{table}");
}

#[test]
fn a_small_mean_is_shown_the_same_in_table_and_page() {
    let cell = |seed| Cell { seed, ..cells(SUITE).remove(0) };
    let done = |seed, cte: f64, collisions: u32| {
        let card = json!({"mean_cte_m": cte, "steering_mse": cte, "collisions": collisions, "time_s": 10.0});
        Done::new(cell(seed), card, "ab".into(), 1.5)
    };
    let groups = groups(&[done(0, 0.000_512, 0), done(1, 0.000_514, 1)]);
    let table = table(&groups);
    assert!(table.contains("  0.000513 m ± 0.0000127 m  ") && table.contains("  0.5 [0, 6.85]  "), "{table}");
    let page = render(&SuiteOutcome::new(groups, None, 0), "").unwrap();
    for words in [
        r#""mean_cte_m":{"mean":"0.000513 m","interval":"± 0.0000127 m","least":"0.000512 m","most":"0.000514 m"}"#,
        r#""collisions":{"mean":"0.5","interval":"[0, 6.85]","least":"0","most":"1"}"#,
        r#""steering_mse":{"mean":"0.000513 lock2","#,
    ] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn a_single_drive_has_no_interval() {
    let groups = groups(&[done(&cells(SUITE)[0], 1.0)]);
    let over = groups[0].figures["completion"];
    assert_eq!((over.spread.runs, over.confidence), (1, None));
    let table = table(&groups);
    assert!(table.contains("20  1 ") && !table.contains('±'), "{table}");
}

#[test]
fn drives_in_worlds_that_only_share_a_name_are_told_apart() {
    let cell_in = |conditions: &str, seed: u64, track: &str, haze: f64| {
        let world = json!({"track_sha256": track, "conditions": {"haze": haze}});
        Cell { seed, world, conditions: conditions.to_owned(), ..cells(SUITE).remove(0) }
    };
    let cell = |seed: u64, track: &str, haze: f64| cell_in("mine.toml", seed, track, haze);
    let tracks = |all: &[Cell]| {
        let all: Vec<_> = all.iter().map(|cell| done(cell, 1.0)).collect();
        groups(&all).into_iter().map(|group| (group.track, group.figures["completion"].spread.runs)).collect::<Vec<_>>()
    };
    // Weather that depends on the seed is one group.
    let by_chance = [cell_in("random", 0, "a", 0.1), cell_in("random", 1, "a", 0.7)];
    assert_eq!(tracks(&by_chance), [("lake".to_owned(), 2)]);
    assert_eq!(tracks(&[cell(0, "a", 0.1), cell(1, "a", 0.1)]), [("lake".to_owned(), 2)]);
    for others in [cell(0, "b", 0.1), cell(0, "a", 0.7), cell(1, "a", 0.7)] {
        let told = tracks(&[cell(0, "a", 0.1), others]);
        assert!(
            told.len() == 2 && told.iter().all(|(name, runs)| name.starts_with("lake (world ") && *runs == 1),
            "{told:?}"
        );
    }
}

#[test]
fn the_collision_rate_of_a_group_is_that_of_all_its_episodes() {
    let cells = cells(SUITE);
    let done = |i: usize, episodes: u32, rate: f64| {
        let card = json!({"episodes": episodes, "collision_rate": rate});
        Done::new(cells[i].clone(), card, "ab".into(), 1.5)
    };
    // The second cell of a group is the first of the next seed.
    let over = groups(&[done(0, 1, 1.0), done(cells.len() / 3, 4, 0.25)])[0].figures["collision_rate"];
    assert!((over.spread.mean - 0.4).abs() < 1e-12, "{over:?}");
    assert_eq!(Some(over.spread), crate::score::Spread::weighted(&[(1.0, 1.0), (0.25, 4.0)]));
    assert_eq!(over.confidence, over.spread.confidence());
}

#[test]
fn every_key_of_the_files_is_documented() {
    fn keys(value: &serde_json::Value, path: &str, found: &mut std::collections::BTreeSet<String>) {
        // These are documented elsewhere, and every figure has the same keys.
        let told_elsewhere = ["card", "cell.settings.control", "cell.settings.simulator", "cell.world.conditions"];
        let inside = match value {
            serde_json::Value::Object(map) if !told_elsewhere.contains(&path) => {
                let inside = |(key, value)| {
                    let key: &String = key;
                    let key = if path == "groups[].figures" { "KEY" } else { key };
                    (if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }, value)
                };
                map.iter().map(inside).collect()
            }
            serde_json::Value::Array(list) => list.iter().map(|value| (format!("{path}[]"), value)).collect(),
            _ => {
                found.insert(path.to_owned());
                vec![]
            }
        };
        for (path, value) in inside {
            keys(value, &path, found);
        }
    }
    let mut cell = cells(SUITE).remove(0);
    cell.settings = json!({"lapwing": "0", "control": {}, "simulator": {}, "beside_model_sha256": null});
    cell.world = json!({"conditions": {}, "track_sha256": null});
    let mut done = done(&cell, 1.0);
    done.run = Some("runs/ID.mcap".into());
    let outcome = SuiteOutcome::new(groups(std::slice::from_ref(&done)), Some(1), 0);
    let mut found = std::collections::BTreeSet::new();
    keys(&json!(outcome), "", &mut found);
    keys(&json!(Plan::new(&[cell])), "", &mut found);
    keys(&json!(done), "", &mut found);
    assert!(found.len() > 30, "{found:?}");
    let documented = include_str!("mod.rs");
    for key in found {
        assert!(documented.contains(&format!("//! | `{key}` | ")), "{key}");
    }
}

#[test]
fn no_name_gets_out_of_its_place_in_the_page() {
    let cell = Cell { pilot: "</script>".into(), ..cells(SUITE).remove(0) };
    let page = render(&SuiteOutcome::new(groups(&[done(&cell, 1.0)]), None, 0), "").unwrap();
    assert_eq!(page.matches("</script>").count(), 3);
    assert!(page.contains("n = ${over.runs}"), "how many drives stand behind a mean is shown");
}

#[test]
fn a_drive_fails_by_what_it_did_and_not_by_what_nobody_measured() {
    let failed = |card: serde_json::Value| Done::new(cells(SUITE).remove(0), card, "ab".into(), 1.5).failed();
    assert_eq!(failed(json!({"completion": 1.0, "collisions": 0, "off_roads": 0})), None);
    assert_eq!(failed(json!({"completion": 1.0, "collisions": null})), None);
    let words = failed(json!({"completion": 0.4561, "collisions": 1, "off_roads": 2}));
    assert_eq!(words.unwrap(), "45.61 % driven, 1 collision, 2 times off the road");
}

/// Drives at once: the first seed's cells fail.
struct Paper;

impl Course for Paper {
    type Error = std::io::Error;

    fn model_sha256(&self, _: &Contestant) -> Option<String> {
        None
    }

    fn resolve(&self, _: &mut Cell) -> Result<(), Self::Error> {
        Ok(())
    }

    fn left_to_chance(&self, _: &Cell) -> bool {
        true
    }

    fn drive(&self, cell: &Cell, run: Option<&Path>, stop: Stop<'_>) -> Result<Option<Judged>, Self::Error> {
        if let Some(run) = run {
            fs::write(run, cell.to_string())?;
        }
        let mut scorer = Scorer::default();
        let json = r#"{"steering_deg":0,"throttle":0.25,"speed_mph":9}"#;
        let mut telemetry: Telemetry = serde_json::from_str(json).unwrap();
        for second in 0..3 {
            telemetry.truth.crashes = Some(u32::from(cell.seed == 0 && second > 1));
            scorer.telemetry(Duration::from_secs(second), &telemetry);
        }
        // And the second seed's frames cannot be used.
        let bad_frames = u64::from(cell.seed == 1);
        let first_bad = (bad_frames > 0).then(|| "no JPEG".to_owned());
        let driven = DriveDigest { fingerprint: "ab".into(), frames: 1, bad_frames, first_bad };
        Ok((!stop()).then(|| Judged { card: scorer.finish(), driven }))
    }
}

struct Nobody;

impl Watch for Nobody {
    fn begins(&self, _: &Cell) {}
    fn done(&self, _: &Done) {}
}

#[test]
fn the_runs_of_failed_drives_are_kept_and_the_page_leads_to_them() {
    let runs_in = |keep, stop: Stop<'_>| {
        let dir = tempfile::tempdir().unwrap();
        let results = Results::open(dir.path()).unwrap();
        let cells: Vec<_> = cells(SUITE).into_iter().filter(|cell| cell.track == "lake").collect();
        drive_all(&Paper, cells, (&results, keep), Some(1), stop, &Nobody).unwrap();
        let done: Vec<_> = results.all().unwrap().into_iter().map(Result::unwrap).collect();
        for one in &done {
            let run = one.run.as_ref().map(|run| fs::read_to_string(results.file(run)).unwrap());
            assert_eq!(run, one.run.is_some().then(|| one.cell.to_string()));
        }
        let files = fs::read_dir(dir.path().join("runs")).map_or(0, Iterator::count);
        assert_eq!(files, done.iter().filter(|one| one.run.is_some()).count(), "no other run is there");
        (done, dir)
    };
    let (done, _dir) = runs_in(Keep::Failed, &|| false);
    assert_eq!((done.len(), done.iter().filter(|one| one.run.is_some()).count()), (24, 16));
    let groups = groups(&done);
    let of_seed = |seed| groups[0].drives.iter().find(|drive| drive.seed == seed).unwrap();
    assert_eq!(groups[0].drives.len(), 2);
    let [drive, unseen] = [0, 1].map(of_seed);
    assert_eq!((drive.seed, drive.failed.as_deref(), &drive.bad_frames), (0, Some("1 collision"), &None));
    let why = "expected at most 1 % bad frames, which no network sees, got 1 of 1; the first: no JPEG";
    assert_eq!((unseen.seed, unseen.failed.as_deref(), unseen.bad_frames.as_deref()), (1, Some(why), Some(why)));
    let page = render(&SuiteOutcome::new(groups.clone(), None, 0), "../results").unwrap();
    assert!(page.contains(drive.run.as_ref().unwrap()) && page.contains(r#""folder":"../results""#));
    assert_eq!(runs_in(Keep::All, &|| false).0.iter().filter(|one| one.run.is_some()).count(), 24);
    assert_eq!(runs_in(Keep::None, &|| false).0.iter().filter(|one| one.run.is_some()).count(), 0);
}

#[test]
fn what_a_drive_that_was_killed_left_is_gone_once_its_cell_is_driven_whatever_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let results = Results::open(dir.path()).unwrap();
    let cell = cells(SUITE).remove(0);
    let left = results.room_for_run(&cell).unwrap();
    fs::write(&left, "half a run").unwrap();
    drive_all(&Paper, vec![cell], (&results, Keep::None), Some(1), &|| false, &Nobody).unwrap();
    assert!(!left.exists());
}
