//! `lapwing replay`: show a recording to a model or a bridge.

use std::{
    io::{self, IsTerminal},
    path::Path,
    time::{Duration, Instant},
};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::Ended;
use crate::{
    cli,
    config::ConfigError,
    driver::Driver,
    replay::{self, Difference, Golden, Replay, Report},
    score::Scorecard,
    simulator::client::{self, ClientOptions},
};

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
}

pub(super) fn run(arguments: cli::Replay, config: Option<&Path>) -> anyhow::Result<Ended> {
    if let Some(flag) = arguments.thresholds.first() {
        // What is only answered, and not driven, has no such figures.
        return Err(ConfigError::Value {
            layer: flag.into(),
            why: "expected together with --closed-loop, got it alone: an open loop is not driven".into(),
        }
        .into());
    }
    let settings = super::thinking_layers(config, &arguments.driving, &arguments.thinking)?.resolve()?;
    // Read before the work is done, so that a wrong file does not cost a whole replay.
    let golden = arguments.golden.as_deref().map(Golden::read).transpose()?;
    let mut replay = Replay::open(&arguments.source, arguments.rate)?;
    let bar = progress_bar(replay.frames());
    let (driver, times, began) = match &arguments.connect {
        Some(address) => {
            let began = Instant::now();
            let options = ClientOptions { culture: arguments.culture, ..Default::default() };
            let report = client::play(&mut replay, address, &options, |_| bar.inc(1))?;
            if report.lost_tokens > 0 {
                say!("the simulator would have swallowed {} of the bridge's answers", report.lost_tokens);
            }
            (format!("the bridge at {address}"), report.round_trips, began)
        }
        None => {
            let model = super::load_model(&settings)?;
            let mut driver = Driver::new(model.pilot(), &settings.control, Instant::now);
            let began = Instant::now();
            let times = replay::run(&mut replay, &mut driver, || bar.inc(1))
                .map_err(|e| anyhow::anyhow!(e))
                .with_context(|| arguments.source.display().to_string())?;
            (model.name().to_owned(), times, began)
        }
    };
    let wall = began.elapsed();
    bar.finish_and_clear();
    let source = arguments.source.display().to_string();
    let answers = replay.answers();
    let report = Report::new((source.clone(), driver.clone()), answers, replay.losses(), (&times, wall));
    if let Some(path) = &arguments.write_golden {
        Golden::new(&source, &driver, answers).write(path)?;
        say!("written: {}", path.display());
    }
    let comparison = golden.map(|golden| {
        let differences = golden.compare(answers, arguments.tolerance);
        Comparison {
            tolerance: arguments.tolerance,
            differing_frames: differences.len(),
            first: differences.into_iter().take(NAMED).collect(),
        }
    });
    let ended = match &comparison {
        Some(comparison) if comparison.differing_frames > 0 => Ended::Failed,
        _ => Ended::Passed,
    };
    if arguments.json {
        let card = Scorecard::of_replay(report.steering.as_ref());
        super::print(&serde_json::to_string_pretty(&Result_ { report: &report, card, golden: comparison })?);
    } else {
        let comparison = comparison.as_ref().map(told).unwrap_or_default();
        super::print(&format!("{report}{comparison}"));
    }
    Ok(ended)
}

fn told(Comparison { tolerance, differing_frames, first }: &Comparison) -> String {
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
    text
}

pub(super) fn progress_bar(frames: Option<u64>) -> ProgressBar {
    if !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let (bar, template) = match frames {
        Some(frames) => (ProgressBar::new(frames), "{wide_bar} {pos}/{len} frames, {per_sec}, {eta} left"),
        None => (ProgressBar::new_spinner(), "{spinner} {pos} frames, {per_sec}, {elapsed}"),
    };
    bar.enable_steady_tick(Duration::from_millis(200));
    bar.with_style(ProgressStyle::with_template(template).expect("the template is written here"))
}
