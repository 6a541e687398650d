//! Thresholds of a run: from flags to the exit status.

use super::Ended;
use crate::cli;
use lapwing_core::config::{ConfigError, Layers, Thresholds};
use lapwing_score::score::Scorecard;

/// How a world says that it was interrupted.
const INTERRUPTED: &str = "interrupted";

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
pub(super) fn ended_whole(card: &Scorecard, thresholds: &Thresholds, missed: &[String]) -> Ended {
    match ended(missed) {
        Ended::Passed if card.ended.as_deref() == Some(INTERRUPTED) && *thresholds != Thresholds::default() => {
            say!("interrupted: the thresholds were met, but only on the part that was driven");
            Ended::Failed
        }
        ended => ended,
    }
}
