//! Scores a run.
//!
//! A [`Scorer`] watches a run item by item, live or from a file ([`of_recording`]), and ends in a [`Scorecard`]: a [`Measure`]
//! for each [`Figure`]. What the world reports of itself (its position, laps and collisions) is told on; what follows
//! from other things is marked as an estimate, with its uncertainty; what a run cannot tell is not measurable, with
//! the reason, never 0.
//!
//! | file | holds |
//! |---|---|
//! | [`figure`] | each figure's unit, formula and source |
//! | `scorer` | from items to figures |
//! | `clock` | the time of the run, by the simulator's clock or the recording's |
//! | `told` | what telemetry beyond the stock build's tells, as a judge would have called it |
//! | `blind` | what the stock build does not say, as well as it can be found out |
//! | `infractions`, `smoothness`, `latency`, `braking`, `offline` | the figures that take a formula |
//! | `card`, `table` | the scorecard as JSON and for people |
//! | [`files`], [`report`] | which runs are meant, and what is said of all of them |
//! | `thresholds`, [`junit`] | what a run must reach, and how CI is told |
//! | [`page`] | runs as a page for a browser |
//! | [`summary`], [`against`] | several runs in one, and whether they got worse |

pub mod against;
mod blind;
mod braking;
mod card;
mod clock;
pub mod figure;
pub mod files;
mod infractions;
pub mod junit;
mod latency;
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
pub use figure::{Better, Figure, SOURCES, Unit};
pub use latency::{Latency, STAGES};
pub use measure::Measure;
pub use run::of_recording;
pub use scorer::Scorer;
pub use summary::Spread;
pub use table::{aligned, lines};
pub use thresholds::{Check, checks, missed};
