//! PilotNet: Bojarski et al., "End to End Learning for Self-Driving Cars", 2016,
//! arXiv:1604.07316. Five convolutions, four linear layers, 252,219 parameters.
//!
//! The paper leaves the activation open; this is ELU, as in the networks that
//! drive the simulator. Normalisation, the paper's first layer, is preprocessing
//! here.

use tch::Tensor;

use super::{
    NnError, TensorSource,
    layers::{Convolution, Linear, Watch, beside},
};

/// Outputs, inputs, kernel and stride of each convolution; none is padded.
const CONVOLUTIONS: [[i64; 4]; 5] = [[24, 3, 5, 2], [36, 24, 5, 2], [48, 36, 5, 2], [64, 48, 3, 1], [64, 64, 3, 1]];

/// 64 channels of 1 x 18, channel by channel.
const FLAT: i64 = 1152;

/// The network. Tensors are `conv1.weight` to `conv5.bias` and `fc1.weight` to `fc4.bias`, shaped as PyTorch's.
#[derive(Debug)]
pub struct PilotNet {
    convolutions: [Convolution; 5],
    linears: [Linear; 4],
}

impl PilotNet {
    /// Channels, rows and columns that it takes.
    pub const INPUT_SHAPE: [usize; 3] = [3, 66, 200];

    pub(super) fn build(speed: bool, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        let mut convolution = |i: usize| {
            let [outputs, inputs, kernel, stride] = CONVOLUTIONS[i];
            Convolution::build(source, &format!("conv{}", i + 1), [outputs, inputs, kernel], stride, 0)
        };
        let convolutions = [convolution(0)?, convolution(1)?, convolution(2)?, convolution(3)?, convolution(4)?];
        let linears = [
            Linear::build(source, "fc1", 100, FLAT + i64::from(speed))?,
            Linear::build(source, "fc2", 50, 100)?,
            Linear::build(source, "fc3", 10, 50)?,
            Linear::build(source, "fc4", 1, 10)?,
        ];
        Ok(Self { convolutions, linears })
    }

    /// (B, 3, 66, 200) and (B, 1) to (B, 1): the steering.
    pub(super) fn forward(
        &self,
        frames: &Tensor,
        speed: Option<&Tensor>,
        watch: &mut Watch<'_>,
    ) -> Result<Tensor, NnError> {
        let mut x = frames.shallow_clone(); // (B, 3, 66, 200)
        for convolution in &self.convolutions {
            x = convolution.forward(&x)?.f_elu()?;
            watch(&x, convolution.reach());
        }
        // (B, 64, 1, 18) to (B, 1152): by channel, whatever the layout in memory.
        x = beside(x.f_flatten(1, -1)?, speed)?;
        let [hidden @ .., last] = &self.linears;
        for layer in hidden {
            x = layer.forward(&x)?.f_elu()?;
        }
        last.forward(&x) // (B, 1)
    }

    pub(super) fn share(&self) -> Self {
        Self {
            convolutions: self.convolutions.each_ref().map(Convolution::share),
            linears: self.linears.each_ref().map(Linear::share),
        }
    }
}
