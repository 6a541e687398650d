//! The program itself: exit status, and what goes where.

use std::{
    path::Path,
    process::{Command, Output},
};

fn lapwing(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("LAPWING_CONTROL__KI", "0.002")
        .output()
        .unwrap()
}

fn said(output: &Output) -> (i32, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
}

const RUN: &str = "recordings/lake.mcap";

#[test]
fn wrong_usage_is_2_and_says_expected_and_got() {
    for (arguments, words) in [
        (&["serve", "--speed", "-3"][..], "--speed: control.speed_mph: expected a speed above 0 mph, got -3 mph"),
        (&["serve", "--port", "99999"], "99999"),
        (&["replay", RUN, "--rate", "0"], "expected real, max, or frames a second"),
        (&["replay", RUN, "--connect", "x:1", "--culture", "tlh"], "expected one of en-US, de-DE"),
        (&["replay", RUN, "--golden", "x", "--tolerance", "-1"], "expected a number of at least 0"),
        (&["--config", "/nowhere.toml", "doctor"], "/nowhere.toml: cannot be read"),
    ] {
        let (code, out, err) = said(&lapwing(arguments));
        assert_eq!((code, out.as_str()), (2, ""), "{arguments:?}: {err}");
        assert!(err.contains(words), "{arguments:?}: {err}");
    }
}

#[test]
fn a_file_that_is_not_there_is_1_and_named_once() {
    let (code, out, err) = said(&lapwing(&["replay", "nowhere.mcap"]));
    assert_eq!((code, out.as_str()), (1, ""));
    assert_eq!(err.matches("os error 2").count(), 1, "{err}");
    assert!(err.contains("nowhere.mcap"), "{err}");
}

#[test]
fn a_replay_that_agrees_is_0_and_one_that_does_not_is_1_with_the_frames_named() {
    let golden = "recordings/lake.golden";
    let (code, out, err) = said(&lapwing(&["replay", RUN, "--golden", golden]));
    assert_eq!(code, 0, "{out}{err}");
    assert!(out.contains("every command agrees within 0.001"), "{out}");
    let (code, out, err) = said(&lapwing(&["replay", RUN, "--golden", golden, "--speed", "20", "--json"]));
    assert_eq!(code, 1, "{out}{err}");
    let result: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(result["golden"]["first"][0]["frame"], 0);
    assert!(result["golden"]["differing_frames"].as_u64().unwrap() > 100, "{result}");
    assert_eq!(result["moments"], 225);
    let card = &result["card"];
    assert_eq!((&card["schema"], &card["steering_mae"]), (&"lapwing.scorecard/1".into(), &result["steering"]["mae"]));
    assert!(card["not_measurable"]["completion"].as_str().unwrap().starts_with("nothing was driven"), "{card}");
}

#[test]
fn the_doctor_names_the_libtorch_that_is_loaded() {
    // Another program may hold port 4567: a free one is asked for instead.
    let output = Command::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(["doctor", "--json"])
        .env("LAPWING_BRIDGE__PORT", "0")
        .current_dir(std::env::temp_dir())
        .output()
        .unwrap();
    let (code, out, err) = said(&output);
    assert_eq!(code, 0, "{out}{err}");
    let findings: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(findings["troubles"], serde_json::json!([]));
    if cfg!(target_os = "linux") {
        assert!(Path::new(findings["libtorch"]["file"].as_str().unwrap()).exists(), "{findings}");
    }
}

#[test]
fn a_score_below_a_threshold_is_3_and_says_what_it_was_in_every_form() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (junit, html, baseline) = (path("a.xml"), path("a.html"), path("a.json"));
    let (code, out, err) = said(&lapwing(&["score", RUN, "--json", "--html", &html]));
    assert_eq!(code, 0, "{out}{err}");
    let result: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&result["schema"], &result["runs"][0]["track"]), (&"lapwing.score/1".into(), &"lake".into()));
    let completion = result["runs"][0]["completion"].as_f64().unwrap();
    assert!((0.05..0.2).contains(&completion), "{completion}");
    assert!(std::fs::read_to_string(&html).unwrap().contains("data:image/jpeg;base64"));

    let (code, out, err) = said(&lapwing(&["score", RUN, "--min-completion", "100", "--junit", &junit]));
    assert_eq!(code, 3, "{out}{err}");
    assert!(err.contains("completion: expected at least 100.0 %, got 1"), "{err}");
    assert!(std::fs::read_to_string(&junit).unwrap().contains(r#"failures="1""#));

    // Against itself nothing is worse; against a better one it is.
    std::fs::write(&baseline, serde_json::to_string(&result).unwrap()).unwrap();
    assert_eq!(said(&lapwing(&["score", RUN, "--against", &baseline])).0, 0);
    let mut better = result.clone();
    better["runs"][0]["completion"] = 1.0.into();
    std::fs::write(&baseline, better.to_string()).unwrap();
    let (code, _, err) = said(&lapwing(&["score", RUN, "--against", &baseline, "--junit", &junit]));
    assert_eq!(code, 3, "{err}");
    assert!(err.contains("worse: lake, 20 mph: completion: 100.0 % before"), "{err}");
    assert!(std::fs::read_to_string(&junit).unwrap().contains(r#"failures="1""#));

    // What cannot be read does not keep the others from being scored.
    let broken = path("broken.mcap");
    std::fs::write(&broken, b"noise").unwrap();
    let (code, out, err) = said(&lapwing(&["score", RUN, &broken, "--junit", &junit]));
    assert!(code == 1 && out.contains("completion") && err.contains("1 of 2 runs cannot be scored"), "{out}{err}");
    assert!(std::fs::read_to_string(&junit).unwrap().contains(r#"errors="1""#));
}

#[test]
fn a_suite_drives_each_cell_on_its_own_road_and_none_twice() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (suite, parts, whole) = (path("suite.toml"), [path("one"), path("two")], path("whole"));
    let text = "tracks = [\"lake\", \"mountain\"]\nlongest_s = 2.0\n[[pilot]]\nname = \"expert\"\nexpert = true\n";
    std::fs::write(&suite, text).unwrap();
    for (shard, part) in ["1/2", "2/2"].into_iter().zip(&parts) {
        let (code, out, err) = said(&lapwing(&["suite", &suite, "--out", part, "--shard", shard]));
        assert_eq!((code, out.lines().count()), (0, 2), "{out}{err}");
        assert!(err.contains("1 cells, 0 of them driven before"), "{err}");
    }
    let (code, out, err) = said(&lapwing(&["merge", &parts[0], &parts[1], "--out", &whole]));
    assert_eq!((code, out.lines().count()), (0, 3), "{out}{err}");
    let mut roads = vec![];
    for cell in std::fs::read_dir(format!("{whole}/cells")).unwrap() {
        let cell: serde_json::Value = serde_json::from_slice(&std::fs::read(cell.unwrap().path()).unwrap()).unwrap();
        assert_eq!(cell["cell"]["track"], cell["card"]["track"]);
        roads.push(cell["card"]["track"].as_str().unwrap().to_owned());
    }
    roads.sort();
    assert_eq!(roads, ["lake", "mountain"]);
    let (code, _, err) = said(&lapwing(&["suite", &suite, "--out", &whole]));
    assert_eq!(code, 0);
    assert!(err.contains("2 cells, 2 of them driven before"), "{err}");
}
