//! What CI does with the program, the scripts behind action.yml as a job runs them; and what the program tells of itself and of models.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use crate::program::{lapwing, said};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn executable(folder: &Path, name: &str, text: &str) {
    use std::os::unix::fs::PermissionsExt;
    fs::write(folder.join(name), text).unwrap();
    fs::set_permissions(folder.join(name), fs::Permissions::from_mode(0o755)).unwrap();
}

/// A folder with `lapwing`, and a `gh` that keeps what it is called with.
fn tools(folder: &Path) {
    executable(folder, "lapwing", &format!("#!/bin/sh\nexec '{}' \"$@\"\n", env!("CARGO_BIN_EXE_lapwing")));
    executable(folder, "gh", "#!/bin/sh\necho \"$@\" > gh.called\n");
}

fn script(name: &str, folder: &Path, variables: &[(&str, &str)]) -> Output {
    let path = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap());
    let script = Path::new(ROOT).join("scripts/ci").join(name);
    Command::new(script).current_dir(folder).env("PATH", path).envs(variables.iter().copied()).output().unwrap()
}

#[test]
fn the_steps_of_the_action_drive_score_report_and_comment() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let read = |name: &str| fs::read_to_string(at(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    tools(dir.path());
    let driven = [("LAPWING_TRACKS", "lake jungle"), ("LAPWING_FLAGS", "--max-time 2 --speed 20")];
    let (code, _, err) = said(&script("drive.sh", dir.path(), &driven));
    assert_eq!((code, fs::read_dir(at("lapwing-out/runs")).unwrap().count()), (0, 2), "{err}");

    let asked = [("LAPWING_THRESHOLDS", "--min-completion 100"), ("GITHUB_STEP_SUMMARY", "job.md")];
    let (code, _, err) = said(&script("score.sh", dir.path(), &asked));
    assert_eq!(code, 3, "two seconds are no lap: {err}");
    let summary = read("lapwing-out/summary.md");
    assert!(
        summary.contains("**Below what was asked for:**") && summary.contains("(summary-2-worst.jpg)"),
        "{summary}"
    );
    assert!(!read("job.md").contains("!["), "a job's summary cannot show files");
    assert!(read("lapwing-out/score.xml").contains("<failure") && read("lapwing-out/score.html").contains("<html"));
    let png = image::open(at("lapwing-out/summary-1-map.png")).unwrap();
    assert_eq!(png.width(), 800);
    let worst = image::open(at("lapwing-out/summary-1-worst.jpg")).unwrap();
    assert_eq!((worst.width(), worst.height()), (320, 160));

    // Against its own result nothing is worse; where the pictures are published they are shown.
    fs::copy(at("lapwing-out/score.json"), at("baseline.json")).unwrap();
    let asked = [
        ("LAPWING_BASELINE", "baseline.json"),
        ("LAPWING_PICTURES_AT", "https://example.org/run/"),
        ("GITHUB_STEP_SUMMARY", "published.md"),
    ];
    let (code, _, err) = said(&script("score.sh", dir.path(), &asked));
    assert_eq!(code, 0, "{err}");
    assert!(read("published.md").contains("](https://example.org/run/summary-1-map.png)"));

    // Thresholds of the settings fail the drives themselves: the others are driven all the same, and all are reported.
    fs::write(at("lapwing.toml"), "[thresholds]\nmin_completion = 100\n").unwrap();
    let driven = [driven[0], driven[1], ("LAPWING_OUT", "strict"), ("GITHUB_OUTPUT", "output")];
    assert_eq!(said(&script("drive.sh", dir.path(), &driven)).0, 3);
    assert_eq!(fs::read_dir(at("strict/runs")).unwrap().count(), 2);
    assert_eq!(read("output"), "driven=true\n", "the next step runs all the same");
    let (code, _, err) = said(&script("score.sh", dir.path(), &[driven[2]]));
    assert_eq!(code, 3, "{err}");
    assert!(read("strict/score.xml").contains("<failure") && read("strict/score.json").starts_with('{'));
    fs::remove_file(at("lapwing.toml")).unwrap();
    // What cannot be driven at all is an error at once, and nothing is there to be scored.
    let wrong = [("LAPWING_TRACKS", "nowhere lake"), ("LAPWING_OUT", "none"), ("GITHUB_OUTPUT", "none.output")];
    assert_eq!(said(&script("drive.sh", dir.path(), &wrong)).0, 2);
    assert!(!at("none.output").exists());
    assert_eq!(said(&script("score.sh", dir.path(), &[wrong[1]])).0, 1);

    assert_eq!(said(&script("comment.sh", dir.path(), &[])).0, 0);
    assert!(!at("gh.called").exists(), "there is no pull request");
    let (code, _, err) = said(&script("comment.sh", dir.path(), &[("LAPWING_PULL_REQUEST", "7")]));
    assert_eq!(code, 0, "{err}");
    assert!(read("gh.called").starts_with("pr comment 7 --body-file lapwing-out/comment.md"), "{}", read("gh.called"));
    assert!(!read("lapwing-out/comment.md").contains("!["));
}

#[test]
fn a_drive_that_fails_does_not_keep_the_others_from_being_driven_and_reported() {
    let dir = tempfile::tempdir().unwrap();
    // Each track is named by the exit status of its drive; the drive of 01 leaves no run.
    let lapwing = "#!/bin/sh\n[ \"$3\" = 01 ] || touch \"$5/$3.mcap\"\nexit \"$3\"\n";
    executable(dir.path(), "lapwing", lapwing);
    for (tracks, ended, runs, is_reported) in [
        ("1 3 0", 1, 3, true),
        ("3 1 0", 1, 3, true),
        ("0 3", 3, 2, true),
        ("01 01", 1, 0, false),
        ("0 2 1", 2, 2, false),
    ] {
        let (out, output) = (format!("out {tracks}"), format!("output {tracks}"));
        let variables = [("LAPWING_TRACKS", tracks), ("LAPWING_OUT", &*out), ("GITHUB_OUTPUT", &*output)];
        assert_eq!(said(&script("drive.sh", dir.path(), &variables)).0, ended, "{tracks}");
        assert_eq!(fs::read_dir(dir.path().join(&out).join("runs")).unwrap().count(), runs, "{tracks}");
        assert_eq!(dir.path().join(&output).exists(), is_reported, "{tracks}");
    }
}

#[test]
fn a_run_that_cannot_be_read_is_reported_beside_the_others_and_fails_the_step() {
    let dir = tempfile::tempdir().unwrap();
    tools(dir.path());
    let out = dir.path().join("lapwing-out");
    fs::create_dir_all(out.join("runs")).unwrap();
    fs::copy(Path::new(ROOT).join("recordings/lake.mcap"), out.join("runs/lake.mcap")).unwrap();
    fs::write(out.join("runs/broken.mcap"), "no run").unwrap();
    let (code, _, err) = said(&script("score.sh", dir.path(), &[("GITHUB_STEP_SUMMARY", "job.md")]));
    assert_eq!(code, 1, "{err}");
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert!(read("score.xml").contains("<error") && read("score.xml").contains("lake.mcap"), "{}", read("score.xml"));
    assert!(read("score.json").starts_with('{') && read("score.html").contains("<html"));
    assert!(read("summary.md").contains("lake.mcap") && !fs::read(dir.path().join("job.md")).unwrap().is_empty());
}

#[test]
fn the_action_builds_once_for_each_state_of_the_sources_and_of_the_network() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    for name in ["src/main.rs", "crates/a.rs", "models/pilotnet.safetensors", "scripts/libtorch.py"] {
        fs::create_dir_all(at(name).parent().unwrap()).unwrap();
        fs::write(at(name), name).unwrap();
    }
    for name in ["Cargo.toml", "Cargo.lock", "build.rs"] {
        fs::write(at(name), name).unwrap();
    }
    // Instead of cargo, whose turn it would be.
    fs::write(at("Makefile"), "build:\n\tmkdir -p target/release && cp Makefile target/release/lapwing\n\tchmod +x target/release/lapwing\n\techo built >> log\n").unwrap();
    let run = |name: &str| {
        let (output, path) = (at("output"), at("path"));
        let _ = fs::remove_file(&output);
        let variables = [("GITHUB_ACTION_PATH", dir.path()), ("GITHUB_OUTPUT", &*output), ("GITHUB_PATH", &*path)];
        let (code, _, err) =
            said(&script(name, dir.path(), &variables.map(|(name, value)| (name, value.to_str().unwrap()))));
        assert_eq!(code, 0, "{err}");
        fs::read_to_string(output).unwrap_or_default()
    };
    let key = run("key.sh");
    assert!(key.starts_with("key=") && key.trim().len() == 4 + 64, "{key}");
    for _ in 0..2 {
        run("build.sh");
        assert_eq!(fs::read_to_string(at("log")).unwrap(), "built\n", "the second time it is there");
    }
    assert!(fs::read_to_string(at("path")).unwrap().contains("target/release\n"));
    assert_eq!(run("key.sh"), key, "what is built is no source");
    fs::write(at("models/pilotnet.safetensors"), "another").unwrap();
    assert_ne!(run("key.sh"), key);
}

