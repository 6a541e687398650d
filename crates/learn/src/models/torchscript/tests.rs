use std::{fs, path::PathBuf, time::Instant};

use tch::{Device, Kind, Tensor};

use super::*;
use crate::models::load;
use lapwing_core::{
    perception::Frame,
    pilot::{Pilot, View},
};

/// A drawn frame of the stock simulator's size.
fn frame() -> Frame {
    let pixel = |i: usize| [(i % 320 / 2) as u8, (i / 320 + 60) as u8, 90];
    Frame::new(320, 160, (0..320 * 160).flat_map(pixel).collect()).unwrap()
}

/// Writes a module that answers half the mean of its input, and a side file.
fn torchscript(folder: &Path, side: Option<&str>) -> PathBuf {
    let path = folder.join("mean.pt");
    let input = [Tensor::ones([1, 3, 4, 8], (Kind::Float, Device::Cpu))];
    let mut half_of_mean = |inputs: &[Tensor]| vec![inputs[0].mean_dim([1i64, 2, 3].as_slice(), false, None) * 0.5];
    CModule::create_by_tracing("Mean", "forward", &input, &mut half_of_mean).unwrap().save(&path).unwrap();
    if let Some(side) = side {
        fs::write(folder.join("mean.toml"), side).unwrap();
    }
    path
}

const SIDE: &str = r#"
outputs = ["steering"]

[preprocess]
resize = { height = 4, width = 8, filter = "bilinear-antialiased" }
colour = "rgb"
scale = "x/255"
layout = "nchw"
"#;

fn error(path: &Path) -> String {
    load(path, Instant::now).unwrap_err().to_string()
}

#[test]
fn a_torchscript_module_drives_by_its_first_output() {
    let folder = tempfile::tempdir().unwrap();
    let model = load(torchscript(folder.path(), Some(SIDE)), Instant::now).unwrap();
    assert!(model.name().starts_with("torchscript ("), "{}", model.name());
    let mean = frame().rgb().iter().map(|x| f64::from(*x)).sum::<f64>() / frame().rgb().len() as f64;
    for _ in 0..2 {
        let steering = model.pilot().steer(&View::of(&frame())).unwrap().steering;
        assert!((steering - mean / 255.0 / 2.0).abs() < 0.005, "{steering} {mean}");
    }
}

#[test]
fn a_torchscript_module_without_a_side_file_names_the_file_it_wants() {
    let folder = tempfile::tempdir().unwrap();
    let path = torchscript(folder.path(), None);
    let at = folder.path().display();
    assert_eq!(
        error(&path),
        format!(
            "expected {at}/mean.toml next to {at}/mean.pt to name the preprocessing (docs/how-to/own-network.md shows one), and cannot read it: No such file or directory (os error 2)"
        )
    );
}

#[test]
fn a_side_file_with_an_unknown_or_missing_key_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let unknown = error(&torchscript(folder.path(), Some(&SIDE.replace("outputs", "output"))));
    assert!(unknown.contains("mean.toml: TOML parse error at line 2"), "{unknown}");
    assert!(unknown.contains("unknown field `output`, expected `outputs` or `preprocess`"), "{unknown}");
    let missing = error(&torchscript(folder.path(), Some("outputs = [\"steering\"]")));
    assert!(missing.contains("missing field `preprocess`"), "{missing}");
    let other = error(&torchscript(folder.path(), Some(&SIDE.replace("steering", "brake"))));
    assert!(other.ends_with(r#"mean.pt: expected a network whose first output is steering, got ["brake"]"#), "{other}");
}

/// A zip of stored files, as `torch.save` writes.
fn zip(files: &[(&str, &[u8])]) -> Vec<u8> {
    let crc = |data: &[u8]| {
        !data.iter().fold(!0u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
        })
    };
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, data) in files {
        let (offset, size) = (out.len() as u32, data.len() as u32);
        // Version, flags, method and time; then CRC, sizes and lengths of name and extra: alike in both headers.
        let mut common = vec![20, 0, 0, 0, 0, 0, 0, 0, 0x21, 0];
        common.extend([crc(data), size, size, name.len() as u32].into_iter().flat_map(u32::to_le_bytes));
        out.extend([&b"PK\x03\x04"[..], &common, name.as_bytes(), data].concat());
        directory
            .extend([&b"PK\x01\x02\x14\0"[..], &common, &[0; 10], &offset.to_le_bytes(), name.as_bytes()].concat());
    }
    let (begin, size, count) = (out.len() as u32, directory.len() as u32, files.len() as u8);
    out.extend(directory);
    out.extend(
        [&b"PK\x05\x06\0\0\0\0"[..], &[count, 0, count, 0], &size.to_le_bytes(), &begin.to_le_bytes(), &[0; 2]]
            .concat(),
    );
    out
}

#[test]
fn a_pt_that_is_no_torchscript_is_told_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = torchscript(folder.path(), Some(SIDE));
    let whole = fs::read(&path).unwrap();
    // An empty dictionary in a zip is what torch.save makes of a state_dict; before PyTorch 1.6 it was the bare pickle.
    let pickled = zip(&[("archive/data.pkl", b"\x80\x02}q\x00."), ("archive/version", b"3\n")]);
    for (bytes, why) in [
        (pickled, "PytorchStreamReader failed locating file constants.pkl: file not found"),
        (b"\x80\x02}q\x00.".to_vec(), "istream reader failed: getting the current position."),
        (vec![], "istream reader failed: getting the current position."),
        (whole[..whole.len() / 2].to_vec(), "PytorchStreamReader failed reading zip archive"),
    ] {
        fs::write(&path, bytes).unwrap();
        // Nobody needs to write that first.
        _ = fs::remove_file(path.with_extension("toml"));
        let (error, path) = (error(&path), path.display());
        let expected = format!(
            "expected {path} to be a TorchScript module, saved by torch.jit.save and not by torch.save; libtorch: {why}"
        );
        assert!(error.starts_with(&expected) && error.contains("then lapwing model rename"), "{error}");
        assert_eq!(error.lines().count(), 1, "{error}");
    }
}

