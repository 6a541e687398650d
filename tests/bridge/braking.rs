//! A guard beside the pilot of a car on the wire.

use std::{
    io::Read,
    time::{Duration, Instant},
};

use tokio::time::{MissedTickBehavior, interval};

use crate::{
    serve::{PLAIN, serve_with},
    support::{Wire, steer, telemetry},
};

#[tokio::test(flavor = "multi_thread")]
async fn a_network_takes_the_throttle_of_a_served_car_once_it_has_seen_twenty_frames() {
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/models/brake.safetensors");
    // To which any value is an emergency.
    let (mut verb, address, mut said) =
        serve_with(PLAIN, &["--brake-model", model, "--brake-threshold", "0.000000000001"]);
    let mut simulator = Wire::simulator(address).await;
    let mut frames = interval(Duration::from_millis(67));
    frames.set_missed_tick_behavior(MissedTickBehavior::Delay);
    // The pilot wants to be faster. Until it is there the car is braked as well.
    let (mut driven, mut braked) = (0, false);
    for _ in 0..300 {
        frames.tick().await;
        let (_, throttle) = steer(&simulator.ask(&telemetry("4.0000")).await);
        driven += u32::from(throttle > 0.0);
        braked = driven > 0 && throttle < 0.0;
        if braked {
            break;
        }
    }
    // Two values in a row press the brake.
    assert!(braked && driven >= 20, "{braked} after {driven} frames");
    verb.signal("TERM");
    assert!(verb.ends().success());
    let mut log = String::new();
    said.read_to_string(&mut log).unwrap();
    assert!(log.contains("emergency brake at 4.0 mph (brake-"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_network_looks_by_the_time_of_a_simulator_that_runs_faster_than_the_wall_clock() {
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/models/brake.safetensors");
    let (mut verb, address, _said) =
        serve_with(PLAIN, &["--brake-model", model, "--brake-threshold", "0.000000000001"]);
    let mut simulator = Wire::simulator(address).await;
    let mut frames = interval(Duration::from_millis(5));
    frames.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let stock = telemetry("4.0000");
    let (mut driven, mut braked, began) = (0, false, Instant::now());
    // By the wall clock, five looks.
    for i in 0_u64.. {
        frames.tick().await;
        let time = format!(r#""sim_time_us":"{}","image""#, i * 66_667);
        let (_, throttle) = steer(&simulator.ask(&stock.replace(r#""image""#, &time)).await);
        driven += u32::from(throttle > 0.0);
        braked = driven > 0 && throttle < 0.0;
        if braked || driven == 60 || began.elapsed() > Duration::from_secs(30) {
            break;
        }
    }
    assert!(braked && driven >= 20, "{braked} after {driven} frames");
    verb.signal("TERM");
    assert!(verb.ends().success());
}
