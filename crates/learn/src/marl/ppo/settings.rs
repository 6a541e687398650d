//! What PPO is told: its settings, and what they come to in the course of a training.

use serde::{Deserialize, Serialize};

use crate::marl::{
    MarlError,
    error::{expect, expect_above_zero},
    policy::HIDDEN,
};

/// What the critic sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Critic {
    /// What the agent sees.
    #[default]
    Own,
    /// The whole situation, too.
    Central,
}

/// The settings of the algorithm. Defaults are cleanrl's unless a reason is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PpoSettings {
    /// What the critic sees.
    pub critic: Critic,
    /// Agent-steps in all: those of agents that drive.
    pub agent_steps: u64,
    /// Intersections side by side; 64, as stepping them costs little.
    pub intersections: usize,
    /// Steps of each before an update; 128.
    pub steps: usize,
    /// Agent-steps in a minibatch; 1024.
    pub minibatch: usize,
    /// Passes over the batch in an update; 4.
    pub epochs: usize,
    /// At the begin; it falls to 0. 1e-3: four times cleanrl's, as minibatches are eight times as large.
    pub learning_rate: f64,
    /// Discount at the begin; 0.99.
    pub gamma: f32,
    /// At the end; none: as at the begin. The time that it looks ahead, 1 / (1 - gamma) steps, grows by the same factor in
    /// each part of the training. Agents that look far ahead from the beginning first learn to wait.
    pub gamma_end: Option<f32>,
    /// Of generalised advantage estimation; 0.95.
    pub lambda: f32,
    /// How far the policy's ratio and the value may move; 0.2.
    pub clip: f64,
    /// Weight of the entropy at the begin; 0.01.
    pub entropy: f64,
    /// At the end; none: as at the begin, and evenly from one to the other. The likeliest actions are what drives in the end,
    /// but with sectors agents learn to stand still if it falls to 0.
    pub entropy_end: Option<f64>,
    /// Weight of the value loss; 0.5.
    pub value: f64,
    /// Largest norm of all gradients; 0.5.
    pub largest_gradient: f64,
    /// Units in each hidden layer; 64.
    pub hidden: usize,
    /// What rewards are multiplied with: 0.05, so that a goal is worth 1.
    pub reward_scale: f32,
    /// Threads that drive while a rollout is collected; 1. The result is the same with any number of them.
    pub collectors: usize,
    /// Of everything random.
    pub seed: u64,
}

impl Default for PpoSettings {
    fn default() -> Self {
        Self {
            critic: Critic::Own,
            agent_steps: 3_000_000,
            intersections: 64,
            steps: 128,
            minibatch: 1024,
            epochs: 4,
            learning_rate: 1e-3,
            gamma: 0.99,
            gamma_end: None,
            lambda: 0.95,
            clip: 0.2,
            entropy: 0.01,
            entropy_end: None,
            value: 0.5,
            largest_gradient: 0.5,
            hidden: 64,
            reward_scale: 0.05,
            collectors: 1,
            seed: 0,
        }
    }
}

impl PpoSettings {
    pub(super) fn check(&self) -> Result<(), MarlError> {
        let counts = [
            ("intersections", self.intersections),
            ("steps", self.steps),
            ("minibatch", self.minibatch),
            ("epochs", self.epochs),
        ];
        expect(counts, "1 to 65536", |count| (1..=65_536).contains(&count))?;
        expect([("hidden", self.hidden)], "1 to 4096", |units| HIDDEN.contains(&units))?;
        expect([("agent_steps", self.agent_steps)], "at least 1", |steps| steps > 0)?;
        expect([("collectors", self.collectors)], "1 to 64", |threads| (1..=64).contains(&threads))?;
        let expected = "at least 2, as advantages are divided by their deviation";
        expect([("minibatch", self.minibatch)], expected, |samples| samples >= 2)?;
        expect_above_zero([
            ("learning_rate", self.learning_rate),
            ("clip", self.clip),
            ("largest_gradient", self.largest_gradient),
            ("reward_scale", f64::from(self.reward_scale)),
        ])?;
        let weights = [("value", Some(self.value)), ("entropy", Some(self.entropy)), ("entropy_end", self.entropy_end)];
        let weights = weights.into_iter().filter_map(|(name, weight)| Some((name, weight?)));
        expect(weights, "a number of at least 0", |weight| weight >= 0.0 && weight.is_finite())?;
        let end = self.gamma_end.unwrap_or(self.gamma);
        let gammas = [("gamma", self.gamma), ("gamma_end", end)];
        let shares = gammas.into_iter().chain([("lambda", self.lambda)]);
        expect(shares, "0 to 1", |share| (0.0..=1.0).contains(&share))?;
        expect(gammas, "below 1, where gamma and gamma_end differ", |gamma| gamma < 1.0 || end == self.gamma)
    }

    /// The discount once a share of the training is done.
    pub(in crate::marl) fn gamma_at(&self, done: f64) -> f32 {
        match self.gamma_end {
            Some(end) if end != self.gamma => {
                1.0 - (1.0 - self.gamma) * ((1.0 - end) / (1.0 - self.gamma)).powf(done as f32)
            }
            _ => self.gamma,
        }
    }

    /// The weight of the entropy then.
    pub(in crate::marl) fn entropy_at(&self, done: f64) -> f64 {
        self.entropy + (self.entropy_end.unwrap_or(self.entropy) - self.entropy) * done
    }
}
