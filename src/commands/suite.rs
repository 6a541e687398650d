//! `lapwing suite`: many drives, over all cores, and `lapwing merge`: the results of its parts.

use std::{
    collections::BTreeMap,
    io::{self, IsTerminal},
    path::{Path, PathBuf},
    slice,
};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};

use super::{Ended, drive, outputs, score};
use crate::{
    cli,
    course::{self, SimulatedCourse},
    known::Roads,
};
use serde_json::Value;

use lapwing_core::{
    config::{BrakeSettings, Settings, Thresholds, text_of},
    words::count,
};
use lapwing_learn::nn::runtime;
use lapwing_score::suite::{
    self, Cell, Done, Group, GroupDrive, Keep, Merged, Plan, Planned, Results, Suite, SuiteOutcome, render, table,
};

/// How many missing cells are named.
const NAMED: usize = 5;

pub(super) fn run(arguments: &cli::Suite, config: Option<&Path>) -> anyhow::Result<Ended> {
    let layers = super::allowing(super::undriven_layers(config)?, &arguments.trust)?;
    let settings = layers.clone().resolve()?;
    tell_unused(&settings);
    let named = || arguments.suite.display().to_string();
    let suite = Suite::parse(&text_of(&arguments.suite)?).with_context(named)?;
    let inputs = suite.pilots.iter().filter_map(|pilot| pilot.model.as_deref()).chain([arguments.suite.as_path()]);
    check_page(arguments.html.as_deref(), inputs, [&arguments.out])?;
    outputs::check_folder(&arguments.out)?;
    let mut models = BTreeMap::new();
    for pilot in &suite.pilots {
        if let Some(model) = pilot.model.as_ref().filter(|_| !pilot.expert) {
            super::refuse_strangers_code(&named(), model, false, &settings)?;
        }
        let pilots = || format!("{}: pilot {:?}", named(), pilot.name);
        if let Some(model) = course::model_of(pilot).with_context(pilots)? {
            super::suits_our_cameras(&model)?;
            models.insert(pilot.name.clone(), model);
        }
    }
    let course = SimulatedCourse::new(&suite, layers, models, |settings, setup, who| {
        drive::header(settings, setup, who, None, Value::Null)
    })
    .with_context(named)?;
    let planned = Planned::new(&suite, &course).with_context(named)?;
    tell_left_out(planned.left_out, "cell");
    let results = Results::open(&arguments.out)?;
    let _lock = results.lock(arguments.shard.is_some())?;
    results.keep_plan(&planned.plan())?;
    let (open, driven) = planned.open(arguments.shard, &results)?;
    tracing::info!("{}, {} of them already driven", count(driven.cells + open.len(), "cell"), driven.cells);
    if arguments.keep_runs == Keep::All && driven.without_run > 0 {
        tracing::warn!(
            "{} of the cells already driven have no run and will not be driven again; use a new --out folder to keep all runs",
            driven.without_run
        );
    }
    // Each drive uses one thread, so that it gives the same bytes on every machine.
    runtime::set_threads(1);
    let interrupted = super::interrupted();
    let bar = SuiteBar::new(open.len());
    let ended = suite::drive_all(
        &course,
        open,
        (&results, arguments.keep_runs),
        arguments.jobs,
        &|| interrupted.is_pressed(),
        &bar,
    );
    bar.0.finish_and_clear();
    ended?;
    if interrupted.is_pressed() {
        bail!("interrupted; run the same command again to continue");
    }
    let outcome = planned.outcome(&results)?;
    report(&outcome, &results, (&arguments.out, arguments.html.as_deref()), arguments.json)?;
    Ok(if tell_bad_frames(&outcome) { Ended::Failed } else { Ended::Passed })
}

pub(super) fn merge(arguments: &cli::Merge) -> anyhow::Result<Ended> {
    suite::check_parts(&arguments.folders)?;
    check_page(arguments.html.as_deref(), [], arguments.folders.iter().chain([&arguments.out]))?;
    outputs::check_folder(&arguments.out)?;
    let merged = suite::merge(&arguments.folders, &arguments.out, course::left_to_chance)?;
    tell(&merged);
    tell_left_out(merged.left_out, "result");
    let results = Results::open(&arguments.out)?;
    report(&merged.outcome, &results, (&arguments.out, arguments.html.as_deref()), arguments.json)?;
    let has_bad = tell_bad_frames(&merged.outcome);
    Ok(if merged.is_whole() && !has_bad { Ended::Passed } else { Ended::Failed })
}

/// Whether the page has a place of its own: neither an input nor what these folders hold besides it would be lost.
fn check_page<'a>(
    page: Option<&Path>,
    inputs: impl IntoIterator<Item = &'a Path>,
    folders: impl IntoIterator<Item = &'a PathBuf>,
) -> anyhow::Result<()> {
    let Some(page) = page else { return Ok(()) };
    let (own, mut kept) = (outputs::place(page), Vec::from_iter(inputs.into_iter().map(Path::to_owned)));
    for folder in folders {
        kept.extend(["plan.json", "suite.json"].map(|name| folder.join(name)));
        let cells = outputs::place(&folder.join("cells"));
        if own.as_deref().and_then(Path::parent).is_some_and(|own| Some(own) == cells.as_deref()) {
            bail!("{}: cannot be written: results of drives are in this folder; name another file", page.display());
        }
    }
    outputs::check_beside(page, kept.iter().map(PathBuf::as_path))
}

