//! `lapwing marl train`.

use std::{
    io::{self, IsTerminal},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use indicatif::{ProgressBar, ProgressStyle};

use super::{Ended, print};
use crate::{
    cli::{AlgorithmKind, AxesKind, CriticKind, MarlTrain, ObservationKind, ReplayKind, RewardKind},
    commands::{interrupted, outputs, terminal},
};
use lapwing_core::config::ConfigError;
use lapwing_learn::{
    marl::{
        Algorithm, MaddpgSettings, MarlError, MarlOutcome, PpoSettings, Training, Update, World, ppo::Critic,
        priorities::Replay, training::TrainingSettings,
    },
    nn::runtime,
};
use lapwing_sim::intersection::{Axes, Reward, Settings, Sight};

/// Updates for which a line is printed where there is no terminal: one of so many.
const LINE_EVERY: u64 = 10;

pub(super) fn run(arguments: &MarlTrain) -> anyhow::Result<Ended> {
    outputs::check_folder(&arguments.out)?;
    runtime::set_threads(arguments.threads);
    let mut training = begin(arguments)?;
    let stop = interrupted();
    let is_terminal = io::stderr().is_terminal();
    let bar = if is_terminal { ProgressBar::new(1000) } else { ProgressBar::hidden() };
    bar.set_style(ProgressStyle::with_template("{wide_bar} {percent}% {msg}, {elapsed}")?);
    let wall = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs_f64();
    let is_stopped = || stop.is_pressed();
    let outcome = training.run(wall, is_stopped, |update, pace, done| {
        bar.set_position((done * 1000.0) as u64);
        bar.set_message(line(update, pace));
        if !is_terminal && update.number % LINE_EVERY == 0 {
            say!("{:>3.0} %  {}", done * 100.0, line(update, pace));
        }
    });
    bar.finish_and_clear();
    let outcome = outcome?;
    print(&if arguments.json { crate::commands::sorted_json(&outcome)? } else { told(&outcome) })?;
    if !outcome.finished {
        say!("stopped; to resume: lapwing marl train --resume --out {}", terminal::pasted(&arguments.out));
    }
    Ok(if outcome.finished { Ended::Passed } else { Ended::Failed })
}

/// The training of the flags; what cannot be followed is told by flag, or by key of the recipe.
fn begin(arguments: &MarlTrain) -> anyhow::Result<Training> {
    let begun = match arguments.resume {
        true => Training::resume(&arguments.out, arguments.agent_steps),
        false => Training::new(&arguments.out, settings(arguments)?),
    };
    begun.map_err(|error| match (error, &arguments.recipe) {
        (MarlError::Setting { name, expected, got }, None) => of_flag(name, expected, &got).into(),
        (MarlError::Setting { name, expected, got }, Some(path)) => {
            let why = format!("{name}: expected {expected}, got {got}");
            MarlError::Recipe { path: path.clone(), why }.into()
        }
        (error, _) => error.into(),
    })
}

/// The error about the flag from which a setting came.
fn of_flag(name: &str, expected: &str, got: &str) -> ConfigError {
    let flag = match name {
        "minibatch" => "batch",
        "critic_rate" => "learning-rate",
        name => name,
    };
    let layer = format!("--{}", flag.replace('_', "-"));
    ConfigError::Value { layer, why: format!("expected {expected}, got {got}") }
}

/// Refuses what only the other algorithm would follow.
fn check_algorithm(arguments: &MarlTrain) -> Result<(), ConfigError> {
    let of_ppo = [
        ("--critic", arguments.critic.is_some()),
        ("--entropy", arguments.entropy.is_some()),
        ("--entropy-end", arguments.entropy_end.is_some()),
        ("--gamma-end", arguments.gamma_end.is_some()),
        ("--collectors", arguments.collectors.is_some()),
    ];
    let of_maddpg = [
        ("--replay", arguments.replay.is_some()),
        ("--every", arguments.every.is_some()),
        ("--memory", arguments.memory.is_some()),
        ("--learners", arguments.learners.is_some()),
        ("--actor-rate", arguments.actor_rate.is_some()),
    ];
    let (flags, owner, got) = match arguments.algorithm {
        AlgorithmKind::Ppo => (of_maddpg, "maddpg", "ppo"),
        AlgorithmKind::Maddpg => (of_ppo, "ppo", "maddpg"),
    };
    match flags.into_iter().find(|(_, is_given)| *is_given) {
        Some((flag, _)) => Err(ConfigError::Value {
            layer: flag.into(),
            why: format!("expected --algorithm {owner}, to which this flag belongs, got {got}"),
        }),
        None => Ok(()),
    }
}

fn settings(arguments: &MarlTrain) -> anyhow::Result<TrainingSettings> {
    if let Some(path) = &arguments.recipe {
        let mut settings = TrainingSettings::read(path)?;
        if let Some(seed) = arguments.seed {
            *settings.algorithm.seed() = seed;
        }
        return Ok(settings);
    }
    check_algorithm(arguments)?;
    let reward = match arguments.reward {
        RewardKind::Smarts => Reward::Smarts,
        RewardKind::Corrected => Reward::Corrected,
    };
    let axes = match arguments.axes {
        AxesKind::World => Axes::World,
        AxesKind::Car => Axes::Car,
    };
    let sight = match arguments.observation {
        ObservationKind::Sectors => Sight::Sectors,
        ObservationKind::Routes => Sight::Routes,
    };
    if (axes, sight) == (Axes::Car, Sight::Routes) {
        let why = "expected --observation sectors with it, got routes, which are told from the car in any case";
        return Err(ConfigError::Value { layer: "--axes car".into(), why: why.into() }.into());
    }
    let learning = Settings { reward, axes, sight, ..Settings::default() };
    let world = World { intersection: arguments.intersection.settings(learning), mixed: arguments.mixed };
    let algorithm = match arguments.algorithm {
        AlgorithmKind::Ppo => Algorithm::Ppo(ppo(arguments)),
        AlgorithmKind::Maddpg => Algorithm::Maddpg(maddpg(arguments)),
    };
    Ok(TrainingSettings { world, algorithm })
}

fn ppo(arguments: &MarlTrain) -> PpoSettings {
    let usual = PpoSettings::default();
    PpoSettings {
        critic: match arguments.critic.unwrap_or_default() {
            CriticKind::Own => Critic::Own,
            CriticKind::Central => Critic::Central,
        },
        agent_steps: arguments.agent_steps.unwrap_or(usual.agent_steps),
        intersections: arguments.intersections.unwrap_or(usual.intersections),
        minibatch: arguments.batch.unwrap_or(usual.minibatch),
        hidden: arguments.hidden.unwrap_or(usual.hidden),
        learning_rate: arguments.learning_rate.unwrap_or(usual.learning_rate),
        entropy: arguments.entropy.unwrap_or(usual.entropy),
        entropy_end: arguments.entropy_end,
        gamma: arguments.gamma.map_or(usual.gamma, |gamma| gamma as f32),
        gamma_end: arguments.gamma_end.map(|gamma| gamma as f32),
        collectors: arguments.collectors.map_or(usual.collectors, usize::from),
        seed: arguments.seed.unwrap_or(usual.seed),
        ..usual
    }
}

fn maddpg(arguments: &MarlTrain) -> MaddpgSettings {
    let usual = MaddpgSettings::default();
    MaddpgSettings {
        agent_steps: arguments.agent_steps.unwrap_or(usual.agent_steps),
        intersections: arguments.intersections.unwrap_or(usual.intersections),
        batch: arguments.batch.unwrap_or(usual.batch),
        every: arguments.every.unwrap_or(usual.every),
        memory: arguments.memory.unwrap_or(usual.memory),
        replay: match arguments.replay.unwrap_or_default() {
            ReplayKind::Uniform => Replay::Uniform,
            ReplayKind::Proportional => Replay::Proportional,
            ReplayKind::Rank => Replay::Rank,
        },
        hidden: arguments.hidden.unwrap_or(usual.hidden),
        critic_rate: arguments.learning_rate.unwrap_or(usual.critic_rate),
        actor_rate: arguments.actor_rate.unwrap_or(usual.actor_rate),
        gamma: arguments.gamma.map_or(usual.gamma, |gamma| gamma as f32),
        learners: arguments.learners.map_or(usual.learners, usize::from),
        seed: arguments.seed.unwrap_or(usual.seed),
        ..usual
    }
}

fn line(update: &Update, pace: f64) -> String {
    let ended = match update.episodes {
        0 => "no episode ended".to_owned(),
        _ => format!(
            "collisions {:5.1} %  completed {:5.1} %",
            update.collision_rate * 100.0,
            update.completion_rate * 100.0
        ),
    };
    format!("{:.2} M agent-steps  {ended}  {pace:.0} agent-steps/s", update.agent_steps as f64 / 1e6)
}

fn told(outcome: &MarlOutcome) -> String {
    let mut told = format!("{} ({:.0} s", outcome.policy.display(), outcome.seconds);
    if let Some(seconds) = outcome.seconds_to_80 {
        told += &format!(", all four in 80 % of a hundred episodes after {seconds:.0} s");
    }
    if let Some(last) = outcome.last.as_ref().filter(|last| last.episodes > 0) {
        let rates = (last.collision_rate * 100.0, last.completion_rate * 100.0);
        told += &format!("; last rollout: collisions {:.1} %, completed {:.1} %", rates.0, rates.1);
    }
    if outcome.last.as_ref().is_some_and(|last| last.gradient_steps == 0) {
        told += "; nothing was learnt: the training ended before its first gradient step";
    }
    told + ")"
}
