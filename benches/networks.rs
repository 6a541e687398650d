//! One frame's answer of each network, weights drawn, input of the size that comes with it.

use std::hint::black_box;

use divan::Bencher;
use lapwing_learn::nn::{Architecture, Design, Memory, Network, in_variable_store};
use tch::{Device, Kind, Tensor, nn::VarStore};

fn network(name: &str) -> Network {
    let design = Design::of(Architecture::named(name).unwrap());
    let store = VarStore::new(Device::Cpu);
    Network::build(&design, &mut in_variable_store(store.root())).unwrap()
}

/// (1, C, H, W)
fn frame(network: &Network) -> Tensor {
    let [channels, height, width] = network.design().preprocess.shape().map(|n| n as i64);
    Tensor::rand([1, channels, height, width], (Kind::Float, Device::Cpu))
}

fn answers(bencher: Bencher<'_, '_>, network: &Network) {
    let (frame, mut memory) = (frame(network), Memory::default());
    bencher.bench_local(|| network.answer(black_box(&frame), None, &mut memory).unwrap().double_value(&[0, 0]));
}

const NAMES: [&str; 8] =
    ["pilotnet", "cps", "resnet18", "resnet50", "resnet18-gru", "resnet50-gru", "resnet18-stack", "resnet50-stack"];

/// As a pilot drives with it.
#[divan::bench(args = NAMES, consts = [1, 2], sample_count = 30)]
fn answer_on_threads<const THREADS: i32>(bencher: Bencher<'_, '_>, name: &str) {
    tch::set_num_threads(THREADS);
    answers(bencher, &network(name).for_inference().unwrap());
}

/// The same without what is done for inference.
#[divan::bench(args = ["cps", "resnet18", "resnet50"], consts = [1, 2], sample_count = 30)]
fn answer_as_in_training_on_threads<const THREADS: i32>(bencher: Bencher<'_, '_>, name: &str) {
    tch::set_num_threads(THREADS);
    answers(bencher, &network(name));
}
