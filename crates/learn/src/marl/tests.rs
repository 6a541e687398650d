//! Learning as a whole.

use std::cell::Cell;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tch::Tensor;

use super::{policy::Mlp, ppo::Critic, priorities::Replay, training::TrainingSettings, *};
use crate::{nn::runtime, train::events};
use lapwing_sim::intersection::{ACTIONS, Axes, Environment, OBSERVATION, Reward, Settings, evaluation};

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

fn run(folder: &std::path::Path, settings: TrainingSettings) -> Result<MarlOutcome, MarlError> {
    one_thread();
    Training::new(folder, settings)?.run(|| 0.0, || false, |_, _, _| ())
}

fn resume(folder: &std::path::Path) -> Result<MarlOutcome, MarlError> {
    one_thread();
    Training::resume(folder, None)?.run(|| 0.0, || false, |_, _, _| ())
}

/// Trains for one update.
fn one_update(folder: &std::path::Path, settings: TrainingSettings) -> MarlOutcome {
    one_thread();
    let over = Cell::new(false);
    Training::new(folder, settings).unwrap().run(|| 0.0, || over.get(), |_, _, _| over.set(true)).unwrap()
}

/// The numbers of the updates in a folder's log, and how many lines of it are headers.
fn logged(folder: &std::path::Path) -> (Vec<u64>, usize) {
    let log = std::fs::read_to_string(folder.join("log.csv")).unwrap();
    let numbers = log.lines().filter_map(|line| line.split(',').next()?.parse().ok()).collect();
    (numbers, log.lines().filter(|line| line.starts_with("update,")).count())
}

