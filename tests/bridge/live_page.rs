//! Our own page: what it shows, what it changes, and who may look.

use std::{net::SocketAddr, time::Duration};

use futures_util::{SinkExt, StreamExt};
use lapwing_core::recording::{EventRecord, Item, RunReader};
use lapwing_learn::models;
use serde_json::{Value, json};
use tempfile::tempdir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::{Instant, sleep, timeout},
};
use tokio_tungstenite::{
    WebSocketStream, client_async,
    tungstenite::{self, Message, client::IntoClientRequest},
};

use crate::support::{PATIENCE, Running, Wire, settings, steer, telemetry};

/// A request with these headers and this body; returns status, head and body.
pub(super) async fn ask(address: SocketAddr, request: &str, headers: &str, body: &str) -> (u16, String, Vec<u8>) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let length = body.len();
    let host = if headers.contains("Host:") { "" } else { "Host: localhost\r\n" };
    let text =
        format!("{request} HTTP/1.1\r\n{host}Connection: close\r\nContent-Length: {length}\r\n{headers}\r\n{body}");
    stream.write_all(text.as_bytes()).await.unwrap();
    let mut answer = vec![];
    timeout(PATIENCE, stream.read_to_end(&mut answer)).await.unwrap().unwrap();
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
    let head = String::from_utf8(answer[..end].to_vec()).unwrap().to_lowercase();
    (head[9..12].parse().unwrap(), head, answer[end + 4..].to_vec())
}

pub(super) async fn get(address: SocketAddr, path: &str) -> (u16, Value) {
    let (status, _, body) = ask(address, &format!("GET {path}"), "", "").await;
    (status, serde_json::from_slice(&body).unwrap_or_default())
}

pub(super) async fn control(address: SocketAddr, drive: u64, control: Value) -> (u16, Value) {
    let path = format!("POST /api/drives/{drive}/control");
    let (status, _, body) = ask(address, &path, "", &control.to_string()).await;
    (status, serde_json::from_slice(&body).unwrap_or_default())
}

/// A page's end of `/live`.
struct Look(WebSocketStream<TcpStream>);

