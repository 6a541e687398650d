//! What is in `models/`.

use std::{fs, path::PathBuf};

use lapwing_learn::{nn::Checkpoint, train::Recipe};

fn models(extension: &str) -> Vec<PathBuf> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/models");
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|of| of == extension));
    assert!(!paths.is_empty());
    paths
}

#[test]
fn every_recipe_can_be_followed() {
    for path in models("toml") {
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
    for path in models("safetensors") {
        let checkpoint = Checkpoint::load(&path).unwrap();
        let told: Recipe = serde_json::from_str(&checkpoint.metadata.training).unwrap();
        let beside = Recipe::parse(&fs::read_to_string(path.with_extension("toml")).unwrap()).unwrap();
        assert_eq!(told, beside, "{}", path.display());
    }
}
