//! Replays of the shipped run and of Udacity folders, in process and over the wire.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Instant,
};

use futures_util::{SinkExt, StreamExt};
use lapwing_core::stats::Agreement;
use lapwing_core::{
    client::{self, ClientOptions, PlayError},
    config::ControlSettings,
    drive,
    driver::Driver,
    pilot::{ConstantPilot, Pilot},
    protocol::Command,
    protocol::number::Culture,
    replay::{Answered, Answers, ForBridge, Golden, Rate, Replay, ReplayError, ReplayReport, Response},
    units::Steering,
};
use lapwing_learn::models;
use lapwing_score::score::Figure;
use tempfile::{TempDir, tempdir};
use tokio::{io::AsyncReadExt, io::AsyncWriteExt, net::TcpListener};
use tokio_tungstenite::tungstenite::Message;

use crate::{
    program::lapwing_in,
    support::{Running, jpeg, settings},
};

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/lake.mcap")
}

/// What a pilot that saw the frame says.
fn steered(answered: &Answered) -> Command {
    let Response::Steer(command) = answered.response else { panic!("{answered:?}") };
    command
}

/// What a pilot in this process answers, and what the recording lost.
pub fn answered_by(path: &Path, pilot: Box<dyn Pilot>) -> (Answers, (u64, Option<String>)) {
    let mut replay = Replay::open(path, Rate::Max).unwrap();
    let mut driver = Driver::new(pilot, &ControlSettings::default(), Instant::now);
    let mut answers = Answers::default();
    drive::run(&mut replay, &mut driver, &mut [&mut answers]).unwrap();
    (answers, replay.losses())
}

fn in_process(path: &Path) -> Answers {
    answered_by(path, models::built_in(Instant::now).unwrap().pilot()).0
}

fn for_bridge(path: &Path, rate: Rate) -> ForBridge {
    ForBridge::new(Replay::open(path, rate).unwrap())
}

/// A folder as the stock recorder leaves it, of so many rows.
fn udacity_folder(rows: u8) -> TempDir {
    let dir = tempdir().unwrap();
    fs::create_dir(dir.path().join("IMG")).unwrap();
    let mut log = String::new();
    for i in 0..rows {
        let name = format!("center_2026_11_21_08_00_{:02}_{:03}.jpg", i / 10, u32::from(i) % 10 * 100);
        // Far apart in brightness: a good network cares little for a few grey levels.
        fs::write(dir.path().join("IMG").join(&name), jpeg(i.wrapping_mul(40))).unwrap();
        let other = |camera: &str| name.replace("center", camera);
        let steering = f64::from(i % 7) / 20.0;
        log += &format!(
            "C:\\IMG\\{name}, C:\\IMG\\{}, C:\\IMG\\{}, {steering}, 0.5, 0, 9.1\n",
            other("left"),
            other("right")
        );
    }
    fs::write(dir.path().join("driving_log.csv"), log).unwrap();
    dir
}

#[test]
fn the_shipped_run_is_answered_frame_by_frame() {
    let (answers, losses) = answered_by(&shipped(), models::built_in(Instant::now).unwrap().pilot());
    assert_eq!((answers.answers().len(), losses), (225, (0, None)));
    let pairs = answers.answers().iter().map(|a| (steered(a).steering.get(), a.recorded.unwrap().get()));
    let agreement = Agreement::of(pairs).unwrap();
    assert_eq!(agreement.frames, 225);
    assert!(agreement.r.is_some());
}

