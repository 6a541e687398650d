//! `lapwing score`: scores recorded runs.

mod markdown;

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::bail;

use self::markdown::Pictures;
use super::{Ended, outputs, thresholds};
use crate::{
    cli,
    known::{Roads, outline, whereabouts},
    locating::turns,
};
#[cfg(feature = "networks")]
use lapwing_core::config::Thresholds;
use lapwing_core::{
    recording::{Item, folders_with_recordings},
    words::{count, first_five},
};
use lapwing_score::score::{
    Scorer,
    against::{Baseline, Comparison, Trend},
    files::runs_in,
    junit,
    markdown::WorstWatch,
    page::{self, Collector, Drawn, Outline, Shown},
    report::{JudgedRun, Report, explained},
};
use lapwing_sim::track::Track;

/// A run, and what a page shows of it, if one is asked for.
struct PagedRun {
    judged: JudgedRun,
    drawn: Option<(Drawn, Option<Outline>)>,
    /// Of a summary, if one is asked for.
    worst: Option<WorstWatch>,
}

pub(super) fn run(arguments: &cli::Score, config: Option<&Path>) -> anyhow::Result<Ended> {
    if arguments.explain && arguments.runs.is_empty() {
        super::print(&explained())?;
        return Ok(Ended::Passed);
    }
    let limits = thresholds::layers(super::undriven_layers(config)?, &arguments.thresholds)?.resolve()?.thresholds;
    arguments.tracks.iter().try_for_each(|name| Track::open(name).map(drop))?;
    let baseline = arguments.against.as_deref().map(Baseline::read).transpose()?;
    let summary = arguments.markdown.as_ref().and_then(Option::as_ref);
    let paths = runs_in(&arguments.runs)?;
    let inputs = || paths.iter().chain(&arguments.against).map(PathBuf::as_path);
    let results = || [arguments.junit.as_ref(), arguments.html.as_ref(), summary].into_iter().flatten();
    outputs::check_apart(results())?;
    results().try_for_each(|path| outputs::check_beside(path, inputs()))?;
    let roads = Roads::with(&arguments.tracks);
    let (mut runs, mut unscored) = (vec![], vec![]);
    for path in paths {
        let name = path.display().to_string();
        if path.to_str().is_none() {
            unscored.push((name, format!("{path:?}: expected a name in UTF-8: rename it")));
            continue;
        }
        let mut collector = arguments.html.is_some().then(Collector::with_pictures);
        let mut worst = arguments.markdown.is_some().then(WorstWatch::default);
        let watch = |at: Duration, item: &Item| {
            collector.iter_mut().for_each(|collector| collector.item(at, item));
            worst.iter_mut().for_each(|worst| worst.item(at, item));
        };
        let recording = path.clone();
        let scorer = || {
            let turns = move || turns(&recording).map_err(|error| error.to_string());
            Ok::<_, anyhow::Error>(Scorer::on(&roads.both_ways()?, Some(arguments.laps)).seeing(turns))
        };
        match JudgedRun::open(path, &limits, scorer, watch) {
            Ok(judged) => {
                let drawn = collector.map(|collector| drawn(collector, &judged, &roads));
                runs.push(PagedRun { drawn, judged, worst });
            }
            Err(error) => unscored.push((name, super::told(&error))),
        }
    }
    let judged: Vec<_> = runs.iter().map(|run| &run.judged).collect();
    let compared: Vec<_> = judged.iter().map(|run| run.compared()).collect();
    let against = baseline.map(|baseline| baseline.compare(&compared));
    // A failed write does not affect the other results.
    let written = [
        arguments.junit.as_deref().map(|path| {
            let cases: Vec<_> = judged.iter().map(|run| (run.name(), &run.card, run.checks.clone())).collect();
            outputs::write(path, &junit::report(&cases, &unscored, against.as_ref())?)
        }),
        arguments.html.as_deref().map(|path| outputs::write(path, &page(&runs)?)),
    ];
    let report = Report::new(&judged, &unscored, against.as_ref());
    let pictures = summary.map(|file| Pictures { file, base: arguments.pictures_at.as_deref() });
    let told = arguments.markdown.as_ref().map(|_| {
        let runs: Vec<_> = runs.iter().filter_map(|run| Some((&run.judged, run.worst.as_ref()?))).collect();
        markdown::summary(&report, &runs, against.as_ref(), &roads, pictures.as_ref())
    });
    let (told, summarised) = match told {
        Some(Ok(told)) => (pictures.is_none().then_some(told), Ok(())),
        Some(Err(error)) => (None, Err(error)),
        None => (None, Ok(())),
    };
    let result = match &judged[..] {
        _ if told.is_some() => told,
        _ if arguments.json => Some(serde_json::to_string_pretty(&report)?),
        [] => None,
        runs if arguments.explain => {
            let told = runs.iter().map(|run| format!("{}\n{}\n{}", run.title(), run.card, run.card.roads_tried()));
            Some(told.map(|told| told.trim_end().to_owned()).collect::<Vec<_>>().join("\n\n"))
        }
        [run] => Some(format!("{}\n{}", run.title(), run.card)),
        _ => Some(report.table()),
    };
    let printed = result.map_or(Ok(()), |result| super::print(&result));
    for change in against.iter().flat_map(|against| &against.changes).filter(|change| change.turn == Trend::Better) {
        say!("better: {change}");
    }
    let named: Vec<_> =
        arguments.runs.iter().flat_map(|path| [Some(&**path), path.parent()]).flatten().map(outputs::place).collect();
    for folder in arguments.runs.iter().filter(|path| path.is_dir()) {
        let mut below = folders_with_recordings(folder);
        below.retain(|folder| !named.contains(&outputs::place(folder)));
        if !below.is_empty() {
            let below = below.iter().map(|path| path.display().to_string()).collect();
            say!("not scored: {}: name these folders as well", first_five(below).join(", "));
        }
    }
    for setting in against.iter().flat_map(|against| &against.new) {
        say!("not compared: {setting}: the baseline has no run");
    }
    let named = |run: &&JudgedRun| run.missed().map(|missed| format!("{}: {missed}", run.name())).collect::<Vec<_>>();
    let worse = against.iter().flat_map(Comparison::worse).map(|worse| format!("worse: {worse}"));
    let ended = thresholds::ended(&judged.iter().flat_map(named).chain(worse).collect::<Vec<_>>());
    written.into_iter().flatten().collect::<Result<(), _>>()?;
    summarised?;
    printed?;
    match &unscored[..] {
        [] => Ok(ended),
        [(_, why)] if runs.is_empty() => bail!("{why}"),
        several => {
            several.iter().for_each(|(_, why)| say!("error: {why}"));
            bail!("{} of {} cannot be scored", several.len(), count(several.len() + runs.len(), "run"))
        }
    }
}

