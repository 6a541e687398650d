//! Errors of pilots.

use crate::{perception::PreprocessError, words::count};

/// Why there is no steering of a pilot.
#[derive(Debug, thiserror::Error)]
pub enum PilotError {
    /// A pilot that follows the road's line needs to know it, and only worlds of our own tell it.
    #[error(
        "expected telemetry with the line to drive, got telemetry without it: this pilot works with lapwing drive, not with other simulators"
    )]
    NoPath,
    /// The frame does not suit the preprocessing, or that cannot be.
    #[error(transparent)]
    Preprocess(#[from] PreprocessError),
    /// The forward pass fails.
    #[error(transparent)]
    Network(Box<dyn std::error::Error + Send + Sync>),
    /// The network answers more or fewer numbers than it is said to.
    #[error("expected {expected} from the network for its outputs {names}, got a tensor of shape {got:?}", expected = count(.outputs.len(), "number"), names = .outputs.join(", "))]
    OutputShape {
        /// What each number should be.
        outputs: Vec<String>,
        /// What came.
        got: Vec<i64>,
    },
    /// The network answers NaN or infinity.
    #[error("expected a finite {output} from the network, got {got}")]
    NotFinite {
        /// Which output.
        output: String,
        /// What it is.
        got: f64,
    },
}
