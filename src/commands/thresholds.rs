//! Thresholds of a run: from flags to the exit status.

use super::{Ended, Interrupted};
use crate::cli;
use lapwing_core::config::{ConfigError, Layers, Thresholds};

/// The flags as settings.
pub(super) fn layers(mut layers: Layers, flags: &cli::ThresholdFlags) -> Result<Layers, ConfigError> {
    for (threshold, limit) in &flags.0 {
        let key = format!("thresholds.{}", threshold.key);
        layers = layers.set(&format!("--{}", threshold.flag()), &key, limit)?;
    }
    Ok(layers)
}

/// Reports each threshold that was missed.
pub(super) fn ended(missed: &[String]) -> Ended {
    for missed in missed {
        say!("missed: {missed}");
    }
    if missed.is_empty() { Ended::Passed } else { Ended::Missed }
}

/// The same of a drive that may have been interrupted: what was not driven has not passed.
pub(super) fn ended_unless(interrupted: &Interrupted, thresholds: &Thresholds, missed: &[String]) -> Ended {
    match ended(missed) {
        Ended::Passed if interrupted.is_pressed() && *thresholds != Thresholds::default() => {
            say!("interrupted: the thresholds were met only as far as was driven");
            Ended::Failed
        }
        ended => ended,
    }
}
