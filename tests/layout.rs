//! The layout for Foxglove and Lichtblick shows channels and fields that there are.

use std::{collections::BTreeSet, fs, path::Path};

use lapwing_core::recording::Channel;
use serde_json::Value;

fn layout() -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/how-to/lapwing-layout.json");
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// The panels of a part of the screen.
fn panels(part: &Value) -> Vec<String> {
    match part {
        Value::String(id) => vec![id.clone()],
        divided => ["first", "second"].into_iter().flat_map(|side| panels(&divided[side])).collect(),
    }
}

/// Why there is no such path in a run.
fn missing(path: &str) -> Option<String> {
    let (topic, fields) = path.split_once('.').unwrap_or((path, ""));
    let Some(channel) = Channel::ALL.into_iter().find(|channel| channel.topic() == topic) else {
        return Some(format!("{path}: no such channel"));
    };
    if fields.is_empty() {
        return None;
    }
    let mut schema: Value = serde_json::from_slice(&channel.schema().data).unwrap();
    for field in fields.split('.') {
        schema = schema["properties"][field].take();
    }
    (schema["type"] != "number").then(|| format!("{path}: no such number"))
}

#[test]
fn each_panel_is_on_the_screen_once_and_what_it_shows_is_in_a_run() {
    let layout = layout();
    let configs = layout["configById"].as_object().unwrap();
    let on_screen = panels(&layout["layout"]);
    assert_eq!(on_screen.iter().collect::<BTreeSet<_>>(), configs.keys().collect(), "{on_screen:?}");
    assert_eq!(on_screen.len(), configs.len());

    let text = |value: &Value| value.as_str().map(str::to_owned);
    let mut shown = BTreeSet::new();
    for config in configs.values() {
        shown.extend(text(&config["topicToRender"]));
        shown.extend(text(&config["topicPath"]));
        shown.extend(text(&config["imageMode"]["imageTopic"]));
        shown.extend(config["topics"].as_object().into_iter().flat_map(|topics| topics.keys().cloned()));
        shown.extend(config["paths"].as_array().into_iter().flatten().filter_map(|path| text(&path["value"])));
    }
    assert!(shown.len() > 6, "{shown:?}");
    let wrong: Vec<_> = shown.iter().filter_map(|path| missing(path)).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
    assert!(missing("/telemetry.speed").is_some() && missing("/odometry").is_some(), "what is not there is found");
}
