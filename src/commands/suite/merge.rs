//! `lapwing merge`: the results of a suite's parts in one folder, and what is missing of them.

use std::{collections::BTreeSet, path::PathBuf};

use anyhow::bail;

use super::{
    super::{Ended, outputs},
    Found, told_apart,
};
use crate::cli;
use lapwing_core::words::count;
use lapwing_score::suite::{Done, Plan, Results, ResultsError};

/// So many missing cells are named.
const NAMED: usize = 5;

pub(in crate::commands) fn run(arguments: &cli::Merge) -> anyhow::Result<Ended> {
    for folder in &arguments.folders {
        if !folder.join("cells").is_dir() {
            bail!("{}: expected the folder of a suite, with cells in it", folder.display());
        }
    }
    arguments.html.as_deref().map_or(Ok(()), outputs::check)?;
    outputs::check_folder(&arguments.out)?;
    let target = Results::open(&arguments.out)?;
    let mut gathered = Gathered::default();
    gathered.plan_of(&target);
    for folder in &arguments.folders {
        let part = Results::open(folder)?;
        if !gathered.plan_of(&part) {
            gathered.unplanned.push(folder.clone());
        }
        for done in gathered.readable(&part)? {
            match target.get(&done.cell)? {
                Some(other) if other.fingerprint != done.fingerprint => {
                    bail!(
                        "{}: driven twice, with different frames: {} and {}",
                        done.cell,
                        other.fingerprint,
                        done.fingerprint
                    );
                }
                Some(_) => {}
                None => target.keep(&done)?,
            }
        }
    }
    let mut done = gathered.readable(&target)?;
    let plan = gathered.plan();
    if let Some(plan) = &plan {
        target.keep_plan(plan)?;
    }
    let missing = gathered.missing(plan.as_ref(), &done);
    tell(plan.as_ref(), &done, &missing, &gathered);
    done.sort_by_key(|done| done.cell.seed);
    let all = done.len();
    let done = told_apart(done, |done| &done.cell);
    if let left_out @ 1.. = all - done.len() {
        tracing::info!("skipped {}: a different seed would not change their drives", count(left_out, "result"));
    }
    let found = Found { done, planned: plan.as_ref().map(Plan::count), missing: missing.len() };
    found.report(&arguments.out, arguments.html.as_deref(), arguments.json)?;
    Ok(if missing.is_empty() && !gathered.corrupt { Ended::Passed } else { Ended::Failed })
}

/// What the folders say.
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
    /// Takes in a folder's plan; says whether there is a file for it.
    fn plan_of(&mut self, results: &Results) -> bool {
        match results.plan() {
            Ok(None) => return false,
            Ok(Some(plan)) if self.plans.contains(&plan) => {}
            Ok(Some(plan)) => self.plans.push(plan),
            Err(error) => self.warn(&error),
        }
        true
    }

    /// A folder's results, but those that cannot be read: these are named, and count as missing.
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

    /// The cells without a result, as people call them; of one that no plan knows its id.
    fn missing(&self, plan: Option<&Plan>, done: &[Done]) -> Vec<String> {
        let mut missing: Vec<_> = plan.map(|plan| plan.missing(done)).unwrap_or_default();
        let there: BTreeSet<_> = done.iter().map(|done| done.cell.id()).collect();
        let unplanned = |id: &&String| !there.contains(*id) && !plan.is_some_and(|plan| plan.has(id));
        missing.extend(self.unreadable.iter().filter(unplanned).map(String::as_str));
        missing.into_iter().map(str::to_owned).collect()
    }
}

/// Says how much of the suite is there.
fn tell(plan: Option<&Plan>, done: &[Done], missing: &[String], gathered: &Gathered) {
    match plan {
        Some(plan) => {
            let (all, without) = (plan.count(), plan.missing(done).len());
            say!("{} of {} present, {without} missing", all - without, count(all, "cell"));
            for folder in &gathered.unplanned {
                say!("{}: no plan.json: the suite's other cells are unknown", folder.display());
            }
        }
        None => {
            let present = count(done.len(), "cell");
            say!("{present} present; no folder has a plan.json: how many the suite has is unknown");
        }
    }
    for name in missing.iter().take(NAMED) {
        say!("missing: {name}");
    }
    if let more @ 1.. = missing.len().saturating_sub(NAMED) {
        say!("missing: {more} more");
    }
    if gathered.plans.len() > 1 && !missing.is_empty() {
        say!(
            "the parts plan different cells: were they driven with different settings, models or versions of Lapwing?"
        );
    }
}
