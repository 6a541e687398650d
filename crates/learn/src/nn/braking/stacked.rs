//! The network of Itu and Danescu, Fully Convolutional Neural Network for Vehicle Speed and Emergency-Brake Prediction,
//! Sensors 2024, 24(1), 212: 20 grey frames as the channels of one picture through five convolutions, the speeds beside what
//! comes out of them through four linear layers. 5,909,219 parameters.
//!
//! What the paper leaves open here: pixels are 0 to 1, the dropout is the one before the linear layers, and these have ReLU
//! between them, too.

use tch::Tensor;

use crate::nn::{
    NnError, TensorSource,
    layers::{Convolution, Linear, beside},
};

/// Rows and columns that it takes.
pub const SIZE: [usize; 2] = [300, 300];

/// Outputs, inputs, kernel and stride of each convolution; none is padded.
const CONVOLUTIONS: [[i64; 4]; 5] = [[24, 20, 5, 2], [36, 24, 5, 2], [48, 36, 5, 2], [64, 48, 3, 1], [64, 64, 3, 1]];

/// 64 channels of 30 x 30, channel by channel.
const FLAT: i64 = 57_600;

const DROPOUT: f64 = 0.5;

/// The network. Tensors are `conv1.weight` to `conv5.bias` and `fc1.weight` to `fc4.bias`, shaped as PyTorch's.
#[derive(Debug)]
pub(super) struct Stacked {
    convolutions: [Convolution; 5],
    linears: [Linear; 4],
}

impl Stacked {
    pub(super) fn build(source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        let mut convolution = |i: usize| {
            let [outputs, inputs, kernel, stride] = CONVOLUTIONS[i];
            Convolution::build(source, &format!("conv{}", i + 1), [outputs, inputs, kernel], stride, 0)
        };
        let convolutions = [convolution(0)?, convolution(1)?, convolution(2)?, convolution(3)?, convolution(4)?];
        let linears = [
            Linear::build(source, "fc1", 100, FLAT + super::FRAMES as i64)?,
            Linear::build(source, "fc2", 50, 100)?,
            Linear::build(source, "fc3", 10, 50)?,
            Linear::build(source, "fc4", 1, 10)?,
        ];
        Ok(Self { convolutions, linears })
    }

    /// (B, 20, 300, 300) and (B, 20) to (B, 1).
    pub(super) fn forward(&self, frames: &Tensor, speeds: &Tensor, train: bool) -> Result<Tensor, NnError> {
        let mut x = frames.f_mul_scalar(1.0 / 255.0)?; // (B, 20, 300, 300)
        for convolution in &self.convolutions {
            x = convolution.forward(&x)?.f_relu()?;
        }
        x = x.f_dropout(DROPOUT, train)?.f_flatten(1, -1)?; // (B, 57600)
        x = beside(x, Some(speeds))?;
        let [hidden @ .., last] = &self.linears;
        for layer in hidden {
            x = layer.forward(&x)?.f_relu()?;
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
