//! The network that drives an agent: all agents share it.

use std::{
    collections::HashMap,
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor, no_grad};

use super::{MarlError, file};
use lapwing_sim::intersection::{
    ACTIONS, AGENTS, Action, Environment, FRAME, OBSERVATION, Settings, Sight, observation::SCALE,
};

/// The value of the key `format`.
pub(super) const FORMAT: &str = "lapwing.marl/1";
/// Units in each hidden layer, of what is trained and of what is read.
pub(super) const HIDDEN: RangeInclusive<usize> = 1..=4096;

/// What stands between the layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// cleanrl's PPO.
    #[default]
    Tanh,
    /// MADDPG (Lowe et al. 2017).
    Relu,
}

/// A multilayer perceptron with two hidden layers.
#[derive(Debug)]
pub struct Mlp {
    activation: Activation,
    /// Weight (out, in) and bias (out) of each layer, by name.
    layers: Vec<(String, Tensor)>,
}

impl Mlp {
    /// Orthogonal weights with a gain of the square root of 2, and another one in the last layer; biases of 0 (detail 2
    /// of Huang et al. 2022, The 37 Implementation Details of PPO).
    pub fn new(name: &str, sizes: [usize; 4], last_gain: f64, random: &mut ChaCha8Rng) -> Result<Self, MarlError> {
        let mut layers = Vec::new();
        for (i, pair) in sizes.windows(2).enumerate() {
            let gain = if i == 2 { last_gain } else { std::f64::consts::SQRT_2 };
            let weight = orthogonal(pair[1], pair[0], gain, random)?;
            let bias = Tensor::f_zeros([pair[1] as i64], (Kind::Float, tch::Device::Cpu))?;
            layers.push((format!("{name}.{}.weight", 2 * i), weight.f_set_requires_grad(true)?));
            layers.push((format!("{name}.{}.bias", 2 * i), bias.f_set_requires_grad(true)?));
        }
        Ok(Self { activation: Activation::Tanh, layers })
    }

    /// What stands between its layers.
    pub fn activation(&self) -> Activation {
        self.activation
    }

    /// The same weights with another activation.
    pub fn with(self, activation: Activation) -> Self {
        Self { activation, ..self }
    }

    /// A network of the same shape and weights with memory of its own.
    pub fn copy(&self) -> Result<Self, MarlError> {
        let copy = |(name, tensor): &(String, Tensor)| -> Result<_, MarlError> {
            Ok((name.clone(), copied(tensor)?.f_set_requires_grad(true)?))
        };
        Ok(Self { activation: self.activation, layers: self.layers.iter().map(copy).collect::<Result<_, _>>()? })
    }

    /// Takes over another network's weights, or moves towards them by a share.
    pub fn follow(&self, other: &Self, share: f64) -> Result<(), MarlError> {
        no_grad(|| {
            for ((_, own), (_, other)) in self.layers.iter().zip(&other.layers) {
                let mut own = own.f_detach()?; // the same memory
                if share < 1.0 {
                    let _ = own.f_lerp_(&other.f_detach()?, share)?;
                } else {
                    own.f_copy_(other)?;
                }
            }
            Ok(())
        })
    }

    /// (B, in) to (B, out).
    pub fn forward(&self, input: &Tensor) -> Result<Tensor, MarlError> {
        self.rest(&self.first(input)?)
    }

    /// (B, in) to (B, hidden): the first layer.
    pub(super) fn first(&self, input: &Tensor) -> Result<Tensor, MarlError> {
        Ok(input.f_linear(&self.layers[0].1, Some(&self.layers[1].1))?)
    }

    /// The weight (hidden, in) of the first layer.
    pub(super) fn first_weight(&self) -> &Tensor {
        &self.layers[0].1
    }

    /// (B, hidden) to (B, out): what comes after the first layer.
    pub(super) fn rest(&self, first: &Tensor) -> Result<Tensor, MarlError> {
        let mut x = first.shallow_clone();
        for layer in self.layers[2..].chunks_exact(2) {
            x = match self.activation {
                Activation::Tanh => x.f_tanh()?,
                Activation::Relu => x.f_relu()?,
            };
            x = x.f_linear(&layer[0].1, Some(&layer[1].1))?;
        }
        Ok(x)
    }

    /// Weights and biases by PyTorch's names.
    pub fn weights(&self) -> Vec<(String, Tensor)> {
        self.layers.iter().map(|(name, tensor)| (name.clone(), tensor.shallow_clone())).collect()
    }
}

/// The same numbers in memory of their own.
pub(super) fn copied(tensor: &Tensor) -> Result<Tensor, MarlError> {
    let mut copy = tensor.f_detach()?.f_empty_like()?;
    no_grad(|| copy.f_copy_(tensor))?;
    Ok(copy)
}

