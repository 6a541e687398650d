//! `lapwing score`: what recorded runs were worth.

use std::{
    cell::OnceCell,
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use glam::DVec3;
use serde::Serialize;

use super::{Ended, outputs, thresholds};
use crate::{cli, known};
use lapwing_core::{
    config::Thresholds,
    recording::udacity::DrivingLog,
    recording::{Item, RunHeader, RunReader, is_run},
    words::count,
};
use lapwing_score::{
    odometry::Road,
    score::against::{self, Baseline, Comparison, Turn},
    score::page::{self, Collector, Drawn, Outline, Shown},
    score::summary::{Spread, summary},
    score::{self, Check, Figure, Measure, Scorecard, Scorer, Unit, junit},
};
use lapwing_sim::track::Track;

/// What the JSON is called; a key's meaning never changes under one number, new keys may come. It is one object:
///
/// | key | holds |
/// |---|---|
/// | `schema` | this |
/// | `runs` | of each run: `run` (its path), `started` (RFC 3339), `model`, `model_sha256`, `seed`, `setting` ([`against::setting`]), all keys of a [`Scorecard`], and `missed`, the thresholds that it missed, in words |
/// | `summary` | under each figure's key, over the runs that tell it, a [`Spread`]: `runs`, `mean`, `deviation`, `least`, `most` |
/// | `against` | with `--against`, a [`Comparison`]: `changes` (`setting`, `figure`, `before`, `now`, `noise`, `turn`), `missing`, `new` |
/// | `unscored` | under the path of each run that could not be scored, why |
const SCHEMA: &str = "lapwing.score/1";

/// Metres between points of a road's edge on the page.
const OUTLINE_M: f64 = 3.0;

/// Figures that stand in the table of several runs.
const COMPARED: [Figure; 8] = [
    Figure::Completion,
    Figure::Collisions,
    Figure::OffRoads,
    Figure::MeanCte,
    Figure::Autonomy,
    Figure::DrivingScore,
    Figure::MeanMph,
    Figure::SteeringRate,
];

#[derive(Serialize)]
struct Result_<'a> {
    schema: &'static str,
    runs: Vec<Scored<'a>>,
    summary: BTreeMap<&'static str, Spread>,
    #[serde(skip_serializing_if = "Option::is_none")]
    against: Option<&'a Comparison>,
    /// Runs that could not be scored, and why.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    unscored: BTreeMap<&'a str, &'a str>,
}

#[derive(Serialize)]
struct Scored<'a> {
    run: String,
    started: String,
    model: Option<&'a str>,
    model_sha256: Option<&'a str>,
    seed: Option<u64>,
    setting: String,
    #[serde(flatten)]
    card: &'a Scorecard,
    missed: Vec<&'a str>,
}

/// Roads that a run may be on which does not say; made once they are asked for.
struct Roads<'a> {
    arguments: &'a cli::Score,
    known: OnceCell<Vec<Arc<Road>>>,
}

impl Roads<'_> {
    fn known(&self) -> anyhow::Result<&[Arc<Road>]> {
        if let Some(known) = self.known.get() {
            return Ok(known);
        }
        let known = self.names().map(|name| Ok(Arc::new(known::known_road(name)?))).collect::<anyhow::Result<_>>()?;
        Ok(self.known.get_or_init(|| known))
    }

    /// As [`Track::open`] takes them.
    fn names(&self) -> impl Iterator<Item = &str> {
        Track::NAMES.into_iter().chain(self.arguments.tracks.iter().map(String::as_str))
    }

    /// The track that calls itself so, if it is known.
    fn track(&self, name: &str) -> Option<Track> {
        let known = |track: &Track| track.file().name == name;
        Track::open(name).ok().or_else(|| self.names().filter_map(|name| Track::open(name).ok()).find(known))
    }
}

/// A run, judged.
struct Run {
    path: PathBuf,
    header: RunHeader,
    card: Scorecard,
    checks: Vec<Check>,
    /// What a page shows of it, where one is asked for.
    drawn: Option<(Drawn, Option<Outline>)>,
}

