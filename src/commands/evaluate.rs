//! `lapwing evaluate`.

use std::sync::Arc;

use serde_json::json;

use super::Ended;
use crate::{
    cli,
    dataset::{Balance, Blocks, Cache, Inputs, Samples, Selection, Set},
    nn::Checkpoint,
    train::measure,
};

pub(super) fn run(arguments: cli::Evaluate) -> anyhow::Result<Ended> {
    let checkpoint = Checkpoint::load(&arguments.model)?;
    let preprocess = checkpoint.metadata.preprocess.clone();
    let inputs = Inputs { preprocess, frames: checkpoint.network.architecture().frames() };
    let (set, blocks) = match arguments.rows {
        cli::Rows::All => (Set::All, None),
        cli::Rows::HeldOut => (Set::Validation, Some(Blocks::default())),
    };
    let mut lines = vec![];
    let mut results = vec![];
    for path in &arguments.data {
        let selection = Selection { rows: arguments.before.map(|row| (0, row)), ..Selection::of(path) };
        let samples = Arc::new(Samples::open(&[selection], set, blocks, &Balance::default())?);
        let cache = Cache::new(&samples, 0);
        let (measured, _) = measure(&checkpoint.network, &samples, &cache, &inputs)?;
        let rows = samples.samples.len();
        results.push(json!({ "data": path, "rows": rows, "raw": measured.raw, "smooth": measured.smooth }));
        for (label, m) in [("as recorded", measured.raw), ("9-frame mean", measured.smooth)] {
            let r = m.r.map_or_else(|| "-".to_owned(), |r| format!("{r:.3}"));
            let name = path.display().to_string();
            lines.push(format!("{name:<32} {rows:>6}  {label:<12}  {:.4}  {:.4}  {r}", m.mse, m.mae));
        }
    }
    if arguments.json {
        super::print(&serde_json::to_string_pretty(&json!({ "model": arguments.model, "results": results }))?);
    } else {
        super::print(&format!("{:<32} {:>6}  {:<12}  {:<6}  {:<6}  r", "data", "rows", "label", "MSE", "MAE"));
        lines.iter().for_each(|line| super::print(line));
    }
    Ok(Ended::Passed)
}
