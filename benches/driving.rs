//! What driving costs: `cargo bench --bench driving`. All on a picture that is
//! drawn here, of the stock simulator's size and about its bytes.

use std::{
    hint::black_box,
    path::Path,
    time::{Duration, Instant},
};

use base64::{Engine, prelude::BASE64_STANDARD};
use divan::{Bencher, counter::BytesCount};
use image::{ColorType, codecs::jpeg::JpegEncoder};
use lapwing_core::guard::GuardModel;
use lapwing_core::{
    config::ControlSettings,
    driver::Driver,
    perception::{Frame, Preprocess, Preprocessor, decode_base64, decode_jpeg},
    pilot::View,
    protocol::{Observation, Sight},
};
use lapwing_learn::braking::BrakingModel;
use lapwing_learn::models;
use lapwing_learn::nn::{Architecture, Checkpoint, Design, Network, in_variable_store, runtime};
use tch::{Device, Kind, Tensor, nn::VarStore};

mod intersection;
mod lock_step;
mod memory;
mod networks;
mod odometry;
mod training;
mod world;

const BRAKE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/models/brake.safetensors");
const MODEL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/models/pilotnet.safetensors");

fn main() {
    if memory::child() {
        return;
    }
    runtime::keep_tensor_memory();
    divan::main();
}

/// A road under a sky, 320 x 160, with some noise, as a JPEG of quality 75: 11 to 15 KiB.
fn jpeg() -> Vec<u8> {
    let mut seed = 1u32;
    let mut noise = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 24) as i32 * 36 / 256 - 18
    };
    let pixel = |i: i32| {
        let (x, y) = (i % 320, i / 320);
        let road = (x - 160).abs() < y - 50;
        let colour = match (y < 60, road) {
            (true, _) => [120 + y, 160 + y, 230],
            (_, true) => [110 - y / 4, 105 - y / 4, 100 - y / 4],
            (_, false) => [60 + x / 8, 110 + y / 4, 40],
        };
        let noise = noise();
        colour.map(|c| (c + noise).clamp(0, 255) as u8)
    };
    let rgb: Vec<u8> = (0..320 * 160).flat_map(pixel).collect();
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 75).encode(&rgb, 320, 160, ColorType::Rgb8.into()).unwrap();
    assert!((11 << 10..=15 << 10).contains(&bytes.len()), "{} bytes", bytes.len());
    bytes
}

fn frame() -> Frame {
    let mut frame = Frame::default();
    decode_jpeg(&jpeg(), &mut frame).unwrap();
    frame
}

fn preprocess() -> Preprocess {
    Checkpoint::load(MODEL).unwrap().metadata.preprocess
}

#[divan::bench]
fn base64_decode(bencher: Bencher<'_, '_>) {
    let text = BASE64_STANDARD.encode(jpeg());
    bencher.counter(BytesCount::new(text.len())).bench_local(|| decode_base64(black_box(text.as_bytes())).unwrap());
}

#[divan::bench]
fn jpeg_decode(bencher: Bencher<'_, '_>) {
    let (bytes, mut frame) = (jpeg(), Frame::default());
    bencher.counter(BytesCount::new(bytes.len())).bench_local(|| decode_jpeg(black_box(&bytes), &mut frame).unwrap());
}

#[divan::bench(name = "preprocess")]
fn preprocess_(bencher: Bencher<'_, '_>) {
    let (frame, mut preprocessor, mut out) = (frame(), Preprocessor::new(preprocess()).unwrap(), Vec::new());
    bencher.bench_local(|| preprocessor.apply(black_box(&frame), &mut out).unwrap());
}

/// The forward pass alone, as a pilot makes it.
#[divan::bench(args = [1, 2], sample_size = 20)]
fn pilotnet_forward_on_threads(bencher: Bencher<'_, '_>, threads: i32) {
    tch::set_num_threads(threads);
    let network = Checkpoint::load(MODEL).unwrap().network;
    let input = Tensor::rand([1, 3, 66, 200], (Kind::Float, Device::Cpu)); // (1, 3, 66, 200)
    tch::no_grad(|| {
        bencher.bench_local(|| network.forward(black_box(&input), None, false).unwrap().double_value(&[0, 0]))
    });
}

/// The same without what inference does for it: weights as in training, gradients tracked.
#[divan::bench(args = [1, 2], sample_size = 20)]
fn pilotnet_forward_as_in_training_on_threads(bencher: Bencher<'_, '_>, threads: i32) {
    tch::set_num_threads(threads);
    let store = VarStore::new(Device::Cpu);
    let network = Network::build(&Design::of(Architecture::PilotNet), &mut in_variable_store(store.root())).unwrap();
    let input = Tensor::rand([1, 3, 66, 200], (Kind::Float, Device::Cpu)); // (1, 3, 66, 200)
    bencher.bench_local(|| network.forward(black_box(&input), None, false).unwrap().double_value(&[0, 0]));
}

/// From a decoded frame to steering.
#[divan::bench(args = [1, 2], sample_size = 20)]
fn pilot_steers_on_threads(bencher: Bencher<'_, '_>, threads: i32) {
    tch::set_num_threads(threads);
    let (mut pilot, frame) = (models::load(MODEL, Instant::now).unwrap().pilot(), frame());
    bencher.bench_local(|| pilot.steer(&View::of(black_box(&frame))).unwrap());
}

/// JPEG bytes to command: the whole driver.
#[divan::bench(sample_size = 20)]
fn driver(bencher: Bencher<'_, '_>) {
    tch::set_num_threads(1);
    let pilot = models::load(MODEL, Instant::now).unwrap().pilot();
    let mut driver = Driver::new(pilot, &ControlSettings::default(), Instant::now);
    let observation = Observation { at: Duration::ZERO, sight: Sight::Telemetry(lock_step::telemetry()) };
    bencher.bench_local(|| driver.drive(black_box(&observation)));
}

/// The same watched over by the live braking network, at 15 frames a second: each frame is looked at.
#[divan::bench(sample_size = 20)]
fn driver_with_guard(bencher: Bencher<'_, '_>) {
    tch::set_num_threads(1);
    let pilot = models::load(MODEL, Instant::now).unwrap().pilot();
    let guard = BrakingModel::load(Path::new(BRAKE), None).unwrap().guard();
    let mut driver = Driver::new(pilot, &ControlSettings::default(), Instant::now).guarded(Some(guard));
    let mut observation = Observation { at: Duration::ZERO, sight: Sight::Telemetry(lock_step::telemetry()) };
    bencher.bench_local(|| {
        observation.at += Duration::from_secs(1) / 15;
        driver.drive(black_box(&observation))
    });
}

/// What the driver cannot do without, and nothing else: decode and forward.
#[divan::bench(sample_size = 20)]
fn decode_and_forward_alone(bencher: Bencher<'_, '_>) {
    tch::set_num_threads(1);
    let (bytes, mut frame) = (jpeg(), Frame::default());
    let network = Checkpoint::load(MODEL).unwrap().network;
    let input = Tensor::rand([1, 3, 66, 200], (Kind::Float, Device::Cpu)); // (1, 3, 66, 200)
    tch::no_grad(|| {
        bencher.bench_local(|| {
            decode_jpeg(black_box(&bytes), &mut frame).unwrap();
            network.forward(black_box(&input), None, false).unwrap().double_value(&[0, 0])
        })
    });
}