impl Run {
    fn open(path: PathBuf, limits: &Thresholds, roads: &Roads<'_>, for_page: bool) -> anyhow::Result<Self> {
        let mut collector = for_page.then(Collector::default);
        let watch = |at, item: &Item| collector.iter_mut().for_each(|collector| collector.item(at, item));
        let blind = || Ok::<_, anyhow::Error>(Scorer::on(roads.known()?, Some(roads.arguments.laps)));
        let (header, card) = if is_run(&path) {
            let mut reader = RunReader::open(&path)?;
            let card = score::of_run(&mut reader, blind()?, watch)?;
            (reader.header().clone(), card)
        } else {
            let log = DrivingLog::open(&path)?;
            (log.header(), score::of_log(&log, blind()?, watch))
        };
        let checks = score::checks(limits, &card);
        let track = card.track.as_deref().filter(|_| for_page).and_then(|name| roads.track(name));
        let drawn = collector.map(|collector| {
            let mut drawn = collector.finish();
            if let Some(track) = &track {
                drawn.locate(&whereabouts(&card, track));
            }
            (drawn, track.as_ref().map(outline))
        });
        Ok(Self { header, path, card, checks, drawn })
    }

    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn setting(&self) -> String {
        against::setting(&self.header, &self.card)
    }

    fn model(&self) -> Option<&str> {
        self.header.model.as_ref().map(|model| model.name.as_str())
    }

    fn missed(&self) -> impl Iterator<Item = &str> {
        self.checks.iter().filter(|check| !check.passed).map(|check| check.words.as_str())
    }

    fn title(&self) -> String {
        let driver = self.model().map_or_else(String::new, |model| format!(", {model}"));
        let track = self.card.track.as_ref().map_or_else(String::new, |track| format!(" on {track}"));
        let seed = self.header.seed.map_or_else(String::new, |seed| format!(", seed {seed}"));
        format!("{}{driver}{track}{seed}", self.name())
    }
}

pub(super) fn run(arguments: &cli::Score, config: Option<&Path>) -> anyhow::Result<Ended> {
    if arguments.explain {
        super::print(&explained())?;
        return Ok(Ended::Passed);
    }
    let limits = thresholds::layers(super::undriven_layers(config)?, &arguments.thresholds)?.resolve()?.thresholds;
    arguments.tracks.iter().try_for_each(|name| Track::open(name).map(drop))?;
    let baseline = arguments.against.as_deref().map(baseline).transpose()?;
    [&arguments.junit, &arguments.html].into_iter().flatten().try_for_each(|path| outputs::check(path))?;
    let paths = files(&arguments.runs)?;
    let roads = Roads { arguments, known: OnceCell::new() };
    let (mut runs, mut unscored) = (vec![], vec![]);
    for path in paths {
        let name = path.display().to_string();
        match Run::open(path, &limits, &roads, arguments.html.is_some()) {
            Ok(run) => runs.push(run),
            Err(error) => unscored.push((name, super::told(&error))),
        }
    }
    let cards: Vec<_> = runs.iter().map(|run| &run.card).collect();
    let summary = summary(&cards);
    let settings: Vec<_> = runs.iter().map(|run| (run.setting(), &run.card)).collect();
    let against = baseline.map(|baseline| baseline.compare(&settings));
    // What cannot be written takes nothing else with it.
    let written = [
        arguments.junit.as_deref().map(|path| {
            let cases: Vec<_> = runs.iter().map(|run| (run.name(), &run.card, run.checks.clone())).collect();
            outputs::write(path, &junit::report(&cases, &unscored, against.as_ref())?)
        }),
        arguments.html.as_deref().map(|path| outputs::write(path, &page(&runs)?)),
    ];
    let result = if arguments.json {
        let scored = runs.iter().map(|run| Scored {
            run: run.name(),
            started: run.header.started.to_string(),
            model: run.model(),
            model_sha256: run.header.model.as_ref().map(|model| model.sha256.as_str()),
            seed: run.header.seed,
            setting: run.setting(),
            card: &run.card,
            missed: run.missed().collect(),
        });
        let unscored = unscored.iter().map(|(name, why)| (name.as_str(), why.as_str())).collect();
        let result = Result_ { schema: SCHEMA, runs: scored.collect(), summary, against: against.as_ref(), unscored };
        Some(serde_json::to_string_pretty(&result)?)
    } else {
        match &runs[..] {
            [] => None,
            [run] => Some(format!("{}\n{}", run.title(), run.card)),
            _ => Some(table(&runs, &summary)),
        }
    };
    let printed = result.map_or(Ok(()), |result| super::print(&result));
    for change in against.iter().flat_map(|against| &against.changes).filter(|change| change.turn == Turn::Better) {
        say!("better: {change}");
    }
    for setting in against.iter().flat_map(|against| &against.new) {
        say!("not compared: {setting}: the baseline has no run");
    }
    let named = |run: &Run| run.missed().map(|missed| format!("{}: {missed}", run.name())).collect::<Vec<_>>();
    let worse = against.iter().flat_map(Comparison::worse).map(|worse| format!("worse: {worse}"));
    let ended = thresholds::ended(&runs.iter().flat_map(named).chain(worse).collect::<Vec<_>>());
    written.into_iter().flatten().collect::<Result<(), _>>()?;
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

fn baseline(path: &Path) -> anyhow::Result<Baseline> {
    let cannot = || format!("{}: expected the JSON of lapwing score", path.display());
    let text = fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let baseline: Baseline = serde_json::from_str(&text).with_context(cannot)?;
    if baseline.schema != SCHEMA {
        bail!("{}: expected schema {SCHEMA}, got {:?}", path.display(), baseline.schema);
    }
    Ok(baseline)
}

fn page(runs: &[Run]) -> Result<String, serde_json::Error> {
    let shown = runs.iter().filter_map(|run| {
        let (drawn, outline) = run.drawn.as_ref()?;
        let missed = run.missed().collect();
        Some(Shown { title: run.title(), card: &run.card, drawn, outline: outline.as_ref(), missed })
    });
    page::render(&shown.collect::<Vec<_>>())
}

/// A track's edges.
fn outline(track: &Track) -> Outline {
    let edge = |offset: f64| {
        let steps = (track.length() / OUTLINE_M).ceil() as u32;
        (0..steps).map(|i| from_above(track.point(f64::from(i) * OUTLINE_M, offset))).collect()
    };
    Outline { left: edge(-track.half_width()), right: edge(track.half_width()) }
}

/// Where a run that tells no position seems to have been: seconds, and places on the line to drive.
fn whereabouts(card: &Scorecard, track: &Track) -> Vec<(f64, [f32; 2])> {
    card.whereabouts.iter().map(|(at, s)| (*at, from_above(track.on_driving_line(*s).position))).collect()
}

fn from_above(point: DVec3) -> [f32; 2] {
    [point.x as f32, point.z as f32]
}

fn ends(file: &Path, ending: &str) -> bool {
    file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(ending))
}

