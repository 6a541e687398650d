//! The verbs around training.

use std::path::PathBuf;

use clap::{ArgGroup, Args, Subcommand};

use super::parse::{above_zero, not_negative, rows_and_columns, word};
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
    /// Data to measure by [default: one block of 50 rows in five, held out]
    #[arg(long, value_name = "DIR", num_args = 1..)]
    pub validation: Vec<PathBuf>,
    /// Folder for the model, its log and its resume state
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Resume the training in that folder with its recipe; flags may override settings that do not affect training
    #[arg(long)]
    pub resume: bool,
    /// Architecture [default: pilotnet]
    #[arg(long, value_name = "NAME")]
    pub network: Option<String>,
    /// Rows and columns of the input, for networks that take any, such as 80x160
    #[arg(long, value_name = "ROWSxCOLUMNS", value_parser = rows_and_columns)]
    pub input: Option<(usize, usize)>,
    /// Tell the network the speed, too
    #[arg(long)]
    pub speed_input: bool,
    /// Weights to begin with: of a ResNet under torchvision's names, or of a checkpoint (.safetensors)
    #[arg(long, value_name = "FILE")]
    pub pretrained: Option<PathBuf>,
    /// Leave the backbone as --pretrained has it; only what is behind it learns
    #[arg(long)]
    pub freeze_backbone: bool,
    /// Passes over the data [default: 20]
    #[arg(long)]
    pub epochs: Option<usize>,
    /// Samples in a step [default: 64]
    #[arg(long)]
    pub batch: Option<usize>,
    /// Samples in a pass [default: all]
    #[arg(long, value_name = "COUNT")]
    pub samples_per_epoch: Option<usize>,
    /// Held-out samples measured after each pass [default: all]
    #[arg(long, value_name = "COUNT")]
    pub validation_samples: Option<usize>,
    /// Seed of everything random [default: 0]
    #[arg(long)]
    pub seed: Option<u64>,
    /// adam or sgd [default: adam]
    #[arg(long, value_name = "NAME", value_parser = word::<OptimiserKind>)]
    pub optimiser: Option<OptimiserKind>,
    /// Learning rate [default: 0.001]
    #[arg(long, value_name = "RATE", value_parser = above_zero)]
    pub learning_rate: Option<f64>,
    /// constant, cosine or plateau [default: constant]
    #[arg(long, value_name = "NAME", value_parser = word::<Schedule>)]
    pub schedule: Option<Schedule>,
    /// L2 penalty [default: 0]
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    pub weight_decay: Option<f64>,
    /// Largest norm of the gradient
    #[arg(long, value_name = "NORM", value_parser = above_zero)]
    pub clip: Option<f64>,
    /// End after so many passes without a better validation error
    #[arg(long, value_name = "EPOCHS")]
    pub patience: Option<usize>,
    /// Save an average over past weights, of which each step keeps this share, such as 0.999
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    pub ema: Option<f64>,
    /// f32 or bf16 [default: f32]
    #[arg(long, value_name = "NAME", value_parser = word::<Precision>)]
    pub precision: Option<Precision>,
    /// Keep the best or the last epoch [default: best]
    #[arg(long, value_name = "NAME", value_parser = word::<Keep>)]
    pub keep: Option<Keep>,
    /// Steering added for the left camera and taken off for the right [default: 0.25]
    #[arg(long, value_name = "STEERING", value_parser = not_negative)]
    pub side_offset: Option<f64>,
    /// Labels are means over so many rows [default: 1]
    #[arg(long, value_name = "ROWS")]
    pub smooth: Option<usize>,
    /// Share of the rows without steering that is kept [default: 1]
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    pub keep_zero: Option<f64>,
    /// How far the histogram of steering is flattened, 0 to 1 [default: 0]
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    pub flatten: Option<f64>,
    /// A row at full lock is drawn so many times more often than one straight on [default: 0]
    #[arg(long, value_name = "TIMES", value_parser = not_negative)]
    pub large_angles: Option<f64>,
    /// Only these changes to pictures: flip, translate, brightness, shadow, erase, or none [default: all]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub augment: Option<Vec<String>>,
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
    /// Checkpoint (.safetensors), or TorchScript (.pt with a side .toml), whose code runs: load only files that you
    /// trust [default: the PilotNet built in]
    pub model: Option<PathBuf>,
    /// Data sets: folders with driving_log.csv, or runs
    #[arg(long, value_name = "DIR", num_args = 1.., required = true)]
    pub data: Vec<PathBuf>,
    /// All rows, or those that the checkpoint's training held out; where it does not say, one block of 50 in five
    #[arg(long, value_enum, default_value_t = Rows::All)]
    pub rows: Rows,
    /// Draw the error over the steering angle: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Only rows before this one, counted from 0
    #[arg(long, value_name = "ROW")]
    pub before: Option<usize>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
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
    /// Decode every picture and say what is there: rows, cameras, steering, speed, gaps, missing and broken pictures
    Inspect(DatasetInspect),
    /// Make a run (.mcap) of a Udacity folder, or a Udacity folder of a run
    Convert(DatasetConvert),
    /// Write two logs, of the rows to train on and of those to validate on; pictures stay where they are
    Split(DatasetSplit),
    /// Draw what each augmentation makes of pictures and labels
    Preview(DatasetPreview),
}

/// `lapwing dataset inspect`; exit 1 where a picture is missing or broken
#[derive(Debug, Args)]
pub struct DatasetInspect {
    /// Folders with driving_log.csv and IMG/, or runs (.mcap)
    #[arg(required = true, value_name = "DIR|FILE")]
    pub sources: Vec<PathBuf>,
    /// Contact sheet: pictures over the drive, steering as an arrow: FILE.png or FILE.svg
    #[arg(long, value_name = "FILE")]
    pub sheet: Option<PathBuf>,
    /// Distribution of the steering, a chart for each: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Print the findings as JSON, all gaps and problems among them
    #[arg(long)]
    pub json: bool,
}

/// `lapwing dataset convert`
#[derive(Debug, Args)]
pub struct DatasetConvert {
    /// A folder with driving_log.csv and IMG/, or a run (.mcap)
    #[arg(value_name = "SRC")]
    pub source: PathBuf,
    /// The run (.mcap) or the folder to make; nothing is overwritten
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
    /// Take the ranges of a recipe (.toml) [default: Lu's]
    #[arg(long, value_name = "FILE")]
    pub recipe: Option<PathBuf>,
    /// Seed of the dice
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
    /// Rows in a block: neighbours in time are not torn apart
    #[arg(long, value_name = "ROWS", default_value_t = 50)]
    pub block: usize,
    /// One block in so many is held out, the first of them
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub every: usize,
    /// Print what was written as JSON
    #[arg(long)]
    pub json: bool,
}
