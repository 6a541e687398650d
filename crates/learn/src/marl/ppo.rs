//! Proximal Policy Optimization (Schulman et al. 2017) for agents that share one network (parameter sharing, as in Yu et
//! al. 2022, The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games).
//!
//! As cleanrl's `ppo.py` does it. Its details, with the numbers of Huang et al. 2022, The 37 Implementation Details of
//! Proximal Policy Optimization ("core"), are named where they are: 1 vectorised environments, 2 orthogonal
//! initialisation, 3 Adam with an epsilon of 1e-5, 4 a learning rate that falls to 0, 5 generalised advantage estimation,
//! 6 minibatches, 7 normalised advantages, 8 clipped surrogate, 9 clipped value loss, 10 entropy bonus, 11 gradients
//! clipped together, 12 what is logged, 13 two networks for policy and value.
//!
//! What differs: agents that have ended are masked out of the batch; a truncated episode is bootstrapped with the value
//! of its last observation (Pardo et al. 2018, Time Limits in Reinforcement Learning), where cleanrl takes it for a
//! terminal one; discount and entropy's weight may change towards the end; the inputs and rewards are divided by constants; and the batch is cut into minibatches of a given size.
//! With [`Critic::Central`] the value is that of the whole situation together with the agent's own view (MAPPO's
//! agent-specific global state); the actor is the same.

mod settings;

pub use settings::{Critic, PpoSettings};

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor, no_grad};

use super::{
    MarlError,
    learner::{Counters, Learner, Update, World},
    policy::{Mlp, scale},
};
use crate::train::{Optimiser, Stepper};
use lapwing_sim::intersection::{
    ACTIONS, AGENTS, Batch, Buffers, STATE,
    evaluation::{Evaluation, Sums},
};

/// What is logged of an update (detail 12): policy loss, value loss, the policy's entropy in nats (at most ln 4), how far
/// the policy moved (Schulman's estimator `(r - 1) - ln r` of the KL divergence), and the share of the ratios that were
/// clipped, all means over the minibatches.
const LOSSES: [&str; 5] = ["policy_loss", "value_loss", "entropy", "divergence", "clipped"];

/// A training between two updates.
#[derive(Debug)]
pub struct Ppo {
    settings: PpoSettings,
    actor: Mlp,
    critic: Mlp,
    stepper: Stepper,
    scale: Tensor,
    world: Batch,
    random: ChaCha8Rng,
    rollout: Rollout,
    agent_steps: u64,
    updates: u64,
}

impl Learner for Ppo {
    fn update(&mut self) -> Result<Update, MarlError> {
        self.rollout_and_learn()
    }

    fn progress(&self) -> f64 {
        (self.agent_steps as f64 / self.settings.agent_steps.max(1) as f64).min(1.0)
    }

    fn actor(&self) -> &Mlp {
        &self.actor
    }

    fn tensors(&self) -> Vec<(String, Tensor)> {
        let moments = self.stepper.state().map(|(name, tensor)| (name, tensor.shallow_clone()));
        self.actor.weights().into_iter().chain(self.critic.weights()).chain(moments).collect()
    }

    fn counters(&self) -> Counters {
        let Self { agent_steps, updates, .. } = *self;
        Counters { agent_steps, updates, optimiser_steps: self.stepper.steps, transitions: 0 }
    }

    fn go_on_at(&mut self, counters: Counters) {
        (self.agent_steps, self.updates) = (counters.agent_steps, counters.updates);
        self.stepper.steps = counters.optimiser_steps;
    }
}

/// What a number of steps gave: for each step, each agent of each intersection in turn.
#[derive(Debug, Default)]
struct Rollout {
    /// One step more than the others: what is seen after the last.
    observations: Vec<f32>,
    states: Vec<f32>,
    actions: Vec<u8>,
    log_probabilities: Vec<f32>,
    rewards: Vec<f32>,
    drove: Vec<bool>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
    /// One step more than the others.
    values: Vec<f32>,
    advantages: Vec<f32>,
}

impl Rollout {
    /// Generalised advantage estimation (Schulman et al. 2015), detail 5.
    fn estimate_advantages(&mut self, agents: usize, gamma: f32, lambda: f32) {
        for agent in 0..agents {
            let mut advantage = 0.0;
            for row in (agent..self.rewards.len()).step_by(agents).rev() {
                if self.drove[row] {
                    // A terminal state is worth nothing; a truncated one what it promises, but nothing follows it here.
                    let next = if self.terminated[row] { 0.0 } else { self.values[row + agents] };
                    let goes_on = !self.terminated[row] && !self.truncated[row];
                    let surprise = self.rewards[row] + gamma * next - self.values[row];
                    advantage = surprise + if goes_on { gamma * lambda * advantage } else { 0.0 };
                } else {
                    advantage = 0.0;
                }
                self.advantages[row] = advantage;
            }
        }
    }

