//! What `/api/openapi.json` says, held against what is answered.

use std::{cell::Cell, net::SocketAddr};

use lapwing::known::{Roads, courses};
use serde_json::{Value, json};
use tempfile::tempdir;

use super::{
    live_page::{ask, control, get},
    schema::wrong,
};
use crate::support::{Running, Wire, settings, steer, telemetry};

/// The description that a bridge gives of its paths.
struct Documented {
    address: SocketAddr,
    document: Value,
}

impl Documented {
    async fn at(address: SocketAddr) -> Self {
        let (_, document) = get(address, "/api/openapi.json").await;
        Self { address, document }
    }

    /// Asks, and returns the status and the answer if these are as the description of `path` says.
    async fn ask(&self, method: &str, path: &str, request: &str, body: &str) -> (u16, Vec<u8>) {
        let (status, head, answer) = ask(self.address, &format!("{} {request}", method.to_uppercase()), "", body).await;
        let text = String::from_utf8_lossy(&answer);
        let documented = &self.document["paths"][path][method]["responses"][status.to_string()];
        let content = documented["content"].as_object();
        let (kind, content) =
            content.and_then(|all| all.iter().next()).unwrap_or_else(|| panic!("{request}: {status} {text}"));
        assert!(head.contains(kind), "{request}: {head}");
        if kind.contains("json") {
            // One value; or one a line, between the lengths of what was sent at a time.
            let texts: Vec<_> = match kind.ends_with("ndjson") {
                true => text.lines().filter(|line| line.starts_with('{')).collect(),
                false => vec![&*text],
            };
            assert!(!texts.is_empty(), "{request}");
            for text in texts {
                let value = serde_json::from_str(text).unwrap_or_else(|error| panic!("{request}: {error} in {text}"));
                let wrong = wrong(&self.document, &content["schema"], &value);
                assert!(wrong.is_empty(), "{request}: {status} {wrong:#?}");
            }
        }
        (status, answer)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_documented_path_answers_as_documented() {
    let dir = tempdir().unwrap();
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/lake.mcap"), dir.path().join("lake.mcap")).unwrap();
    let running = Running::start(settings(dir.path())).await;
    running.bridge.page().has_courses(courses(&Roads::default()).unwrap());
    let mut simulator = Wire::simulator(running.address).await;
    // Once there is a drive, its score is made where a turn comes while somebody waits for it.
    steer(&simulator.ask(&telemetry("4.0000")).await);
    let done = Cell::new(false);
    let scraped = async {
        let (_, _, metrics) = ask(running.address, "GET /metrics", "", "").await;
        done.set(true);
        String::from_utf8(metrics).unwrap()
    };
    let driven = async {
        let mut asked = 1;
        while asked < 3 || !done.get() {
            steer(&simulator.ask(&telemetry("4.0000")).await);
            asked += 1;
        }
        asked
    };
    let (scored, asked) = tokio::join!(scraped, driven);
    assert!(scored.contains("\nlapwing_score_max_mph{drive=\"1\"} 4.0\n"), "{scored}");
    // A run that is whole, to be looked at.
    control(running.address, 1, json!({ "control": "end-run" })).await;
    steer(&simulator.ask(&telemetry("4.0000")).await);
    let (_, runs) = get(running.address, "/api/runs").await;
    let runs: Vec<_> = runs.as_array().unwrap().iter().map(|run| run["name"].as_str().unwrap().to_owned()).collect();
    assert_eq!(runs.len(), 2);

    let api = Documented::at(running.address).await;
    let paths = api.document["paths"].as_object().unwrap();
    assert_eq!(paths.len(), 20);
    for (path, methods) in paths {
        for method in methods.as_object().unwrap().keys().filter(|key| *key != "parameters") {
            // A run that was just made, and one with positions on a road that is known.
            for run in runs.iter().take(if path.contains("{name}") { 2 } else { 1 }) {
                let request = path
                    .replace("{id}", "1")
                    .replace("{name}", run)
                    .replace("{n}", "2")
                    .replace("{looks}", "visual-back-prop")
                    .replace("{pilot}", "0");
                let body = if method == "post" { r#"{"control":"take-over"}"# } else { "" };
                let (status, answer) = api.ask(method, path, &request, body).await;
                // This bridge's model is not looked into, and this request asks for no WebSocket.
                let expected = if path == "/live" { status == 426 } else { status < 300 };
                let is_fine = expected || (status == 409 && path.contains("explained"));
                assert!(is_fine, "{request}: {status} {}", String::from_utf8_lossy(&answer));
            }
        }
    }
    let (_, run) = get(running.address, "/api/runs/lake.mcap").await;
    assert!(run["outline"]["left"].as_array().unwrap().len() > 100, "so that its schema was tried");
    for (method, path, request, body, expected) in [
        ("get", "/api/drives/{id}", "/api/drives/9", "", 404),
        ("get", "/api/drives/{id}/score", "/api/drives/9/score", "", 404),
        ("get", "/api/runs/{name}", "/api/runs/nothing.mcap", "", 404),
        ("get", "/api/runs/{name}/frames/{n}", "/api/runs/lake.mcap/frames/9999", "", 404),
        ("get", "/api/runs/{name}/compared/{pilot}", "/api/runs/lake.mcap/compared/7", "", 400),
        ("post", "/api/drives/{id}/control", "/api/drives/1/control", r#"{"control":"fly"}"#, 400),
        ("post", "/api/drives/{id}/control", "/api/drives/1/control", r#"{"control":"pause"}"#, 409),
    ] {
        assert_eq!(api.ask(method, path, request, body).await.0, expected, "{request} {body}");
    }
    let (_, _, metrics) = ask(running.address, "GET /metrics", "", "").await;
    let metrics = String::from_utf8(metrics).unwrap();
    for line in [
        format!("lapwing_messages_total {asked}\n"),
        "lapwing_drives 1\n".into(),
        format!("le=\"+Inf\",stage=\"answer\"}} {asked}\n"),
    ] {
        assert!(metrics.contains(&line), "{line}: {metrics}");
    }
    assert!(metrics.ends_with("# EOF\n"));
}
