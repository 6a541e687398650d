//! The network of Krasheninnikov's radio-controlled car: five convolutions on a
//! small grey picture, two linear layers, 160,578 parameters; it answers
//! acceleration as well as steering.
//!
//! The upper 60% of the picture is cropped away and the rest scaled to 12 rows of 40 grey pixels; here that is
//! preprocessing. His count of parameters settles what the list of layers leaves open: one input channel, convolutions
//! that keep the size, so that two poolings leave 32 channels of 3 x 10 for 128 neurons and 2.

use tch::Tensor;

use super::{
    Init, NnError, TensorSource,
    layers::{Convolution, Linear, Reach, Watch, beside},
};

/// Inputs of each convolution of 32 outputs and 3 x 3; pooling follows the second and the fifth.
const INPUTS: [i64; 5] = [1, 32, 32, 32, 32];
const OUTPUTS: i64 = 32;
const POOLED: [usize; 2] = [1, 4];

/// 32 channels of 3 x 10, channel by channel.
const FLAT: i64 = 960;
const HIDDEN: i64 = 128;

/// The share of the 960 numbers that training drops in each pass.
const DROPOUT: f64 = 0.3;

/// The network. Tensors are `conv1.weight` to `conv5.bias` and `fc1.weight` to `fc2.bias`, shaped as PyTorch's.
#[derive(Debug)]
pub struct Cps {
    convolutions: [Convolution; 5],
    hidden: Linear,
    last: Linear,
}

impl Cps {
    /// Channels, rows and columns that it takes.
    pub const INPUT_SHAPE: [usize; 3] = [1, 12, 40];

    pub(super) fn build(speed: bool, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        // With PyTorch's default initialisation, which does not suit ReLU, so little signal passes five layers that SGD
        // does not leave its starting point: tried over four epochs of 20,000 pictures at rates of 0.02 and 0.1.
        let source: &mut TensorSource<'_> = &mut |name, shape, _| {
            let init = match shape {
                [_, inputs @ ..] if !inputs.is_empty() => Init::KaimingNormal(inputs.iter().product()),
                _ => Init::Constant(0.0),
            };
            source(name, shape, init)
        };
        let mut convolution =
            |i: usize| Convolution::build(source, &format!("conv{}", i + 1), [OUTPUTS, INPUTS[i], 3], 1, 1);
        Ok(Self {
            convolutions: [convolution(0)?, convolution(1)?, convolution(2)?, convolution(3)?, convolution(4)?],
            hidden: Linear::build(source, "fc1", HIDDEN, FLAT + i64::from(speed))?,
            last: Linear::build(source, "fc2", 2, HIDDEN)?,
        })
    }

    /// (B, 1, 12, 40) and (B, 1) to (B, 2): steering and acceleration.
    pub(super) fn forward(
        &self,
        frames: &Tensor,
        speed: Option<&Tensor>,
        train: bool,
        watch: &mut Watch<'_>,
    ) -> Result<Tensor, NnError> {
        let mut x = frames.shallow_clone(); // (B, 1, 12, 40)
        for (i, convolution) in self.convolutions.iter().enumerate() {
            x = convolution.forward(&x)?.f_relu()?;
            watch(&x, convolution.reach());
            if POOLED.contains(&i) {
                x = x.f_max_pool2d([2, 2], [2, 2], [0, 0], [1, 1], false)?;
                watch(&x, Reach { kernel: 2, stride: 2, padding: 0 });
            }
        }
        // (B, 32, 3, 10) to (B, 960): by channel, whatever the layout in memory.
        x = x.f_flatten(1, -1)?.f_dropout(DROPOUT, train)?;
        self.last.forward(&self.hidden.forward(&beside(x, speed)?)?.f_relu()?)
    }

    pub(super) fn share(&self) -> Self {
        Self {
            convolutions: self.convolutions.each_ref().map(Convolution::share),
            hidden: self.hidden.share(),
            last: self.last.share(),
        }
    }
}