    /// How much of the returns' variance the values explain (detail 12).
    fn explained(&self) -> f64 {
        let rows = || (0..self.drove.len()).filter(|row| self.drove[*row]);
        let variance = |of: &dyn Fn(usize) -> f32| {
            let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
            for number in rows().map(|row| f64::from(of(row))) {
                (n, sum, squares) = (n + 1.0, sum + number, squares + number * number);
            }
            squares / f64::max(n, 1.0) - (sum / f64::max(n, 1.0)).powi(2)
        };
        let returns = variance(&|row| self.advantages[row] + self.values[row]);
        1.0 - variance(&|row| self.advantages[row]) / returns.max(1e-12)
    }
}

impl Ppo {
    /// The begin of a training.
    ///
    /// # Errors
    /// [`MarlError::Setting`], and those of libtorch.
    pub fn new(settings: PpoSettings, world: World) -> Result<Self, MarlError> {
        settings.check()?;
        let mut random = ChaCha8Rng::seed_from_u64(settings.seed);
        // Detail 2, with 0.01 for the policy, so that all actions are as likely at first, and 1 for the value. Detail 13.
        let hidden = settings.hidden;
        let sight = world.intersection.sight;
        let numbers = sight.numbers();
        let actor = Mlp::new("actor", [numbers, hidden, hidden, ACTIONS], 0.01, &mut random)?;
        let sees = numbers + if settings.critic == Critic::Central { STATE } else { 0 };
        let critic = Mlp::new("critic", [sees, hidden, hidden, 1], 1.0, &mut random)?;
        let weights = actor.weights().into_iter().chain(critic.weights()).collect();
        let optimiser = Optimiser { clip: Some(settings.largest_gradient), ..Optimiser::default() }; // detail 11
        let stepper = Stepper::new(optimiser, weights)?.with_epsilon(1e-5); // detail 3
        let world = world.batch(settings.intersections, random.random());
        let agents = world.agents();
        let rows = settings.steps * agents;
        let mut rollout = Rollout {
            observations: vec![0.0; (rows + agents) * numbers],
            states: Vec::new(),
            actions: vec![0; rows],
            log_probabilities: vec![0.0; rows],
            rewards: vec![0.0; rows],
            drove: vec![false; rows],
            terminated: vec![false; rows],
            truncated: vec![false; rows],
            values: vec![0.0; rows + agents],
            advantages: vec![0.0; rows],
        };
        if settings.critic == Critic::Central {
            rollout.states = vec![0.0; (settings.steps + 1) * settings.intersections * STATE];
        }
        world.observe(&mut rollout.observations[rows * numbers..]);
        Ok(Self {
            settings,
            actor,
            critic,
            stepper,
            scale: scale(sight)?,
            world,
            random,
            rollout,
            agent_steps: 0,
            updates: 0,
        })
    }

    /// Drives a number of steps, and learns from them.
    fn rollout_and_learn(&mut self) -> Result<Update, MarlError> {
        let done = self.progress();
        let learning_rate = self.settings.learning_rate * (1.0 - done).max(1e-3); // detail 4
        let drove = self.collect()?;
        let agents = self.world.agents();
        self.rollout.estimate_advantages(agents, self.settings.gamma_at(done), self.settings.lambda);
        let explained = self.rollout.explained();
        self.updates += 1;
        self.agent_steps += self.rollout.drove.iter().filter(|drove| **drove).count() as u64;
        let losses = self.learn(learning_rate, self.settings.entropy_at(done))?;
        Ok(Update {
            number: self.updates,
            agent_steps: self.agent_steps,
            episodes: drove.episodes,
            collision_rate: drove.collision_rate,
            completion_rate: drove.completion_rate,
            all_completed: drove.all_completed,
            reward: drove.reward,
            seconds: drove.seconds,
            learning_rate,
            gradient_steps: self.stepper.steps as u64,
            losses: LOSSES.into_iter().zip(losses).chain([("explained", explained)]).collect(),
        })
    }

