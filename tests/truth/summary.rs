//! The bridge's summary and the scorecard of the run's file are one.

use std::time::Duration;

use lapwing_core::recording::Recording;
use lapwing_score::score::{self, Figure, Measure, Scorer};
use tempfile::tempdir;

use crate::support::{Running, Wire, settings_with_kicks, telemetry, telemetry_with};

#[tokio::test(flavor = "multi_thread")]
async fn a_drive_with_a_takeover_kicks_and_bad_frames_is_summed_up_as_its_file_is_scored() {
    let dir = tempdir().unwrap();
    let mut settings = settings_with_kicks(dir.path());
    settings.bridge.kick_after_s = 1.0; // longer than a busy machine keeps the simulator waiting
    let running = Running::start(settings).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.text().await; // a kick before the first telemetry
    for mph in ["5.0000", "9.0000", "14.0000", "20.0000"] {
        simulator.ask(&telemetry(mph)).await;
        tokio::time::sleep(Duration::from_millis(40)).await;
    }
    for _ in 0..20 {
        simulator.ask(r#"42["telemetry",null]"#).await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    simulator.ask(&telemetry("20.0000")).await;
    simulator.ask(&telemetry_with("broken", "21.0000")).await;
    simulator.ask("garbage").await;
    simulator.text().await; // stalled: another kick
    simulator.send(&telemetry("3.0000")).await;
    simulator.text().await;
    let summary = running.stop().await.remove(0);
    let path = summary.run.as_ref().unwrap().path.clone();
    let card = score::of_recording(&mut Recording::open(path).unwrap(), Scorer::on(&[], Some(1)), |_, _| ()).unwrap();
    let counts = [Figure::Takeovers, Figure::Kicks, Figure::BadFrames].map(|figure| summary.count(figure));
    assert_eq!(counts, [1, 2, 2], "{summary}");
    let mut shown = 0;
    for figure in Figure::ALL {
        if summary.card.value(figure).is_some() {
            assert_eq!(summary.card.get(figure), card.get(figure), "{}", figure.key());
            shown += 1;
        }
    }
    assert!(shown >= 12, "{summary}");
    assert_eq!(summary.card.latency, card.latency);
    // In words and in JSON.
    let (said, scored) = (summary.to_string(), card.to_string());
    for row in ["human takeovers", "kicks", "bad frames", "frame rate", "speed", "steering", "distance", "latency"] {
        let line = |text: &str| text.lines().find(|line| line.trim_start().starts_with(row)).map(str::to_owned);
        assert!(line(&said).is_some() && line(&said) == line(&scored), "{row}:\n{said}\n{scored}");
    }
    let json = serde_json::to_value(&summary).unwrap();
    assert_eq!((json["kicks"].as_u64(), json["human_messages"].as_u64()), (Some(2), Some(20)), "{json}");
    assert_eq!(json["latency_ms"], serde_json::to_value(&card).unwrap()["latency_ms"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drive_without_a_telemetry_has_no_frame_rate() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    for _ in 0..5 {
        simulator.ask(&telemetry("NaN")).await;
    }
    let summary = running.stop().await.remove(0);
    assert_eq!(summary.card.get(Figure::FramesPerS), Measure::Unknown("the run has no telemetry"));
    assert!(!summary.to_string().contains("a second"), "{summary}");
    assert_eq!((summary.telemetries, summary.count(Figure::BadFrames)), (5, 5), "{summary}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_begins_with_a_human_names_its_dialect_and_keeps_its_beginning() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings_with_kicks(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.ask(r#"42["telemetry",null]"#).await;
    tokio::time::sleep(Duration::from_millis(150)).await;
    simulator.ask(&telemetry("9.0000")).await;
    simulator.ask(&telemetry("9.0000")).await;
    let summary = running.stop().await.remove(0);
    let mut run = Recording::open(summary.run.unwrap().path).unwrap();
    assert_eq!(run.header().dialect, Some(lapwing_core::protocol::Dialect::Term1));
    let card = score::of_recording(&mut run, Scorer::on(&[], Some(1)), |_, _| ()).unwrap();
    assert!(card.value(Figure::HumanS).unwrap() >= 0.15, "{card}");
    assert_eq!(card.value(Figure::SurvivalS), Some(0.0), "{card}");
}
