//! Pages in a browser are turned away, programs are not.

use std::time::Duration;

use lapwing_core::config::Takeover;
use tempfile::tempdir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use crate::support::{PATIENCE, Running, UNITY, Wire, settings, steer, telemetry};

/// What the bridge answers to a request with these headers: status line and body.
async fn ask(running: &Running, request: &str, headers: &str) -> (String, String) {
    let mut stream = TcpStream::connect(running.address).await.unwrap();
    let text = format!("{request} HTTP/1.1\r\nConnection: close\r\nContent-Length: 0\r\n{headers}\r\n");
    stream.write_all(text.as_bytes()).await.unwrap();
    let mut answer = String::new();
    tokio::time::timeout(PATIENCE, stream.read_to_string(&mut answer)).await.unwrap().unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.to_lowercase(), body.to_owned())
}

/// The status of a WebSocket's handshake.
async fn dial(running: &Running, headers: &str) -> u16 {
    let mut stream = TcpStream::connect(running.address).await.unwrap();
    let text = format!(
        "GET /socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n{headers}\r\n"
    );
    stream.write_all(text.as_bytes()).await.unwrap();
    let mut head = [0; 12];
    tokio::time::timeout(PATIENCE, stream.read_exact(&mut head)).await.unwrap().unwrap();
    std::str::from_utf8(&head[9..]).unwrap().parse().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_elsewhere_opens_no_websocket_writes_no_run_and_ends_no_drive() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut paused = Wire::simulator(running.address).await;
    steer(&paused.ask(&telemetry("5.0000")).await);
    let local = "Host: 127.0.0.1:4567\r\n";
    for agent in [UNITY, "Mozilla/5.0"] {
        for origin in ["https://evil.example", "null", "http://127.0.0.1:8000"] {
            let headers = format!("{local}User-Agent: {agent}\r\nOrigin: {origin}\r\n");
            assert_eq!(dial(&running, &headers).await, 403, "{agent} from {origin}");
        }
        // Its own name, pointed here: to the browser the page is of this very origin.
        let rebound = format!("Host: evil.example:4567\r\nUser-Agent: {agent}\r\nOrigin: http://evil.example:4567\r\n");
        assert_eq!(dial(&running, &rebound).await, 403, "{agent}, rebound");
        assert_eq!(dial(&running, &format!("{local}User-Agent: {agent}\r\n")).await, 101, "no page");
    }
    tokio::time::sleep(Duration::from_millis(300)).await;
    steer(&paused.ask(&telemetry("5.0000")).await);
    assert_eq!(running.stop().await.len(), 1, "one drive, one summary");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "one run");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_elsewhere_arms_no_pilot_and_polls_no_session_unless_the_settings_name_it() {
    let dir = tempdir().unwrap();
    let mut settings = settings(dir.path());
    settings.control.takeover = Takeover::Latch;
    settings.bridge.allow_origins = vec!["http://localhost:3000".into()];
    let running = Running::start(settings).await;
    let mut simulator = Wire::simulator(running.address).await;
    steer(&simulator.ask(&telemetry("4.0000")).await);
    simulator.ask(r#"42["telemetry",null]"#).await;
    assert_eq!(steer(&simulator.ask(&telemetry("4.0000")).await), (0.0, 0.0), "latched");
    let local = "Host: localhost:4567\r\n";
    for page in
        ["Origin: https://evil.example\r\n", "Origin: http://localhost:4567\r\n", "Sec-Fetch-Site: cross-site\r\n"]
    {
        let (head, body) = ask(&running, "POST /arm", &format!("{local}{page}")).await;
        assert!(head.starts_with("http/1.1 403") && body.contains("bridge.allow_origins"), "{page}{head}{body}");
    }
    let (head, body) = ask(&running, "POST /arm", "Host: evil.example\r\n").await;
    assert!(head.starts_with("http/1.1 403") && body.contains("bridge.allow_hosts"), "{head}{body}");
    for page in ["Origin: https://evil.example\r\n", "Sec-Fetch-Site: cross-site\r\n"] {
        let (head, _) = ask(&running, "GET /socket.io/?EIO=4&transport=polling", &format!("{local}{page}")).await;
        assert!(head.starts_with("http/1.1 403"), "{page}{head}");
    }
    assert_eq!(steer(&simulator.ask(&telemetry("4.0000")).await), (0.0, 0.0), "latched as before");

    let allowed = format!("{local}Origin: http://localhost:3000\r\n");
    let (head, body) = ask(&running, "GET /socket.io/?EIO=4&transport=polling", &allowed).await;
    assert!(head.starts_with("http/1.1 200") && body.starts_with("0{"), "{head}{body}");
    assert!(head.contains("access-control-allow-origin: http://localhost:3000"), "or the page cannot read it: {head}");
    assert_eq!(ask(&running, "POST /arm", &allowed).await.1, "armed\n");
    assert!(steer(&simulator.ask(&telemetry("4.0000")).await).1 > 0.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_names_the_bridge_as_its_origin_is_greeted_at_once() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    // As python-socketio dials, through a tunnel.
    let own = "Host: 127.0.0.1:9999\r\nOrigin: http://127.0.0.1:9999\r\n";
    assert_eq!(dial(&running, own).await, 101);
    assert!(ask(&running, "GET /", "Host: 127.0.0.1:9999\r\n").await.1.starts_with("Lapwing is here"));
}
