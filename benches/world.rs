//! What the headless simulator costs: a picture, a step, a drive. All on one core.

use std::{hint::black_box, sync::Arc, time::Instant};

use divan::{Bencher, counter::ItemsCount};
use lapwing_core::{
    config::{ControlSettings, OnCrash},
    driver::Driver,
    perception::Frame,
    protocol::Command,
    units::{Mph, Steering, Throttle},
};
use lapwing_learn::models;
use lapwing_learn::nn::runtime;
use lapwing_score::judged;
use lapwing_sim::{
    camera::{Camera, JPEG_QUALITY, Renderer, Scenery, Shot, encode_jpeg},
    conditions::Conditions,
    expert::Expert,
    scenario::Scenario,
    track::Track,
    vehicle::Car,
    world::{Setup, Simulation},
};

/// Telemetries of the drive that is timed: 20 s at 15 Hz.
const FRAMES: usize = 300;

fn setup(name: &str) -> Setup {
    let track = Track::open(name).unwrap();
    let scenery = Arc::new(Scenery::new(&track));
    let longest_s = Some(FRAMES as f64 / 15.0);
    Setup { laps: None, longest_s, on_crash: OnCrash::Reset, ..Setup::new(Arc::new(track), scenery) }
}

/// Pictures all around the track, as the car sees them on its line. 700 a second are asked for on the lake.
#[divan::bench(args = Track::NAMES, sample_count = 5, sample_size = 1)]
fn render_a_lap(bencher: Bencher<'_, '_>, name: &str) {
    let Setup { track, scenery, .. } = setup(name);
    let cars: Vec<Car> = (0..FRAMES)
        .map(|i| {
            let s = track.length() * i as f64 / FRAMES as f64;
            let station = track.at(s);
            let position = track.point(s, track.file().driving_line_m);
            Car { position, yaw: station.yaw, pitch: station.grade.atan(), ..Car::default() }
        })
        .collect();
    let (mut renderer, mut frame, conditions) = (Renderer::new(scenery), Frame::default(), Conditions::default());
    bencher.counter(ItemsCount::new(FRAMES)).bench_local(|| {
        for car in &cars {
            let shot = Shot { car, actors: &[], conditions: &conditions, seed: 0, time_s: 0.0 };
            renderer.render(&Camera::CENTER, black_box(&shot), &mut frame);
        }
    });
}

/// A rendered picture as JPEG.
#[divan::bench(sample_size = 20)]
fn jpeg_encode(bencher: Bencher<'_, '_>) {
    let world = Simulation::new(setup("lake")).unwrap();
    let (mut renderer, mut frame) = (Renderer::new(world.setup().scenery.clone()), Frame::default());
    world.draw(&mut renderer, &Camera::CENTER, &mut frame);
    bencher.bench_local(|| encode_jpeg(black_box(&frame), JPEG_QUALITY));
}

/// The world's step without its camera: car, road, traffic and judge. At most 5 us are asked for.
#[divan::bench(args = ["", "ccrb", "cpna"], sample_size = 500)]
fn world_step(bencher: Bencher<'_, '_>, scenario: &str) {
    let mut setup = setup("lake");
    setup.longest_s = None;
    if !scenario.is_empty() {
        setup.scenario = Some(Scenario::named(scenario).unwrap());
    }
    let mut world = Simulation::new(setup).unwrap();
    let gently = Command { steering: Steering::constant(-0.02), throttle: Throttle::constant(0.2) };
    bencher.bench_local(|| world.step(black_box(gently)));
}

/// What the expert's look at the road adds to a step.
#[divan::bench(sample_size = 500)]
fn expert(bencher: Bencher<'_, '_>) {
    let world = Simulation::new(setup("lake")).unwrap();
    let (track, mut expert) = (world.setup().track.clone(), Expert::default());
    bencher.bench_local(|| expert.drive(&track, black_box(world.place()), world.car(), Mph::constant(20.0)));
}

/// The whole of `lapwing drive` with PilotNet, 20 s of the world, without recording. 15 times real time are asked for:
/// 1.33 s.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn drive_20_s_with_pilotnet(bencher: Bencher<'_, '_>) {
    runtime::set_threads(1);
    let (model, setup) = (models::built_in(Instant::now).unwrap(), setup("lake"));
    bencher.counter(ItemsCount::new(FRAMES)).bench_local(|| {
        let mut world = Simulation::new(setup.clone()).unwrap();
        let mut driver = Driver::new(model.pilot(), &ControlSettings::default(), Instant::now);
        judged::run(&mut world, &mut driver, &mut []).unwrap().driven.frames
    });
}
