//! Multi-Agent Deep Deterministic Policy Gradient (Lowe et al. 2017): decentralised actors, a centralised critic.
//!
//! Where the paper leaves something open, its authors' code is followed (`openai/maddpg`, `trainer/maddpg.py`):
//!
//! | detail | as in |
//! |---|---|
//! | two hidden layers of 64 units with ReLU | paper, appendix |
//! | discrete actions as relaxed one-hots (Gumbel-softmax, temperature 1); their noise is the exploration | paper; `SoftCategoricalPd.sample` |
//! | the relaxed action is what is remembered; its largest part is what is done | `DiscreteEnv` takes the same vector |
//! | the target's next actions are sampled, too | `target_act` |
//! | the agent's own action is sampled anew from its actor, the others' are those remembered | `p_train` |
//! | 0.001 times the mean square of the actor's outputs is added to its loss | `p_reg` |
//! | gradients clipped to 0.5; here all of a network together, there each tensor | `minimize_and_clip` |
//! | a gradient step for each 100 joint transitions, batches of 1024, targets follow by 0.01 | paper, appendix; `update` |
//! | learning rates of 1e-3 that fall towards 0 | the paper has 1e-2, Biswas and Biswas 1e-4 for the actor and 1e-3 for the critic; ours are from the experiments in `docs/how-to/marl.md`, "What lets MADDPG learn" |
//! | they stop falling at a thousandth of their first value | our choice, as for PPO here |
//! | Adam with an epsilon of 1e-8 | the default of Kingma and Ba 2015, and of their `AdamOptimizer` |
//! | orthogonal initial weights with a gain of the square root of 2, in the last layer 0.01 for the actor and 1 for the critic; biases of 0 | as for PPO here, detail 2 of Huang et al. 2022; theirs are `fully_connected`'s default (Glorot and Bengio 2010) |
//! | no gradient step before 10,000 joint transitions, or a batch if that is more | our choice; theirs is a batch of the longest episodes, 25,600 (`max_replay_buffer_len`) |
//! | a memory of a million | paper |
//!
//! What differs: the agents share both networks, as with PPO here, so the critic of an agent is given its own part of the
//! situation first and then those of the others in turn; agents that have ended are zeros to the critic and masked out of
//! the losses; a truncated episode is bootstrapped; observations and rewards are divided by the same constants as for PPO;
//! both gradients are taken at the same weights, before either is followed.
//!
//! With [`learners`](MaddpgSettings::learners) above 0 it is asynchronous: `asynchronous.rs` says how.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Tensor, no_grad};

use super::{
    MarlError, asynchronous,
    error::{expect, expect_above_zero},
    gradients::{Core, LOSSES, Losses, learn, relax},
    learner::{Counters, Learner, Update, World},
    policy::{HIDDEN, Mlp, scale},
    priorities::Replay,
    replay::{Drawing, Memory, Moment},
};
use lapwing_sim::intersection::{ACTIONS, AGENTS, Batch, Buffers, evaluation::Sums};

/// Joint transitions between two updates that are logged: as many as PPO's defaults make in one. One that is
/// stopped has fewer.
const LOGGED: u64 = 8192;

/// The settings of the algorithm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MaddpgSettings {
    /// Agent-steps in all: those of agents that drive.
    pub agent_steps: u64,
    /// Intersections side by side; 16.
    pub intersections: usize,
    /// Joint transitions in a batch; 1024.
    pub batch: usize,
    /// Joint transitions for each gradient step; 100.
    pub every: f64,
    /// Joint transitions before the first one; 10,000.
    pub warm_up: u64,
    /// Joint transitions that are remembered; a million.
    pub memory: usize,
    /// How they are drawn.
    pub replay: Replay,
    /// How much priorities matter; 0.6.
    pub alpha: f32,
    /// How much of their bias is undone at first; 0.4. It rises to 1.
    pub beta: f64,
    /// Learning rate of the actor; 1e-3.
    pub actor_rate: f64,
    /// And of the critic; 1e-3.
    pub critic_rate: f64,
    /// Whether both fall to 0, as PPO's does; yes, since what is shipped and judged is the last policy.
    pub rates_fall: bool,
    /// How far the targets follow at each gradient step; 0.01.
    pub tau: f64,
    /// Discount; 0.95.
    pub gamma: f32,
    /// Of the relaxed actions; 1.
    pub temperature: f64,
    /// Largest norm of a network's gradient; 0.5.
    pub largest_gradient: f64,
    /// Units in each hidden layer; 64.
    pub hidden: usize,
    /// What rewards are multiplied with: 0.05, so that a goal is worth 1.
    pub reward_scale: f32,
    /// Learner threads beside a collector thread; 0 is synchronous, one after the other.
    pub learners: usize,
    /// Of everything random.
    pub seed: u64,
}

