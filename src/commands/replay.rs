//! `lapwing replay`: show a recording to a model or a bridge.

use std::{
    io::{self, IsTerminal},
    path::Path,
    time::{Duration, Instant},
};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::{Ended, outputs};
use crate::cli;
use lapwing_core::{
    client::{self, ClientOptions},
    config::{ConfigError, Settings},
    drive::{self, Observer, ObserverError},
    driver::Driver,
    replay::{Answered, Answers, Difference, ForBridge, Golden, GoldenError, MOST_BAD_FRAMES, Machine, Replay, Report},
    turn::Turn,
};
use lapwing_learn::nn::runtime;
use lapwing_score::score::Scorecard;

/// Differing frames that are named one by one.
const NAMED: usize = 10;

#[derive(Serialize)]
struct Result_<'a> {
    #[serde(flatten)]
    report: &'a Report,
    card: Scorecard,
    #[serde(skip_serializing_if = "Option::is_none")]
    golden: Option<Comparison>,
}

#[derive(Serialize)]
struct Comparison {
    tolerance: f64,
    differing_frames: usize,
    first: Vec<Difference>,
    /// Where the stored replay was written and where this one ran; absent where it is not told.
    written_on: Option<Machine>,
    compared_on: Option<Machine>,
}

pub(super) fn run(arguments: cli::Replay, config: Option<&Path>) -> anyhow::Result<Ended> {
    if let Some((threshold, _)) = arguments.thresholds.0.first() {
        // What is only answered, and not driven, has no such figures.
        return Err(ConfigError::Value {
            layer: format!("--{}", threshold.flag()),
            why: "requires --closed-loop: without it nothing is driven".into(),
        }
        .into());
    }
    let settings = super::thinking_layers(config, &arguments.driving, &arguments.thinking)?.resolve()?;
    // Read before the work is done, so that a wrong file does not cost a whole replay.
    let golden = arguments.golden.as_deref().map(Golden::read).transpose()?;
    arguments.write_golden.as_deref().map_or(Ok(()), outputs::check)?;
    let connect = arguments.connect.as_deref().map(super::bridge_address).transpose()?;
    let replay = Replay::open(&arguments.source, arguments.rate)?;
    let Asked { driver, answers, times, losses, wall, here } = match connect {
        Some(address) => of_bridge(replay, address, &arguments)?,
        None => of_model(replay, &settings).with_context(|| arguments.source.display().to_string())?,
    };
    let source = arguments.source.display().to_string();
    let report = Report::new((source.clone(), driver.clone()), &answers, losses, (&times, wall));
    let too_many_bad = report.has_too_many_bad_frames() && !arguments.allow_bad_frames;
    // What cannot be written takes nothing else with it.
    let written = arguments.write_golden.as_ref().filter(|_| !too_many_bad).map_or(Ok(()), |path| {
        Golden::new(&source, &driver, &answers, here.clone()).write(path)?;
        say!("written: {}", path.display());
        Ok::<_, GoldenError>(())
    });
    let comparison = golden.map(|golden| {
        let differences = golden.compare(&answers, arguments.tolerance);
        Comparison {
            tolerance: arguments.tolerance,
            differing_frames: differences.len(),
            first: differences.into_iter().take(NAMED).collect(),
            written_on: golden.written_on().cloned(),
            compared_on: here,
        }
    });
    let ended = match &comparison {
        _ if too_many_bad => Ended::Failed,
        Some(comparison) if comparison.differing_frames > 0 => Ended::Failed,
        _ => Ended::Passed,
    };
    if arguments.json {
        let card = Scorecard::of_replay(report.agreement());
        super::print(&serde_json::to_string_pretty(&Result_ { report: &report, card, golden: comparison })?)?;
    } else {
        let comparison = comparison.as_ref().map(told).unwrap_or_default();
        super::print(&format!("{report}{comparison}"))?;
    }
    if too_many_bad {
        say!("{}", too_many_bad_frames(&report.source, report.bad_frames, report.for_the_pilot()));
        if let Some(path) = &arguments.write_golden {
            say!("not written: {}", path.display());
        }
    }
    written?;
    Ok(ended)
}

