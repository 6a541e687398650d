//! `lapwing evaluate`.

use std::sync::Arc;

use serde_json::json;

use super::Ended;
use crate::{
    cli,
    dataset::{Balance, Blocks, Cache, Inputs, Samples, Selection, Set},
    drawing::{
        Kind, Sheet,
        chart::{Axis, Chart, Marks, Series, stack},
    },
    nn::Checkpoint,
    train::measure,
};

pub(super) fn run(arguments: cli::Evaluate) -> anyhow::Result<Ended> {
    let checkpoint = Checkpoint::load(&arguments.model)?;
    let preprocess = checkpoint.metadata.preprocess.clone();
    let inputs = Inputs::plain(preprocess, checkpoint.network.architecture().frames());
    let (set, blocks) = match arguments.rows {
        cli::Rows::All => (Set::All, None),
        cli::Rows::HeldOut => (Set::Validation, Some(Blocks::default())),
    };
    if let Some(path) = &arguments.plot {
        Kind::of(path)?;
    }
    let mut lines = vec![];
    let mut charts = vec![];
    let mut results = vec![];
    for path in &arguments.data {
        let selection = Selection { rows: arguments.before.map(|row| (0, row)), ..Selection::of(path) };
        let samples = Arc::new(Samples::open(&[selection], set, blocks, &Balance::default())?);
        let cache = Cache::new(&samples, 0);
        let (measured, answers) = measure(&checkpoint.network, &samples, &cache, &inputs)?;
        let rows = samples.samples.len();
        let labels: Vec<f64> = samples.samples.iter().map(|sample| sample.steering).collect();
        charts.push(errors(&path.display().to_string(), &labels, &answers));
        results.push(json!({ "data": path, "rows": rows, "raw": measured.raw, "smooth": measured.smooth }));
        for (label, m) in [("as recorded", measured.raw), ("9-frame mean", measured.smooth)] {
            let r = m.r.map_or_else(|| "-".to_owned(), |r| format!("{r:.3}"));
            let name = path.display().to_string();
            lines.push(format!("{name:<32} {rows:>6}  {label:<12}  {:.4}  {:.4}  {r}", m.mse, m.mae));
        }
    }
    if let Some(path) = &arguments.plot {
        let sheet: Sheet = stack(&charts, 900, 420);
        sheet.write(path)?;
    }
    if arguments.json {
        super::print(&serde_json::to_string_pretty(&json!({ "model": arguments.model, "results": results }))?);
    } else {
        super::print(&format!("{:<32} {:>6}  {:<12}  {:<6}  {:<6}  r", "data", "rows", "label", "MSE", "MAE"));
        lines.iter().for_each(|line| super::print(line));
    }
    Ok(Ended::Passed)
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
