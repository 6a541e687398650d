//! The `lapwing` program: its command line, what it draws and films, and the glue between the crates that do the work.
//!
//! # The data's way
//! ```text
//!              telemetry text                                         steer text
//! simulator ─────────────────▶ protocol ▶ perception ▶ pilot ▶ control ▶ protocol ────────▶ simulator
//!                                  └──────────┬────────────┴────────┘
//!                                         recording  (one run = one MCAP file) ▶ replay
//! ```
//!
//! # The map
//! | crate | holds | knows, of the others |
//! |---|---|---|
//! | [`lapwing_core`] | the simulator's text, frames, pilots, controllers, the driver, runs on disk | |
//! | [`lapwing_sim`] | the headless simulator: roads, car, traffic, camera, weather; recordings as closed-loop worlds |
//! `core` |
//! | [`lapwing_score`] | figures, estimates, scorecards, suites, pages, drawings | `core` |
//! | [`lapwing_learn`] | networks, models, data sets, training: the only one that knows libtorch | `core`, `sim`, `score` |
//! | [`lapwing_live`] | the server | `core`, `score` |
//! | here: [`cli`], [`commands`] | clap types; one file per verb | all |
//! | [`course`] | suites, driven in our simulator by our models | `core`, `sim`, `score`, `learn` |
//! | [`film`], [`map`], [`known`] | films and maps for people; tracks as known roads, on which drives are located |
//! `core`, `sim`, `score` |
//! | [`top_view`] | the intersection of the agents from above | `core`, `sim`, `score` |
//! | [`locating`] | where a recording was driven, and where each of its pictures was taken | `core`, `sim`, `score` |
//! | [`real_time`] | a world that goes no faster than time | `core` |
//! | [`staged`] | the simulator in the hands of a person at the page | `core`, `sim`, `score`, `live` |
//! | [`doctor`] | whether this machine can drive: what `lapwing doctor` finds | `core`, `learn`, `live` |
//! | [`allocator`] | Rust's own large blocks, apart from libtorch's memory | |
//!
//! # Example
//! A map of the lake track, as `--map` draws it under the driven line:
//! ```
//! # #[cfg(feature = "simulator")]
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use lapwing::map;
//! use lapwing_sim::track::Track;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("lake.svg");
//! map::draw(&Track::open("lake")?, &[], &[], &path, 800)?;
//! assert!(std::fs::read_to_string(&path)?.starts_with("<svg"));
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "simulator"))]
//! # fn main() {}
//! ```
//!
//! # Parts
//! Features that are switched off are not compiled:
//!
//! | feature | verbs | needs |
//! |---|---|---|
//! | `bridge` | `serve`, `doctor`, and those of `networks` | libtorch |
//! | `onnx` | models as `.onnx` in those of `networks` | ONNX Runtime, when one is loaded |
//! | `networks` | `replay`, `evaluate`, `model`, `dataset`; with `simulator` also `train`, `suite`, `merge`, the closed loop | libtorch |
//! | `simulator` | `drive`, `simulate`, `record`, `score`, `marl`; only the expert drives without `networks` | nothing |
//! | `films` | `--video FILE.mp4` | a C++ compiler, for OpenH264 |
//!
//! Each crate's `Cargo.toml` states what it may know. `tests/architecture.rs` checks what Cargo cannot see.

#![warn(missing_docs)]
// A build without some features has code that only those would use.
#![cfg_attr(
    not(all(feature = "bridge", feature = "films", feature = "simulator")),
    allow(dead_code, unused_imports, unused_mut, unused_variables)
)]
// As the workspace's lints, but for the tests, benches and examples of this package, which may panic and print.
#![warn(clippy::unwrap_used, clippy::panic, clippy::todo, clippy::unimplemented)]
// These panic if nobody reads any more; `commands::terminal` does not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod allocator;
#[allow(missing_docs)] // clap shows these docs as help; what they flatten or name needs no second text
pub mod cli;
pub mod commands;
#[cfg(all(feature = "networks", feature = "simulator"))]
pub mod course;
#[cfg(feature = "bridge")]
pub mod doctor;
#[cfg(feature = "simulator")]
pub mod film;
#[cfg(feature = "simulator")]
pub mod known;
#[cfg(feature = "simulator")]
pub mod locating;
#[cfg(feature = "simulator")]
pub mod map;
#[cfg(feature = "simulator")]
pub mod real_time;
#[cfg(all(feature = "bridge", feature = "simulator"))]
pub mod staged;
#[cfg(feature = "simulator")]
pub mod top_view;
