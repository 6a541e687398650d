//! The verbs around emergency braking.

use std::path::PathBuf;

#[cfg(feature = "networks")]
use clap::builder::RangedU64ValueParser;
#[cfg(any(feature = "networks", feature = "simulator"))]
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};

#[cfg(feature = "simulator")]
use super::GuardFlags;
use super::{examples, parse::above_zero};
#[cfg(feature = "simulator")]
use lapwing_core::words::did_you_mean;
#[cfg(all(feature = "networks", not(feature = "simulator")))]
use lapwing_learn::braking::Part;
#[cfg(feature = "simulator")]
use lapwing_sim::braking::{Case, Layer, Part};

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
    #[command(after_help = examples::BRAKE_LABEL)]
    Label(BrakeLabel),
    /// Record data to learn emergency braking from: hazards and harmless drives, with a driver who brakes as people do
    #[cfg(feature = "simulator")]
    #[command(after_help = examples::BRAKE_RECORD)]
    Record(BrakeRecord),
    /// Drive every hazard and every harmless situation, without and with a guard, and count what is avoided
    #[cfg(feature = "simulator")]
    #[command(after_help = examples::BRAKE_TRIAL)]
    Trial(BrakeTrial),
    /// Train a network to say when an emergency brake is due, on the data of brake record
    #[cfg(feature = "networks")]
    #[command(after_help = examples::BRAKE_TRAIN)]
    Train(BrakeTrain),
    /// Measure how many emergencies a network finds, and how often it is wrong
    #[cfg(feature = "networks")]
    #[command(after_help = examples::BRAKE_EVALUATE)]
    Evaluate(BrakeEvaluate),
}

/// `lapwing brake record`
#[cfg(feature = "simulator")]
#[derive(Debug, Args)]
pub struct BrakeRecord {
    /// Folder for a run of each episode and episodes.csv; episodes that are there already are kept
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Hours of driving in all parts together, at least
    #[arg(long, value_name = "HOURS", default_value_t = 3.0, value_parser = above_zero)]
    pub hours: f64,
    /// Random seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Record only this part of the data set: train to learn from, validation to choose by, held-out to judge by [default: all]
    #[arg(long, value_parser = part())]
    pub part: Option<Part>,
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
    /// Go on where an earlier training with the same output ended
    #[arg(long)]
    pub resume: bool,
    /// Threads for one operation; other numbers round differently, so the result is another one
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: u16,
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
    #[arg(long, default_value = "held-out", value_parser = part())]
    pub part: Part,
    /// Of its episodes, take so many, spread over all [default: all]
    #[arg(long, value_name = "COUNT", value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub episodes: Option<usize>,
    /// The value from which on a brake is due [default: the one in the network's file]
    #[arg(long, value_name = "VALUE", value_parser = above_zero, allow_negative_numbers = true)]
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

/// `lapwing brake trial`
#[cfg(feature = "simulator")]
#[derive(Debug, Args)]
pub struct BrakeTrial {
    #[command(flatten)]
    pub guard: GuardFlags,
    /// What to play, such as ccrs,cpna,parked [default: all hazards and all that is harmless]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = case)]
    pub cases: Vec<Case>,
    /// The layers that the seeds take turns in: plain, hidden, rain, low-sun, night; what is played in none of them is left out
    /// [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = layer)]
    pub layers: Vec<Layer>,
    /// Speeds of the car, in mph [default: 10,15,20,25,30]
    #[arg(long, value_name = "MPH", value_delimiter = ',', value_parser = speed_in_trial)]
    pub speeds: Vec<f64>,
    /// Drives of each case at each speed
    #[arg(long, value_name = "COUNT", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,
    /// Laps of each of lake, jungle and mountain, without traffic
    #[arg(long, value_name = "COUNT", default_value_t = 10)]
    pub laps: u32,
    /// Part of the data whose roads, looks and weather to use: train to learn from, validation to choose by, held-out to judge by
    #[arg(long, default_value = "held-out", value_parser = part())]
    pub part: Part,
    /// Folder without a trial.json, for trial.json, trial.html, and films/ of the worst drive of each
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

#[cfg(any(feature = "networks", feature = "simulator"))]
fn part() -> impl TypedValueParser<Value = Part> {
    PossibleValuesParser::new(Part::ALL.map(Part::name)).try_map(|name| Part::named(&name).ok_or("expected a part"))
}

#[cfg(feature = "simulator")]
fn case(text: &str) -> Result<Case, String> {
    Case::named(text).filter(|case| *case != Case::Lap).ok_or_else(|| {
        let names: Vec<_> = Case::ALL.into_iter().filter(|case| *case != Case::Lap).map(Case::name).collect();
        format!("expected one of {}{}", names.join(", "), did_you_mean(text, names.iter().copied()))
    })
}

#[cfg(feature = "simulator")]
fn layer(text: &str) -> Result<Layer, String> {
    let names = || Layer::ALL.into_iter().map(Layer::name);
    Layer::named(text).ok_or_else(|| {
        format!("expected one of {}{}", names().collect::<Vec<_>>().join(", "), did_you_mean(text, names()))
    })
}

#[cfg(feature = "simulator")]
fn speed_in_trial(text: &str) -> Result<f64, String> {
    let within = |mph: &f64| (5.0..=30.0).contains(mph);
    text.parse().ok().filter(within).ok_or_else(|| "expected 5 to 30 mph".to_owned())
}

/// `lapwing brake label`
#[derive(Debug, Args)]
pub struct BrakeLabel {
    /// Runs (.mcap), folders with driving_log.csv, or tables (.csv) with columns such as time_s, speed_kmh
    /// and brake
    #[arg(required = true, value_name = "RUN|DIR|CSV")]
    pub sources: Vec<PathBuf>,
    /// Write the labels of each source to a table in this folder, named after it
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Draw pedal, slope and label over time: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// How fast the pedal goes down in an emergency, in pedals per second [default: 1]
    #[arg(long, value_name = "PER_S", value_parser = above_zero, allow_negative_numbers = true)]
    pub threshold: Option<f64>,
    /// Print what was found as JSON
    #[arg(long)]
    pub json: bool,
}
