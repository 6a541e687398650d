//! What collects the rollouts of PPO: threads, each with some of the intersections.
//!
//! ```text
//! luck ─▶ parts ─▶ collectors: look, act, step; in the end values ─▶ rollouts ─▶ learning
//! ```
//!
//! The result does not depend on the number of threads. All that is random is drawn before they start. And a network is
//! given the agents of one [`Part`] at a time, whichever thread has it: a product of matrices of another size may round
//! differently.

use std::thread;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor, no_grad};

use super::{Critic, PpoSettings, Rollout};
use crate::marl::{
    MarlError,
    policy::{Mlp, copied},
};
use lapwing_sim::intersection::{ACTIONS, AGENTS, Batch, Buffers, Ending, STATE, Tally};

/// Intersections in a part; the last part may have fewer. Fewer would mean more, smaller calls of the networks.
const PART: usize = 32;

/// How each agent of an intersection ended, and what is told of it.
type Episode = [(Ending, Tally); AGENTS];

/// Both networks (detail 13), and what observations are multiplied with.
#[derive(Debug)]
pub(super) struct ActorCritic {
    pub actor: Mlp,
    pub critic: Mlp,
    pub scale: Tensor,
}

impl ActorCritic {
    /// With memory of its own: a tensor can be moved to another thread, but not shared with it.
    fn copy(&self) -> Result<Self, MarlError> {
        Ok(Self { actor: self.actor.copy()?, critic: self.critic.copy()?, scale: copied(&self.scale)? })
    }

    /// (B): values of scaled observations, and of the situations for a critic that sees these, too.
    pub fn value(&self, seen: &Tensor, situations: Option<&Tensor>) -> Result<Tensor, MarlError> {
        let value = match situations {
            None => self.critic.forward(seen)?,
            Some(situations) => self.critic.forward(&Tensor::f_cat(&[seen, situations], 1)?)?,
        };
        Ok(value.f_flatten(0, -1)?)
    }
}

/// Some of the intersections, and what happened there in the last rollout.
#[derive(Debug)]
pub(super) struct Part {
    pub world: Batch,
    pub rollout: Rollout,
    /// For each step and agent a number from 0 to 1 that decides what it does.
    luck: Vec<f32>,
}

impl Part {
    /// Cuts all intersections into parts.
    pub fn all(world: Batch, settings: &PpoSettings) -> Vec<Self> {
        world.split(PART).into_iter().map(|world| Self::new(world, settings)).collect()
    }

    fn new(world: Batch, settings: &PpoSettings) -> Self {
        let (agents, numbers) = (world.agents(), world.numbers());
        let rows = settings.steps * agents;
        let states = match settings.critic {
            Critic::Own => 0,
            Critic::Central => (settings.steps + 1) * agents / AGENTS * STATE,
        };
        let mut rollout = Rollout {
            observations: vec![0.0; (rows + agents) * numbers],
            states: vec![0.0; states],
            actions: vec![0; rows],
            log_probabilities: vec![0.0; rows],
            rewards: vec![0.0; rows],
            drove: vec![false; rows],
            terminated: vec![false; rows],
            truncated: vec![false; rows],
            values: vec![0.0; rows + agents],
            advantages: vec![0.0; rows],
        };
        world.observe(&mut rollout.observations[rows * numbers..]);
        Self { world, rollout, luck: vec![0.0; rows] }
    }

    /// Drives a number of steps (detail 1). Returns the episodes that ended.
    fn drive(&mut self, networks: &ActorCritic, settings: &PpoSettings) -> Result<Vec<Episode>, MarlError> {
        let (agents, mut ended) = (self.world.agents(), Vec::new());
        // What was seen after the last step of the last rollout comes first.
        let each = agents * self.world.numbers();
        self.rollout.observations.copy_within(settings.steps * each.., 0);
        for step in 0..settings.steps {
            self.note_states(step);
            self.act(step, networks)?;
            let at = step * agents..(step + 1) * agents;
            let rollout = &mut self.rollout;
            self.world.step(
                &rollout.actions[at.clone()],
                Buffers {
                    observations: &mut rollout.observations[(step + 1) * each..(step + 2) * each],
                    rewards: &mut rollout.rewards[at.clone()],
                    drove: &mut rollout.drove[at.clone()],
                    terminated: &mut rollout.terminated[at.clone()],
                    truncated: &mut rollout.truncated[at],
                },
            );
            ended.extend(self.world.finished());
        }
        self.note_states(settings.steps);
        self.judge(networks)?;
        for reward in &mut self.rollout.rewards {
            *reward *= settings.reward_scale;
        }
        Ok(ended)
    }

