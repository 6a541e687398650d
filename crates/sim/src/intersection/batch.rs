//! Many intersections at once, stepped into buffers that the caller keeps: nothing is allocated after the start.

use rand::SeedableRng;
use rand_chacha::{ChaCha8Rng, rand_core::Rng};

use super::{AGENTS, Action, Environment, Missions, STATE, Settings, environment::Ending, environment::Tally};

/// Intersections that are stepped together.
///
/// An episode that is over begins anew at the next step, which takes no actions then and drives nobody (as Gymnasium's
/// `AutoresetMode.NEXT_STEP`). So the last observation of an episode is seen, and agents that have ended stay in the
/// batch: [`Buffers::drove`] says whose numbers count.
#[derive(Debug, Clone)]
pub struct Batch {
    environments: Vec<Environment>,
    /// Numbers in an observation.
    numbers: usize,
}

/// What a step gives, for each agent of each intersection in turn.
#[derive(Debug)]
pub struct Buffers<'a> {
    /// As many numbers each as its [`Sight`](super::Sight) has, after the step; those of agents that have ended before are left as they are.
    pub observations: &'a mut [f32],
    /// One each.
    pub rewards: &'a mut [f32],
    /// Whether it drove in this step.
    pub drove: &'a mut [bool],
    /// Whether it ended in this step for good.
    pub terminated: &'a mut [bool],
    /// Whether its time was up after this step.
    pub truncated: &'a mut [bool],
}

impl Batch {
    /// So many intersections; each has a stream of random numbers of its own, drawn from the seed.
    pub fn new(settings: Settings, count: usize, seed: u64) -> Self {
        let mut seeds = ChaCha8Rng::seed_from_u64(seed);
        let environments = (0..count).map(|_| Environment::new(settings, seeds.next_u64())).collect();
        Self { environments, numbers: settings.sight.numbers() }
    }

    /// The same with four kinds in turn: the benchmark's missions and random ones, without traffic and with it.
    pub fn mixed(settings: Settings, count: usize, seed: u64) -> Self {
        let mut seeds = ChaCha8Rng::seed_from_u64(seed);
        let kind = |e: usize| {
            let missions = if e.is_multiple_of(2) { Missions::Benchmark } else { Missions::Random };
            Settings { missions, cars: if (e / 2).is_multiple_of(2) { 0 } else { settings.cars }, ..settings }
        };
        let environments = (0..count).map(|e| Environment::new(kind(e), seeds.next_u64())).collect();
        Self { environments, numbers: settings.sight.numbers() }
    }

    /// The same intersections in batches of so many; the last may have fewer.
    pub fn split(mut self, count: usize) -> Vec<Self> {
        let mut batches = Vec::new();
        while !self.environments.is_empty() {
            let rest = self.environments.split_off(count.clamp(1, self.environments.len()));
            batches.push(Self { environments: std::mem::replace(&mut self.environments, rest), numbers: self.numbers });
        }
        batches
    }

    /// Number of agents in all intersections.
    pub fn agents(&self) -> usize {
        self.environments.len() * AGENTS
    }

    /// The intersections.
    pub fn environments(&self) -> &[Environment] {
        &self.environments
    }

    /// Numbers in each agent's observation.
    pub fn numbers(&self) -> usize {
        self.numbers
    }

    /// Writes all present observations, [`numbers`](Self::numbers) for each agent.
    pub fn observe(&self, observations: &mut [f32]) {
        let each = observations.chunks_exact_mut(AGENTS * self.numbers);
        for (environment, out) in self.environments.iter().zip(each) {
            write(environment, [true; AGENTS], out);
        }
    }

    /// Writes the whole situation of each intersection, [`STATE`] numbers each.
    pub fn states(&self, states: &mut [f32]) {
        for (environment, out) in self.environments.iter().zip(states.as_chunks_mut::<STATE>().0) {
            environment.state(out);
        }
    }

    /// Steps all intersections with one [`Action`] for each agent, as its number.
    ///
    /// # Panics
    /// If a buffer is not as long as the agents need.
    pub fn step(&mut self, actions: &[u8], buffers: Buffers<'_>) {
        let Buffers { observations, rewards, drove, terminated, truncated } = buffers;
        let (agents, numbers) = (self.agents(), self.numbers);
        assert_eq!(
            [actions.len(), observations.len(), rewards.len(), drove.len(), terminated.len(), truncated.len()],
            [agents, agents * numbers, agents, agents, agents, agents],
            "one of each for each agent"
        );
        for (e, environment) in self.environments.iter_mut().enumerate() {
            let at = e * AGENTS..(e + 1) * AGENTS;
            let out = &mut observations[at.start * numbers..at.end * numbers];
            if environment.is_over() {
                environment.begin();
                write(environment, [true; AGENTS], out);
                rewards[at.clone()].fill(0.0);
                for flags in [&mut *drove, &mut *terminated, &mut *truncated] {
                    flags[at.clone()].fill(false);
                }
            } else {
                let step = environment.step(std::array::from_fn(|i| Action::of(actions[at.start + i])));
                rewards[at.clone()].copy_from_slice(&step.rewards);
                drove[at.clone()].copy_from_slice(&step.drove);
                terminated[at.clone()].copy_from_slice(&step.terminated);
                truncated[at.clone()].copy_from_slice(&step.truncated);
                write(environment, step.drove, out);
            }
        }
    }

    /// The episodes that ended with the last step: how each agent's did, and what is told of it.
    pub fn finished(&self) -> impl Iterator<Item = [(Ending, Tally); AGENTS]> {
        self.environments.iter().filter(|environment| environment.is_over()).map(Environment::episode)
    }
}

/// Writes what some of the agents see.
fn write(environment: &Environment, whose: [bool; AGENTS], out: &mut [f32]) {
    let numbers = environment.settings().sight.numbers();
    for (i, out) in out.chunks_exact_mut(numbers).enumerate().filter(|(i, _)| whose[*i]) {
        out.copy_from_slice(environment.observation(i));
    }
}
