//! `lapwing brake`, from recordings to labels and networks, and guards that brake.

use std::{fs, path::Path};

use lapwing_score::emergency::{LabelRule, Labelled};
use serde_json::{Value, json};
use tempfile::tempdir;

use crate::{program::lapwing_in, support::shared};

#[test]
fn a_foot_that_goes_down_on_a_real_drive_is_an_emergency_and_a_touch_of_the_pedal_is_none() {
    let Some(lake) = shared("recordings/lake") else { return };
    // Pressed to a third at 113 s, and all the way at 146 s, before the car stops.
    let found = Labelled::open(&lake, LabelRule::default()).unwrap().found();
    let [at_s] = found.emergencies_s[..] else { panic!("{found:?}") };
    assert!((145.5..147.0).contains(&at_s), "{found:?}");
    let eager = LabelRule { threshold_per_s: 0.5, ..LabelRule::default() };
    assert!(Labelled::open(&lake, eager).unwrap().found().emergencies_s.len() >= 2);
}

#[test]
fn recordings_are_labelled_into_a_folder_and_one_without_a_brake_stops_it_before_anything_is_written() {
    let folder = tempdir().unwrap();
    let row = |i: u32| format!("{:.3},30,{}\n", f64::from(i) / 15.0, if i < 30 { 0 } else { 100 });
    let table = "time_s,speed_kmh,brake_percent\n".to_owned() + &(0..60).map(row).collect::<String>();
    fs::write(folder.path().join("drive.csv"), table).unwrap();
    let run = |arguments: &[&str]| lapwing_in(folder.path(), "", arguments);
    let (status, out, err) = run(&["brake", "label", "drive.csv", "--out", "labels", "--plot", "pedal.svg"]);
    assert_eq!((status, err.as_str()), (0, ""));
    assert_eq!(
        out,
        "drive.csv: 1 drive, 60 moments\n  emergencies  1, at 1.9 s\n  labelled     16.7 % of the moments (10)\n"
    );
    assert_eq!(fs::read_to_string(folder.path().join("labels/drive.csv")).unwrap().lines().count(), 61);
    assert!(fs::read_to_string(folder.path().join("pedal.svg")).unwrap().contains("pedals per second"));
    // The stock simulator reports no brake.
    let drive = ["drive", "--stock", "--pilot", "expert", "--max-time", "2", "--recordings", "runs"];
    let (status, _, err) = run(&drive);
    assert_eq!(status, 0, "{err}");
    let made = fs::read_dir(folder.path().join("runs")).unwrap().next().unwrap().unwrap();
    let name = format!("runs/{}", made.file_name().to_string_lossy());
    let (status, out, err) = run(&["brake", "label", "drive.csv", &name, "--out", "others"]);
    assert_eq!((status, out.as_str()), (1, ""));
    assert!(err.contains("expected a brake, got none in"), "{err}");
    assert!(!folder.path().join("others").exists());
    let (status, _, err) = run(&["brake", "label", "drive.csv", "drive.csv", "--out", "labels"]);
    assert_eq!(status, 1);
    assert!(err.contains("expected names that differ, got \"drive\" twice"), "{err}");
}

#[test]
fn labels_are_never_written_over_the_table_that_they_are_of_nor_over_a_driving_log() {
    let folder = tempdir().unwrap();
    let table = "time_s,speed_kmh,brake_percent\n0,30,0\n0.067,30,0\n";
    for name in ["drive.csv", "driving_log.csv"] {
        fs::create_dir_all(folder.path().join("other")).unwrap();
        fs::write(folder.path().join(name), table).unwrap();
        fs::write(folder.path().join("other").join(name), "as it was").unwrap();
    }
    let run = |arguments: &[&str]| lapwing_in(folder.path(), "", &[&["brake", "label"], arguments].concat());
    let (status, _, err) = run(&["drive.csv", "--out", "."]);
    assert_eq!(status, 1);
    assert!(err.contains("it is also an input, which would be lost; name another file"), "{err}");
    let (status, _, err) = run(&["driving_log.csv", "--out", "other"]);
    assert_eq!(status, 1);
    assert!(err.contains("it is a recording, which would be lost"), "{err}");
    assert_eq!(fs::read_to_string(folder.path().join("drive.csv")).unwrap(), table);
    assert_eq!(fs::read_to_string(folder.path().join("other/driving_log.csv")).unwrap(), "as it was");
    // A table of labels is made anew.
    assert_eq!(run(&["drive.csv", "--out", "other"]).0, 0);
}

