//! Data sets for the tests of this module.

use std::{
    ops::ControlFlow,
    path::{Path, PathBuf},
    time::Duration,
};

use image::{ColorType, codecs::jpeg::JpegEncoder};

use super::*;
use lapwing_core::{
    protocol::Telemetry,
    recording::udacity::{DrivingLogWriter, NewRow},
    recording::{CommandRecord, Entry, Item, Recorder, RecorderOptions, RunHeader, RunKind, RunReader, Step},
    units::{Mph, Steering, Throttle},
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
