use tch::{
    Device, Kind,
    nn::{OptimizerConfig, Sgd, VarStore},
};

use super::*;
use crate::nn::in_variable_store;

fn fresh(design: &Design) -> (VarStore, Network) {
    let store = VarStore::new(Device::Cpu);
    let network = Network::build(design, &mut in_variable_store(store.root())).unwrap();
    (store, network)
}

/// Small pictures for those that take any size: these tests are about wiring.
fn small(architecture: Architecture, speed: bool) -> Design {
    let mut design = Design { speed, ..Design::of(architecture) };
    if architecture.input_shape().is_none() {
        (design.preprocess.resize.height, design.preprocess.resize.width) = (33, 64);
    }
    design
}

/// (B, C, H, W), or (B, 5, C, H, W).
fn frames(design: &Design, batch: i64) -> Tensor {
    let mut shape = vec![batch];
    if design.architecture.frames() > 1 {
        shape.push(design.architecture.frames() as i64);
    }
    shape.extend(design.preprocess.shape().map(|n| n as i64));
    Tensor::randn(&shape, (Kind::Float, Device::Cpu))
}

/// (B, 1), `Some` if the design uses it.
fn speed(design: &Design, batch: i64) -> Option<Tensor> {
    design.speed.then(|| Tensor::rand([batch, 1], (Kind::Float, Device::Cpu)))
}

fn largest_difference(a: &Tensor, b: &Tensor) -> f64 {
    (a - b).abs().max().double_value(&[])
}

/// The light architectures, one of each kind.
const LIGHT: [Architecture; 6] = [
    Architecture::PilotNet,
    Architecture::Cps,
    Architecture::ResNet18,
    Architecture::ResNet18Gru,
    Architecture::ResNet18Stack,
    Architecture::Lane,
];

#[test]
fn each_has_as_many_parameters_as_its_file_says() {
    for (architecture, parameters) in [
        (Architecture::PilotNet, 252_219),
        (Architecture::Cps, 160_578),
        (Architecture::ResNet18, 11_504_961),
        (Architecture::ResNet50, 24_622_913),
        (Architecture::ResNet18Gru, 13_082_946),
        (Architecture::ResNet50Gru, 28_560_194),
        (Architecture::ResNet18Stack, 11_542_593),
        (Architecture::ResNet50Stack, 24_660_545),
    ] {
        let (store, network) = fresh(&Design::of(architecture));
        let trained: usize = store.trainable_variables().iter().map(Tensor::numel).sum();
        assert_eq!(trained, parameters, "{}", architecture.name());
        let all = network.tensors();
        let without_buffers = all.iter().filter(|(name, _)| !name.contains("running_"));
        assert_eq!(without_buffers.map(|(_, t)| t.numel()).sum::<usize>(), parameters, "{}", architecture.name());
        assert_eq!(all.len(), store.variables().len(), "{}", architecture.name());
        for (name, tensor) in all {
            assert_eq!(store.variables()[&name].data_ptr(), tensor.data_ptr(), "{name}");
        }
    }
}

#[test]
fn the_speed_is_one_more_input_of_the_first_linear_layer_or_of_the_gru() {
    for (architecture, name) in [
        (Architecture::PilotNet, "fc1.weight"),
        (Architecture::Cps, "fc1.weight"),
        (Architecture::ResNet18, "head.1.weight"),
        (Architecture::ResNet18Gru, "gru.weight_ih_l0"),
        (Architecture::ResNet18Stack, "head.1.weight"),
    ] {
        let (without, _a) = fresh(&small(architecture, false));
        let (with, _b) = fresh(&small(architecture, true));
        for (each, tensor) in without.variables() {
            let more = i64::from(each == name);
            assert_eq!(with.variables()[&each].size().last().unwrap() - tensor.size().last().unwrap(), more, "{each}");
        }
    }
}

