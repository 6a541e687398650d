//! What MADDPG learns from a batch: the gradients of its actor and its critic. `maddpg.rs` says where each detail is from.
//!
//! Only agents that drove are rows here, about half of those that there could be. What is multiplied with the situation, the
//! largest part of the work, is so three times: by the target's critic, by the critic, and back. The actor's own action enters
//! the critic's first layer by its columns alone.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor, no_grad};

use super::{
    MarlError,
    maddpg::MaddpgSettings,
    policy::{Activation, Mlp},
    replay::Drawing,
};
use crate::train::{Optimiser, Stepper};
use lapwing_sim::intersection::{ACTIONS, AGENTS};

/// Weight of the mean square of the actor's outputs.
const OUTPUTS: f64 = 1e-3;

/// The four networks.
#[derive(Debug)]
pub(super) struct Networks {
    pub actor: Mlp,
    critic: Mlp,
    target_actor: Mlp,
    target_critic: Mlp,
}

impl Networks {
    fn new(settings: &MaddpgSettings, numbers: usize, random: &mut ChaCha8Rng) -> Result<Self, MarlError> {
        let hidden = settings.hidden;
        let sees = AGENTS * (numbers + ACTIONS);
        let actor = Mlp::new("actor", [numbers, hidden, hidden, ACTIONS], 0.01, random)?.with(Activation::Relu);
        let critic = Mlp::new("critic", [sees, hidden, hidden, 1], 1.0, random)?.with(Activation::Relu);
        let (target_actor, target_critic) = (actor.copy()?, critic.copy()?);
        Ok(Self { actor, critic, target_actor, target_critic })
    }

    /// The same with memory of their own.
    pub fn copy(&self) -> Result<Self, MarlError> {
        Ok(Self {
            actor: self.actor.copy()?,
            critic: self.critic.copy()?,
            target_actor: self.target_actor.copy()?,
            target_critic: self.target_critic.copy()?,
        })
    }

    /// Takes over others' weights.
    pub fn take(&self, others: &Self) -> Result<(), MarlError> {
        self.actor.follow(&others.actor, 1.0)?;
        self.critic.follow(&others.critic, 1.0)?;
        self.target_actor.follow(&others.target_actor, 1.0)?;
        self.target_critic.follow(&others.target_critic, 1.0)
    }
}

/// What is learnt: networks and their optimisers.
#[derive(Debug)]
pub(super) struct Core {
    pub networks: Networks,
    actor: Stepper,
    critic: Stepper,
    /// Gradient steps so far.
    pub steps: u64,
}

/// What a batch says of how the weights should change.
#[derive(Debug)]
pub(super) struct Gradients {
    actor: Vec<Tensor>,
    critic: Vec<Tensor>,
    /// (B): mean size of the agents' errors, one for each joint transition.
    pub errors: Vec<f32>,
    losses: [f64; 4],
}

/// What is logged of a gradient step: mean squared error of the critic, the actor's loss, mean value, mean size of the
/// errors.
pub(super) const LOSSES: [&str; 4] = ["critic_loss", "policy_loss", "value", "error"];

impl Core {
    /// Before the first step.
    pub fn new(settings: &MaddpgSettings, numbers: usize, random: &mut ChaCha8Rng) -> Result<Self, MarlError> {
        let networks = Networks::new(settings, numbers, random)?;
        let optimiser = Optimiser { clip: Some(settings.largest_gradient), ..Optimiser::default() };
        let actor = Stepper::new(optimiser.clone(), networks.actor.weights())?;
        let critic = Stepper::new(optimiser, networks.critic.weights())?;
        Ok(Self { networks, actor, critic, steps: 0 })
    }

    /// Weights, targets and moments, by name.
    pub fn tensors(&self) -> Vec<(String, Tensor)> {
        let Networks { actor, critic, target_actor, target_critic } = &self.networks;
        let targets = target_actor.weights().into_iter().chain(target_critic.weights());
        let moments = self.actor.state().chain(self.critic.state());
        actor
            .weights()
            .into_iter()
            .chain(critic.weights())
            .chain(targets.map(|(name, tensor)| (format!("target.{name}"), tensor)))
            .chain(moments.map(|(name, tensor)| (name, tensor.shallow_clone())))
            .collect()
    }

