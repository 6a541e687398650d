//! Five frames as one picture of 15 channels, the oldest first, for one
//! [ResNet](super::resnet) that looks at all of them together.
//!
//! Only its first convolution differs, and starts from that for one picture: inflated, as Carreira and Zisserman do
//! along time ("Quo Vadis, Action Recognition?", 2017, arXiv:1705.07750). The weights for three channels, repeated five
//! times and divided by five, answer five equal frames as they answered one. 37,632 parameters more than the ResNet's:
//! 11,542,593 with 18 layers, 24,660,545 with 50.

use tch::Tensor;

use super::{NnError, architecture::FRAMES, resnet};

/// Channels of all frames together.
pub(super) const CHANNELS: i64 = (FRAMES * resnet::CHANNELS) as i64;

/// (B, 5, 3, H, W) to (B, 15, H, W), channels last in memory if they were so in each frame.
pub(super) fn stacked(frames: &Tensor) -> Result<Tensor, NnError> {
    if frames.stride()[2] == 1 {
        return Ok(frames.f_permute([0, 3, 4, 1, 2])?.f_flatten(3, 4)?.f_permute([0, 3, 1, 2])?);
    }
    Ok(frames.f_flatten(1, 2)?)
}

/// Turns a convolution's weights for one frame, (N, 3, k, k), into those for five, (N, 15, k, k).
pub(super) fn inflate(weight: &Tensor) -> Result<Tensor, NnError> {
    Ok(weight.f_repeat([1, FRAMES as i64, 1, 1])?.f_div_scalar(FRAMES as f64)?)
}
