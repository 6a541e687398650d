//! The program itself: exit status, and what goes where.

use std::{
    path::Path,
    process::{Command, Output},
};

use crate::support::torchscript;

pub fn lapwing(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("LAPWING_CONTROL__KI", "0.002")
        .env("XDG_CONFIG_HOME", "/nonexistent") // the settings of anyone who runs the tests
        .output()
        .unwrap()
}

pub fn said(output: &Output) -> (i32, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
}

const RUN: &str = "recordings/lake.mcap";

/// What the program prints where stdout and stderr are a terminal.
#[cfg(unix)]
fn in_a_terminal(arguments: &[&str], no_color: Option<&str>) -> String {
    use std::{fs::File, io::Read, os::fd::FromRawFd, ptr::null_mut};
    let (mut ours, mut its) = (0, 0);
    // SAFETY: both descriptors are written before it returns 0, and what is null is left out.
    let opened = unsafe { libc::openpty(&mut ours, &mut its, null_mut(), null_mut(), null_mut()) };
    assert_eq!(opened, 0, "no pseudo-terminal: {}", std::io::Error::last_os_error());
    // SAFETY: they are open, and nobody else's.
    let (mut ours, its) = unsafe { (File::from_raw_fd(ours), File::from_raw_fd(its)) };
    let mut command = Command::new(env!("CARGO_BIN_EXE_lapwing"));
    command
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("XDG_CONFIG_HOME", "/nonexistent")
        .env("TERM", "xterm")
        .env("LAPWING_LOG", "lapwing=debug")
        .stdin(std::process::Stdio::null())
        .stdout(its.try_clone().unwrap())
        .stderr(its);
    for name in ["NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE"] {
        command.env_remove(name);
    }
    if let Some(value) = no_color {
        command.env("NO_COLOR", value);
    }
    let mut child = command.spawn().unwrap();
    drop(command); // and with it our hold on the program's end
    let (mut printed, mut piece) = (vec![], [0; 4096]);
    // Once the program has ended, reading is an error on Linux, and the end elsewhere.
    while let Ok(read @ 1..) = ours.read(&mut piece) {
        printed.extend_from_slice(&piece[..read]);
    }
    child.wait().unwrap();
    String::from_utf8_lossy(&printed).into_owned()
}

/// Escape codes for colours and weights of letters: ESC [ digits m. Others move the cursor, for a line of progress.
#[cfg(unix)]
fn colours(printed: &str) -> usize {
    let ends_in_m = |code: &&str| code.trim_start_matches(|c: char| c.is_ascii_digit() || c == ';').starts_with('m');
    printed.split("\u{1b}[").skip(1).filter(ends_in_m).count()
}

#[cfg(unix)]
#[test]
fn a_terminal_gets_colours_and_none_with_no_color() {
    // Help on stdout, wrong usage on stderr, the log.
    for (arguments, words) in [
        (&["--help"][..], "Drives, simulates, records"),
        (&["drive", "--sped", "3"], "unexpected argument"),
        (&["replay", RUN], "INFO"),
    ] {
        let coloured = in_a_terminal(arguments, None);
        assert!(colours(&coloured) > 0 && coloured.contains(words), "{arguments:?}: {coloured:?}");
        assert!(colours(&in_a_terminal(arguments, Some(""))) > 0, "{arguments:?}: an empty NO_COLOR asks for nothing");
        let plain = in_a_terminal(arguments, Some("1"));
        assert!(colours(&plain) == 0 && plain.contains(words), "{arguments:?}: {plain:?}");
    }
}

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

/// A folder of so many rows as the stock recorder leaves it, with pictures of the given kind.
pub fn folder(rows: usize, picture: impl Fn(usize) -> Vec<u8>) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("IMG")).unwrap();
    let mut log = String::new();
    for row in 0..rows {
        std::fs::write(dir.path().join(format!("IMG/{row}.jpg")), picture(row)).unwrap();
        log += &format!("IMG/{row}.jpg,,,{},0.5,0,9.1\n", (row as f64 * 0.7).sin() / 2.0);
    }
    std::fs::write(dir.path().join("driving_log.csv"), log).unwrap();
    dir
}

