//! The command line, as clap types. What a verb does stands in `commands`.

use std::{ffi::OsString, path::PathBuf};

use clap::{
    Arg, ArgGroup, ArgMatches, Args, Command, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum,
    builder::ValueParser, error::ErrorKind,
};
use serde::Serialize;

use lapwing_core::{
    config::{self, LimitUnit, OnCrash, SpeedLaw, Takeover, Threshold},
    protocol::number::Culture,
    replay::Rate,
};
#[cfg(feature = "networks")]
use lapwing_learn::{
    evaluate::Rows,
    nn::Precision,
    train::{Keep, OptimiserKind, Schedule},
};
use lapwing_score::suite::Shard;
#[cfg(feature = "simulator")]
use lapwing_sim::along::DEFAULT_LIMIT_M;

/// Connects, drives, records and replays the Udacity self-driving-car simulator.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100)]
pub struct Cli {
    /// Settings file, which overrides your own ~/.config/lapwing/lapwing.toml [default: lapwing.toml of this folder, if
    /// there is one]
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Drive the headless simulator and print the scorecard
    #[cfg(feature = "simulator")]
    Drive(Drive),
    /// Wait for simulators, drive them and record the runs
    #[cfg(feature = "bridge")]
    Serve(Serve),
    /// Be a simulator: dial a bridge as the Unity build does, or let the expert drive
    #[cfg(feature = "simulator")]
    Simulate(Simulate),
    /// Let the expert drive and write what the stock recorder would: driving_log.csv and IMG/
    #[cfg(feature = "simulator")]
    Record(Record),
    /// Train a network on driving logs and runs
    #[cfg(all(feature = "networks", feature = "simulator"))]
    Train(Train),
    /// Say how far a model's steering lies from that of data sets
    #[cfg(feature = "networks")]
    Evaluate(Evaluate),
    /// Show a recording to a model, or to any bridge, and compare the steering; or drive along it
    #[cfg(feature = "networks")]
    Replay(Replay),
    /// Say what recorded runs were worth, for people and for CI
    #[cfg(feature = "simulator")]
    Score(Score),
    /// Drive pilots x tracks x conditions x seeds over all cores, and compare them
    #[cfg(all(feature = "networks", feature = "simulator"))]
    Suite(Suite),
    /// Put the results of a suite's parts together
    #[cfg(all(feature = "networks", feature = "simulator"))]
    Merge(Merge),
    /// Look over, convert and split recordings as data sets
    #[cfg(feature = "networks")]
    Dataset(Dataset),
    /// Say which libtorch is in use, and what is wrong if anything
    #[cfg(feature = "bridge")]
    Doctor(Doctor),
}

/// Which world; shared by all verbs that simulate one.
#[derive(Debug, Clone, Args)]
pub struct World {
    /// lake, jungle, mountain, random:SEED, or a track file (.toml) [default: lake]
    #[arg(long, value_name = "NAME")]
    pub track: Option<String>,
    /// Seed of everything random
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Light, weather, camera: rain=0.5,night=1,noise=4 …; random; or a file (.toml)
    #[arg(long, value_name = "LIST")]
    pub conditions: Option<String>,
    /// Other traffic: ccrs, ccrm, ccrb, cpna, child, or a scenario file (.toml)
    #[arg(long, value_name = "NAME")]
    pub scenario: Option<String>,
    /// Telemetries a second of the simulated time [default: 15]
    #[arg(long, value_name = "HZ")]
    pub hz: Option<f64>,
    /// After a crash: end the run, or go on from the next waypoint [default: stop]
    #[arg(long, value_enum)]
    pub on_crash: Option<OnCrash>,
    /// End the run after so much simulated time, in seconds
    #[arg(long, value_name = "SECONDS", value_parser = above_zero)]
    pub max_time: Option<f64>,
}

/// Pictures for people.
#[derive(Debug, Args)]
pub struct Pictures {
    /// Film of the drive: FILE.mp4, FILE.gif, or a folder for single pictures
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// Where the film is taken from
    #[arg(long, value_enum, default_value_t = FilmView::Follow, requires = "video")]
    pub view: FilmView,
    /// Map of the track with the driven line: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
}

/// Where a film is taken from.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum FilmView {
    /// Behind the car
    Follow,
    /// Above it
    Top,
    /// The centre camera, what the pilot sees
    Car,
}

