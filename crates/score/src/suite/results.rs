//! Results of cells, and the plan beside them, as files in a folder.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{Cell, Plan, plan};
use crate::score::Figure;
use lapwing_core::files;

/// The schema of a cell's file.
const SCHEMA: &str = "lapwing.cell/1";

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
    /// How long it took, in seconds of real time.
    pub took_s: f64,
}

impl Done {
    /// What was driven.
    pub fn new(cell: Cell, card: serde_json::Value, fingerprint: String, took_s: f64) -> Self {
        Self { schema: SCHEMA.into(), cell, card, fingerprint, took_s }
    }

    pub(super) fn value(&self, figure: Figure) -> Option<f64> {
        self.card.get(figure.key())?.as_f64()
    }
}

/// Why results cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ResultsError {
    /// An error of the system.
    #[error("{path}: cannot {what}: {source}")]
    Io {
        /// What was tried.
        what: &'static str,
        /// With what.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// A file with the wrong content for its name.
    #[error("{path}: expected {expected}, got {got}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What it should be.
        expected: String,
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

/// The id of a cell, and why its result cannot be read.
pub type Unreadable = (String, ResultsError);

impl Results {
    /// The results in this folder, which is created if it does not exist.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn open(folder: &Path) -> Result<Self, ResultsError> {
        let results = Self(folder.to_owned());
        let cells = results.cells();
        fs::create_dir_all(&cells).map_err(ResultsError::io("make the folder", &cells))?;
        Ok(results)
    }

    fn cells(&self) -> PathBuf {
        self.0.join("cells")
    }

    /// The result of a cell, if it was driven. A file that cannot be parsed, as after a disk failure, does not count
    /// and is logged.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn get(&self, cell: &Cell) -> Result<Option<Done>, ResultsError> {
        let path = self.cells().join(format!("{}.json", cell.id()));
        if !path.exists() {
            return Ok(None);
        }
        match read_cell(&path) {
            Ok(done) => Ok(Some(done)),
            Err(error @ ResultsError::Content { .. }) => {
                tracing::warn!("{error}; the cell counts as not driven");
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Writes a result: whole or not at all.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn keep(&self, done: &Done) -> Result<(), ResultsError> {
        let path = self.cells().join(format!("{}.json", done.cell.id()));
        write("write the result", &path, done)
    }

    /// All results in the folder, by the names of their files. One that cannot be read is an error of its own, with the
    /// id of its cell.
    ///
    /// # Errors
    /// [`ResultsError::Io`] if the folder cannot be read.
    pub fn all(&self) -> Result<Vec<Result<Done, Unreadable>>, ResultsError> {
        let cells = self.cells();
        let mut paths = vec![];
        for entry in fs::read_dir(&cells).map_err(ResultsError::io("read the folder", &cells))? {
            paths.push(entry.map_err(ResultsError::io("read the folder", &cells))?.path());
        }
        paths.retain(|path| path.extension().is_some_and(|extension| extension == "json"));
        paths.sort();
        let id = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(paths.iter().map(|path| read_cell(path).map_err(|error| (id(path), error))).collect())
    }

    fn plan_path(&self) -> PathBuf {
        self.0.join("plan.json")
    }

    /// The plan of the suite that was driven here last; none if it was driven before there were plans.
    ///
    /// # Errors
    /// [`ResultsError`].
    pub fn plan(&self) -> Result<Option<Plan>, ResultsError> {
        let path = self.plan_path();
        if !path.exists() {
            return Ok(None);
        }
        read(&path, "the plan of a suite", plan::SCHEMA, |plan: &Plan| &plan.schema).map(Some)
    }

    /// Writes a plan, replacing any that was there.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn keep_plan(&self, plan: &Plan) -> Result<(), ResultsError> {
        let there = || matches!(self.plan(), Ok(Some(there)) if there == *plan);
        if there() {
            return Ok(());
        }
        let path = self.plan_path();
        // If parts share a folder and begin at once, one plan is enough.
        write("write the plan", &path, plan).or_else(|error| if there() { Ok(()) } else { Err(error) })
    }
}

/// Writes a file: whole or not at all.
fn write(what: &'static str, path: &Path, content: &impl Serialize) -> Result<(), ResultsError> {
    let written = serde_json::to_vec_pretty(content).map_err(io::Error::from);
    written.and_then(|bytes| files::write(path, &bytes)).map_err(ResultsError::io(what, path))
}

fn read_cell(path: &Path) -> Result<Done, ResultsError> {
    read(path, "the result of a cell", SCHEMA, |done: &Done| &done.schema)
}

/// Reads a file that names its own schema.
fn read<T: DeserializeOwned>(
    path: &Path,
    what: &str,
    schema: &str,
    schema_of: impl Fn(&T) -> &str,
) -> Result<T, ResultsError> {
    let bytes = fs::read(path).map_err(ResultsError::io("read the file", path))?;
    let not = |got| ResultsError::Content { path: path.to_owned(), expected: format!("{what} ({schema})"), got };
    let read: T = serde_json::from_slice(&bytes).map_err(|why| not(why.to_string()))?;
    if schema_of(&read) == schema { Ok(read) } else { Err(not(schema_of(&read).to_owned())) }
}
