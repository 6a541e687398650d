//! `lapwing score`: what recorded runs were worth.

use std::{
    cell::OnceCell,
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use serde::Serialize;

use super::{Ended, thresholds};
use crate::{
    cli,
    config::Thresholds,
    odometry::Road,
    protocol::Dialect,
    recording::{RunHeader, RunReader},
    score::{
        self, Check, Figure, Scorecard, Scorer,
        against::{Baseline, Change, Turn, changes},
        junit,
        page::{self, Collector, Drawn, Outline, Shown},
        summary::{Spread, summary},
    },
    simulator::{survey, track::Track},
};

/// What the JSON is called.
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
    #[serde(skip_serializing_if = "Vec::is_empty")]
    against: Vec<Change>,
}

#[derive(Serialize)]
struct Scored<'a> {
    run: String,
    started: String,
    model: Option<&'a str>,
    model_sha256: Option<&'a str>,
    seed: Option<u64>,
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
        let names = Track::NAMES.into_iter().chain(self.arguments.tracks.iter().map(String::as_str));
        let known = names.map(|name| Ok(Arc::new(survey::known_road(name)?))).collect::<anyhow::Result<_>>()?;
        Ok(self.known.get_or_init(|| known))
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
        let mut reader = RunReader::open(&path)?;
        let scorer = match reader.header().dialect {
            // Whatever another build leaves untold, it is not the position.
            None | Some(Dialect::Term1) => Scorer::on(roads.known()?, Some(roads.arguments.laps)),
            Some(_) => Scorer::default(),
        };
        let mut collector = for_page.then(Collector::default);
        let card = score::of_run(&mut reader, scorer, |at, item| {
            if let Some(collector) = &mut collector {
                collector.item(at, item);
            }
        })?;
        let checks = score::checks(limits, &card);
        let drawn = collector.map(|collector| (collector.finish(), card.track.as_deref().and_then(outline)));
        Ok(Self { header: reader.header().clone(), path, card, checks, drawn })
    }

    fn name(&self) -> String {
        self.path.display().to_string()
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
        super::print(&explained());
        return Ok(Ended::Passed);
    }
    let limits = thresholds::layers(super::undriven_layers(config)?, &arguments.thresholds)?.resolve()?.thresholds;
    let paths = files(&arguments.runs)?;
    let roads = Roads { arguments, known: OnceCell::new() };
    let runs = paths
        .into_iter()
        .map(|path| Run::open(path, &limits, &roads, arguments.html.is_some()))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let cards: Vec<_> = runs.iter().map(|run| &run.card).collect();
    let summary = summary(&cards);
    let against = arguments.against.as_deref().map(|path| Ok::<_, anyhow::Error>(changes(&baseline(path)?, &summary)));
    let against = against.transpose()?.unwrap_or_default();
    if let Some(path) = &arguments.junit {
        let cases: Vec<_> = runs.iter().map(|run| (run.name(), &run.card, run.checks.clone())).collect();
        fs::write(path, junit::report(&cases)?).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    if let Some(path) = &arguments.html {
        fs::write(path, page(&runs)?).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    if arguments.json {
        let scored = runs.iter().map(|run| Scored {
            run: run.name(),
            started: run.header.started.to_string(),
            model: run.model(),
            model_sha256: run.header.model.as_ref().map(|model| model.sha256.as_str()),
            seed: run.header.seed,
            card: &run.card,
            missed: run.missed().collect(),
        });
        let result = Result_ { schema: SCHEMA, runs: scored.collect(), summary, against: against.clone() };
        super::print(&serde_json::to_string_pretty(&result)?);
    } else if let [run] = &runs[..] {
        super::print(&format!("{}\n{}", run.title(), run.card));
    } else {
        super::print(&table(&runs, &summary));
    }
    if !arguments.json {
        for change in against.iter().filter(|change| change.turn == Turn::Better) {
            super::print(&format!("better: {change}"));
        }
    }
    let named = |run: &Run| run.missed().map(|missed| format!("{}: {missed}", run.name())).collect::<Vec<_>>();
    let worse = against.iter().filter(|change| change.turn == Turn::Worse).map(|change| format!("worse: {change}"));
    Ok(thresholds::ended(&runs.iter().flat_map(named).chain(worse).collect::<Vec<_>>()))
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

/// The edges of a track that Lapwing knows by name.
fn outline(name: &str) -> Option<Outline> {
    let track = Track::open(name).ok()?;
    let edge = |offset: f64| {
        let steps = (track.length() / OUTLINE_M).ceil() as u32;
        let point = |i| track.point(f64::from(i) * OUTLINE_M, offset);
        (0..steps).map(point).map(|point| [point.x as f32, point.z as f32]).collect()
    };
    Some(Outline { left: edge(-track.half_width()), right: edge(track.half_width()) })
}

/// The runs that are meant; of a folder all in it, by name.
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
            inside.push(entry.with_context(cannot)?.path());
        }
        inside.retain(|file| file.extension().is_some_and(|extension| extension == "mcap"));
        if inside.is_empty() {
            bail!("{}: expected runs (.mcap) in the folder, got none", path.display());
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
        let cell = |figure: Figure| run.card.value(figure).map_or_else(|| "-".to_owned(), |v| figure.unit().show(v));
        rows.push(std::iter::once(run.name()).chain(COMPARED.map(cell)).collect());
    }
    let mean = |figure: Figure| {
        spreads.get(figure.key()).map_or_else(|| "-".to_owned(), |spread| figure.unit().show_mean(spread.mean))
    };
    rows.push(std::iter::once(format!("mean of {}", runs.len())).chain(COMPARED.map(mean)).collect());
    score::aligned(&rows, 1) + "\n- is not measurable; lapwing score RUN says why."
}

/// Every figure's key, unit, formula and source.
fn explained() -> String {
    let line = |figure: Figure| format!("{:<27} {}", figure.key(), figure.meaning());
    Figure::ALL.map(line).join("\n")
}
