//! `lapwing brake record`: a data set for emergency braking.

use std::io::{self, IsTerminal};

use indicatif::ProgressBar;
use serde_json::json;

use super::super::{Ended, interrupted, outputs, print};
use crate::cli::BrakeRecord;
use lapwing_core::words::count;
use lapwing_sim::braking::{DataOptions, DataReport, Kind, Part, Recorded, record};

pub(super) fn run(arguments: &BrakeRecord) -> anyhow::Result<Ended> {
    outputs::check_folder(&arguments.out)?;
    let interrupted = interrupted();
    let &BrakeRecord { hours, seed, part, .. } = arguments;
    let options = DataOptions { hours, seed, part, ..DataOptions::default() };
    let bar = if io::stderr().is_terminal() { ProgressBar::new(1) } else { ProgressBar::hidden() };
    let report = record(&arguments.out, options, |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
        !interrupted.is_pressed()
    })?;
    bar.finish_and_clear();
    let told = Told::of(&report, options.hz);
    if arguments.json {
        print(&serde_json::to_string_pretty(&json!({
            "episodes": report.episodes.len(), "kept": report.kept, "more": report.more, "given_up": report.given_up,
            "hours": told.hours, "hazards": told.hazards, "negatives": told.negatives, "hits": told.hits,
            "part": part.map(Part::name), "interrupted": report.interrupted,
        }))?)?;
    } else if report.interrupted && report.episodes.is_empty() {
        print(&format!("interrupted before this call recorded anything in {}", arguments.out.display()))?;
    } else {
        let Told { hours, hazards, negatives, hits } = told;
        let (episodes, folder) = (count(report.episodes.len(), "episode"), arguments.out.display());
        print(&format!("{episodes} ({} kept), {hours:.2} hours, in {folder}", report.kept))?;
        print(&format!("  hazards    {hazards}, in {hits} of them something was hit"))?;
        print(&format!("  negatives  {negatives}"))?;
        if report.given_up > 0 {
            print(&format!("  given up   {}, of which no draw was of use", report.given_up))?;
        }
        if report.more > 0 {
            print(&format!(
                "  more       {} recorded earlier, beyond these hours; they stay in the table",
                report.more
            ))?;
        }
        if report.interrupted {
            print("  interrupted: run the same command again to continue")?;
        }
    }
    Ok(if report.interrupted { Ended::Failed } else { Ended::Passed })
}

/// What is told of a data set.
struct Told {
    hours: f64,
    hazards: usize,
    negatives: usize,
    hits: usize,
}

impl Told {
    fn of(report: &DataReport, hz: f64) -> Self {
        let counted = |which: fn(&&Recorded) -> bool| report.episodes.iter().filter(which).count();
        let frames: u64 = report.episodes.iter().map(|recorded| recorded.frames).sum();
        Self {
            hours: frames as f64 / hz / 3600.0,
            hazards: counted(|recorded| recorded.episode.case.kind() == Kind::Hazard),
            negatives: counted(|recorded| recorded.episode.case.kind() == Kind::Negative),
            hits: counted(|recorded| recorded.hit),
        }
    }
}
