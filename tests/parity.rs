//! PilotNet with PyTorch's weights against PyTorch on the team's real recordings, and ResNets
//! against torchvision's on weights and an input that any language can make. They are
//! not in this repository: `LAPWING_SHARED` names their folder, `../shared` where
//! it is not set. Without them the tests are skipped, unless
//! `LAPWING_REQUIRE_SHARED=1`.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Instant,
};

use lapwing_core::{
    perception::{Frame, Preprocessor, decode_jpeg},
    pilot::View,
};
use lapwing_learn::models;
use lapwing_learn::nn::{Architecture, Checkpoint, Design, Metadata, Network, Precision, in_variable_store, save};
use tch::{Device, Kind, Tensor, nn::VarStore};
use tempfile::TempDir;

/// The team's folder, or `None` where it is absent and may be.
fn shared() -> Option<PathBuf> {
    crate::support::shared("parity").map(|parity| parity.with_file_name(""))
}

/// PyTorch's weights as a checkpoint of this project, made for this test.
fn model(shared: &Path) -> (TempDir, PathBuf) {
    let tensors = Tensor::read_safetensors(shared.join("parity/pilotnet-lake.safetensors")).unwrap();
    let design = Design::of(Architecture::PilotNet);
    let network = Network::build(&design, &mut |name, shape, _| {
        let found = tensors.iter().find(|(n, t)| n == name && t.size() == shape);
        Ok(found.unwrap_or_else(|| panic!("no {name}")).1.shallow_clone())
    });
    let metadata = Metadata {
        preprocess: design.preprocess.clone(),
        outputs: vec!["steering".into()],
        training: "PyTorch 2.13".into(),
        result: String::new(),
    };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("pilotnet.safetensors");
    save(&path, &metadata, &network.unwrap(), Precision::F32).unwrap();
    (dir, path)
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
    let network = {
        let (_dir, model) = model(&shared);
        Checkpoint::load(model).unwrap().network
    };
    let difference = (network.forward(&input, None, false).unwrap() - output).abs().max().double_value(&[]);
    println!("forward pass: difference {difference:.1e}");
    assert!(difference < 1e-5, "{difference}");
}

#[test]
fn preprocessing_agrees_with_pillow_within_a_few_grey_levels() {
    let Some(shared) = shared() else { return };
    let (input, _) = input_and_output(&shared);
    let frame = frame(&shared.join("recordings/lake/IMG/center_2018_07_16_17_11_44_981.jpg"));
    let mut preprocessor = Preprocessor::new(Design::of(Architecture::PilotNet).preprocess).unwrap();
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
    let (_dir, model) = model(&shared);
    let mut pilot = models::load(model, Instant::now).unwrap().pilot();
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

/// Numbers in -1..1 from a seed, as the parity folder's README defines them.
fn drawn(state: &mut u32, count: usize) -> Vec<f64> {
    let mut number = || {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(*state >> 8) / f64::from(1 << 24) * 2.0 - 1.0
    };
    (0..count).map(|_| number()).collect()
}

/// A ResNet whose backbone has the README's weights.
fn resnet(architecture: Architecture) -> Network {
    let store = VarStore::new(Device::Cpu);
    let network = Network::build(&Design::of(architecture), &mut in_variable_store(store.root())).unwrap();
    let mut tensors = network.tensors();
    tensors.retain(|(name, _)| !name.starts_with("head."));
    tensors.sort_by(|(a, _), (b, _)| a.cmp(b));
    let mut state = 1;
    for (name, mut tensor) in tensors {
        let size = tensor.size();
        let values = Tensor::from_slice(&drawn(&mut state, tensor.numel())).reshape(&size);
        let values = match name.rsplit('.').next() {
            _ if size.len() == 4 => values * (3.0 / size[1..].iter().product::<i64>() as f64).sqrt(),
            Some("weight") => values * 0.1 + 1.0,
            Some("running_var") => values.abs() * 0.5 + 1.0,
            _ => values * 0.1,
        };
        tch::no_grad(|| tensor.copy_(&values));
    }
    network
}

#[test]
fn the_features_of_resnets_agree_with_torchvision_within_a_thousandth_of_their_deviation() {
    let Some(shared) = shared() else { return };
    let text = fs::read_to_string(shared.join("parity/resnet-features.json")).unwrap();
    let all: serde_json::Value = serde_json::from_str(&text).unwrap();
    let input = drawn(&mut 7, 3 * 160 * 320);
    let input = Tensor::from_slice(&input).to_kind(Kind::Float).reshape([1, 3, 160, 320]); // (1, 3, 160, 320)
    for architecture in [Architecture::ResNet18, Architecture::ResNet50] {
        let expected = &all[architecture.name()];
        let number = |key: &str| expected[key].as_f64().unwrap();
        let network = resnet(architecture);
        let trained = tch::no_grad(|| network.features(&input).unwrap().unwrap()); // (1, N)
        let ready = network.for_inference().unwrap().features(&input).unwrap().unwrap();
        for features in [trained, ready] {
            assert_eq!(features.size(), [1, number("features") as i64]);
            let std = number("std");
            let mut worst = (features.mean(Kind::Float).double_value(&[]) - number("mean")).abs();
            worst = worst.max((features.std(false).double_value(&[]) - std).abs());
            for (i, value) in (0..).zip(expected["first16"].as_array().unwrap()) {
                worst = worst.max((features.double_value(&[0, i]) - value.as_f64().unwrap()).abs());
            }
            println!("{}: worst difference {:.1e} deviations", architecture.name(), worst / std);
            assert!(worst < 1e-3 * std, "{}: {worst}", architecture.name());
        }
    }
}
