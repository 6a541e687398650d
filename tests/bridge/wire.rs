//! Connection and lock-step.

use std::time::Duration;

use lapwing_core::config::Settings;
use tempfile::tempdir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use crate::support::{Running, Wire, jpeg, settings, steer, telemetry};

#[tokio::test(flavor = "multi_thread")]
async fn a_telemetry_is_answered_by_one_steer_and_nothing_comes_before_it() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    assert_eq!(simulator.text_within(Duration::from_millis(300)).await, None, "no OPEN packet: it would be a token");
    let (steering, throttle) = steer(&simulator.ask(&telemetry("0.0000")).await);
    assert!((-1.0..=1.0).contains(&steering), "{steering}");
    assert_eq!(throttle, 0.918, "drive.py's PI at rest: 0.1 * 9 + 0.002 * 9");
    assert_eq!(simulator.text_within(Duration::from_millis(300)).await, None, "one answer for one telemetry");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_handshake_names_no_extension_even_where_one_is_offered() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut stream = TcpStream::connect(running.address).await.unwrap();
    let request = "GET /socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nUser-Agent: websocket-sharp/1.0\r\n\
                   Upgrade: websocket\r\nConnection: Upgrade\r\nHost: 127.0.0.1:4567\r\n\
                   Sec-WebSocket-Extensions: permessage-deflate\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n";
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut head = vec![0; 4096];
    let n = stream.read(&mut head).await.unwrap();
    let head = String::from_utf8_lossy(&head[..n]).to_lowercase();
    assert!(head.starts_with("http/1.1 101 "), "{head}");
    assert!(head.contains("sec-websocket-accept: s3pplmbitxaq9kygzzhzrbk+xoo="), "RFC 6455's own example: {head}");
    assert!(!head.contains("extensions"), "{head}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ping_is_answered_by_a_pong() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    assert_eq!(simulator.ask("2").await, "3");
    assert_eq!(simulator.ask("2probe").await, "3probe");
}

#[tokio::test(flavor = "multi_thread")]
async fn until_the_model_is_there_a_car_that_comes_rolling_is_braked_to_a_standstill() {
    let dir = tempdir().unwrap();
    let running = Running::without_a_model(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    for (speed, throttle) in [("30.0000", -1.0), ("12.0000", -1.0), ("4.9000", -1.0), ("0.6000", 0.0), ("0.0000", 0.0)]
    {
        // 5 of 25 degrees: as it was steered when it came.
        let text = telemetry(speed).replacen("0.0000", "5.0000", 1);
        assert_eq!(steer(&simulator.ask(&text).await), (0.2, throttle), "at {speed} mph");
    }
    let broken = telemetry("0.0000").replace("/9j/", "!!!!");
    assert_eq!(steer(&simulator.ask(&broken).await), (0.2, 0.0));
    assert_eq!(simulator.ask(r#"42["telemetry",null]"#).await, r#"42["manual",{}]"#);
    running.bridge.model_is_ready(lapwing_learn::models::built_in(std::time::Instant::now).unwrap());
    assert_eq!(steer(&simulator.ask(&telemetry("0.0000")).await).1, 0.918);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_brake_of_a_car_that_waits_is_in_its_dialect_and_so_is_the_farewell() {
    let dir = tempdir().unwrap();
    let running = Running::without_a_model(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let term_2 = telemetry("30.0000").replace("}]", r#","cte":"0.5"}]"#);
    assert_eq!(simulator.ask(&term_2).await, r#"42["steer",{"steering_angle":0e-4,"throttle":-10000e-4}]"#);
    assert!(running.stop().await.is_empty(), "nothing was driven");
    assert_eq!(simulator.text().await, r#"42["steer",{"steering_angle":0e-4,"throttle":0e-4}]"#);
}

#[tokio::test(flavor = "multi_thread")]
async fn several_simulators_have_states_and_runs_of_their_own() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut first = Wire::simulator(running.address).await;
    let mut second = Wire::simulator(running.address).await;
    for _ in 0..10 {
        first.ask(&telemetry("4.0000")).await;
    }
    // 0.1 * 5 + 0.002 * 5 n: only the first's integral has grown.
    assert_eq!(steer(&first.ask(&telemetry("4.0000")).await).1, 0.61);
    assert_eq!(steer(&second.ask(&telemetry("4.0000")).await).1, 0.51);
    let summaries = running.stop().await;
    assert_eq!(summaries.iter().map(|s| s.telemetries).sum::<u64>(), 12);
    let mut runs: Vec<_> = summaries.iter().map(|s| s.run.as_ref().unwrap().path.clone()).collect();
    runs.dedup();
    assert_eq!(runs.len(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stopped_bridge_leaves_the_car_rolling_and_the_run_whole() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let (steering, _) = steer(&simulator.ask(&telemetry("9.0000")).await);
    let summaries = running.stop().await;
    assert_eq!(steer(&simulator.text().await), (steering, 0.0));
    assert!(simulator.ends_within(Duration::from_secs(2)).await);
    let run = summaries[0].run.as_ref().unwrap();
    assert_eq!((run.frames, run.not_recorded, &run.error), (1, 0, &None));
    let mut moments = lapwing_core::recording::RunReader::open(&run.path).unwrap().entries();
    let steps: Vec<_> = moments.by_ref().map(Result::unwrap).collect();
    assert!(moments.truncated().is_none());
    let lapwing_core::recording::Entry::Step(step) = &steps[0] else { panic!("{steps:?}") };
    assert_eq!(
        step.telemetry.image,
        lapwing_core::protocol::CameraImage::Jpeg(jpeg(90).into()),
        "the bytes as received"
    );
    assert_eq!(step.command.as_ref().unwrap().steering.get(), summaries_steering(&steps), "as answered");
}

fn summaries_steering(moments: &[lapwing_core::recording::Entry]) -> f64 {
    let lapwing_core::recording::Entry::Step(step) = &moments[0] else { panic!("no step") };
    step.command.as_ref().unwrap().prediction.unwrap().clamp(-1.0, 1.0)
}

#[tokio::test(flavor = "multi_thread")]
async fn without_recording_nothing_is_written_and_the_car_drives() {
    let dir = tempdir().unwrap();
    let mut settings: Settings = settings(dir.path());
    settings.recording.enabled = false;
    let running = Running::start(settings).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.ask(&telemetry("0.0000")).await;
    assert!(running.stop().await[0].run.is_none());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_that_cannot_be_made_costs_the_run_and_not_the_drive() {
    let dir = tempdir().unwrap();
    let file = dir.path().join("a file");
    std::fs::write(&file, "").unwrap();
    let running = Running::start(settings(&file)).await;
    let mut simulator = Wire::simulator(running.address).await;
    assert_eq!(steer(&simulator.ask(&telemetry("0.0000")).await).1, 0.918);
    assert!(running.stop().await[0].run.is_none());
}
