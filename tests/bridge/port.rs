//! What a port bears that anybody can reach: size, number, time.

use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use lapwing_core::config::Settings;
use tempfile::tempdir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpSocket, TcpStream},
    time::{sleep, timeout},
};
use tokio_tungstenite::tungstenite::{
    Message,
    protocol::frame::{
        Frame,
        coding::{Control, Data, OpCode},
    },
};

use crate::support::{PATIENCE, Running, Wire, settings, steer, telemetry, telemetry_with};

/// A bridge with these limits that does not kick.
async fn with_limits(change: impl FnOnce(&mut Settings)) -> (tempfile::TempDir, Running) {
    let dir = tempdir().unwrap();
    let mut settings = settings(dir.path());
    change(&mut settings);
    let running = Running::start(settings).await;
    (dir, running)
}

async fn connect(running: &Running, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(running.address).await.unwrap();
    stream.write_all(text.as_bytes()).await.unwrap();
    stream
}

/// Everything until the bridge hangs up.
async fn rest(stream: &mut TcpStream, wait: Duration) -> Option<String> {
    let mut bytes = Vec::new();
    match timeout(wait, stream.read_to_end(&mut bytes)).await {
        Err(_) => None,
        Ok(_) => Some(String::from_utf8_lossy(&bytes).into_owned()), // a reset is an end, too
    }
}

/// Sends frames until the connection breaks; how many that took. `None` where all were taken.
async fn send_until_dropped(wire: &mut Wire, first: Option<Frame>, frame: &Frame, count: usize) -> Option<usize> {
    for (i, frame) in first.iter().chain(std::iter::repeat_n(frame, count)).enumerate() {
        if wire.socket.send(Message::Frame(frame.clone())).await.is_err() {
            return Some(i);
        }
    }
    let ended = wire.ends_within(Duration::from_secs(2)).await;
    ended.then_some(count)
}

