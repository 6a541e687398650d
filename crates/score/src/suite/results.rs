//! Results of cells, and the plan beside them, as files in a folder.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{Cell, Plan, plan};
use crate::score::{Figure, figure::wrong_figure};
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
    /// If too many of its frames were bad: how many, and why the first was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bad_frames: Option<String>,
    /// How long it took, in seconds of real time.
    pub took_s: f64,
    /// Its run, if it was kept and is still there: the path from the folder of the results, such as `runs/ID.mcap`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
}

impl Done {
    /// What was driven.
    pub fn new(cell: Cell, card: serde_json::Value, fingerprint: String, took_s: f64) -> Self {
        Self { schema: SCHEMA.into(), cell, card, fingerprint, bad_frames: None, took_s, run: None }
    }

    pub(super) fn value(&self, figure: Figure) -> Option<f64> {
        self.card.get(figure.key())?.as_f64()
    }

    /// What went wrong in the drive, in words: too many bad frames, laps not finished, collisions, times off the road. A figure
    /// that is not measurable is no failure.
    pub fn failed(&self) -> Option<String> {
        let completion = self.value(Figure::Completion).filter(|share| *share < 1.0);
        let completed = completion.map(|share| format!("{} driven", Figure::Completion.unit().show_mean(share)));
        let mut words: Vec<_> = self.bad_frames.clone().into_iter().chain(completed).collect();
        for (figure, what) in [(Figure::Collisions, "collision"), (Figure::OffRoads, "time off the road")] {
            if let Some(many) = self.value(figure).filter(|many| *many > 0.0) {
                let plural = if what == "collision" { "collisions" } else { "times off the road" };
                words.push(format!("{many} {}", if many == 1.0 { what } else { plural }));
            }
        }
        (!words.is_empty()).then(|| words.join(", "))
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

    /// Holds the folder for the driving of a suite, or of a shard of it beside others; see [`files::lock`].
    ///
    /// # Errors
    /// [`ResultsError::Io`] if another suite is driven there.
    pub fn lock(&self, is_shard: bool) -> Result<Option<File>, ResultsError> {
        files::lock(&self.0, is_shard).map_err(ResultsError::io("drive a suite there", &self.0))
    }

    /// Where the run of a cell is kept, from the folder of the results.
    pub(super) fn run_name(cell: &Cell) -> String {
        format!("runs/{}.mcap", cell.id())
    }

    /// The file of a run that is, or will be, kept.
    pub fn file(&self, run: &str) -> PathBuf {
        self.0.join(run)
    }

    /// Makes room for a cell's run: its folder exists, and what an interrupted drive left there is gone.
    pub(super) fn room_for_run(&self, cell: &Cell) -> Result<PathBuf, ResultsError> {
        let path = self.file(&Self::run_name(cell));
        let folder = path.parent().unwrap_or(&self.0);
        fs::create_dir_all(folder).map_err(ResultsError::io("make the folder", folder))?;
        self.drop_run(cell)?;
        Ok(path)
    }

    /// Deletes a cell's run, if there is one.
    pub(super) fn drop_run(&self, cell: &Cell) -> Result<(), ResultsError> {
        let path = self.file(&Self::run_name(cell));
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(ResultsError::io("delete the run", &path)(error))
            }
            _ => Ok(()),
        }
    }

    /// Copies the run of a result from another folder of results: whole or not at all.
    pub(super) fn take_run(&self, from: &Self, done: &Done) -> Result<(), ResultsError> {
        let Some(run) = &done.run else { return Ok(()) };
        let (from, to) = (from.file(run), self.room_for_run(&done.cell)?);
        let part = files::partial(&to).map_err(ResultsError::io("write the run", &to))?;
        fs::copy(&from, part.path()).map_err(ResultsError::io("copy the run", &from))?;
        part.persist(&to).map_err(|error| ResultsError::io("write the run", &to)(error.error))?;
        Ok(())
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
        match self.read_cell(&path) {
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
        Ok(paths.iter().map(|path| self.read_cell(path).map_err(|error| (id(path), error))).collect())
    }

    fn read_cell(&self, path: &Path) -> Result<Done, ResultsError> {
        let mut done = read(path, "the result of a cell", SCHEMA, |done: &Done| &done.schema)?;
        if let Some(got) = wrong_figure(|key| done.card.get(key)) {
            return Err(ResultsError::Content {
                path: path.to_owned(),
                expected: format!("the result of a cell ({SCHEMA})"),
                got: format!("a scorecard with a wrong figure: {got}"),
            });
        }
        // Whatever the file says of its run's place; and whoever needs the room deletes runs.
        done.run = done.run.map(|_| Self::run_name(&done.cell)).filter(|run| self.file(run).is_file());
        Ok(done)
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
