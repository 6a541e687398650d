//! Errors of models.

use std::path::PathBuf;

use lapwing_core::pilot::PilotError;

use crate::nn::NnError;

/// Why a file is not a model that can drive.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A file of a kind that is not a model.
    #[error("expected a model, a file ending in .safetensors, .pt or .onnx, got {path}", path = .0.display())]
    Extension(PathBuf),
    /// A file of another tool.
    #[error("expected a model, a file ending in .safetensors, .pt or .onnx, got {path}, {kind}: {todo}", path = path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What it is.
        kind: &'static str,
        /// What to do with it.
        todo: &'static str,
    },
    /// Tensors without the metadata that makes them a checkpoint.
    #[error(
        "{path}: expected a checkpoint, whose metadata says what the tensors are, got tensors alone: lapwing model rename \
         {path} --network NAME --out OUT makes one",
        path = path.display()
    )]
    TensorsAlone {
        /// The file.
        path: PathBuf,
    },
    /// A file of this project that holds something else.
    #[error("{path}: expected a network that steers, got {what}", path = path.display())]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// What it is, and what takes it.
        what: &'static str,
    },
    /// ONNX Runtime is not there, or too old.
    #[error(
        "expected ONNX Runtime 1.24 or newer to run {path}, and cannot load it: {why}. pip install onnxruntime brings it; name \
         its onnxruntime/capi/libonnxruntime.so.1… in the environment (ORT_DYLIB_PATH) or in your own settings \
         (model.onnxruntime)",
        path = path.display()
    )]
    NoOnnxRuntime {
        /// The model.
        path: PathBuf,
        /// What the loader says.
        why: String,
    },
    /// ONNX Runtime refuses the model or fails in it.
    #[error("{path}: ONNX Runtime: {why}", path = path.display())]
    Onnx {
        /// The model.
        path: PathBuf,
        /// The first line of what it says.
        why: String,
    },
    /// A model that is not whole: what a run says of its model would not tell these weights from others.
    #[error(
        "{path}: expected a model with its weights, got one whose weights are in a second file: export it with \
         external_data=False, as torch.onnx.export calls it",
        path = path.display()
    )]
    OnnxWeights {
        /// The model.
        path: PathBuf,
    },
    /// A network that does not take what the file beside it prepares.
    #[error("{path}: expected a network with one input of shape {expected:?} f32, as {side} says, got {got}", path = path.display(), side = path.with_extension("toml").display())]
    OnnxInput {
        /// The model.
        path: PathBuf,
        /// What the preprocessing gives.
        expected: [usize; 4],
        /// What the network takes.
        got: String,
    },
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
        "expected {side} next to {model} to name the preprocessing (docs/how-to/own-network.md shows one), and cannot read it: {source}",
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
        "expected {path} to be a TorchScript module, saved by torch.jit.save and not by torch.save; libtorch: {said}. If it holds \
         pickled weights, {todo}",
        path = path.display(), said = .why.trim_end_matches('.'), todo = super::foreign::UNPICKLE
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