    /// Keeps the situations before a step for a critic that sees them.
    fn note_states(&mut self, step: usize) {
        if !self.rollout.states.is_empty() {
            let each = self.world.agents() / AGENTS * STATE;
            self.world.states(&mut self.rollout.states[step * each..(step + 1) * each]);
        }
    }

    /// Decides what each agent does in a step.
    pub fn act(&mut self, step: usize, networks: &ActorCritic) -> Result<(), MarlError> {
        let agents = self.world.agents();
        let rows = step * agents..(step + 1) * agents;
        let mut logs = vec![0.0_f32; agents * ACTIONS];
        no_grad(|| -> Result<_, MarlError> {
            let seen = self.seen(rows.start, agents, &networks.scale)?;
            Ok(networks
                .actor
                .forward(&seen)?
                .f_log_softmax(1, Kind::Float)?
                .f_copy_data(&mut logs, agents * ACTIONS)?)
        })?;
        for (row, logs) in rows.zip(logs.chunks_exact(ACTIONS)) {
            let mut left = self.luck[row];
            let chosen = logs.iter().position(|log| {
                left -= log.exp();
                left < 0.0
            });
            let action = chosen.unwrap_or(ACTIONS - 1);
            self.rollout.actions[row] = action as u8;
            self.rollout.log_probabilities[row] = logs[action];
        }
        Ok(())
    }

    /// Writes the values of all that was seen.
    pub fn judge(&mut self, networks: &ActorCritic) -> Result<(), MarlError> {
        let rows = self.rollout.values.len();
        let values =
            no_grad(|| networks.value(&self.seen(0, rows, &networks.scale)?, self.situations(0, rows)?.as_ref()))?;
        Ok(values.f_copy_data(&mut self.rollout.values, rows)?)
    }

    /// (count, numbers of an observation): scaled observations of rows of the rollout.
    pub fn seen(&self, from: usize, count: usize, scale: &Tensor) -> Result<Tensor, MarlError> {
        let numbers = self.world.numbers();
        let seen = &self.rollout.observations[from * numbers..(from + count) * numbers];
        Ok(Tensor::f_from_slice(seen)?.f_view([count as i64, numbers as i64])?.f_mul(scale)?)
    }

    /// (count, STATE): the situation that each of the agents is in, for a critic that sees it; rows begin with an
    /// intersection's first agent.
    pub fn situations(&self, from: usize, count: usize) -> Result<Option<Tensor>, MarlError> {
        if self.rollout.states.is_empty() {
            return Ok(None);
        }
        let numbers = &self.rollout.states[from / AGENTS * STATE..(from + count) / AGENTS * STATE];
        let each = Tensor::f_from_slice(numbers)?.f_view([(count / AGENTS) as i64, STATE as i64])?;
        Ok(Some(each.f_repeat_interleave_self_int(AGENTS as i64, 0, None)?))
    }
}

/// Draws what decides the actions of the next rollout.
pub(super) fn draw_luck(parts: &mut [Part], steps: usize, random: &mut ChaCha8Rng) {
    for step in 0..steps {
        for part in &mut *parts {
            let agents = part.world.agents();
            part.luck[step * agents..(step + 1) * agents].fill_with(|| random.random_range(0.0..1.0));
        }
    }
}

/// Lets as many threads as the settings say drive all parts through a rollout. Returns the episodes that ended, in the
/// order of the parts.
pub(super) fn collect(
    parts: &mut [Part],
    networks: &ActorCritic,
    settings: &PpoSettings,
) -> Result<Vec<Episode>, MarlError> {
    let each = parts.len().div_ceil(settings.collectors);
    thread::scope(|scope| {
        let threads = parts.chunks_mut(each).map(|parts| {
            let networks = networks.copy()?;
            Ok(scope.spawn(move || parts.iter_mut().map(|part| part.drive(&networks, settings)).collect()))
        });
        let threads: Vec<thread::ScopedJoinHandle<'_, Result<Vec<_>, MarlError>>> =
            threads.collect::<Result<_, MarlError>>()?;
        let mut ended = Vec::new();
        for thread in threads {
            match thread.join() {
                Ok(episodes) => ended.extend(episodes?.into_iter().flatten()),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        Ok(ended)
    })
}
