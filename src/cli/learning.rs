//! The verbs around training.

use std::path::PathBuf;

use clap::{ArgGroup, Args, Subcommand, builder::RangedU64ValueParser};

use super::{
    examples,
    parse::{above_zero, not_negative, rows_and_columns},
};
use lapwing_learn::{
    evaluate::Rows,
    nn::Precision,
    train::{Keep, OptimiserKind, Schedule},
};

/// `lapwing train`
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("learnt from").args(["data", "recipe", "resume"]).required(true).multiple(true)))]
pub struct Train {
    /// Data to train on: folders with driving_log.csv, or runs; DIR@2 is drawn twice as often
    #[arg(long, value_name = "DIR[@WEIGHT]", num_args = 1..)]
    pub data: Vec<String>,
    /// Recipe of a whole training (.toml); the other flags override its settings
    #[arg(long, value_name = "FILE")]
    pub recipe: Option<PathBuf>,
    /// Validation data [default: one held-out block of 50 rows in five]
    #[arg(long, value_name = "DIR", num_args = 1..)]
    pub validation: Vec<PathBuf>,
    /// Folder for the model, its log and its resume state
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Resume the training in that folder with its recipe; flags may override settings that do not affect the training
    #[arg(long)]
    pub resume: bool,
    /// Architecture [default: pilotnet]
    #[arg(long, value_name = "NAME")]
    pub network: Option<String>,
    /// Rows and columns of the input, such as 80x160, for networks that accept any size
    #[arg(long, value_name = "ROWSxCOLUMNS", value_parser = rows_and_columns)]
    pub input: Option<(usize, usize)>,
    /// Give the network the speed, too
    #[arg(long)]
    pub speed_input: bool,
    /// Initial weights: a ResNet's with torchvision's names, or a checkpoint (.safetensors)
    #[arg(long, value_name = "FILE")]
    pub pretrained: Option<PathBuf>,
    /// Keep the backbone's weights as --pretrained has them, and train only the layers after it
    #[arg(long)]
    pub freeze_backbone: bool,
    /// Passes over the data [default: 20]
    #[arg(long)]
    pub epochs: Option<usize>,
    /// Samples per step [default: 64]
    #[arg(long)]
    pub batch: Option<usize>,
    /// Samples per pass [default: all]
    #[arg(long, value_name = "COUNT")]
    pub samples_per_epoch: Option<usize>,
    /// Held-out samples to measure after each pass [default: all]
    #[arg(long, value_name = "COUNT")]
    pub validation_samples: Option<usize>,
    /// Random seed [default: 0]
    #[arg(long)]
    pub seed: Option<u64>,
    /// Optimiser [default: adam]
    #[arg(long, value_enum)]
    pub optimiser: Option<OptimiserKind>,
    /// Learning rate [default: 0.001]
    #[arg(long, value_name = "RATE", value_parser = above_zero)]
    pub learning_rate: Option<f64>,
    /// How the learning rate changes [default: constant]
    #[arg(long, value_enum)]
    pub schedule: Option<Schedule>,
    /// L2 penalty [default: 0]
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    pub weight_decay: Option<f64>,
    /// Largest norm of the gradient
    #[arg(long, value_name = "NORM", value_parser = above_zero)]
    pub clip: Option<f64>,
    /// Stop after this many passes without a better validation error
    #[arg(long, value_name = "EPOCHS")]
    pub patience: Option<usize>,
    /// Save an exponential moving average of the weights with this decay, such as 0.999
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    pub ema: Option<f64>,
    /// Precision of the forward and backward pass [default: f32]
    #[arg(long, value_enum)]
    pub precision: Option<Precision>,
    /// Which epoch to keep [default: best]
    #[arg(long, value_enum)]
    pub keep: Option<Keep>,
    /// Steering added for the left camera and subtracted for the right one [default: 0.25]
    #[arg(long, value_name = "STEERING", value_parser = not_negative)]
    pub side_offset: Option<f64>,
    /// Average the labels over this many rows [default: 1]
    #[arg(long, value_name = "ROWS")]
    pub smooth: Option<usize>,
    /// Share of the rows without steering to keep [default: 1]
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    pub keep_zero: Option<f64>,
    /// How much to flatten the histogram of steering, 0 to 1 [default: 0]
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    pub flatten: Option<f64>,
    /// Draw a row at full lock this many times more often than a straight one [default: 0]
    #[arg(long, value_name = "TIMES", value_parser = not_negative)]
    pub large_angles: Option<f64>,
    /// Augmentations to use: flip, translate, brightness, shadow, erase, or none [default: all]; a recipe's late is off
    /// then, too
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub augment: Option<Vec<String>>,
    /// Where in its lane the car was, as locate --csv writes it, one file for each --data: labels lead back to the lane's
    /// middle, whatever was steered
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "data")]
    pub lane: Vec<PathBuf>,
    /// The track file (.toml) of a road of your own on which the data was recorded
    #[arg(long, value_name = "FILE")]
    pub track: Option<String>,
    /// After the training, let the network drive and learn from what it saw, in this many rounds [default: as the recipe
    /// says; without a number: 3]
    #[arg(long, value_name = "ROUNDS", num_args = 0..=1, default_missing_value = "3")]
    pub closed_loop: Option<usize>,
    /// Memory for decoded pictures, in MiB [default: 1024]
    #[arg(long, value_name = "MIB")]
    pub cache_mib: Option<usize>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing evaluate`
#[derive(Debug, Args)]
pub struct Evaluate {
    /// Checkpoint (.safetensors), ONNX (.onnx with a side .toml), or TorchScript (.pt with a side .toml), which is code: load
    /// only files that you trust [default: the built-in PilotNet]
    pub model: Option<PathBuf>,
    /// Data sets: folders with driving_log.csv, or runs
    #[arg(long, value_name = "DIR", num_args = 1.., required = true)]
    pub data: Vec<PathBuf>,
    /// Which rows: all, or those held out when the checkpoint was trained (if it does not say, one block of 50 in five)
    #[arg(long, value_enum, default_value_t = Rows::All)]
    pub rows: Rows,
    /// Plot the error over the steering angle: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Use only the rows before this one, counted from 0
    #[arg(long, value_name = "ROW", value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub before: Option<usize>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing explain`
