//! Five frames as one picture of 15 channels, the oldest first, for one
//! [ResNet](super::resnet) that looks at all of them together.
//!
//! Only its first convolution differs. From the weights for one picture it starts with these for the newest frame and
//! zeros for the four before, and so answers as the network for one picture did; what the older frames are worth, it learns.
//! (Repeated five times and divided by five, as Carreira and Zisserman inflate along time (2017, arXiv:1705.07750), it
//! answers the mean of five moments, which is late in bends: `models/README.md` has both.) 37,632 parameters more than the
//! ResNet's: 11,542,593 with 18 layers, 24,660,545 with 50.

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
pub(super) fn widen(weight: &Tensor) -> Result<Tensor, NnError> {
    let older = CHANNELS - resnet::CHANNELS as i64;
    Ok(weight.f_pad([0, 0, 0, 0, older, 0], "constant", 0.0)?)
}
