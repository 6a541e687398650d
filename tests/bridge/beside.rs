//! What the page computes beside the drives: another model's steering on a recorded run, and what networks look at.

use std::{
    error::Error,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use lapwing_core::{
    perception::Frame,
    pilot::{Model, Pilot, PilotError, Prediction, View},
    recording::Recording,
    stats::Agreement,
    units::{Mph, Steering},
};
use lapwing_learn::models;
use lapwing_live::page::{Explaining, Explains, Layer, Looks};
use serde_json::Value;
use tempfile::tempdir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::timeout,
};

use super::live_page::{ask, get};
use crate::support::{PATIENCE, Running, Wire, settings, steer, telemetry};

const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap");

/// Explains by a layer of one colour, and counts how often.
struct Red(Arc<AtomicUsize>);

impl Explains for Red {
    fn explain(&mut self, frame: &Frame, _: Mph, _: Looks) -> Result<Layer, Box<dyn Error + Send + Sync>> {
        self.0.fetch_add(1, Ordering::SeqCst);
        let (width, height) = (frame.width(), frame.height());
        Ok(Layer { width, height, rgba: [255, 0, 0, 100].repeat(width * height) })
    }
}

/// A network that takes its time, and counts what it was shown.
struct Slow(Arc<AtomicUsize>);

impl Model for Slow {
    fn name(&self) -> &str {
        "slow"
    }

    fn sha256(&self) -> &str {
        "of nothing"
    }

    fn pilot(&self) -> Box<dyn Pilot> {
        Box::new(Slow(self.0.clone()))
    }
}

impl Pilot for Slow {
    fn steer(&mut self, _: &View<'_>) -> Result<Prediction, PilotError> {
        self.0.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(Duration::from_millis(20));
        Ok(Prediction::default())
    }

    fn reset(&mut self) {}
}

