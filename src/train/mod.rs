//! Training a network.

pub mod events;
