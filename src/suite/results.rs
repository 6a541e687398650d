//! Results of cells: files, groups over seeds, and the table.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::Cell;
use crate::score::{Figure, Spread, aligned};

/// What the file of a cell is called.
const SCHEMA: &str = "lapwing.cell/1";
/// Figures of the table.
const SHOWN: [Figure; 6] =
    [Figure::Completion, Figure::Collisions, Figure::OffRoads, Figure::MeanCte, Figure::Autonomy, Figure::DrivingScore];

/// A cell that was driven.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Done {
    schema: String,
    /// Which.
    pub cell: Cell,
    /// Its scorecard.
    pub card: serde_json::Value,
    /// The hash of its frames and commands.
    pub fingerprint: String,
    /// How long it took, in seconds on the wall.
    pub took_s: f64,
}

impl Done {
    /// What was driven.
    pub fn new(cell: Cell, card: serde_json::Value, fingerprint: String, took_s: f64) -> Self {
        Self { schema: SCHEMA.into(), cell, card, fingerprint, took_s }
    }

    fn value(&self, figure: Figure) -> Option<f64> {
        self.card.get(figure.key())?.as_f64()
    }
}

/// Why results are not to be had.
#[derive(Debug, thiserror::Error)]
pub enum ResultsError {
    /// The system's word.
    #[error("{path}: cannot {what}: {source}")]
    Io {
        /// What was tried.
        what: &'static str,
        /// With what.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// Not the result of a cell.
    #[error("{path}: expected the result of a cell ({SCHEMA}), got {got}")]
    NotACell {
        /// The file.
        path: PathBuf,
        /// What it is.
        got: String,
    },
}

impl ResultsError {
    fn io(what: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { what, path, source }
    }
}

/// The folder of a suite's results.
#[derive(Debug, Clone)]
pub struct Results(PathBuf);

impl Results {
    /// In this folder, which is made where it is not there.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn open(folder: &Path) -> Result<Self, ResultsError> {
        let cells = folder.join("cells");
        fs::create_dir_all(&cells).map_err(ResultsError::io("make the folder", &cells))?;
        Ok(Self(cells))
    }

    fn path(&self, cell: &Cell) -> PathBuf {
        self.0.join(format!("{}.json", cell.id()))
    }

    /// The result of a cell, if it was driven. A file that cannot be understood, as a failing disk leaves it, is none;
    /// that is logged.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn get(&self, cell: &Cell) -> Result<Option<Done>, ResultsError> {
        let path = self.path(cell);
        if !path.exists() {
            return Ok(None);
        }
        match read(&path) {
            Ok(done) => Ok(Some(done)),
            Err(error @ ResultsError::NotACell { .. }) => {
                tracing::warn!("{error}; it is driven again");
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Keeps a result: whole or not at all.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn keep(&self, done: &Done) -> Result<(), ResultsError> {
        let path = self.path(&done.cell);
        let partial = path.with_extension("partial");
        let write = || {
            let mut file = fs::File::create(&partial)?;
            file.write_all(&serde_json::to_vec_pretty(done)?)?;
            file.sync_all()?;
            fs::rename(&partial, &path)
        };
        write().map_err(ResultsError::io("write the result", &path))
    }

    /// All results that lie here, in no order.
    ///
    /// # Errors
    /// [`ResultsError`].
    pub fn all(&self) -> Result<Vec<Done>, ResultsError> {
        let mut all = vec![];
        for entry in fs::read_dir(&self.0).map_err(ResultsError::io("read the folder", &self.0))? {
            let path = entry.map_err(ResultsError::io("read the folder", &self.0))?.path();
            if path.extension().is_some_and(|extension| extension == "json") {
                all.push(read(&path)?);
            }
        }
        Ok(all)
    }
}

fn read(path: &Path) -> Result<Done, ResultsError> {
    let bytes = fs::read(path).map_err(ResultsError::io("read the result", path))?;
    let not = |got: String| ResultsError::NotACell { path: path.to_owned(), got };
    let done: Done = serde_json::from_slice(&bytes).map_err(|why| not(why.to_string()))?;
    if done.schema == SCHEMA { Ok(done) } else { Err(not(done.schema)) }
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
}

/// A figure over seeds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Over {
    /// Its spread.
    #[serde(flatten)]
    pub spread: Spread,
    /// Half the width of the mean's confidence interval at 95 %, by Student's t; none of a single seed.
    pub confidence: Option<f64>,
}

/// Groups in the order of pilot, track, conditions and speed. Where cells of one name were driven with other models, laps
/// or settings, the pilot's name says which.
pub fn groups(done: &[Done]) -> Vec<Group> {
    let mut by_key: BTreeMap<_, Vec<&Done>> = BTreeMap::new();
    for one in done {
        let Cell { pilot, model_sha256, track, conditions, speed_mph, laps, longest_s, settings, .. } = &one.cell;
        let mut settings = settings.clone();
        // What the group's name says already.
        for (section, said) in [("simulator", "track"), ("control", "speed_mph")] {
            settings.get_mut(section).and_then(Value::as_object_mut).and_then(|section| section.remove(said));
        }
        let others = format!("{model_sha256:?} {laps} {longest_s} {settings}");
        // The bits of positive numbers are ordered as they are.
        by_key.entry((pilot, track, conditions, speed_mph.to_bits(), others)).or_default().push(one);
    }
    let several = |pilot: &str| {
        let others = by_key.keys().filter(|key| key.0 == pilot).map(|key| &key.4);
        others.collect::<BTreeSet<_>>().len() > 1
    };
    let group = |(key, done): (&(&String, _, _, _, String), &Vec<&Done>)| {
        let Cell { mut pilot, model_sha256, track, conditions, speed_mph, .. } = done[0].cell.clone();
        if several(&pilot) {
            let id: String = Sha256::digest(&key.4).iter().take(3).map(|byte| format!("{byte:02x}")).collect();
            pilot = format!("{pilot} (settings {id})");
        }
        let over = |figure: Figure| {
            let values: Vec<_> = done.iter().filter_map(|one| one.value(figure)).collect();
            let spread = Spread::of(&values)?;
            Some((figure.key(), Over { confidence: spread.confidence(), spread }))
        };
        let figures = Figure::ALL.into_iter().filter_map(over).collect();
        Group { pilot, model_sha256, track, conditions, speed_mph, figures }
    };
    by_key.iter().map(group).collect()
}

/// A line for each group.
pub fn table(groups: &[Group]) -> String {
    let mut rows = vec![["pilot", "track", "conditions", "mph", "seeds"].map(str::to_owned).to_vec()];
    rows[0].extend(SHOWN.map(|figure| figure.label().to_owned()));
    for group in groups {
        let seeds = group.figures.get(Figure::TimeS.key()).map_or(0, |over| over.spread.runs);
        let Group { pilot, track, conditions, speed_mph, .. } = group;
        let mut row = vec![pilot.clone(), track.clone(), conditions.clone(), speed_mph.to_string(), seeds.to_string()];
        row.extend(SHOWN.map(|figure| group.figures.get(figure.key()).map_or("-".into(), |over| over.words(figure))));
        rows.push(row);
    }
    aligned(&rows, 3)
}

impl Over {
    fn words(&self, figure: Figure) -> String {
        let show = |mean: f64| figure.unit().show_mean(mean);
        let confidence = self.confidence.map_or_else(String::new, |half| format!(" ± {}", show(half)));
        show(self.spread.mean) + &confidence
    }
}