#[test]
fn the_action_names_the_library_that_onnx_models_need_or_fails() {
    let dir = tempfile::tempdir().unwrap();
    tools(dir.path());
    let at = |name: &str| dir.path().join(name);
    // Instead of pip: it installs what $WHEEL says into the folder behind --target.
    let pip = "#!/bin/sh\nmkdir -p \"$5/onnxruntime/capi\" && touch \"$5/onnxruntime/capi/$WHEEL\"\n";
    executable(dir.path(), "python3", pip);
    let run = |wheel: &str, temp: &str| {
        let (variables, temp) = (at("variables"), at(temp));
        let (temp, variables) = (temp.to_str().unwrap(), variables.to_str().unwrap());
        said(&script(
            "onnxruntime.sh",
            dir.path(),
            &[("WHEEL", wheel), ("RUNNER_TEMP", temp), ("GITHUB_ENV", variables)],
        ))
    };
    let (code, _, err) = run("nothing.py", "one");
    assert!(code == 1 && err.contains("expected a libonnxruntime.so.1"), "{err}");
    assert_eq!(run("libonnxruntime.so.1.24.1", "two").0, 0);
    let library = at("two/onnxruntime/onnxruntime/capi/libonnxruntime.so.1.24.1");
    assert_eq!(fs::read_to_string(at("variables")).unwrap(), format!("ORT_DYLIB_PATH={}\n", library.display()));
}

