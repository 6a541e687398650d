//! The verbs that drive, or play the simulator.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

#[cfg(all(feature = "networks", feature = "simulator"))]
use super::parse::range;
use super::{
    Driving, GuardFlags, PictureFlags, Thinking, ThresholdFlags, WorldFlags,
    parse::{above_zero, culture, not_negative},
};
use lapwing_core::{protocol::number::Culture, replay::Rate};
#[cfg(feature = "simulator")]
use lapwing_sim::along::{Limit, Protocol};

/// `lapwing drive`
#[derive(Debug, Args)]
pub struct Drive {
    #[command(flatten)]
    pub world: WorldFlags,
    /// Drive where these recordings were driven, with their pictures in place of drawn ones: runs, or folders of the
    /// training mode. They must be of a track that comes with Lapwing, or of --track
    #[arg(long = "world", value_name = "RECORDING", num_args = 1.., conflicts_with = "scenario")]
    pub recorded: Vec<PathBuf>,
    /// Where in its lane the car was in each picture, as locate --csv writes it, one file for each --world, which is then not
    /// located again
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "recorded")]
    pub lane: Vec<PathBuf>,
    /// Number of laps after which the run ends [default: 1, or no limit with a scenario]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub laps: Option<u32>,
    /// Who steers: the model, or the expert, which knows the road
    #[arg(long, value_enum, default_value_t)]
    pub pilot: PilotKind,
    #[command(flatten)]
    pub driving: Driving,
    #[command(flatten)]
    pub guard: GuardFlags,
    /// Give the pilot only what the stock build sends, and record only that
    #[arg(long)]
    pub stock: bool,
    #[command(flatten)]
    pub pictures: PictureFlags,
    #[command(flatten)]
    pub thresholds: ThresholdFlags,
    /// Folder for the run, which is then recorded whatever the settings say [default: recordings]
    #[arg(long, value_name = "DIR", conflicts_with = "no_recording")]
    pub recordings: Option<PathBuf>,
    /// Record nothing
    #[arg(long)]
    pub no_recording: bool,
    /// Print the scorecard as JSON
    #[arg(long)]
    pub json: bool,
    #[cfg(feature = "bridge")]
    #[command(flatten)]
    pub page: PageFlags,
    /// Drive in real time, shown to Foxglove and Lichtblick at this port [default port: 8765]
    #[cfg(feature = "bridge")]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    pub foxglove: Option<u16>,
}

/// A page that shows and controls the headless simulator.
#[cfg(feature = "bridge")]
#[derive(Debug, Default, Args)]
pub struct PageFlags {
    /// Drive in real time, shown on and controlled from a page in the browser at this port [default port: 4568]; until Ctrl-C,
    /// unless --laps or --max-time is given
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "4568")]
    pub page: Option<u16>,
    /// Address that the page listens on; 0.0.0.0 lets other machines connect, using the token that is printed [default: 127.0.0.1]
    #[arg(long, value_name = "ADDRESS", requires = "page")]
    pub bind: Option<String>,
    /// Another model to switch to or to compare runs with on the page, or a folder of models; may be given several times
    #[arg(long, value_name = "FILE", requires = "page")]
    pub also_model: Vec<PathBuf>,
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

