//! Learning as a whole.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tch::Tensor;

use super::{policy::Mlp, ppo::Critic, priorities::Replay, training::TrainingSettings, *};
use crate::{nn::runtime, train::Go};
use lapwing_sim::intersection::{Axes, Environment, Reward, Settings, evaluation};

fn small(critic: Critic) -> TrainingSettings {
    let ppo = PpoSettings {
        critic,
        agent_steps: 4000,
        intersections: 8,
        steps: 64,
        minibatch: 256,
        ..PpoSettings::default()
    };
    let intersection = Settings { reward: Reward::Corrected, ..Settings::default() };
    TrainingSettings { world: World { intersection, mixed: false }, algorithm: Algorithm::Ppo(ppo) }
}

/// Small networks are the slower on more threads, the more so where others use the processor, too.
fn one_thread() {
    runtime::set_threads(1);
}

fn run(folder: &std::path::Path, settings: TrainingSettings, resume: bool) -> Result<MarlOutcome, MarlError> {
    one_thread();
    Training::new(folder, settings, resume)?.run(|| 0.0, |_, _, _| Go::On)
}

#[test]
fn the_same_seed_gives_the_same_policy_with_either_critic_and_another_seed_another() {
    for critic in [Critic::Own, Critic::Central] {
        let train = |seed| {
            let folder = tempfile::tempdir().unwrap();
            let mut settings = small(critic);
            *settings.algorithm.seed() = seed;
            let outcome = run(folder.path(), settings, false).unwrap();
            assert!(outcome.finished && outcome.last.unwrap().agent_steps >= 4000);
            std::fs::read(outcome.policy).unwrap()
        };
        assert!(train(1) == train(1), "{critic:?}");
        assert!(train(1) != train(2), "{critic:?}");
    }
}

fn small_maddpg(learners: usize, replay: Replay) -> TrainingSettings {
    let maddpg = MaddpgSettings {
        agent_steps: 20_000,
        intersections: 8,
        batch: 64,
        warm_up: 500,
        memory: 5000,
        hidden: 16,
        replay,
        learners,
        ..MaddpgSettings::default()
    };
    TrainingSettings { algorithm: Algorithm::Maddpg(maddpg), ..small(Critic::Own) }
}

#[test]
fn maddpg_is_the_same_for_the_same_seed_with_each_kind_of_replay() {
    for replay in [Replay::Uniform, Replay::Proportional, Replay::Rank] {
        let train = || {
            let folder = tempfile::tempdir().unwrap();
            let outcome = run(folder.path(), small_maddpg(0, replay), false).unwrap();
            let last = outcome.last.unwrap();
            assert!(outcome.finished && last.gradient_steps >= 70, "{last:?}");
            assert_eq!(last.losses["staleness"], 0.0);
            assert_eq!(Policy::load(&outcome.policy).unwrap().metadata.algorithm, "maddpg");
            std::fs::read(outcome.policy).unwrap()
        };
        assert!(train() == train(), "{replay:?}");
    }
}

#[test]
fn two_learners_beside_a_collector_take_as_many_gradient_steps_as_one_after_the_other() {
    let folder = tempfile::tempdir().unwrap();
    let stop = |_: &Update, _, _| Go::Stop;
    let settings = small_maddpg(2, Replay::Proportional);
    one_thread();
    let first = Training::new(folder.path(), settings.clone(), false).unwrap().run(|| 0.0, stop).unwrap();
    let alone = tempfile::tempdir().unwrap();
    let other = Training::new(alone.path(), small_maddpg(0, Replay::Proportional), false).unwrap();
    let other = { other }.run(|| 0.0, stop).unwrap();
    let (first, other) = (first.last.unwrap(), other.last.unwrap());
    assert_eq!(first.gradient_steps, other.gradient_steps);
    assert!((0.0..=2.0).contains(&first.losses["staleness"]), "{first:?}");
    let resumed = run(folder.path(), settings, true).unwrap();
    assert!(resumed.finished && resumed.last.unwrap().gradient_steps > first.gradient_steps);
}

#[test]
fn weights_are_orthogonal_at_first_and_the_policy_prefers_no_action() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let net = Mlp::new("actor", [10, 6, 6, 4], 0.01, &mut random).unwrap();
    let weight = &net.weights()[0].1.detach(); // (6, 10): orthogonal rows of length sqrt(2)
    let product = weight.matmul(&weight.transpose(0, 1));
    let expected = Tensor::eye(6, (tch::Kind::Float, tch::Device::Cpu)) * 2.0;
    assert!((product - expected).abs().max().double_value(&[]) < 1e-5);
    let logits = net.forward(&Tensor::ones([1, 10], (tch::Kind::Float, tch::Device::Cpu))).unwrap();
    assert!(logits.abs().max().double_value(&[]) < 0.05);
}

