//! One intersection in the manner of PettingZoo's parallel API.

use std::collections::BTreeMap;

use super::{AGENTS, Action, Ending, Environment, STATE, Settings};

/// An agent's name.
pub type Name = &'static str;

/// All agents' names.
pub const NAMES: [Name; AGENTS] = ["agent_0", "agent_1", "agent_2", "agent_3"];

/// Why a step cannot be taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StepError {
    /// An agent that drives was given no action.
    #[error("expected an action for each of {expected:?}, got none for {missing}")]
    Missing {
        /// Who drives.
        expected: Vec<Name>,
        /// Who was forgotten.
        missing: Name,
    },
    /// An action was given to somebody who does not drive.
    #[error("expected actions for {expected:?} alone, got one for {got:?}")]
    Unknown {
        /// Who drives.
        expected: Vec<Name>,
        /// Who does not.
        got: String,
    },
}

/// What a step gives, by agent; only those who drove are in it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stepped {
    /// What they see: as many numbers as their [`Sight`](super::Sight) has.
    pub observations: BTreeMap<Name, Vec<f32>>,
    /// What they earned.
    pub rewards: BTreeMap<Name, f32>,
    /// Who ended for good.
    pub terminations: BTreeMap<Name, bool>,
    /// Whose time is up.
    pub truncations: BTreeMap<Name, bool>,
    /// How those ended that did: crashes say with whom and whose fault they were.
    pub infos: BTreeMap<Name, Option<Ending>>,
}

/// The intersection.
#[derive(Debug, Clone)]
pub struct Parallel {
    environment: Environment,
}

impl Parallel {
    /// At the begin of the episode of seed 0.
    pub fn new(settings: Settings) -> Self {
        Self { environment: Environment::new(settings, 0) }
    }

    /// All agents that there ever are.
    pub fn possible_agents(&self) -> [Name; AGENTS] {
        NAMES
    }

    /// Those that still drive. The episode is over when there are none.
    pub fn agents(&self) -> Vec<Name> {
        let alive = self.environment.alive();
        NAMES.into_iter().zip(alive).filter_map(|(name, alive)| alive.then_some(name)).collect()
    }

    /// Begins the episode of a seed; returns what all agents see.
    pub fn reset(&mut self, seed: u64) -> BTreeMap<Name, Vec<f32>> {
        self.environment.reset(seed);
        NAMES.into_iter().enumerate().map(|(i, name)| (name, self.environment.observation(i).to_vec())).collect()
    }

    /// A tenth of a second.
    ///
    /// # Errors
    /// [`StepError`], and nothing has changed.
    pub fn step(&mut self, actions: &BTreeMap<&str, Action>) -> Result<Stepped, StepError> {
        let expected = self.agents();
        if let Some(missing) = expected.iter().find(|name| !actions.contains_key(**name)) {
            return Err(StepError::Missing { missing, expected });
        }
        if let Some(got) = actions.keys().find(|name| !expected.contains(name)) {
            return Err(StepError::Unknown { got: (*got).to_owned(), expected });
        }
        let actions = NAMES.map(|name| actions.get(name).copied().unwrap_or_default());
        let step = self.environment.step(actions);
        let (endings, mut stepped) = (self.environment.endings(), Stepped::default());
        for (i, name) in NAMES.into_iter().enumerate().filter(|(i, _)| step.drove[*i]) {
            stepped.observations.insert(name, self.environment.observation(i).to_vec());
            stepped.rewards.insert(name, step.rewards[i]);
            stepped.terminations.insert(name, step.terminated[i]);
            stepped.truncations.insert(name, step.truncated[i]);
            stepped.infos.insert(name, endings[i]);
        }
        Ok(stepped)
    }

    /// The whole situation, for a centralised critic: [`STATE`] numbers.
    pub fn state(&self) -> Vec<f32> {
        let mut state = [0.0; STATE];
        self.environment.state(&mut state);
        state.to_vec()
    }

    /// How many numbers an observation has, and how many actions there are: the same for all agents.
    pub fn spaces(&self) -> (usize, usize) {
        (self.environment.settings().sight.numbers(), Action::ALL.len())
    }

    /// The environment beneath.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }
}