/// Drives a scenario with the expert and these flags in a folder; the scorecard.
fn driven(folder: &Path, scenario: &str, seed: &str, flags: &[&str]) -> Value {
    let drive = ["drive", "--pilot", "expert", "--scenario", scenario, "--seed", seed, "--json"];
    let (status, out, err) = lapwing_in(folder, "", &[&drive, flags].concat());
    assert_eq!(status, 0, "{err}");
    serde_json::from_str(&out).unwrap()
}

#[test]
fn a_guard_that_is_told_the_time_to_collision_keeps_the_expert_from_running_into_a_standing_car() {
    let folder = tempdir().unwrap();
    let alone = driven(folder.path(), "ccrs", "3", &["--no-recording"]);
    assert!(alone["collisions"].as_u64().unwrap() > 0 && alone["guard_activations"].is_null(), "{alone}");
    let guarded = driven(folder.path(), "ccrs", "3", &["--no-recording", "--brake-guard", "ttc"]);
    assert_eq!(guarded["collisions"], 0, "{guarded}");
    assert!(guarded["guard_activations"].as_u64().unwrap() >= 1, "{guarded}");
    assert!(guarded["guard_braked_s"].as_f64().unwrap() > 0.3, "{guarded}");
    let hardest = guarded["guard_hardest_g"].as_f64().unwrap();
    assert!((0.3..1.2).contains(&hardest), "{hardest} g");
    assert!(guarded["latency_ms"]["guard"]["p50"].as_f64().is_some(), "{guarded}");
    // The same on the scorecard and its page.
    let drive = ["drive", "--pilot", "expert", "--scenario", "ccrs", "--seed", "3", "--brake-guard", "ttc"];
    let (status, out, err) = lapwing_in(folder.path(), "", &[&drive[..], &["--recordings", "runs"]].concat());
    assert_eq!(status, 0, "{err}");
    let braked = out.lines().find(|line| line.starts_with("  guard ")).unwrap();
    let times = if guarded["guard_activations"] == 1 { "braked once, " } else { "times, " };
    assert!(braked.contains(times) && braked.ends_with(&format!(" s, at most {hardest:.2} g")), "{braked}");
    let (status, _, err) = lapwing_in(folder.path(), "", &["score", "runs", "--html", "page.html"]);
    assert_eq!(status, 0, "{err}");
    let page = fs::read_to_string(folder.path().join("page.html")).unwrap();
    for label in ["guard activations", "braked by the guard", "hardest guard braking"] {
        assert!(page.contains(label), "{label}");
    }
}

#[test]
fn the_shipped_network_keeps_the_expert_from_running_into_a_standing_car() {
    let folder = tempdir().unwrap();
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/models/brake.safetensors");
    let trial = ["brake", "trial", "--brake-model", model, "--cases", "ccrs", "--layers", "plain", "--speeds", "20"];
    let (status, out, err) =
        lapwing_in(folder.path(), "", &[&trial[..], &["--seeds", "2", "--laps", "0", "--json"]].concat());
    assert_eq!(status, 0, "{err}");
    let row = &serde_json::from_str::<Value>(&out).unwrap()["hazards"][0];
    let count = |key: &str| row[key].as_u64().unwrap();
    assert_eq!((count("hit_without"), count("avoidable"), count("avoided")), (2, 2, 2), "{row}");
}

