//! Errors of checkpoints and forward passes.

use std::path::PathBuf;

use super::{Architecture, FORMAT};
use lapwing_core::{perception::PreprocessError, words::did_you_mean};

/// Why a network, its answer or its file cannot be made or read.
#[derive(Debug, thiserror::Error)]
pub enum NnError {
    /// The file cannot be read.
    #[error("{path} cannot be read: {source}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("{path} cannot be written: {source}", path = path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// The bytes are not of this format, are cut off, or have a wrong header.
    #[error("expected a whole safetensors file: {0}")]
    NotSafetensors(safetensors::SafeTensorError),
    /// A metadata key is missing.
    #[error("expected the metadata key {0}, got none")]
    MissingKey(&'static str),
    /// Another format, or a later one.
    #[error("expected the format {FORMAT:?}, got {0:?}")]
    Format(String),
    /// A network that this build does not have.
    #[error(
        "expected one of the architectures {known}, got {got:?}{meant}",
        known = Architecture::names(),
        meant = did_you_mean(got, Architecture::ALL.map(Architecture::name))
    )]
    UnknownArchitecture {
        /// What the file names.
        got: String,
    },
    /// A metadata key holds text that is not the JSON it should be.
    #[error("metadata key {key}: {why}")]
    Metadata {
        /// The key.
        key: &'static str,
        /// What the JSON reader says.
        why: serde_json::Error,
    },
    /// Invalid preprocessing.
    #[error("metadata key preprocess: {0}")]
    Preprocess(#[from] PreprocessError),
    /// Channels last, in a checkpoint.
    #[error("expected layout nchw for {name}, got nhwc: only networks made elsewhere take pictures pixel by pixel", name = architecture.name())]
    Layout {
        /// The network.
        architecture: Architecture,
    },
    /// Preprocessing for another network.
    #[error(
        "expected preprocessing to {expected} for {name}, got {got}",
        expected = architecture.frame_shape(), got = times(got), name = architecture.name()
    )]
    InputShape {
        /// The network.
        architecture: Architecture,
        /// The shape that the preprocessing gives.
        got: [usize; 3],
    },
    /// The number of names differs from the network's outputs.
    #[error("expected {expected} outputs for {architecture}, got {got:?}", architecture = architecture.name())]
    Outputs {
        /// The network.
        architecture: Architecture,
        /// How many it has.
        expected: usize,
        /// The names in the file.
        got: Vec<String>,
    },
    /// A tensor of the architecture is not in the file.
    #[error("expected the tensor {name} of shape {expected:?}, got none")]
    MissingTensor {
        /// Its name.
        name: String,
        /// Its shape.
        expected: Vec<i64>,
    },
    /// A tensor in the file is not of the architecture.
    #[error("expected only the tensors of {architecture}, got {name} as well", architecture = architecture.name())]
    SurplusTensor {
        /// The network.
        architecture: Architecture,
        /// The tensor's name, the first in the alphabet.
        name: String,
    },
    /// A tensor of another shape.
    #[error("tensor {name}: expected shape {expected:?}, got {got:?}")]
    Shape {
        /// Its name.
        name: String,
        /// The architecture's.
        expected: Vec<i64>,
        /// The file's.
        got: Vec<usize>,
    },
    /// A tensor of numbers that are not floating-point, or wider than 32 bits.
    #[error("tensor {name}: expected F32, F16 or BF16, got {got:?}")]
    Dtype {
        /// Its name.
        name: String,
        /// The file's.
        got: safetensors::Dtype,
    },
    /// Metadata that says another preprocessing than the network was built with.
    #[error(
        "expected the preprocessing that the network was built with, got another in its metadata: use the release that \
         wrote the file, or train the network anew by its recipe (lapwing train, lapwing brake train)"
    )]
    OtherPreprocess,
    /// Inputs that are not the architecture's.
    #[error("expected {expected} frames for {name}, got {got}", expected = architecture.frames(), name = architecture.name())]
    Frames {
        /// The network.
        architecture: Architecture,
        /// How many the file says.
        got: usize,
    },
    /// A file of weights has none of this network's backbone.
    #[error(
        "expected tensors for the backbone of {name} in {path}, got none: pretrained weights are for ResNets",
        name = architecture.name(), path = path.display()
    )]
    NoneFits {
        /// The file.
        path: PathBuf,
        /// The network.
        architecture: Architecture,
    },
    /// A backbone was to be frozen in a network without one.
    #[error("expected a network with a backbone (resnet…), got {name}", name = architecture.name())]
    NoBackbone {
        /// The network.
        architecture: Architecture,
    },
    /// Weights that a network cannot compute with.
    #[error("tensor {name}: expected finite numbers, got {count} that are NaN or infinite")]
    NotFinite {
        /// The tensor.
        name: String,
        /// How many of its numbers.
        count: i64,
    },
    /// A network was given a tensor that it does not take.
    #[error("expected an input of shape {expected}, got {got:?}")]
    Input {
        /// The shape that it takes.
        expected: String,
        /// All that it was given.
        got: Vec<i64>,
    },
    /// A network was given no speed, or one that it does not take.
    #[error("expected {expected}, got {got}", expected = speed(expected), got = speed(got))]
    Speed {
        /// The shape that it takes, if it takes any.
        expected: Option<Vec<i64>>,
        /// What it was given.
        got: Option<Vec<i64>>,
    },
    /// An error of ONNX Runtime: the first line of its message.
    #[error("ONNX Runtime: {0}")]
    Onnx(String),
    /// An error of libtorch: the first line of its message.
    #[error("libtorch: {0}")]
    Torch(String),
}

impl From<tch::TchError> for NnError {
    fn from(error: tch::TchError) -> Self {
        Self::Torch(torch_words(&error))
    }
}

/// libtorch's message without the stack of C++ calls after it.
pub(crate) fn torch_words(error: &tch::TchError) -> String {
    match error {
        tch::TchError::Torch(text) => first_line(text),
        other => first_line(&other.to_string()),
    }
}

/// What a library says first, in one line.
pub(crate) fn first_line(text: &str) -> String {
    text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("no reason given").to_owned()
}

fn times(shape: &[usize; 3]) -> String {
    shape.map(|n| n.to_string()).join("x")
}

fn speed(shape: &Option<Vec<i64>>) -> String {
    shape.as_ref().map_or("no speed".into(), |shape| format!("a speed of shape {shape:?}"))
}
