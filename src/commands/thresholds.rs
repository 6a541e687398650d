//! Thresholds of a run: from flags to the exit status.

use super::Ended;
use crate::cli;
use lapwing_core::config::{ConfigError, Layers};

/// The flags as settings.
pub(super) fn layers(mut layers: Layers, flags: &cli::Thresholds) -> Result<Layers, ConfigError> {
    let numbers = [
        ("--min-completion", "thresholds.min_completion", flags.min_completion),
        ("--min-autonomy", "thresholds.min_autonomy", flags.min_autonomy),
        ("--min-driving-score", "thresholds.min_driving_score", flags.min_driving_score),
        ("--max-cte", "thresholds.max_cte", flags.max_cte),
        ("--max-mean-cte", "thresholds.max_mean_cte", flags.max_mean_cte),
    ];
    for (flag, key, value) in numbers {
        if let Some(value) = value {
            layers = layers.set(flag, key, value)?;
        }
    }
    let counts = [
        ("--max-collisions", "thresholds.max_collisions", flags.max_collisions),
        ("--max-off-road", "thresholds.max_off_road", flags.max_off_road),
    ];
    for (flag, key, value) in counts {
        if let Some(value) = value {
            layers = layers.set(flag, key, i64::from(value))?;
        }
    }
    Ok(layers)
}

/// Says each threshold that was missed.
pub(super) fn ended(missed: &[String]) -> Ended {
    for missed in missed {
        say!("missed: {missed}");
    }
    if missed.is_empty() { Ended::Passed } else { Ended::Missed }
}
