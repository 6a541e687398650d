//! What was found, against what was driven.

use std::process::ExitCode;

use super::{BlindRun, Driven};
use lapwing_score::{
    odometry::words,
    score::{DriveFound, Figure, Scorecard},
};

/// Points of completion that an estimate may be off.
const COMPLETION: f64 = 0.02;
/// A collision is found where one is suspected within so many seconds of it.
const SAME_S: f64 = 2.0;
/// Least precision and recall of collisions.
const COLLISIONS: f64 = 0.9;
/// The share of intervals that must hold the truth.
const HELD: f64 = 0.9;

#[derive(Clone, Copy, PartialEq)]
enum Named {
    Right,
    Unknown,
    Wrong,
}

fn figure(card: &Scorecard, figure: Figure) -> f64 {
    card.value(figure).unwrap_or(f64::NAN)
}

/// Each drive, and what was found of it.
fn pairs(run: &BlindRun) -> impl Iterator<Item = (&Driven, Option<&DriveFound>)> {
    run.drives.iter().enumerate().map(|(i, driven)| (driven, run.found.drives.get(i)))
}

fn named((driven, found): (&Driven, Option<&DriveFound>)) -> Named {
    match found.and_then(|found| found.on.as_ref()) {
        None => Named::Unknown,
        Some(on) if (&on.track, on.reversed) == (&driven.track, driven.reversed) => Named::Right,
        Some(_) => Named::Wrong,
    }
}

/// Whether the interval of a drive's laps holds the truth, where its road is named right and the truth is known.
fn held((driven, found): (&Driven, Option<&DriveFound>)) -> Option<bool> {
    let on = found?.on.as_ref().filter(|_| named((driven, found)) == Named::Right)?;
    Some((on.laps - driven.laps?).abs() <= on.laps_uncertainty)
}

fn laps(run: &BlindRun) -> f64 {
    run.drives.iter().map(|driven| figure(&driven.truth, Figure::Laps)).sum()
}

/// How far off the completion is, of a run with one drive.
fn off(run: &BlindRun) -> Option<f64> {
    let [driven] = &run.drives[..] else { return None };
    Some((run.found.value(Figure::Completion)? - driven.completion).abs())
}

/// How far off each lap's time is, in seconds.
fn lap_times_off(run: &BlindRun) -> Vec<f64> {
    let truth: Vec<f64> = run.drives.iter().flat_map(|driven| driven.truth.lap_times_s.iter().copied()).collect();
    let found = &run.found.lap_times_s;
    let pairs = truth.iter().zip(found).filter(|_| truth.len() == found.len());
    pairs.map(|(truth, found)| (truth - found).abs()).collect()
}

/// A line about a run.
pub fn told(run: &BlindRun) -> String {
    let BlindRun { run: number, who, mph, drives, found, .. } = run;
    let roads = pairs(run).map(|(driven, found)| {
        let truth = words(&driven.track, driven.reversed);
        let laps = driven.laps.map_or_else(|| "off the road".to_owned(), |laps| format!("{laps:.3}"));
        format!("{truth} {laps}: {}", found.map_or_else(|| "no drive".to_owned(), ToString::to_string))
    });
    let wrong = pairs(run).any(|pair| named(pair) == Named::Wrong);
    let missed = pairs(run).any(|pair| held(pair) == Some(false));
    let struck: f64 = drives.iter().map(|driven| figure(&driven.truth, Figure::Collisions)).sum();
    format!(
        "{number:>3}  {:<24} {mph:>2}  laps {} {}  collisions {struck} {}  {}{}{}",
        who.name(),
        laps(run),
        figure(found, Figure::Laps),
        figure(found, Figure::Collisions),
        roads.collect::<Vec<_>>().join(" | "),
        if wrong { "  WRONG ROAD" } else { "" },
        if missed { "  OUTSIDE" } else { "" },
    )
}

/// All runs, in figures.
pub fn report(runs: &[BlindRun]) -> ExitCode {
    runs.iter().for_each(|run| println!("{}", told(run)));
    let (mut both, mut suspected, mut seen) = (0.0, 0.0, 0.0);
    // A run ends with its collision, so that of a joined drive's end nothing is known by time.
    for run in runs.iter().filter(|run| run.drives.len() == 1) {
        let truth = &run.drives[0].truth;
        let struck = figure(truth, Figure::Collisions);
        let right = run.suspected.iter().any(|at| (at - figure(truth, Figure::TimeS)).abs() < SAME_S);
        both += if right { struck } else { 0.0 };
        (suspected, seen) = (suspected + run.suspected.len() as f64, seen + struck);
    }
    let (precision, recall) = (both / f64::max(suspected, 1.0), both / f64::max(seen, 1.0));
    let all: Vec<_> = runs.iter().flat_map(pairs).collect();
    let of = |reversed: bool, what: Named| {
        all.iter().filter(|pair| pair.0.reversed == reversed && named(**pair) == what).count()
    };
    for (reversed, way) in [(false, "own way round  "), (true, "other way round")] {
        let [right, unknown, wrong] = [Named::Right, Named::Unknown, Named::Wrong].map(|what| of(reversed, what));
        println!("{way}       {right} named right, {unknown} unknown, {wrong} wrong");
    }
    let joined: Vec<_> = runs.iter().filter(|run| run.drives.len() > 1).collect();
    let apart = joined.iter().filter(|run| run.found.drives.len() == run.drives.len()).count();
    println!("joined drives         {apart} of {} told apart", joined.len());
    let equal = |run: &&BlindRun| run.found.value(Figure::Laps) == Some(laps(run));
    let (counted, known) =
        (runs.iter().filter(equal).count(), runs.iter().filter(|run| run.found.value(Figure::Laps).is_some()));
    println!("lap counts equal      {counted} of {} that are counted, {} runs", known.count(), runs.len());
    let held: Vec<bool> = all.iter().filter_map(|pair| held(*pair)).collect();
    let share = held.iter().filter(|held| **held).count() as f64 / held.len().max(1) as f64;
    let mut widths: Vec<f64> =
        all.iter().filter_map(|(_, found)| Some(found.as_ref()?.on.as_ref()?.laps_uncertainty)).collect();
    widths.sort_by(f64::total_cmp);
    let width = widths.get(widths.len() / 2).copied().unwrap_or(f64::NAN);
    println!(
        "laps within interval  {:.0} % of {} drives, interval \u{b1} {width:.3} laps in the median",
        100.0 * share,
        held.len()
    );
    let offs: Vec<f64> = runs.iter().filter_map(off).collect();
    let within = offs.iter().filter(|off| **off <= COMPLETION).count();
    let worst = offs.iter().copied().fold(0.0, f64::max);
    println!("completion within 2 % {within} of {}, worst {:.1} points off", offs.len(), 100.0 * worst);
    let mut times: Vec<f64> = runs.iter().flat_map(lap_times_off).collect();
    times.sort_by(f64::total_cmp);
    if let (Some(middle), Some(worst)) = (times.get(times.len() / 2), times.last()) {
        println!("lap times             {} laps, {middle:.1} s off in the median, {worst:.1} s at worst", times.len());
    }
    println!(
        "collisions            precision {precision:.2} ({both} of {suspected}), recall {recall:.2} ({both} of {seen})"
    );
    let wrong = all.iter().any(|pair| named(*pair) == Named::Wrong);
    let good = !wrong && share >= HELD && precision >= COLLISIONS && recall >= COLLISIONS;
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
