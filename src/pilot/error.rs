//! What keeps a pilot from driving.

use std::path::PathBuf;

use crate::{nn::NnError, perception::PreprocessError, words::count};

/// Why there is no pilot, or no steering of one.
#[derive(Debug, thiserror::Error)]
pub enum PilotError {
    /// A file of a kind that is no model.
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
    /// A checkpoint that is none, or is broken.
    #[error("{path}: {source}", path = path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        source: NnError,
    },
    /// A TorchScript model does not say what it was trained on; a file beside it must.
    #[error(
        "expected {side} beside {model} to name the preprocessing, and cannot read it: {source}",
        side = side.display(), model = model.display()
    )]
    NoSideFile {
        /// The model.
        model: PathBuf,
        /// The file that is wanted.
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
    /// A pilot that follows the road's line needs to know it, and only worlds of our own tell it.
    #[error(
        "expected a world that tells the line to drive, got telemetry without one: this pilot drives with lapwing drive, not with a simulator of others"
    )]
    NoPath,
    /// The frame does not suit the preprocessing, or that cannot be.
    #[error(transparent)]
    Preprocess(#[from] PreprocessError),
    /// The forward pass fails.
    #[error(transparent)]
    Network(#[from] NnError),
    /// The network answers more or fewer numbers than it is said to.
    #[error("expected {expected} from the network for its outputs {names}, got a tensor of shape {got:?}", expected = count(.outputs.len(), "number"), names = .outputs.join(", "))]
    OutputShape {
        /// What each number should be.
        outputs: Vec<String>,
        /// What came.
        got: Vec<i64>,
    },
    /// The network answers NaN or infinity.
    #[error("expected a finite {output} from the network, got {got}")]
    NotFinite {
        /// Which output.
        output: String,
        /// What it is.
        got: f64,
    },
    /// A model that cannot drive: made for something else, or even a blank picture is not answered as it should be.
    #[error("{path}: {source}", path = path.display())]
    Unfit {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: Box<PilotError>,
    },
}
