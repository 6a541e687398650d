//! Networks and their training: the only crate that uses libtorch.
//!
//! ```text
//! driving logs, runs ─▶ dataset ─▶ train ─▶ checkpoint (.safetensors) ─▶ models ─▶ Pilot
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`nn`] | networks, checkpoints, the libtorch in use |
//! | [`models`] | models from files, and the pilots that drive with them |
//! | [`dataset`] | driving logs and runs as data sets: inspect, convert, split; labels, balance, augmentation, loader |
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
