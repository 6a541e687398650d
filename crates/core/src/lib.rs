//! The foundation of all other crates: the simulator's messages, frames, pilots, controllers, the driver that combines them,
//! and runs on disk.
//!
//! ```text
//!              telemetry text                                         steer text
//! simulator ─────────────────▶ protocol ▶ perception ▶ pilot ▶ control ▶ protocol ────────▶ simulator
//!                                  └──────────┬────────────┴────────┘
//!                                  drive ─▶ observers: recording, scores, films
//! ```
//! [`driver`] is the middle of that line, as one plain function from an observation to an answer and its trace. The
//! live bridge, the replay, the tests and the benches call that same function, so what is measured is what drives.
//!
//! | module | holds |
//! |---|---|
//! | [`units`] | mph, degrees, normalised steering and throttle: newtypes with checked construction |
//! | [`car`] | the stock simulator's car: its dimensions and rules |
//! | [`motion`] | the bicycle model, angles, closed roads, straight lines between points |
//! | [`hash`] | SHA-256 in hexadecimal |
//! | [`files`] | files written whole or not at all, and checks that they can be |
//! | [`words`] | plurals and suggestions for misspelt names, for messages |
//! | [`stats`] | how well two series agree |
//! | [`config`] | settings: defaults < your own file < `lapwing.toml` < environment < flags |
//! | [`protocol`] | the simulator's text, both ends of it, in every dialect and culture; no I/O |
//! | [`client`] | plays any [`World`](protocol::World) to any bridge as the Unity build does |
//! | [`perception`] | base64 and JPEG to `Frame`; crop, resize, colour, scale |
//! | [`pilot`] | the trait `Pilot`, pure pursuit, constant |
//! | [`control`] | speed controllers, standstill, emergency brake, hand-over |
//! | [`guard`] | the trait `Guard`, which says when to brake; one by the time to collision |
//! | [`turn`] | one turn of a drive, and what is recorded of it |
//! | [`driver`] | the function above |
//! | [`drive`] | the loop: drives a world and shows it to observers |
//! | [`recording`] | runs in MCAP: writer, reader, recovery; Udacity folders |
//! | [`replay`] | a recording as a world, open loop |
//!
//! No libtorch, no async runtime, no C++.
//!
//! # Example
//! ```
//! use std::time::{Duration, Instant};
//! use lapwing_core::{config::ControlSettings, driver::Driver, pilot::ConstantPilot, protocol::{Observation, Sight}, units::Steering};
//!
//! let mut driver = Driver::new(Box::new(ConstantPilot::new(Steering::ZERO)), &ControlSettings::default(), Instant::now);
//! let observation = Observation { at: Duration::ZERO, sight: Sight::HumanDrives };
//! let (answer, trace) = driver.drive(&observation);
//! assert_eq!(answer.encode(None), r#"42["manual",{}]"#);
//! # let _ = trace;
//! ```

pub mod car;
pub mod client;
pub mod config;
pub mod control;
pub mod drive;
pub mod driver;
pub mod files;
pub mod guard;
pub mod hash;
pub mod motion;
pub mod perception;
pub mod pilot;
pub mod protocol;
pub mod recording;
pub mod replay;
pub mod stats;
pub mod turn;
pub mod units;
pub mod words;
