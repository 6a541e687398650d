//! The verbs around a model's file.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::examples;

/// `lapwing model`
#[derive(Debug, Args)]
pub struct Model {
    #[command(subcommand)]
    pub verb: ModelVerb,
}

/// What to do with a model's file.
#[derive(Debug, Subcommand)]
pub enum ModelVerb {
    /// Show a recorded run to a model: shapes, range of its answers, latency, and what looks wrong
    #[command(after_help = examples::MODEL_CHECK)]
    Check(ModelCheck),
    /// Make a checkpoint from PyTorch tensors, whatever their names
    #[command(after_help = examples::MODEL_RENAME)]
    Rename(ModelRename),
}

/// `lapwing model check`; exit 1 where something looks wrong
#[derive(Debug, Args)]
pub struct ModelCheck {
    /// Checkpoint (.safetensors), ONNX (.onnx with a side .toml), or TorchScript (.pt with a side .toml), which is code: load
    /// only files that you trust [default: the built-in PilotNet]
    #[arg(value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Run (.mcap), or folder with driving_log.csv, to show to the model [default: recordings/lake.mcap, here or beside the
    /// program]
    #[arg(long, value_name = "RUN")]
    pub run: Option<PathBuf>,
    /// Write the first 100 pictures as the model sees them, decoded but not preprocessed (PNG), and its answers (answers.csv)
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Print the findings as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing model rename`
#[derive(Debug, Args)]
pub struct ModelRename {
    /// PyTorch tensors (.safetensors), as safetensors.torch.save_file writes a state_dict
    #[arg(value_name = "IN")]
    pub input: PathBuf,
    /// Architecture of the network
    #[arg(long, value_name = "NAME")]
    pub network: String,
    /// The checkpoint to write (.safetensors)
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Preprocessing of its training pictures (.toml, as beside a TorchScript model) [default: the .toml beside IN,
    /// if there is one, or else the architecture's own]
    #[arg(long, value_name = "FILE")]
    pub preprocess: Option<PathBuf>,
}
