//! `lapwing brake`: emergency braking, one function per verb.

#[cfg(feature = "networks")]
mod evaluate;
#[cfg(feature = "simulator")]
mod recorded;
#[cfg(feature = "networks")]
mod train;
#[cfg(feature = "simulator")]
mod tried;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};

use super::{Ended, outputs, print};
use crate::cli::{Brake, BrakeLabel, BrakeVerb};
use lapwing_score::{
    drawing::chart::stack,
    emergency::{LabelRule, Labelled},
};

pub(super) fn run(arguments: &Brake, config: Option<&Path>) -> anyhow::Result<Ended> {
    match &arguments.verb {
        BrakeVerb::Label(arguments) => label(arguments),
        #[cfg(feature = "simulator")]
        BrakeVerb::Record(arguments) => recorded::run(arguments),
        #[cfg(feature = "simulator")]
        BrakeVerb::Trial(arguments) => tried::run(arguments, config),
        #[cfg(feature = "networks")]
        BrakeVerb::Train(arguments) => train::run(arguments),
        #[cfg(feature = "networks")]
        BrakeVerb::Evaluate(arguments) => evaluate::run(arguments),
    }
}

/// `lapwing brake label`.
fn label(arguments: &BrakeLabel) -> anyhow::Result<Ended> {
    arguments.plot.as_deref().map_or(Ok(()), outputs::check_drawing)?;
    let tables = arguments.out.as_deref().map(|folder| tables(folder, &arguments.sources)).transpose()?;
    let threshold_per_s = arguments.threshold.unwrap_or(LabelRule::default().threshold_per_s);
    let rule = LabelRule { threshold_per_s, ..LabelRule::default() };
    let open = |source: &PathBuf| Labelled::open(source, rule);
    let labelled = arguments.sources.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    if let Some(folder) = &arguments.out {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    for (path, labelled) in tables.iter().flatten().zip(&labelled) {
        outputs::write(path, &labelled.csv())?;
    }
    // A failed drawing does not affect the other results.
    let plotted = arguments.plot.as_ref().map_or(Ok(()), |path| {
        let charts: Vec<_> = labelled.iter().flat_map(Labelled::charts).collect();
        stack(&charts, 1200, 300).write(path)
    });
    let found: Vec<_> = labelled.iter().map(Labelled::found).collect();
    if arguments.json {
        print(&serde_json::to_string_pretty(&found)?)?;
    } else {
        found.iter().try_for_each(|found| print(&found.to_string()))?;
    }
    plotted?;
    Ok(Ended::Passed)
}

/// The table of each source, in a folder that can be written; none of them is a source, or a recording.
fn tables(folder: &Path, sources: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    outputs::check_folder(folder)?;
    let mut named = BTreeMap::new();
    let table = |source: &PathBuf| {
        let source = source.canonicalize().with_context(|| source.display().to_string())?;
        let name = if source.is_dir() { source.file_name() } else { source.file_stem() };
        let name = name.unwrap_or_default().to_string_lossy().into_owned();
        if let Some(other) = named.insert(name.clone(), source.clone()) {
            bail!("{} and {}: expected names that differ, got {name:?} twice", other.display(), source.display());
        }
        let table = folder.join(name + ".csv");
        // In a folder that is still to be made there is nothing to lose.
        if table.exists() {
            outputs::check_beside(&table, sources.iter().map(PathBuf::as_path))?;
        }
        Ok(table)
    };
    sources.iter().map(table).collect()
}
