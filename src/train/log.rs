//! A line of CSV for each epoch.

use std::path::Path;

use super::{Epoch, TrainError, state};

const HEADER: &str = "epoch,seconds,images_per_s,learning_rate,train_mse,train_mae,train_r,\
    validation_mse,validation_mae,validation_r,smooth_mse,smooth_mae,smooth_r\n";

/// Writes all epochs so far: a training that went on has one log.
pub(super) fn write(path: &Path, history: &[Epoch]) -> Result<(), TrainError> {
    let mut text = HEADER.to_owned();
    for epoch in history {
        text += &format!("{},{:.1},{:.1},{}", epoch.number, epoch.seconds, epoch.images_per_s, epoch.learning_rate);
        for metrics in [&epoch.training, &epoch.validation.raw, &epoch.validation.smooth] {
            let r = metrics.r.map_or_else(String::new, |r| r.to_string());
            text += &format!(",{},{},{r}", metrics.mse, metrics.mae);
        }
        text.push('\n');
    }
    state::replace(path, text.as_bytes(), "write the log")
}
