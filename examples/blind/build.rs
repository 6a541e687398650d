//! What other builds make of a drive: the road driven the other way round, steering that lags behind the wheels and is geared
//! otherwise, drives joined in one log.

use std::{collections::VecDeque, path::Path, time::Duration};

use lapwing_core::{
    recording::{EventRecord, Item, Recorder, RecorderOptions, Recording, RunHeader},
    units::Degrees,
};

/// How a build reports its steering.
#[derive(Debug, Clone, Copy)]
pub struct Build {
    /// Reported over real steering. That of real logs, taken as a line from row to row, lies within this range but for one.
    pub gear: f64,
    /// Telemetries by which it lags behind.
    pub lag: usize,
}

impl Build {
    pub fn of(run: usize) -> Self {
        Self { gear: [1.0, 0.78, 1.22, 0.9, 1.1, 0.95, 1.05][run % 7], lag: run % 3 }
    }
}

/// Writes these runs as one, as such a build would have it.
pub fn rewrite(runs: &[&Path], build: Build, header: RunHeader, to: &Path) -> Result<(), super::Error> {
    let recorder = Recorder::create_file(to, header, RecorderOptions::default())?;
    let mut from_s = Duration::ZERO;
    for (i, run) in runs.iter().enumerate() {
        if i > 0 {
            recorder.record(from_s, Item::Event(EventRecord::Break { seconds: None }));
        }
        let mut recording = Recording::open(run)?;
        let mut late: VecDeque<f64> = VecDeque::new();
        let mut last = Duration::ZERO;
        while let Some(item) = recording.next_item() {
            let (at, mut item) = item?;
            if let Item::Telemetry(telemetry) = &mut item {
                late.push_back(telemetry.steering.get());
                let then = if late.len() > build.lag + 1 { late.pop_front() } else { late.front().copied() };
                telemetry.steering = Degrees::saturating(build.gear * then.unwrap_or_default());
            }
            // The first drive's end is not the end of the run.
            if i + 1 < runs.len() && matches!(item, Item::Event(EventRecord::RunEnded { .. })) {
                continue;
            }
            recorder.wait_for_room();
            recorder.record(from_s + at, item);
            last = at;
        }
        from_s += last + Duration::from_millis(70);
    }
    recorder.finish();
    Ok(())
}