/// A bridge with the built-in model twice, of which the first is explained, and the shipped run.
async fn running(dir: &Path) -> (Running, Arc<AtomicUsize>) {
    std::fs::copy(SHIPPED, dir.join("lake.mcap")).unwrap();
    let running = Running::without_a_model(settings(dir)).await;
    let model: Arc<dyn Model> = Arc::new(models::built_in(Instant::now).unwrap());
    let count = Arc::new(AtomicUsize::new(0));
    let explained = (model.clone(), Explaining::by(Red(count.clone())));
    running.bridge.models_are_ready(vec![explained, (model, Explaining::not("it is not looked into"))]);
    (running, count)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recorded_run_is_shown_to_another_model_and_the_agreement_is_that_of_its_frames() {
    let dir = tempdir().unwrap();
    let (running, _) = running(dir.path()).await;
    let (status, head, body) = ask(running.address, "GET /api/runs/lake.mcap/compared/0", "", "").await;
    assert!(status == 200 && head.contains("application/x-ndjson"), "{head}");
    // Between them are the sizes of the chunks.
    let body = String::from_utf8(body).unwrap();
    let lines: Vec<Value> =
        body.lines().filter(|line| line.starts_with('{')).map(|line| serde_json::from_str(line).unwrap()).collect();
    let recorded: Vec<_> = Recording::open(SHIPPED).unwrap().seen().map(Result::unwrap).collect();
    assert_eq!((&lines[0]["model"], &lines[0]["moments"]), (&"pilotnet (built in)".into(), &recorded.len().into()));
    let (pieces, last) = (&lines[1..], lines.last().unwrap());
    assert!(pieces.len() > 3 && last["done"] == true && pieces[0]["done"] == false);
    let all =
        |key: &str| -> Vec<Value> { pieces.iter().flat_map(|piece| piece[key].as_array().unwrap()).cloned().collect() };
    let expected: Vec<_> = recorded.iter().map(|moment| moment.steering().map(Steering::get)).collect();
    assert_eq!(all("recorded").len(), expected.len());
    for (told, expected) in all("recorded").iter().zip(&expected) {
        assert_eq!(told.is_null(), expected.is_none());
        assert!(expected.is_none_or(|expected| (told.as_f64().unwrap() - expected).abs() < 1e-5));
    }
    let pairs: Vec<_> = all("steering").iter().map(|s| s.as_f64().unwrap()).zip(expected).collect();
    let pairs: Vec<_> = pairs.into_iter().filter_map(|(ours, recorded)| Some((ours, recorded?))).collect();
    let agreement = Agreement::of(pairs.iter().copied()).unwrap();
    let told = &last["agreement"];
    assert_eq!(told["frames"], agreement.frames);
    assert!((told["mae"].as_f64().unwrap() - agreement.mae).abs() < 1e-5, "{told}");
    assert!((told["r"].as_f64().unwrap() - agreement.r.unwrap()).abs() < 1e-4 && agreement.r > Some(0.8), "{told}");
    for (wrong, expected) in
        [("lake.mcap/compared/2", 400), ("nothing.mcap/compared/0", 404), ("..%2flake.mcap/compared/0", 404)]
    {
        assert_eq!(get(running.address, &format!("/api/runs/{wrong}")).await.0, expected, "{wrong}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_that_goes_away_ends_its_comparison() {
    let dir = tempdir().unwrap();
    std::fs::copy(SHIPPED, dir.path().join("lake.mcap")).unwrap();
    let running = Running::without_a_model(settings(dir.path())).await;
    let count = Arc::new(AtomicUsize::new(0));
    running.bridge.models_are_ready(vec![(Arc::new(Slow(count.clone())), Explaining::not("it sees nothing"))]);
    let mut page = TcpStream::connect(running.address).await.unwrap();
    page.write_all(b"GET /api/runs/lake.mcap/compared/0 HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
    let mut came = vec![];
    while !came.windows(8).any(|part| part == b"steering") {
        assert!(timeout(PATIENCE, page.read_buf(&mut came)).await.unwrap().unwrap() > 0);
    }
    drop(page);
    let mut shown = 0;
    loop {
        tokio::time::sleep(Duration::from_secs(1)).await;
        let now = count.load(Ordering::SeqCst);
        if now == std::mem::replace(&mut shown, now) {
            break;
        }
    }
    let all = Recording::open(SHIPPED).unwrap().seen().count();
    assert!(shown < all / 2, "{shown} of {all} frames were shown to the model");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_of_a_run_is_explained_by_the_model_that_is_asked_for() {
    let dir = tempdir().unwrap();
    let (running, count) = running(dir.path()).await;
    let asked = |rest: &'static str| ask(running.address, rest, "", "");
    let (status, head, png) = asked("GET /api/runs/lake.mcap/frames/60/explained/integrated-gradients/0").await;
    assert!(status == 200 && head.contains("image/png") && png.starts_with(b"\x89PNG"), "{head}");
    assert_eq!(count.load(Ordering::SeqCst), 1);
    let (status, _, why) = asked("GET /api/runs/lake.mcap/frames/60/explained/visual-back-prop/1").await;
    assert!(status == 409 && String::from_utf8(why).unwrap().contains("it is not looked into"));
    for (wrong, expected) in [
        ("GET /api/runs/lake.mcap/frames/60/explained/visual-back-prop/2", 400),
        ("GET /api/runs/lake.mcap/frames/60/explained/something/0", 400),
        ("GET /api/runs/lake.mcap/frames/6000/explained/visual-back-prop/0", 404),
        ("GET /api/drives/1/explained/visual-back-prop", 404),
    ] {
        assert_eq!(asked(wrong).await.0, expected, "{wrong}");
    }
    let (_, state) = get(running.address, "/api/state").await;
    let told: Vec<_> = state["pilots"].as_array().unwrap().iter().map(|pilot| &pilot["unexplained"]).collect();
    assert_eq!(told, [&Value::Null, &"it is not looked into".into()]);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_drive_looks_at_is_found_out_once_for_all_who_ask_at_a_time() {
    let dir = tempdir().unwrap();
    let (running, count) = running(dir.path()).await;
    let mut simulator = Wire::simulator(running.address).await;
    for _ in 0..3 {
        steer(&simulator.ask(&telemetry("4.0000")).await);
    }
    let look = || ask(running.address, "GET /api/drives/1/explained/visual-back-prop", "", "");
    let (one, two, three) = tokio::join!(look(), look(), look());
    let found = count.load(Ordering::SeqCst);
    assert!(one.0 == 200 && one.1.contains("image/png") && one.2 == two.2 && two.2 == three.2);
    // On a machine that is busy enough another one may be due before the last of them is answered.
    assert!((1..3).contains(&found), "{found}");
}
