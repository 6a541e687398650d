//! `lapwing brake train`.

use std::{fs, time::Duration};

use anyhow::Context;
use serde_json::json;

use crate::{
    cli::BrakeTrain,
    commands::{Ended, outputs, print, sorted_json},
};
use lapwing_core::config::ConfigError;
use lapwing_learn::braking::{self, BrakingRecipe, Epoch, TrainOptions};

pub(super) fn run(arguments: &BrakeTrain) -> anyhow::Result<Ended> {
    let BrakeTrain { recipe: file, data, out, epochs, minutes, resume, threads, seed, json } = arguments;
    if out.extension().is_none_or(|extension| extension != "safetensors") {
        let why = format!("expected a file ending in .safetensors, got {}", out.display());
        return Err(ConfigError::Value { layer: "--out".into(), why }.into());
    }
    if let Some(folder) = out.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    }
    let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
    let mut recipe = BrakingRecipe::read(&text).with_context(|| file.display().to_string())?;
    outputs::check_network(out, [file.as_path()].into_iter().chain(recipe.pretrained.as_deref()))?;
    recipe.epochs = epochs.unwrap_or(recipe.epochs);
    recipe.seed = seed.unwrap_or(recipe.seed);
    let most = minutes.map(|minutes| Duration::from_secs_f64(60.0 * minutes));
    let told = |epoch: &Epoch| {
        let Epoch { epoch, windows, loss, validation, learning_rate, seconds, best } = epoch;
        let best = if *best { ", the best so far" } else { "" };
        say!(
            "epoch {epoch} after {seconds:.0} s: {windows} windows, loss {loss:.5}, validation {validation:.5}{best}, \
             learning rate {learning_rate:.6}"
        );
    };
    let trained = braking::train(&recipe, data, out, TrainOptions { most, resume: *resume, threads: *threads }, told)?;
    if *json {
        print(&sorted_json(&json!({
            "model": trained.path, "sha256": trained.sha256, "epochs": trained.epochs, "limits": trained.limits,
            "rule": trained.rule, "validation": trained.validation,
        }))?)?;
    } else {
        let rate = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
        let found = &trained.validation;
        print(&format!(
            "{} (threshold {:.3}, {}; on validation episodes recall {}, precision {})",
            trained.path.display(),
            trained.limits.fires,
            trained.rule,
            rate(found.recall.value),
            rate(found.precision.value)
        ))?;
    }
    Ok(Ended::Passed)
}