#[test]
fn the_same_seed_gives_the_same_policy_with_either_critic_and_another_seed_another() {
    for critic in [Critic::Own, Critic::Central] {
        let train = |seed| {
            let folder = tempfile::tempdir().unwrap();
            let mut settings = small(critic);
            *settings.algorithm.seed() = seed;
            let outcome = run(folder.path(), settings).unwrap();
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
            let outcome = run(folder.path(), small_maddpg(0, replay)).unwrap();
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
    let settings = small_maddpg(2, Replay::Proportional);
    let first = one_update(folder.path(), settings);
    let alone = tempfile::tempdir().unwrap();
    let other = one_update(alone.path(), small_maddpg(0, Replay::Proportional));
    let (first, other) = (first.last.unwrap(), other.last.unwrap());
    assert_eq!(first.gradient_steps, other.gradient_steps);
    assert!((0.0..=2.0).contains(&first.losses["staleness"]), "{first:?}");
    let resumed = resume(folder.path()).unwrap();
    assert!(resumed.finished && resumed.last.unwrap().gradient_steps > first.gradient_steps);
}

#[test]
fn maddpg_is_stopped_within_an_update_and_what_it_has_learnt_by_then_is_kept() {
    one_thread();
    for learners in [0, 2] {
        let folder = tempfile::tempdir().unwrap();
        let steps = Cell::new(0);
        let is_stopped = || {
            steps.set(steps.get() + 1);
            steps.get() >= 100
        };
        let mut training = Training::new(folder.path(), small_maddpg(learners, Replay::Uniform)).unwrap();
        let first = training.run(|| 0.0, is_stopped, |_, _, _| ()).unwrap();
        let last = first.last.unwrap();
        assert!(!first.finished && last.number == 1 && last.agent_steps <= 100 * 8 * 4, "{learners}: {last:?}");
        assert!((1..=3).contains(&last.gradient_steps), "a step for each 100 of 800 after the first 500: {last:?}");
        drop(training);
        let resumed = resume(folder.path()).unwrap();
        assert!(resumed.finished && resumed.last.unwrap().gradient_steps > last.gradient_steps, "{learners}");
        let (numbers, headers) = logged(folder.path());
        assert_eq!((&numbers[..2], headers), (&[1, 2][..], 1));
    }
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
    let outcome = run(folder.path(), settings).unwrap();
    let mut policy = Policy::load(&outcome.policy).unwrap();
    assert_eq!((policy.settings().axes, policy.metadata.agent_steps >= 4000), (Axes::Car, true));
    let act = |environments: &[Environment], actions: &mut [_]| policy.act(environments, actions);
    let found = evaluation::evaluate(settings_of(Axes::Car), 0..3, 2, act).unwrap();
    assert_eq!(found.episodes, 3);

    let lake = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/pilotnet.safetensors");
    let other = Policy::load(lake).unwrap_err().to_string();
    assert!(other.contains("pilotnet.safetensors: expected a policy of lapwing marl train"), "{other}");
    assert!(other.contains("expected the key lapwing.policy, got none"), "{other}");
    let broken = folder.path().join("broken.safetensors");
    std::fs::write(&broken, b"no tensors").unwrap();
    let broken = Policy::load(&broken).unwrap_err().to_string();
    assert!(broken.contains("broken.safetensors: expected a policy of lapwing marl train"), "{broken}");
    assert!(broken.contains("expected a whole safetensors file"), "{broken}");
    let narrow = folder.path().join("narrow.safetensors");
    let actor = Mlp::new("actor", [OBSERVATION, 8, 8, ACTIONS], 0.01, &mut ChaCha8Rng::seed_from_u64(1)).unwrap();
    Policy::save(&narrow, &actor, &policy.metadata).unwrap();
    let narrow = Policy::load(&narrow).unwrap_err().to_string();
    assert!(narrow.contains("narrow.safetensors: expected a policy of lapwing marl train"), "{narrow}");
    assert!(narrow.contains("actor.0.weight: expected shape"), "{narrow}");
}

fn settings_of(axes: Axes) -> Settings {
    Settings { axes, ..Settings::default() }
}

#[test]
fn a_training_goes_on_where_it_was_stopped_and_is_not_begun_twice() {
    let folder = tempfile::tempdir().unwrap();
    let settings = small(Critic::Own);
    let first = one_update(folder.path(), settings.clone());
    assert!(!first.finished && first.last.unwrap().number == 1);
    let twice = run(folder.path(), settings).unwrap_err().to_string();
    assert!(twice.contains("add --resume"), "{twice}");
    let second = resume(folder.path()).unwrap();
    assert!(second.finished && second.last.unwrap().number > 1);
    let (numbers, headers) = logged(folder.path());
    assert_eq!((&numbers[..2], headers), (&[1, 2][..], 1));
    let none = resume(tempfile::tempdir().unwrap().path()).unwrap_err().to_string();
    assert!(none.contains("expected a training to resume, got none"), "{none}");
}

#[test]
fn a_resumed_training_is_as_long_as_it_was_or_longer_if_that_is_told() {
    let folder = tempfile::tempdir().unwrap();
    one_update(folder.path(), small(Critic::Own));
    let resumed = |agent_steps| Training::resume(folder.path(), agent_steps);
    for (told, expected) in [(None, 4000), (Some(4000), 4000), (Some(5000), 5000)] {
        let mut settings = resumed(told).unwrap().settings().clone();
        assert_eq!(*settings.algorithm.agent_steps(), expected, "{told:?}");
    }
    let shorter = resumed(Some(3999)).unwrap_err().to_string();
    assert!(shorter.starts_with("agent_steps: expected at least as many as"), "{shorter}");
    let state = folder.path().join("state.safetensors");
    let whole = std::fs::read(&state).unwrap();
    std::fs::write(&state, &whole[..100]).unwrap();
    let cut = resumed(None).unwrap_err().to_string();
    assert!(cut.contains("state.safetensors: expected the resume state of lapwing marl train"), "{cut}");
}

#[test]
fn the_log_has_no_updates_of_a_training_that_was_killed_before_it_saved_them() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.csv");
    std::fs::write(&log, "update,agent_steps\n1,2000\n2,4000\n").unwrap();
    one_update(folder.path(), small(Critic::Own));
    assert_eq!(logged(folder.path()), (vec![1], 1));
    let saved = std::fs::read_to_string(&log).unwrap();
    std::fs::write(&log, saved.clone() + "2,4000\n3,6000\n4,80").unwrap();
    resume(folder.path()).unwrap();
    let (numbers, headers) = logged(folder.path());
    let expected: Vec<u64> = (1..=numbers.len() as u64).collect();
    assert_eq!((numbers, headers), (expected, 1));
    assert!(std::fs::read_to_string(&log).unwrap().starts_with(&saved));
}

#[test]
fn the_log_tells_how_often_all_four_arrived_and_one_that_did_not_yet_gets_the_column() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.csv");
    one_update(folder.path(), small(Critic::Own));
    let first = std::fs::read_to_string(&log).unwrap();
    let older: String = first.lines().map(|line| line.rsplit_once(',').unwrap().0.to_owned() + "\n").collect();
    std::fs::write(&log, older).unwrap();
    resume(folder.path()).unwrap();
    let text = std::fs::read_to_string(&log).unwrap();
    let names = text.lines().next().unwrap();
    assert!(names.ends_with(",all_completed") && names.matches("all_completed").count() == 1, "{names}");
    let columns = |line: &str| line.split(',').count();
    assert!(text.lines().all(|line| columns(line) == columns(names)) && text.lines().count() > 2, "{text}");
}

#[test]
fn the_curves_have_no_updates_of_a_training_that_was_killed_before_it_saved_them() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state.safetensors");
    let shown = || events::tests::steps_shown(folder.path(), "charts/learning_rate");
    let first = one_update(folder.path(), small(Critic::Own));
    let saved = std::fs::read(&state).unwrap();
    resume(folder.path()).unwrap();
    std::fs::write(&state, saved).unwrap();
    let resumed = resume(folder.path()).unwrap();
    assert!(shown().is_sorted_by(|before, after| before < after), "{:?}", shown());
    assert_eq!(shown().len() as u64, resumed.last.unwrap().number);
    assert_eq!(shown()[0] as u64, first.last.unwrap().agent_steps, "what was saved stays");
    // One that was killed before it saved anything begins anew.
    std::fs::remove_file(&state).unwrap();
    one_update(folder.path(), small(Critic::Own));
    assert_eq!(shown().len(), 1);
}