#[test]
fn a_replay_of_frames_that_no_network_saw_fails_unless_they_are_allowed() {
    let png = b"\x89PNG\r\n\x1a\n".to_vec();
    let (all, golden) = (folder(40, |_| png.clone()), tempfile::tempdir().unwrap());
    let golden = golden.path().join("m.golden");
    let (all, golden) = (all.path().to_str().unwrap(), golden.to_str().unwrap());
    let (code, out, err) = said(&lapwing(&["replay", all, "--write-golden", golden]));
    assert_eq!(code, 1, "{out}{err}");
    assert!(out.contains("bad frames              40 (100.0 %): no network saw them"), "{out}");
    assert!(out.contains("steering error   not measurable: no network saw a frame"), "{out}");
    assert!(err.contains("expected at most 1 % bad frames, which no network sees, got 40 of 40"), "{err}");
    assert!(!Path::new(golden).exists(), "what failed is not kept to compare with");

    let (code, out, err) = said(&lapwing(&["replay", all, "--allow-bad-frames", "--json", "--write-golden", golden]));
    assert_eq!(code, 0, "{out}{err}");
    let result: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&result["bad_frames"], &result["steering"], &result["latency"]), (&40.into(), &NULL, &NULL));
    assert_eq!(result["card"]["not_measurable"]["steering_mae"], "no network saw a frame");
    // Frames that are seen now are not those that were not.
    let seen = folder(40, |row| crate::support::jpeg(row as u8));
    let (code, out, err) = said(&lapwing(&["replay", seen.path().to_str().unwrap(), "--golden", golden]));
    assert_eq!(code, 1, "{out}{err}");
    assert!(out.contains("40 differ") && out.contains("expected a bad frame, which no network saw"), "{out}");
    // Of a hundred one may be bad, and is told.
    let one = folder(100, |row| if row == 7 { png.clone() } else { crate::support::jpeg(row as u8) });
    let (code, out, err) = said(&lapwing(&["replay", one.path().to_str().unwrap()]));
    assert_eq!(code, 0, "{out}{err}");
    assert!(out.contains("(1.0 %): no network saw them") && out.contains("over 99 frames"), "{out}");
}

/// The program in a folder of its own, with settings of its own for all folders, or none.
pub fn lapwing_in(folder: &Path, own_settings: &str, arguments: &[&str]) -> (i32, String, String) {
    let config = tempfile::tempdir().unwrap();
    std::fs::create_dir(config.path().join("lapwing")).unwrap();
    std::fs::write(config.path().join("lapwing/lapwing.toml"), own_settings).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(arguments)
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", config.path())
        .output();
    said(&output.unwrap())
}

#[test]
fn a_training_without_data_asks_for_data_first() {
    let (code, out, err) = said(&lapwing(&["train", "--out", "/nowhere"]));
    assert_eq!((code, out.as_str()), (2, ""));
    assert!(err.contains("<--data <DIR[@WEIGHT]>...|--recipe <FILE>|--resume>"), "{err}");
}

#[test]
fn a_closed_loop_in_which_no_network_saw_a_frame_fails_unless_that_is_allowed() {
    let (dir, data) = (tempfile::tempdir().unwrap(), folder(20, |row| crate::support::jpeg(row as u8)));
    torchscript(&dir.path().join("lost.pt"), crate::support::lost_for_words);
    let closed_loop = ["replay", data.path().to_str().unwrap(), "--closed-loop", "--model", "lost.pt"];
    let (code, out, err) = lapwing_in(dir.path(), "", &closed_loop);
    assert_eq!(code, 1, "{out}{err}");
    assert!(out.contains("; no network saw 20 of them"), "{out}");
    assert!(err.contains("expected at most 1 % bad frames, which no network sees, got 20 of 20"), "{err}");
    let (code, out, err) = lapwing_in(dir.path(), "", &[&closed_loop[..], &["--allow-bad-frames"]].concat());
    assert_eq!(code, 0, "{out}{err}");
}