#[test]
fn a_torchscript_module_that_takes_another_shape_is_refused_when_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("linear.pt");
    let input = [Tensor::ones([1, 3, 4, 8], (Kind::Float, Device::Cpu))];
    let weight = Tensor::ones([1, 96], (Kind::Float, Device::Cpu));
    let mut linear = |inputs: &[Tensor]| vec![inputs[0].flatten(1, -1).linear::<&Tensor>(&weight, None)];
    CModule::create_by_tracing("Linear", "forward", &input, &mut linear).unwrap().save(&path).unwrap();
    fs::write(folder.path().join("linear.toml"), SIDE.replace("height = 4", "height = 5")).unwrap();
    let error = error(&path);
    assert!(error.contains("linear.pt: libtorch: ") && error.lines().count() == 1, "{error}");
}

/// Writes a module that answers what `answer` makes of its input, (1, 3, 4, 8), and the side file.
fn traced(folder: &Path, answer: impl Fn(&Tensor) -> Tensor) -> PathBuf {
    let path = folder.join("traced.pt");
    let input = [Tensor::ones([1, 3, 4, 8], (Kind::Float, Device::Cpu))];
    let mut answer = |inputs: &[Tensor]| vec![answer(&inputs[0])];
    CModule::create_by_tracing("Traced", "forward", &input, &mut answer).unwrap().save(&path).unwrap();
    fs::write(path.with_extension("toml"), SIDE).unwrap();
    path
}

#[test]
fn a_torchscript_module_that_answers_another_shape_than_its_outputs_or_no_number_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let three = traced(folder.path(), |x| x.mean_dim([2i64, 3].as_slice(), false, None));
    let named = format!("{}: expected ", three.display());
    assert_eq!(
        error(&three),
        format!(
            "{named}1 number from the network for its outputs steering, got a tensor of shape [1, 3]: name all of its numbers in outputs"
        )
    );
    let nan = traced(folder.path(), |x| (x.mean(Kind::Float) * 0.0 - 1.0).sqrt());
    assert_eq!(error(&nan), format!("{named}a finite steering from the network, got NaN"));
    let bright = traced(folder.path(), |x| (x.mean(Kind::Float) * -1.0 + 0.9).sqrt());
    assert_eq!(error(&bright), format!("{named}a finite steering from the network, got NaN"), "of white alone");
}

#[test]
fn a_crop_beyond_any_picture_is_refused_when_loaded_and_one_beyond_this_picture_when_it_comes() {
    let folder = tempfile::tempdir().unwrap();
    let with_crop = |bottom: usize| {
        let path = torchscript(folder.path(), None);
        let crop = format!("[preprocess]\ncrop = {{ top = 100, bottom = {bottom} }}");
        fs::write(path.with_extension("toml"), SIDE.replace("[preprocess]", &crop)).unwrap();
        path
    };
    let beyond = error(&with_crop(1000));
    assert!(beyond.ends_with("expected a crop within a picture's rows, 0 to 480, got rows 100 to 1000"), "{beyond}");
    let mut pilot = load(with_crop(300), Instant::now).unwrap().pilot();
    assert_eq!(
        pilot.steer(&View::of(&frame())).unwrap_err().to_string(),
        "expected a frame of at least 300 rows for the crop to row 300, got 320x160"
    );
}

#[test]
fn a_module_that_remembers_begins_each_drive_as_it_was_loaded() {
    // class Counting: forward adds 1 to a buffer n and answers 0.001 * n + 0.5 * x.mean(); torch.jit.script(Counting()).save(…)
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("counting.pt");
    fs::write(&path, include_bytes!("counting.pt")).unwrap();
    fs::write(folder.path().join("counting.toml"), SIDE).unwrap();
    let model = load(path, Instant::now).unwrap();
    let (mut first, mut second) = (model.pilot(), model.pilot());
    let steering = |pilot: &mut dyn Pilot| pilot.steer(&View::of(&frame())).unwrap().steering;
    let begun = steering(&mut *first);
    let later = steering(&mut *first);
    assert!((later - begun - 0.001).abs() < 1e-6, "{begun} {later}");
    assert_eq!(steering(&mut *second), begun, "another car's pilot has seen nothing");
    first.reset();
    assert_eq!(steering(&mut *first), begun, "another drive begins");
}

#[test]
fn what_a_module_cannot_do_with_its_input_is_told_with_the_shape_that_it_got() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sum.pt");
    let input = [Tensor::ones([1, 3, 4, 8], (Kind::Float, Device::Cpu))];
    let weights = Tensor::ones([3 * 4 * 8, 1], (Kind::Float, Device::Cpu));
    let mut sum = |inputs: &[Tensor]| vec![inputs[0].flatten(1, 3).matmul(&weights)];
    CModule::create_by_tracing("Sum", "forward", &input, &mut sum).unwrap().save(&path).unwrap();
    fs::write(folder.path().join("sum.toml"), SIDE.replace("height = 4", "height = 5")).unwrap();
    let error = error(&path);
    assert!(error.contains("cannot be multiplied") && error.contains("[1, 3, 5, 8] f32"), "{error}");
}