/// What was answered, and how.
struct Asked {
    driver: String,
    answers: Vec<Answered>,
    times: Vec<Duration>,
    /// Of the recording: [`Replay::losses`].
    losses: (u64, Option<String>),
    wall: Duration,
    /// Absent where a bridge answered, which does not say what it runs on.
    here: Option<Machine>,
}

fn of_bridge(replay: Replay, address: String, arguments: &cli::Replay) -> anyhow::Result<Asked> {
    let bar = Bar::new(replay.frames());
    let mut world = ForBridge::new(replay);
    let began = Instant::now();
    let options = ClientOptions { culture: arguments.culture, ..Default::default() };
    let report = client::play(&mut world, &address, &options, |_| bar.0.inc(1))?;
    super::tell_ignored(report.lost_tokens);
    let wall = began.elapsed();
    bar.0.finish_and_clear();
    let losses = world.replay().losses();
    let (driver, answers) = (format!("the bridge at {address}"), world.into_answers());
    Ok(Asked { driver, answers, times: report.round_trips, losses, wall, here: None })
}

fn of_model(mut replay: Replay, settings: &Settings) -> anyhow::Result<Asked> {
    let mut bar = Bar::new(replay.frames());
    let model = super::load_model(settings)?;
    let mut driver = Driver::new(model.pilot(), &settings.control, Instant::now);
    let mut answers = Answers::default();
    let began = Instant::now();
    drive::run(&mut replay, &mut driver, &mut [&mut answers, &mut bar])?;
    let wall = began.elapsed();
    let libtorch = runtime::libtorch().version.unwrap_or_else(|| "of unknown version".into());
    let here = Some(Machine { cpu: runtime::processor(), libtorch });
    let (answers, times) = answers.into_parts();
    Ok(Asked { driver: model.name().to_owned(), answers, times, losses: replay.losses(), wall, here })
}

/// What is said of a replay that fails for its bad frames.
pub(super) fn too_many_bad_frames(source: &str, bad: u64, all: u64) -> String {
    let most = MOST_BAD_FRAMES * 100.0;
    format!(
        "{source}: expected at most {most} % bad frames, which no network sees, got {bad} of {all}; \
         --allow-bad-frames accepts them"
    )
}

fn told(Comparison { tolerance, differing_frames, first, written_on, compared_on }: &Comparison) -> String {
    if *differing_frames == 0 {
        return format!("\n  golden           every command agrees within {tolerance}");
    }
    let mut text = format!("\n  golden           {differing_frames} differ by more than {tolerance}:");
    for Difference { frame, what } in first {
        text += &format!("\n    frame {frame}: {what}");
    }
    if *differing_frames > first.len() {
        text += &format!("\n    and {} more", differing_frames - first.len());
    }
    let machine = |machine: &Option<Machine>| machine.as_ref().map_or_else(|| "not told".into(), Machine::to_string);
    text += &format!("\n    written on       {}\n    compared on      {}", machine(written_on), machine(compared_on));
    if written_on != compared_on {
        text += "\n    the last bits of a network's answers differ between kinds of processor and versions of libtorch";
    }
    text
}

/// A line of progress through a recording, where somebody watches.
pub(super) struct Bar(ProgressBar);

impl Bar {
    pub(super) fn new(frames: Option<u64>) -> Self {
        if !io::stderr().is_terminal() {
            return Self(ProgressBar::hidden());
        }
        let (bar, template) = match frames {
            Some(frames) => (ProgressBar::new(frames), "{wide_bar} {pos}/{len} frames, {per_sec}, {eta} left"),
            None => (ProgressBar::new_spinner(), "{spinner} {pos} frames, {per_sec}, {elapsed}"),
        };
        bar.enable_steady_tick(Duration::from_millis(200));
        Self(bar.with_style(ProgressStyle::with_template(template).expect("the template is written here")))
    }
}

impl<W: ?Sized> Observer<W> for Bar {
    fn turn(&mut self, _: &W, _: &Turn) -> Result<(), ObserverError> {
        self.0.inc(1);
        Ok(())
    }

    fn end(&mut self) {
        self.0.finish_and_clear();
    }
}