#[test]
fn the_action_runs_scripts_that_are_there_and_gives_them_variables_that_they_read() {
    let action = fs::read_to_string(Path::new(ROOT).join("action.yml")).unwrap();
    let mut text = String::new();
    for part in action.split("/scripts/ci/").skip(1) {
        let name = part.split('"').next().unwrap();
        text += &fs::read_to_string(Path::new(ROOT).join("scripts/ci").join(name)).unwrap();
    }
    for line in action.lines().filter_map(|line| line.trim().strip_prefix("LAPWING_")) {
        let variable = format!("LAPWING_{}", line.split(':').next().unwrap());
        assert!(text.contains(&variable), "{variable} is given to no script");
    }
    for input in action.split("inputs.").skip(1) {
        let name: String = input.chars().take_while(|c| c.is_ascii_lowercase() || *c == '-').collect();
        assert!(action.contains(&format!("\n  {name}:\n")), "{name} is no input");
    }
}

#[test]
fn the_program_tells_of_itself() {
    let (code, out, _) = said(&lapwing(&["completions", "bash"]));
    assert!(code == 0 && out.contains("_lapwing()") && out.contains("--conditions"), "{out}");
    let (code, out, _) = said(&lapwing(&["man"]));
    assert!(code == 0 && out.contains(".TH lapwing 1"), "{out}");
    let dir = tempfile::tempdir().unwrap();
    let pages = dir.path().join("man1");
    assert_eq!(said(&lapwing(&["man", "--out", pages.to_str().unwrap()])).0, 0);
    assert!(fs::read_to_string(pages.join("lapwing-drive.1")).unwrap().contains("lapwing\\-drive"));
    let file = dir.path().join("race.toml");
    fs::write(&file, "[control]\nspeed_mph = 21\n").unwrap();
    let (code, out, _) = said(&lapwing(&["--config", file.to_str().unwrap(), "config"]));
    let line = out.lines().find(|line| line.starts_with("speed_mph")).unwrap();
    assert!(code == 0 && line.starts_with("speed_mph = 21") && line.ends_with(file.to_str().unwrap()), "{line}");
    let (code, out, _) = said(&lapwing(&["--config", file.to_str().unwrap(), "config", "--json"]));
    let settings: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, &settings["bridge.port"]["origin"]), (0, &"default".into()), "{out}");
}

