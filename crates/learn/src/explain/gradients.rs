//! Integrated gradients: Sundararajan, Taly and Yan, "Axiomatic Attribution for Deep Networks", 2017, arXiv:1703.01365.
//!
//! On the straight way from a picture that shows nothing to the one that is seen, the gradients of the steering are added up
//! pixel by pixel. The shares add up to what the picture adds to the steering (completeness).

use tch::{IndexOp, Kind, Tensor};

use super::ExplainError;
use crate::nn::Network;

/// Pictures on the way, the middles of equal steps. The paper calls for 20 to 300; with 64 the shares of `pilotnet` add up to
/// within a hundredth of full lock on pictures of every road.
const STEPS: i64 = 64;
/// Pictures in a batch.
const BATCH: i64 = 16;

/// How much each number of `input` adds to the steering, compared with `plain`: both (1, C, H, W), as is the result.
///
/// # Errors
/// [`ExplainError::Network`]
pub fn integrated_gradients(
    network: &Network,
    input: &Tensor,
    plain: &Tensor,
    speed: Option<&Tensor>,
) -> Result<Tensor, ExplainError> {
    let way = input.f_sub(plain)?; // (1, C, H, W)
    let mut sum = way.f_zeros_like()?;
    for first in (0..STEPS).step_by(BATCH as usize) {
        let shares: Vec<f32> = (first..first + BATCH).map(|i| (i as f32 + 0.5) / STEPS as f32).collect();
        let shares = Tensor::f_from_slice(&shares)?.f_view([-1, 1, 1, 1])?;
        let on_the_way = plain.f_add(&way.f_mul(&shares)?)?.f_set_requires_grad(true)?; // (BATCH, C, H, W)
        let speed = speed.map(|speed| speed.f_expand([BATCH, 1], false)).transpose()?;
        let steering = network.forward(&on_the_way, speed.as_ref(), false)?.i((.., 0)).f_sum(Kind::Float)?;
        let gradients = Tensor::f_run_backward(&[steering], &[&on_the_way], false, false)?;
        sum = sum.f_add(&gradients[0].f_sum_dim_intlist([0i64].as_slice(), true, Kind::Float)?)?;
    }
    Ok(sum.f_mul(&way)?.f_divide_scalar(STEPS as f64)?)
}
