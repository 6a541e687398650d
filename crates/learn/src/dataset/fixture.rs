//! Data sets for the tests of this module.

use std::{
    fs,
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use image::{ColorType, codecs::jpeg::JpegEncoder};

use super::*;
use lapwing_core::{
    config::ControlSettings,
    driver::Driver,
    pilot::PurePursuit,
    protocol::Telemetry,
    recording::udacity::{DrivingLogWriter, NewRow},
    recording::{CommandRecord, Entry, Item, Recorder, RecorderOptions, RunHeader, RunKind, RunReader, Step},
    units::{Mph, Steering, Throttle},
};
use lapwing_sim::{
    camera::Scenery,
    locate::{Pose, table},
    record::{self as lesson, RecordOptions},
    track::Track,
    world::{Setup, Simulation},
};

/// 64 x 32 pixels that tell one row's picture from another's.
pub(super) fn jpeg(seed: usize) -> Vec<u8> {
    let rgb: Vec<u8> = (0..64 * 32 * 3).map(|i| ((i / 3 % 64) * 3 + seed * 7 + i % 3 * 20) as u8).collect();
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 80).encode(&rgb, 64, 32, ColorType::Rgb8.into()).unwrap();
    bytes
}

pub(super) fn steering(i: usize) -> f64 {
    [0.0, 0.0, -0.25, 0.5, 0.0][i % 5]
}

/// A folder with this many rows, 67 ms apart.
pub(super) fn folder(dir: &Path, rows: usize, sides: bool) -> PathBuf {
    let began = jiff::civil::date(2024, 5, 17).at(12, 0, 0, 123_000_000);
    let mut log = DrivingLogWriter::create(dir, began).unwrap();
    for i in 0..rows {
        let jpeg = jpeg(i);
        let side = sides.then_some(&jpeg[..]);
        log.row(&NewRow {
            at: Duration::from_millis(67 * i as u64),
            center: &jpeg,
            left: side,
            right: side,
            steering: Steering::new(steering(i)).unwrap(),
            throttle: Throttle::new(0.5).unwrap(),
            brake: 0.25,
            speed: Mph::new(10.0 + i as f64).unwrap(),
        })
        .unwrap();
    }
    log.finish().unwrap();
    dir.to_owned()
}

pub(super) fn looked_over(path: &Path) -> Inspection {
    inspect(path, &mut |_, _| {}).unwrap()
}

pub(super) fn converted(source: &Path, target: &Path) -> Converted {
    convert(source, target, &mut |_, _| ControlFlow::Continue(())).unwrap()
}

pub(super) fn steps(run: &Path) -> Vec<Step> {
    let step = |moment| match moment {
        Ok(Entry::Step(step)) => Some(step),
        other => panic!("{other:?}"),
    };
    RunReader::open(run).unwrap().entries().filter_map(step).collect()
}

/// Records a telemetry for each entry, with its picture if there is one, and this answer.
pub(super) fn record(run: &Path, pictures: &[Option<Vec<u8>>], answer: Option<&CommandRecord>) {
    let header = RunHeader {
        kind: RunKind::Driven,
        name_hint: None,
        dialect: None,
        decimal_separator: None,
        model: None,
        seed: None,
        config: serde_json::Value::Null,
        lapwing: "0.1.0".into(),
        started: "2024-05-17T10:00:00Z".parse().unwrap(),
    };
    let recorder = Recorder::create_file(run, header, RecorderOptions::default()).unwrap();
    for (i, picture) in pictures.iter().enumerate() {
        let at = Duration::from_millis(100 * i as u64);
        let telemetry: Telemetry =
            serde_json::from_str(r#"{"steering_deg":-5,"throttle":0.25,"speed_mph":9}"#).unwrap();
        recorder.record(at, Item::Telemetry(telemetry));
        if let Some(jpeg) = picture {
            recorder.record(at, Item::Frame(jpeg.clone().into()));
        }
        if let Some(answer) = answer {
            recorder.record(at, Item::Command(answer.clone()));
        }
    }
    assert!(recorder.finish().error.is_none());
}

const SPEED: Mph = Mph::constant(20.0);

/// A drive that weaves, with the table of its places but for one row in ten; returns what the expert would have
/// steered in each.
pub(super) fn weaving(folder: &Path) -> Vec<f64> {
    let track = Arc::new(Track::named("lake").unwrap());
    let scenery = Arc::new(Scenery::new(&track));
    let setup = Setup { laps: None, longest_s: Some(12.0), ..Setup::new(Arc::clone(&track), scenery) };
    let mut world = Simulation::new(setup).unwrap();
    let log = DrivingLogWriter::create(folder, jiff::civil::date(2026, 11, 23).at(8, 0, 0, 0)).unwrap();
    let (mut text, mut expert) = (table::heading(), vec![]);
    let mut see = |world: &mut Simulation| {
        let pose = Some(Pose::of(world)).filter(|_| expert.len() % 10 != 5);
        text += &table::line(expert.len(), world.time_s(), &track, pose);
        expert.push(world.expert(SPEED).steering.get());
    };
    see(&mut world);
    let options = RecordOptions { weave_m: 1.6, ..RecordOptions::at(SPEED) };
    let pilot = Box::new(PurePursuit::default());
    let mut driver = Driver::new(pilot, &ControlSettings::default(), Instant::now);
    let rows = lesson::record(&mut world, &mut driver, log, options, see).unwrap().rows as usize;
    // What was seen last is not recorded any more.
    let text: Vec<&str> = text.lines().take(1 + rows).collect();
    fs::write(folder.join("lane.csv"), text.join("\n") + "\n").unwrap();
    expert
}
