//! Simulators of other names, and ordinary Socket.IO clients on the same port.
//! The real libraries are run by `tests/interop`.

use std::time::Duration;

use tempfile::tempdir;

use lapwing_score::score::Figure;

use crate::support::{PATIENCE, Running, Wire, settings, steer, telemetry};

/// The answer of a server of Engine.IO 4, whose own pings may come first.
async fn ask(client: &mut Wire, text: &str) -> String {
    client.send(text).await;
    loop {
        match client.text().await.as_str() {
            "2" => client.send("3").await,
            text => return text.to_owned(),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_talks_before_being_greeted_is_served_as_a_simulator() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut simulator = Wire::dial(running.address, "UnityPlayer/2020.3", "EIO=4&transport=websocket").await;
    steer(&simulator.ask(&telemetry("0.0000")).await);
    steer(&simulator.ask(&telemetry("0.0000")).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_ordinary_client_of_protocol_5_is_greeted_and_steered() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut client = Wire::dial(running.address, "node-XMLHttpRequest", "EIO=4&transport=websocket").await;
    let open = client.text().await;
    assert!(open.starts_with("0{\"sid\":"), "{open}");
    let connected = ask(&mut client, "40").await;
    assert!(connected.starts_with("40{\"sid\":"), "{connected}");
    let (_, throttle) = steer(&ask(&mut client, &telemetry("0.0000")).await);
    assert_eq!(throttle, 0.918);
    assert_eq!(ask(&mut client, r#"42["telemetry",null]"#).await, r#"42["manual",{}]"#);
    client.send(r#"42["hello"]"#).await;
    assert_eq!(ask(&mut client, r#"42["telemetry"]"#).await, r#"42["manual",{}]"#, "to telemetry, not to hello");
    client.send("41").await;
    drop(client);
    let over = async {
        while running.summaries.lock().unwrap().is_empty() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(PATIENCE, over).await.expect("its run ends when it leaves");
    assert_eq!(running.summaries.lock().unwrap()[0].count(Figure::BadFrames), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_ordinary_client_that_does_not_wait_for_the_greeting_is_served_all_the_same() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut client = Wire::dial(running.address, "impatient", "EIO=4&transport=websocket").await;
    client.send("40").await;
    assert!(client.text().await.starts_with("0{\"sid\":"));
    // Connected in between; the answer to a telemetry says so better than the order of pings.
    while !client.text().await.starts_with("40{\"sid\":") {}
    steer(&ask(&mut client, &telemetry("0.0000")).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_ordinary_client_of_protocol_4_is_greeted_and_steered() {
    let dir = tempdir().unwrap();
    let running = Running::start(settings(dir.path())).await;
    let mut client = Wire::dial(running.address, "python-socketio", "EIO=3&transport=websocket").await;
    assert!(client.text().await.starts_with("0{\"sid\":"));
    assert_eq!(client.text().await, "40");
    steer(&client.ask(&telemetry("0.0000")).await);
}
