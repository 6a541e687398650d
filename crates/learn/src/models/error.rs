//! Errors of models.

use std::path::PathBuf;

use lapwing_core::pilot::PilotError;

use crate::nn::NnError;

/// Why a file is not a model that can drive.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A file of a kind that is not a model.
    #[error("expected a model, a file ending in .safetensors or .pt, got {path}", path = .0.display())]
    Extension(PathBuf),
    /// The model cannot be read.
    #[error("{path} cannot be read: {source}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// A file that is not a checkpoint, or is broken.
    #[error("{path}: {source}", path = path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        source: NnError,
    },
    /// A TorchScript model does not say what it was trained on; a file beside it must.
    #[error(
        "expected {side} next to {model} to name the preprocessing, and cannot read it: {source}",
        side = side.display(), model = model.display()
    )]
    NoSideFile {
        /// The model.
        model: PathBuf,
        /// The file that is missing.
        side: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// The file beside a TorchScript model is not TOML, or has keys missing or unknown.
    #[error("{side}: {why}", side = side.display())]
    SideFile {
        /// The file.
        side: PathBuf,
        /// What and where.
        why: String,
    },
    /// A `.pt` of another kind: the name is used for pickled weights, too.
    #[error(
        "expected {path} to be a TorchScript module, saved by torch.jit.save and not by torch.save; libtorch: {why}",
        path = path.display()
    )]
    NotTorchScript {
        /// The file.
        path: PathBuf,
        /// The first line of what libtorch says.
        why: String,
    },
    /// A network for something else.
    #[error("expected a network whose first output is steering, got {0:?}")]
    NotSteering(Vec<String>),
    /// A network that drives where one that locates is wanted.
    #[error("expected a network that locates the lane (lane), got outputs {0:?}")]
    NotLane(Vec<String>),
    /// A model that cannot drive: it is made for something else, or fails even on a blank picture.
    #[error("{path}: {source}", path = path.display())]
    Unfit {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: Box<ModelError>,
    },
    /// It does not answer a blank picture correctly.
    #[error(transparent)]
    Pilot(#[from] PilotError),
    /// libtorch fails.
    #[error(transparent)]
    Network(#[from] NnError),
}
