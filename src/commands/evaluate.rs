//! `lapwing evaluate`.

use std::{path::Path, sync::Arc, time::Instant};

use anyhow::{Context, bail, ensure};
use serde_json::json;

use super::{Ended, outputs};
use crate::cli;
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    pilot::View,
};
use lapwing_learn::models;
use lapwing_learn::{
    dataset::{self, Balance, Blocks, Cache, Inputs, Sample, Samples, Selection, Set},
    models::Model,
    nn::Network,
    train::{Measured, Recipe, measure},
};
use lapwing_score::{
    drawing::Sheet,
    drawing::chart::{Axis, Chart, Marks, Series, stack},
};

pub(super) fn run(arguments: cli::Evaluate) -> anyhow::Result<Ended> {
    arguments.plot.as_deref().map_or(Ok(()), outputs::check_drawing)?;
    arguments.data.iter().try_for_each(|data| dataset::check(data))?;
    let model = match &arguments.model {
        Some(path) => models::load(path, Instant::now)?,
        None => models::built_in(Instant::now)?,
    };
    let (name, network) = (model.name(), model.network());
    // Models made elsewhere say in their own words how they were trained, or not at all.
    let recipe: Option<Recipe> = model.training().and_then(|training| serde_json::from_str(training).ok());
    let (set, blocks) = match arguments.rows {
        cli::Rows::All => (Set::All, None),
        cli::Rows::HeldOut => {
            ensure!(
                recipe.as_ref().is_none_or(|recipe| recipe.validation.is_empty()),
                "{name} was validated on separate data and held out no rows: use --rows all on that data"
            );
            let blocks = recipe.as_ref().map_or_else(Blocks::default, |recipe| recipe.blocks);
            (Set::Validation, Some(blocks))
        }
    };
    if recipe.is_none() {
        tracing::warn!("{name} has no recipe: whether these rows were held out is unknown");
    }
    let mut lines = vec![];
    let mut charts = vec![];
    let mut results = vec![];
    for path in &arguments.data {
        let selection = Selection { rows: arguments.before.map(|row| (0, row)), ..Selection::of(path) };
        let samples = Arc::new(Samples::open(&[selection], set, blocks, &Balance::default())?);
        let answers = match &network {
            Some(network) => of_network(network, &model, &samples)?,
            None => of_pilot(&model, &samples)?,
        };
        let rows = samples.samples.len();
        let not_finite: Vec<usize> = (0..answers.len()).filter(|i| !answers[*i].is_finite()).collect();
        if let [first, ..] = not_finite[..] {
            let (path, got, row, count) =
                (path.display(), answers[first], samples.samples[first].row, not_finite.len());
            bail!(
                "{path}: expected finite answers from {name}, got {got} in row {row}; {count} of {rows} are not finite"
            );
        }
        let measured = Measured::of(&answers, &samples);
        let learnt = recipe.as_ref().map(|recipe| {
            let learnt = learnt_from(recipe, path);
            samples.samples.iter().filter(|sample| learnt(sample.row as usize)).count()
        });
        if let Some(learnt) = learnt.filter(|learnt| *learnt > 0) {
            let path = path.display();
            tracing::warn!("{path}: the network learnt from {learnt} of these {rows} rows; see --rows held-out");
        }
        let labels: Vec<f64> = samples.samples.iter().map(|sample| sample.steering).collect();
        charts.push(errors(&path.display().to_string(), &labels, &answers));
        results.push(json!({
            "data": path, "rows": rows, "learnt_from": learnt, "raw": measured.raw, "smooth": measured.smooth,
        }));
        for (label, m) in [("as recorded", measured.raw), ("9-frame mean", measured.smooth)] {
            let r = m.r.map_or_else(|| "-".to_owned(), |r| format!("{r:.3}"));
            let name = path.display().to_string();
            lines.push(format!("{name:<32} {rows:>6}  {label:<12}  {:.4}  {:.4}  {r}", m.mse, m.mae));
        }
    }
    // What cannot be drawn takes nothing else with it.
    let plotted = arguments.plot.as_ref().map_or(Ok(()), |path| Sheet::write(&stack(&charts, 900, 420), path));
    if arguments.json {
        super::print(&serde_json::to_string_pretty(&json!({
            "model": arguments.model.as_deref().unwrap_or(Path::new("built in")), "sha256": model.sha256(), "held_out": blocks, "results": results,
        }))?)?;
    } else {
        super::print(&format!("{:<32} {:>6}  {:<12}  {:<6}  {:<6}  r", "data", "rows", "label", "MSE", "MAE"))?;
        lines.iter().try_for_each(|line| super::print(line))?;
    }
    plotted?;
    Ok(Ended::Passed)
}

