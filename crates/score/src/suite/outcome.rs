//! The outcome of results: groups over seeds, the table, and `suite.json`.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use super::{Cell, Done};
use crate::{
    score::summary::spreads,
    score::{Figure, Spread, aligned},
};
use lapwing_core::hash::sha256;

/// The schema of the JSON.
const SCHEMA: &str = "lapwing.suite/1";
/// Figures of the table.
const SHOWN: [Figure; 8] = [
    Figure::Completion,
    Figure::Collisions,
    Figure::OffRoads,
    Figure::MeanCte,
    Figure::P95Cte,
    Figure::MaxCte,
    Figure::Autonomy,
    Figure::DrivingScore,
];

/// What `suite.json` holds; the documentation of [`suite`](super) has its keys.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SuiteOutcome {
    schema: &'static str,
    /// Cells in the suite; none if there is no plan.
    pub planned: Option<usize>,
    /// Cells known to have no result.
    pub missing: usize,
    /// What was driven.
    pub groups: Vec<Group>,
}

impl SuiteOutcome {
    /// The outcome of groups, and how complete they are.
    pub fn new(groups: Vec<Group>, planned: Option<usize>, missing: usize) -> Self {
        Self { schema: SCHEMA, planned, missing, groups }
    }
}

/// The cells that differ in nothing but their seed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Group {
    /// Who drove.
    pub pilot: String,
    /// Which model.
    pub model_sha256: Option<String>,
    /// The track.
    pub track: String,
    /// The conditions.
    pub conditions: String,
    /// The set speed in mph.
    pub speed_mph: f64,
    /// Each figure over the seeds, by key.
    pub figures: BTreeMap<&'static str, Over>,
    /// The drives that failed, or whose run was kept.
    pub drives: Vec<GroupDrive>,
}

/// A drive of a group, by itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GroupDrive {
    /// Its track, as the suite names it.
    #[serde(skip)]
    pub track: String,
    /// Its seed.
    pub seed: u64,
    /// What went wrong, in words; none if all went well.
    pub failed: Option<String>,
    /// If too many of its frames were bad: how many, and why the first was.
    pub bad_frames: Option<String>,
    /// Its run: the path from the folder of the results.
    pub run: Option<String>,
}

/// A figure over seeds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Over {
    /// Its spread.
    #[serde(flatten)]
    pub spread: Spread,
    /// Half the width of the mean's confidence interval at 95 %, by Student's t; none for a single drive.
    pub confidence: Option<f64>,
    /// The mean's interval at 95 % as shown to people: [`Spread::interval`].
    pub interval: Option<[f64; 2]>,
}

/// Groups in the order of pilot, track, conditions and speed. If cells of the same name were driven with different
/// models, laps or settings, the pilot's name tells them apart; if the name of a road or of conditions stood for different
/// ones, the track's name does.
pub fn groups(done: &[Done]) -> Vec<Group> {
    let mut by_key: BTreeMap<_, Vec<&Done>> = BTreeMap::new();
    for one in done {
        let Cell { pilot, model_sha256, track, conditions, speed_mph, laps, longest_s, settings, world, .. } =
            &one.cell;
        let mut settings = settings.clone();
        // What the group's name already contains.
        for (section, said) in [("simulator", "track"), ("control", "speed_mph")] {
            settings.get_mut(section).and_then(Value::as_object_mut).and_then(|section| section.remove(said));
        }
        let others = format!("{model_sha256:?} {laps} {longest_s} {settings}");
        // Only these are others for each seed.
        let weather = if conditions == "random" { String::new() } else { world["conditions"].to_string() };
        let world = format!("{} {weather}", world["track_sha256"]);
        // The bits of positive floats sort like the numbers.
        by_key.entry((pilot, track, conditions, speed_mph.to_bits(), others, world)).or_default().push(one);
    }
    let several = |pilot: &str| {
        let others = by_key.keys().filter(|key| key.0 == pilot).map(|key| &key.4);
        others.collect::<BTreeSet<_>>().len() > 1
    };
    let several_worlds = |track: &String, conditions: &String| {
        let worlds = by_key.keys().filter(|key| key.1 == track && key.2 == conditions).map(|key| &key.5);
        worlds.collect::<BTreeSet<_>>().len() > 1
    };
    let group = |(key, done): (&(&String, &String, &String, _, String, String), &Vec<&Done>)| {
        let Cell { mut pilot, model_sha256, mut track, conditions, speed_mph, .. } = done[0].cell.clone();
        if several_worlds(&track, &conditions) {
            track = format!("{track} (world {})", &sha256(&key.5)[..6]);
        }
        if several(&pilot) {
            pilot = format!("{pilot} (settings {})", &sha256(&key.4)[..6]);
        }
        let spreads = spreads(done, |one, figure| one.value(figure));
        let over = |figure: Figure| {
            let spread = *spreads.get(figure.key())?;
            let (confidence, interval) = (spread.confidence(), spread.interval(figure));
            Some((figure.key(), Over { spread, confidence, interval }))
        };
        let figures = Figure::ALL.into_iter().filter_map(over).collect();
        let alone = |one: &&Done| GroupDrive {
            track: one.cell.track.clone(),
            seed: one.cell.seed,
            failed: one.failed(),
            bad_frames: one.bad_frames.clone(),
            run: one.run.clone(),
        };
        let told = |drive: &GroupDrive| drive.failed.is_some() || drive.run.is_some();
        let drives = done.iter().map(alone).filter(told).collect();
        Group { pilot, model_sha256, track, conditions, speed_mph, figures, drives }
    };
    by_key.iter().map(group).collect()
}

/// A line for each group.
pub fn table(groups: &[Group]) -> String {
    let mut rows = vec![["pilot", "track", "conditions", "mph", "n"].map(str::to_owned).to_vec()];
    rows[0].extend(SHOWN.map(|figure| figure.label().to_owned()));
    for group in groups {
        let n = group.figures.get(Figure::TimeS.key()).map_or(0, |over| over.spread.runs);
        let Group { pilot, track, conditions, speed_mph, .. } = group;
        let mut row = vec![pilot.clone(), track.clone(), conditions.clone(), speed_mph.to_string(), n.to_string()];
        row.extend(SHOWN.map(|figure| match group.figures.get(figure.key()).map(|over| over.words(figure)) {
            None => "-".into(),
            Some((mean, None)) => mean,
            Some((mean, Some(interval))) => format!("{mean} {interval}"),
        }));
        rows.push(row);
    }
    aligned(&rows, 3)
}

impl Over {
    /// The mean, and where it lies, in words.
    pub(super) fn words(&self, figure: Figure) -> (String, Option<String>) {
        let (unit, mean) = (figure.unit(), self.spread.mean);
        (unit.show_mean(mean), self.interval.map(|interval| unit.show_interval(mean, interval)))
    }
}
