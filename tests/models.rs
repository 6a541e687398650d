//! What is in `models/`.

use std::{fs, path::PathBuf};

use lapwing_learn::{
    braking::BrakingRecipe,
    nn::{Checkpoint, braking::BrakingCheckpoint},
    train::Recipe,
};

/// Those that drive or find the lane, and those that brake.
fn models(extension: &str) -> [Vec<PathBuf>; 2] {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/models");
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|of| of == extension));
    let brakes = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with("brake");
    let (braking, others): (Vec<_>, Vec<_>) = paths.into_iter().partition(brakes);
    assert!(!others.is_empty() && !braking.is_empty());
    [others, braking]
}

#[test]
fn every_recipe_can_be_followed() {
    let [others, braking] = models("toml");
    for path in braking {
        let recipe = BrakingRecipe::read(&fs::read_to_string(&path).unwrap()).unwrap();
        recipe.check().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }
    for path in others {
        let recipe = Recipe::parse(&fs::read_to_string(&path).unwrap()).unwrap();
        recipe.check().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        // What is simulated is recorded by the recipe itself.
        let recorded = |data: &PathBuf| recipe.record.iter().any(|of| of.out == *data);
        let unknown = recipe.data.iter().find(|data| !data.path.starts_with("../shared") && !recorded(&data.path));
        assert_eq!(unknown, None, "{}", path.display());
    }
}

#[test]
fn every_shipped_model_is_read_and_tells_the_recipe_beside_it() {
    let [others, braking] = models("safetensors");
    for path in braking {
        let checkpoint = BrakingCheckpoint::load(&path).unwrap();
        let told: serde_json::Value = serde_json::from_str(&checkpoint.metadata.training).unwrap();
        let told: BrakingRecipe = serde_json::from_value(told["recipe"].clone()).unwrap();
        let beside = BrakingRecipe::read(&fs::read_to_string(path.with_extension("toml")).unwrap()).unwrap();
        assert_eq!(told, beside, "{}", path.display());
    }
    for path in others {
        let checkpoint = Checkpoint::load(&path).unwrap();
        let told: Recipe = serde_json::from_str(&checkpoint.metadata.training).unwrap();
        let beside = Recipe::parse(&fs::read_to_string(path.with_extension("toml")).unwrap()).unwrap();
        assert_eq!(told, beside, "{}", path.display());
    }
}
