//! What `lapwing score` reports on runs: each is judged and checked against thresholds, all in one table or one JSON.

use std::{collections::BTreeMap, path::PathBuf, time::Duration};

use serde::Serialize;

use super::{
    Check, Figure, Measure, SOURCES, Scorecard, Scorer, Spread, Unit,
    against::{self, ComparedRun, Comparison},
    aligned, checks, of_recording,
    summary::summary,
};
use lapwing_core::{
    config::Thresholds,
    recording::{Item, Recording, RecordingError, RunHeader},
    words::count,
};

/// The schema of a [`Report`]'s JSON.
pub const SCHEMA: &str = "lapwing.score/1";

/// Figures shown in the table of several runs.
const COMPARED: [Figure; 10] = [
    Figure::Completion,
    Figure::Collisions,
    Figure::OffRoads,
    Figure::MeanCte,
    Figure::P95Cte,
    Figure::MaxCte,
    Figure::Autonomy,
    Figure::DrivingScore,
    Figure::MeanMph,
    Figure::SteeringRate,
];
/// And beside them, if one of the runs went along a recording: a car that is put back late needs few interventions.
const ALONG: [Figure; 3] = [Figure::Interventions, Figure::Beyond1m, Figure::Beyond2m];

/// A run, judged.
#[derive(Debug)]
pub struct JudgedRun {
    /// Its file.
    pub path: PathBuf,
    /// How it was made.
    pub header: RunHeader,
    /// The judgement.
    pub card: Scorecard,
    /// The thresholds that are set, checked against it.
    pub checks: Vec<Check>,
}

impl JudgedRun {
    /// Reads a recording to its end. The scorer is made once the file is open; `watch` sees each
    /// item as [`of_recording`] shows it.
    ///
    /// # Errors
    /// If the file cannot be read, or the scorer cannot be made.
    pub fn open<E: From<RecordingError>>(
        path: PathBuf,
        limits: &Thresholds,
        scorer: impl FnOnce() -> Result<Scorer, E>,
        watch: impl FnMut(Duration, &Item),
    ) -> Result<Self, E> {
        let mut recording = Recording::open(&path)?;
        let card = of_recording(&mut recording, scorer()?, watch)?;
        let header = recording.header().clone();
        let checks = checks(limits, &card);
        Ok(Self { path, header, card, checks })
    }

    /// Its path, as text.
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// See [`against::setting`].
    pub fn setting(&self) -> String {
        against::setting(&self.header, &self.card)
    }

    /// As it is compared with a baseline.
    pub fn compared(&self) -> ComparedRun<'_> {
        ComparedRun { setting: self.setting(), model: self.model(), card: &self.card }
    }

    /// The thresholds that it misses, in words.
    pub fn missed(&self) -> impl Iterator<Item = &str> {
        self.checks.iter().filter(|check| !check.passed).map(|check| check.words.as_str())
    }

    /// The run, its model and its track.
    pub fn title(&self) -> String {
        let driver = self.model().map_or_else(String::new, |model| format!(", {model}"));
        let track = self.card.road().map_or_else(String::new, |road| format!(" on {road}"));
        let is_recorded = against::is_in_recorded_pictures(&self.header);
        let recorded = if is_recorded { format!(", {}", against::RECORDED) } else { String::new() };
        let seed = self.header.seed.map_or_else(String::new, |seed| format!(", seed {seed}"));
        format!("{}{driver}{track}{recorded}{seed}", self.name())
    }

    fn model(&self) -> Option<&str> {
        self.header.model.as_ref().map(|model| model.name.as_str())
    }
}

/// Runs that were scored, as one JSON: [`SCHEMA`]. A key's meaning never changes under one number; new keys may be
/// added.
#[derive(Debug, Serialize)]
pub struct Report<'a> {
    schema: &'static str,
    /// The score of each.
    pub runs: Vec<ScoredRun<'a>>,
    /// Under each figure's key, over the runs that report it.
    pub summary: BTreeMap<&'static str, Spread>,
    /// How they compare with earlier ones, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub against: Option<&'a Comparison>,
    /// Runs that could not be scored, and why.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub unscored: BTreeMap<&'a str, &'a str>,
}

/// A column of words: its name, and what it says of a run.
type Told<'a> = (&'static str, for<'r> fn(&'r ScoredRun<'a>) -> &'r str);

/// A run in a [`Report`].
#[derive(Debug, Serialize)]
pub struct ScoredRun<'a> {
    /// Its path.
    pub run: String,
    /// When it began, RFC 3339.
    pub started: String,
    /// Which model drove.
    pub model: Option<&'a str>,
    /// SHA-256 of its file.
    pub model_sha256: Option<&'a str>,
    /// The seed of everything random.
    pub seed: Option<u64>,
    /// What it may be compared with: see [`against::setting`].
    pub setting: String,
    /// The judgement.
    #[serde(flatten)]
    pub card: &'a Scorecard,
    /// The thresholds that it missed, in words.
    pub missed: Vec<&'a str>,
}

impl<'a> Report<'a> {
    /// A report on judged runs, and on those that could not be judged, each with the reason.
    pub fn new(runs: &[&'a JudgedRun], unscored: &'a [(String, String)], against: Option<&'a Comparison>) -> Self {
        let scored = |run: &&'a JudgedRun| ScoredRun {
            run: run.name(),
            started: run.header.started.to_string(),
            model: run.model(),
            model_sha256: run.header.model.as_ref().map(|model| model.sha256.as_str()),
            seed: run.header.seed,
            setting: run.setting(),
            card: &run.card,
            missed: run.missed().collect(),
        };
        let cards: Vec<_> = runs.iter().map(|run| &run.card).collect();
        Self {
            schema: SCHEMA,
            runs: runs.iter().map(scored).collect(),
            summary: summary(&cards),
            against,
            unscored: unscored.iter().map(|(name, why)| (name.as_str(), why.as_str())).collect(),
        }
    }

