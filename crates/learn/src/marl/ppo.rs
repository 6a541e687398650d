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

mod collectors;
mod settings;

pub use settings::{Critic, PpoSettings};

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor, no_grad};

use self::collectors::{ActorCritic, Part, collect, draw_luck};
use super::{
    MarlError,
    learner::{Counters, Learner, Update, World},
    policy::{Mlp, scale},
};
use crate::train::{Optimiser, Stepper};
use lapwing_sim::intersection::{ACTIONS, STATE, evaluation::Sums};

/// What is logged of an update (detail 12): policy loss, value loss, the policy's entropy in nats (at most ln 4), how far
/// the policy moved (Schulman's estimator `(r - 1) - ln r` of the KL divergence), and the share of the ratios that were
/// clipped, all means over the minibatches.
const LOSSES: [&str; 5] = ["policy_loss", "value_loss", "entropy", "divergence", "clipped"];

/// A training between two updates.
#[derive(Debug)]
pub struct Ppo {
    settings: PpoSettings,
    networks: ActorCritic,
    stepper: Stepper,
    parts: Vec<Part>,
    random: ChaCha8Rng,
    agent_steps: u64,
    updates: u64,
}

impl Learner for Ppo {
    fn update(&mut self, _: &dyn Fn() -> bool) -> Result<Update, MarlError> {
        self.rollout_and_learn()
    }

    fn progress(&self) -> f64 {
        (self.agent_steps as f64 / self.settings.agent_steps.max(1) as f64).min(1.0)
    }

    fn actor(&self) -> &Mlp {
        &self.networks.actor
    }

    fn tensors(&self) -> Vec<(String, Tensor)> {
        let moments = self.stepper.state().map(|(name, tensor)| (name, tensor.shallow_clone()));
        let ActorCritic { actor, critic, .. } = &self.networks;
        actor.weights().into_iter().chain(critic.weights()).chain(moments).collect()
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

/// What a number of steps gave: for each step, each agent of each intersection of a part in turn.
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
}

/// How much of the returns' variance the values explain (detail 12).
fn explained<'a>(rollouts: impl Iterator<Item = &'a Rollout> + Clone) -> f64 {
    let variance = |of: fn(&Rollout, usize) -> f32| {
        let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for rollout in rollouts.clone() {
            for row in (0..rollout.drove.len()).filter(|row| rollout.drove[*row]) {
                let number = f64::from(of(rollout, row));
                (n, sum, squares) = (n + 1.0, sum + number, squares + number * number);
            }
        }
        squares / f64::max(n, 1.0) - (sum / f64::max(n, 1.0)).powi(2)
    };
    let returns = variance(|rollout, row| rollout.advantages[row] + rollout.values[row]);
    1.0 - variance(|rollout, row| rollout.advantages[row]) / returns.max(1e-12)
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
        let parts = Part::all(world.batch(settings.intersections, random.random()), &settings);
        let networks = ActorCritic { actor, critic, scale: scale(sight)? };
        Ok(Self { settings, networks, stepper, parts, random, agent_steps: 0, updates: 0 })
    }

    /// Drives a number of steps, and learns from them.
    fn rollout_and_learn(&mut self) -> Result<Update, MarlError> {
        let done = self.progress();
        let learning_rate = self.settings.learning_rate * (1.0 - done).max(1e-3); // detail 4
        draw_luck(&mut self.parts, self.settings.steps, &mut self.random);
        let mut sums = Sums::default();
        collect(&mut self.parts, &self.networks, &self.settings)?.into_iter().for_each(|episode| sums.add(episode));
        let drove = sums.evaluation();
        for part in &mut self.parts {
            let agents = part.world.agents();
            part.rollout.estimate_advantages(agents, self.settings.gamma_at(done), self.settings.lambda);
        }
        let explained = explained(self.rollouts());
        self.updates += 1;
        self.agent_steps += self.rollouts().flat_map(|rollout| &rollout.drove).filter(|drove| **drove).count() as u64;
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

    fn rollouts(&self) -> impl Iterator<Item = &Rollout> + Clone {
        self.parts.iter().map(|part| &part.rollout)
    }

    /// Where in all rollouts, one part after the other, somebody drove; in the order of the steps.
    fn rows(&self) -> Vec<i64> {
        let mut rows = Vec::new();
        for step in 0..self.settings.steps {
            let mut begin = 0;
            for part in &self.parts {
                let (agents, drove) = (part.world.agents(), &part.rollout.drove);
                let here = (step * agents..(step + 1) * agents).filter(|row| drove[*row]);
                rows.extend(here.map(|row| (begin + row) as i64));
                begin += drove.len();
            }
        }
        rows
    }

    /// (rows of all rollouts): one part after the other.
    fn all<T: tch::kind::Element + Copy>(&self, of: impl Fn(&Rollout) -> &[T]) -> Result<Tensor, MarlError> {
        Ok(Tensor::f_from_slice(&self.rollouts().map(of).collect::<Vec<_>>().concat())?)
    }

    /// Several passes over the rollout. Returns the means of [`LOSSES`].
    fn learn(&mut self, learning_rate: f64, entropy_weight: f64) -> Result<[f64; 5], MarlError> {
        let mut rows = self.rows();
        let seen = self.parts.iter().map(|part| part.seen(0, part.rollout.drove.len(), &self.networks.scale));
        let seen = Tensor::f_cat(&seen.collect::<Result<Vec<_>, _>>()?, 0)?;
        let situations = self.parts.iter().map(|part| part.situations(0, part.rollout.drove.len()));
        let situations = situations.collect::<Result<Option<Vec<_>>, _>>()?;
        let situations = situations.map(|situations| Tensor::f_cat(&situations, 0)).transpose()?;
        let actions = self.all(|rollout| &rollout.actions)?.f_to_kind(Kind::Int64)?.f_view([-1, 1])?;
        let old = self.all(|rollout| &rollout.log_probabilities)?;
        let advantages = self.all(|rollout| &rollout.advantages)?;
        let values = self.all(|rollout| &rollout.values[..rollout.drove.len()])?;
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
                let logs = self.networks.actor.forward(&seen)?.f_log_softmax(1, Kind::Float)?; // (B, ACTIONS)
                let log = logs.f_gather(1, &pick(&actions)?, false)?.f_flatten(0, -1)?; // (B)
                let log_ratio = log.f_sub(&pick(&old)?)?;
                let ratio = log_ratio.f_exp()?;

                let policy_loss = surrogate(&normalised(&pick(&advantages)?)?, &ratio, clip)?;

                let value = self.networks.value(&seen, situations.as_ref().map(pick).transpose()?.as_ref())?;
                let value_loss = value_loss(&value, &pick(&values)?, &pick(&returns)?, clip)?;

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