impl Default for MaddpgSettings {
    fn default() -> Self {
        Self {
            agent_steps: 3_000_000,
            intersections: 16,
            batch: 1024,
            every: 100.0,
            warm_up: 10_000,
            memory: 1_000_000,
            replay: Replay::Uniform,
            alpha: 0.6,
            beta: 0.4,
            actor_rate: 1e-3,
            critic_rate: 1e-3,
            rates_fall: true,
            tau: 0.01,
            gamma: 0.95,
            temperature: 1.0,
            largest_gradient: 0.5,
            hidden: 64,
            reward_scale: 0.05,
            learners: 0,
            seed: 0,
        }
    }
}

impl MaddpgSettings {
    fn check(&self) -> Result<(), MarlError> {
        let counts = [("intersections", self.intersections), ("batch", self.batch)];
        expect(counts, "1 to 65536", |count| (1..=65_536).contains(&count))?;
        expect([("hidden", self.hidden)], "1 to 4096", |units| HIDDEN.contains(&units))?;
        expect([("agent_steps", self.agent_steps)], "at least 1", |steps| steps > 0)?;
        expect([("memory", self.memory)], "1000 to 10000000", |moments| (1000..=10_000_000).contains(&moments))?;
        expect([("learners", self.learners)], "0 to 64", |threads| threads <= 64)?;
        expect_above_zero([
            ("every", self.every),
            ("actor_rate", self.actor_rate),
            ("critic_rate", self.critic_rate),
            ("temperature", self.temperature),
            ("largest_gradient", self.largest_gradient),
            ("reward_scale", f64::from(self.reward_scale)),
        ])?;
        let shares =
            [("gamma", self.gamma), ("alpha", self.alpha), ("beta", self.beta as f32), ("tau", self.tau as f32)];
        expect(shares, "0 to 1", |share| (0.0..=1.0).contains(&share))
    }
}

/// Gradient steps and joint transitions before this process: what they were drawn from is not stored.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Origin {
    steps: u64,
    transitions: u64,
}

impl Origin {
    /// Gradient steps that are due after so many joint transitions.
    pub fn due(self, settings: &MaddpgSettings, transitions: u64) -> u64 {
        let warm_up = settings.warm_up.max(settings.batch as u64);
        let learnt_from = transitions.saturating_sub(self.transitions + warm_up);
        self.steps + (learnt_from as f64 / settings.every) as u64
    }
}

/// The intersections, and what drives in them.
#[derive(Debug)]
pub(super) struct Collector {
    world: Batch,
    scale: Tensor,
    random: ChaCha8Rng,
    observations: Vec<f32>,
    relaxed: Vec<f32>,
    actions: Vec<u8>,
    rewards: Vec<f32>,
    drove: Vec<bool>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
    /// Of the episodes that ended since they were last asked for.
    pub sums: Sums,
    /// So far.
    pub agent_steps: u64,
    /// Joint transitions so far.
    pub transitions: u64,
}

impl Collector {
    fn new(settings: &MaddpgSettings, world: World, random: &mut ChaCha8Rng) -> Result<Self, MarlError> {
        let scale = scale(world.intersection.sight)?;
        let world = world.batch(settings.intersections, random.random());
        let agents = world.agents();
        let mut observations = vec![0.0; agents * world.numbers()];
        world.observe(&mut observations);
        Ok(Self {
            world,
            scale,
            random: ChaCha8Rng::seed_from_u64(random.random()),
            observations,
            relaxed: vec![0.0; agents * ACTIONS],
            actions: vec![0; agents],
            rewards: vec![0.0; agents],
            drove: vec![false; agents],
            terminated: vec![false; agents],
            truncated: vec![false; agents],
            sums: Sums::default(),
            agent_steps: 0,
            transitions: 0,
        })
    }

    /// One step of all intersections.
    pub fn step(&mut self, actor: &Mlp, settings: &MaddpgSettings) -> Result<(), MarlError> {
        let (agents, numbers) = (self.world.agents(), self.world.numbers());
        let relaxed = no_grad(|| {
            let seen = Tensor::f_from_slice(&self.observations)?.f_view([agents as i64, numbers as i64])?;
            relax(&actor.forward(&seen.f_mul(&self.scale)?)?, settings.temperature, &mut self.random)
        })?; // (agents, ACTIONS)
        relaxed.f_contiguous()?.f_copy_data(&mut self.relaxed, agents * ACTIONS)?;
        for (action, parts) in self.actions.iter_mut().zip(self.relaxed.chunks_exact(ACTIONS)) {
            let largest = (0..ACTIONS).max_by(|a, b| parts[*a].total_cmp(&parts[*b]));
            *action = largest.unwrap_or_default() as u8;
        }
        let Self { observations, rewards, drove, terminated, truncated, .. } = self;
        self.world.step(&self.actions, Buffers { observations, rewards, drove, terminated, truncated });
        self.world.finished().for_each(|episode| self.sums.add(episode));
        self.rewards.iter_mut().for_each(|reward| *reward *= settings.reward_scale);
        self.agent_steps += self.drove.iter().filter(|drove| **drove).count() as u64;
        self.transitions += self.drove.chunks_exact(AGENTS).filter(|drove| drove.contains(&true)).count() as u64;
        Ok(())
    }

