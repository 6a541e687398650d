//! Foxglove and Lichtblick: what they get of a drive, and who else does not.

use std::{collections::BTreeMap, fmt::Write, net::SocketAddr, path::Path, time::Duration};

use base64::{Engine, engine::general_purpose::STANDARD};
use futures_util::{SinkExt, StreamExt};
use lapwing_core::recording::Channel;
use lapwing_live::{
    bridge::{self, Listener},
    viewers::Viewers,
};
use lapwing_sim::track::Track;
use serde_json::{Value, json};
use tempfile::tempdir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    sync::oneshot,
    task::JoinHandle,
    time::timeout,
};
use tokio_tungstenite::{
    WebSocketStream, client_async,
    tungstenite::{self, Message, client::IntoClientRequest},
};

use crate::support::{PATIENCE, Running, Wire, settings, telemetry, telemetry_with};

/// A bridge that viewers may look at.
struct Watched {
    running: Running,
    address: SocketAddr,
    over: oneshot::Sender<()>,
    serving: JoinHandle<std::io::Result<()>>,
}

impl Watched {
    async fn start(dir: &Path, at: [u8; 4]) -> Self {
        let running = Running::start(settings(dir)).await;
        let listener = Listener::bind((at, 0).into()).await.unwrap();
        let address = SocketAddr::new([127, 0, 0, 1].into(), listener.address().port());
        let viewers = Viewers::new();
        running.bridge.has_viewers(viewers.clone());
        running.bridge.roadways_are_known([Track::named("lake").unwrap().roadway()].into());
        let (over, is_over) = oneshot::channel();
        let is_over = async move { is_over.await.unwrap_or_default() };
        let serving = tokio::spawn(bridge::serve_foxglove(listener, running.bridge.clone(), viewers, is_over));
        Self { running, address, over, serving }
    }

    /// Ends all runs; what viewers have not got yet, they get.
    async fn stop(self) {
        self.running.stop().await;
        self.over.send(()).unwrap();
        timeout(PATIENCE, self.serving).await.expect("it ends").unwrap().unwrap();
    }
}

/// A viewer.
struct View {
    socket: WebSocketStream<TcpStream>,
    /// Topics by the subscription's number, which is the channel's.
    topics: BTreeMap<u64, String>,
}

/// Topic, nanoseconds since 1970, and data.
type Got = (String, u64, Vec<u8>);