/// `lapwing drive`
#[derive(Debug, Args)]
pub struct Drive {
    #[command(flatten)]
    pub world: World,
    /// Laps after which the run ends [default: 1, without a scenario]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub laps: Option<u32>,
    /// Who steers: the model, or the expert, who knows the road
    #[arg(long, value_enum, default_value_t)]
    pub pilot: PilotKind,
    #[command(flatten)]
    pub driving: Driving,
    /// Tell the pilot and the run only what the stock build reports
    #[arg(long)]
    pub stock: bool,
    #[command(flatten)]
    pub pictures: Pictures,
    #[command(flatten)]
    pub thresholds: Thresholds,
    /// Folder for the run [default: recordings]
    #[arg(long, value_name = "DIR", conflicts_with = "no_recording")]
    pub recordings: Option<PathBuf>,
    /// Record nothing
    #[arg(long)]
    pub no_recording: bool,
    /// Print the scorecard as JSON
    #[arg(long)]
    pub json: bool,
}

/// Who steers.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PilotKind {
    #[cfg(feature = "networks")]
    #[default]
    Model,
    #[cfg_attr(not(feature = "networks"), default)]
    Expert,
}

/// What a run must reach, or the exit status is 3: a flag for each of [`config::Thresholds::ALL`]. They stand over
/// `[thresholds]` of the settings.
#[derive(Debug, Default)]
pub struct Thresholds(pub Vec<(Threshold, Limit)>);

/// A threshold's number, as its setting has it.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(untagged)]
pub enum Limit {
    Count(u32),
    Number(f64),
}

