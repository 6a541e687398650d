//! Kicks, tokens too many, ghosts.

use std::time::{Duration, Instant};

use lapwing_score::score::Figure;
use tempfile::tempdir;

use crate::support::{Running, Wire, settings_with_kicks, steer, telemetry};

#[tokio::test(flavor = "multi_thread")]
async fn a_simulator_that_missed_its_start_is_kicked_after_a_second() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let began = Instant::now();
    let kick = simulator.text().await;
    assert_eq!(kick, r#"42["steer",{"steering_angle":"0e-4","throttle":"0e-4"}]"#);
    assert!(began.elapsed() >= Duration::from_millis(950), "{:?}", began.elapsed());
    assert!(steer(&simulator.ask(&telemetry("0.0000")).await).1 > 0.0, "and its loop runs");
    assert_eq!(running.stop().await[0].count(Figure::Kicks), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulator_of_unknown_kind_is_kicked_in_words_that_every_kind_takes() {
    let dir = tempdir().unwrap();
    let mut settings = settings_with_kicks(dir.path());
    settings.bridge.kick_after_s = 0.2;
    let running = Running::start(settings).await;
    let mut simulator = Wire::simulator(running.address).await;
    steer(&simulator.text().await);
    assert_eq!(simulator.text().await, r#"42["manual",{}]"#, "term 2 would not take the strings of a steer");
    simulator.ask(&telemetry("0.0000")).await;
    assert!(running.stop().await[0].count(Figure::Kicks) >= 2, "those before the drive began count, too");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_loop_that_stalled_is_kicked_with_the_last_steering() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let (steering, _) = steer(&simulator.ask(&telemetry("5.0000")).await);
    assert_eq!(steer(&simulator.text().await), (steering, 0.0));
    let summary = running.stop().await.remove(0);
    assert_eq!(summary.count(Figure::Kicks), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_too_many_after_a_pause_is_taken_out_of_the_game() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let frame = telemetry("5.0000");
    simulator.ask(&frame).await;
    simulator.text().await; // the kick: now the simulator holds two tokens
    simulator.send(&frame).await;
    tokio::time::sleep(Duration::from_millis(20)).await; // one game frame
    simulator.send(&frame).await;
    steer(&simulator.text().await);
    assert_eq!(simulator.text_within(Duration::from_millis(500)).await, None, "one answer for two telemetries");
    steer(&simulator.ask(&telemetry("5.0000")).await);
}

/// Also where its pings are not due yet; that a ghost is dropped once they stay away is tested with the rule itself.
#[tokio::test(flavor = "multi_thread")]
async fn a_paused_simulator_keeps_its_run_while_another_one_plays_beside_it() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut paused = Wire::simulator(running.address).await;
    paused.ask(&telemetry("5.0000")).await;
    let mut playing = Wire::simulator(running.address).await;
    for frame in 0..50 {
        playing.ask(&telemetry(&format!("{frame}.0000"))).await;
        if frame % 20 == 0 {
            paused.send("2").await;
        }
        tokio::time::sleep(Duration::from_millis(60)).await;
    }
    paused.send(&telemetry("5.0000")).await;
    let mut heard = vec![];
    while let Some(text) = paused.text_within(Duration::from_millis(500)).await {
        heard.push(text);
    }
    assert_eq!(heard.iter().filter(|text| *text == "3").count(), 3, "its pings are answered: {heard:?}");
    let summaries = running.stop().await;
    let telemetries: Vec<_> = summaries.iter().map(|summary| summary.telemetries).collect();
    assert!(telemetries == [2, 50] || telemetries == [50, 2], "one run each: {telemetries:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulator_that_plays_is_spared_when_another_one_dials() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut first = Wire::simulator(running.address).await;
    let mut second = Wire::simulator(running.address).await;
    let until = Instant::now() + Duration::from_millis(2500);
    while Instant::now() < until {
        steer(&first.ask(&telemetry("5.0000")).await);
        steer(&second.ask(&telemetry("5.0000")).await);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}