/// The runs and driving logs that are meant; of a folder all in it, by name.
fn files(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = vec![];
    for path in paths {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let cannot = || format!("{}: cannot be read", path.display());
        let mut inside = vec![];
        for entry in fs::read_dir(path).with_context(cannot)? {
            let file = entry.with_context(cannot)?.path();
            anyhow::ensure!(file.to_str().is_some(), "{file:?}: expected a name in UTF-8");
            inside.push(file);
        }
        let pictures = inside.iter().filter(|file| ends(file, "jpg")).count();
        inside.retain(|file| ends(file, "mcap") || file.file_name().is_some_and(|name| name == "driving_log.csv"));
        if inside.is_empty() {
            let got = match pictures {
                0 => "neither".to_owned(),
                n => {
                    let pictures = count(n, "picture");
                    format!(
                        "{pictures} alone, which tell neither speed nor steering: let lapwing serve record the drive"
                    )
                }
            };
            bail!("{}: expected runs (.mcap) or a driving_log.csv in the folder, got {got}", path.display());
        }
        inside.sort();
        files.extend(inside);
    }
    // A run that is named twice is one.
    let mut seen = std::collections::HashSet::new();
    files.retain(|file| seen.insert(fs::canonicalize(file).unwrap_or_else(|_| file.clone())));
    Ok(files)
}

/// A line for each run, and their mean.
fn table(runs: &[Run], spreads: &BTreeMap<&'static str, Spread>) -> String {
    let mut rows: Vec<Vec<String>> = vec![];
    rows.push(std::iter::once("run").chain(COMPARED.map(Figure::label)).map(str::to_owned).collect());
    for run in runs {
        let cell = |figure: Figure| match run.card.get(figure) {
            Measure::Told(value) => figure.unit().show(value),
            Measure::Estimate { value, .. } => format!("~{}", figure.unit().show(value)),
            Measure::Unknown(_) => "-".to_owned(),
        };
        rows.push(std::iter::once(run.name()).chain(COMPARED.map(cell)).collect());
    }
    let mean = |figure: Figure| {
        spreads.get(figure.key()).map_or_else(|| "-".to_owned(), |spread| figure.unit().show_mean(spread.mean))
    };
    rows.push(std::iter::once(format!("mean of {}", runs.len())).chain(COMPARED.map(mean)).collect());
    score::aligned(&rows, 1) + "\n~ is an estimate, - not measurable; lapwing score RUN says more."
}

/// Every figure's key, unit, formula and source.
fn explained() -> String {
    let unit = |figure: Figure| match figure.unit() {
        Unit::Share => "0 to 1",
        Unit::Count => "count",
        Unit::Points => "0 to 100",
        Unit::Correlation => "-1 to 1",
        unit => unit.symbol(),
    };
    let line = |figure: Figure| format!("{:<27} {:<8} {}", figure.key(), unit(figure), figure.meaning());
    Figure::ALL.map(line).join("\n")
}