impl Args for Thresholds {
    fn augment_args(command: Command) -> Command {
        let flag = |threshold: Threshold| {
            let parser = match threshold.unit {
                LimitUnit::Count => ValueParser::new(|text: &str| text.parse().map(Limit::Count)),
                _ => ValueParser::new(|text: &str| text.parse().map(Limit::Number)),
            };
            let flag = Arg::new(threshold.key).long(threshold.flag()).value_name(threshold.unit.placeholder());
            flag.help(threshold.help).value_parser(parser)
        };
        command.args(config::Thresholds::ALL.map(flag))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Thresholds {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = |threshold: Threshold| Some((threshold, *matches.get_one(threshold.key)?));
        Ok(Self(config::Thresholds::ALL.into_iter().filter_map(given).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Cli {
    /// Parses the program's arguments, of which the first is its own name. They must be Unicode: anything else would
    /// appear altered in runs and reports.
    ///
    /// # Errors
    /// Clap's: wrong usage, or what was asked for with `--help` and `--version`.
    pub fn read(arguments: impl Iterator<Item = OsString>) -> Result<Self, clap::Error> {
        let text = |argument: OsString| {
            let wrong = |got| Self::command().error(ErrorKind::InvalidUtf8, format!("expected UTF-8, got {got:?}"));
            argument.into_string().map_err(wrong)
        };
        let arguments: Vec<_> = arguments.skip(1).map(text).collect::<Result<_, _>>()?;
        Self::try_parse_from(std::iter::once("lapwing".to_owned()).chain(arguments))
    }
}

/// `lapwing score`
#[derive(Debug, Args)]
pub struct Score {
    /// Runs (.mcap), Udacity folders (driving_log.csv), or folders of runs
    #[arg(value_name = "RUN", required_unless_present = "explain")]
    pub runs: Vec<PathBuf>,
    /// Another road that a run which tells no position may be on: random:SEED, or a track file (.toml)
    #[arg(long = "track", value_name = "NAME")]
    pub tracks: Vec<String>,
    /// Laps asked for, where the run does not say
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub laps: u32,
    #[command(flatten)]
    pub thresholds: Thresholds,
    /// An earlier result (--json): exit status 3 if a figure got worse beyond noise
    #[arg(long, value_name = "FILE")]
    pub against: Option<PathBuf>,
    /// Write the thresholds as test cases of a JUnit report
    #[arg(long, value_name = "FILE")]
    pub junit: Option<PathBuf>,
    /// Write the runs side by side as one page for a browser
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Print the scorecards as JSON
    #[arg(long)]
    pub json: bool,
    /// Print what each figure means, and after whom
    #[arg(long, exclusive = true)]
    pub explain: bool,
}

/// `lapwing suite`
#[derive(Debug, Args)]
pub struct Suite {
    /// What is driven (.toml); TorchScript models (.pt) that it names, which are code, need --allow-torchscript
    #[arg(value_name = "FILE")]
    pub suite: PathBuf,
    #[command(flatten)]
    pub trust: Trust,
    /// Folder for the results; what lies there is not driven again
    #[arg(long, value_name = "DIR", default_value = "suite")]
    pub out: PathBuf,
    /// Drive one part of so many only, such as 2/8; merge puts them together
    #[arg(long, value_name = "PART/OF")]
    pub shard: Option<Shard>,
    /// Drives at a time [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: Option<u16>,
    /// Heat map for a browser [default: suite.html in the folder]
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Print the groups as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing merge`
#[derive(Debug, Args)]
pub struct Merge {
    /// Folders of a suite's parts
    #[arg(value_name = "DIR", required = true)]
    pub folders: Vec<PathBuf>,
    /// Folder for all of them
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Heat map for a browser [default: suite.html in the folder]
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Print the groups as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing simulate`
#[derive(Debug, Args)]
pub struct Simulate {
    #[command(flatten)]
    pub world: World,
    /// Laps after which the run ends [default: 1, without a scenario]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub laps: Option<u32>,
    /// Dial this bridge, drive.py included; the port is 4567 by default. Without this flag the expert drives
    #[arg(long, value_name = "HOST[:PORT]")]
    pub connect: Option<String>,
    /// Culture in which numbers are written and read
    #[arg(long, value_name = "NAME", default_value = "en-US", value_parser = culture, requires = "connect")]
    pub culture: Culture,
    /// Send only what the stock build sends, not SelfOracle's ground truth
    #[arg(long, requires = "connect")]
    pub stock: bool,
    /// Keep step with the clock on the wall; otherwise as fast as the bridge answers
    #[arg(long)]
    pub realtime: bool,
    /// A human takes the wheel at this time of the run, in seconds
    #[arg(long, value_name = "SECONDS", requires = "human_for", value_parser = not_negative)]
    pub human_from: Option<f64>,
    /// And holds it for so long, in seconds
    #[arg(long, value_name = "SECONDS", requires = "human_from", value_parser = above_zero)]
    pub human_for: Option<f64>,
    /// Speed of the expert and of the human, in mph
    #[arg(long, value_name = "MPH", default_value_t = 20.0, value_parser = above_zero)]
    pub speed: f64,
    #[command(flatten)]
    pub pictures: Pictures,
    #[command(flatten)]
    pub thresholds: Thresholds,
    /// Print the scorecard as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing record`
#[derive(Debug, Args)]
pub struct Record {
    #[command(flatten)]
    pub world: World,
    /// Laps to drive
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub laps: u32,
    /// Folder to make, for driving_log.csv and IMG/
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Speed, in mph; bends are taken as slowly as they must be
    #[arg(long, value_name = "MPH", default_value_t = 20.0, value_parser = above_zero)]
    pub speed: f64,
    /// Mix in disturbed starts and steering noise; the expert's correction is the label
    #[arg(long)]
    pub recovery: bool,
}

/// `lapwing train`
#[cfg(feature = "networks")]
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
#[cfg(feature = "networks")]
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

#[cfg(feature = "networks")]
fn rows_and_columns(text: &str) -> Result<(usize, usize), String> {
    let parsed = text.split_once('x').and_then(|(rows, columns)| Some((rows.parse().ok()?, columns.parse().ok()?)));
    parsed.ok_or_else(|| "expected rows x columns, such as 80x160".into())
}

/// A word as settings files have it.
#[cfg(feature = "networks")]
fn word<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(text.into()).map_err(|why| why.to_string())
}

/// `lapwing serve`
#[derive(Debug, Args)]
pub struct Serve {
    #[command(flatten)]
    pub driving: Driving,
    #[command(flatten)]
    pub thinking: Thinking,
    /// Address to listen on; 0.0.0.0 for simulators on other machines [default: 127.0.0.1]
    #[arg(long, value_name = "ADDRESS")]
    pub bind: Option<String>,
    /// Port to listen on; the simulator connects only to port 4567 [default: 4567]
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
    /// Checkpoint (.safetensors), or TorchScript (.pt with a side .toml), whose code runs: load only files that you
    /// trust [default: the PilotNet built in]
    #[cfg(feature = "networks")]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    #[cfg(feature = "networks")]
    #[command(flatten)]
    pub trust: Trust,
    /// Set speed of the PI law, limit of the quadratic one, in mph [default: 9]
    #[arg(long, value_name = "MPH", allow_negative_numbers = true)]
    pub speed: Option<f64>,
    /// How throttle is made: drive.py's PI controller, or 1 - steering^2 - (speed/limit)^2 [default: pi]
    #[arg(long, value_enum)]
    pub speed_law: Option<SpeedLaw>,
    /// After a human lets go: drive on, or stay off until armed (Enter, or POST /arm) [default: resume]
    #[arg(long, value_enum)]
    pub takeover: Option<Takeover>,
}

/// Whose models are trusted; shared by all verbs for which a file may name a model.
#[derive(Debug, Args)]
pub struct Trust {
    /// Run the code of a TorchScript model (.pt) even if it is named by a file that others may have written:
    /// lapwing.toml, --config, a suite
    #[arg(long)]
    pub allow_torchscript: bool,
}

/// How fast the model thinks; shared by the verbs that need not give the same bytes everywhere.
#[derive(Debug, Args)]
pub struct Thinking {
    /// Threads for one forward pass [default: what serves the network best]
    #[arg(long)]
    pub threads: Option<u16>,
}

/// `lapwing replay`
#[cfg(feature = "networks")]
#[derive(Debug, Args)]
pub struct Replay {
    /// A run (.mcap), or a folder with driving_log.csv and IMG/
    pub source: PathBuf,
    #[command(flatten)]
    pub driving: Driving,
    #[command(flatten)]
    pub thinking: Thinking,
    /// Play the recording to a bridge as the Unity build would, instead of driving in process
    #[arg(long, value_name = "HOST[:PORT]", conflicts_with_all = ["model", "speed", "speed_law", "takeover", "threads"])]
    pub connect: Option<String>,
    /// Drive along the recording: a virtual car steers, and sees the recorded pictures from where it is
    #[cfg(feature = "simulator")]
    #[arg(long, conflicts_with_all = ["connect", "rate", "golden", "write_golden", "threads"])]
    pub closed_loop: bool,
    /// How far beside the recorded path the virtual car may be before it is put back, in metres
    #[cfg(feature = "simulator")]
    #[arg(long, value_name = "METRES", default_value_t = DEFAULT_LIMIT_M, value_parser = above_zero, requires = "closed_loop")]
    pub limit: f64,
    /// Take the recorded car's turning from recorded steering and speed alone, not from the pictures
    #[cfg(feature = "simulator")]
    #[arg(long, requires = "closed_loop")]
    pub by_steering: bool,
    /// Film of what the pilot sees: FILE.mp4, FILE.gif, or a folder for single pictures
    #[cfg(feature = "simulator")]
    #[arg(long, value_name = "FILE", requires = "closed_loop")]
    pub film: Option<PathBuf>,
    /// Record the closed loop as a run in this folder
    #[cfg(feature = "simulator")]
    #[arg(long, value_name = "DIR", requires = "closed_loop")]
    pub recordings: Option<PathBuf>,
    #[command(flatten)]
    pub thresholds: Thresholds,
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
    /// Do not fail if more than 1 % of the frames are bad (seen by no network, counted in no figure)
    #[arg(long)]
    pub allow_bad_frames: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

fn culture(name: &str) -> Result<Culture, String> {
    let known = || Culture::ALL.map(|c| c.name).join(", ");
    Culture::named(name).ok_or_else(|| format!("expected one of {}", known()))
}

fn above_zero(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|x: &f64| x.is_finite() && *x > 0.0);
    number.ok_or_else(|| "expected a number above 0".into())
}

fn not_negative(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|x: &f64| x.is_finite() && *x >= 0.0);
    number.ok_or_else(|| "expected a number of at least 0".into())
}

#[cfg(feature = "networks")]
fn tolerance(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|t| *t >= 0.0).ok_or_else(|| "expected a number of at least 0".into())
}

/// `lapwing doctor`
#[derive(Debug, Args)]
pub struct Doctor {
    #[command(flatten)]
    pub driving: Driving,
    #[command(flatten)]
    pub thinking: Thinking,
    /// Print the findings as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing dataset`
#[cfg(feature = "networks")]
#[derive(Debug, Args)]
pub struct Dataset {
    #[command(subcommand)]
    pub verb: DatasetVerb,
}

/// What to do with data sets.
#[cfg(feature = "networks")]
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
#[cfg(feature = "networks")]
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
#[cfg(feature = "networks")]
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
#[cfg(feature = "networks")]
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
#[cfg(feature = "networks")]
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