#[test]
fn the_shipped_network_keeps_the_shipped_pilot_from_running_into_somebody_who_crosses_as_the_readme_shows() {
    let folder = tempdir().unwrap();
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/models/brake.safetensors");
    let driven = |more: &[&str]| {
        let drive = ["drive", "--scenario", "cpna", "--max-time", "12", "--no-recording", "--json"];
        let (status, out, err) = lapwing_in(folder.path(), "", &[&drive[..], more].concat());
        assert_eq!(status, 0, "{err}");
        serde_json::from_str::<Value>(&out).unwrap()
    };
    let (alone, guarded) = (driven(&[]), driven(&["--brake-model", model]));
    assert_eq!((&alone["collisions"], &guarded["collisions"]), (&1.into(), &0.into()), "{alone} {guarded}");
    assert_eq!(guarded["guard_activations"], 1, "{guarded}");
}

#[test]
fn without_a_scenario_there_is_no_time_to_collision_and_log_and_scorecard_say_so() {
    let folder = tempdir().unwrap();
    let drive = ["drive", "--pilot", "expert", "--max-time", "2", "--brake-guard", "ttc", "--recordings", "runs"];
    let (status, out, err) = lapwing_in(folder.path(), "", &drive);
    assert_eq!(status, 0, "{err}");
    assert_eq!(err.matches("the guard (time to collision) cannot watch: expected telemetry").count(), 1, "{err}");
    assert!(out.contains("guard             could not watch"), "{out}");
    let drive = ["drive", "--pilot", "expert", "--max-time", "2", "--brake-guard", "ttc", "--no-recording", "--json"];
    let (status, out, err) = lapwing_in(folder.path(), "", &drive);
    assert_eq!(status, 0, "{err}");
    assert!(serde_json::from_str::<Value>(&out).unwrap()["guard_activations"].is_null(), "{out}");
    let (status, _, err) = lapwing_in(folder.path(), "", &["drive", "--brake-model", "none.safetensors"]);
    assert_eq!(status, 1);
    assert!(err.contains("none.safetensors cannot be read"), "{err}");
}

#[test]
fn a_threshold_needs_the_network_to_which_it_belongs() {
    let folder = tempdir().unwrap();
    for more in [&[][..], &["--brake-guard", "ttc"]] {
        let flags = ["drive", "--pilot", "expert", "--no-recording", "--max-time", "1", "--brake-threshold", "0.5"];
        let (status, _, err) = lapwing_in(folder.path(), "", &[&flags[..], more].concat());
        assert_eq!(status, 2, "{err}");
        assert!(
            err.contains("expected a braking network as well (brake.model, --brake-model), got 0.5 without one"),
            "{err}"
        );
    }
    let flags =
        ["drive", "--pilot", "expert", "--no-recording", "--max-time", "1", "--model", "models/cps.safetensors"];
    let (status, _, err) = lapwing_in(folder.path(), "", &flags);
    assert!(status == 2 && err.contains("--model: expected --pilot model, got --pilot expert"), "{err}");
    // Who has both in a file may do without for once.
    fs::write(folder.path().join("lapwing.toml"), "[brake]\nthreshold = 0.5\n").unwrap();
    let flags = ["drive", "--pilot", "expert", "--no-recording", "--max-time", "1", "--brake-guard", "none"];
    assert_eq!(lapwing_in(folder.path(), "", &flags).0, 0);
}

