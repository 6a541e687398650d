//! The game of tokens as the simulator plays it: once a game frame it serves all that it holds.

use std::time::Duration;

use tempfile::tempdir;
use tokio::time::Instant;

use crate::support::{Running, Wire, settings, settings_with_kicks, telemetry};

const FRAME: Duration = Duration::from_millis(40);

/// How a simulator sends the telemetries of one game frame.
#[derive(Debug, Clone, Copy)]
struct Habits {
    /// Time from one to the next: taking a picture takes some.
    apart: Duration,
    /// Whether all of one frame are the same.
    same: bool,
}

/// Plays so many game frames with so many tokens; how many telemetries each frame had.
async fn play(simulator: &mut Wire, mut tokens: u32, frames: u32, habits: Habits) -> Vec<u32> {
    let mut sent = vec![];
    for frame in 0..frames {
        let end = Instant::now() + FRAME;
        sent.push(tokens);
        for token in 0..std::mem::take(&mut tokens) {
            let mph = f64::from(frame) / 10.0 + if habits.same { 0.0 } else { f64::from(token) / 100.0 };
            simulator.send(&telemetry(&format!("{mph:.4}"))).await;
            tokio::time::sleep(habits.apart).await;
        }
        while let Some(answer) = simulator.text_within(end.saturating_duration_since(Instant::now())).await {
            assert!(answer.starts_with(r#"42["steer""#), "{answer}");
            tokens += 1;
        }
    }
    sent
}

/// One telemetry a frame in the end: never two, and sometimes none where a busy machine answers late.
fn comes_down_to_one(sent: &[u32], what: Habits) {
    let end = &sent[sent.len() - 20..];
    assert!(end.iter().all(|tokens| *tokens <= 1) && end.iter().sum::<u32>() >= 5, "{what:?}: {sent:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_too_many_are_taken_out_of_a_connection_that_did_not_cause_them() {
    let dir = tempdir().unwrap();
    for apart_ms in [0, 5] {
        let habits = Habits { apart: Duration::from_millis(apart_ms), same: true };
        let running = Running::start(settings(dir.path())).await;
        let mut simulator = Wire::simulator(running.address).await;
        comes_down_to_one(&play(&mut simulator, 6, 60, habits).await, habits);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn kicks_that_were_not_read_are_taken_out_of_the_next_connection() {
    let dir = tempdir().unwrap();
    let mut settings = settings(dir.path());
    settings.bridge.kick_after_s = 0.3;
    let running = Running::start(settings).await;
    let mut frozen = Wire::simulator(running.address).await;
    frozen.ask(&telemetry("5.0000")).await;
    tokio::time::sleep(Duration::from_millis(1200)).await; // two kicks, not read
    drop(frozen);
    tokio::time::sleep(Duration::from_millis(100)).await;
    let mut simulator = Wire::simulator(running.address).await;
    // No picture twice, and each after the answer to the one before.
    let habits = Habits { apart: Duration::from_millis(8), same: false };
    comes_down_to_one(&play(&mut simulator, 3, 60, habits).await, habits);
}

#[tokio::test(flavor = "multi_thread")]
async fn with_one_token_every_telemetry_has_its_answer_at_once() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let mut waits = vec![];
    for frame in 0..40 {
        let asked = Instant::now();
        simulator.ask(&telemetry(&format!("{frame}.0000"))).await;
        waits.push(asked.elapsed());
    }
    waits.sort();
    assert!(waits[20] < FRAME, "nothing is held back without doubt: {waits:?}");
    assert_eq!(simulator.text_within(Duration::from_millis(300)).await, None, "one answer each");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fork_with_a_timer_is_answered_as_often_as_it_speaks() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let text = telemetry("5.0000").replace("}]", r#","pos_x":"1.0","pos_y":"0","pos_z":"2","hit":"none"}]"#);
    for _ in 0..20 {
        simulator.send(&text).await;
    }
    for _ in 0..20 {
        assert!(simulator.text().await.starts_with(r#"42["steer""#));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulator_that_never_waits_for_answers_gets_them_all_the_same() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let mut answers = 0;
    for i in 0..300 {
        simulator.send(&telemetry(&format!("{i}.0000"))).await;
    }
    while simulator.text_within(Duration::from_secs(1)).await.is_some() {
        answers += 1;
    }
    assert!((200..=300).contains(&answers), "{answers}");
}
