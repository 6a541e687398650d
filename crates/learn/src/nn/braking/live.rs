//! The small network for live use, in two widths: it looks at each frame once, beside the one a fifth of a second before it, and
//! keeps what it saw; two linear layers decide by what was seen at each second of the last 20 frames, and by their speeds.
//!
//! ```text
//! frame, less the one 3 before ─▶ 5 convolutions, linear ─▶ 48 numbers ┐ of frames t, t-2, … t-16
//! speed, and whether it is known ─────────────────────────────────────┴─▶ 2 linear layers ─▶ due, blocked
//! ```
//! A live step so costs one frame's convolutions, 9.4 million multiplications, not those of 20 frames; of the wide one, which
//! keeps 64 numbers, 18.5 million. With its predecessor three frames earlier, the oldest of the nine frames reaches back to the
//! first of the 20.
//!
//! Each frame is brought to a mean of 0 and a standard deviation of 1 first, as for the [`lane`](crate::nn::lane): it drives
//! by night and against a low sun.

use tch::{Kind, Tensor};

use super::{Answers, FRAMES, NO_SPEED, Said};
use crate::nn::{
    NnError, TensorSource,
    layers::{Linear, NormedConvolution, channels_last},
};

/// Rows and columns that it takes.
pub const SIZE: [usize; 2] = [64, 240];

/// How wide one is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Width {
    /// Outputs, inputs, kernel and stride of each convolution.
    convolutions: [[i64; 4]; 5],
    /// What is kept of a frame.
    features: i64,
    hidden: i64,
}

/// 132,708 parameters.
pub(super) const LIVE: Width = Width {
    convolutions: [[16, 2, 5, 2], [24, 16, 3, 2], [32, 24, 3, 2], [48, 32, 3, 2], [64, 48, 3, 2]],
    features: 48,
    hidden: 64,
};

/// 285,740 parameters.
pub(super) const WIDE: Width = Width {
    convolutions: [[24, 2, 5, 2], [36, 24, 3, 2], [48, 36, 3, 2], [64, 48, 3, 2], [96, 64, 3, 2]],
    features: 64,
    hidden: 128,
};

/// The channels of the last convolution are 2 x 8, channel by channel.
const LAST_PIXELS: i64 = 16;
/// A frame is seen beside the one so many before it.
pub(crate) const LAG: i64 = 3;
/// Of every so many frames, one is taken into account.
pub(crate) const STEP: i64 = 2;
/// How many those are of 20 frames.
const TAPS: i64 = (FRAMES as i64 - LAG - 1) / STEP + 1;
const DROPOUT: f64 = 0.2;

/// Speeds are counted in this many km/h.
const SPEED_UNIT_KMH: f64 = 50.0;
/// A frame of a single shade stays one; in squared shades.
const LEAST_VARIANCE: f64 = 4.0;

/// The network. Tensors are `conv1.weight`, `norm1.weight` and so on to `norm5.running_var`, and `see.weight`, `near.weight`,
/// `fc1.weight` to `fc2.bias`, shaped as PyTorch's.
#[derive(Debug)]
pub(super) struct Live {
    width: Width,
    convolutions: [NormedConvolution; 5],
    /// Numbers of the convolutions: bf16 takes half the time in training.
    kind: Kind,
    see: Linear,
    /// What each frame by itself shows: for learning alone.
    near: Linear,
    hidden: Linear,
    last: Linear,
}

/// What a drive's last frames left behind.
#[derive(Debug, Default)]
pub struct Seen {
    /// The newest last: (1, 1, H, W), as brought to one light, or as they came.
    frames: Vec<Tensor>,
    /// (1, 1, features) of each frame that has a predecessor.
    features: Vec<Tensor>,
    speeds_kmh: Vec<f32>,
}

/// Adds one and forgets what is too old.
fn push<T>(kept: &mut Vec<T>, new: T, most: usize) {
    if kept.len() >= most {
        kept.remove(0);
    }
    kept.push(new);
}

impl Seen {
    /// Forgets all.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Keeps a frame, (1, H, W), and its speed; the last 20, (1, 20, H, W) and (1, 20), once there are so many.
    pub(super) fn remember(&mut self, frame: &Tensor, speed_kmh: f64) -> Result<Option<(Tensor, Tensor)>, NnError> {
        push(&mut self.frames, frame.f_unsqueeze(0)?, FRAMES);
        push(&mut self.speeds_kmh, speed_kmh as f32, FRAMES);
        if self.frames.len() < FRAMES {
            return Ok(None);
        }
        Ok(Some((Tensor::f_cat(&self.frames, 1)?, self.speeds()?)))
    }

    /// (1, 20)
    fn speeds(&self) -> Result<Tensor, NnError> {
        Ok(Tensor::f_from_slice(&self.speeds_kmh)?.f_unsqueeze(0)?)
    }
}

/// Frames (B, T, H, W) at a mean of 0 and a standard deviation of 1, each by itself.
fn in_one_light(frames: &Tensor) -> Result<Tensor, NnError> {
    let mean = frames.f_mean_dim(&[2i64, 3][..], true, None)?;
    let apart = frames.f_sub(&mean)?;
    let variance = apart.f_square()?.f_mean_dim(&[2i64, 3][..], true, None)?;
    Ok(apart.f_mul(&variance.f_add_scalar(LEAST_VARIANCE)?.f_rsqrt()?)?)
}

/// Frames (B, T) of which each is every `step`th from `first` on.
fn every(x: &Tensor, first: i64, step: i64) -> Result<Tensor, NnError> {
    Ok(x.f_slice(1, first, x.size()[1], step)?)
}