    /// Fills the rollout (detail 1). Returns what became of the episodes that ended.
    fn collect(&mut self) -> Result<Evaluation, MarlError> {
        let (agents, mut sums) = (self.world.agents(), Sums::default());
        // What was seen after the last step of the last rollout comes first.
        let each = agents * self.world.numbers();
        let last = self.settings.steps * each;
        self.rollout.observations.copy_within(last.., 0);
        for step in 0..self.settings.steps {
            self.look(step)?;
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
            self.world.finished().for_each(|episode| sums.add(episode));
        }
        self.look(self.settings.steps)?;
        for reward in &mut self.rollout.rewards {
            *reward *= self.settings.reward_scale;
        }
        Ok(sums.evaluation())
    }

    /// Writes the values of what is seen before a step and, but for the step after the last, draws actions.
    fn look(&mut self, step: usize) -> Result<(), MarlError> {
        let agents = self.world.agents();
        let (rows, seen) = (step * agents, self.observations(step * agents, agents)?);
        if self.settings.critic == Critic::Central {
            let each = self.settings.intersections * STATE;
            self.world.states(&mut self.rollout.states[step * each..(step + 1) * each]);
        }
        let (logits, values) = no_grad(|| -> Result<_, MarlError> {
            Ok((self.actor.forward(&seen)?.f_log_softmax(1, Kind::Float)?, self.value(&seen, rows, agents)?))
        })?;
        values.f_copy_data(&mut self.rollout.values[rows..rows + agents], agents)?;
        if step == self.settings.steps {
            return Ok(());
        }
        let mut logs = vec![0.0_f32; agents * ACTIONS];
        logits.f_copy_data(&mut logs, agents * ACTIONS)?;
        for (i, logs) in logs.chunks_exact(ACTIONS).enumerate() {
            let mut left = self.random.random_range(0.0..1.0_f32);
            let chosen = logs.iter().position(|log| {
                left -= log.exp();
                left < 0.0
            });
            let action = chosen.unwrap_or(ACTIONS - 1);
            self.rollout.actions[rows + i] = action as u8;
            self.rollout.log_probabilities[rows + i] = logs[action];
        }
        Ok(())
    }

    /// (count, numbers of an observation): scaled observations of rows of the rollout.
    fn observations(&self, from: usize, count: usize) -> Result<Tensor, MarlError> {
        let numbers = self.world.numbers();
        let seen = &self.rollout.observations[from * numbers..(from + count) * numbers];
        Ok(Tensor::f_from_slice(seen)?.f_view([count as i64, numbers as i64])?.f_mul(&self.scale)?)
    }

    /// (count): values of rows of the rollout that begin with an intersection's first agent.
    fn value(&self, seen: &Tensor, from: usize, count: usize) -> Result<Tensor, MarlError> {
        let value = match self.settings.critic {
            Critic::Own => self.critic.forward(seen)?,
            Critic::Central => self.critic.forward(&Tensor::f_cat(&[seen, &self.situations(from, count)?], 1)?)?,
        };
        Ok(value.f_flatten(0, -1)?)
    }

    /// (count, STATE): the situation that each of the agents is in.
    fn situations(&self, from: usize, count: usize) -> Result<Tensor, MarlError> {
        let numbers = &self.rollout.states[from / AGENTS * STATE..(from + count) / AGENTS * STATE];
        let each = Tensor::f_from_slice(numbers)?.f_view([(count / AGENTS) as i64, STATE as i64])?;
        Ok(each.f_repeat_interleave_self_int(AGENTS as i64, 0, None)?)
    }