    /// Goes on after so many gradient steps.
    pub fn go_on_at(&mut self, steps: i64) {
        self.steps = steps.max(0) as u64;
        (self.actor.steps, self.critic.steps) = (steps, steps);
    }

    /// Follows gradients with a share of the learning rates; the targets follow the networks.
    pub fn apply(&mut self, gradients: &Gradients, settings: &MaddpgSettings, share: f64) -> Result<(), MarlError> {
        self.critic.step_along(&gradients.critic, settings.critic_rate * share)?;
        self.actor.step_along(&gradients.actor, settings.actor_rate * share)?;
        self.networks.target_critic.follow(&self.networks.critic, settings.tau)?;
        self.networks.target_actor.follow(&self.networks.actor, settings.tau)?;
        self.steps += 1;
        Ok(())
    }
}

/// Sums of losses.
#[derive(Debug, Default)]
pub(super) struct Losses {
    sums: [f64; 4],
    count: f64,
    /// Sum over the gradient steps of how many others had been taken since its weights were read.
    pub staleness: f64,
}

impl Losses {
    pub fn add(&mut self, gradients: &Gradients) {
        self.sums.iter_mut().zip(gradients.losses).for_each(|(sum, loss)| *sum += loss);
        self.count += 1.0;
    }

    /// Their means.
    pub fn means(&self) -> [f64; 4] {
        self.sums.map(|sum| sum / self.count.max(1.0))
    }

    /// Mean staleness.
    pub fn mean_staleness(&self) -> f64 {
        self.staleness / self.count.max(1.0)
    }

    pub fn join(&mut self, other: &Self) {
        self.sums.iter_mut().zip(other.sums).for_each(|(sum, loss)| *sum += loss);
        self.count += other.count;
        self.staleness += other.staleness;
    }
}

/// (N, ACTIONS) to the same: a sample of the relaxed one-hot that the logits mean (Jang et al. 2017; Maddison et al. 2017).
pub(super) fn relax(logits: &Tensor, temperature: f64, random: &mut ChaCha8Rng) -> Result<Tensor, MarlError> {
    let noise: Vec<f32> = (0..logits.numel()).map(|_| -(-random.random_range(f32::EPSILON..1.0).ln()).ln()).collect();
    let noise = Tensor::f_from_slice(&noise)?.f_view_as(logits)?;
    Ok(logits.f_add(&noise)?.f_div_scalar(temperature)?.f_softmax(-1, Kind::Float)?)
}

/// (N, AGENTS * n) of (N + 1, n): for each agent its own part, and then those of the others in turn.
fn joint(parts: &Tensor, others: &[Vec<i64>; AGENTS - 1]) -> Result<Tensor, MarlError> {
    let mut all = vec![parts.f_narrow(0, 0, others[0].len() as i64)?];
    for rows in others {
        all.push(parts.f_index_select(0, &Tensor::f_from_slice(rows)?)?);
    }
    Ok(Tensor::f_cat(&all, 1)?)
}

/// (N, hidden): what the critic's first layer gives if the agent's own action is changed by so much (N, ACTIONS).
fn acting_otherwise(critic: &Mlp, first: &Tensor, change: &Tensor, numbers: i64) -> Result<Tensor, MarlError> {
    let columns = critic.first_weight().f_detach()?.f_narrow(1, numbers, ACTIONS as i64)?; // (hidden, ACTIONS)
    Ok(first.f_detach()?.f_add(&change.f_linear::<&Tensor>(&columns, None)?)?)
}

/// With a last row of zeros.
fn with_nobody(rows: &Tensor) -> Result<Tensor, MarlError> {
    let nobody = rows.f_new_zeros([1, rows.size()[1]], (rows.kind(), rows.device()))?;
    Ok(Tensor::f_cat(&[rows, &nobody], 0)?)
}

