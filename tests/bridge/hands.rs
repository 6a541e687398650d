//! Hand-over between human and pilot.

use std::time::Duration;

use lapwing_core::{
    config::Takeover,
    recording::{Entry, EventRecord, RunReader},
};
use lapwing_score::score::Figure;
use tempfile::tempdir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use crate::support::{Running, Wire, settings, settings_with_kicks, steer, telemetry};

const HUMAN: &str = r#"42["telemetry",null]"#;
const MANUAL: &str = r#"42["manual",{}]"#;

#[tokio::test(flavor = "multi_thread")]
async fn a_human_is_answered_manual_and_the_integral_is_held_meanwhile() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    assert_eq!(steer(&simulator.ask(&telemetry("4.0000")).await).1, 0.51);
    for _ in 0..20 {
        assert_eq!(simulator.ask(HUMAN).await, MANUAL);
    }
    assert_eq!(simulator.ask(r#"42["telemetry",{}]"#).await, MANUAL);
    assert_eq!(steer(&simulator.ask(&telemetry("4.0000")).await).1, 0.52, "one more error in the sum, not twenty");
    let summary = running.stop().await.remove(0);
    assert_eq!((summary.count(Figure::Takeovers), summary.human_messages, summary.telemetries), (1, 21, 2));
    let moments: Vec<_> = RunReader::open(summary.run.unwrap().path).unwrap().entries().map(Result::unwrap).collect();
    let ended = moments.iter().any(
        |m| matches!(m, Entry::Event { event: EventRecord::TakeoverEnded { duration_s }, .. } if *duration_s > 0.0),
    );
    assert!(ended, "{moments:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_kicks_while_a_human_drives() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    assert_eq!(simulator.ask(HUMAN).await, MANUAL);
    assert_eq!(simulator.text_within(Duration::from_millis(1500)).await, None);
}

#[tokio::test(flavor = "multi_thread")]
async fn garbage_while_a_human_drives_leaves_the_wheel_to_the_human() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let (steering, _) = steer(&simulator.ask(&telemetry("4.0000")).await);
    simulator.ask(HUMAN).await;
    assert_eq!(simulator.ask("garbage").await, MANUAL);
    let summary = running.stop().await.remove(0);
    assert_eq!((summary.count(Figure::BadFrames), summary.count(Figure::Takeovers)), (1, 1));
    // Else it would go on with the throttle of before once the human lets go, and nobody is there any more.
    assert_eq!(steer(&simulator.text().await), (steering, 0.0), "a bridge that stops lets go of the car, too");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_human_from_the_first_frame_belongs_to_a_run_that_knows_its_simulator() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    for _ in 0..4 {
        assert_eq!(simulator.ask(HUMAN).await, MANUAL);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert!(steer(&simulator.ask(&telemetry("4.0000")).await).1 > 0.0);
    let summary = running.stop().await.remove(0);
    assert_eq!((summary.count(Figure::Takeovers), summary.telemetries), (1, 1));
    let reader = RunReader::open(summary.run.unwrap().path).unwrap();
    assert_eq!(reader.header().dialect, Some(lapwing_core::protocol::Dialect::Term1));
    let moments: Vec<_> = reader.entries().map(Result::unwrap).collect();
    let driven_s = moments.iter().find_map(|moment| match moment {
        Entry::Event { event: EventRecord::TakeoverEnded { duration_s }, .. } => Some(*duration_s),
        _ => None,
    });
    assert!(driven_s.is_some_and(|s| (0.4..10.0).contains(&s)), "{moments:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn armed_while_the_human_still_drives_the_pilot_goes_on_when_they_let_go() {
    let dir = tempdir().unwrap();
    let mut settings = settings(dir.path());
    settings.control.takeover = Takeover::Latch;
    let running = Running::start(settings).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.ask(HUMAN).await;
    running.bridge.arm();
    simulator.ask(HUMAN).await;
    assert_eq!(steer(&simulator.ask(&telemetry("4.0000")).await), (0.0, 0.0), "the answer that ends the takeover");
    assert!(steer(&simulator.ask(&telemetry("4.0000")).await).1 > 0.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn latched_the_pilot_stays_off_until_it_is_armed() {
    let dir = tempdir().unwrap();
    let mut settings = settings(dir.path());
    settings.control.takeover = Takeover::Latch;
    let running = Running::start(settings).await;
    let mut simulator = Wire::simulator(running.address).await;
    assert!(steer(&simulator.ask(&telemetry("4.0000")).await).1 > 0.0);
    assert_eq!(simulator.ask(HUMAN).await, MANUAL);
    for _ in 0..3 {
        assert_eq!(steer(&simulator.ask(&telemetry("4.0000")).await), (0.0, 0.0), "off: wheels straight, no throttle");
    }
    assert_eq!(post(&running, "/arm").await, "armed\n");
    assert!(steer(&simulator.ask(&telemetry("4.0000")).await).1 > 0.0);
}

async fn post(running: &Running, path: &str) -> String {
    let mut stream = TcpStream::connect(running.address).await.unwrap();
    let request = format!("POST {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 0\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).await.unwrap();
    response.split_once("\r\n\r\n").unwrap().1.to_owned()
}