impl View {
    async fn dial(address: SocketAddr, query: &str, headers: &[(&'static str, &str)]) -> Result<Self, u16> {
        let mut request = format!("ws://{address}/{query}").into_client_request().unwrap();
        for (name, value) in headers {
            request.headers_mut().insert(*name, value.parse().unwrap());
        }
        let stream = TcpStream::connect(address).await.unwrap();
        match client_async(request, stream).await {
            Ok((socket, _)) => Ok(Self { socket, topics: BTreeMap::new() }),
            Err(tungstenite::Error::Http(response)) => Err(response.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }

    /// A viewer that subscribes to all that it is offered first.
    async fn of_all(address: SocketAddr) -> Self {
        let mut view = Self::dial(address, "", &[PROTOCOL]).await.ok().unwrap();
        assert_eq!(view.json().await["op"], "serverInfo");
        let offered = view.json().await;
        view.subscribe(&offered).await;
        view
    }

    async fn subscribe(&mut self, offered: &Value) {
        let channels = offered["channels"].as_array().unwrap();
        let topic = |channel: &Value| (channel["id"].as_u64().unwrap(), channel["topic"].as_str().unwrap().to_owned());
        self.topics.extend(channels.iter().map(topic));
        let subscription = |channel: &Value| json!({ "id": channel["id"], "channelId": channel["id"] });
        let subscriptions: Vec<_> = channels.iter().map(subscription).collect();
        self.say(json!({ "op": "subscribe", "subscriptions": subscriptions })).await;
    }

    async fn say(&mut self, value: Value) {
        self.socket.send(Message::text(value.to_string())).await.unwrap();
    }

    async fn next(&mut self) -> Option<Message> {
        timeout(PATIENCE, self.socket.next()).await.expect("something in a minute").and_then(Result::ok)
    }

    async fn json(&mut self) -> Value {
        match self.next().await {
            Some(Message::Text(text)) => serde_json::from_str(&text).unwrap(),
            other => panic!("no text: {other:?}"),
        }
    }

    /// The next message of a channel; none once the server has hung up.
    async fn message(&mut self) -> Option<Got> {
        match self.next().await {
            Some(Message::Binary(bytes)) => {
                assert_eq!(bytes[0], 1, "message data");
                let subscription = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                let time = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                Some((self.topics[&subscription.into()].clone(), time, bytes[13..].to_vec()))
            }
            Some(Message::Text(text)) => panic!("{text}"),
            _ => None,
        }
    }

    /// Whether the server hangs up.
    async fn hung_up(mut self) -> bool {
        let end =
            async { while self.socket.next().await.is_some_and(|message| message.is_ok_and(|m| !m.is_close())) {} };
        timeout(PATIENCE, end).await.is_ok()
    }
}

const PROTOCOL: (&str, &str) = ("sec-websocket-protocol", "foxglove.sdk.v1");

/// A telemetry on the lake's road so far from where it begins.
fn on_the_lake(metres: f64) -> String {
    let at = Track::named("lake").unwrap().point(metres, 0.0);
    let mut truth = String::new();
    for (key, value) in [("pos_x", at.x), ("pos_y", at.y), ("pos_z", at.z)] {
        write!(truth, r#""{key}":"{value:.4}","#).unwrap();
    }
    let stock = telemetry("9.0000");
    stock.replace(r#""image""#, &format!(r#"{truth}"hit":"none","track":"lake","image""#))
}

/// The messages of the only run in a folder, by topic.
fn in_run(dir: &Path) -> BTreeMap<String, Vec<(u64, Vec<u8>)>> {
    let mut files = std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path());
    let file = std::fs::read(files.next().unwrap()).unwrap();
    assert!(files.next().is_none());
    let mut messages = BTreeMap::<_, Vec<_>>::new();
    for message in mcap::MessageStream::new(&file).unwrap() {
        let message = message.unwrap();
        let topic = message.channel.topic.clone();
        messages.entry(topic).or_default().push((message.log_time, message.data.into_owned()));
    }
    messages
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_gets_of_each_channel_what_the_run_holds() {
    let dir = tempdir().unwrap();
    let watched = Watched::start(dir.path(), [127, 0, 0, 1]).await;
    let mut view = View::of_all(watched.address).await;
    let topics: Vec<_> = view.topics.values().cloned().collect();
    assert_eq!(topics, Channel::ALL.map(Channel::topic));
    let mut simulator = Wire::simulator(watched.running.address).await;
    let mut got = BTreeMap::<_, Vec<_>>::new();
    // Nothing answers a subscription: it holds once something comes.
    while !got.contains_key("/scene") {
        simulator.ask(&on_the_lake(1.0)).await;
        while let Ok(Some((topic, time, data))) = timeout(Duration::from_millis(100), view.message()).await {
            got.entry(topic).or_default().push((time, data));
        }
    }
    for metres in 2..6 {
        simulator.ask(&on_the_lake(f64::from(metres))).await;
    }
    simulator.ask(r#"42["telemetry",{"steering_angle":"x"}]"#).await;
    watched.stop().await;
    while let Some((topic, time, data)) = view.message().await {
        got.entry(topic).or_default().push((time, data));
    }
    let held = in_run(dir.path());
    for channel in Channel::ALL {
        let (topic, seen) = (channel.topic(), &got[channel.topic()]);
        let expected = &held[topic];
        match channel {
            // A viewer that is slow misses some, and one that comes just then is shown the road twice.
            Channel::Camera | Channel::Scene => assert!(seen.iter().all(|one| expected.contains(one)), "{topic}"),
            // It may have come after the first ones.
            _ => assert!(expected.ends_with(seen) && !seen.is_empty(), "{topic}: {seen:?} of {expected:?}"),
        }
    }
    assert_eq!(held["/scene"].len(), 1);
    assert!(held["/tf"].len() >= 4 && held["/tf"].len() < held["/telemetry"].len(), "none before the car has moved");
    let ended = |data: &[u8]| data.windows(13).any(|text| text == b"the run ended");
    assert!(got["/log"].last().is_some_and(|(_, data)| ended(data)), "to the very end");
}

#[tokio::test(flavor = "multi_thread")]
async fn simulators_beside_one_another_have_channels_of_their_own() {
    let dir = tempdir().unwrap();
    let watched = Watched::start(dir.path(), [127, 0, 0, 1]).await;
    let mut view = View::of_all(watched.address).await;
    let mut simulators = vec![];
    for _ in 0..2 {
        let mut simulator = Wire::simulator(watched.running.address).await;
        simulator.ask(&telemetry("9.0000")).await;
        simulators.push(simulator);
    }
    let offered = loop {
        if let Message::Text(text) = view.next().await.unwrap() {
            break serde_json::from_str(&text).unwrap();
        }
    };
    view.subscribe(&offered).await;
    let mut seen = std::collections::BTreeSet::new();
    while !(seen.contains("/telemetry") && seen.contains("/2/telemetry")) {
        for simulator in &mut simulators {
            simulator.ask(&telemetry("9.0000")).await;
        }
        while let Ok(Some((topic, ..))) = timeout(Duration::from_millis(100), view.message()).await {
            seen.insert(topic);
        }
    }
    watched.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_comes_late_is_shown_the_road_and_the_last_picture_under_the_old_name_of_the_protocol_too() {
    let dir = tempdir().unwrap();
    let watched = Watched::start(dir.path(), [127, 0, 0, 1]).await;
    let mut simulator = Wire::simulator(watched.running.address).await;
    for metres in 1..4 {
        simulator.ask(&on_the_lake(f64::from(metres))).await;
    }
    let old = ("sec-websocket-protocol", "foxglove.websocket.v1");
    let mut view = View::dial(watched.address, "", &[old]).await.ok().unwrap();
    view.json().await;
    let offered = view.json().await;
    let schema = |topic: &str| {
        let channels = offered["channels"].as_array().unwrap();
        channels.iter().find(|channel| channel["topic"] == topic).unwrap().clone()
    };
    let (log, command) = (schema("/log"), schema("/command"));
    assert_eq!((&log["schemaName"], &log["encoding"]), (&json!("foxglove.Log"), &json!("protobuf")));
    assert_eq!(STANDARD.decode(log["schema"].as_str().unwrap()).unwrap(), *Channel::Log.schema().data);
    assert_eq!((&command["schemaEncoding"], &command["encoding"]), (&json!("jsonschema"), &json!("json")));
    assert!(command["schema"].as_str().unwrap().contains("\"steering\""));
    view.subscribe(&offered).await;
    let (picture, scene) = (view.message().await.unwrap(), view.message().await.unwrap());
    let names = |name: &[u8]| scene.2.windows(name.len()).any(|part| part == name);
    assert_eq!((&*picture.0, &*scene.0), ("/camera/center", "/scene"));
    assert!(names(b"road") && names(b"car"));
    watched.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_that_does_not_read_delays_no_answer_and_gets_the_newest_picture_when_it_does() {
    const PICTURES: usize = 30;
    let dir = tempdir().unwrap();
    let watched = Watched::start(dir.path(), [127, 0, 0, 1]).await;
    let mut view = View::of_all(watched.address).await;
    let mut simulator = Wire::simulator(watched.running.address).await;
    // More than the sockets between them hold.
    let picture = |n: usize| vec![n as u8; 1 << 20];
    for n in 1..=PICTURES {
        simulator.ask(&telemetry_with(&STANDARD.encode(picture(n)), "9.0000")).await;
    }
    let mut came = vec![];
    while came.last() != Some(&PICTURES) {
        let (topic, _, data) = view.message().await.unwrap();
        if topic == "/camera/center" {
            came.push(usize::from(data[data.len() / 2]));
        }
    }
    assert!(came.len() < PICTURES && came.is_sorted(), "{came:?}");
    watched.stop().await;
}

/// The status of an answer to a request for a WebSocket with these headers.
async fn status(address: SocketAddr, headers: &str) -> u16 {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let request = format!("GET / HTTP/1.1\r\n{headers}Connection: Upgrade\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = [0; 12];
    timeout(PATIENCE, stream.read_exact(&mut answer)).await.unwrap().unwrap();
    std::str::from_utf8(&answer[9..]).unwrap().parse().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_of_another_site_sees_nothing_and_a_viewer_changes_nothing() {
    let dir = tempdir().unwrap();
    let watched = Watched::start(dir.path(), [127, 0, 0, 1]).await;
    let address = watched.address;
    let socket = "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n";
    let protocol = "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n";
    for (headers, expected) in [
        (format!("Host: localhost\r\n{socket}{protocol}"), 101),
        (format!("Host: localhost\r\nOrigin: file://\r\n{socket}{protocol}"), 101),
        (format!("Host: localhost\r\nOrigin: https://app.foxglove.dev\r\n{socket}{protocol}"), 101),
        (format!("Host: localhost\r\nOrigin: https://evil.example\r\n{socket}{protocol}"), 403),
        (format!("Host: localhost\r\nOrigin: null\r\n{socket}{protocol}"), 403),
        (
            format!(
                "Host: localhost:{}\r\nOrigin: http://localhost:{}\r\n{socket}{protocol}",
                address.port(),
                address.port()
            ),
            403,
        ),
        (format!("Host: evil.example\r\n{socket}{protocol}"), 403),
        (format!("Host: localhost\r\n{socket}"), 400),
        (format!("Host: localhost\r\n{socket}Sec-WebSocket-Protocol: foxglove.sdk.v9\r\n"), 400),
        ("Host: localhost\r\n".to_owned(), 426),
    ] {
        assert_eq!(status(address, &headers).await, expected, "{headers}");
    }

    let mut simulator = Wire::simulator(watched.running.address).await;
    let before = simulator.ask(&telemetry("9.0000")).await;
    let mut view = View::of_all(address).await;
    for said in [
        json!({ "op": "advertise", "channels": [{ "id": 1, "topic": "/command", "encoding": "json", "schemaName": "" }] }),
        json!({ "op": "setParameters", "parameters": [{ "name": "set_speed", "value": 30 }] }),
        json!({ "op": "subscribe", "subscriptions": [{ "id": 9, "channelId": 4_000_000_000_u64 }] }),
        json!({ "op": "unsubscribe", "subscriptionIds": [9, 10, 11] }),
    ] {
        view.say(said).await;
    }
    view.socket.send(Message::Binary(vec![1, 1, 0, 0, 0, b'{', b'}'].into())).await.unwrap();
    assert_eq!(simulator.ask(&telemetry("9.0000")).await, before);
    while view.message().await.unwrap().0 != "/command" {} // it still looks

    let garbage = |message: Message| async move {
        let mut view = View::dial(address, "", &[PROTOCOL]).await.ok().unwrap();
        view.socket.send(message).await.unwrap();
        view.hung_up().await
    };
    assert!(garbage(Message::text("garbage")).await);
    assert!(garbage(Message::text(format!("{{\"op\":\"{}\"}}", "x".repeat(40_000)))).await);
    let many: Vec<_> = (0..300).map(|id| json!({ "id": id, "channelId": 0 })).collect();
    assert!(garbage(Message::text(json!({ "op": "subscribe", "subscriptions": many }).to_string())).await);
    let mut chatty = View::dial(address, "", &[PROTOCOL]).await.ok().unwrap();
    let ends = async {
        while chatty.socket.send(Message::text("{\"op\":\"unsubscribe\",\"subscriptionIds\":[]}")).await.is_ok() {
            tokio::task::yield_now().await;
        }
    };
    timeout(PATIENCE, ends).await.expect("so many messages end it");
    drop(chatty);

    // Those that were dropped leave their places once the server has noticed.
    let mut views = vec![view];
    let full = async {
        loop {
            match View::dial(address, "", &[PROTOCOL]).await {
                Ok(view) => views.push(view),
                Err(status) => break status,
            }
        }
    };
    assert_eq!(timeout(PATIENCE, full).await.expect("it is full some day"), 503);
    assert!(views.len() <= 16, "{}", views.len());
    watched.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn where_others_can_reach_the_port_viewers_want_the_token() {
    let dir = tempdir().unwrap();
    let watched = Watched::start(dir.path(), [0, 0, 0, 0]).await;
    let token = watched.running.bridge.page().want_token().unwrap().text().to_owned();
    let dial = async |query: String| View::dial(watched.address, &query, &[PROTOCOL]).await.err();
    assert_eq!(dial(String::new()).await, Some(401));
    assert_eq!(dial(format!("?token={}", "0".repeat(32))).await, Some(401));
    assert_eq!(dial(format!("?token={token}")).await, None);
    watched.stop().await;
}