fn frame(kind: OpCode, bytes: usize, last: bool) -> Frame {
    Frame::message(vec![b'x'; bytes], kind, last)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_of_four_mib_is_answered_and_a_larger_one_ends_the_connection() {
    let (_dir, running) = with_limits(|_| {}).await;
    let mut simulator = Wire::simulator(running.address).await;
    steer(&simulator.ask(&telemetry("7.0000")).await);
    let (_, throttle) = steer(&simulator.ask(&telemetry_with(&"A".repeat((4 << 20) - 200), "7.0000")).await);
    assert_eq!(throttle, 0.0, "no picture, but an answer");
    let mut good = Wire::simulator(running.address).await;
    // The bridge may have closed before it is sent whole.
    let _ = simulator.socket.send(Message::text(telemetry_with(&"A".repeat(4 << 20), "7.0000"))).await;
    assert!(simulator.ends_within(Duration::from_secs(2)).await);
    steer(&good.ask(&telemetry("7.0000")).await);

    let mut client = Wire::dial(running.address, "python-socketio", "EIO=3&transport=websocket").await;
    client.text().await;
    client.text().await;
    steer(&client.ask(&telemetry_with(&"A".repeat((4 << 20) - 200), "7.0000")).await);
    let _ = client.socket.send(Message::text("4".repeat((4 << 20) + 1))).await;
    assert!(client.ends_within(Duration::from_secs(2)).await, "the limit is the same for every client");
}

#[tokio::test(flavor = "multi_thread")]
async fn fragments_that_come_to_nothing_and_pings_without_end_drop_whoever_sends_them() {
    let (_dir, running) = with_limits(|_| {}).await;
    let mut good = Wire::simulator(running.address).await;
    steer(&good.ask(&telemetry("7.0000")).await);
    let text = || Some(frame(OpCode::Data(Data::Text), 0, false));
    for (what, first, repeated) in [
        ("empty fragments", text(), frame(OpCode::Data(Data::Continue), 0, false)),
        ("tiny fragments", text(), frame(OpCode::Data(Data::Continue), 2, false)),
        ("WebSocket pings", None, frame(OpCode::Control(Control::Ping), 0, true)),
        ("pings", None, Frame::message("2", OpCode::Data(Data::Text), true)),
        ("empty messages", None, frame(OpCode::Data(Data::Text), 0, true)),
    ] {
        for query in ["EIO=4&transport=websocket", "EIO=3&transport=websocket"] {
            let agent = if query.starts_with("EIO=4") { crate::support::UNITY } else { "python-socketio" };
            let mut peer = Wire::dial(running.address, agent, query).await;
            let dropped = send_until_dropped(&mut peer, first.clone(), &repeated, 10_000).await;
            assert!(dropped.is_some(), "{what} by {agent}");
        }
        steer(&good.ask(&telemetry("7.0000")).await);
    }
    let mut tiny = Wire::simulator(running.address).await;
    let telemetry = telemetry("7.0000");
    let last = telemetry.len().div_ceil(125) - 1;
    for (i, part) in telemetry.as_bytes().chunks(125).enumerate() {
        let kind = if i == 0 { Data::Text } else { Data::Continue };
        let frame = Frame::message(part.to_vec(), OpCode::Data(kind), i == last);
        tiny.socket.send(Message::Frame(frame)).await.unwrap();
    }
    steer(&tiny.text().await);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_never_ends_and_is_allowed_leaves_the_others_their_turn() {
    let (_dir, running) = with_limits(|_| {}).await;
    let mut good = Wire::simulator(running.address).await;
    steer(&good.ask(&telemetry("7.0000")).await);
    let mut floods = vec![];
    for _ in 0..4 {
        let mut wire = Wire::simulator(running.address).await;
        floods.push(tokio::spawn(async move {
            // Messages that are no telemetry: neither answered nor limited.
            let packets = Message::text("6 a packet that is passed over");
            while wire.socket.feed(packets.clone()).await.is_ok() {}
        }));
    }
    sleep(Duration::from_millis(200)).await;
    let mut times = vec![];
    for _ in 0..40 {
        let began = Instant::now();
        steer(&good.ask(&telemetry("7.0000")).await);
        times.push(began.elapsed());
    }
    times.sort();
    floods.iter().for_each(|flood| flood.abort());
    assert!(times[20] < Duration::from_millis(150), "the floods themselves take their share: {times:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn connections_beyond_the_limit_are_turned_away_and_who_leaves_makes_room() {
    let (_dir, running) = with_limits(|settings| settings.bridge.limits.connections = 3).await;
    let mut good = Wire::simulator(running.address).await;
    let idle = [connect(&running, "").await, connect(&running, "GET / HTTP/1.1\r\n").await];
    let mut fourth = connect(&running, "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").await;
    let began = Instant::now();
    assert_eq!(rest(&mut fourth, PATIENCE).await.as_deref(), Some(""), "not even answered");
    assert!(began.elapsed() > Duration::from_millis(500), "at once would be an invitation: {:?}", began.elapsed());
    steer(&good.ask(&telemetry("7.0000")).await);
    drop(idle);
    let mut fifth = connect(&running, "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").await;
    assert!(rest(&mut fifth, PATIENCE).await.unwrap().starts_with("HTTP/1.1 200"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_head_that_does_not_come_and_a_connection_that_asks_no_more_are_closed_and_a_simulator_is_not() {
    let (_dir, running) = with_limits(|settings| settings.bridge.limits.patience_s = 0.4).await;
    let mut simulator = Wire::simulator(running.address).await;
    for what in ["", "GET / HTTP/1.1\r\nHost: loc", "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"] {
        let mut stream = connect(&running, what).await;
        let began = Instant::now();
        let answer = rest(&mut stream, PATIENCE).await.expect(what);
        assert_eq!(answer.starts_with("HTTP/1.1 200"), what.ends_with("\r\n\r\n"), "{answer}");
        assert!(began.elapsed() > Duration::from_millis(300), "{what}");
    }
    steer(&simulator.ask(&telemetry("7.0000")).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_that_polling_opens_are_limited_too() {
    let (_dir, running) = with_limits(|settings| settings.bridge.limits.connections = 5).await;
    let mut statuses = vec![];
    for _ in 0..8 {
        let open = "GET /socket.io/?EIO=3&transport=polling HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
        let answer = rest(&mut connect(&running, open).await, PATIENCE).await.unwrap();
        statuses.push(answer[9..12].to_owned());
    }
    assert_eq!(statuses, ["200", "200", "200", "200", "200", "503", "503", "503"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_websocket_is_opened_only_where_its_frames_are_watched() {
    let (_dir, running) = with_limits(|_| {}).await;
    let key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13";
    for (query, upgrade) in [
        ("EIO=4&transport=websocket", "Upgrade: x"),
        ("EIO=3&transport=websocket=x", "Upgrade: websocket, x"),
        ("EIO=4&transport=websocket", "X: y"),
    ] {
        let dial = format!(
            "GET /socket.io/?{query} HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\n{upgrade}\r\n{key}\r\n\r\n"
        );
        let answer = rest(&mut connect(&running, &dial).await, PATIENCE).await.expect(query);
        let expected = "expected Upgrade: websocket and a Sec-WebSocket-Key";
        assert!(answer.starts_with("HTTP/1.1 400") && answer.contains(expected), "{query}, {upgrade}: {answer}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asks_and_never_reads_the_answers_loses_his_place() {
    let (_dir, running) = with_limits(|settings| {
        settings.bridge.limits.connections = 1;
        settings.bridge.limits.patience_s = 0.4;
    })
    .await;
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let mut deaf = socket.connect(running.address).await.unwrap();
    let requests = "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(1000);
    let dropped =
        timeout(Duration::from_secs(20), async { while deaf.write_all(requests.as_bytes()).await.is_ok() {} });
    assert!(dropped.await.is_ok(), "it is still there");
    let mut next = connect(&running, "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").await;
    assert!(rest(&mut next, PATIENCE).await.unwrap().starts_with("HTTP/1.1 200"));
}

/// Opens a session by polling; its id.
async fn session(running: &Running) -> String {
    let open = "GET /socket.io/?EIO=4&transport=polling HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let answer = rest(&mut connect(running, open).await, PATIENCE).await.unwrap();
    answer.split_once("\"sid\":\"").unwrap_or_else(|| panic!("{answer}")).1.split('"').next().unwrap().to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_posted_body_is_limited_whether_it_says_its_length_or_not() {
    let (_dir, running) = with_limits(|_| {}).await;
    let post = |sid: &str, more: &str| {
        format!("POST /socket.io/?EIO=4&transport=polling&sid={sid} HTTP/1.1\r\nHost: localhost\r\n{more}\r\n\r\n")
    };
    let sid = session(&running).await;
    let mut announced = connect(&running, &post(&sid, "Content-Length: 66060288")).await;
    let answer = rest(&mut announced, PATIENCE).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 413") && answer.contains("at most 4096 KiB"), "{answer}");

    let mut chunked = connect(&running, &post(&sid, "Transfer-Encoding: chunked")).await;
    let chunk = format!("10000\r\n{}\r\n", "x".repeat(1 << 16));
    let mut sent = 0;
    let broke = timeout(Duration::from_secs(10), async {
        while chunked.write_all(chunk.as_bytes()).await.is_ok() {
            sent += 1 << 16;
        }
    });
    assert!(broke.await.is_ok() && sent < 16 << 20, "{sent} bytes were taken");

    let sid = session(&running).await;
    let mut whole = connect(&running, &post(&sid, "Content-Length: 2\r\nConnection: close")).await;
    whole.write_all(b"40").await.unwrap();
    assert!(rest(&mut whole, PATIENCE).await.unwrap().ends_with("ok"));
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn a_hundred_unfinished_posts_and_messages_take_no_more_room_than_all_messages_may() {
    let (_dir, running) = with_limits(|settings| {
        settings.bridge.limits.connections = 128;
        settings.bridge.limits.in_flight_mib = 16;
    })
    .await;
    let mut good = Wire::simulator(running.address).await;
    steer(&good.ask(&telemetry("7.0000")).await);
    let before = resident_mib();
    let mut held = vec![];
    for i in 0..110 {
        let sid = if i % 2 == 0 { session(&running).await } else { String::new() };
        let mut stream = if i % 2 == 0 {
            let post = format!(
                "POST /socket.io/?EIO=4&transport=polling&sid={sid} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4000000\r\n\r\n"
            );
            connect(&running, &post).await
        } else {
            let mut wire = Wire::simulator(running.address).await;
            wire.socket.get_mut().write_all(&[1, 0x80 | 127, 0, 0, 0, 0, 0, 0x3d, 9, 0, 1, 2, 3, 4]).await.unwrap();
            wire.socket.into_inner()
        };
        let _ = timeout(Duration::from_millis(200), stream.write_all(&vec![b'x'; 3_900_000])).await; // may be cut off
        held.push(stream);
    }
    let peak = resident_mib() - before;
    // What this test's own end and the kernel hold is no more than a part of it: 110 of them would be 420 MB.
    assert!(peak < 150.0, "{peak} MiB more than before");
    steer(&good.ask(&telemetry("7.0000")).await);
}

#[cfg(target_os = "linux")]
fn resident_mib() -> f64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap();
    text.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() * 4096.0 / f64::from(1 << 20)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_comes_before_a_handshake_is_over_is_not_lost_to_an_ordinary_client() {
    let (_dir, running) = with_limits(|_| {}).await;
    let mut client = Wire::dial(running.address, "python-socketio", "EIO=3&transport=websocket").await;
    // The messages are there before the bridge has passed the connection on.
    for _ in 0..3 {
        client.send(&telemetry("0.0000")).await;
    }
    let mut steers = 0;
    while steers < 3 {
        let text = client.socket.next().await.unwrap().unwrap().into_text().unwrap();
        steers += u32::from(text.starts_with(r#"42["steer""#));
    }
}
