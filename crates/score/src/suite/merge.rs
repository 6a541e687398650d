//! Merges the results of a suite's parts into one folder, and reports what is missing.

use std::{
    collections::{BTreeMap, BTreeSet},
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
    /// Two folders have different results of one cell.
    #[error(
        "{cell}: expected the same frames in both folders, got different ones in {one} and {other} (a different processor or libtorch?): \
         delete cells/{id}.json in one of them{more}",
        one = one.display(), other = other.display(),
        more = if *more == 0 { String::new() } else { format!("; likewise {}, so better leave one of the folders out", count(*more, "more cell")) }
    )]
    Differ {
        /// The cell, by its name for people.
        cell: String,
        /// Its id.
        id: String,
        /// A folder.
        one: PathBuf,
        /// The other.
        other: PathBuf,
        /// How many more cells differ.
        more: usize,
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
    /// Whether a plan, or the file of a cell that may be planned, could not be read; each was warned of.
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
    let mut parts = vec![];
    for folder in folders {
        let part = Results::open(folder)?;
        if !gathered.plan_of(&part) {
            gathered.unplanned.push(folder.clone());
        }
        let readable = gathered.readable(&part)?;
        parts.push((folder, part, readable));
    }
    let there = target.all()?.into_iter().flatten().collect::<Vec<_>>();
    // Before anything is copied.
    check_same(parts.iter().map(|(folder, _, done)| (folder.as_path(), done)).chain([(out, &there)]))?;
    for (_, part, readable) in parts {
        for done in readable {
            match target.get(&done.cell)? {
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
    if let Some(plan) = plan.as_ref().filter(|_| gathered.unplanned.is_empty() && !gathered.corrupt) {
        gathered.unreadable.retain(|id| plan.has(id));
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
        corrupt: gathered.corrupt || !gathered.unreadable.is_empty(),
        left_out: present - done.len(),
    })
}

/// Whether the folders that have a result of the same cell have the same one.
fn check_same<'a>(folders: impl Iterator<Item = (&'a Path, &'a Vec<Done>)>) -> Result<(), MergeError> {
    let (mut known, mut differing) = (BTreeMap::new(), BTreeMap::new());
    for (folder, done) in folders.flat_map(|(folder, all)| all.iter().map(move |done| (folder, done))) {
        let id = done.cell.id();
        let (first, fingerprint) = *known.entry(id.clone()).or_insert((folder, &done.fingerprint));
        if *fingerprint != done.fingerprint {
            differing.insert(id, (done.cell.to_string(), first, folder));
        }
    }
    let more = differing.len().saturating_sub(1);
    differing.pop_first().map_or(Ok(()), |(id, (cell, one, other))| {
        Err(MergeError::Differ { cell, id, one: one.to_owned(), other: other.to_owned(), more })
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
    /// Whether a plan could not be read.
    corrupt: bool,
}

impl Gathered {
    /// Takes in a folder's plan; returns whether there is a file for it.
    fn plan_of(&mut self, results: &Results) -> bool {
        match results.plan() {
            Ok(None) => return false,
            Ok(Some(plan)) if self.plans.contains(&plan) => {}
            Ok(Some(plan)) => self.plans.push(plan),
            Err(error) => {
                tracing::warn!("{error}");
                self.corrupt = true;
            }
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
                    tracing::warn!("{error}");
                    self.unreadable.insert(id);
                }
            }
        }
        Ok(readable)
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