/// The report on a recorded run as one page.
///
/// # Errors
/// If the run cannot be read.
#[cfg(feature = "networks")]
pub(super) fn report(path: PathBuf, roads: &Roads) -> anyhow::Result<String> {
    let mut collector = Collector::with_pictures();
    let scorer = || Ok::<_, anyhow::Error>(Scorer::default());
    let judged = JudgedRun::open(path, &Thresholds::default(), scorer, |at, item| collector.item(at, item))?;
    let drawn = Some(drawn(collector, &judged, roads));
    Ok(page(&[PagedRun { judged, drawn, worst: None }])?)
}

/// What a page shows of a run, and of the track that it was driven on, if that is known.
fn drawn(collector: Collector, run: &JudgedRun, roads: &Roads) -> (Drawn, Option<Outline>) {
    let track = run.card.track.as_deref().and_then(|name| roads.track(name));
    let mut drawn = collector.finish();
    if let Some(track) = &track {
        drawn.locate(&whereabouts(&run.card, track));
    }
    (drawn, track.as_ref().map(outline))
}

fn page(runs: &[PagedRun]) -> Result<String, serde_json::Error> {
    let shown = runs.iter().filter_map(|PagedRun { judged: run, drawn, .. }| {
        let (drawn, outline) = drawn.as_ref()?;
        let missed = run.missed().collect();
        Some(Shown { title: run.title(), card: &run.card, drawn, outline: outline.as_ref(), missed })
    });
    page::render(&shown.collect::<Vec<_>>())
}
