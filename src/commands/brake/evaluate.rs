//! `lapwing brake evaluate`.

use crate::{
    cli::BrakeEvaluate,
    commands::{Ended, outputs, print, sorted_json},
};
use lapwing_learn::{
    braking::{BrakingModel, BrakingReport, load},
    nn::runtime,
};

pub(super) fn run(arguments: &BrakeEvaluate) -> anyhow::Result<Ended> {
    let BrakeEvaluate { model, data, part, episodes, threshold, plot, seed, json } = arguments;
    plot.as_deref().map_or(Ok(()), outputs::check_drawing)?;
    runtime::set_threads(1);
    let model = BrakingModel::load(model, *threshold)?;
    let drives = load(data, *part, episodes.unwrap_or(usize::MAX), model.network().architecture())?;
    let mut told = 0;
    let report = BrakingReport::of(&model, &drives, *seed, |done, all| {
        if done >= told + 100 {
            told = done;
            tracing::info!("{done} of {all}");
        }
    })?;
    // A failed drawing does not affect the other results.
    let plotted = plot.as_ref().map_or(Ok(()), |path| report.chart().sheet(900, 600).write(path));
    if *json {
        print(&sorted_json(&report)?)?;
    } else {
        print(&report.to_string())?;
    }
    plotted?;
    Ok(Ended::Passed)
}
