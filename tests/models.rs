//! What is in `models/`.

use std::{
    fs,
    path::{Path, PathBuf},
};

use lapwing_learn::{
    braking::BrakingRecipe,
    marl::{Policy, training::TrainingSettings},
    nn::{Checkpoint, braking::BrakingCheckpoint},
    train::{Lesson, Recipe},
};
use lapwing_sim::intersection::{
    CARS, Missions, Settings,
    evaluation::{Evaluation, HELD_OUT, evaluate},
};

/// Those that drive or find the lane, those that brake, and the intersection's.
fn models(extension: &str) -> [Vec<PathBuf>; 3] {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/models");
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|of| of == extension));
    let named =
        |start: &'static str| move |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with(start);
    let (braking, others): (Vec<_>, Vec<_>) = paths.into_iter().partition(named("brake"));
    let (crossing, others): (Vec<_>, Vec<_>) = others.into_iter().partition(named("intersection"));
    assert!(!others.is_empty() && !braking.is_empty() && !crossing.is_empty());
    [others, braking, crossing]
}

#[test]
fn every_recipe_can_be_followed() {
    let [others, braking, crossing] = models("toml");
    for path in crossing {
        TrainingSettings::read(&path).unwrap_or_else(|error| panic!("{error}"));
    }
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
    let [others, braking, crossing] = models("safetensors");
    for path in crossing {
        let told = Policy::load(&path).unwrap().metadata.training;
        let beside = TrainingSettings::read(&path.with_extension("toml")).unwrap();
        assert_eq!(serde_json::from_value::<TrainingSettings>(told).unwrap(), beside, "{}", path.display());
    }
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
        assert_eq!(told, as_told(beside, &path), "{}", path.display());
    }
}

/// What a model tells that was trained by this recipe: after rounds in closed loop, the last round's training.
fn as_told(recipe: Recipe, model: &Path) -> Recipe {
    let Some(closed_loop) = recipe.closed_loop.clone() else { return recipe };
    let out = Path::new("runs").join(model.file_stem().unwrap());
    let weights = out.join(format!("round-{}/model.safetensors", closed_loop.rounds - 1));
    let of_round = |round| (1..=closed_loop.drive.len()).map(move |drive| format!("round-{round}/drive-{drive}"));
    let drives = (1..=closed_loop.rounds).flat_map(of_round).map(|drive| out.join(drive));
    let lessons: Vec<_> = drives.map(|path| Lesson { path, track: None }).collect();
    recipe.of_round(&closed_loop, &weights, &lessons)
}

/// The shipped policy of an algorithm on so many of the held-out episodes.
fn drive(algorithm: &str, missions: Missions, cars: usize, episodes: u64) -> Evaluation {
    let path = format!("{}/models/intersection-{algorithm}.safetensors", env!("CARGO_MANIFEST_DIR"));
    let mut policy = Policy::load(path).unwrap();
    let settings = Settings { missions, cars, ..policy.settings() };
    evaluate(settings, HELD_OUT..HELD_OUT + episodes, 50, |environments, actions| policy.act(environments, actions))
        .unwrap()
}

#[test]
fn the_shipped_policies_bring_all_four_agents_to_the_benchmarks_goals() {
    for algorithm in ["ppo", "maddpg"] {
        let found = drive(algorithm, Missions::Benchmark, 0, 1);
        assert_eq!((found.episodes, found.all_completed), (1, 1.0), "{algorithm}: {found:?}");
    }
}

/// Completion rates are those of the card, which are of 1000 episodes. Fewer come out up to a few points beside them.
#[test]
fn the_shipped_policies_complete_about_as_much_as_their_card_says() {
    for (algorithm, missions, cars, card) in [
        ("ppo", Missions::Benchmark, CARS, 0.999),
        ("ppo", Missions::Random, 0, 0.988),
        ("ppo", Missions::Random, CARS, 0.977),
        ("maddpg", Missions::Benchmark, CARS, 0.962),
        ("maddpg", Missions::Random, 0, 0.939),
        ("maddpg", Missions::Random, CARS, 0.88),
    ] {
        let found = drive(algorithm, missions, cars, 50);
        let (lowest, highest) = (card - 0.05, card + 0.08);
        assert!(
            (lowest..=highest).contains(&found.completion_rate),
            "{algorithm}, {missions:?}, {cars} cars: {found:?}"
        );
    }
}
