//! The live server, to which any build of the simulator and any Socket.IO client connects.
//!
//! ```text
//! simulator ─▶ bridge ─▶ Driver ─▶ answer
//!                 └────▶ recorder, scorer
//! ```
//! It is handed pilots ([`Model`](lapwing_core::pilot::Model)) and roads, and knows neither networks nor a simulator.
//!
//! # Example
//! ```no_run
//! use lapwing_core::config::Settings;
//! use lapwing_live::bridge::Bridge;
//!
//! // A bridge without a model brakes every car to a standstill.
//! let bridge = Bridge::new(Settings::default(), |summary| println!("{summary}"));
//! bridge.arm();
//! ```

pub mod bridge;