#[test]
fn a_policy_is_read_as_it_was_written_and_anything_else_is_refused_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let mut settings = small(Critic::Own);
    settings.world.intersection.axes = Axes::Car;
    let outcome = run(folder.path(), settings, false).unwrap();
    let mut policy = Policy::load(&outcome.policy).unwrap();
    assert_eq!((policy.settings().axes, policy.metadata.agent_steps >= 4000), (Axes::Car, true));
    let act = |environments: &[Environment], actions: &mut [_]| policy.act(environments, actions);
    let found = evaluation::evaluate(settings_of(Axes::Car), 0..3, 2, act).unwrap();
    assert_eq!(found.episodes, 3);

    let lake = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/pilotnet.safetensors");
    let other = Policy::load(lake).unwrap_err().to_string();
    assert!(other.contains("expected the key lapwing.policy, got none"), "{other}");
    let broken = folder.path().join("broken.safetensors");
    std::fs::write(&broken, b"no tensors").unwrap();
    assert!(Policy::load(&broken).unwrap_err().to_string().contains("expected a whole safetensors file"));
}

fn settings_of(axes: Axes) -> Settings {
    Settings { axes, ..Settings::default() }
}

#[test]
fn a_training_goes_on_where_it_was_stopped_and_is_not_begun_twice() {
    let folder = tempfile::tempdir().unwrap();
    let settings = small(Critic::Own);
    let stop = |_: &Update, _, _| Go::Stop;
    let first = Training::new(folder.path(), settings.clone(), false).unwrap().run(|| 0.0, stop).unwrap();
    assert!(!first.finished && first.last.unwrap().number == 1);
    let twice = run(folder.path(), settings.clone(), false).unwrap_err().to_string();
    assert!(twice.contains("add --resume"), "{twice}");
    let second = run(folder.path(), settings, true).unwrap();
    assert!(second.finished && second.last.unwrap().number > 1);
    let log = std::fs::read_to_string(folder.path().join("log.csv")).unwrap();
    let numbers: Vec<_> = log.lines().skip(1).map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(numbers[..2], ["1", "2"]);
    assert_eq!(log.lines().filter(|line| line.starts_with("update")).count(), 1);
    let none = run(tempfile::tempdir().unwrap().path(), small(Critic::Own), true).unwrap_err().to_string();
    assert!(none.contains("expected a training to resume, got none"), "{none}");
}

#[test]
fn settings_that_cannot_be_followed_are_refused() {
    for (settings, expected) in [
        (PpoSettings { minibatch: 1, ..PpoSettings::default() }, "minibatch: expected at least 2"),
        (PpoSettings { steps: 0, ..PpoSettings::default() }, "steps: expected 1 to 65536, got 0"),
        (PpoSettings { gamma_end: Some(1.0), ..PpoSettings::default() }, "gamma_end: expected below 1"),
        (PpoSettings { gamma: 1.5, ..PpoSettings::default() }, "gamma and lambda: expected 0 to 1, got 1.5"),
        (PpoSettings { collectors: 0, ..PpoSettings::default() }, "collectors: expected 1 to 64, got 0"),
        (PpoSettings { learning_rate: f64::NAN, ..PpoSettings::default() }, "learning_rate: expected a number above 0"),
    ] {
        let error = Ppo::new(settings, World::default()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn discount_and_entropy_go_from_the_begin_to_the_end_and_stay_if_no_end_is_told() {
    let settings =
        PpoSettings { gamma_end: Some(0.9975), entropy: 0.02, entropy_end: Some(0.0), ..PpoSettings::default() };
    let near = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-6, "{found}, expected {expected}");
    // 100 steps, 200, 400.
    for (done, gamma, weight) in [(0.0, 0.99, 0.02), (0.5, 0.995, 0.01), (1.0, 0.9975, 0.0)] {
        near(settings.gamma_at(done), gamma);
        assert_eq!(settings.entropy_at(done), weight);
    }
    let usual = PpoSettings::default();
    assert_eq!((usual.gamma_at(0.7), usual.entropy_at(0.7)), (0.99, 0.01));
}
