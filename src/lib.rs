//! Lapwing.
pub mod nn;
pub mod perception;
pub mod pilot;
pub mod protocol;
pub mod recording;
pub mod units;