/// The gradients of a batch.
pub(super) fn learn(
    networks: &Networks,
    batch: &Drawing,
    scale: &Tensor,
    settings: &MaddpgSettings,
    random: &mut ChaCha8Rng,
) -> Result<Gradients, MarlError> {
    let numbers = scale.size1()?;
    let of = |numbers: &[f32], columns: i64| Tensor::f_from_slice(numbers)?.f_view([-1, columns]);
    let seen = of(&batch.seen, numbers)?.f_mul_(scale)?; // (N + 1, numbers)
    let done = of(&batch.actions, ACTIONS as i64)?; // (N + 1, ACTIONS)
    let next = of(&batch.next, numbers)?.f_mul_(scale)?; // (M + 1, numbers)
    let rewards = of(&batch.rewards, 1)?; // (N, 1)
    let weights = of(&batch.weights, 1)?; // (N, 1)
    let agents = batch.of.len() as i64; // N
    let those = |all: &Tensor| all.f_narrow(0, 0, all.size()[0] - 1);

    let target = no_grad(|| -> Result<_, MarlError> {
        let logits = networks.target_actor.forward(&those(&next)?)?; // (M, ACTIONS)
        let then = with_nobody(&relax(&logits, settings.temperature, random)?)?; // (M + 1, ACTIONS)
        let situation = joint(&Tensor::f_cat(&[&next, &then], 1)?, &batch.next_others)?;
        let future = with_nobody(&networks.target_critic.forward(&situation)?)?; // (M + 1, 1)
        let future = future.f_index_select(0, &Tensor::f_from_slice(&batch.then)?)?; // (N, 1)
        Ok(rewards.f_add(&future.f_mul_scalar(f64::from(settings.gamma))?)?)
    })?;
    let situation = joint(&Tensor::f_cat(&[&seen, &done], 1)?, &batch.others)?; // (N, AGENTS * (numbers + ACTIONS))
    let first = networks.critic.first(&situation)?; // (N, hidden)
    let values = networks.critic.rest(&first)?; // (N, 1)
    let errors = values.f_sub(&target)?;
    let critic_loss = errors.f_square()?.f_mul(&weights)?.f_mean(Kind::Float)?;

    let logits = networks.actor.forward(&those(&seen)?)?; // (N, ACTIONS)
    let anew = relax(&logits, settings.temperature, random)?;
    let otherwise = acting_otherwise(&networks.critic, &first, &anew.f_sub(&those(&done)?)?, numbers)?;
    let worth = networks.critic.rest(&otherwise)?.f_mul(&weights)?; // (N, 1)
    let outputs = logits.f_square()?.f_mean(Kind::Float)?.f_mul_scalar(OUTPUTS)?;
    let actor_loss = outputs.f_sub(&worth.f_mean(Kind::Float)?)?;

    let along = |loss: &Tensor, network: &Mlp| {
        let weights: Vec<Tensor> = network.weights().into_iter().map(|(_, weight)| weight).collect();
        Tensor::f_run_backward(&[loss], &weights, false, false)
    };
    let (critic, actor) = (along(&critic_loss, &networks.critic)?, along(&actor_loss, &networks.actor)?);

    // One priority for each joint transition: the mean over the agents that drove.
    let mut each = vec![0.0_f32; agents as usize];
    errors.f_detach()?.f_copy_data(&mut each, agents as usize)?;
    let mut sums = vec![(0.0_f32, 0.0_f32); batch.rows.len()];
    for (error, row) in each.iter().zip(&batch.of) {
        sums[*row].0 += error.abs();
        sums[*row].1 += 1.0;
    }
    let found: Vec<f32> = sums.into_iter().map(|(sum, count)| sum / count.max(1.0)).collect();
    let losses = [
        critic_loss.f_double_value(&[])?,
        actor_loss.f_double_value(&[])?,
        values.f_mean(Kind::Float)?.f_double_value(&[])?,
        found.iter().map(|error| f64::from(*error)).sum::<f64>() / found.len().max(1) as f64,
    ];
    Ok(Gradients { actor, critic, errors: found, losses })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn each_agent_comes_first_and_who_is_not_there_is_nobody() {
        // Three agents of one transition, the second of which is missing, and one of another.
        let parts = Tensor::from_slice(&[1.0_f32, 3.0, 4.0, 10.0, 0.0]).view([5, 1]);
        let others = [vec![4, 2, 0, 4], vec![1, 0, 4, 4], vec![2, 4, 1, 4]];
        let all = joint(&parts, &others).unwrap();
        let expected = [[1.0, 0.0, 3.0, 4.0], [3.0, 4.0, 1.0, 0.0], [4.0, 1.0, 0.0, 3.0], [10.0, 0.0, 0.0, 0.0]];
        assert_eq!(all.size(), [4, 4]);
        assert_eq!(Vec::<f32>::try_from(all.flatten(0, -1)).unwrap(), expected.concat());
    }

    #[test]
    fn another_action_of_its_own_enters_as_if_the_whole_situation_were_multiplied_anew() {
        let (numbers, rows) = (7_i64, 5_i64);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let sees = AGENTS * (numbers as usize + ACTIONS);
        let critic = Mlp::new("critic", [sees, 16, 16, 1], 1.0, &mut random).unwrap().with(Activation::Relu);
        let draw = |count: i64, random: &mut ChaCha8Rng| {
            let numbers: Vec<f32> = (0..count).map(|_| random.random_range(-1.0..1.0)).collect();
            Tensor::from_slice(&numbers).view([rows, -1])
        };
        let situation = draw(rows * sees as i64, &mut random);
        let anew = draw(rows * ACTIONS as i64, &mut random);
        let was = situation.narrow(1, numbers, ACTIONS as i64);
        let after = situation.narrow(1, numbers + ACTIONS as i64, sees as i64 - numbers - ACTIONS as i64);
        let changed = Tensor::cat(&[&situation.narrow(1, 0, numbers), &anew, &after], 1);
        let first = critic.first(&situation).unwrap();
        let short = acting_otherwise(&critic, &first, &(&anew - was), numbers).unwrap();
        let gap = critic.rest(&short).unwrap() - critic.forward(&changed).unwrap();
        assert!(gap.abs().max().double_value(&[]) < 1e-5);
    }

    /// Two agents in each of 32 transitions, which end there. Each sees two numbers, is paid for the action that the sign of
    /// the first one asks for, and loses by what the other one does.
    fn batch(random: &mut ChaCha8Rng) -> Drawing {
        let mut batch = Drawing { rows: (0..32).collect(), ..Drawing::default() };
        for row in 0..32 {
            let mut done = [[0.0_f32; ACTIONS]; 2];
            for done in &mut done {
                done.iter_mut().for_each(|part| *part = random.random_range(0.0..1.0));
                let sum: f32 = done.iter().sum();
                done.iter_mut().for_each(|part| *part /= sum);
            }
            for agent in 0..2 {
                let seen = [random.random_range(-1.0..1.0_f32), random.random_range(-1.0..1.0)];
                batch.seen.extend(seen);
                batch.actions.extend(done[agent]);
                batch.rewards.push(done[agent][wanted(seen[0])] - done[1 - agent][1]);
                batch.of.push(row);
                batch.weights.push(1.0);
                batch.then.push(0);
                let other = (2 * row + 1 - agent) as i64;
                // The second of the four is there where the agent is the first, and the other way about.
                let places = if agent == 0 { [other, 64, 64] } else { [64, 64, other] };
                batch.others.iter_mut().zip(places).for_each(|(rows, place)| rows.push(place));
            }
        }
        batch.seen.extend([0.0; 2]);
        batch.actions.extend([0.0; ACTIONS]);
        batch.next.extend([0.0; 2]);
        batch
    }

    fn wanted(number: f32) -> usize {
        if number > 0.0 { 2 } else { 0 }
    }

    #[test]
    fn an_actor_learns_from_its_critic_what_is_paid_whatever_the_other_agent_does() {
        crate::nn::runtime::set_threads(1);
        let settings = MaddpgSettings { hidden: 32, actor_rate: 3e-3, critic_rate: 3e-3, ..MaddpgSettings::default() };
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut core = Core::new(&settings, 2, &mut random).unwrap();
        let scale = Tensor::ones([2], (Kind::Float, tch::Device::Cpu));
        let (mut first, mut last) = (None, 0.0);
        for _ in 0..600 {
            let gradients = learn(&core.networks, &batch(&mut random), &scale, &settings, &mut random).unwrap();
            assert_eq!((gradients.errors.len(), gradients.losses[1].is_finite()), (32, true));
            first.get_or_insert(gradients.losses[0]);
            last = gradients.losses[0];
            core.apply(&gradients, &settings, 1.0).unwrap();
        }
        assert!(last < 0.1 * first.unwrap(), "{first:?}, {last}");
        for number in [-0.8_f32, -0.3, 0.3, 0.8] {
            let logits = core.networks.actor.forward(&Tensor::from_slice(&[number, 0.5]).view([1, 2])).unwrap();
            assert_eq!(logits.argmax(1, false).int64_value(&[0]), wanted(number) as i64, "{number}");
        }
    }

    #[test]
    fn the_largest_part_of_a_relaxed_action_is_each_as_often_as_the_logits_say_at_any_temperature() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let logits = Tensor::from_slice(&[0.0_f32, 1.0, -1.0, 2.0]).repeat([20_000, 1]);
        let mut sizes = Vec::new();
        for temperature in [1.0, 0.1] {
            let relaxed = relax(&logits, temperature, &mut random).unwrap();
            let sums = relaxed.sum_dim_intlist(1, false, Kind::Float);
            assert!((sums - 1.0).abs().max().double_value(&[]) < 1e-5);
            let largest = relaxed.argmax(1, false);
            for (action, share) in [0.0871, 0.2369, 0.0321, 0.6439].into_iter().enumerate() {
                let found = largest.eq(action as i64).to_kind(Kind::Float).mean(Kind::Float).double_value(&[]);
                assert!((found - share).abs() < 0.012, "{action} at {temperature}: {found}, expected {share}");
            }
            sizes.push(relaxed.amax(1, false).mean(Kind::Float).double_value(&[]));
        }
        assert!(sizes[0] < 0.8 && sizes[1] > 0.95, "the colder, the nearer to one action: {sizes:?}");
    }

    #[test]
    fn what_follows_counts_with_the_discount_unless_the_agent_has_ended_for_good() {
        let settings = MaddpgSettings { hidden: 4, gamma: 0.9, ..MaddpgSettings::default() };
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let networks = Networks::new(&settings, 2, &mut random).unwrap();
        // Each situation is worth 2 now and 3 then.
        for (critic, worth) in [(&networks.critic, 2.0), (&networks.target_critic, 3.0)] {
            for (name, weight) in critic.weights() {
                let _ = no_grad(|| weight.detach().fill_(if name == "critic.4.bias" { worth } else { 0.0 }));
            }
        }
        let scale = Tensor::ones([2], (Kind::Float, tch::Device::Cpu));
        // One agent each: the first goes on, the second has ended.
        let batch = Drawing {
            rows: vec![0, 1],
            of: vec![0, 1],
            seen: vec![0.1, 0.2, 0.3, 0.4, 0.0, 0.0],
            actions: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0; 4]].concat(),
            others: [(); AGENTS - 1].map(|()| vec![2, 2]),
            rewards: vec![0.5, -0.5],
            weights: vec![1.0, 1.0],
            next: vec![0.5, 0.6, 0.0, 0.0],
            next_others: [(); AGENTS - 1].map(|()| vec![1]),
            then: vec![0, 1],
        };
        let errors = learn(&networks, &batch, &scale, &settings, &mut random).unwrap().errors;
        // 0.5 + 0.9 x 3 - 2, and -0.5 - 2.
        assert!((errors[0] - 1.2).abs() < 1e-5 && (errors[1] - 2.5).abs() < 1e-5, "{errors:?}");
    }
}
