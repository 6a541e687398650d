//! `lapwing evaluate`.

use std::time::Instant;

use super::{Ended, outputs};
use crate::cli;
use lapwing_learn::{dataset, evaluate::Evaluation, models};
use lapwing_score::drawing::chart::stack;

pub(super) fn run(arguments: cli::Evaluate) -> anyhow::Result<Ended> {
    arguments.plot.as_deref().map_or(Ok(()), outputs::check_drawing)?;
    arguments.data.iter().try_for_each(|data| dataset::check(data))?;
    let file = arguments.model.as_deref();
    let model = match file {
        Some(path) => models::load(path, Instant::now)?,
        None => models::built_in(Instant::now)?,
    };
    let evaluation = Evaluation::of(&model, file, &arguments.data, arguments.rows, arguments.before)?;
    // A failed drawing does not affect the other results.
    let plotted = arguments.plot.as_ref().map_or(Ok(()), |path| stack(&evaluation.charts(), 900, 420).write(path));
    if arguments.json {
        super::print(&super::sorted_json(&evaluation)?)?;
    } else {
        super::print(&evaluation.to_string())?;
    }
    plotted?;
    Ok(Ended::Passed)
}
