//! The verbs around emergency braking.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::parse::above_zero;

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