#[test]
fn a_wrong_number_is_named_by_its_flag() {
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/models/brake.safetensors");
    let folder = tempdir().unwrap();
    for (flags, expected) in [
        (&["drive", "--brake-model", model, "--brake-threshold", "-1"][..], "expected a number above 0"),
        (
            &["drive", "--pilot", "expert", "--no-recording", "--brake-model", model, "--brake-threshold", "2"][..],
            "expected a threshold of at most 1, as a brake-live network says no more, got 2",
        ),
        (
            &["brake", "evaluate", model, "--data", "data", "--threshold", "2"][..],
            "expected a threshold of at most 1, as a brake-live network says no more, got 2",
        ),
        (&["brake", "label", "drive.csv", "--threshold", "-1"][..], "expected a number above 0"),
        (&["brake", "evaluate", model, "--data", "data", "--episodes", "0"][..], "'--episodes <COUNT>'"),
    ] {
        let (status, _, err) = lapwing_in(folder.path(), "", flags);
        assert_eq!(status, 2, "{err}");
        assert!(err.contains(expected), "{err}");
    }
}

#[test]
fn a_network_that_cannot_be_trained_further_is_named_before_the_data_are_read_and_none_is_written_over() {
    let folder = tempdir().unwrap();
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/models/brake.safetensors");
    fs::copy(model, folder.path().join("brake.safetensors")).unwrap();
    for (network, pretrained, out, expected) in [
        ("brake-live", "none.safetensors", "new.safetensors", "pretrained: none.safetensors cannot be read"),
        ("brake-stacked", "brake.safetensors", "new.safetensors", "expected a brake-stacked network, as in the recipe"),
        ("brake-live", "brake.safetensors", "brake.safetensors", "it is also an input, which would be lost"),
    ] {
        let recipe = format!("network = \"{network}\"\npretrained = \"{pretrained}\"\n");
        fs::write(folder.path().join("brake.toml"), recipe).unwrap();
        let train = ["brake", "train", "--recipe", "brake.toml", "--data", "nowhere", "--out", out];
        let (status, _, err) = lapwing_in(folder.path(), "", &train);
        assert_eq!(status, 1, "{err}");
        assert!(err.contains(expected), "{err}");
    }
}

#[test]
fn a_network_is_written_to_no_other_ending_and_a_training_that_cannot_be_resumed_says_so() {
    let folder = tempdir().unwrap();
    fs::write(folder.path().join("brake.toml"), "network = \"brake-live\"\n").unwrap();
    fs::create_dir(folder.path().join("data")).unwrap();
    let table = "name,part,scenario,kind,layer,reaction_s\n";
    fs::write(folder.path().join("data/episodes.csv"), table).unwrap();
    let train = ["brake", "train", "--recipe", "brake.toml", "--data", "data", "--resume", "--out"];
    let run = |out: &str| lapwing_in(folder.path(), "", &[&train[..], &[out]].concat());
    for out in ["data/episodes.csv", "brake.onnx", "brake"] {
        let (status, _, err) = run(out);
        assert_eq!(status, 2, "{err}");
        assert!(err.contains(&format!("--out: expected a file ending in .safetensors, got {out}")), "{err}");
    }
    assert_eq!(fs::read_to_string(folder.path().join("data/episodes.csv")).unwrap(), table);
    let (status, _, err) = run("brake.safetensors");
    assert_eq!(status, 1, "{err}");
    assert!(err.contains("brake.state.safetensors: no resume state"), "{err}");
    assert!(err.contains("expected episodes of the part train, got none"), "{err}");
}

