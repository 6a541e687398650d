//! Lapwing.
pub mod protocol;
pub mod units;
