//! Errors of pilots.

use crate::{perception::PreprocessError, words::count};

/// Why a pilot gives no steering.
#[derive(Debug, thiserror::Error)]
pub enum PilotError {
    /// A pilot that follows the road's line needs to know it, and only this project's own worlds report it.
    #[error(
        "expected telemetry with the line to drive, got telemetry without it: this pilot works with lapwing drive, not with other simulators"
    )]
    NoPath,
    /// The frame does not fit the preprocessing, or that is invalid.
    #[error(transparent)]
    Preprocess(#[from] PreprocessError),
    /// The forward pass fails.
    #[error(transparent)]
    Network(Box<dyn std::error::Error + Send + Sync>),
    /// The network answers more or fewer numbers than declared.
    #[error("expected {expected} from the network for its outputs {names}, got a tensor of shape {got:?}: name all of its numbers in outputs", expected = count(.outputs.len(), "number"), names = .outputs.join(", "))]
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