impl Look {
    async fn dial(address: SocketAddr, query: &str, origin: Option<&str>) -> Result<Self, u16> {
        let mut request = format!("ws://{address}/live{query}").into_client_request().unwrap();
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", origin.parse().unwrap());
        }
        let stream = TcpStream::connect(address).await.unwrap();
        match client_async(request, stream).await {
            Ok((socket, _)) => Ok(Self(socket)),
            Err(tungstenite::Error::Http(response)) => Err(response.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }

    async fn next(&mut self) -> Option<Message> {
        timeout(PATIENCE, self.0.next()).await.unwrap().and_then(Result::ok)
    }

    /// The next text of this kind.
    async fn text(&mut self, kind: &str) -> Value {
        loop {
            let Some(Message::Text(text)) = self.next().await else { continue };
            let value: Value = serde_json::from_str(&text).unwrap();
            if value["kind"] == "moment" {
                self.say(&json!({ "seen": value["message"] }).to_string()).await;
            }
            if value["kind"] == kind {
                return value;
            }
        }
    }

    async fn say(&mut self, text: &str) {
        self.0.send(Message::text(text)).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_browser_gets_the_page_and_all_its_files_from_here_and_a_program_a_greeting() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let (status, head, body) = ask(running.address, "GET /", "Accept: text/html,*/*\r\n", "").await;
    let page = String::from_utf8(body).unwrap();
    assert!(status == 200 && head.contains("script-src 'self'") && head.contains("frame-ancestors 'none'"), "{head}");
    let mut files = 0;
    for part in page.split(['"']).filter(|part| part.starts_with("page/")) {
        let (status, head, body) = ask(running.address, &format!("GET /{part}"), "", "").await;
        let kind = if part.ends_with("js") { "text/javascript" } else { "text/css" };
        assert!(status == 200 && head.contains(kind) && (!body.is_empty() || part.contains("uplot")), "{part}: {head}");
        files += 1;
    }
    assert!(files > 8 && !page.contains("http://") && !page.contains("https://"), "nothing from elsewhere");
    let (_, _, greeting) = ask(running.address, "GET /", "", "").await;
    assert!(greeting.starts_with(b"Lapwing is here"));
    for path in
        ["/page/../Cargo.toml", "/page/%2e%2e/Cargo.toml", "/page//etc/passwd", "/page/", "/api", "/api/drives/1/../2"]
    {
        assert_eq!(ask(running.address, &format!("GET {path}"), "", "").await.0, 404, "{path}");
    }
    assert_eq!(ask(running.address, "GET /healthz", "", "").await.2, b"ok\n");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_sees_each_drive_as_it_happens_and_a_stalled_one_delays_nobody() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    steer(&simulator.ask(&telemetry("4.0000")).await);
    let mut page = Look::dial(running.address, "", Some(&format!("http://{}", running.address))).await.unwrap();
    let mut stalled = Look::dial(running.address, "", None).await.unwrap();
    let status = page.text("status").await;
    assert_eq!(status["status"]["phase"], "driving");
    assert!(status["status"]["can"]["pause"].is_string() && status["status"]["can"]["stop"].is_null());
    let mut slowest = Duration::ZERO;
    for _ in 0..400 {
        let began = Instant::now();
        steer(&simulator.ask(&telemetry("7.5000")).await);
        slowest = slowest.max(began.elapsed());
    }
    assert!(slowest < Duration::from_secs(1), "{slowest:?}");
    // Two moments were on their way; once one is seen, the newest comes, and not one that was skipped.
    let newest = loop {
        let moment = page.text("moment").await;
        if moment["turn"]["n"] == 401 {
            break moment;
        }
    };
    assert_eq!(newest["turn"]["speed_mph"], 7.5);
    let mut came = 0;
    while let Ok(Some(Ok(message))) = timeout(Duration::from_millis(500), stalled.0.next()).await {
        came += u32::from(message.is_binary());
    }
    assert!(came <= 2, "{came} pictures for a page that saw none");
    stalled.say(r#"{"seen":2}"#).await;
    let Some(picture) = (loop {
        match stalled.next().await {
            Some(Message::Binary(bytes)) => break Some(bytes),
            Some(Message::Text(text)) if text.contains("moment") => assert!(text.contains("\"n\":401"), "{text}"),
            Some(_) => {}
            None => break None,
        }
    }) else {
        panic!("no picture")
    };
    assert!(picture.starts_with(&[0xff, 0xd8]), "a JPEG");
    let (status, head, body) = ask(running.address, "GET /api/drives/1/picture", "", "").await;
    assert!(status == 200 && head.contains("image/jpeg") && body == picture);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_whose_simulator_leaves_keeps_looking_at_it_until_another_is_there() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut first = Wire::simulator(running.address).await;
    steer(&first.ask(&telemetry("4.0000")).await);
    let mut page = Look::dial(running.address, "", None).await.unwrap();
    let seen = |drives: &Value| (drives["drives"].as_array().unwrap().len(), drives["watched"].as_u64());
    assert_eq!(seen(&page.text("drives").await), (1, Some(1)));
    drop(first);
    assert_eq!(seen(&page.text("drives").await), (0, Some(1)), "the last picture stays");
    let mut second = Wire::simulator(running.address).await;
    steer(&second.ask(&telemetry("5.0000")).await);
    assert_eq!(seen(&page.text("drives").await), (1, Some(2)));
    assert_eq!(page.text("status").await["drive"], 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_that_begins_to_look_is_told_the_last_minute_at_once() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    for speed in ["4.0000", "5.0000", "6.0000"] {
        steer(&simulator.ask(&telemetry(speed)).await);
        sleep(Duration::from_millis(100)).await;
    }
    let mut page = Look::dial(running.address, "", None).await.unwrap();
    for how in ["opened", "at another tab, and back"] {
        let minute = page.text("minute").await;
        let turns = minute["turns"].as_array().unwrap();
        let speeds: Vec<_> = turns.iter().map(|turn| turn[1].as_f64()).collect();
        assert_eq!((&minute["drive"], speeds), (&json!(1), vec![Some(4.0), Some(5.0), Some(6.0)]), "{how}");
        assert_eq!(page.text("moment").await["turn"]["t"], turns[2][0], "{how}: curves go on where the minute ends");
        page.say(r#"{"watch":1}"#).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_page_asks_for_acts_at_the_next_frame_and_is_in_the_run() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let address = running.address;
    let mut simulator = Wire::simulator(address).await;
    let at_9 = telemetry("9.0000");
    steer(&simulator.ask(&at_9).await);
    assert_eq!(control(address, 1, json!({ "control": "set-speed", "mph": 25 })).await.0, 202);
    assert_eq!(steer(&simulator.ask(&at_9).await).1, 1.0, "full throttle");
    control(address, 1, json!({ "control": "stop" })).await;
    assert_eq!(steer(&simulator.ask(&at_9).await).1, -1.0, "full brake");
    assert_eq!(steer(&simulator.ask(&at_9).await).1, -1.0, "until the pilot is armed");
    assert_eq!(get(address, "/api/drives/1").await.1["status"]["hands"], "stopped");
    control(address, 1, json!({ "control": "arm" })).await;
    assert_eq!(steer(&simulator.ask(&at_9).await).1, 1.0);
    control(address, 1, json!({ "control": "take-over" })).await;
    assert_eq!(steer(&simulator.ask(&at_9).await), (0.0, 0.0), "it rolls out");
    control(address, 1, json!({ "control": "arm" })).await;
    control(address, 1, json!({ "control": "pilot", "index": 0 })).await;

    let mut page = Look::dial(address, "", None).await.unwrap();
    page.text("moment").await;
    page.say(r#"{"hand":{"steering":-0.5,"throttle":0.25}}"#).await;
    let by_hand = async { while steer(&simulator.ask(&at_9).await) != (-0.5, 0.25) {} };
    timeout(PATIENCE, by_hand).await.expect("the page has the wheel");
    drop(page); // and lets go as it leaves
    let by_pilot = async { while steer(&simulator.ask(&at_9).await).0 == -0.5 {} };
    timeout(PATIENCE, by_pilot).await.expect("the pilot drives again");

    let (status, refused) = control(address, 1, json!({ "control": "pause" })).await;
    assert!(status == 409 && refused["error"].as_str().unwrap().contains("lapwing drive --page"), "{refused}");
    for (drive, wrong, expected) in [
        (1, json!({ "control": "set-speed", "mph": -3 }), 400),
        (1, json!({ "control": "pilot", "index": 7 }), 400),
        (1, json!({ "control": "pilot", "path": "/etc/passwd" }), 400),
        (9, json!({ "control": "stop" }), 404),
    ] {
        assert_eq!(control(address, drive, wrong.clone()).await.0, expected, "{wrong}");
    }
    for (blanks, expected) in [(3000, 202), (5000, 400)] {
        let body = format!("{{\"control\":\"arm\"{}}}", " ".repeat(blanks));
        assert_eq!(ask(address, "POST /api/drives/1/control", "", &body).await.0, expected, "{blanks} blanks");
    }
    running.stop().await;
    let run = std::fs::read_dir(dir.path()).unwrap().next().unwrap().unwrap().path();
    let events: Vec<_> = RunReader::open(&run)
        .unwrap()
        .filter_map(|entry| match entry.unwrap().1 {
            Item::Event(event) => Some(event),
            _ => None,
        })
        .collect();
    for expected in [
        EventRecord::SpeedSet { mph: 25.0 },
        EventRecord::EmergencyStop,
        EventRecord::PilotArmed,
        EventRecord::TakeoverBegan,
    ] {
        assert!(events.contains(&expected), "{expected:?} in {events:?}");
    }
    let has = |kind: fn(&EventRecord) -> bool| events.iter().any(kind);
    assert!(has(|event| matches!(event, EventRecord::PilotOff { .. })));
    assert!(has(|event| matches!(event, EventRecord::PilotSet { sha256: Some(_), .. })));
    assert!(has(|event| matches!(event, EventRecord::TakeoverEnded { .. })));
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_pages_that_drive_by_hand_the_second_is_told_and_waits_until_the_first_lets_go() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::simulator(running.address).await;
    let at_9 = telemetry("9.0000");
    steer(&simulator.ask(&at_9).await);
    let mut first = Look::dial(running.address, "", None).await.unwrap();
    let mut second = Look::dial(running.address, "", None).await.unwrap();
    first.text("moment").await;
    second.text("moment").await;
    let [left, right] = [(-0.5, 0.25), (0.5, 1.0)];
    let hand = |(steering, throttle): (f64, f64)| {
        json!({ "hand": { "steering": steering, "throttle": throttle } }).to_string()
    };
    let taken = async {
        while steer(&simulator.ask(&at_9).await) != left {
            first.say(&hand(left)).await;
        }
    };
    timeout(PATIENCE, taken).await.expect("the first page has the wheel");
    // As a page does, again and again.
    let held = async {
        for _ in 0..1000 {
            first.say(&hand(left)).await;
            sleep(Duration::from_millis(20)).await;
        }
    };
    let refused = async {
        second.say(&hand(right)).await;
        let told = second.text("wheel").await;
        (told, steer(&simulator.ask(&at_9).await))
    };
    let (told, steered) = tokio::select! {
        () = held => panic!("the second page was told nothing"),
        refused = refused => refused,
    };
    assert_eq!((&told["why"], steered), (&json!("another page drives by hand"), left));
    first.say(r#"{"hand":null}"#).await;
    let taken = async {
        while steer(&simulator.ask(&at_9).await) != right {
            second.say(&hand(right)).await;
        }
    };
    timeout(PATIENCE, taken).await.expect("then the second has it");
    first.say(r#"{"hand":null}"#).await;
    drop(first);
    for _ in 0..10 {
        second.say(&hand(right)).await;
        assert_eq!(steer(&simulator.ask(&at_9).await), right, "who leaves without the wheel takes none along");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whether_a_run_is_being_written_is_told_while_it_lasts() {
    let dir = tempdir().unwrap();
    std::fs::write(dir.path().join("file"), "where a folder is wanted").unwrap();
    for (folder, is_written) in [("runs", true), ("file", false)] {
        let running = Running::start(settings(&dir.path().join(folder))).await;
        let mut simulator = Wire::simulator(running.address).await;
        // A turn is shown once its answer is out: the first one for certain before the second answer.
        for _ in 0..2 {
            steer(&simulator.ask(&telemetry("4.0000")).await);
        }
        let (_, drive) = get(running.address, "/api/drives/1").await;
        let file = &drive["status"]["file"];
        assert_eq!(file["name"].as_str().is_some_and(|name| name.ends_with(".mcap")), is_written, "{drive}");
        assert_eq!((file["trouble"].is_null(), &file["not_recorded"]), (is_written, &json!(0)), "{drive}");
        let (_, _, metrics) = ask(running.address, "GET /metrics", "", "").await;
        let line = format!("\nlapwing_run_being_written{{drive=\"1\"}} {}.0\n", u8::from(is_written));
        let metrics = String::from_utf8(metrics).unwrap();
        assert!(metrics.contains(&line), "{metrics}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_ends_and_another_begins_while_the_simulator_stays() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let address = running.address;
    let mut simulator = Wire::simulator(address).await;
    assert!(steer(&simulator.ask(&telemetry("4.0000")).await).1 > 0.0);
    control(address, 1, json!({ "control": "set-speed", "mph": 20 })).await;
    steer(&simulator.ask(&telemetry("4.0000")).await);
    control(address, 1, json!({ "control": "end-run" })).await;
    assert_eq!(steer(&simulator.ask(&telemetry("8.0000")).await).1, -1.0, "it is braked");
    assert_eq!(running.summaries.lock().unwrap().len(), 1);
    assert_eq!(get(address, "/api/drives/1").await.1["status"]["phase"], "ended");
    control(address, 1, json!({ "control": "start-run" })).await;
    assert!(steer(&simulator.ask(&telemetry("9.0000")).await).1 > 0.9, "20 mph, as was chosen");
    let (_, drive) = get(address, "/api/drives/1").await;
    assert_eq!((&drive["status"]["run"], &drive["status"]["phase"]), (&json!(2), &json!("driving")));
    assert_eq!(running.stop().await.len(), 2);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_others_look_at_nothing_and_no_page_takes_up_more_than_its_share() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let address = running.address;
    for origin in ["https://evil.example", "null", "http://localhost:8000"] {
        assert_eq!(Look::dial(address, "", Some(origin)).await.err(), Some(403), "{origin}");
        let headers = format!("Origin: {origin}\r\n");
        assert_eq!(ask(address, "POST /api/drives/1/control", &headers, r#"{"control":"stop"}"#).await.0, 403);
    }
    for path in ["/api/state", "/api/drives/1/picture", "/page/page.js", "/metrics"] {
        let rebound = "Host: evil.example:4567\r\n";
        assert_eq!(ask(address, &format!("GET {path}"), rebound, "").await.0, 403, "{path}, by a name pointed here");
        let embedded = "Sec-Fetch-Site: cross-site\r\n";
        assert_eq!(ask(address, &format!("GET {path}"), embedded, "").await.0, 403, "{path}, on another page");
    }
    let mut pages = vec![];
    for _ in 0..16 {
        pages.push(Look::dial(address, "", None).await.ok().unwrap());
    }
    assert_eq!(Look::dial(address, "", None).await.err(), Some(503));
    let mut large = pages.pop().unwrap();
    large.say(&format!("{{\"seen\":1,\"x\":\"{}\"}}", "x".repeat(2000))).await;
    let ends = async { while large.0.next().await.is_some_and(|message| message.is_ok_and(|m| !m.is_close())) {} };
    timeout(PATIENCE, ends).await.expect("a message that large ends it");
    let mut chatty = pages.pop().unwrap();
    let ends = async {
        while chatty.0.send(Message::text("{\"seen\":0}")).await.is_ok() {
            tokio::task::yield_now().await;
        }
    };
    timeout(PATIENCE, ends).await.expect("so many messages end it");
}

#[tokio::test(flavor = "multi_thread")]
async fn where_others_can_reach_the_port_the_token_is_wanted() {
    let dir = tempdir().unwrap();
    let running = Running::listening(([0, 0, 0, 0], 0).into(), settings(dir.path())).await;
    running.bridge.model_is_ready(models::built_in(std::time::Instant::now).unwrap());
    let address = SocketAddr::new([127, 0, 0, 1].into(), running.address.port());
    let token = running.bridge.page().want_token().unwrap().text().to_owned();
    let mut simulator = Wire::simulator(address).await;
    for _ in 0..2 {
        // A turn is shown once its answer is out: that of the first is, once the second is answered.
        steer(&simulator.ask(&telemetry("4.0000")).await);
    }
    let wrong = "0".repeat(32);
    for request in [
        "GET /api/state",
        "GET /api/drives/1",
        "GET /api/drives/1/picture",
        "GET /metrics",
        "POST /api/drives/1/control",
        "POST /arm",
    ] {
        let body = r#"{"control":"arm"}"#;
        assert_eq!(ask(address, request, "", body).await.0, 401, "{request}");
        assert_eq!(
            ask(address, request, &format!("Authorization: Bearer {wrong}\r\n"), body).await.0,
            401,
            "{request}"
        );
        let known = ask(address, request, &format!("Authorization: Bearer {token}\r\n"), body).await.0;
        assert!(known < 300, "{request}: {known}");
    }
    assert_eq!(Look::dial(address, "", None).await.err(), Some(401));
    assert_eq!(Look::dial(address, &format!("?token={wrong}"), None).await.err(), Some(401));
    assert!(Look::dial(address, &format!("?token={token}"), None).await.is_ok());
    for request in
        ["GET /api/drives/1/explained/visual-back-prop", "GET /api/runs/a.mcap/compared/0", "GET /api/runs/a.mcap"]
    {
        assert_eq!(ask(address, request, "", "").await.0, 401, "{request}");
    }
    for open in ["/", "/page/page.js", "/healthz", "/api/openapi.json"] {
        assert_eq!(ask(address, &format!("GET {open}"), "", "").await.0, 200, "{open} shows no drive");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recorded_run_is_looked_at_and_downloaded_and_nothing_else_of_the_disk() {
    let dir = tempdir().unwrap();
    let runs = dir.path().join("runs");
    std::fs::create_dir(&runs).unwrap();
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap");
    std::fs::copy(shipped, runs.join("lake.mcap")).unwrap();
    for other in [dir.path().join("secret.mcap"), runs.join("notes.txt")] {
        std::fs::copy(shipped, other).unwrap();
    }
    let running = Running::start(settings(&runs)).await;
    let address = running.address;
    let (_, listed) = get(address, "/api/runs").await;
    assert_eq!(listed.as_array().unwrap().iter().map(|run| &run["name"]).collect::<Vec<_>>(), ["lake.mcap"]);
    std::fs::write(runs.join("junk.mcap"), "junk").unwrap();
    let told = json!({ "error": "junk.mcap: expected a run (an MCAP file), got text" });
    assert_eq!(get(address, "/api/runs/junk.mcap").await, (500, told), "its name alone, and why");
    std::fs::remove_file(runs.join("junk.mcap")).unwrap();
    let (_, run) = get(address, "/api/runs/lake.mcap").await;
    assert_eq!(run["card"]["schema"], "lapwing.scorecard/1");
    let frames = run["frames_s"].as_array().unwrap();
    assert!(frames.len() > 10 && !run["drawn"]["t"].as_array().unwrap().is_empty());
    let last = format!("GET /api/runs/lake.mcap/frames/{}", frames.len() - 1);
    let (status, _, jpeg) = ask(address, &last, "", "").await;
    assert!(status == 200 && jpeg.starts_with(&[0xff, 0xd8]));
    assert_eq!(ask(address, &format!("GET /api/runs/lake.mcap/frames/{}", frames.len()), "", "").await.0, 404);
    let (_, head, file) = ask(address, "GET /api/runs/lake.mcap/file", "", "").await;
    assert!(head.contains("attachment; filename=\"lake.mcap\"") && file == std::fs::read(shipped).unwrap());
    let (_, head, report) = ask(address, "GET /api/runs/lake.mcap/report", "", "").await;
    let report = String::from_utf8(report).unwrap();
    assert!(head.contains("sandbox allow-scripts") && report.contains("Lapwing"));
    assert!(report.contains(r#""frames":[["#), "a report has pictures along the run");
    for name in
        ["..%2fsecret.mcap", "%2e%2e%2fsecret.mcap", "notes.txt", "lake.mcap%00", "%2fetc%2fpasswd", "nothing.mcap"]
    {
        for rest in ["", "/file", "/report", "/glance", "/frames/0"] {
            let (status, _, body) = ask(address, &format!("GET /api/runs/{name}{rest}"), "", "").await;
            assert!(status == 404 && body.len() < 200, "{name}{rest}: {status}");
        }
    }
}
