//! `lapwing replay`: show a recording to a model or a bridge.

use std::{
    io::{self, IsTerminal},
    path::Path,
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};

use super::{Ended, outputs};
use crate::cli;
use lapwing_core::{
    client::{self, ClientOptions},
    config::{ConfigError, Settings},
    drive::{self, Observer, ObserverError},
    driver::Driver,
    replay::{
        Answered, Answers, ForBridge, Golden, GoldenComparison, GoldenError, Machine, Replay, ReplayReport, Response,
    },
    turn::Turn,
    words::count,
};
use lapwing_learn::nn::runtime;
use lapwing_score::{results::Replayed, score::Scorecard};

pub(super) fn run(arguments: cli::Replay, config: Option<&Path>) -> anyhow::Result<Ended> {
    if let Some((threshold, _)) = arguments.thresholds.0.first() {
        // Without driving, there are no such figures.
        return Err(ConfigError::Value {
            layer: format!("--{}", threshold.flag()),
            why: "requires --closed-loop: without it nothing is driven".into(),
        }
        .into());
    }
    let settings = super::thinking_layers(config, &arguments.driving, &arguments.thinking)?.resolve()?;
    // Read first, so that a wrong file does not waste a whole replay.
    let golden = arguments.golden.as_deref().map(Golden::read).transpose()?;
    let inputs = [arguments.source.as_path()];
    arguments.write_golden.as_deref().map_or(Ok(()), |golden| outputs::check_beside(golden, inputs))?;
    let connect = arguments.connect.as_deref().map(super::bridge_address).transpose()?;
    let replay = Replay::open(&arguments.source, arguments.rate)?;
    let ReplayAnswers { driver, answers, times, losses, wall, here } = match connect {
        Some(address) => of_bridge(replay, address, &arguments)?,
        None => of_model(replay, &settings).with_context(|| arguments.source.display().to_string())?,
    };
    let source = arguments.source.display().to_string();
    // Of a recording that is cut off, perhaps no more is left than that a human drove.
    let no_frame = answers.iter().all(|answered| matches!(answered.response, Response::Human));
    if no_frame && (answers.is_empty() || losses.1.is_some()) {
        let (skipped, cut_off) = losses;
        let skipped = if skipped > 0 { format!("; {} without one", count(skipped, "moment")) } else { String::new() };
        let cut_off = cut_off.map_or_else(String::new, |why| format!("; {why}"));
        bail!("{source}: expected frames with a picture, got none{skipped}{cut_off}");
    }
    let report = ReplayReport::new((source.clone(), driver.clone()), &answers, losses, (&times, wall));
    let too_many_bad = report.too_many_bad_frames().filter(|_| !arguments.allow_bad_frames);
    // A failed write does not affect the other results.
    let written = arguments.write_golden.as_ref().filter(|_| too_many_bad.is_none()).map_or(Ok(()), |path| {
        Golden::new(&source, &driver, &answers, here.clone()).write(path)?;
        say!("written: {}", path.display());
        Ok::<_, GoldenError>(())
    });
    let comparison = golden.map(|golden| GoldenComparison::new(&golden, &answers, arguments.tolerance, here));
    let ended = match &comparison {
        _ if too_many_bad.is_some() => Ended::Failed,
        Some(comparison) if comparison.differing_frames > 0 => Ended::Failed,
        _ => Ended::Passed,
    };
    if arguments.json {
        let mut card = Scorecard::of_replay(report.agreement());
        card.damaged = report.cut_off.is_some();
        super::print(&serde_json::to_string_pretty(&Replayed { report: &report, card, golden: comparison })?)?;
    } else {
        let comparison = comparison.map_or_else(String::new, |comparison| format!("\n{comparison}"));
        super::print(&format!("{report}{comparison}"))?;
    }
    if let Some(too_many) = too_many_bad {
        say!("{}: {}", report.source, with_flag_hint(&too_many));
        if let Some(path) = &arguments.write_golden {
            say!("not written: {}", path.display());
        }
    }
    written?;
    Ok(ended)
}

/// The answers, and how they came about.
struct ReplayAnswers {
    driver: String,
    answers: Vec<Answered>,
    times: Vec<Duration>,
    /// Losses of the recording: [`Replay::losses`].
    losses: (u64, Option<String>),
    wall: Duration,
    /// Absent if a bridge answered, which does not say what it runs on.
    here: Option<Machine>,
}

fn of_bridge(replay: Replay, address: String, arguments: &cli::Replay) -> anyhow::Result<ReplayAnswers> {
    let bar = ReplayBar::new(replay.frames());
    let mut world = ForBridge::new(replay);
    let began = Instant::now();
    let options = ClientOptions { culture: arguments.culture, ..Default::default() };
    let report = client::play(&mut world, &address, &options, |_| bar.0.inc(1))?;
    super::tell_ignored(report.lost_tokens);
    let wall = began.elapsed();
    bar.0.finish_and_clear();
    let losses = world.replay().losses();
    let (driver, answers) = (format!("the bridge at {address}"), world.into_answers());
    Ok(ReplayAnswers { driver, answers, times: report.round_trips, losses, wall, here: None })
}

fn of_model(mut replay: Replay, settings: &Settings) -> anyhow::Result<ReplayAnswers> {
    let mut bar = ReplayBar::new(replay.frames());
    let model = super::load_model(settings)?;
    let mut driver = Driver::new(model.pilot(), &settings.control, Instant::now);
    let mut answers = Answers::default();
    let began = Instant::now();
    drive::run(&mut replay, &mut driver, &mut [&mut answers, &mut bar])?;
    let wall = began.elapsed();
    let libtorch = runtime::libtorch().version.unwrap_or_else(|| "of unknown version".into());
    let here = Some(Machine { cpu: runtime::processor(), libtorch });
    let (answers, times) = answers.into_parts();
    Ok(ReplayAnswers { driver: model.name().to_owned(), answers, times, losses: replay.losses(), wall, here })
}

/// What is wrong with the bad frames of a replay, and how they are accepted.
pub(super) fn with_flag_hint(too_many: &str) -> String {
    format!("{too_many}; --allow-bad-frames accepts them")
}

/// A line of progress through a recording, if stderr is a terminal.
pub(super) struct ReplayBar(ProgressBar);

impl ReplayBar {
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

impl<W: ?Sized> Observer<W> for ReplayBar {
    fn turn(&mut self, _: &W, _: &Turn) -> Result<(), ObserverError> {
        self.0.inc(1);
        Ok(())
    }

    fn end(&mut self) {
        self.0.finish_and_clear();
    }
}