/// The steering that a network answers to each sample, many at once.
fn of_network(network: &Network, model: &Model, samples: &Arc<Samples>) -> anyhow::Result<Vec<f64>> {
    let inputs = Inputs::plain(model.preprocess().clone(), network.architecture().frames());
    Ok(measure(network, samples, &Cache::new(samples, 0), &inputs)?.1)
}

/// The steering that a model answers to each sample as it would while driving: a network made elsewhere takes one
/// picture at a time.
fn of_pilot(model: &Model, samples: &Samples) -> anyhow::Result<Vec<f64>> {
    let (mut pilot, mut frame) = (model.pilot(), Frame::default());
    let answer = |sample: &Sample| {
        let row = &samples.sources[sample.source as usize].rows[sample.row as usize];
        let picture = row.pictures[sample.camera as usize].as_ref().context("a sample without a picture")?;
        decode_jpeg(&picture.read()?, &mut frame).with_context(|| picture.name())?;
        let view = View { speed: sample.speed, ..View::of(&frame) };
        Ok(pilot.steer(&view).with_context(|| picture.name())?.steering)
    };
    samples.samples.iter().map(answer).collect()
}

/// Which rows of a data set a training learnt from, as far as paths tell: a copy elsewhere is another data set.
fn learnt_from<'a>(recipe: &'a Recipe, path: &Path) -> impl Fn(usize) -> bool + 'a {
    let measured = Selection::of(path).place();
    let same: Vec<&Selection> = recipe.data.iter().filter(|data| data.place() == measured).collect();
    move |row| {
        let taken = same.iter().any(|data| data.rows.is_none_or(|(first, end)| (first..end).contains(&row)));
        // Where there were data to validate by, no blocks were held out.
        taken && !(recipe.validation.is_empty() && recipe.blocks.is_validation(row))
    }
}

/// Width of a bin of steering over which errors are averaged.
const BIN: f64 = 0.1;

/// Each row's error over its label, and the mean of each bin.
fn errors(title: &str, labels: &[f64], answers: &[f64]) -> Chart {
    let points: Vec<(f64, f64)> = labels.iter().zip(answers).map(|(label, answer)| (*label, answer - label)).collect();
    let mean = |bin: i32| {
        let middle = f64::from(bin) * BIN;
        let inside = points.iter().filter(|(label, _)| (label - middle).abs() <= BIN / 2.0);
        let (sum, count) = inside.fold((0.0, 0.0), |(sum, count), (_, error)| (sum + error, count + 1.0));
        (middle, if count > 0.0 { sum / count } else { f64::NAN })
    };
    let means = (-10..=10).map(mean).collect();
    let y = Axis::new("answered less recorded").from_to(-1.0, 1.0);
    Chart {
        series: vec![Series::new("rows", Marks::Points(points)), Series::new("mean", Marks::Line(means))],
        ..Chart::new(title, Axis::new("recorded steering").from_to(-1.0, 1.0), y)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn rows_were_learnt_from_where_the_recipe_has_them_and_does_not_hold_them_out() {
        let dir = tempfile::tempdir().unwrap();
        let lake = dir.path().join("lake");
        fs::create_dir(&lake).unwrap();
        let data = vec![Selection { rows: Some((20, 40)), ..Selection::of(&lake) }];
        let mut recipe = Recipe { data, blocks: Blocks { size: 10, every: 3 }, ..Recipe::default() };
        let rows = |recipe: &Recipe, path: &Path| {
            let learnt = learnt_from(recipe, path);
            (0..50).filter(|row| learnt(*row)).collect::<Vec<_>>()
        };
        assert_eq!(rows(&recipe, &dir.path().join("./lake")), (20..30).collect::<Vec<_>>());
        assert!(rows(&recipe, dir.path()).is_empty());
        recipe.validation = vec![Selection::of("other")];
        assert_eq!(rows(&recipe, &lake), (20..40).collect::<Vec<_>>());
    }
}