#[test]
fn a_model_is_checked_and_a_file_of_another_tool_is_told_what_to_do() {
    let run = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap");
    let (code, out, err) = said(&lapwing(&["model", "check", "--run", run]));
    assert!(
        code == 0 && out.contains("input       [1, 3, 66, 200] f32") && out.contains("nothing looks wrong"),
        "{out}{err}"
    );
    let (code, _, err) = said(&lapwing(&["drive", "--model", "net.keras"]));
    assert!(code == 1 && err.contains("a Keras model: in Python, keras.models.load_model"), "{err}");
    let (code, _, err) =
        said(&lapwing(&["model", "rename", "net.onnx", "--network", "pilotnet", "--out", "x.safetensors"]));
    assert!(code == 1 && err.contains("whole networks (.onnx, .pt) drive as they are, with --model"), "{err}");
    let dir = tempfile::tempdir().unwrap();
    let own = dir.path().join("own.safetensors");
    fs::write(&own, "weights").unwrap();
    let own = own.to_str().unwrap();
    let (code, _, err) = said(&lapwing(&["model", "rename", own, "--network", "pilotnet", "--out", own]));
    assert!(code == 1 && err.contains("it is also an input, which would be lost"), "{err}");
    let saved = dir.path().join("saved");
    fs::create_dir(&saved).unwrap();
    fs::write(saved.join("saved_model.pb"), "").unwrap();
    let (code, _, err) = said(&lapwing(&["drive", "--model", saved.to_str().unwrap()]));
    assert!(code == 1 && err.contains("a TensorFlow SavedModel: tf2onnx makes an ONNX model of it"), "{err}");
    // In a folder without a run, a network that cannot be used is told of all the same.
    for (model, told) in [(None, "--run RUN names a recording"), (Some("saved"), "tf2onnx makes an ONNX model of it")] {
        let mut check = Command::new(env!("CARGO_BIN_EXE_lapwing"));
        let checked = check.args(["model", "check"]).args(model).current_dir(dir.path()).output();
        let (code, _, err) = said(&checked.unwrap());
        assert!(code == 1 && err.contains(told), "{err}");
    }
    let out = dir.path().join("net.safetensors");
    // Elsewhere: the file beside the shipped model is its recipe.
    let shipped = dir.path().join("theirs.safetensors");
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/models/pilotnet.safetensors"), &shipped).unwrap();
    let rename = |network| {
        said(&lapwing(&[
            "model",
            "rename",
            shipped.to_str().unwrap(),
            "--network",
            network,
            "--out",
            out.to_str().unwrap(),
        ]))
    };
    let (code, told, err) = rename("pilotnet");
    assert!(code == 0 && told.contains("18 tensors of pilotnet, which has ELU between its layers"), "{told}{err}");
    // It was Lapwing's all along: nothing that it says of itself is lost.
    assert!(told.contains("preprocessing and training: as the checkpoint says"), "{told}");
    assert!(fs::read(&shipped).unwrap() == fs::read(&out).unwrap(), "the same bytes");
    let (code, _, err) = rename("cps");
    assert!(code == 1 && err.contains("expected the layers of cps as PyTorch shapes them, with ReLU"), "{err}");
}
