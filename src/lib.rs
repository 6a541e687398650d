//! Lapwing.
pub mod protocol;
pub mod recording;
pub mod units;