#[test]
fn a_run_along_a_recording_says_its_rules_and_its_pace_apart_from_its_frame_rate() {
    let dir = tempfile::tempdir().unwrap();
    let runs = dir.path().to_str().unwrap();
    let along = ["replay", RUN, "--closed-loop", "--json", "--recordings", runs];
    let rules = ["--from-path", "--limit", "0.3", "--rows", "0..60"];
    let (code, out, err) = said(&lapwing(&[&along[..], &rules[..]].concat()));
    assert_eq!(code, 0, "{out}{err}");
    assert_eq!(out.matches("\"frames_per_s\": ").count(), 1, "{out}");
    assert!(out.contains("\"times_real_time\": "), "{out}");
    let (code, out, err) = said(&lapwing(&["score", runs, "--json"]));
    assert_eq!(code, 0, "{out}{err}");
    let scored: serde_json::Value = serde_json::from_str(&out).unwrap();
    let expected = "lake (recorded), limit 0.3 m, dave2, from the recorded path, rows 0..60";
    assert_eq!(scored["runs"][0]["setting"], expected, "{scored}");
}

const NULL: serde_json::Value = serde_json::Value::Null;

#[test]
fn a_golden_file_tells_the_processor_and_a_difference_names_both() {
    let dir = tempfile::tempdir().unwrap();
    let golden = dir.path().join("lake.golden");
    let golden = golden.to_str().unwrap();
    assert_eq!(said(&lapwing(&["replay", RUN, "--write-golden", golden])).0, 0);
    let text = std::fs::read_to_string(golden).unwrap();
    let here = lapwing_learn::nn::runtime::processor();
    let header: serde_json::Value = serde_json::from_str(text.lines().next().unwrap()).unwrap();
    assert_eq!(header["written_on"]["cpu"], here.as_str());
    assert!(header["written_on"]["libtorch"].as_str().unwrap().starts_with("2.13.0"), "{header}");
    std::fs::write(golden, text.replacen(&here, "another processor", 1)).unwrap();
    let faster = &["replay", RUN, "--golden", golden, "--speed", "20"];
    let (code, out, err) = said(&lapwing(faster));
    assert_eq!(code, 1, "{out}{err}");
    assert!(out.contains("written on       another processor, libtorch 2.13.0"), "{out}");
    assert!(out.contains(&format!("compared on      {here}, libtorch 2.13.0")), "{out}");
    // One from before processors were told.
    let header =
        r#"{"format":"lapwing-golden/1","source":"recordings/lake.mcap","driver":"pilotnet (built in)","frames":225}"#;
    let (_, frames) = text.split_once('\n').unwrap();
    std::fs::write(golden, format!("{header}\n{frames}")).unwrap();
    let (_, out, _) = said(&lapwing(faster));
    assert!(out.contains("written on       not reported"), "{out}");
}