    /// A line for each run, and their mean.
    pub fn table(&self) -> String {
        let (rows, words) = self.rows();
        aligned(&rows, words)
            + "\n~ is an estimate, - not measurable, (2 runs) the mean of two runs; lapwing score RUN says more."
    }

    /// The same as cells: names of figures, runs, and their mean; and how many columns are words. Models and settings are told
    /// where they differ.
    pub(super) fn rows(&self) -> (Vec<Vec<String>>, usize) {
        let mut told: Vec<Told<'a>> = vec![("run", |run| &run.run)];
        let differing: [Told<'a>; 2] = [("model", |run| run.model.unwrap_or("-")), ("setting", |run| &run.setting)];
        let differs = |(_, of): &Told<'a>| self.runs.windows(2).any(|runs| of(&runs[0]) != of(&runs[1]));
        told.extend(differing.into_iter().filter(differs));
        let mut rows: Vec<Vec<String>> = vec![];
        let is_along = self.runs.iter().any(|run| run.card.value(Figure::FromLane).is_some());
        let figures: Vec<Figure> = COMPARED.into_iter().chain(ALONG.into_iter().filter(|_| is_along)).collect();
        let names = told.iter().map(|(name, _)| *name);
        rows.push(names.chain(figures.iter().map(|figure| figure.label())).map(str::to_owned).collect());
        for run in &self.runs {
            let cell = |figure: Figure| match run.card.get(figure) {
                Measure::Told(value) => figure.unit().show(value),
                Measure::Estimate { value, .. } => format!("~{}", figure.unit().show(value)),
                Measure::Unknown(_) => "-".to_owned(),
            };
            let damaged = if run.card.damaged { " (damaged)" } else { "" };
            let mut words: Vec<_> = told.iter().map(|(_, of)| of(run).to_owned()).collect();
            words[0] += damaged;
            rows.push(words.into_iter().chain(figures.iter().map(|figure| cell(*figure))).collect());
        }
        let mean = |figure: Figure| {
            let Some(spread) = self.summary.get(figure.key()) else { return "-".to_owned() };
            let is_estimate = |run: &ScoredRun<'_>| matches!(run.card.get(figure), Measure::Estimate { .. });
            let about = if self.runs.iter().any(is_estimate) { "~" } else { "" };
            // Where not all of them report it, of how many.
            let of =
                if spread.runs < self.runs.len() { format!(" ({})", count(spread.runs, "run")) } else { String::new() };
            format!("{about}{}{of}", figure.unit().show_mean(spread.mean))
        };
        let mut words = vec![String::new(); told.len()];
        if !self.runs.is_empty() {
            words[0] = format!("mean of {}", self.runs.len());
            rows.push(words.into_iter().chain(figures.iter().map(|figure| mean(*figure))).collect());
        }
        (rows, told.len())
    }
}

/// Every figure's key, unit, formula and source, a line each.
pub fn explained() -> String {
    let unit = |figure: Figure| match figure.unit() {
        Unit::Share => "0 to 1",
        Unit::Count => "count",
        Unit::Points => "0 to 100",
        Unit::Correlation => "-1 to 1",
        unit => unit.symbol(),
    };
    let line = |figure: Figure| format!("{:<27} {:<8} {}", figure.key(), unit(figure), figure.meaning());
    let sources = SOURCES.map(|(name, what)| format!("{name}: {what}")).join("\n");
    format!("{}\n\nSources:\n{sources}", Figure::ALL.map(line).join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lapwing_core::recording::{ModelId, RunKind};

    #[test]
    fn a_table_names_models_and_settings_where_they_differ() {
        let run = |model: &str, mph: f64| {
            let config = serde_json::json!({ "settings": { "control": { "speed_mph": mph } } });
            let model = Some(ModelId { name: model.into(), sha256: String::new() });
            let began = "2026-11-26T12:00:00Z".parse().unwrap();
            let header = RunHeader { model, ..RunHeader::new(RunKind::Driven, config, began) };
            JudgedRun { path: "run.mcap".into(), header, card: Scorer::default().finish(), checks: vec![] }
        };
        let words = |runs: [JudgedRun; 2]| {
            let runs: Vec<_> = runs.iter().collect();
            let (rows, words) = Report::new(&runs, &[], None).rows();
            assert!(rows.iter().all(|row| row.len() == rows[0].len()));
            rows.into_iter().map(|row| row[..words].join(", ")).collect::<Vec<_>>()
        };
        assert_eq!(words([run("a", 9.0), run("a", 9.0)]), ["run", "run.mcap", "run.mcap", "mean of 2"]);
        assert_eq!(Report::new(&[], &[], None).rows().0.len(), 1, "of nothing there is no mean");
        assert_eq!(words([run("a", 9.0), run("b", 9.0)])[..3], ["run, model", "run.mcap, a", "run.mcap, b"]);
        let [heads, first, ..] = &words([run("a", 9.0), run("b", 20.0)])[..] else { panic!() };
        assert_eq!(heads, "run, model, setting");
        assert!(first.starts_with("run.mcap, a, ") && first.ends_with("9 mph"), "{first}");
    }
}
