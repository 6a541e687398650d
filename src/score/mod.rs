//! What a run was worth.
//!
//! A [`Scorer`] watches a run item by item, live or from a file, and ends in a
//! [`Scorecard`]. It judges by what the world tells of itself (its position,
//! laps and collisions); what a run cannot tell is absent, never 0.

mod card;
mod scorer;

pub use card::{Scorecard, Thresholds};
pub use scorer::Scorer;
