//! The command line, as clap types. `commands` does the work of each verb.

mod braking;
mod driving;
mod examples;
#[cfg(feature = "networks")]
mod learning;
#[cfg(feature = "simulator")]
mod marl;
#[cfg(feature = "networks")]
mod models;
mod parse;
mod program;
mod scoring;

use std::{ffi::OsString, path::PathBuf};

use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum, error::ErrorKind};

use lapwing_core::config::{GuardKind, OnCrash, SpeedLaw, Takeover};

pub use braking::*;
pub use driving::*;
#[cfg(feature = "networks")]
pub use learning::*;
#[cfg(feature = "simulator")]
pub use marl::*;
#[cfg(feature = "networks")]
pub use models::*;
use parse::{above_zero, number};
pub use program::*;
pub use scoring::*;

/// Drives, simulates, records, scores and replays the Udacity self-driving-car simulator.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100, after_help = examples::LAPWING)]
pub struct Cli {
    /// Settings file; it overrides your own ~/.config/lapwing/lapwing.toml [default: lapwing.toml in this folder, if it
    /// exists]
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
    #[command(after_help = examples::DRIVE)]
    Drive(Drive),
    /// Wait for simulators, drive their cars and record the runs
    #[cfg(feature = "bridge")]
    #[command(after_help = examples::SERVE)]
    Serve(Serve),
    /// Connect to a bridge as the Unity simulator does, or let the expert drive
    #[cfg(feature = "simulator")]
    #[command(after_help = examples::SIMULATE)]
    Simulate(Simulate),
    /// Record training data: the expert drives, and driving_log.csv and IMG/ are written
    #[cfg(feature = "simulator")]
    #[command(after_help = examples::RECORD)]
    Record(Record),
    /// Train a network on driving logs and runs
    #[cfg(all(feature = "networks", feature = "simulator"))]
    #[command(after_help = examples::TRAIN)]
    Train(Train),
    /// Measure a model's steering error on data sets
    #[cfg(feature = "networks")]
    #[command(after_help = examples::EVALUATE)]
    Evaluate(Evaluate),
    /// Draw which parts of a recorded picture a network's steering comes from
    #[cfg(feature = "networks")]
    #[command(after_help = examples::EXPLAIN)]
    Explain(Explain),
    /// Check a model's file, or make a checkpoint of PyTorch's tensors
    #[cfg(feature = "networks")]
    #[command(after_help = examples::MODEL)]
    Model(Model),
    /// Replay a recording to a model or a bridge and compare the steering, or drive along it
    #[cfg(feature = "networks")]
    #[command(after_help = examples::REPLAY)]
    Replay(Replay),
    /// Find out where a recording was driven, and where in its lane the car was in each picture
    #[cfg(feature = "simulator")]
    #[command(after_help = examples::LOCATE)]
    Locate(Locate),
    /// Score recorded runs, for people and for CI
    #[cfg(feature = "simulator")]
    #[command(after_help = examples::SCORE)]
    Score(Score),
    /// Emergency braking: label, record and try it, train networks and measure them
    #[command(after_help = examples::BRAKE)]
    Brake(Brake),
    /// Train, measure and watch four agents at an intersection
    #[cfg(feature = "simulator")]
    #[command(after_help = examples::MARL)]
    Marl(Marl),
    /// Compare pilots on many drives: all combinations of tracks, conditions, speeds and seeds
    #[cfg(all(feature = "networks", feature = "simulator"))]
    #[command(after_help = examples::SUITE)]
    Suite(Suite),
    /// Merge the results of a suite's parts
    #[cfg(all(feature = "networks", feature = "simulator"))]
    #[command(after_help = examples::MERGE)]
    Merge(Merge),
    /// Inspect, convert, split and preview data sets
    #[cfg(feature = "networks")]
    #[command(after_help = examples::DATASET)]
    Dataset(Dataset),
    /// Check the installation: libtorch, the model, the braking network, the port, the folder for runs, the last simulator
    #[cfg(feature = "bridge")]
    #[command(after_help = examples::DOCTOR)]
    Doctor(Doctor),
    /// Print all settings, and where each comes from
    #[command(after_help = examples::CONFIG)]
    Config(Config),
    /// Print a script that completes verbs and flags in a shell
    #[command(after_help = examples::COMPLETIONS)]
    Completions(Completions),
    /// Print the manual page
    #[command(after_help = examples::MAN)]
    Man(Man),
}

/// Which world; shared by all verbs that simulate one.
#[derive(Debug, Clone, Args)]
pub struct WorldFlags {
    /// lake, jungle, mountain, random:SEED, random-lanes:SEED, or a track file (.toml) [default: lake]
    #[arg(long, value_name = "NAME")]
    pub track: Option<String>,
    /// Random seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Light, weather and camera faults: a list such as rain=0.5,night=1,noise=4, random, or a file (.toml)
    #[arg(long, value_name = "LIST")]
    pub conditions: Option<String>,
    /// Other traffic: ccrs, ccrm, ccrb, cpna, cpfa, cpla, child, cbna, cbla (after Euro NCAP), gentle-stop, parked, turn-off,
    /// oncoming, steel-plate, pass-through, bystanders, or a scenario file (.toml); it brings its own set speed, which only --speed changes
    #[arg(long, value_name = "NAME")]
    pub scenario: Option<String>,
    /// Telemetries per second of simulated time [default: 15]
    #[arg(long, value_name = "HZ", value_parser = number)]
    pub hz: Option<f64>,
    /// After a crash: end the run (stop), or continue from the next waypoint (reset) [default: stop]
    #[arg(long, value_enum)]
    pub on_crash: Option<OnCrash>,
    /// Time limit of the run, in seconds of simulated time
    #[arg(long, value_name = "SECONDS", value_parser = above_zero)]
    pub max_time: Option<f64>,
}

