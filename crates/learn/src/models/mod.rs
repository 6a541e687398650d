//! Models from files, and the pilots that drive with them.
//!
//! [`load`] reads a file, [`built_in`] the shipped one, into a [`LoadedModel`], which makes any number of independent
//! pilots that share its weights, each on a thread of its own if need be. A [`LaneModel`] does not drive: it says where in
//! its lane a picture was taken. [`check`] looks at what a model answers to a whole recording.

pub mod check;
mod elsewhere;
mod error;
mod foreign;
mod lane;
mod model;
pub mod network;
#[cfg(feature = "onnx")]
pub mod onnx;
pub mod shown;
mod side_file;
pub mod torchscript;

pub use error::ModelError;
pub use foreign::{UNPICKLE, advice};
pub use lane::{LaneError, LaneFinder, LaneModel, LaneSeen};
pub use model::{LoadedModel, built_in, is_foreign, is_torchscript, load};
pub use side_file::SideFile;
