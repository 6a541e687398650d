//! Networks and how they are trained: the only crate that knows libtorch.
//!
//! ```text
//! driving logs, runs ─▶ dataset ─▶ train ─▶ checkpoint (.safetensors) ─▶ models ─▶ Pilot
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`nn`] | networks, checkpoints, the libtorch in use |
//! | [`models`] | files read into models, of which pilots drive |
//! | [`dataset`] | driving logs and runs as something to learn from: looked over, converted, split; labels, balance, augmentation, loader |
//! | [`train`] | the supervised training loop, its log, checkpoints and recipes |
//! | [`evaluate`] | models held against data sets |
//!
//! # Example
//! ```no_run
//! let model = lapwing_learn::models::load("models/pilotnet.safetensors", std::time::Instant::now)?;
//! println!("{}", model.name());
//! let _pilot = model.pilot();
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod dataset;
pub mod evaluate;
pub mod models;
pub mod nn;
pub mod train;
