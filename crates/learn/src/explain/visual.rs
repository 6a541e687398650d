//! VisualBackProp: Bojarski et al., "VisualBackProp: efficient visualization of CNNs", 2016, arXiv:1611.05418; on
//! PilotNet: Bojarski et al., "Explaining How a Deep Neural Network Trained with End-to-End Learning Steers a Car", 2017,
//! arXiv:1704.07911.
//!
//! The maps of each layer are averaged over its channels. From the last layer on, an average is spread over what its layer
//! looked at (a deconvolution with the layer's kernel, stride and padding, all weights 1) and multiplied by the average
//! there, down to the picture: what a late layer reacts to, as sharp as an early one sees it. The paper's networks have
//! ReLU; of PilotNet's ELU the positive part counts. (How far it is above its least, -1, or its size do no better by the check of
//! `tests/explain.rs`.)

use tch::{Kind, Tensor};

use super::ExplainError;
use crate::nn::{Network, NnError, Reach};

/// What the convolutions react to in (1, C, H, W): (1, 1, H, W), 0 or more, to be compared within one picture only.
///
/// # Errors
/// [`ExplainError::Network`]
pub fn visual_back_prop(network: &Network, input: &Tensor, speed: Option<&Tensor>) -> Result<Tensor, ExplainError> {
    let seen = network.activations(input, speed)?;
    tch::no_grad(|| {
        let average = |map: &Tensor| -> Result<Tensor, NnError> {
            let mean = map.f_relu()?.f_mean_dim([1i64].as_slice(), true, Kind::Float)?; // (1, 1, h, w)
            let largest = mean.f_max()?.f_clamp_min(f64::from(f32::MIN_POSITIVE))?;
            Ok(mean.f_divide(&largest)?)
        };
        let mut later: Option<(Tensor, Reach)> = None;
        for (map, reach) in seen.iter().rev() {
            let here = average(map)?;
            let masked = match later {
                Some((mask, reach)) => here.f_mul(&spread(&mask, reach, &here)?)?,
                None => here,
            };
            // Products of many factors below 1 leave what f32 can hold.
            later = Some((average(&masked)?, *reach));
        }
        let not_watched = || NnError::Input { expected: "a network of one frame".into(), got: input.size() };
        let (mask, reach) = later.ok_or_else(not_watched)?;
        Ok(spread(&mask, reach, input)?)
    })
}

/// Each value added to all places at which its layer looked: (1, 1, h, w) to (1, 1, H, W), as high and wide as `before`.
fn spread(mask: &Tensor, Reach { kernel, stride, padding }: Reach, before: &Tensor) -> Result<Tensor, NnError> {
    let (size, target) = (mask.size(), before.size());
    // What the layer's stride left over at the right and at the bottom.
    let over = [2, 3].map(|axis| target[axis] - ((size[axis] - 1) * stride - 2 * padding + kernel));
    let ones = Tensor::f_ones([1, 1, kernel, kernel], (Kind::Float, mask.device()))?;
    let none: Option<&Tensor> = None;
    Ok(mask.f_conv_transpose2d(&ones, none, [stride; 2], [padding; 2], over, 1, [1, 1])?)
}
