//! Bad input never costs a token.

use base64::{Engine, engine::general_purpose::STANDARD};
use futures_util::SinkExt;
use lapwing_core::recording::{Entry, EventRecord, RunReader};
use lapwing_learn::models;
use lapwing_score::score::Figure;
use tempfile::tempdir;
use tokio_tungstenite::tungstenite::Message;

use crate::support::{Running, Wire, jpeg, lost_for_words, settings, steer, telemetry, telemetry_with, torchscript};

/// A JPEG whose header says 30000x30000.
fn huge() -> Vec<u8> {
    let mut jpeg = jpeg(1);
    let sof = jpeg.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    jpeg[sof + 5..sof + 9].copy_from_slice(&[0x75, 0x30, 0x75, 0x30]);
    jpeg
}

fn bad_messages() -> Vec<(&'static str, Message)> {
    let image = |bytes: &[u8]| Message::text(telemetry_with(&STANDARD.encode(bytes), "7.0000"));
    let good = telemetry("7.0000");
    let mut truncated = jpeg(1);
    truncated.truncate(truncated.len() / 2);
    vec![
        ("broken base64", Message::text(telemetry_with("!!!not base64", "7.0000"))),
        ("no image", Message::text(telemetry_with("", "7.0000"))),
        ("not a JPEG", image(b"GIF89a and so on")),
        ("a truncated JPEG", image(&truncated)),
        ("30000x30000", image(&huge())),
        ("a missing speed", Message::text(good.replace(r#""speed":"7.0000","#, ""))),
        ("NaN", Message::text(good.replace("7.0000", "NaN"))),
        ("an absurd speed", Message::text(good.replace("7.0000", "1e300"))),
        ("an absurd angle", Message::text(good.replacen("0.0000", "99,999.0000", 1))),
        ("4 MB of text", Message::text(telemetry_with(&"A".repeat(4_000_000), "7.0000"))),
        ("a binary frame", Message::binary(vec![1, 2, 3])),
        ("deep JSON", Message::text(format!("42[\"telemetry\",{}", "[".repeat(100_000)))),
        (
            "deep JSON, closed",
            Message::text(format!("42[\"telemetry\",{}{}]", "[".repeat(100_000), "]".repeat(100_000))),
        ),
        ("an array", Message::text(r#"42["telemetry",[1,2,3]]"#)),
        ("no packet", Message::text("hello")),
        ("empty text", Message::text("")),
        ("half an event", Message::text(r#"42["telemetry",{"speed":"#)),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn every_bad_message_gets_one_safe_command_and_the_drive_goes_on() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let count = bad_messages().len() as u64;
    for (name, message) in bad_messages() {
        let (steering, throttle) = steer(&simulator.ask(&telemetry("7.0000")).await);
        assert!(throttle > 0.0, "before {name}");
        simulator.socket.send(message).await.unwrap();
        assert_eq!(steer(&simulator.text().await), (steering, 0.0), "{name}: as steered last, no throttle");
    }
    let summaries = running.stop().await;
    assert_eq!(summaries[0].count(Figure::BadFrames), count);
    let run = &summaries[0].run.as_ref().unwrap().path;
    let events = RunReader::open(run).unwrap().entries().map(Result::unwrap).filter(
        |moment| matches!(moment, Entry::Event { event: EventRecord::BadFrame { why, .. }, .. } if !why.is_empty()),
    );
    assert_eq!(events.count() as u64, count);
}

#[tokio::test(flavor = "multi_thread")]
async fn from_the_fifth_bad_frame_in_a_row_the_car_is_braked_to_a_standstill_and_not_reversed() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    simulator.ask(&telemetry("12.0000")).await;
    let mut throttles = vec![];
    for speed in
        ["12.0000", "12.0000", "12.0000", "12.0000", "12.0000", "8.0000", "4.9000", "2.0000", "0.5000", "0.0000"]
    {
        throttles.push(steer(&simulator.ask(&telemetry_with("broken", speed)).await).1);
    }
    assert_eq!(throttles, [0.0, 0.0, 0.0, 0.0, -1.0, -1.0, -1.0, -1.0, 0.0, 0.0]);
    assert!(steer(&simulator.ask(&telemetry("0.0000")).await).1 > 0.0, "a good frame and it drives again");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_network_without_an_answer_gets_the_car_a_safe_command_and_the_run_the_reason() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("net.pt");
    torchscript(&path, lost_for_words);
    let running = Running::without_a_model(settings(dir.path())).await;
    running.bridge.model_is_ready(models::load(&path, std::time::Instant::now).unwrap());
    let mut simulator = Wire::simulator(running.address).await;
    for _ in 0..3 {
        assert_eq!(steer(&simulator.ask(&telemetry("7.0000")).await), (0.0, 0.0));
    }
    let run = running.stop().await.remove(0).run.unwrap().path;
    let why = |moment| match moment {
        Ok(Entry::Event { event: EventRecord::BadFrame { why, .. }, .. }) => Some(why),
        _ => None,
    };
    let reasons: Vec<_> = RunReader::open(&run).unwrap().entries().filter_map(why).collect();
    assert_eq!(reasons, vec!["pilot: expected a finite steering from the network, got NaN"; 3]);
}
