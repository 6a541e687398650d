//! The shipped network against PyTorch, on the team's real recordings. They are
//! not in this repository: `LAPWING_SHARED` names their folder, `../shared` where
//! it is not set. Without them the tests are skipped, unless
//! `LAPWING_REQUIRE_SHARED=1`.

use std::{
    env, fs,
    path::{Path, PathBuf},
    time::Instant,
};

use lapwing::{
    nn::Checkpoint,
    perception::{Frame, Preprocessor, decode_jpeg},
    pilot::{self, View},
};
use tch::Tensor;

/// The team's folder, or `None` where it is absent and may be.
fn shared() -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let shared = env::var_os("LAPWING_SHARED").map_or_else(|| root.join("../shared"), PathBuf::from);
    if shared.join("parity").is_dir() {
        return Some(shared);
    }
    let notice = format!("no folder parity in {}", shared.display());
    assert!(env::var_os("LAPWING_REQUIRE_SHARED").is_none_or(|v| v != "1"), "{notice}");
    eprintln!("skipped: {notice}");
    None
}

fn model() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("models/pilotnet.safetensors")
}

/// The tensors `input` (1, 3, 66, 200) and `output` (1, 1) that PyTorch wrote.
fn input_and_output(shared: &Path) -> (Tensor, Tensor) {
    let tensors = Tensor::read_safetensors(shared.join("parity/pilotnet-lake-io.safetensors")).unwrap();
    let get = |name| tensors.iter().find(|(n, _)| n == name).unwrap().1.shallow_clone();
    (get("input"), get("output"))
}

fn frame(path: &Path) -> Frame {
    let mut frame = Frame::default();
    decode_jpeg(&fs::read(path).unwrap(), &mut frame).unwrap();
    frame
}

#[test]
fn the_forward_pass_agrees_with_pytorch_within_1e_5() {
    let Some(shared) = shared() else { return };
    let (input, output) = input_and_output(&shared);
    let network = Checkpoint::load(model()).unwrap().network;
    let difference = (network.forward(&input, None, false).unwrap() - output).abs().max().double_value(&[]);
    println!("forward pass: difference {difference:.1e}");
    assert!(difference < 1e-5, "{difference}");
}

#[test]
fn preprocessing_agrees_with_pillow_within_a_few_grey_levels() {
    let Some(shared) = shared() else { return };
    let (input, _) = input_and_output(&shared);
    let frame = frame(&shared.join("recordings/lake/IMG/center_2018_07_16_17_11_44_981.jpg"));
    let mut preprocessor = Preprocessor::new(Checkpoint::load(model()).unwrap().metadata.preprocess).unwrap();
    let mut ours = Vec::new();
    preprocessor.apply(&frame, &mut ours).unwrap();
    let difference = (Tensor::from_slice(&ours).view([1, 3, 66, 200]) - input).abs() * 127.5; // (1, 3, 66, 200), grey levels
    let (mean, worst) = (difference.mean(tch::Kind::Float).double_value(&[]), difference.max().double_value(&[]));
    println!("preprocessing: mean difference {mean:.3}, worst {worst:.2} of 255 grey levels");
    assert!(mean < 0.5 && worst < 5.0, "mean {mean}, worst {worst}");
}

#[test]
fn jpeg_to_steering_agrees_with_pytorch_within_0_01_on_30_real_frames() {
    let Some(shared) = shared() else { return };
    let mut pilot = pilot::load(model(), Instant::now).unwrap().pilot();
    let table = fs::read_to_string(shared.join("parity/pilotnet-lake.csv")).unwrap();
    let (mut frames, mut worst) = (0, (0.0, ""));
    for row in table.lines().skip(1) {
        let (name, expected) = row.split_once(',').unwrap();
        let expected: f64 = expected.parse().unwrap();
        let frame = frame(&shared.join("recordings").join(name));
        let steering = pilot.steer(&View::of(&frame)).unwrap().steering;
        let difference = (steering - expected).abs();
        assert!(difference < 0.01, "{name}: expected {expected}, got {steering}");
        if difference > worst.0 {
            worst = (difference, name);
        }
        frames += 1;
    }
    println!("{frames} frames: worst difference {:.5} on {}", worst.0, worst.1);
    assert_eq!(frames, 30);
}
