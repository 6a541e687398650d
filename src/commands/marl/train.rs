//! `lapwing marl train`.

use std::{
    io::{self, IsTerminal},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use indicatif::{ProgressBar, ProgressStyle};

use super::{Ended, print};
use crate::{
    cli::{AxesKind, CriticKind, MarlTrain, RewardKind},
    commands::{interrupted, outputs},
};
use lapwing_learn::{
    marl::{MarlOutcome, PpoSettings, Training, Update, ppo::Critic, training::TrainingSettings},
    nn::runtime,
    train::Go,
};
use lapwing_sim::intersection::{Axes, Reward};

/// Updates for which a line is printed where there is no terminal: one of so many.
const LINE_EVERY: u64 = 10;

pub(super) fn run(arguments: &MarlTrain) -> anyhow::Result<Ended> {
    outputs::check_folder(&arguments.out)?;
    runtime::set_threads(arguments.threads);
    let mut training = Training::new(&arguments.out, settings(arguments), arguments.resume)?;
    let stop = interrupted();
    let is_terminal = io::stderr().is_terminal();
    let bar = if is_terminal { ProgressBar::new(1000) } else { ProgressBar::hidden() };
    bar.set_style(ProgressStyle::with_template("{wide_bar} {percent}% {msg}, {elapsed}")?);
    let wall = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs_f64();
    let outcome = training.run(wall, |update, pace, done| {
        bar.set_position((done * 1000.0) as u64);
        bar.set_message(line(update, pace));
        if !is_terminal && update.number % LINE_EVERY == 0 {
            say!("{:>3.0} %  {}", done * 100.0, line(update, pace));
        }
        if stop.is_pressed() { Go::Stop } else { Go::On }
    });
    bar.finish_and_clear();
    let outcome = outcome?;
    print(&if arguments.json { crate::commands::sorted_json(&outcome)? } else { told(&outcome) })?;
    if !outcome.finished {
        say!("stopped; to resume: lapwing marl train --resume --out {}", arguments.out.display());
    }
    Ok(if outcome.finished { Ended::Passed } else { Ended::Failed })
}

fn settings(arguments: &MarlTrain) -> TrainingSettings {
    let reward = match arguments.reward {
        RewardKind::Smarts => Reward::Smarts,
        RewardKind::Corrected => Reward::Corrected,
    };
    let axes = match arguments.axes {
        AxesKind::World => Axes::World,
        AxesKind::Car => Axes::Car,
    };
    let critic = match arguments.critic {
        CriticKind::Own => Critic::Own,
        CriticKind::Central => Critic::Central,
    };
    let usual = PpoSettings::default();
    let ppo = PpoSettings {
        critic,
        agent_steps: arguments.agent_steps.unwrap_or(usual.agent_steps),
        intersections: arguments.intersections.unwrap_or(usual.intersections),
        hidden: arguments.hidden.unwrap_or(usual.hidden),
        learning_rate: arguments.learning_rate.unwrap_or(usual.learning_rate),
        entropy: arguments.entropy.unwrap_or(usual.entropy),
        gamma: arguments.gamma.map_or(usual.gamma, |gamma| gamma as f32),
        seed: arguments.seed,
        ..usual
    };
    TrainingSettings { intersection: arguments.intersection.settings(reward, axes), ppo }
}

fn line(update: &Update, pace: f64) -> String {
    format!(
        "{:.2} M agent-steps  collisions {:5.1} %  completed {:5.1} %  entropy {:.2}  {pace:.0} agent-steps/s",
        update.agent_steps as f64 / 1e6,
        update.collision_rate * 100.0,
        update.completion_rate * 100.0,
        update.entropy,
    )
}

fn told(outcome: &MarlOutcome) -> String {
    let mut told = format!("{} ({:.0} s", outcome.policy.display(), outcome.seconds);
    if let Some(seconds) = outcome.seconds_to_80 {
        told += &format!(", 80 % completed after {seconds:.0} s");
    }
    if let Some(last) = &outcome.last {
        let rates = (last.collision_rate * 100.0, last.completion_rate * 100.0);
        told += &format!("; last rollout: collisions {:.1} %, completed {:.1} %", rates.0, rates.1);
    }
    told + ")"
}
