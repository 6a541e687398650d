//! Scores runs: figures, estimates of what a run does not contain, scorecards, thresholds, suites and their pages.
//!
//! ```text
//! items of a run ─▶ Scorer ─▶ Scorecard ─▶ table, JSON, JUnit, page
//!        └─▶ odometry: where the car was, if no message says so
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`odometry`] | where a car was, from its speed, steering and pictures alone |
//! | [`score`] | from the items of a run to its scorecard; reports and comparisons of scorecards |
//! | [`judged`] | a drive with a scorer among its observers |
//! | [`results`] | scored drives and replays as JSON |
//! | [`emergency`] | emergency braking over time: a driver's pedal, and the labels that follow from it |
//! | [`suite`] | many drives as one: the plan, the results, the statistics |
//! | [`drawing`] | sheets of lines, words and pictures as SVG and PNG; charts |
//!
//! The crate knows no simulator: callers hand it runs, items and roads. No libtorch, no async runtime, no C++.
//!
//! # Example
//! ```
//! use lapwing_core::recording::Recording;
//! use lapwing_score::score::{self, Figure, Scorer};
//!
//! let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../recordings/lake.mcap");
//! let card = score::of_recording(&mut Recording::open(path)?, Scorer::default(), |_, _| ())?;
//! assert_eq!(card.value(Figure::Collisions), Some(0.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod drawing;
pub mod emergency;
pub mod judged;
pub mod odometry;
pub mod results;
pub mod score;
pub mod suite;
