//! Merges the results of a suite's parts into one folder, and reports what is missing.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use lapwing_core::words::count;

use super::{Cell, Done, Plan, Results, ResultsError, SuiteOutcome, drive::told_apart, groups};

/// Parts that cannot be put together.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// Not the folder of a suite.
    #[error("{}: expected the folder of a suite, with results of drives in it", .0.display())]
    NoSuite(PathBuf),
    /// A folder or a file in it.
    #[error(transparent)]
    Results(#[from] ResultsError),
    /// Two parts have different results of one cell.
    #[error("{cell}: driven twice, with different frames: {one} and {other}")]
    Differ {
        /// The cell, by its name for people.
        cell: String,
        /// A fingerprint.
        one: String,
        /// The other.
        other: String,
    },
}

/// The result of a merge.
#[derive(Debug)]
pub struct Merged {
    /// The outcome of the results.
    pub outcome: SuiteOutcome,
    /// Cells that have a result.
    pub present: usize,
    /// All cells of the plans; none where no folder has a plan.
    pub plan: Option<Plan>,
    /// How many of these have no result.
    pub without: usize,
    /// The cells without a result, by their names for people; a cell that no plan contains, by its id.
    pub missing: Vec<String>,
    /// Folders that have no plan.
    pub unplanned: Vec<PathBuf>,
    /// Whether the parts plan different cells.
    pub plans_differ: bool,
    /// Whether any file could not be read; each was warned of.
    pub corrupt: bool,
    /// Results that repeat another, because a different seed would not change their drives.
    pub left_out: usize,
}

impl Merged {
    /// Whether nothing is missing and nothing was corrupt.
    pub fn is_whole(&self) -> bool {
        self.missing.is_empty() && !self.corrupt
    }
}

/// Whether these are the folders of suites.
///
/// # Errors
/// [`MergeError::NoSuite`] for the first that is not.
pub fn check_parts(folders: &[PathBuf]) -> Result<(), MergeError> {
    match folders.iter().find(|folder| !folder.join("cells").is_dir()) {
        Some(folder) => Err(MergeError::NoSuite(folder.clone())),
        None => Ok(()),
    }
}

/// Copies the results of parts into a folder, which may have some already, and returns the outcome of all of them.
/// `left_to_chance` says whether another seed changes a cell's pictures, as [`Course`](super::Course) does.
///
/// # Errors
/// [`MergeError`].
pub fn merge(folders: &[PathBuf], out: &Path, left_to_chance: impl Fn(&Cell) -> bool) -> Result<Merged, MergeError> {
    check_parts(folders)?;
    let target = Results::open(out)?;
    let mut gathered = Gathered::default();
    gathered.plan_of(&target);
    for folder in folders {
        let part = Results::open(folder)?;
        if !gathered.plan_of(&part) {
            gathered.unplanned.push(folder.clone());
        }
        for mut done in gathered.readable(&part)? {
            // Whatever the part says of its place.
            done.run = done.run.map(|_| Results::run_name(&done.cell));
            match target.get(&done.cell)? {
                Some(other) if other.fingerprint != done.fingerprint => {
                    let (one, other) = (other.fingerprint, done.fingerprint);
                    return Err(MergeError::Differ { cell: done.cell.to_string(), one, other });
                }
                // The same drive, whose run only this part has kept.
                Some(mut known) if known.run.is_none() && done.run.is_some() => {
                    target.take_run(&part, &done)?;
                    known.run.clone_from(&done.run);
                    target.keep(&known)?;
                }
                Some(_) => {}
                None => {
                    // The run first: a result with a run has it.
                    target.take_run(&part, &done)?;
                    target.keep(&done)?;
                }
            }
        }
    }
    let mut done = gathered.readable(&target)?;
    let plan = gathered.plan();
    if let Some(plan) = &plan {
        target.keep_plan(plan)?;
    }
    if let Some(plan) = plan.as_ref().filter(|_| gathered.unplanned.is_empty()) {
        // Of a pilot that was withdrawn, or a network that was replaced, since then.
        let all = done.len();
        done.retain(|done| plan.has(&done.cell.id()));
        if done.len() < all {
            tracing::warn!("{} left out, which no part plans any more", count(all - done.len(), "result"));
        }
    }
    let missing = gathered.missing(plan.as_ref(), &done);
    let without = plan.as_ref().map_or(0, |plan| plan.missing(&done).len());
    let present = done.len();
    done.sort_by_key(|done| done.cell.seed);
    let done = told_apart(done, |done| &done.cell, left_to_chance);
    Ok(Merged {
        outcome: SuiteOutcome::new(groups(&done), plan.as_ref().map(Plan::count), missing.len()),
        present,
        plan,
        without,
        missing,
        plans_differ: gathered.plans.len() > 1,
        unplanned: gathered.unplanned,
        corrupt: gathered.corrupt,
        left_out: present - done.len(),
    })
}

/// The contents of the folders.
#[derive(Default)]
struct Gathered {
    /// Each once.
    plans: Vec<Plan>,
    /// Folders without one.
    unplanned: Vec<PathBuf>,
    /// Ids of cells whose files cannot be read.
    unreadable: BTreeSet<String>,
    /// Whether any file could not be read.
    corrupt: bool,
}

impl Gathered {
    /// Takes in a folder's plan; returns whether there is a file for it.
    fn plan_of(&mut self, results: &Results) -> bool {
        match results.plan() {
            Ok(None) => return false,
            Ok(Some(plan)) if self.plans.contains(&plan) => {}
            Ok(Some(plan)) => self.plans.push(plan),
            Err(error) => self.warn(&error),
        }
        true
    }

    /// A folder's results, except those that cannot be read: these are logged and count as missing.
    fn readable(&mut self, results: &Results) -> Result<Vec<Done>, ResultsError> {
        let mut readable = vec![];
        for one in results.all()? {
            match one {
                Ok(done) => readable.push(done),
                Err((id, error)) => {
                    self.warn(&error);
                    self.unreadable.insert(id);
                }
            }
        }
        Ok(readable)
    }

    fn warn(&mut self, error: &ResultsError) {
        tracing::warn!("{error}");
        self.corrupt = true;
    }

    /// All plans in one.
    fn plan(&self) -> Option<Plan> {
        self.plans.iter().cloned().reduce(|mut all, plan| {
            all.add(plan);
            all
        })
    }

    /// The cells without a result, by their names for people; a cell that no plan contains, by its id.
    fn missing(&self, plan: Option<&Plan>, done: &[Done]) -> Vec<String> {
        let mut missing: Vec<_> = plan.map(|plan| plan.missing(done)).unwrap_or_default();
        let there: BTreeSet<_> = done.iter().map(|done| done.cell.id()).collect();
        let unplanned = |id: &&String| !there.contains(*id) && !plan.is_some_and(|plan| plan.has(id));
        missing.extend(self.unreadable.iter().filter(unplanned).map(String::as_str));
        missing.into_iter().map(str::to_owned).collect()
    }
}

#[cfg(test)]
#[path = "merge_tests.rs"]
mod tests;