#[derive(Debug, Args)]
pub struct Explain {
    /// A run (.mcap), or a folder with driving_log.csv and IMG/
    pub recording: PathBuf,
    /// Which picture: its number in the recording, counted from 0, as other verbs print it
    #[arg(long, value_name = "MOMENT", default_value_t = 0)]
    pub frame: usize,
    /// Checkpoint (.safetensors) of a network that steers by one picture [default: the built-in PilotNet]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Draw the picture and what the steering comes from: FILE.png or FILE.svg
    #[arg(long, value_name = "FILE", default_value = "explained.png")]
    pub out: PathBuf,
}

/// `lapwing dataset`
#[derive(Debug, Args)]
pub struct Dataset {
    #[command(subcommand)]
    pub verb: DatasetVerb,
}

/// What to do with data sets.
#[derive(Debug, Subcommand)]
pub enum DatasetVerb {
    /// Decode every picture and report rows, cameras, steering, speed, gaps, missing and broken pictures
    #[command(after_help = examples::DATASET_INSPECT)]
    Inspect(DatasetInspect),
    /// Convert a Udacity folder to a run (.mcap), or a run to a Udacity folder
    #[command(after_help = examples::DATASET_CONVERT)]
    Convert(DatasetConvert),
    /// Split a log in two, one to train on and one to validate on; the pictures stay where they are
    #[command(after_help = examples::DATASET_SPLIT)]
    Split(DatasetSplit),
    /// Draw what each augmentation does to pictures and labels
    #[command(after_help = examples::DATASET_PREVIEW)]
    Preview(DatasetPreview),
}

/// `lapwing dataset inspect`; exit 1 where a picture is missing or broken
#[derive(Debug, Args)]
pub struct DatasetInspect {
    /// Folders with driving_log.csv and IMG/, or runs (.mcap)
    #[arg(required = true, value_name = "DIR|FILE")]
    pub sources: Vec<PathBuf>,
    /// Draw a contact sheet of the drive, with the steering as an arrow: FILE.png or FILE.svg
    #[arg(long, value_name = "FILE")]
    pub sheet: Option<PathBuf>,
    /// Draw the distribution of the steering, one chart per source: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Print the findings as JSON, with all gaps and problems
    #[arg(long)]
    pub json: bool,
}

/// `lapwing dataset convert`
#[derive(Debug, Args)]
pub struct DatasetConvert {
    /// A folder with driving_log.csv and IMG/, or a run (.mcap)
    #[arg(value_name = "SRC")]
    pub source: PathBuf,
    /// The run (.mcap) or the folder to write; nothing is overwritten
    #[arg(value_name = "DST")]
    pub target: PathBuf,
    /// Print what was written as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing dataset preview`
#[derive(Debug, Args)]
pub struct DatasetPreview {
    /// A folder with driving_log.csv and IMG/, or a run (.mcap)
    #[arg(value_name = "DIR|FILE")]
    pub source: PathBuf,
    /// Where to draw: FILE.png or FILE.svg
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Recipe (.toml) whose ranges to use [default: those of Lu, End to End Learning for Self-Driving Cars]
    #[arg(long, value_name = "FILE")]
    pub recipe: Option<PathBuf>,
    /// Random seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// `lapwing dataset split`
#[derive(Debug, Args)]
pub struct DatasetSplit {
    /// A folder with driving_log.csv and IMG/
    #[arg(value_name = "DIR")]
    pub source: PathBuf,
    /// Folder to make, for the log of the rows to train on
    #[arg(long, value_name = "DIR")]
    pub out_train: PathBuf,
    /// Folder to make, for the log of the rows to validate on
    #[arg(long, value_name = "DIR")]
    pub out_validation: PathBuf,
    /// Rows per block; rows of one block stay together
    #[arg(long, value_name = "ROWS", default_value_t = 50)]
    pub block: usize,
    /// Hold out the first of every N blocks
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub every: usize,
    /// Print what was written as JSON
    #[arg(long)]
    pub json: bool,
}
