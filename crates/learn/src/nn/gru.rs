//! A [ResNet](super::resnet) that remembers: Lu, "End to End Learning for Self-Driving Cars", Figure 13b. For each of
//! five frames, the backbone's features and the steering that the perceptron computes from them go, side by side, into
//! a gated recurrent unit (Cho et al., 2014, arXiv:1406.1078) of 512; a linear layer turns its last state into the
//! steering.
//!
//! While driving, a frame's features are kept until it is the oldest of five: the backbone sees each frame once. The
//! speed, if used, is the current one, beside the features of all five frames.
//!
//! From the weights of a ResNet alone the memory starts by passing its steering on, so that the network
//! begins as a driver, and learns what older frames are worth.
//!
//! The unit's tensors are `gru.weight_ih_l0`, `gru.weight_hh_l0`,
//! `gru.bias_ih_l0` and `gru.bias_hh_l0`, gates in PyTorch's order, the linear
//! layer's `out.weight` and `out.bias`; the others are the ResNet's.
//! 13,082,946 parameters with 18 layers, 28,560,194 with 50.

use tch::Tensor;

use super::{
    Init, NnError, TensorSource,
    layers::{Linear, beside, in_kind_of},
    resnet::{Backbone, Depth, Head, STAGES},
};

/// Numbers in the unit's state.
const HIDDEN: i64 = 512;

/// What the steering is multiplied with before the tanh of the state that passes it on: at full lock 2 % are lost there.
const PASSED: f64 = 0.25;
/// Bias of that state's update gate: it keeps a quarter of a percent of what was before.
const UPDATE: f64 = -6.0;

/// The network.
#[derive(Debug)]
pub(super) struct ResNetGru {
    backbone: Backbone,
    head: Head,
    /// Weights of the input and of the state, biases of the input and of the state.
    gru: [Tensor; 4],
    out: Linear,
}

impl ResNetGru {
    pub(super) fn build(depth: Depth, speed: bool, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        let backbone = Backbone::build(depth, super::resnet::CHANNELS as i64, source)?;
        let head = Head::build(depth, false, source)?;
        let inputs = depth.features() + 1 + i64::from(speed);
        let mut gru = |name: &str, shape: &[i64]| source(&format!("gru.{name}_l0"), shape, Init::Uniform(HIDDEN));
        Ok(Self {
            backbone,
            head,
            gru: [
                gru("weight_ih", &[3 * HIDDEN, inputs])?,
                gru("weight_hh", &[3 * HIDDEN, HIDDEN])?,
                gru("bias_ih", &[3 * HIDDEN])?,
                gru("bias_hh", &[3 * HIDDEN])?,
            ],
            out: Linear::build(source, "out", 1, HIDDEN)?,
        })
    }

    /// (B, 5, 3, H, W) and (B, 1) to (B, 1): the steering.
    pub(super) fn forward(&self, frames: &Tensor, speed: Option<&Tensor>, train: bool) -> Result<Tensor, NnError> {
        let [batch, steps] = [frames.size()[0], frames.size()[1]];
        let seen = self.see(&frames.f_flatten(0, 1)?, train)?; // (B * 5, features + 1)
        self.steer(&seen.f_reshape([batch, steps, -1])?, speed, train)
    }

    /// What is kept of a frame: (B, 3, H, W) to (B, features + 1), the features and the steering from this frame alone.
    pub(super) fn see(&self, frames: &Tensor, train: bool) -> Result<Tensor, NnError> {
        let features = self.backbone.forward(frames, train, &mut |_, _| {})?;
        let steering = self.head.forward(&features)?; // (B, 1)
        beside(features, Some(&steering))
    }

    /// (B, 5, features + 1) of frames seen, the oldest first, and (B, 1) to (B, 1).
    pub(super) fn steer(&self, seen: &Tensor, speed: Option<&Tensor>, train: bool) -> Result<Tensor, NnError> {
        let [batch, steps] = [seen.size()[0], seen.size()[1]];
        let input = match speed {
            Some(speed) => {
                let speed = in_kind_of(seen, speed)?.f_reshape([batch, 1, 1])?.f_expand([batch, steps, 1], false)?;
                Tensor::f_cat(&[seen, &speed], 2)?
            }
            None => seen.shallow_clone(),
        };
        let [w_input, w_state, b_input, b_state] = &self.gru;
        let weight = |tensor: &Tensor| in_kind_of(&input, tensor);
        let weights = [weight(w_input)?, weight(w_state)?, weight(b_input)?, weight(b_state)?];
        let start = Tensor::f_zeros([1, batch, HIDDEN], (input.kind(), input.device()))?;
        // cuDNN can only run backwards through what it has computed in training mode.
        let (_, last) = input.f_gru(&start, &weights, true, 1, 0.0, train, false, true)?; // (1, B, 512)
        self.out.forward(&last.f_select(0, 0)?)
    }

    pub(super) fn freeze(&mut self, stages: usize) {
        self.backbone.frozen = stages;
    }

    pub(super) fn is_frozen(&self) -> bool {
        self.backbone.frozen == STAGES
    }

    pub(super) fn fold(&mut self) -> Result<(), NnError> {
        self.backbone.fold()
    }

    pub(super) fn share(&self) -> Self {
        Self {
            backbone: self.backbone.share(),
            head: self.head.share(),
            gru: self.gru.each_ref().map(Tensor::shallow_clone),
            out: self.out.share(),
        }
    }
}

/// Variables of a fresh memory, with values by which it answers what the perceptron said of the newest frame: the first
/// number of its state is that, and the others, as random as they were, are not listened to yet.
pub(super) fn passing_on(memory: Vec<(String, Tensor)>) -> Result<Vec<(Tensor, Tensor)>, NnError> {
    let fill = |mut part: Tensor, number: f64| -> Result<(), NnError> {
        let _ = part.f_fill_(number)?;
        Ok(())
    };
    let start = |(name, variable): (String, Tensor)| -> Result<_, NnError> {
        let value = variable.f_detach_copy()?;
        if name.starts_with("gru") {
            // Rows of the first number's gates: reset, update, new. The reset gate matters no longer.
            let [update, new] = [value.f_get(HIDDEN)?, value.f_get(2 * HIDDEN)?];
            fill(update, if name == "gru.bias_ih_l0" { UPDATE } else { 0.0 })?;
            fill(new.shallow_clone(), 0.0)?;
            if name == "gru.weight_ih_l0" {
                // The features, of which there are 512 or 2048, come before the steering.
                fill(new.f_get(new.size1()? / HIDDEN * HIDDEN)?, PASSED)?;
            }
        } else {
            fill(value.shallow_clone(), 0.0)?;
            if name == "out.weight" {
                fill(value.f_get(0)?.f_get(0)?, 1.0 / PASSED)?;
            }
        }
        Ok((variable, value))
    };
    tch::no_grad(|| memory.into_iter().map(start).collect())
}
