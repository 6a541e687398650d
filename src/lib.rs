//! Lapwing.
pub mod perception;
pub mod protocol;
pub mod units;
