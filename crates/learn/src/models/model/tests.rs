use std::{path::PathBuf, thread, time::Instant};

use super::*;
use lapwing_core::{perception::Frame, pilot::View, units::Mph};

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/pilotnet.safetensors")
}

/// A drawn frame of the stock simulator's size: a gradient with a bright bend in it.
fn frame() -> Frame {
    let pixel = |i: usize| {
        let (x, y) = (i % 320, i / 320);
        let road = x.abs_diff(100 + y * y / 200) < 20;
        [if road { 220 } else { (x / 2) as u8 }, (y + 60) as u8, 90]
    };
    Frame::new(320, 160, (0..320 * 160).flat_map(pixel).collect()).unwrap()
}

fn steering(pilot: &mut dyn Pilot) -> f64 {
    pilot.steer(&View { speed: Mph::new(20.0).unwrap(), ..View::of(&frame()) }).unwrap().steering
}

fn error(path: &Path) -> String {
    load(path, Instant::now).unwrap_err().to_string()
}

#[test]
fn the_shipped_model_drives() {
    let model = load(shipped(), Instant::now).unwrap();
    assert!(model.name().starts_with("pilotnet ("), "{}", model.name());
    assert_eq!(model.preprocess().shape(), [3, 66, 200]);
    assert_eq!(model.sha256(), sha256(fs::read(shipped()).unwrap()));
    let steering = steering(&mut *model.pilot());
    assert!((-1.0..=1.0).contains(&steering), "{steering}");
}

#[test]
fn two_pilots_of_a_model_give_equal_answers_on_any_thread() {
    let model = load(shipped(), Instant::now).unwrap();
    let expected = steering(&mut *model.pilot());
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let mut pilot = model.pilot();
                for _ in 0..20 {
                    assert_eq!(steering(&mut *pilot), expected);
                }
            });
        }
    });
}

#[test]
fn a_prediction_says_how_long_it_took_by_the_clock_that_was_handed_in() {
    fn frozen() -> Instant {
        static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
        *START
    }
    let took = |clock| {
        let mut pilot = load(shipped(), clock).unwrap().pilot();
        let begin = Instant::now();
        let prediction = pilot.steer(&View::of(&frame())).unwrap();
        (prediction.preprocess, prediction.forward, begin.elapsed())
    };
    let (preprocess, forward, whole) = took(Instant::now);
    assert!(!preprocess.is_zero() && !forward.is_zero() && preprocess + forward <= whole);
    let (preprocess, forward, _) = took(frozen);
    assert!(preprocess.is_zero() && forward.is_zero());
}

#[test]
fn what_is_neither_kind_of_file_or_not_there_is_named() {
    let expected = "expected a model, a file ending in .safetensors, .pt or .onnx, got model";
    assert_eq!(error(Path::new("model.txt")), format!("{expected}.txt"));
    for (ending, kind, todo) in [
        ("h5", "a Keras model in HDF5", "makes an ONNX model of it"),
        ("keras", "a Keras model", "makes an ONNX model of it"),
        ("pth", "weights that PyTorch has pickled", "lapwing model rename"),
    ] {
        let error = error(Path::new(&format!("model.{ending}")));
        assert!(error.starts_with(&format!("{expected}.{ending}, {kind}: ")) && error.contains(todo), "{error}");
    }
    assert_eq!(
        error(Path::new("no.safetensors")),
        "no.safetensors cannot be read: No such file or directory (os error 2)"
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.safetensors");
    fs::write(&path, "").unwrap();
    assert_eq!(error(&path), format!("{}: expected a whole safetensors file: header too small", path.display()));
    let tensors = crate::nn::checkpoint::encode_tensors(Default::default(), vec![], crate::nn::Precision::F32).unwrap();
    fs::write(&path, tensors).unwrap();
    let error = error(&path);
    assert!(error.contains("got tensors alone: lapwing model rename") && error.ends_with("makes one"), "{error}");
}

#[test]
fn a_file_of_ours_that_does_not_steer_is_named_for_what_it_is() {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state.safetensors");
    let position = std::collections::BTreeMap::from([("lapwing.training", "{}")]);
    let tensors = crate::nn::checkpoint::encode_tensors(position, vec![], crate::nn::Precision::F32).unwrap();
    fs::write(&state, tensors).unwrap();
    for (path, got) in [
        (models.join("intersection-ppo.safetensors"), "a policy for agents at an intersection, for lapwing marl"),
        (models.join("brake.safetensors"), "a network that brakes, for --brake-model"),
        (models.join("lane.safetensors"), "a network that finds the lane, for lapwing locate --network"),
        (state, "the resume state of a training run, whose network lies beside it"),
    ] {
        assert_eq!(error(&path), format!("{}: expected a network that steers, got {got}", path.display()));
    }
}

#[test]
fn a_checkpoint_whose_network_answers_no_number_is_refused_when_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wild.safetensors");
    // All weights are finite, but the products of the last layers are not.
    let shipped = fs::read(shipped()).unwrap();
    let file = safetensors::SafeTensors::deserialize(&shipped).unwrap();
    let (_, table) = safetensors::SafeTensors::read_metadata(&shipped).unwrap();
    let huge: Vec<u8> = std::iter::repeat_n(3e38f32.to_le_bytes(), 10).flatten().collect();
    let views = file.iter().map(|(name, view)| {
        let data = if ["fc3.bias", "fc4.weight"].contains(&name) { &huge[..] } else { view.data() };
        (name, safetensors::tensor::TensorView::new(view.dtype(), view.shape().to_vec(), data).unwrap())
    });
    let views: Vec<_> = views.collect();
    fs::write(&path, safetensors::serialize(views, table.metadata().clone()).unwrap()).unwrap();
    Checkpoint::load(&path).unwrap();
    let error = error(&path);
    let expected = format!("{}: expected a finite steering from the network, got ", path.display());
    assert!(error.starts_with(&expected), "{error}");
}
