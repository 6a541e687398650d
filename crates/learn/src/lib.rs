//! Networks and their training: the only crate that uses libtorch.
//!
//! ```text
//! driving logs, runs ─▶ dataset ─▶ train ─▶ checkpoint (.safetensors) ─▶ models ─▶ Pilot
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`dataset`] | driving logs and runs as data sets: inspect, convert, split; labels, balance, augmentation, loader |
//! | [`nn`] | networks, checkpoints, the libtorch in use |
//! | [`train`] | the supervised training loop, its log, checkpoints and recipes |
//! | [`models`] | models from files, and the pilots that drive with them |
//! | [`evaluate`] | models evaluated on data sets |
//! | [`explain`] | which parts of a picture a network's steering comes from |
//! | [`marl`] | agents that learn to drive through an intersection |
//! | [`braking`] | emergency braking: its data, training, values over episodes, and the guard that brakes by a network |
//!
//! # Example
//! The shipped PilotNet, asked for one picture's steering:
//! ```
//! use std::time::Instant;
//! use lapwing_core::{perception::Frame, pilot::View};
//! use lapwing_learn::models;
//!
//! let model = models::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/pilotnet.safetensors"), Instant::now)?;
//! let mut pilot = model.pilot();
//! let grey = Frame::new(320, 160, vec![128; 320 * 160 * 3]).ok_or("a picture of another size")?;
//! let prediction = pilot.steer(&View::of(&grey))?;
//! assert!(prediction.steering.abs() < 1.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod braking;
pub mod dataset;
pub mod evaluate;
pub mod explain;
pub mod marl;
pub mod models;
pub mod nn;
pub mod train;
