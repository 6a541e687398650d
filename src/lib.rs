//! Lapwing drives, simulates, records, scores and replays the Udacity self-driving-car simulator.
//!
//! # The data's way
//! ```text
//!              telemetry text                                         steer text
//! simulator ─────────────────▶ protocol ▶ perception ▶ pilot ▶ control ▶ protocol ────────▶ simulator
//!                                  └──────────┬────────────┴────────┘
//!                                         recording  (one run = one MCAP file) ▶ replay
//! ```
//! [`driver`] is the middle of that line as one plain function: an observation
//! in, an answer and its trace out. The live bridge, the replay, the tests and
//! the benches call that same function, so what is measured is what drives.
//!
//! # Words
//! `Telemetry`: one message from a simulator, decoded. `Frame`: one RGB picture.
//! `Pilot`: says steering for a frame. `Controller`: makes throttle. `Command`:
//! steering and throttle, normalised. `Driver`: perception, pilot and
//! controllers. `World`: yields telemetry and takes commands. `Run`: what was
//! recorded of one drive. `Score`: what a run is judged to be.
//!
//! # The map
//! | module | holds | may import |
//! |---|---|---|
//! | [`units`] | mph, degrees, normalised steering and throttle: newtypes with checked construction | nothing |
//! | [`files`] | files written whole or not at all, and whether they could be; for every module | nothing |
//! | [`words`] | plurals, and what a misspelt name was meant to be, for every module's messages | nothing |
//! | [`config`] | settings: defaults < your own file < `lapwing.toml` < environment < flags | `units` |
//! | [`protocol`] | the simulator's text, both ends of it, in every dialect and culture; no I/O | `units` |
//! | [`perception`] | base64 and JPEG to `Frame`; crop, resize, colour, scale | `units` |
//! | [`nn`] | networks, checkpoints, the libtorch in use | `perception` |
//! | [`pilot`] | trait `Pilot` and its kinds | `perception`, `nn`, `units` |
//! | [`control`] | speed controllers, standstill, hand-over | `units` |
//! | [`driver`] | the function above | everything above |
//! | [`recording`] | runs in MCAP: writer, reader, recovery; Udacity folders | `units`, `protocol` |
//! | [`odometry`] | where a car was, by its speed, steering and pictures alone | `perception` |
//! | [`score`] | what a run is judged to be | `config`, `odometry`, `perception`, `protocol`, `recording`, `units` |
//! | [`suite`] | many drives as one: which, their results, what they come to | `score` |
//! | [`drawing`] | sheets of lines, words and pictures as SVG and PNG; charts | `perception` |
//! | [`simulator`] | the headless world: track, car, camera, traffic; and the client that speaks as the Unity build does | `config`, `drawing`, `odometry`, `perception`, `pilot`, `protocol`, `recording`, `units` |
//! | [`drive`] | a world driven in this process: driver, recorder and scorer around it | `driver`, `protocol`, `recording`, `score`, `units` |
//! | [`replay`] | a recording as a world, open loop and closed loop, where it needs the simulator's car and cameras | `recording`, `driver`, `perception`, `protocol`, `score`, `simulator`, `units` |
//! | [`dataset`] | driving logs and runs as something to learn from: looked over, converted, split; labels, balance, augmentation, loader | `drawing`, `perception`, `protocol`, `recording`, `units` |
//! | [`train`] | the supervised training loop, its log, checkpoints and recipes | `dataset`, `nn`, `perception` |
//! | [`bridge`] | the server: listener, simulator session, Socket.IO clients | `driver` and what it imports, `drive`, `odometry`, `recording`, `score` |
//! | [`allocator`] | Rust's own large blocks, apart from libtorch's memory | nothing |
//! | [`cli`], [`commands`] | clap types; one file a verb | all |
//!
//! Arrows never run upward; `tests/architecture.rs` holds the same table and
//! fails on an edge that is not in it.

#![warn(missing_docs)]
// What comes over a wire, from a file or a flag is an error, never a panic.
#![warn(clippy::unwrap_used, clippy::panic, clippy::todo, clippy::unimplemented)]
// These panic where nobody reads any more; `commands::terminal` does not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod allocator;
pub mod bridge;
#[allow(missing_docs)] // clap shows these docs as help; what they flatten or name needs no second text
pub mod cli;
pub mod commands;
pub mod config;
pub mod control;
pub mod dataset;
pub mod drawing;
pub mod drive;
pub mod driver;
pub mod files;
pub mod nn;
pub mod odometry;
pub mod perception;
pub mod pilot;
pub mod protocol;
pub mod recording;
pub mod replay;
pub mod score;
pub mod simulator;
pub mod suite;
pub mod train;
pub mod units;
pub mod words;
