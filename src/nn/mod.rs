//! Networks and the file that holds one: the only door to weights.
//!
//! A [`Checkpoint`] is read from one `.safetensors` file and brings along what
//! its weights mean: [`Metadata`] with the preprocessing, and the [`Network`] of
//! the architecture that it names. Everything in the file is checked against the
//! architecture before it is used. Training makes a network whose weights are a
//! variable store's, and writes it with [`save`].
//!
//! One file an architecture, top to bottom, citing its paper; the names of its
//! tensors are those in the file. Which network drives, and when, is `pilot`'s.

mod checkpoint;
mod error;
mod network;
pub mod pilotnet;
pub mod runtime;

pub use checkpoint::{Checkpoint, FORMAT, Metadata, encode, save, sha256_hex};
pub use error::NnError;
pub(crate) use error::first_line;
pub use network::{Architecture, Network, TensorSource, in_variable_store};
