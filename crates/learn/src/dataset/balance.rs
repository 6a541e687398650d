//! Balances rows by their steering: decides which are drawn more often than others.

use serde::{Deserialize, Serialize};

use super::DatasetError;

/// How to compensate for the many rows in which nobody steers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Balance {
    /// Share of the rows with (nearly) zero steering that is kept; default 1.
    pub keep_zero: f64,
    /// How far the histogram of steering is flattened: 0, the default, not at all; 1, each of 25 bins counts alike.
    pub flatten: f64,
    /// How many times more often a row at full lock is drawn than one straight on, with those between in proportion;
    /// default 0.
    pub large_angles: f64,
}

impl Default for Balance {
    fn default() -> Self {
        Self { keep_zero: 1.0, flatten: 0.0, large_angles: 0.0 }
    }
}

/// Steering below this counts as none.
const ZERO: f64 = 0.01;
/// Bins of the histogram that is flattened, from -1 to 1.
const BINS: usize = 25;

impl Balance {
    pub(crate) fn check(&self) -> Result<(), DatasetError> {
        let wrong = |name, expected, got: f64| Err(DatasetError::Setting { name, expected, got: got.to_string() });
        if !(0.0..=1.0).contains(&self.keep_zero) {
            return wrong("keep_zero", "0 to 1", self.keep_zero);
        }
        if !(0.0..=1.0).contains(&self.flatten) {
            return wrong("flatten", "0 to 1", self.flatten);
        }
        if !(0.0..=1000.0).contains(&self.large_angles) {
            return wrong("large_angles", "0 to 1000", self.large_angles);
        }
        Ok(())
    }

    /// How often each sample is drawn, from the steering of its row and how often it would be drawn without balancing.
    /// The histogram is that of all data sets together, each counted as often as it is drawn.
    ///
    /// # Errors
    /// [`DatasetError::Setting`] if nothing would be drawn at all.
    pub(super) fn weights(&self, drawn: &[(f64, f64)]) -> Result<Vec<f64>, DatasetError> {
        let bin = |x: f64| (((x.clamp(-1.0, 1.0) + 1.0) / 2.0 * BINS as f64) as usize).min(BINS - 1);
        let mut counts = [0.0f64; BINS];
        drawn.iter().for_each(|(steering, weight)| counts[bin(*steering)] += weight);
        let largest = counts.iter().copied().fold(0.0, f64::max);
        let balanced = |(steering, weight): &(f64, f64)| {
            let kept = if steering.abs() < ZERO { self.keep_zero } else { 1.0 };
            let rare = (counts[bin(*steering)] / largest).powf(-self.flatten);
            weight * kept * rare * (1.0 + self.large_angles * steering.abs())
        };
        let weights: Vec<f64> = drawn.iter().map(balanced).collect();
        let total: f64 = weights.iter().sum();
        if total.is_finite() && total > 0.0 {
            return Ok(weights);
        }
        let got = format!("{} and {} samples that are all straight on", self.keep_zero, drawn.len());
        Err(DatasetError::Setting { name: "keep_zero", expected: "a share that keeps something", got })
    }
}