#[test]
fn torchvisions_names_are_the_backbones() {
    let (store, _network) = fresh(&Design::of(Architecture::ResNet50));
    let variables = store.variables();
    for (name, shape) in [
        ("conv1.weight", vec![64, 3, 7, 7]),
        ("bn1.running_mean", vec![64]),
        ("layer1.0.downsample.0.weight", vec![256, 64, 1, 1]),
        ("layer1.0.downsample.1.running_var", vec![256]),
        ("layer3.5.conv2.weight", vec![256, 256, 3, 3]),
        ("layer4.0.conv1.weight", vec![512, 1024, 1, 1]),
        ("layer4.2.bn3.bias", vec![2048]),
        ("head.1.weight", vec![512, 2048]),
        ("head.3.bias", vec![1]),
    ] {
        assert_eq!(variables[name].size(), shape, "{name}");
    }
    // torchvision's 320 less `fc` and the counts of batches is 265; the head adds six.
    assert_eq!(variables.len(), 271);
    let (store, _network) = fresh(&Design::of(Architecture::ResNet18));
    assert!(!store.variables().contains_key("layer1.0.downsample.0.weight"));
    assert!(store.variables().contains_key("layer2.0.downsample.0.weight"));
}

#[test]
fn gradients_reach_every_variable() {
    for architecture in LIGHT {
        for with_speed in [false, true] {
            let design = small(architecture, with_speed);
            let (store, network) = fresh(&design);
            let answer = network.forward(&frames(&design, 3), speed(&design, 3).as_ref(), true).unwrap();
            assert_eq!(answer.size(), [3, architecture.outputs().len() as i64]);
            (answer - 1.0).square().mean(Kind::Float).backward();
            for (name, variable) in store.variables() {
                let buffer = name.contains("running_");
                assert_eq!(variable.requires_grad(), !buffer, "{name}");
                let reached = buffer || variable.grad().abs().max().double_value(&[]) > 0.0;
                assert!(reached, "{}: {name}", architecture.name());
            }
        }
    }
}

#[test]
fn new_weights_lie_where_pytorch_and_torchvision_draw_them() {
    let (store, _network) = fresh(&Design::of(Architecture::ResNet18Gru));
    let variables = store.variables();
    for (name, bound) in [("head.2.weight", 1.0 / 512f64.sqrt()), ("gru.bias_hh_l0", 1.0 / 512f64.sqrt())] {
        let largest = variables[name].abs().max().double_value(&[]);
        assert!((bound * 0.9..=bound).contains(&largest), "{name}: {largest} {bound}");
    }
    let std = variables["layer2.0.conv1.weight"].std(true).double_value(&[]);
    let expected = (2.0 / (128.0 * 9.0f64)).sqrt();
    assert!((std / expected - 1.0).abs() < 0.02, "{std} {expected}");
    for (name, value) in [("weight", 1.0), ("bias", 0.0), ("running_mean", 0.0), ("running_var", 1.0)] {
        let tensor = &variables[&format!("layer4.1.bn2.{name}")];
        assert_eq!(largest_difference(tensor, &tensor.full_like(value)), 0.0, "{name}");
    }
}

#[test]
fn training_moves_the_running_statistics_and_answering_does_not() {
    let design = small(Architecture::ResNet18, false);
    let (store, network) = fresh(&design);
    let mean = || store.variables()["bn1.running_mean"].copy();
    let before = mean();
    let _ = network.forward(&frames(&design, 2), None, false).unwrap();
    assert!(mean().equal(&before));
    let _ = network.forward(&frames(&design, 2), None, true).unwrap();
    assert!(!mean().equal(&before));
}

#[test]
fn dropout_is_for_training_alone() {
    let design = small(Architecture::Cps, false);
    let (_store, network) = fresh(&design);
    let frames = frames(&design, 4);
    let answer = |train| network.forward(&frames, None, train).unwrap();
    assert!(answer(false).equal(&answer(false)));
    assert!(!answer(true).equal(&answer(true)));
}