impl Live {
    pub(super) fn build(source: &mut TensorSource<'_>, width: Width) -> Result<Self, NnError> {
        let Width { features, hidden, .. } = width;
        let flat = width.convolutions[4][0] * LAST_PIXELS;
        let mut convolution = |i: usize| {
            let [outputs, inputs, kernel, stride] = width.convolutions[i];
            let (convolution, norm) = (format!("conv{}", i + 1), format!("norm{}", i + 1));
            NormedConvolution::build(source, &convolution, &norm, [outputs, inputs, kernel], stride)
        };
        let convolutions = [convolution(0)?, convolution(1)?, convolution(2)?, convolution(3)?, convolution(4)?];
        Ok(Self {
            width,
            convolutions,
            kind: Kind::Float,
            see: Linear::build(source, "see", features, flat)?,
            near: Linear::build(source, "near", 2, features)?,
            hidden: Linear::build(source, "fc1", hidden, TAPS * features + 2 * FRAMES as i64)?,
            last: Linear::build(source, "fc2", 2, hidden)?,
        })
    }

    /// (B, 20 + 2 n, H, W) and (B, 20 + 2 n) to 1 + n answers.
    pub(super) fn forward(&self, frames: &Tensor, speeds: &Tensor, train: bool) -> Result<Answers, NnError> {
        let lit = in_one_light(frames)?; // (B, T, H, W)
        let now = every(&lit, LAG, STEP)?; // (B, S, H, W): frames 3, 5, … T - 1
        let before = every(&lit.f_narrow(1, 0, lit.size()[1] - LAG)?, 0, STEP)?;
        let [batch, seen] = [now.size()[0], now.size()[1]];
        let pairs = Tensor::f_stack(&[&now, &now.f_sub(&before)?], 2)?.f_flatten(0, 1)?; // (B * S, 2, H, W)
        let features = self.see(&pairs, train)?.f_reshape([batch, seen, self.width.features])?;
        let windows = features.f_unfold(1, TAPS, 1)?.f_flatten(2, 3)?; // (B, 1 + n, features * TAPS)
        let speeds = speeds.f_unfold(1, FRAMES as i64, STEP)?; // (B, 1 + n, 20)
        let said = self.decide(&windows, &speeds, train)?; // (B, 1 + n, 2)
        let near = if train { Some(self.near.forward(&features)?) } else { None };
        Ok(Answers { due: said.f_select(2, 0)?, blocked: Some(said.f_select(2, 1)?), near })
    }

    /// Frames and what changed in them, (N, 2, H, W), to (N, features).
    fn see(&self, pairs: &Tensor, train: bool) -> Result<Tensor, NnError> {
        let mut x = channels_last(&pairs.f_to_kind(self.kind)?)?;
        for convolution in &self.convolutions {
            x = convolution.forward(&x, train)?.f_relu()?;
        }
        Ok(self.see.forward(&x.f_flatten(1, -1)?.f_to_kind(Kind::Float)?)?.f_relu()?)
    }

    /// (B, N, features * TAPS) and (B, N, 20) in km/h to (B, N, 2).
    fn decide(&self, windows: &Tensor, speeds_kmh: &Tensor, train: bool) -> Result<Tensor, NnError> {
        let known = speeds_kmh.f_ne(NO_SPEED)?.f_to_kind(Kind::Float)?;
        let speeds = speeds_kmh.f_mul_scalar(1.0 / SPEED_UNIT_KMH)?.f_mul(&known)?;
        let x = Tensor::f_cat(&[windows, &speeds, &known], 2)?;
        let x = self.hidden.forward(&x)?.f_relu()?.f_dropout(DROPOUT, train)?;
        Ok(self.last.forward(&x)?.f_sigmoid()?)
    }

    /// Looks at the newest frame, (1, H, W), and decides once 20 were seen.
    pub(super) fn answer(&self, frame: &Tensor, speed_kmh: f64, seen: &mut Seen) -> Result<Option<Said>, NnError> {
        let lit = in_one_light(&frame.f_unsqueeze(0)?)?; // (1, 1, H, W)
        push(&mut seen.frames, lit, LAG as usize + 1);
        push(&mut seen.speeds_kmh, speed_kmh as f32, FRAMES);
        if seen.frames.len() <= LAG as usize {
            return Ok(None);
        }
        let (now, before) = (&seen.frames[LAG as usize], &seen.frames[0]);
        let pair = Tensor::f_cat(&[now, &now.f_sub(before)?], 1)?; // (1, 2, H, W)
        let kept = FRAMES - LAG as usize;
        push(&mut seen.features, self.see(&pair, false)?.f_unsqueeze(0)?, kept);
        if seen.features.len() < kept {
            return Ok(None);
        }
        let features: Vec<&Tensor> = seen.features.iter().step_by(STEP as usize).collect();
        let window = Tensor::f_cat(&features, 1)?.f_transpose(1, 2)?.f_reshape([1, 1, -1])?; // features by TAPS, as unfolded
        let speeds = seen.speeds()?.f_unsqueeze(0)?; // (1, 1, 20)
        let said = self.decide(&window, &speeds, false)?; // (1, 1, 2)
        Ok(Some(Said { due: said.f_double_value(&[0, 0, 0])?, blocked: said.f_double_value(&[0, 0, 1])? }))
    }

    pub(super) fn set_kind(&mut self, kind: Kind) {
        self.kind = kind;
    }

    pub(super) fn fold(&mut self) -> Result<(), NnError> {
        self.convolutions.iter_mut().try_for_each(NormedConvolution::fold)
    }

    pub(super) fn share(&self) -> Self {
        Self {
            width: self.width,
            convolutions: self.convolutions.each_ref().map(NormedConvolution::share),
            kind: self.kind,
            see: self.see.share(),
            near: self.near.share(),
            hidden: self.hidden.share(),
            last: self.last.share(),
        }
    }
}
