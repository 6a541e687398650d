//! What every algorithm is to a training: something that drives and learns, one update after the other.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use tch::Tensor;

use super::{Maddpg, MaddpgSettings, MarlError, Ppo, PpoSettings, error::expect, policy::Mlp};
use lapwing_sim::intersection::{Batch, CARS, Settings};

/// Where agents learn.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct World {
    /// The intersection.
    pub intersection: Settings,
    /// Whether half of the intersections have the benchmark's missions, the others random ones, and half no traffic.
    #[serde(default)]
    pub mixed: bool,
}

impl World {
    /// Whether there can be such a world.
    ///
    /// # Errors
    /// [`MarlError::Setting`], if there are too many cars.
    fn check(self) -> Result<(), MarlError> {
        expect([("cars", self.intersection.cars)], "0 to 12", |cars| cars <= CARS)
    }

    /// So many intersections.
    pub(super) fn batch(self, count: usize, seed: u64) -> Batch {
        let make = if self.mixed { Batch::mixed } else { Batch::new };
        make(self.intersection, count, seed)
    }
}

/// Which algorithm, and how.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Algorithm {
    /// On policy, synchronous.
    Ppo(PpoSettings),
    /// Off policy, from a replay memory.
    Maddpg(MaddpgSettings),
}

impl Default for Algorithm {
    fn default() -> Self {
        Self::Ppo(PpoSettings::default())
    }
}

impl Algorithm {
    /// Its name in files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Ppo(_) => "ppo",
            Self::Maddpg(_) => "maddpg",
        }
    }

    /// Units in each hidden layer.
    pub fn hidden(&self) -> usize {
        match self {
            Self::Ppo(settings) => settings.hidden,
            Self::Maddpg(settings) => settings.hidden,
        }
    }

    /// Agent-steps in all.
    pub fn agent_steps(&mut self) -> &mut u64 {
        match self {
            Self::Ppo(settings) => &mut settings.agent_steps,
            Self::Maddpg(settings) => &mut settings.agent_steps,
        }
    }

    /// Of everything random.
    pub fn seed(&mut self) -> &mut u64 {
        match self {
            Self::Ppo(settings) => &mut settings.seed,
            Self::Maddpg(settings) => &mut settings.seed,
        }
    }

    /// At the begin of a training.
    ///
    /// # Errors
    /// [`MarlError::Setting`], and those of libtorch.
    pub(super) fn begin(self, world: World) -> Result<Box<dyn Learner>, MarlError> {
        world.check()?;
        Ok(match self {
            Self::Ppo(settings) => Box::new(Ppo::new(settings, world)?),
            Self::Maddpg(settings) => Box::new(Maddpg::new(settings, world)?),
        })
    }
}

/// An algorithm at work.
pub(super) trait Learner: std::fmt::Debug {
    /// Drives for a while, and learns; one that may take long ends early where it `is_stopped`, between two steps.
    ///
    /// # Errors
    /// [`MarlError::NotFinite`], and those of libtorch.
    fn update(&mut self, is_stopped: &dyn Fn() -> bool) -> Result<Update, MarlError>;

    /// The share of the training that is done; 1 is the end.
    fn progress(&self) -> f64;

    /// The network that drives.
    fn actor(&self) -> &Mlp;

    /// All that is stored: weights and moments, by name.
    fn tensors(&self) -> Vec<(String, Tensor)>;

    /// What is stored besides.
    fn counters(&self) -> Counters;

    /// Goes on from what was stored; the tensors have been filled.
    fn go_on_at(&mut self, counters: Counters);
}

/// Where a training is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Counters {
    /// Agent-steps so far.
    pub agent_steps: u64,
    /// Updates so far.
    pub updates: u64,
    /// Steps of the optimiser so far.
    pub optimiser_steps: i64,
    /// Joint transitions so far, where a replay memory is fed with them.
    #[serde(default)]
    pub transitions: u64,
}

/// What an update found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Update {
    /// From 1.
    pub number: u64,
    /// Agent-steps so far: those of agents that drove.
    pub agent_steps: u64,
    /// Gradient steps so far.
    pub gradient_steps: u64,
    /// Episodes that ended since the last update.
    pub episodes: u64,
    /// Share of their agents that crashed.
    pub collision_rate: f64,
    /// Share that reached their goals.
    pub completion_rate: f64,
    /// Share of the episodes in which all agents reached their goals.
    pub all_completed: f64,
    /// Mean undiscounted sum of rewards.
    pub reward: f64,
    /// Mean duration of an agent's episode, in seconds.
    pub seconds: f64,
    /// Learning rate.
    pub learning_rate: f64,
    /// What the algorithm logs of itself, by name.
    pub losses: BTreeMap<&'static str, f64>,
}
