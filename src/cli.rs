//! The command line, as clap types. What a verb does stands in `commands`.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::{protocol::number::Culture, replay::Rate};

/// Connects, drives, records and replays the Udacity self-driving-car simulator.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100)]
pub struct Cli {
    /// Settings file [default: lapwing.toml of this folder, if there is one]
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Wait for simulators, drive them and record the runs
    Serve(Serve),
    /// Show a recording to a model, or to any bridge, and compare the steering
    Replay(Replay),
    /// Say which libtorch is in use, and what is wrong if anything
    Doctor(Doctor),
}

/// `lapwing serve`
#[derive(Debug, Args)]
pub struct Serve {
    #[command(flatten)]
    pub driving: Driving,
    /// Address to listen on; 0.0.0.0 for simulators on other machines [default: 127.0.0.1]
    #[arg(long, value_name = "ADDRESS")]
    pub bind: Option<String>,
    /// Port to listen on; the simulator itself only dials 4567 [default: 4567]
    #[arg(long)]
    pub port: Option<u16>,
    /// Event for each simulator as it connects, in JSON: '["reset",{}]'; may be given several times
    #[arg(long, value_name = "EVENT")]
    pub greet: Vec<String>,
    /// Folder for the runs [default: recordings]
    #[arg(long, value_name = "DIR", conflicts_with = "no_recording")]
    pub recordings: Option<PathBuf>,
    /// Record nothing
    #[arg(long)]
    pub no_recording: bool,
    /// Print the account of each drive as one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// What drives and how; shared by all verbs that drive.
#[derive(Debug, Args)]
pub struct Driving {
    /// Checkpoint (.safetensors) or TorchScript (.pt with a side .toml) [default: the PilotNet built in]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Set speed of the PI law, limit of the quadratic one, in mph [default: 9]
    #[arg(long, value_name = "MPH", allow_negative_numbers = true)]
    pub speed: Option<f64>,
    /// How throttle is made: drive.py's PI controller, or 1 - steering^2 - (speed/limit)^2 [default: pi]
    #[arg(long, value_enum)]
    pub speed_law: Option<SpeedLaw>,
    /// After a human lets go: drive on, or stay off until armed (Enter, or POST /arm) [default: resume]
    #[arg(long, value_enum)]
    pub takeover: Option<Takeover>,
    /// Threads for one forward pass [default: what serves the network best]
    #[arg(long)]
    pub threads: Option<u16>,
}

/// Speed laws by name.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum SpeedLaw {
    Pi,
    Quadratic,
}

/// Hand-over policies by name.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum Takeover {
    Resume,
    Latch,
}

/// `lapwing replay`
#[derive(Debug, Args)]
pub struct Replay {
    /// A run (.mcap), or a folder with driving_log.csv and IMG/
    pub source: PathBuf,
    #[command(flatten)]
    pub driving: Driving,
    /// Play the recording to a bridge as the Unity build would, instead of driving in process
    #[arg(long, value_name = "HOST:PORT", conflicts_with_all = ["model", "speed", "speed_law", "takeover", "threads"])]
    pub connect: Option<String>,
    /// Culture in which the simulator writes its numbers, with --connect
    #[arg(long, value_name = "NAME", default_value = "en-US", value_parser = culture, requires = "connect")]
    pub culture: Culture,
    /// How fast: as recorded (real), as fast as possible (max), or frames a second
    #[arg(long, value_name = "real|max|HZ", default_value = "max")]
    pub rate: Rate,
    /// Compare each command with a stored replay; exit 1 where one differs
    #[arg(long, value_name = "FILE")]
    pub golden: Option<PathBuf>,
    /// Store this replay for --golden
    #[arg(long, value_name = "FILE", conflicts_with = "golden")]
    pub write_golden: Option<PathBuf>,
    /// Largest difference in steering and throttle that --golden forgives
    #[arg(long, default_value_t = 1e-3, value_parser = tolerance, allow_negative_numbers = true, requires = "golden")]
    pub tolerance: f64,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

fn culture(name: &str) -> Result<Culture, String> {
    let known = || Culture::ALL.map(|c| c.name).join(", ");
    Culture::named(name).ok_or_else(|| format!("expected one of {}", known()))
}

fn tolerance(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|t| *t >= 0.0).ok_or_else(|| "expected a number of at least 0".into())
}

/// `lapwing doctor`
#[derive(Debug, Args)]
pub struct Doctor {
    #[command(flatten)]
    pub driving: Driving,
    /// Print the findings as JSON
    #[arg(long)]
    pub json: bool,
}