#[test]
fn a_network_is_trained_on_episodes_judged_on_others_and_watches_over_a_drive() {
    let folder = tempdir().unwrap();
    let data = folder.path().join("data");
    fs::create_dir(&data).unwrap();
    let mut table = "name,part,scenario,kind,layer,seed,track,speed_mph,reaction_s,hit\n".to_owned();
    // Fast ones: at 10 km/h the brake is hardly pressed before it would be the reverse gear.
    for (seed, part) in [("4", "train"), ("5", "train"), ("4", "validation"), ("5", "held-out")] {
        let flags = ["--brake-guard", "ttc", "--recordings", "runs", "--max-time", "12"];
        let card = driven(folder.path(), "ccrs", seed, &flags);
        let run = folder.path().join(card["run"].as_str().unwrap());
        fs::rename(run, data.join(format!("{part}-{seed}.mcap"))).unwrap();
        table += &format!("{part}-{seed},{part},ccrs,hazard,plain,{seed},lake,20,0.9,0\n");
    }
    fs::write(data.join("episodes.csv"), table).unwrap();
    let recipe = "network = \"brake-live\"\nepochs = 2\nwindows_per_epoch = 32\nbatch = 8\nlead = 0.5\nhold = true\n";
    fs::write(folder.path().join("brake.toml"), recipe).unwrap();
    let run = |arguments: &[&str]| lapwing_in(folder.path(), "", arguments);
    let train = ["brake", "train", "--recipe", "brake.toml", "--data", "data", "--out", "brake.safetensors"];
    let (status, out, err) = run(&train);
    assert_eq!(status, 0, "{err}");
    assert!(out.starts_with("brake.safetensors (threshold ") && err.contains("epoch 2 after"), "{out}{err}");
    let trained = fs::read(folder.path().join("brake.safetensors")).unwrap();
    for (state, expected) in
        [(true, "is the state of an earlier training: resume it"), (false, "without a resume state")]
    {
        if !state {
            fs::remove_file(folder.path().join("brake.state.safetensors")).unwrap();
        }
        let (status, _, err) = run(&[&train[..], &["--seed", "5"]].concat());
        assert!(status == 1 && err.contains(expected), "{status}: {err}");
    }
    assert!(fs::read(folder.path().join("brake.safetensors")).unwrap() == trained);
    fs::write(folder.path().join("more.toml"), format!("{recipe}pretrained = \"brake.safetensors\"\n")).unwrap();
    let more =
        ["brake", "train", "--recipe", "more.toml", "--data", "data", "--out", "new/more.safetensors", "--epochs", "1"];
    let (status, out, err) = run(&more);
    assert_eq!(status, 0, "{err}");
    assert!(out.starts_with("new/more.safetensors (threshold ") && err.contains("epoch 1 after"), "{out}{err}");
    let evaluate = ["brake", "evaluate", "brake.safetensors", "--data", "data", "--plot", "curve.svg"];
    let (status, out, err) = run(&evaluate);
    assert_eq!(status, 0, "{err}");
    assert!(out.contains("1 episode") && out.contains("no speed") && out.contains("targets"), "{out}");
    assert!(fs::read_to_string(folder.path().join("curve.svg")).unwrap().contains("precision"));
    let (_, out, _) = run(&[&evaluate[..], &["--json"]].concat());
    let report: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&report["all"]["episodes"], report["speed_failed"].as_array().unwrap().len()), (&1.into(), 3));
    let card = driven(folder.path(), "ccrs", "5", &["--no-recording", "--brake-model", "brake.safetensors"]);
    assert!(card["guard_activations"].is_u64() && card["latency_ms"]["guard"]["p50"].is_f64(), "{card}");
    let (status, _, err) = run(&["brake", "evaluate", "brake.safetensors", "--data", "runs"]);
    assert_eq!(status, 1);
    assert!(err.contains("expected the table of a data set of lapwing brake record"), "{err}");
}

