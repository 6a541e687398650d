//! Every message of a run's file is as the schema beside it says.

use std::{collections::BTreeMap, path::Path};

use lapwing_core::{
    config::{ControlSettings, OnCrash},
    driver::Driver,
    pilot::{ConstantPilot, Pilot, PurePursuit},
    recording::{Recorder, RecorderOptions, RunHeader, RunKind},
    units::{Mph, Steering},
};
use lapwing_score::judged;
use lapwing_sim::world::{Human, Setup, Simulation};
use tempfile::tempdir;

use super::drive::{Case, How, LAP_MPH, Speaks, loop_road, play};
use crate::support::{Running, settings_with_kicks, telemetry};

/// Holds each message against its schema; the kinds of events that were written.
fn checked(run: &Path) -> BTreeMap<String, u32> {
    let bytes = std::fs::read(run).unwrap();
    let (mut kinds, mut schemas) = (BTreeMap::new(), BTreeMap::new());
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        let topic = message.channel.topic.clone();
        let schema = message.channel.schema.as_ref().unwrap();
        if schema.encoding != "jsonschema" {
            continue;
        }
        let validator = schemas
            .entry(topic.clone())
            .or_insert_with(|| jsonschema::validator_for(&serde_json::from_slice(&schema.data).unwrap()).unwrap());
        let said: serde_json::Value = serde_json::from_slice(&message.data).unwrap();
        let wrong: Vec<_> = validator.iter_errors(&said).map(|error| error.to_string()).collect();
        assert!(wrong.is_empty(), "{}: {topic}: {said}: {wrong:?}", run.display());
        if topic == "/event" {
            *kinds.entry(said["kind"].as_str().unwrap().to_owned()).or_default() += 1;
        }
    }
    assert_eq!(schemas.len(), 3, "{}: {:?}", run.display(), schemas.keys());
    kinds
}

#[test]
fn every_message_of_a_driven_a_crashed_and_a_taken_over_run_is_as_its_schema_says() {
    let dir = tempdir().unwrap();
    let ((track, scenery), _) = loop_road(dir.path());
    let human = Some(Human { from_s: 4.0, for_s: 2.0, speed: LAP_MPH });
    let setup = || Setup { hz: 5.0, longest_s: Some(30.0), ..Setup::new(track.clone(), scenery.clone()) };
    let reset = Setup { on_crash: OnCrash::Reset, ..setup() };
    let mut kinds = BTreeMap::new();
    let drives: [(Setup, Box<dyn Pilot>); 4] = [
        (setup(), Box::new(PurePursuit::default())),
        (Setup { human, ..setup() }, Box::new(PurePursuit::default())),
        (setup(), Box::new(ConstantPilot::new(Steering::ZERO))),
        (reset, Box::new(ConstantPilot::new(Steering::ZERO))),
    ];
    for (setup, pilot) in drives {
        let header = RunHeader {
            kind: RunKind::Driven,
            name_hint: None,
            dialect: None,
            model: None,
            seed: None,
            config: serde_json::json!({}),
            lapwing: "test".into(),
            started: jiff::Timestamp::UNIX_EPOCH,
        };
        let recorder = Recorder::create(dir.path(), header, RecorderOptions { queue: 16 }).unwrap();
        let control = ControlSettings { speed_mph: Mph::constant(20.0), ..ControlSettings::default() };
        let mut driver = Driver::new(pilot, &control, std::time::Instant::now);
        let mut world = Simulation::new(setup).unwrap();
        judged::run(&mut world, &mut driver, &mut [&mut &recorder]).unwrap();
        kinds.extend(checked(&recorder.finish().path));
    }
    let expected = ["course", "lap", "off-road", "reset", "run-ended", "takeover-began", "takeover-ended"];
    let missing: Vec<_> = expected.into_iter().filter(|kind| !kinds.contains_key(*kind)).collect();
    assert!(missing.is_empty(), "{missing:?} of {kinds:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_message_that_the_bridge_records_is_as_its_schema_says() {
    let dir = tempdir().unwrap();
    let (track, _) = loop_road(dir.path());
    let mut settings = settings_with_kicks(dir.path());
    settings.bridge.kick_after_s = 0.3;
    let running = Running::start(settings).await;
    let case = |how| Case { speaks: Speaks::SelfOracle, how, realtime: false };
    for how in [How::Finished, How::Crashed, How::TakenOver] {
        play(running.address, track.clone(), case(how)).await;
    }
    let mut simulator = crate::support::Wire::simulator(running.address).await;
    simulator.ask(&telemetry("5.0000")).await;
    simulator.send(r#"42["episode_event",{"name":"lap"}]"#).await;
    simulator.ask("garbage").await;
    simulator.text().await; // a kick
    let mut kinds = BTreeMap::new();
    for summary in running.stop().await {
        kinds.extend(checked(&summary.run.unwrap().path));
    }
    let expected = ["bad-frame", "kick", "run-ended", "simulator", "takeover-began", "takeover-ended"];
    let missing: Vec<_> = expected.into_iter().filter(|kind| !kinds.contains_key(*kind)).collect();
    assert!(missing.is_empty(), "{missing:?} of {kinds:?}");
}
