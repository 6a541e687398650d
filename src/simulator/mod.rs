//! Worlds of our own and how they speak to a bridge.
//!
//! For now only the speaking: [`client`] plays any [`crate::protocol::World`] to
//! any bridge exactly as the Unity build does.

pub mod client;