/// (rows, columns) f32 with orthogonal rows or columns, whichever are fewer (Saxe et al. 2013), as PyTorch's
/// `orthogonal_` makes them.
fn orthogonal(rows: usize, columns: usize, gain: f64, random: &mut ChaCha8Rng) -> Result<Tensor, MarlError> {
    let (long, short) = (rows.max(columns), rows.min(columns));
    // The sum of twelve uniform numbers is as good as normal here.
    let normal = |random: &mut ChaCha8Rng| (0..12).map(|_| random.random_range(0.0..1.0_f64)).sum::<f64>() - 6.0;
    let numbers: Vec<f64> = (0..long * short).map(|_| normal(random)).collect();
    let (q, r) = Tensor::f_linalg_qr(&Tensor::f_from_slice(&numbers)?.f_view([long as i64, short as i64])?, "reduced")?;
    let q = q.f_mul(&r.f_diagonal(0, 0, 1)?.f_sign()?)?; // so that all directions are as likely
    let q = if rows < columns { q.f_transpose(0, 1)? } else { q };
    Ok(q.f_mul_scalar(gain)?.f_to_kind(Kind::Float)?.f_contiguous()?)
}

/// (numbers of the observation): what it is multiplied with to be of the order of one.
pub(super) fn scale(sight: Sight) -> Result<Tensor, MarlError> {
    let each: Vec<f32> = match sight {
        Sight::Sectors => (0..OBSERVATION).map(|i| 1.0 / SCALE[i % FRAME]).collect(),
        Sight::Routes => vec![1.0; sight.numbers()],
    };
    Ok(Tensor::f_from_slice(&each)?)
}

/// What a policy's file says about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicyMetadata {
    /// `lapwing.marl/1`.
    pub format: String,
    /// What trained it.
    pub algorithm: String,
    /// Units in each hidden layer.
    pub hidden: usize,
    /// What stands between the layers.
    #[serde(default)]
    pub activation: Activation,
    /// The intersection that it was trained on: its axes are those on which it sees.
    pub settings: Settings,
    /// Agent-steps that it was trained for.
    pub agent_steps: u64,
    /// The settings of the algorithm, for people.
    pub training: serde_json::Value,
}

/// An actor that drives.
#[derive(Debug)]
pub struct Policy {
    actor: Mlp,
    scale: Tensor,
    /// What its file says.
    pub metadata: PolicyMetadata,
    observations: Vec<f32>,
}

impl Policy {
    /// Writes an actor's file.
    pub(super) fn save(path: &Path, actor: &Mlp, metadata: &PolicyMetadata) -> Result<(), MarlError> {
        let text = serde_json::to_string(metadata)
            .map_err(|why| MarlError::File { path: path.to_owned(), why: why.to_string() })?;
        file::save(path, HashMap::from([("lapwing.policy".to_owned(), text)]), &actor.weights())
    }

    /// Reads one.
    ///
    /// # Errors
    /// [`MarlError`], if the file is not a policy's or its network another one.
    pub fn load(path: impl Into<PathBuf>) -> Result<Self, MarlError> {
        let path = path.into();
        let read = file::Read::open(&path, "a policy of lapwing marl train")?;
        let metadata: PolicyMetadata = read.json("lapwing.policy")?;
        if metadata.format != FORMAT {
            return Err(read.wrong(format_args!("expected the format {FORMAT:?}, got {:?}", metadata.format)));
        }
        if !HIDDEN.contains(&metadata.hidden) {
            let (least, most) = HIDDEN.into_inner();
            return Err(read.wrong(format_args!("expected {least} to {most} hidden units, got {}", metadata.hidden)));
        }
        let sight = metadata.settings.sight;
        let actor = Mlp::blank("actor", [sight.numbers(), metadata.hidden, metadata.hidden, ACTIONS])?
            .with(metadata.activation);
        read.copy_to(&actor.layers)?;
        Ok(Self { actor, scale: scale(sight)?, metadata, observations: Vec::new() })
    }

    /// The intersection that it was trained on. It drives where what it sees and on which axes are the same.
    pub fn settings(&self) -> Settings {
        self.metadata.settings
    }

    /// The likeliest action of each agent of each intersection.
    ///
    /// # Errors
    /// Those of libtorch.
    pub fn act(&mut self, environments: &[Environment], actions: &mut [[Action; AGENTS]]) -> Result<(), MarlError> {
        self.observations.clear();
        for environment in environments {
            (0..AGENTS).for_each(|i| self.observations.extend(environment.observation(i)));
        }
        let rows = (environments.len() * AGENTS) as i64;
        let best = no_grad(|| {
            let input = Tensor::f_from_slice(&self.observations)?.f_view([rows, -1])?;
            let logits = self.actor.forward(&input.f_mul(&self.scale)?)?; // (B, ACTIONS)
            Ok::<_, MarlError>(logits.f_argmax(1, false)?)
        })?;
        let mut numbers = vec![0_i64; rows as usize];
        best.f_copy_data(&mut numbers, rows as usize)?;
        for (actions, numbers) in actions.iter_mut().zip(numbers.as_chunks::<AGENTS>().0) {
            *actions = numbers.map(|number| Action::of(number as u8));
        }
        Ok(())
    }
}

impl Mlp {
    /// Without weights, to be filled.
    fn blank(name: &str, sizes: [usize; 4]) -> Result<Self, MarlError> {
        let mut layers = Vec::new();
        for (i, pair) in sizes.windows(2).enumerate() {
            let zeros = |shape: &[i64]| Tensor::f_zeros(shape, (Kind::Float, tch::Device::Cpu));
            layers.push((format!("{name}.{}.weight", 2 * i), zeros(&[pair[1] as i64, pair[0] as i64])?));
            layers.push((format!("{name}.{}.bias", 2 * i), zeros(&[pair[1] as i64])?));
        }
        Ok(Self { activation: Activation::Tanh, layers })
    }
}