/// Pictures for people.
#[derive(Debug, Args)]
pub struct PictureFlags {
    /// Write a film of the drive: FILE.mp4, FILE.gif, FILE.png or FILE.jpg (numbered pictures:
    /// FILE_00001.png), or a folder for such pictures
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// Where the camera of the film is
    #[arg(long, value_enum, default_value_t = FilmView::Follow, requires = "video")]
    pub view: FilmView,
    /// Draw a map of the track with the driven line: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
}

/// Where a film is taken from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FilmView {
    /// Behind the car
    Follow,
    /// Above it
    Top,
    /// The centre camera: what the pilot sees
    Car,
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

/// What drives and how; shared by all verbs that drive.
#[derive(Debug, Args)]
pub struct Driving {
    /// Checkpoint (.safetensors), ONNX (.onnx with a side .toml), or TorchScript (.pt with a side .toml), which is code: load
    /// only files that you trust [default: the built-in PilotNet]
    #[cfg(feature = "networks")]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    #[cfg(feature = "networks")]
    #[command(flatten)]
    pub trust: Trust,
    /// Target speed of the PI law, or limit of the quadratic law, in mph [default: 9]
    #[arg(long, value_name = "MPH", value_parser = number, allow_negative_numbers = true)]
    pub speed: Option<f64>,
    /// Throttle law: drive.py's PI controller, or 1 - steering^2 - (speed/limit)^2 [default: pi]
    #[arg(long, value_enum)]
    pub speed_law: Option<SpeedLaw>,
    /// After a takeover: drive on when the human lets go (resume), or wait for Enter or POST /arm (latch) [default:
    /// resume]
    #[arg(long, value_enum)]
    pub takeover: Option<Takeover>,
}

/// Who may brake in place of the pilot; shared by the verbs that drive a car which may hit something, and by `doctor`.
#[derive(Debug, Args)]
pub struct GuardFlags {
    /// A network that watches for what the car would hit and brakes in place of the pilot (.safetensors), as brake
    /// train writes it [default: none]
    #[cfg(feature = "networks")]
    #[arg(long, value_name = "FILE", conflicts_with = "brake_guard")]
    pub brake_model: Option<PathBuf>,
    /// The network's value from which on it brakes [default: the one in its file]
    #[cfg(feature = "networks")]
    #[arg(long, value_name = "VALUE", value_parser = above_zero, allow_negative_numbers = true)]
    pub brake_threshold: Option<f64>,
    /// Brake without a network, by the time to collision (ttc), which only Lapwing's own simulator with a scenario tells; or not
    /// at all, whatever the settings file says (none)
    #[arg(long, value_enum)]
    pub brake_guard: Option<GuardKind>,
}

/// Whose models are trusted; shared by all verbs for which a file may name a model.
#[derive(Debug, Args)]
pub struct Trust {
    /// Run the code of a TorchScript model (.pt) even if a file that others may have written names it:
    /// lapwing.toml, --config, a suite
    #[arg(long)]
    pub allow_torchscript: bool,
}

/// How fast the model thinks; shared by the verbs that need not give the same bytes everywhere.
#[derive(Debug, Args)]
pub struct Thinking {
    /// Threads for one forward pass [default: chosen for the network]
    #[arg(long)]
    pub threads: Option<u16>,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Verbs, and the verbs below them, with the examples behind their help.
    fn examples(command: &clap::Command, name: &str) -> Vec<(String, String)> {
        let own = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let below = command.get_subcommands().flat_map(|verb| examples(verb, &format!("{name} {}", verb.get_name())));
        std::iter::once((name.to_owned(), own)).chain(below).collect()
    }

    #[test]
    fn every_verb_has_examples_each_of_them_parses_and_the_files_that_they_name_are_here() {
        let all = examples(&Cli::command(), "lapwing");
        assert!(all.iter().any(|(verb, _)| verb == "lapwing model check"), "verbs below verbs count, too");
        let archive = include_str!("../../scripts/dist.py");
        for (verb, examples) in all {
            let examples = examples.replace("\\\n      ", ""); // continued lines are joined
            let lines: Vec<_> = examples.lines().filter(|line| line.starts_with("  lapwing ")).collect();
            assert!(!lines.is_empty(), "{verb} has no examples");
            for line in lines {
                // What stands behind three spaces is said, and what stands behind > or | is the shell's.
                let command = line.trim_start().split("   ").next().unwrap().split(['>', '|']).next().unwrap();
                let words = command.split_whitespace().map(OsString::from);
                if let Err(error) = Cli::read(words) {
                    panic!("{command}: {error}");
                }
                assert!(command.starts_with(&verb), "{verb}: {command}");
                let is_ours = |word: &&str| word.starts_with("models/") || word.starts_with("recordings");
                for file in command.split_whitespace().filter(is_ours) {
                    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
                    assert!(path.exists(), "{command}: {file} is not in this repository");
                    let packed = path.is_dir() || archive.contains(&format!("\"{file}\""));
                    assert!(packed, "{command}: {file} is not in the archive of a release (scripts/dist.py)");
                }
            }
        }
    }
}