/// Writes the outcome of the results and the reports of the runs that were kept, and prints the outcome.
fn report(
    outcome: &SuiteOutcome,
    results: &Results,
    (out, html): (&Path, Option<&Path>),
    as_json: bool,
) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(outcome)?;
    // One failure does not affect the others.
    let json = outputs::write(&out.join("suite.json"), &text);
    // A page elsewhere finds the runs from wherever it is opened.
    let folder = html.map_or(Ok(String::new()), |_| out.canonicalize().map(|out| out.display().to_string()))?;
    let html = outputs::write(html.unwrap_or(&out.join("suite.html")), &render(outcome, &folder)?);
    let reports = reports(outcome, results);
    let printed = super::print(&if as_json { text } else { table(&outcome.groups) });
    json.and(html).and(reports)?;
    Ok(printed?)
}

/// A report beside each run that was kept and has none yet.
fn reports(outcome: &SuiteOutcome, results: &Results) -> anyhow::Result<()> {
    for drive in outcome.groups.iter().flat_map(|group| &group.drives) {
        let Some(run) = &drive.run else { continue };
        let run = results.file(run);
        let page = run.with_extension("html");
        if run.exists() && !page.exists() {
            let roads = Roads::with(slice::from_ref(&drive.track));
            outputs::write(&page, &score::report(run, &roads)?)?;
        }
    }
    Ok(())
}

/// Says which settings a suite does not follow: whoever set them for single drives may rely on them here.
fn tell_unused(settings: &Settings) {
    if settings.thresholds != Thresholds::default() {
        tracing::warn!(
            "[thresholds] are not applied to a suite: with --keep-runs all, lapwing score --against compares its runs with a baseline"
        );
    }
    if settings.model.path.is_some() {
        tracing::warn!(
            "model.path does not apply to suites: a [[pilot]] without a model uses the built-in PilotNet; set `model` in that [[pilot]]"
        );
    }
    if settings.brake != BrakeSettings::default() {
        tracing::warn!("[brake] is not applied to a suite: its drives have no guard");
    }
}

fn tell_left_out(left_out: usize, what: &str) {
    if left_out > 0 {
        tracing::info!("skipped {}: a different seed would not change their drives", count(left_out, what));
    }
}

/// Says which drives had too many bad frames, and whether there are any: their figures say little about their pilots.
fn tell_bad_frames(outcome: &SuiteOutcome) -> bool {
    let told = |group: &Group| {
        let Group { pilot, track, conditions, speed_mph, drives, .. } = group;
        let of = |drive: &GroupDrive| {
            let why = drive.bad_frames.as_ref()?;
            Some(format!("{pilot} on {track}, {conditions}, {speed_mph} mph, seed {}: {why}", drive.seed))
        };
        drives.iter().filter_map(of).collect::<Vec<_>>()
    };
    let told: Vec<_> = outcome.groups.iter().flat_map(told).collect();
    for drive in told.iter().take(NAMED) {
        say!("{drive}");
    }
    if let more @ 1.. = told.len().saturating_sub(NAMED) {
        say!("{} with too many bad frames", count(more, "more drive"));
    }
    !told.is_empty()
}

/// Reports how much of the suite is present.
fn tell(merged: &Merged) {
    let Merged { plan, present, without, missing, unplanned, .. } = merged;
    match plan.as_ref().map(Plan::count) {
        Some(all) => {
            say!("{} of {} present, {without} missing", all - without, count(all, "cell"));
            for folder in unplanned {
                say!("{}: no plan.json: the suite's other cells are unknown", folder.display());
            }
        }
        None => {
            let present = count(*present, "cell");
            say!("{present} present; no folder has a plan.json: the number of the suite's cells is unknown");
        }
    }
    for name in missing.iter().take(NAMED) {
        say!("missing: {name}");
    }
    if let more @ 1.. = missing.len().saturating_sub(NAMED) {
        say!("missing: {more} more");
    }
    if merged.plans_differ && !missing.is_empty() {
        say!("the parts plan different cells: were they driven with different settings, models or builds of Lapwing?");
    }
}

/// Progress of the cells, if stderr is a terminal.
struct SuiteBar(ProgressBar);

impl SuiteBar {
    fn new(cells: usize) -> Self {
        let bar = if io::stderr().is_terminal() { ProgressBar::new(cells as u64) } else { ProgressBar::hidden() };
        let template = "{wide_bar} {pos}/{len} {msg}, {eta} left";
        bar.set_style(ProgressStyle::with_template(template).expect("the template is written here"));
        Self(bar)
    }
}

impl suite::Watch for SuiteBar {
    fn begins(&self, cell: &Cell) {
        self.0.set_message(cell.to_string());
    }

    fn done(&self, _: &Done) {
        self.0.inc(1);
    }
}