#[test]
fn a_replay_agrees_with_its_golden_file_and_another_models_does_not() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("golden");
    let replay = in_process(&shipped());
    Golden::new("run", "model", replay.answers(), None).write(&path).unwrap();
    let golden = Golden::read(&path).unwrap();
    assert_eq!(golden.compare(in_process(&shipped()).answers(), 1e-6), []);
    let (other, _) = answered_by(&shipped(), Box::new(ConstantPilot::new(Steering::constant(0.9))));
    assert!(golden.compare(other.answers(), 1e-3).len() > 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn over_the_wire_the_same_commands_come_back_in_every_culture() {
    let folder = udacity_folder(40);
    let here = in_process(folder.path());
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let address = running.address.to_string();
    // C# itself would misread a minus sign behind the digits; that culture is written and not read.
    for culture in Culture::ALL.into_iter().filter(|c| c.name != "fa-IR") {
        let (path, address) = (folder.path().to_owned(), address.clone());
        let there = tokio::task::spawn_blocking(move || {
            let mut replay = for_bridge(&path, Rate::Max);
            let options = ClientOptions { culture, ..ClientOptions::default() };
            let report = client::play(&mut replay, &address, &options, |_| {}).unwrap();
            assert_eq!((report.telemetries, report.answers, report.lost_tokens), (40, 40, 0));
            replay
        })
        .await
        .unwrap();
        for (here, there) in here.answers().iter().zip(there.answers()) {
            let (a, b) = (steered(here), steered(there));
            // Four decimals on the wire.
            assert!((a.steering.get() - b.steering.get()).abs() < 1e-4, "{} {here:?} {there:?}", culture.name);
            assert!((a.throttle.get() - b.throttle.get()).abs() < 1e-4, "{} {here:?} {there:?}", culture.name);
        }
        assert_eq!(there.answers().len(), 40);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bridge_that_kicks_between_the_frames_of_a_slow_replay_does_not_mix_up_the_answers() {
    let folder = udacity_folder(6);
    let here = in_process(folder.path());
    let dir = tempdir().unwrap();
    let mut settings = settings(dir.path());
    settings.bridge.kick_after_s = 0.15;
    let running = Running::start(settings).await;
    let (path, address) = (folder.path().to_owned(), running.address.to_string());
    let there = tokio::task::spawn_blocking(move || {
        let mut replay = for_bridge(&path, Rate::Hz(2.0));
        client::play(&mut replay, &address, &ClientOptions::default(), |_| {}).unwrap();
        replay
    })
    .await
    .unwrap();
    let steering = |answers: &[Answered]| -> Vec<f64> { answers.iter().map(|a| steered(a).steering.get()).collect() };
    assert!(running.stop().await[0].count(Figure::Kicks) > 0);
    let (there, here) = (steering(there.answers()), steering(here.answers()));
    assert!(here.windows(2).all(|two| (two[0] - two[1]).abs() > 1e-3), "the frames are told apart: {here:?}");
    assert_eq!(there.len(), here.len());
    assert!(there.iter().zip(&here).all(|(a, b)| (a - b).abs() < 1e-4), "{there:?} {here:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_recorded_by_the_bridge_replays_to_the_commands_that_were_given() {
    let folder = udacity_folder(30);
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let (path, address) = (folder.path().to_owned(), running.address.to_string());
    tokio::task::spawn_blocking(move || {
        let mut replay = for_bridge(&path, Rate::Max);
        client::play(&mut replay, &address, &ClientOptions::default(), |_| {}).unwrap();
    })
    .await
    .unwrap();
    let run = running.stop().await.remove(0).run.unwrap().path;
    let again = in_process(&run);
    assert_eq!(again.answers().len(), 30);
    for answered in again.answers() {
        assert!((steered(answered).steering.get() - answered.recorded.unwrap().get()).abs() < 1e-6, "{answered:?}");
    }
}

#[test]
fn the_shipped_model_still_answers_the_shipped_run_as_it_did() {
    // Written by `lapwing replay recordings/lake.mcap --write-golden recordings/lake.golden`.
    let golden = Golden::read(&shipped().with_extension("golden")).unwrap();
    assert_eq!(golden.compare(in_process(&shipped()).answers(), 1e-3), []);
}

/// Makes these pictures of a folder PNGs under their old names, as a wrong tool does.
fn turn_into_png(folder: &Path, which: impl Fn(usize) -> bool) {
    let mut pictures: Vec<_> = fs::read_dir(folder.join("IMG")).unwrap().map(|e| e.unwrap().path()).collect();
    pictures.sort();
    for (_, path) in pictures.into_iter().enumerate().filter(|(i, _)| which(*i)) {
        let picture = image::load_from_memory(&fs::read(&path).unwrap()).unwrap();
        picture.save_with_format(&path, image::ImageFormat::Png).unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn pictures_that_no_network_can_see_are_bad_frames_in_process_and_over_the_wire() {
    let folder = udacity_folder(20);
    turn_into_png(folder.path(), |i| i % 4 == 1);
    let here = in_process(folder.path());
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let (path, address) = (folder.path().to_owned(), running.address.to_string());
    let there = tokio::task::spawn_blocking(move || {
        let mut replay = for_bridge(&path, Rate::Max);
        client::play(&mut replay, &address, &ClientOptions::default(), |_| {}).unwrap();
        replay
    });
    for answers in [here.answers(), there.await.unwrap().answers()] {
        for answered in answers {
            match &answered.response {
                Response::Bad { why } if answered.frame % 4 == 1 => {
                    assert_eq!(
                        why,
                        "image: expected a JPEG (ff d8 ff), got bytes that begin with 89 50 4e 47, as a PNG does"
                    );
                }
                Response::Steer(_) if answered.frame % 4 != 1 => {}
                other => panic!("frame {}: {other:?}", answered.frame),
            }
        }
        let times = vec![std::time::Duration::ZERO; 20];
        let names = (String::new(), String::new());
        let report = ReplayReport::new(names, answers, (0, None), (&times, times[0]));
        assert_eq!((report.moments, report.bad_frames, report.steering.unwrap().frames), (20, 5, 15));
        assert!(report.too_many_bad_frames().is_some());
    }
}

#[test]
fn an_image_that_is_missing_is_a_bad_frame_and_named_and_if_all_are_nothing_is_replayed() {
    let folder = udacity_folder(3);
    let missing = folder.path().join("IMG/center_2026_11_21_08_00_00_100.jpg");
    fs::remove_file(&missing).unwrap();
    let mut replay = Replay::open(folder.path(), Rate::Max).unwrap();
    let mut driver =
        Driver::new(Box::new(ConstantPilot::new(Steering::ZERO)), &ControlSettings::default(), Instant::now);
    let mut answers = Answers::default();
    drive::run(&mut replay, &mut driver, &mut [&mut answers]).unwrap();
    let [Response::Steer(_), Response::Bad { why }, Response::Steer(_)] =
        &answers.answers().iter().map(|answered| answered.response.clone()).collect::<Vec<_>>()[..]
    else {
        panic!("{answers:?}")
    };
    assert!(why.contains("center_2026_11_21_08_00_00_100.jpg"), "{why}");
    fs::remove_dir_all(folder.path().join("IMG")).unwrap();
    let mut replay = Replay::open(folder.path(), Rate::Max).unwrap();
    let error = drive::run(&mut replay, &mut driver, &mut [&mut Answers::default()]).unwrap_err().to_string();
    assert!(error.contains("center_2026_11_21_08_00_00_000.jpg: expected the image"), "{error}");
}

#[test]
fn of_a_run_that_is_cut_off_before_its_first_frame_nothing_is_replayed_and_no_golden_file_is_written() {
    let dir = tempdir().unwrap();
    let whole = fs::read(shipped()).unwrap();
    fs::write(dir.path().join("cut.mcap"), &whole[..100_000]).unwrap();
    let (code, out, err) = lapwing_in(dir.path(), "", &["replay", "cut.mcap", "--write-golden", "cut.golden"]);
    assert_eq!((code, out.as_str()), (1, ""), "{err}");
    assert!(err.contains("cut.mcap: expected frames with a picture, got none; "), "{err}");
    assert!(!dir.path().join("cut.golden").exists());
}

#[test]
fn what_is_no_recording_is_an_error_that_says_so() {
    let dir = tempdir().unwrap();
    let file = dir.path().join("run.mcap");
    fs::write(&file, "hello").unwrap();
    assert!(Replay::open(&file, Rate::Max).err().unwrap().to_string().contains("expected a run"));
    assert!(Replay::open(&dir.path().join("absent.mcap"), Rate::Max).is_err());
}

/// A server that answers the WebSocket handshake as told and then says one thing.
async fn odd_bridge(head: &'static str, says: &'static [u8]) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    tokio::spawn(async move {
        let (mut stream, _) = listener.accept().await.unwrap();
        let mut request = vec![0; 4096];
        let n = stream.read(&mut request).await.unwrap();
        let request = String::from_utf8_lossy(&request[..n]).into_owned();
        let key = request.split("Sec-WebSocket-Key: ").nth(1).unwrap().split("\r\n").next().unwrap();
        let accept = tokio_tungstenite::tungstenite::handshake::derive_accept_key(key.as_bytes());
        stream.write_all(head.replace("{accept}", &accept).as_bytes()).await.unwrap();
        stream.write_all(says).await.unwrap();
        tokio::time::sleep(std::time::Duration::from_secs(5)).await;
    });
    address
}

async fn play_to(address: String) -> PlayError<ReplayError> {
    tokio::task::spawn_blocking(move || {
        let mut replay = for_bridge(&shipped(), Rate::Max);
        let stall = std::time::Duration::from_millis(500);
        client::play(&mut replay, &address, &ClientOptions { stall, ..Default::default() }, |_| {}).unwrap_err()
    })
    .await
    .unwrap()
}

const SWITCH: &str = "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {accept}\r\n\r\n";

#[tokio::test]
async fn a_bridge_that_the_simulator_would_not_play_with_is_found_out() {
    let extension =
        "HTTP/1.1 101 x\r\nSec-WebSocket-Extensions: permessage-deflate\r\nSec-WebSocket-Accept: {accept}\r\n\r\n";
    let cases: [(&str, &[u8], &str); 6] = [
        ("HTTP/1.1 404 Not Found\r\n\r\n", b"", "expected HTTP/1.1 101"),
        (extension, b"", "no WebSocket extension"),
        (SWITCH, b"\x82\x02hi", "expected text, got \"2 bytes of binary\""),
        (SWITCH, b"\x81\x05hello", "expected an Engine.IO packet"),
        (SWITCH, b"\x81\x030{}", "an OPEN packet with sid"),
        (SWITCH, b"", "stalls here"),
    ];
    for (head, says, expected) in cases {
        let error = play_to(odd_bridge(head, says).await).await.to_string();
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

/// A bridge that answers the frame of each number with that many hundredths, but to the first says nonsense.
async fn bridge_that_stutters() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    tokio::spawn(async move {
        let (stream, _) = listener.accept().await.unwrap();
        let mut socket = tokio_tungstenite::accept_async(stream).await.unwrap();
        socket.send(Message::text(r#"0{"sid":"x"}"#)).await.unwrap();
        let mut frame = 0;
        while let Some(Ok(message)) = socket.next().await {
            if message.to_text().is_ok_and(|text| text.contains("telemetry")) {
                let steering = if frame == 0 { "nonsense".into() } else { format!("{frame}e-2") };
                let steer = format!(r#"42["steer",{{"steering_angle":"{steering}","throttle":"0"}}]"#);
                socket.send(Message::text(steer)).await.unwrap();
                frame += 1;
            }
        }
    });
    address
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_that_cannot_be_read_does_not_put_later_ones_to_the_wrong_frames() {
    let (folder, address) = (udacity_folder(5), bridge_that_stutters().await);
    let replay = tokio::task::spawn_blocking(move || {
        let mut replay = for_bridge(folder.path(), Rate::Max);
        let report = client::play(&mut replay, &address, &ClientOptions::default(), |_| {}).unwrap();
        assert_eq!((report.telemetries, report.answers, report.lost_tokens), (5, 4, 1));
        assert_eq!(report.round_trips.len(), 5, "a time for each frame");
        replay
    });
    let replay = replay.await.unwrap();
    let [first, others @ ..] = replay.answers() else { panic!("no answers") };
    assert_eq!(first.response, Response::Bad { why: "its answer could not be read".into() });
    let others: Vec<_> = others.iter().map(|a| (a.frame, steered(a).steering.get())).collect();
    assert_eq!(others, [(1, 0.01), (2, 0.02), (3, 0.03), (4, 0.04)]);
    // Each line of a golden file is held against the answer to its own frame.
    let mut readable = replay.answers().to_vec();
    readable[0].response = Response::Steer(Command::default());
    let golden = Golden::new("folder", "bridge", &readable, None);
    assert_eq!(golden.compare(replay.answers(), 0.0).iter().map(|d| d.frame).collect::<Vec<_>>(), [0]);
}

#[test]
fn where_no_bridge_is_the_address_is_named() {
    let mut replay = Replay::open(&shipped(), Rate::Max).unwrap();
    let error = client::play(&mut replay, "127.0.0.1:1", &ClientOptions::default(), |_| {}).unwrap_err();
    assert!(error.to_string().starts_with("cannot connect to 127.0.0.1:1: "), "{error}");
}