#[test]
fn frame_by_frame_a_network_with_a_memory_answers_as_to_the_whole_sequence() {
    for architecture in [Architecture::ResNet18Gru, Architecture::ResNet18Stack] {
        let design = small(architecture, true);
        let (_store, network) = fresh(&design);
        let run = frames(&design, 2).flatten(0, 1); // (10, 3, H, W)
        let speed = speed(&design, 1);
        let mut memory = Memory::default();
        for now in 0..run.size()[0] {
            let frame = run.narrow(0, now, 1);
            let answer = network.answer(&frame, speed.as_ref(), &mut memory).unwrap();
            // The run's first frame stands in for those before it.
            let last_five: Vec<Tensor> = (now - 4..=now).map(|i| run.get(i.max(0))).collect();
            let whole = Tensor::stack(&last_five, 0).unsqueeze(0); // (1, 5, 3, H, W)
            let expected = network.forward(&whole, speed.as_ref(), false).unwrap();
            let difference = largest_difference(&answer, &expected);
            assert!(difference < 1e-4, "{} at {now}: {difference}", architecture.name());
        }
        memory.clear();
        let again = network.answer(&run.narrow(0, 0, 1), speed.as_ref(), &mut memory).unwrap();
        let expected = network.answer(&run.narrow(0, 0, 1), speed.as_ref(), &mut Memory::default()).unwrap();
        assert!(again.equal(&expected), "a cleared memory is a new one");
    }
}

#[test]
fn what_is_made_ready_for_inference_answers_the_same_under_the_same_names() {
    for architecture in LIGHT {
        let design = small(architecture, true);
        let (_store, network) = fresh(&design);
        let (frames, speed) = (frames(&design, 2), speed(&design, 2));
        // Moves the statistics away from their initial values.
        let _ = network.forward(&frames, speed.as_ref(), true).unwrap();
        let before = network.forward(&frames, speed.as_ref(), false).unwrap(); // (2, outputs)
        let tensors = network.tensors();
        let ready = network.for_inference().unwrap();
        let after = ready.share().forward(&frames, speed.as_ref(), false).unwrap();
        let difference = largest_difference(&before, &after);
        assert!(difference < 1e-4, "{}: {difference}", architecture.name());
        assert!(!after.requires_grad());
        for ((name, a), (same_name, b)) in tensors.iter().zip(ready.tensors()) {
            assert_eq!(*name, same_name);
            assert!(a.equal(&b) && !b.requires_grad(), "{name}");
        }
    }
}

#[test]
fn a_shared_network_holds_the_same_memory() {
    for architecture in LIGHT {
        let (_store, network) = fresh(&small(architecture, false));
        for ((name, a), (_, b)) in network.tensors().iter().zip(network.share().tensors()) {
            assert_eq!(a.data_ptr(), b.data_ptr(), "{name}");
        }
    }
}

#[test]
fn channels_last_and_bf16_inputs_are_answered_and_trained_on_by_f32_weights() {
    for architecture in LIGHT {
        let design = small(architecture, true);
        let (store, network) = fresh(&design);
        let (input, speed) = (frames(&design, 2), speed(&design, 2));
        let last = input.dim() as i64 - 3; // of channels
        let channels_last = input.movedim_int(last, -1).contiguous().movedim_int(-1, last);
        let whole = network.forward(&input, speed.as_ref(), false).unwrap();
        let relaid = network.forward(&channels_last, speed.as_ref(), false).unwrap();
        assert!(largest_difference(&whole, &relaid) < 1e-4, "{}", architecture.name());

        let mut optimizer = Sgd::default().build(&store, 1e-3).unwrap();
        let half = network.forward(&channels_last.to_kind(Kind::BFloat16), speed.as_ref(), true).unwrap();
        assert_eq!(half.kind(), Kind::BFloat16);
        optimizer.backward_step(&half.to_kind(Kind::Float).square().mean(Kind::Float));
        for (name, variable) in store.variables() {
            assert_eq!(variable.kind(), Kind::Float, "{name}");
            assert!(variable.isfinite().all().int64_value(&[]) == 1, "{name}");
        }
        let half = network.for_inference().unwrap().forward(&input.to_kind(Kind::BFloat16), speed.as_ref(), false);
        assert_eq!(half.unwrap().kind(), Kind::BFloat16);
    }
}

