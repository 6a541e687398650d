//! Models as files that the program is given: which it refuses, whose code it runs, what it makes of the others.

use std::{path::Path, process::Command};

use crate::{
    program::{folder, lapwing, lapwing_in, said},
    support::torchscript,
};

#[test]
fn the_same_training_makes_the_same_file_bit_for_bit() {
    let data = folder(60, |row| crate::support::jpeg(row as u8));
    let out = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| {
        let out = out.path().join(name);
        let (data, out) = (data.path().to_str().unwrap(), out.to_str().unwrap());
        let flags = ["--network", "cps", "--epochs", "2", "--batch", "16", "--seed", "3"];
        let (code, _, err) = said(&lapwing(&[&["train", "--data", data, "--out", out], &flags[..]].concat()));
        assert_eq!(code, 0, "{err}");
        let log = std::fs::read_to_string(format!("{out}/log.csv")).unwrap();
        assert!(log.starts_with("epoch,seconds,images_per_s,"), "how long it took stands in the log: {log}");
        std::fs::read(format!("{out}/model.safetensors")).unwrap()
    });
    assert!(first == second, "the files differ");
}

#[test]
fn a_file_that_anybody_may_have_written_does_not_run_code_without_the_users_word() {
    let dir = tempfile::tempdir().unwrap();
    let (net, folder) = (dir.path().join("net.pt"), dir.path());
    torchscript(&net, |input| input.mean(tch::Kind::Float) * 0.0);
    let settings = "[model]\npath = \"net.pt\"\n";
    for name in ["lapwing.toml", "other.toml"] {
        std::fs::write(folder.join(name), settings).unwrap();
    }
    let suite = "tracks = [\"lake\"]\nlongest_s = 1.0\n[[pilot]]\nname = \"theirs\"\nmodel = \"net.pt\"\n";
    std::fs::write(folder.join("suite.toml"), suite).unwrap();
    let empty = tempfile::tempdir().unwrap();
    let drive = ["drive", "--max-time", "1", "--no-recording"];
    let of_folder = |own: &str, more: &[&str]| lapwing_in(folder, own, &[&drive[..], more].concat());
    for (code, out, err) in [
        of_folder("", &[]),
        of_folder("", &["--config", "other.toml"]),
        lapwing_in(folder, "", &["serve", "--port", "0"]),
        lapwing_in(folder, "", &["doctor"]),
        lapwing_in(folder, "", &["suite", "suite.toml"]),
        lapwing_in(folder, "", &["replay", concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap")]),
        // The user's own file, with a path that means another file in each folder.
        lapwing_in(folder, settings, &[&drive[..], &["--config", "/dev/null"]].concat()),
    ] {
        assert_eq!((code, out.as_str()), (2, ""), "{err}");
        assert!(err.contains("net.pt is TorchScript, and loading it runs its code"), "{err}");
    }
    let allowed = "[model]\nallow_torchscript = true\n";
    let own = format!("[model]\npath = {net:?}\n");
    for (code, out, err) in [
        of_folder("", &["--model", "net.pt"]),
        of_folder("", &["--allow-torchscript"]),
        of_folder(allowed, &[]),
        lapwing_in(empty.path(), &own, &drive),
        lapwing_in(folder, "", &["suite", "suite.toml", "--allow-torchscript"]),
        lapwing_in(folder, "", &["score", concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap")]),
    ] {
        assert_eq!(code, 0, "{out}{err}");
    }
    // No file but the user's own allows it.
    std::fs::write(folder.join("lapwing.toml"), format!("{settings}allow_torchscript = true\n")).unwrap();
    let (code, _, err) = of_folder("", &[]);
    assert!(code == 2 && err.contains("model.allow_torchscript may only be set in your own settings"), "{err}");
}

#[test]
fn the_users_own_settings_stay_his_where_they_are_named_or_lie_in_the_folder() {
    let config = tempfile::tempdir().unwrap();
    let folder = config.path().join("lapwing");
    std::fs::create_dir(&folder).unwrap();
    let own = folder.join("lapwing.toml");
    std::fs::write(&own, "[model]\nallow_torchscript = true\n").unwrap();
    let score = ["score", concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap")];
    for (folder, more) in [(folder.as_path(), &[][..]), (Path::new("/"), &["--config", own.to_str().unwrap()])] {
        let mut lapwing = Command::new(env!("CARGO_BIN_EXE_lapwing"));
        lapwing.args(score).args(more).current_dir(folder).env("XDG_CONFIG_HOME", config.path());
        let (code, _, err) = said(&lapwing.output().unwrap());
        assert_eq!(code, 0, "{err}");
    }
}

#[test]
fn a_recipe_beside_tensors_is_told_to_be_taken_for_their_preprocessing_and_how_another_is_named() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("net.safetensors"), "").unwrap();
    std::fs::write(dir.path().join("net.toml"), "network = \"pilotnet\"\nepochs = 3\n").unwrap();
    let rename = ["model", "rename", "net.safetensors", "--network", "pilotnet", "--out", "out.safetensors"];
    let (code, out, err) = lapwing_in(dir.path(), "", &rename);
    assert_eq!((code, out.as_str()), (1, ""), "{err}");
    let told = "net.toml beside net.safetensors was read for its preprocessing; --preprocess FILE names another file";
    assert!(err.contains(told) && err.contains("unknown field"), "{err}");
}

#[test]
fn every_verb_that_takes_a_model_says_that_torchscript_is_code() {
    for verb in ["drive", "serve", "replay", "suite", "evaluate", "doctor", "model check"] {
        for help in ["-h", "--help"] {
            let (_, out, _) = said(&lapwing(&verb.split(' ').chain([help]).collect::<Vec<_>>()));
            let words = out.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(words.contains("TorchScript") && words.contains("code"), "{verb} {help}: {out}");
        }
    }
}

/// A checkpoint of the shipped network that answers blank pictures and has nothing finite for others: its first
/// convolution sees differences alone, and calls them huge.
fn checkpoint_of_infinities(path: &Path) {
    let shipped = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/models/pilotnet.safetensors")).unwrap();
    let file = safetensors::SafeTensors::deserialize(&shipped).unwrap();
    let (_, table) = safetensors::SafeTensors::read_metadata(&shipped).unwrap();
    let numbers = |values: Vec<f32>| values.into_iter().flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    let change = |name: &str, data: &[u8]| match name {
        "conv1.weight" => {
            let mut weights = vec![0f32; data.len() / 4];
            // Powers of two, so that equal neighbours come to zero however it is added up.
            (weights[0], weights[1]) = (2f32.powi(127), -2f32.powi(127));
            numbers(weights)
        }
        "conv1.bias" => vec![0; data.len()],
        "conv2.weight" => numbers(vec![1e38; data.len() / 4]),
        _ => data.to_vec(),
    };
    let tensors: Vec<_> = file.iter().map(|(name, view)| (name, view.clone(), change(name, view.data()))).collect();
    let views = tensors.iter().map(|(name, view, data)| {
        (*name, safetensors::tensor::TensorView::new(view.dtype(), view.shape().to_vec(), data).unwrap())
    });
    std::fs::write(path, safetensors::serialize(views, table.metadata().clone()).unwrap()).unwrap();
}

#[test]
fn evaluate_takes_what_drive_takes_and_fails_where_an_answer_is_no_number() {
    let dir = tempfile::tempdir().unwrap();
    let data = folder(20, |row| crate::support::jpeg(row as u8));
    let data = data.path().to_str().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let evaluate = |model: &[&str]| said(&lapwing(&[&["evaluate"], model, &["--data", data, "--json"]].concat()));
    torchscript(Path::new(&path("zero.pt")), |input| input.mean(tch::Kind::Float) * 0.0);
    let (code, out, err) = evaluate(&[&path("zero.pt")]);
    assert_eq!(code, 0, "{out}{err}");
    let result: serde_json::Value = serde_json::from_str(&out).unwrap();
    let mean = (0..20).map(|row| ((f64::from(row) * 0.7).sin() / 2.0).abs()).sum::<f64>() / 20.0;
    let mae = result["results"][0]["raw"]["mae"].as_f64().unwrap();
    assert!((mae - mean).abs() < 1e-6, "{mae} {mean}");
    // The model built in, and the same by its name.
    let [built_in, named] = [&[][..], &["models/pilotnet.safetensors"]].map(|model| {
        let (code, out, err) = evaluate(model);
        assert_eq!(code, 0, "{out}{err}");
        serde_json::from_str::<serde_json::Value>(&out).unwrap()["results"].clone()
    });
    assert_eq!(built_in, named);

    torchscript(Path::new(&path("lost.pt")), crate::support::lost_for_words);
    let (code, out, err) = evaluate(&[&path("lost.pt")]);
    assert_eq!((code, out.as_str()), (1, ""), "{err}");
    assert!(err.contains("IMG/0.jpg: expected a finite steering from the network, got NaN"), "{err}");
    checkpoint_of_infinities(Path::new(&path("wild.safetensors")));
    let (code, out, err) = evaluate(&[&path("wild.safetensors")]);
    assert_eq!((code, out.as_str()), (1, ""), "{err}");
    assert!(err.contains("expected finite answers from pilotnet") && err.contains("20 of 20"), "{err}");
}

#[test]
fn a_model_whose_crop_no_picture_of_ours_fills_is_refused_before_it_drives() {
    let dir = tempfile::tempdir().unwrap();
    let net = dir.path().join("net.pt");
    torchscript(&net, |input| input.mean(tch::Kind::Float) * 0.0);
    let side = std::fs::read_to_string(net.with_extension("toml")).unwrap();
    let crop = "[preprocess]\ncrop = { top = 60, bottom = 200 }\n";
    std::fs::write(net.with_extension("toml"), side.replace("[preprocess]\n", crop)).unwrap();
    let (code, out, err) = lapwing_in(dir.path(), "", &["drive", "--model", "net.pt"]);
    assert_eq!((code, out.as_str()), (1, ""), "{err}");
    assert!(err.contains("expected a frame of at least 200 rows for the crop to row 200, got 320x160"), "{err}");
    assert!(!dir.path().join("recordings").exists(), "nothing is left of it");
}