#[test]
fn on_another_processor_the_expert_drives_the_same_and_a_network_to_within_the_tolerance() {
    // As libtorch computes on a processor that knows neither AVX2 nor AVX-512.
    let elsewhere = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lapwing"));
        command.env("ATEN_CPU_CAPABILITY", "default").env("ONEDNN_MAX_CPU_ISA", "SSE41");
        said(&command.args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap())
    };
    let expert = ["drive", "--pilot", "expert", "--max-time", "4", "--no-recording", "--json"];
    let fingerprint = |(code, out, err): (i32, String, String)| {
        assert_eq!(code, 0, "{err}");
        serde_json::from_str::<serde_json::Value>(&out).unwrap()["fingerprint"].clone()
    };
    assert_eq!(fingerprint(elsewhere(&expert)), fingerprint(said(&lapwing(&expert))));
    let (code, out, err) = elsewhere(&["replay", RUN, "--golden", "recordings/lake.golden"]);
    assert_eq!(code, 0, "{out}{err}");
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
    assert!(err.contains("worse: lake, 20 mph: completion: 100 % before"), "{err}");
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
        let (code, out, err) =
            said(&lapwing(&["suite", &suite, "--out", part, "--shard", shard, "--keep-runs", "none"]));
        assert_eq!((code, out.lines().count()), (0, 2), "{out}{err}");
        assert!(err.contains("1 cell, 0 of them already driven"), "{err}");
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
    let mut suite = Command::new(env!("CARGO_BIN_EXE_lapwing"));
    suite.args(["suite", &path("suite.toml"), "--out", &whole, "--keep-runs", "all"]);
    let (code, _, err) = said(&suite.output().unwrap());
    assert!(code == 0 && err.contains("2 cells, 2 of them already driven"), "{code} {err}");
    assert!(err.contains("2 of the cells already driven have no run and will not be driven again"), "{err}");
    // Other settings, other drives.
    suite.envs([("LAPWING_PERCEPTION__MAX_PIXELS", "51200"), ("LAPWING_MODEL__PATH", "nowhere.safetensors")]);
    let (code, _, err) = said(&suite.output().unwrap());
    assert!(code == 0 && err.contains("2 cells, 0 of them already driven"), "{code} {err}");
    assert!(err.contains("model.path does not apply to suites"), "{err}");
}

#[test]
fn how_large_pictures_may_be_is_a_setting_of_every_verb_that_looks_at_them() {
    let small = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_lapwing"))
            .args(arguments)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .env("LAPWING_PERCEPTION__MAX_PIXELS", "51199") // one less than the run's 320x160
            .output()
            .unwrap();
        said(&output)
    };
    let words = "expected a JPEG of at most 51199 pixels, got 320x160: perception.max_pixels allows more";
    let (_, out, err) = small(&["dataset", "inspect", RUN]);
    assert!(out.contains(words), "{out}{err}");
    let (code, out, err) = small(&["evaluate", "models/pilotnet.safetensors", "--data", RUN]);
    assert!(code == 1 && err.contains(words), "{code} {out}{err}");
    let (_, out, err) = small(&["replay", RUN]);
    assert!(out.contains(words) || err.contains(words), "{out}{err}");
}

#[test]
fn a_drive_in_which_the_pilot_saw_nothing_fails_with_the_reason() {
    let output = Command::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(["drive", "--max-time", "3", "--no-recording"])
        .env("LAPWING_PERCEPTION__MAX_PIXELS", "51199") // one less than our camera's 320x160
        .output()
        .unwrap();
    let (code, out, err) = said(&output);
    assert_eq!(code, 1, "{out}{err}");
    assert!(err.contains("the first: image: expected a JPEG of at most 51199 pixels"), "{err}");
}

#[test]
fn the_doctor_finds_a_braking_network_that_is_not_there() {
    let output = Command::new(env!("CARGO_BIN_EXE_lapwing"))
        .arg("doctor")
        .envs([("LAPWING_BRIDGE__PORT", "0"), ("LAPWING_BRAKE__MODEL", "nowhere.safetensors")])
        .current_dir(std::env::temp_dir())
        .output()
        .unwrap();
    let (code, out, _) = said(&output);
    assert!(
        code == 1 && out.contains("the guard that brakes in place of the pilot cannot be used: nowhere.safetensors"),
        "{code} {out}"
    );
}

#[test]
fn the_doctor_names_the_braking_network_that_serve_would_use_and_the_port_that_is_free() {
    let network = concat!(env!("CARGO_MANIFEST_DIR"), "/models/brake.safetensors");
    let folder = tempfile::tempdir().unwrap();
    let doctor = |threshold| {
        let arguments = ["doctor", "--port", "0", "--brake-model", network, "--brake-threshold", threshold];
        lapwing_in(folder.path(), "", &arguments)
    };
    let (_, out, _) = doctor("0.5");
    assert!(out.contains(&format!("\nguard       brake-live ({network})\n")) && out.contains(": free\n"), "{out}");
    let (code, out, err) = doctor("2");
    assert_eq!(code, 2, "wrong usage, as in serve: {out}{err}");
}