    /// Several passes over the rollout. Returns the means of [`LOSSES`].
    fn learn(&mut self, learning_rate: f64, entropy_weight: f64) -> Result<[f64; 5], MarlError> {
        let all = self.rollout.drove.len();
        let mut rows: Vec<i64> = (0..all).filter(|row| self.rollout.drove[*row]).map(|row| row as i64).collect();
        let seen = self.observations(0, all)?;
        let situations = match self.settings.critic {
            Critic::Own => None,
            Critic::Central => Some(self.situations(0, all)?),
        };
        let actions: Vec<i64> = self.rollout.actions.iter().map(|action| i64::from(*action)).collect();
        let actions = Tensor::f_from_slice(&actions)?.f_view([all as i64, 1])?;
        let old = Tensor::f_from_slice(&self.rollout.log_probabilities)?;
        let advantages = Tensor::f_from_slice(&self.rollout.advantages)?;
        let values = Tensor::f_from_slice(&self.rollout.values[..all])?;
        let returns = advantages.f_add(&values)?;
        let (mut sums, mut count) = ([0.0; 5], 0.0);
        let clip = self.settings.clip;
        for _ in 0..self.settings.epochs {
            rows.shuffle(&mut self.random);
            // Detail 6; of the remainder, one row alone has no deviation.
            for rows in rows.chunks(self.settings.minibatch).filter(|rows| rows.len() > 1) {
                let rows = Tensor::f_from_slice(rows)?; // (B)
                let pick = |from: &Tensor| from.f_index_select(0, &rows);
                let seen = pick(&seen)?; // (B, numbers)
                let logs = self.actor.forward(&seen)?.f_log_softmax(1, Kind::Float)?; // (B, ACTIONS)
                let log = logs.f_gather(1, &pick(&actions)?, false)?.f_flatten(0, -1)?; // (B)
                let log_ratio = log.f_sub(&pick(&old)?)?;
                let ratio = log_ratio.f_exp()?;

                let policy_loss = surrogate(&normalised(&pick(&advantages)?)?, &ratio, clip)?;

                let value = match &situations {
                    None => self.critic.forward(&seen)?,
                    Some(situations) => self.critic.forward(&Tensor::f_cat(&[&seen, &pick(situations)?], 1)?)?,
                };
                let value_loss = value_loss(&value.f_flatten(0, -1)?, &pick(&values)?, &pick(&returns)?, clip)?;

                let entropy = logs.f_exp()?.f_mul(&logs)?.f_sum_dim_intlist(1, false, Kind::Float)?;
                let entropy = entropy.f_mean(Kind::Float)?.f_neg()?;
                let loss = policy_loss
                    .f_sub(&entropy.f_mul_scalar(entropy_weight)?)? // detail 10
                    .f_add(&value_loss.f_mul_scalar(self.settings.value)?)?;
                self.stepper.forget_gradients();
                loss.f_backward()?;
                self.stepper.step(learning_rate)?;

                let (divergence, out) = no_grad(|| -> Result<_, MarlError> {
                    let divergence = ratio.f_sub_scalar(1.0)?.f_sub(&log_ratio)?.f_mean(Kind::Float)?;
                    let out = ratio.f_sub_scalar(1.0)?.f_abs()?.f_gt(clip)?;
                    Ok((divergence, out.f_to_kind(Kind::Float)?.f_mean(Kind::Float)?))
                })?;
                let found = [&policy_loss, &value_loss, &entropy, &divergence, &out];
                for (sum, found) in sums.iter_mut().zip(found) {
                    *sum += found.f_double_value(&[])?;
                }
                count += 1.0;
            }
        }
        let means = sums.map(|sum| sum / f64::max(count, 1.0));
        match means.iter().find(|mean| !mean.is_finite()) {
            Some(loss) => Err(MarlError::NotFinite { loss: *loss, update: self.updates, rate: learning_rate }),
            None => Ok(means),
        }
    }
}

/// (B) to the same with a mean of 0 and a deviation of 1: detail 7.
fn normalised(advantage: &Tensor) -> Result<Tensor, MarlError> {
    let spread = advantage.f_std(true)?.f_add_scalar(1e-8)?;
    Ok(advantage.f_sub(&advantage.f_mean(Kind::Float)?)?.f_div(&spread)?)
}

/// The clipped surrogate of advantages (B) and of the ratios (B) of new to old probabilities, to be made small: detail 8.
fn surrogate(advantage: &Tensor, ratio: &Tensor, clip: f64) -> Result<Tensor, MarlError> {
    let free = advantage.f_mul(ratio)?;
    let clipped = advantage.f_mul(&ratio.f_clamp(1.0 - clip, 1.0 + clip)?)?;
    Ok(free.f_minimum(&clipped)?.f_mean(Kind::Float)?.f_neg()?)
}

/// Half the mean squared error of values (B) that were something else before the update, clipped as they move: detail 9.
fn value_loss(value: &Tensor, was: &Tensor, target: &Tensor, clip: f64) -> Result<Tensor, MarlError> {
    let moved = value.f_sub(was)?.f_clamp(-clip, clip)?;
    let free = value.f_sub(target)?.f_square()?;
    let clipped = was.f_add(&moved)?.f_sub(target)?.f_square()?;
    Ok(free.f_maximum(&clipped)?.f_mean(Kind::Float)?.f_mul_scalar(0.5)?)
}

#[cfg(test)]
mod tests;
