//! The verbs that score drives, and the thresholds that a drive may be held to.

use std::path::PathBuf;

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches, builder::ValueParser};
use serde::Serialize;

use super::{
    Trust,
    parse::{count, number},
};
use lapwing_core::config::{self, LimitUnit, Threshold};
use lapwing_score::suite::{Keep, Shard};

/// What a run must reach, or the exit status is 3: a flag for each of [`config::Thresholds::ALL`]. They stand over
/// `[thresholds]` of the settings.
#[derive(Debug, Default)]
pub struct ThresholdFlags(pub Vec<(Threshold, Limit)>);

/// A threshold's number, as its setting has it.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(untagged)]
pub enum Limit {
    Count(u32),
    Number(f64),
}

impl Args for ThresholdFlags {
    fn augment_args(command: Command) -> Command {
        let flag = |threshold: Threshold| {
            let parser = match threshold.unit {
                LimitUnit::Count => ValueParser::new(|text: &str| count(text).map(Limit::Count)),
                _ => ValueParser::new(|text: &str| number(text).map(Limit::Number)),
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

impl FromArgMatches for ThresholdFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = |threshold: Threshold| Some((threshold, *matches.get_one(threshold.key)?));
        Ok(Self(config::Thresholds::ALL.into_iter().filter_map(given).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// `lapwing locate`
#[derive(Debug, Args)]
pub struct Locate {
    /// A run (.mcap), or a folder with driving_log.csv and IMG/
    pub recording: PathBuf,
    /// Another road that it may have been driven on: random:SEED, random-lanes:SEED, or a track file (.toml); may be repeated
    #[arg(long = "track", value_name = "NAME")]
    pub tracks: Vec<String>,
    /// A network that says where in its lane the camera is (lane, .safetensors); its answers are compared with the drawn road
    #[cfg(feature = "networks")]
    #[arg(long, value_name = "FILE")]
    pub network: Option<PathBuf>,
    /// Where the car was in each moment of this recording, as lapwing record writes it: errors are told against it
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Locate the side cameras' pictures, too, each by itself, and compare where they come out with where they sit on the car
    #[arg(long)]
    pub sides: bool,
    /// Write a row for each picture: place, offset from the lane's middle, heading, how sure they are
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Draw the lane into pictures from all over the recording: FILE.png or FILE.svg
    #[arg(long, value_name = "FILE")]
    pub frames: Option<PathBuf>,
    /// Draw the offset from the lane's middle along the road, lap by lap: FILE.svg or FILE.png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `lapwing score`
#[derive(Debug, Args)]
pub struct Score {
    /// Runs (.mcap), Udacity folders (driving_log.csv), or folders of runs
    #[arg(value_name = "RUN", required_unless_present = "explain")]
    pub runs: Vec<PathBuf>,
    /// Another road that runs without a position may have been driven on, and that maps show: random:SEED, random-lanes:SEED,
    /// or a track file (.toml); may be repeated
    #[arg(long = "track", value_name = "NAME")]
    pub tracks: Vec<String>,
    /// Laps asked for, if the run does not say
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub laps: u32,
    #[command(flatten)]
    pub thresholds: ThresholdFlags,
    /// Compare with an earlier result (--json): exit status 3 if a figure got worse beyond noise
    #[arg(long, value_name = "FILE")]
    pub against: Option<PathBuf>,
    /// Write the thresholds as test cases of a JUnit report
    #[arg(long, value_name = "FILE")]
    pub junit: Option<PathBuf>,
    /// Write a page for a browser that shows the runs side by side
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Write a summary in Markdown for a CI job or a pull request, with each run's map and worst moment as pictures beside it;
    /// without =FILE print it, without pictures
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, conflicts_with = "json")]
    pub markdown: Option<Option<PathBuf>>,
    /// Address under which the pictures of --markdown will be found [default: beside it]
    #[arg(long, value_name = "URL", requires = "markdown")]
    pub pictures_at: Option<String>,
    /// Print the scorecards as JSON
    #[arg(long)]
    pub json: bool,
    /// Print what each figure means, and its source; with RUN, how well each known road explains a run without positions
    #[arg(long, conflicts_with = "json")]
    pub explain: bool,
}

/// `lapwing suite`
#[derive(Debug, Args)]
pub struct Suite {
    /// Suite file (.toml); TorchScript models (.pt) that it names are code and need --allow-torchscript
    #[arg(value_name = "FILE")]
    pub suite: PathBuf,
    #[command(flatten)]
    pub trust: Trust,
    /// Folder for the results; drives whose results are already there are not repeated
    #[arg(long, value_name = "DIR", default_value = "suite")]
    pub out: PathBuf,
    /// Drive only one part, such as 2/8 for the second of eight; merge combines the parts
    #[arg(long, value_name = "PART/OF")]
    pub shard: Option<Shard>,
    /// Number of drives at a time [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: Option<u16>,
    /// Drives whose run is kept, with a report, in the folder's runs
    #[arg(long, value_enum, value_name = "WHICH", default_value_t = Keep::Failed)]
    pub keep_runs: Keep,
    /// Write the heat map for a browser to this file [default: suite.html in the folder]
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
    /// Folder for the merged results
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write the heat map for a browser to this file [default: suite.html in the folder]
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Print the groups as JSON
    #[arg(long)]
    pub json: bool,
}