/// `lapwing simulate`
#[derive(Debug, Args)]
pub struct Simulate {
    #[command(flatten)]
    pub world: WorldFlags,
    /// Number of laps after which the run ends [default: 1, or no limit with a scenario]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub laps: Option<u32>,
    /// Connect to this bridge, drive.py included; the default port is 4567. Without this flag the expert drives
    #[arg(long, value_name = "HOST[:PORT]")]
    pub connect: Option<String>,
    /// Culture (language) whose number format is written and read
    #[arg(long, value_name = "NAME", default_value = "en-US", value_parser = culture, requires = "connect")]
    pub culture: Culture,
    /// Send only what the stock build sends, not SelfOracle's ground truth
    #[arg(long, requires = "connect")]
    pub stock: bool,
    /// Run in real time; otherwise as fast as the bridge answers
    #[arg(long)]
    pub realtime: bool,
    /// A human takes over at this time of the run, in seconds
    #[arg(long, value_name = "SECONDS", requires = "human_for", value_parser = not_negative)]
    pub human_from: Option<f64>,
    /// How long the human drives, in seconds
    #[arg(long, value_name = "SECONDS", requires = "human_from", value_parser = above_zero)]
    pub human_for: Option<f64>,
    /// Speed of the expert and of the human, in mph
    #[arg(long, value_name = "MPH", default_value_t = 20.0, value_parser = above_zero)]
    pub speed: f64,
    #[command(flatten)]
    pub pictures: PictureFlags,
    #[command(flatten)]
    pub thresholds: ThresholdFlags,
    /// Print the scorecard as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing record`
#[derive(Debug, Args)]
pub struct Record {
    #[command(flatten)]
    pub world: WorldFlags,
    /// Number of laps to drive; recording fewer is a failure, unless only --max-time is given and its time runs out [default: 1]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    #[cfg_attr(feature = "bridge", arg(conflicts_with = "page"))]
    pub laps: Option<u32>,
    /// New folder for driving_log.csv and IMG/
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Speed, in mph; slower in bends where needed
    #[arg(long, value_name = "MPH", default_value_t = 20.0, value_parser = above_zero)]
    pub speed: f64,
    /// Move the car off the line now and then, disturb its steering, and record how the expert corrects it
    #[arg(long)]
    #[cfg_attr(feature = "bridge", arg(conflicts_with = "page"))]
    pub recovery: bool,
    /// Instead of a drive, take this many pictures of a car that stands anywhere on the road and anyhow; with
    /// --conditions random, in many weathers
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), conflicts_with_all = ["laps", "speed", "recovery", "scenario", "max_time"])]
    #[cfg_attr(feature = "bridge", arg(conflicts_with = "page"))]
    pub stances: Option<u64>,
    #[cfg(feature = "bridge")]
    #[command(flatten)]
    pub page: PageFlags,
}

/// Where the bridge listens, and where its runs go; shared by `serve` and `doctor`.
#[derive(Debug, Args)]
pub struct ServerFlags {
    /// Address that serve listens on; 0.0.0.0 lets other machines connect, which a tunnel does not need [default: 127.0.0.1]
    #[arg(long, value_name = "ADDRESS")]
    pub bind: Option<String>,
    /// Port that serve listens on; the simulator connects only to port 4567 [default: 4567]
    #[arg(long)]
    pub port: Option<u16>,
    /// Folder where serve saves its runs, whatever the settings say [default: recordings]
    #[arg(long, value_name = "DIR")]
    pub recordings: Option<PathBuf>,
}

