//! Scores a run.
//!
//! A [`Scorer`] watches a run item by item, live or from a file ([`of_recording`]), and ends in a [`Scorecard`]: a
//! [`Measure`] for each [`Figure`]. What the world itself reports (position, laps, collisions) is passed on; what
//! follows from other data is marked as an estimate, with its uncertainty; what a run does not report is not
//! measurable, with the reason, never 0.
//!
//! | file | holds |
//! |---|---|
//! | [`figure`] | each figure's unit, formula and source |
//! | `scorer` | from items to figures |
//! | `clock` | the time of the run, by the simulator's clock or the recording's |
//! | `told` | events from telemetry beyond the stock build's, as a judge would have reported them |
//! | `blind` | estimates of what the stock build does not report |
//! | `drives` | on which road each drive was, as it is told |
//! | `breaks` | where a recording does not continue from the row before, as it is told |
//! | `infractions`, `smoothness`, `latency`, `braking`, `guarded`, `offline` | the figures that need a formula |
//! | `card`, `table` | the scorecard as JSON and for people |
//! | [`files`], [`report`] | the runs that paths stand for, and the report on all of them |
//! | `thresholds`, [`junit`] | what a run must reach, and the report for CI |
//! | [`page`] | runs as a page for a browser |
//! | [`markdown`] | runs as a summary for CI, with the worst moment of each |
//! | [`summary`], [`against`] | several runs in one, and whether they got worse |

pub mod against;
mod blind;
mod braking;
mod breaks;
mod card;
mod clock;
mod drives;
pub mod figure;
pub mod files;
mod guarded;
mod infractions;
pub mod junit;
mod latency;
pub mod markdown;
mod measure;
mod offline;
pub mod page;
pub mod report;
mod run;
mod scorer;
mod smoothness;
pub mod summary;
mod table;
mod thresholds;
mod told;

pub use card::{SCHEMA, Scorecard};
pub(crate) use clock::RunClock;
pub use drives::{DriveFound, OnRoad, RoadTried, Turned};
pub use figure::{Better, Figure, SOURCES, Unit};
pub use latency::{Latency, STAGES};
pub use measure::Measure;
pub use run::of_recording;
pub use scorer::Scorer;
pub use summary::Spread;
pub use table::{aligned, lines};
pub use thresholds::{Check, checks, missed};