#[test]
fn each_recorded_hazard_is_labelled_as_one_emergency_and_nothing_harmless_is() {
    let folder = tempdir().unwrap();
    let record = ["brake", "record", "--out", "data", "--hours", "0.02", "--seed", "3"];
    let (status, out, err) = lapwing_in(folder.path(), "", &record);
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.contains(" (0 kept), 0.02 hours, in data"), "{out}");
    let table = fs::read_to_string(folder.path().join("data/episodes.csv")).unwrap();
    for row in table.lines().skip(1) {
        let fields: Vec<_> = row.split(',').collect();
        let run = folder.path().join("data").join(format!("{}.mcap", fields[0]));
        let found = Labelled::open(&run, LabelRule::default()).unwrap().found();
        assert_eq!(found.emergencies_s.len(), usize::from(fields[3] == "hazard"), "{row}: {found:?}");
        assert_eq!(found.moments.to_string(), fields[9], "{row}");
    }
    assert!(table.lines().count() > 4, "{table}");
    let (status, out, err) = lapwing_in(folder.path(), "", &[&record[..], &["--part", "held-out", "--json"]].concat());
    assert_eq!((status, err.as_str()), (0, ""));
    let report: serde_json::Value = serde_json::from_str(&out).unwrap();
    let held_out = table.lines().filter(|row| row.split(',').nth(1) == Some("held-out")).count();
    assert_eq!(
        (&report["part"], &report["kept"], &report["episodes"]),
        (&json!("held-out"), &json!(held_out), &json!(held_out))
    );
}

#[test]
fn a_trial_tells_what_a_guard_avoids_in_a_table_a_file_and_a_page_with_films() {
    let folder = tempdir().unwrap();
    let run = |arguments: &[&str]| lapwing_in(folder.path(), "", arguments);
    // What is named twice is driven once.
    let less = ["--cases", "ccrs,steel-plate,ccrs", "--speeds", "20,20", "--seeds", "2", "--laps", "0"];
    let trial = |more: &[&str]| run(&[&["brake", "trial"], &less[..], more].concat());
    let (status, out, err) = trial(&[]);
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.ends_with("guard: none; roads, looks and weather: held-out; speeds in mph\n"), "{out}");
    let (status, out, err) = trial(&["--brake-guard", "ttc", "--out", "runs", "--json"]);
    assert_eq!(status, 0, "{err}");
    let result: serde_json::Value = serde_json::from_str(&out).unwrap();
    let drives = result["drives"].as_array().unwrap().len();
    assert_eq!((result["planned"].as_u64(), result["interrupted"].as_bool()), (Some(drives as u64), Some(false)));
    let row = &result["hazards"][0];
    assert_eq!((row["hit_without"].as_u64(), row["avoidable"].as_u64()), (Some(2), Some(2)), "{row}");
    assert_eq!((row["hit_with"].as_u64(), row["avoided"].as_u64()), (Some(0), Some(2)), "{row}");
    assert_eq!(result["harmless"][0]["activations"].as_u64(), Some(0), "{out}");
    let page = fs::read_to_string(folder.path().join("runs/trial.html")).unwrap();
    assert_eq!(page.matches("data:video/mp4;base64,").count(), 2);
    assert!(folder.path().join("runs/films/ccrs.mp4").is_file());
    assert!((result["threshold"].as_f64().unwrap() - 1.0 / 1.4).abs() < 1e-9, "{}", result["threshold"]);
    let (status, _, err) = trial(&["--out", "runs"]);
    assert!(status == 1 && err.contains("trial.json") && err.contains("choose another folder"), "{status}: {err}");
    let (status, out, err) = trial(&["--layers", "hidden", "--json"]);
    assert!(status == 0 && err.contains("steel-plate"), "it has no such layer: {err}");
    let hidden: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert!(hidden["drives"].as_array().unwrap().iter().all(|drive| drive["layer"] == "hidden"), "{out}");
    let (status, _, err) = run(&["brake", "trial", "--cases", "steel-plate", "--layers", "hidden"]);
    assert_eq!(status, 2, "{err}");
    let (status, out, err) = trial(&["--part", "train", "--json"]);
    assert_eq!(status, 0, "{err}");
    let learnt: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&result["part"], &learnt["part"]), (&"held-out".into(), &"train".into()));
    assert_ne!(result["drives"][0]["track"], learnt["drives"][0]["track"], "each part has its own roads");
    let (status, _, err) = trial(&["--layers", "fog"]);
    assert_eq!(status, 2);
    assert!(err.contains("expected one of plain, hidden, rain, low-sun, night"), "{err}");
}