/// `lapwing serve`
#[derive(Debug, Args)]
pub struct Serve {
    #[command(flatten)]
    pub driving: Driving,
    #[command(flatten)]
    pub guard: GuardFlags,
    #[command(flatten)]
    pub thinking: Thinking,
    #[command(flatten)]
    pub server: ServerFlags,
    /// Another model to switch to or to compare runs with on the page, or a folder of models; may be given several times
    #[arg(long, value_name = "FILE")]
    pub also_model: Vec<PathBuf>,
    /// Show the drives to Foxglove and Lichtblick at this port [default port: 8765]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    pub foxglove: Option<u16>,
    /// Event to send to each simulator when it connects, in JSON: '["reset",{}]'; may be given several times
    #[arg(long, value_name = "EVENT")]
    pub greet: Vec<String>,
    /// Record nothing
    #[arg(long, conflicts_with = "recordings")]
    pub no_recording: bool,
    /// Print the summary of each drive as one line of JSON
    #[arg(long)]
    pub json: bool,
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
    /// Send the recording to a bridge as the Unity build would, instead of driving in this process
    #[arg(long, value_name = "HOST[:PORT]", conflicts_with_all = ["model", "speed", "speed_law", "takeover", "threads"])]
    pub connect: Option<String>,
    /// Drive along the recording: the pilot steers a virtual car and sees the recorded pictures from its position
    #[cfg(feature = "simulator")]
    #[arg(long, conflicts_with_all = ["connect", "rate", "golden", "write_golden", "threads", "speed", "speed_law", "takeover"])]
    pub closed_loop: bool,
    /// Another road that the recording may have been driven on: random:SEED, random-lanes:SEED, or a track file (.toml)
    #[cfg(feature = "simulator")]
    #[arg(long = "track", value_name = "NAME", requires = "closed_loop", conflicts_with = "from_path")]
    pub tracks: Vec<String>,
    /// Measure from the recorded path alone: its pictures are not located, which takes most of the time
    #[cfg(feature = "simulator")]
    #[arg(long, requires = "closed_loop")]
    pub from_path: bool,
    /// Drive along these rows with a picture alone, counted from 0, up to but without the last: such as those that a model was
    /// not trained on [default: all]
    #[cfg(feature = "simulator")]
    #[arg(long, value_name = "FIRST..END", requires = "closed_loop", value_parser = range)]
    pub rows: Option<std::ops::Range<usize>>,
    /// Where in its lane the car was in each picture, as locate --csv writes it: they are not located again
    #[cfg(feature = "simulator")]
    #[arg(long, value_name = "FILE", requires = "closed_loop", conflicts_with = "from_path")]
    pub lane: Option<PathBuf>,
    /// Where the virtual car is put back: at the road's edge, or so many metres from the lane's middle, or from the recorded
    /// path where the lane is not known [default: road if the lane is known along most of the way, otherwise 1]
    #[cfg(feature = "simulator")]
    #[arg(long, value_name = "road|METRES", requires = "closed_loop", allow_negative_numbers = true)]
    pub limit: Option<Limit>,
    /// How the drive goes on after an intervention; rally-estonia has a limit of 1 or 2 m [default: 2]
    #[cfg(feature = "simulator")]
    #[arg(long, value_enum, default_value_t, requires = "closed_loop")]
    pub protocol: ProtocolKind,
    /// Derive the recorded car's turning from recorded steering and speed alone, not from its lane or the pictures
    #[cfg(feature = "simulator")]
    #[arg(long, requires = "closed_loop")]
    pub by_steering: bool,
    /// Write a film of what the pilot sees: FILE.mp4, FILE.gif, FILE.png or FILE.jpg (numbered pictures:
    /// FILE_00001.png), or a folder for such pictures
    #[cfg(feature = "simulator")]
    #[arg(long, value_name = "FILE", requires = "closed_loop")]
    pub film: Option<PathBuf>,
    /// Record the closed loop as a run in this folder
    #[cfg(feature = "simulator")]
    #[arg(long, value_name = "DIR", requires = "closed_loop")]
    pub recordings: Option<PathBuf>,
    #[command(flatten)]
    pub thresholds: ThresholdFlags,
    /// Culture (language) whose number format the simulator writes, with --connect
    #[arg(long, value_name = "NAME", default_value = "en-US", value_parser = culture, requires = "connect")]
    pub culture: Culture,
    /// Speed: as recorded (real), as fast as possible (max), or frames per second
    #[arg(long, value_name = "real|max|HZ", default_value = "max")]
    pub rate: Rate,
    /// Compare each command with a stored replay; exit status 1 if any differs
    #[arg(long, value_name = "FILE")]
    pub golden: Option<PathBuf>,
    /// Store this replay for --golden
    #[arg(long, value_name = "FILE", conflicts_with = "golden")]
    pub write_golden: Option<PathBuf>,
    /// Largest difference in steering and throttle that --golden accepts
    #[arg(long, default_value_t = 1e-3, value_parser = not_negative, allow_negative_numbers = true, requires = "golden")]
    pub tolerance: f64,
    /// Do not fail if more than 1 % of the frames are bad (not seen by the network, not counted in any figure)
    #[arg(long)]
    pub allow_bad_frames: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// How a drive along a recording goes on after an intervention.
#[cfg(feature = "simulator")]
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProtocolKind {
    /// At once and at the same place: NVIDIA's test of DAVE-2 (Bojarski et al. 2016)
    #[default]
    Dave2,
    /// Two seconds further on: the Rally Estonia study (Tampuu et al. 2022)
    RallyEstonia,
}

#[cfg(feature = "simulator")]
impl From<ProtocolKind> for Protocol {
    fn from(kind: ProtocolKind) -> Self {
        match kind {
            ProtocolKind::Dave2 => Self::Dave2,
            ProtocolKind::RallyEstonia => Self::RallyEstonia,
        }
    }
}

/// `lapwing doctor`
#[derive(Debug, Args)]
pub struct Doctor {
    #[command(flatten)]
    pub driving: Driving,
    #[command(flatten)]
    pub guard: GuardFlags,
    #[command(flatten)]
    pub thinking: Thinking,
    #[command(flatten)]
    pub server: ServerFlags,
    /// Print the findings as JSON
    #[arg(long)]
    pub json: bool,
}
