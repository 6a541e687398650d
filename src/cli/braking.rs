//! The verbs around emergency braking.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::parse::above_zero;
#[cfg(feature = "networks")]
use lapwing_learn::braking::Part;

/// `lapwing brake`
#[derive(Debug, Args)]
pub struct Brake {
    #[command(subcommand)]
    pub verb: BrakeVerb,
}

/// What to do with braking.
#[derive(Debug, Subcommand)]
pub enum BrakeVerb {
    /// Label when an emergency brake is due, by how fast the driver's pedal goes down
    Label(BrakeLabel),
    /// Record data to learn emergency braking from: hazards and harmless drives, with a driver who brakes as people do
    #[cfg(feature = "simulator")]
    Record(BrakeRecord),
    /// Train a network to say when an emergency brake is due, on the data of brake record
    #[cfg(feature = "networks")]
    Train(BrakeTrain),
    /// Measure how many emergencies a network finds, and how often it is wrong
    #[cfg(feature = "networks")]
    Evaluate(BrakeEvaluate),
}

/// `lapwing brake record`
#[cfg(feature = "simulator")]
#[derive(Debug, Args)]
pub struct BrakeRecord {
    /// Folder for a run of each episode and episodes.csv; episodes that are there already are kept
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Hours of driving, at least
    #[arg(long, value_name = "HOURS", default_value_t = 3.0, value_parser = above_zero)]
    pub hours: f64,
    /// Random seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Print what was recorded as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing brake train`
#[cfg(feature = "networks")]
#[derive(Debug, Args)]
pub struct BrakeTrain {
    /// Recipe of the training (.toml)
    #[arg(long, value_name = "FILE")]
    pub recipe: PathBuf,
    /// Data set, as brake record writes it
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// The network's file to write (.safetensors)
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Passes at most [default: the recipe's]
    #[arg(long, value_name = "COUNT")]
    pub epochs: Option<usize>,
    /// End with the best pass so far once this time has gone by [default: no limit]
    #[arg(long, value_name = "MINUTES", value_parser = above_zero)]
    pub minutes: Option<f64>,
    /// Random seed [default: the recipe's]
    #[arg(long)]
    pub seed: Option<u64>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing brake evaluate`
#[cfg(feature = "networks")]
#[derive(Debug, Args)]
pub struct BrakeEvaluate {
    /// The network's file (.safetensors)
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Data set, as brake record writes it
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Which part of it
    #[arg(long, value_enum, default_value = "held-out")]
    pub part: Part,
    /// Of its episodes, take so many, spread over all [default: all]
    #[arg(long, value_name = "COUNT")]
    pub episodes: Option<usize>,
    /// The value from which on a brake is due [default: the one in the network's file]
    #[arg(long, value_name = "VALUE", value_parser = above_zero)]
    pub threshold: Option<f64>,
    /// Draw precision over recall: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Random seed of the intervals, and of which speeds fail
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing brake label`
#[derive(Debug, Args)]
pub struct BrakeLabel {
    /// Runs (.mcap), folders with driving_log.csv, or tables (.csv) with time, speed and brake
    #[arg(required = true, value_name = "RUN|DIR|CSV")]
    pub sources: Vec<PathBuf>,
    /// Write the labels of each source to a table in this folder, named after it
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Draw pedal, slope and label over time: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// How fast the pedal goes down in an emergency, in pedals per second [default: 1]
    #[arg(long, value_name = "PER_S", value_parser = above_zero)]
    pub threshold: Option<f64>,
    /// Print what was found as JSON
    #[arg(long)]
    pub json: bool,
}