    /// What the last step gave.
    pub fn moment(&self) -> Moment<'_> {
        Moment {
            observations: &self.observations,
            actions: &self.relaxed,
            rewards: &self.rewards,
            drove: &self.drove,
            terminated: &self.terminated,
        }
    }
}

/// A training between two updates.
#[derive(Debug)]
pub struct Maddpg {
    pub(super) settings: MaddpgSettings,
    pub(super) core: Core,
    pub(super) collector: Collector,
    pub(super) memory: Memory,
    pub(super) scale: Tensor,
    pub(super) random: ChaCha8Rng,
    drawing: Drawing,
    updates: u64,
    origin: Origin,
}

impl Maddpg {
    /// The begin of a training.
    ///
    /// # Errors
    /// [`MarlError::Setting`], and those of libtorch.
    pub fn new(settings: MaddpgSettings, world: World) -> Result<Self, MarlError> {
        settings.check()?;
        let mut random = ChaCha8Rng::seed_from_u64(settings.seed);
        let sight = world.intersection.sight;
        let core = Core::new(&settings, sight.numbers(), &mut random)?;
        let collector = Collector::new(&settings, world, &mut random)?;
        let mut memory = Memory::new(sight, settings.intersections, settings.memory, settings.replay, settings.alpha);
        memory.push(collector.moment());
        let scale = scale(sight)?;
        let drawing = Drawing::default();
        Ok(Self { settings, core, collector, memory, scale, random, drawing, updates: 0, origin: Origin::default() })
    }

    /// Where this process began.
    pub(super) fn origin(&self) -> Origin {
        self.origin
    }

    /// Drives and learns in turn, at least one step. It stops only where no gradient step is due.
    fn synchronous(&mut self, until: u64, is_stopped: &dyn Fn() -> bool) -> Result<Losses, MarlError> {
        let mut losses = Losses::default();
        while self.collector.transitions < until {
            self.collector.step(&self.core.networks.actor, &self.settings)?;
            self.memory.push(self.collector.moment());
            while self.core.steps < self.origin.due(&self.settings, self.collector.transitions) {
                let beta = self.beta();
                self.memory.draw(self.settings.batch, beta, &mut self.random, &mut self.drawing);
                let networks = &self.core.networks;
                let gradients = learn(networks, &self.drawing, &self.scale, &self.settings, &mut self.random)?;
                self.memory.update(&self.drawing.rows, &gradients.errors);
                self.core.apply(&gradients, &self.settings, self.share_of_rates())?;
                losses.add(&gradients);
            }
            if is_stopped() {
                break;
            }
        }
        Ok(losses)
    }

    /// How much of the priorities' bias is undone now.
    pub(super) fn beta(&self) -> f64 {
        self.settings.beta + (1.0 - self.settings.beta) * self.progress()
    }

    /// The share of the learning rates with which it learns now.
    pub(super) fn share_of_rates(&self) -> f64 {
        if self.settings.rates_fall { (1.0 - self.progress()).max(1e-3) } else { 1.0 }
    }
}

impl Learner for Maddpg {
    fn update(&mut self, is_stopped: &dyn Fn() -> bool) -> Result<Update, MarlError> {
        let until = self.collector.transitions + LOGGED;
        let losses = match self.settings.learners {
            0 => self.synchronous(until, is_stopped)?,
            _ => asynchronous::run(self, until, is_stopped)?,
        };
        self.updates += 1;
        let means = losses.means();
        if let Some(loss) = means.iter().find(|mean| !mean.is_finite()) {
            let rate = self.settings.critic_rate;
            return Err(MarlError::NotFinite { loss: *loss, update: self.updates, rate });
        }
        let drove = std::mem::take(&mut self.collector.sums).evaluation();
        Ok(Update {
            number: self.updates,
            agent_steps: self.collector.agent_steps,
            gradient_steps: self.core.steps,
            episodes: drove.episodes,
            collision_rate: drove.collision_rate,
            completion_rate: drove.completion_rate,
            all_completed: drove.all_completed,
            reward: drove.reward,
            seconds: drove.seconds,
            learning_rate: self.settings.actor_rate * self.share_of_rates(),
            losses: LOSSES.into_iter().zip(means).chain([("staleness", losses.mean_staleness())]).collect(),
        })
    }

    fn progress(&self) -> f64 {
        (self.collector.agent_steps as f64 / self.settings.agent_steps.max(1) as f64).min(1.0)
    }

    fn actor(&self) -> &Mlp {
        &self.core.networks.actor
    }

    fn tensors(&self) -> Vec<(String, Tensor)> {
        self.core.tensors()
    }

    fn counters(&self) -> Counters {
        Counters {
            agent_steps: self.collector.agent_steps,
            updates: self.updates,
            optimiser_steps: self.core.steps as i64,
            transitions: self.collector.transitions,
        }
    }

    fn go_on_at(&mut self, counters: Counters) {
        (self.collector.agent_steps, self.updates) = (counters.agent_steps, counters.updates);
        self.collector.transitions = counters.transitions;
        self.core.go_on_at(counters.optimiser_steps);
        self.origin = Origin { steps: self.core.steps, transitions: counters.transitions };
    }
}

#[cfg(test)]
mod tests;
