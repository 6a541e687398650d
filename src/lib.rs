//! Lapwing.
pub mod nn;
pub mod perception;
pub mod protocol;
pub mod units;
