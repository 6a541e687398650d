//! From bytes to the range that a network takes.

use serde::{Deserialize, Serialize};

/// From 0..=255 to the range that a network takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum PixelScale {
    /// -1 to 1.
    #[serde(rename = "x/127.5-1")]
    Signed,
    /// 0 to 1.
    #[serde(rename = "x/255")]
    Unit,
    /// 0 to 255, for a network that normalises itself.
    #[serde(rename = "none")]
    None,
    /// `(x - mean) / range`, of 0 to 255: 128 and 128 is another usual way to -1 to 1.
    #[serde(rename = "shifted")]
    Shifted {
        /// Subtracted.
        mean: f64,
        /// Divided by; positive.
        range: f64,
    },
    /// `(x / 255 - mean) / std`, one number a channel; torchvision's ImageNet networks want
    /// mean .485, .456, .406 and std .229, .224, .225 in RGB.
    #[serde(rename = "standardised")]
    Standardised {
        /// Subtracted.
        mean: Vec<f64>,
        /// Divided by; positive.
        std: Vec<f64>,
    },
}

impl PixelScale {
    /// Factor and summand of a channel; `None` if the scale has no valid ones for it.
    pub(super) fn affine(&self, channel: usize) -> Option<(f64, f64)> {
        match self {
            Self::Signed => Some((1.0 / 127.5, -1.0)),
            Self::Unit => Some((1.0 / 255.0, 0.0)),
            Self::None => Some((1.0, 0.0)),
            Self::Shifted { mean, range } => {
                let valid = mean.is_finite() && range.is_finite() && *range > 0.0;
                valid.then(|| (1.0 / range, -mean / range))
            }
            Self::Standardised { mean, std } => {
                let (mean, std) = (*mean.get(channel)?, *std.get(channel)?);
                (mean.is_finite() && std.is_finite() && std > 0.0).then(|| (1.0 / (255.0 * std), -mean / std))
            }
        }
    }
}
