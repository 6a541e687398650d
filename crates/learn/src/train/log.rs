//! The log of a training: for each epoch a line of CSV and a point on each curve.

use std::{io, path::Path, time::SystemTime};

use super::{Measured, TimedEpoch, TrainError, events::Events};
use lapwing_core::files;

const HEADER: &str = "epoch,seconds,images_per_s,learning_rate,train_mse,train_mae,train_r,\
    validation_mse,validation_mae,validation_r,smooth_mse,smooth_mae,smooth_r\n";

/// Writes all epochs so far: a resumed training has one log.
pub(super) fn write(path: &Path, history: &[TimedEpoch]) -> Result<(), TrainError> {
    let mut text = HEADER.to_owned();
    for TimedEpoch { epoch, seconds, images_per_s } in history {
        text += &format!("{},{seconds:.1},{images_per_s:.1},{}", epoch.number, epoch.learning_rate);
        for metrics in [&epoch.training, &epoch.validation.raw, &epoch.validation.smooth] {
            let r = metrics.r.map_or_else(String::new, |r| r.to_string());
            text += &format!(",{},{},{r}", metrics.mse, metrics.mae);
        }
        text.push('\n');
    }
    files::write(path, text.as_bytes()).map_err(TrainError::io("write the log", path))
}

/// Seconds since 1970, as TensorBoard has them.
pub(super) fn now() -> f64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |passed| passed.as_secs_f64())
}

/// An epoch's numbers for TensorBoard.
pub(super) fn curves(events: &mut Events, timed: &TimedEpoch) -> io::Result<()> {
    let TimedEpoch { epoch, images_per_s, .. } = timed;
    let (step, wall) = (epoch.number as i64, now());
    let Measured { raw, smooth } = &epoch.validation;
    for (set, metrics) in [("training", &epoch.training), ("validation", raw), ("validation_9_frames", smooth)] {
        events.scalar(&format!("mse/{set}"), step, wall, metrics.mse as f32)?;
        events.scalar(&format!("mae/{set}"), step, wall, metrics.mae as f32)?;
        if let Some(r) = metrics.r {
            events.scalar(&format!("r/{set}"), step, wall, r as f32)?;
        }
    }
    events.scalar("learning_rate", step, wall, epoch.learning_rate as f32)?;
    events.scalar("images_per_s", step, wall, *images_per_s as f32)?;
    events.flush()
}