#[test]
fn an_input_of_another_shape_is_an_error() {
    let floats = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
    let error = |architecture, shape: &[i64]| {
        let (_store, network) = fresh(&small(architecture, false));
        network.forward(&floats(shape), None, false).unwrap_err().to_string()
    };
    assert_eq!(
        error(Architecture::PilotNet, &[1, 3, 66, 320]),
        "expected an input of shape (B, 3, 66, 200), got [1, 3, 66, 320]"
    );
    assert_eq!(error(Architecture::Cps, &[]), "expected an input of shape (B, 1, 12, 40), got []");
    assert_eq!(
        error(Architecture::ResNet18, &[2, 1, 8, 8]),
        "expected an input of shape (B, 3, H, W), got [2, 1, 8, 8]"
    );
    assert_eq!(
        error(Architecture::ResNet18, &[2, 3, 0, 8]),
        "expected an input of shape (B, 3, H, W), got [2, 3, 0, 8]"
    );
    for shape in [&[2, 3, 8, 8][..], &[2, 4, 3, 8, 8]] {
        assert_eq!(
            error(Architecture::ResNet18Gru, shape),
            format!("expected an input of shape (B, 5, 3, H, W), got {shape:?}")
        );
    }
    let (_store, network) = fresh(&small(Architecture::ResNet18Stack, false));
    let error = network.answer(&floats(&[2, 3, 8, 8]), None, &mut Memory::default()).unwrap_err();
    assert_eq!(error.to_string(), "expected an input of shape (1, 3, H, W), got [2, 3, 8, 8]");
}

#[test]
fn a_speed_where_none_is_wanted_and_none_where_one_is_are_errors() {
    let error = |wanted, given: Option<&[i64]>| {
        let design = small(Architecture::Cps, wanted);
        let (_store, network) = fresh(&design);
        let speed = given.map(|shape| Tensor::zeros(shape, (Kind::Float, Device::Cpu)));
        network.forward(&frames(&design, 2), speed.as_ref(), false).unwrap_err().to_string()
    };
    assert_eq!(error(true, None), "expected a speed of shape [2, 1], got no speed");
    assert_eq!(error(true, Some(&[2])), "expected a speed of shape [2, 1], got a speed of shape [2]");
    assert_eq!(error(false, Some(&[2, 1])), "expected no speed, got a speed of shape [2, 1]");
}

#[test]
fn what_is_frozen_neither_learns_nor_moves_its_statistics_and_the_rest_learns() {
    let whole = [Architecture::ResNet18, Architecture::ResNet18Gru, Architecture::ResNet18Stack].map(|kind| (kind, 4));
    for (architecture, stages) in whole.into_iter().chain([1, 3].map(|stages| (Architecture::ResNet18, stages))) {
        let design = small(architecture, false);
        let (store, mut network) = fresh(&design);
        assert!(network.normalises_by_batch());
        network.freeze(stages).unwrap();
        assert_eq!([&network, &network.share()].map(Network::normalises_by_batch), [stages < 4; 2]);
        let before: Vec<_> = network.tensors().into_iter().map(|(name, tensor)| (name, tensor.copy())).collect();
        let answer = network.forward(&frames(&design, 2), None, true).unwrap();
        (answer - 1.0).square().mean(Kind::Float).backward();
        for (name, before) in before {
            let now = &store.variables()[&name];
            let stage = name.strip_prefix("layer").and_then(|rest| rest[..1].parse().ok()).unwrap_or(1);
            let behind = ["head.", "gru.", "out."].iter().any(|part| name.starts_with(part)) || stage > stages;
            if name.contains("running") {
                assert_eq!(now.equal(&before), !behind, "{name}");
                continue;
            }
            assert!(now.equal(&before), "{name}");
            assert_eq!((now.requires_grad(), now.grad().defined()), (behind, behind), "{name}");
        }
    }
    let (_store, mut network) = fresh(&small(Architecture::Cps, false));
    let error = network.freeze(4).unwrap_err().to_string();
    assert_eq!(error, "expected a network with a backbone (resnet…), got cps");
}