#[test]
fn a_recipes_unknown_keys_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recipe.toml");
    let read = |top: &str, intersection: &str, ppo: &str| {
        let usual = "missions = \"random\"\ncars = 12\nreward = \"corrected\"\naxes = \"world\"";
        std::fs::write(&path, format!("{top}\n[intersection]\n{usual}\n{intersection}\n[ppo]\n{ppo}\n")).unwrap();
        TrainingSettings::read(&path).map_err(|error| error.to_string())
    };
    let settings = read("mixed = true", "sight = \"routes\"", "hidden = 8").unwrap();
    assert_eq!((settings.world.mixed, settings.algorithm.hidden()), (true, 8));
    for (told, expected) in [
        (read("mixd = true", "", ""), "got mixd; did you mean \"mixed\"?"),
        (read("", "sped = 3", ""), "got intersection.sped"),
        (read("", "", "entrpy = 0.1"), "unknown field `entrpy`"),
    ] {
        let error = told.unwrap_err();
        assert!(error.contains("recipe.toml: ") && error.contains(expected), "{error}");
    }
    let error = read("", "", "hidden = 8\nseed = -1").unwrap_err();
    assert!(error.contains("line 10, column 8"), "where it is: {error}");
    let error = read("", "", "[maddpg]").unwrap_err();
    assert!(error.contains("expected one table, [ppo] or [maddpg], got both"), "{error}");
    let usual = "[intersection]\nmissions = \"random\"\ncars = 12\nreward = \"corrected\"\naxes = \"world\"\n";
    for (algorithm, expected) in
        [("", "expected a table [ppo] or [maddpg], got neither"), ("[Ppo]", "did you mean \"ppo\"?")]
    {
        std::fs::write(&path, format!("{usual}{algorithm}\n")).unwrap();
        let error = TrainingSettings::read(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn settings_that_cannot_be_followed_are_refused() {
    for (settings, expected) in [
        (PpoSettings { minibatch: 1, ..PpoSettings::default() }, "minibatch: expected at least 2"),
        (PpoSettings { steps: 0, ..PpoSettings::default() }, "steps: expected 1 to 65536, got 0"),
        (
            PpoSettings { gamma_end: Some(1.0), ..PpoSettings::default() },
            "gamma_end: expected below 1, where gamma and gamma_end differ, got 1",
        ),
        (PpoSettings { gamma: 1.5, ..PpoSettings::default() }, "gamma: expected 0 to 1, got 1.5"),
        (PpoSettings { hidden: 4097, ..PpoSettings::default() }, "hidden: expected 1 to 4096, got 4097"),
        (PpoSettings { agent_steps: 0, ..PpoSettings::default() }, "agent_steps: expected at least 1, got 0"),
        (PpoSettings { entropy: -1.0, ..PpoSettings::default() }, "entropy: expected a number of at least 0, got -1"),
        (PpoSettings { entropy_end: Some(-0.5), ..PpoSettings::default() }, "entropy_end: expected a number of at"),
        (PpoSettings { value: -1.0, ..PpoSettings::default() }, "value: expected a number of at least 0, got -1"),
        (PpoSettings { clip: 0.0, ..PpoSettings::default() }, "clip: expected a number above 0, got 0"),
        (PpoSettings { largest_gradient: -1.0, ..PpoSettings::default() }, "largest_gradient: expected a number above"),
        (PpoSettings { reward_scale: f32::NAN, ..PpoSettings::default() }, "reward_scale: expected a number above 0"),
        (PpoSettings { collectors: 0, ..PpoSettings::default() }, "collectors: expected 1 to 64, got 0"),
        (PpoSettings { learning_rate: f64::NAN, ..PpoSettings::default() }, "learning_rate: expected a number above 0"),
    ] {
        let error = Ppo::new(settings, World::default()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    for (settings, expected) in [
        (MaddpgSettings { hidden: 4097, ..MaddpgSettings::default() }, "hidden: expected 1 to 4096, got 4097"),
        (MaddpgSettings { agent_steps: 0, ..MaddpgSettings::default() }, "agent_steps: expected at least 1, got 0"),
        (MaddpgSettings { tau: 2.0, ..MaddpgSettings::default() }, "tau: expected 0 to 1, got 2"),
        (MaddpgSettings { reward_scale: 0.0, ..MaddpgSettings::default() }, "reward_scale: expected a number above 0"),
    ] {
        let error = Maddpg::new(settings, World::default()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let crowded = World { intersection: Settings { cars: 13, ..Settings::default() }, mixed: false };
    let error = Algorithm::default().begin(crowded).unwrap_err().to_string();
    assert_eq!(error, "cars: expected 0 to 12, got 13");
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
