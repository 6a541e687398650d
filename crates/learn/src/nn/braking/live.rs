//! The network for live use: it looks at each frame once, together with the one a fifth of a second earlier, and keeps what
//! stands in each of the picture's 40 columns. It decides by the columns of every other one of the last 20 frames, and by their
//! speeds.
//!
//! ```text
//! frame, less the one 3 before ─▶ 5 convolutions ─▶ 40 columns ─┬─▶ linear: the scene, 64 numbers
//!                                                              └─▶ + the scene, convolution ─▶ 40 x 24 numbers ┐ of t, t-2, … t-16
//! scene of t, speeds, and whether they are known ───────────────────▶ 2 convolutions over columns, 2 linear ◀──┘ ─▶ due, blocked
//! ```
//! A column that says how far away the thing in it is, is a stixel: Badino, Franke and Pfeiffer, "The Stixel World", 2009; Levi,
//! Garnett and Fetaya, "StixelNet", 2015, have a network say it. While our network learns, it is also told, for each column, how
//! our car gets past what stands there and, for each frame, where our path leads: in this way, nearly all of a hundred frames
//! without danger teach it something.
//!
//! A live step costs 53 million multiplications. The oldest of the nine frames, with its predecessor three frames earlier,
//! reaches back to the first of the 20. Each frame is first brought to a mean of 0 and a standard deviation of 1.

use tch::{Kind, Tensor};

use super::{Answers, FRAMES, NO_SPEED, Said, Shows};
use crate::nn::{
    NnError, TensorSource,
    layers::{Linear, NormedConvolution, RowConvolution, channels_last},
};

/// Rows and columns of pixels that it takes.
pub const SIZE: [usize; 2] = [80, 320];
/// Columns for which it says what stands there, each 8 pixels wide.
pub const COLUMNS: usize = 40;
/// What it is told of each column while it learns: whether something stands there, how near it is, the room beside it now and
/// when our car is there, and the inverse of the time until then.
pub const TOLD: usize = 5;
/// Places on our path that it is told.
pub const COURSE: usize = 3;

/// Outputs, inputs, kernel and stride of each convolution.
const CONVOLUTIONS: [[i64; 4]; 5] = [[24, 2, 5, 2], [32, 24, 3, 2], [48, 32, 3, 2], [64, 48, 3, 1], [64, 64, 3, 1]];
/// Rows of the last convolution.
const ROWS: i64 = 10;
/// Numbers of a column before it knows of the others, and after.
const WITHIN: i64 = 48;
const KEPT: i64 = 24;
const SCENE: i64 = 64;
/// Channels of the two convolutions over the last frames' columns; the second leaves half as many columns.
const OVER: [i64; 2] = [64, 32];
const HIDDEN: i64 = 64;
/// A frame is seen together with the one so many frames earlier.
pub(crate) const LAG: i64 = 3;
/// One of every so many frames is taken into account.
pub(crate) const STEP: i64 = 2;
/// How many of 20 frames those are.
const TAPS: i64 = (FRAMES as i64 - LAG - 1) / STEP + 1;
const DROPOUT: f64 = 0.2;
/// Speeds are counted in this many km/h.
const SPEED_UNIT_KMH: f64 = 50.0;
/// Added to a frame's variance, in squared shades, so that a frame of a single shade stays one.
const LEAST_VARIANCE: f64 = 4.0;

/// The network. Tensors are `conv1.weight`, `norm1.weight` and so on to `norm5.running_var`, and `column.weight`, `scene.weight`,
/// `around.weight`, `kept.weight`, `over1.weight`, `over2.weight`, `fc1.weight`, `fc2.weight`, and, only for learning,
/// `stands.weight`, `course.weight` and `near.weight`, with their biases.
#[derive(Debug)]
pub(super) struct Live {
    convolutions: [NormedConvolution; 5],
    kind: Kind,
    column: Linear,
    scene: Linear,
    around: Linear,
    kept: RowConvolution,
    over: [RowConvolution; 2],
    hidden: Linear,
    last: Linear,
    stands: Linear,
    course: Linear,
    near: Linear,
}

/// What is kept of a frame: the columns, (N, 24, 40), and the scene, (N, 64).
#[derive(Debug)]
struct Kept {
    columns: Tensor,
    scene: Tensor,
}

/// What a drive's last frames left behind.
#[derive(Debug, Default)]
pub struct Seen {
    /// (1, 1, H, W), the newest last; brought to one light, or (stacked network) as they came.
    frames: Vec<Tensor>,
    /// (1, 24, 40), the columns of each frame that has a predecessor.
    columns: Vec<Tensor>,
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
    pub(super) fn build(source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        let mut convolution = |i: usize| {
            let [outputs, inputs, kernel, stride] = CONVOLUTIONS[i];
            let (convolution, norm) = (format!("conv{}", i + 1), format!("norm{}", i + 1));
            NormedConvolution::build(source, &convolution, &norm, [outputs, inputs, kernel], stride)
        };
        let convolutions = [convolution(0)?, convolution(1)?, convolution(2)?, convolution(3)?, convolution(4)?];
        let columns = COLUMNS as i64;
        let speeds = 2 * FRAMES as i64;
        Ok(Self {
            convolutions,
            kind: Kind::Float,
            column: Linear::build(source, "column", WITHIN, CONVOLUTIONS[4][0] * ROWS)?,
            scene: Linear::build(source, "scene", SCENE, WITHIN * columns)?,
            around: Linear::build(source, "around", WITHIN, SCENE)?,
            kept: RowConvolution::build(source, "kept", [KEPT, WITHIN, 5], 1)?,
            over: [
                RowConvolution::build(source, "over1", [OVER[0], KEPT * TAPS, 3], 1)?,
                RowConvolution::build(source, "over2", [OVER[1], OVER[0], 3], 2)?,
            ],
            hidden: Linear::build(source, "fc1", HIDDEN, OVER[1] * columns / 2 + SCENE + speeds)?,
            last: Linear::build(source, "fc2", 2, HIDDEN)?,
            stands: Linear::build(source, "stands", TOLD as i64, KEPT)?,
            course: Linear::build(source, "course", COURSE as i64, SCENE)?,
            near: Linear::build(source, "near", 2, SCENE)?,
        })
    }

    /// (B, 20 + 2 n, H, W) and (B, 20 + 2 n) to 1 + n answers.
    pub(super) fn forward(&self, frames: &Tensor, speeds: &Tensor, train: bool) -> Result<Answers, NnError> {
        let lit = in_one_light(frames)?; // (B, T, H, W)
        let now = every(&lit, LAG, STEP)?; // (B, S, H, W): frames 3, 5, … T - 1
        let before = every(&lit.f_narrow(1, 0, lit.size()[1] - LAG)?, 0, STEP)?;
        let [batch, seen] = [now.size()[0], now.size()[1]];
        let pairs = Tensor::f_stack(&[&now, &now.f_sub(&before)?], 2)?.f_flatten(0, 1)?; // (B * S, 2, H, W)
        let Kept { columns, scene } = self.see(&pairs, train)?;
        let count = COLUMNS as i64;
        let windows = columns.f_reshape([batch, seen, KEPT * count])?.f_unfold(1, TAPS, 1)?; // (B, M, 24 * 40, taps)
        let answers = windows.size()[1];
        let windows =
            windows.f_reshape([batch * answers, KEPT, count, TAPS])?.f_permute([0, 1, 3, 2])?.f_flatten(1, 2)?;
        let scenes = scene.f_reshape([batch, seen, SCENE])?;
        let newest = scenes.f_narrow(1, TAPS - 1, answers)?.f_flatten(0, 1)?;
        let speeds = speeds.f_unfold(1, FRAMES as i64, STEP)?.f_flatten(0, 1)?; // (B * M, 20)
        let said = self.decide(&windows, &newest, &speeds, train)?.f_view([batch, answers, 2])?;
        let shows = if train { Some(self.shows(&columns, &scenes)?) } else { None };
        Ok(Answers { due: said.f_select(2, 0)?, blocked: Some(said.f_select(2, 1)?), shows })
    }

    /// Columns (B * S, 24, 40) and scenes (B, S, 64).
    fn shows(&self, columns: &Tensor, scenes: &Tensor) -> Result<Shows, NnError> {
        let [batch, seen] = [scenes.size()[0], scenes.size()[1]];
        let columns = self.stands.forward(&columns.f_permute([0, 2, 1])?)?;
        Ok(Shows {
            near: self.near.forward(scenes)?,
            columns: columns.f_reshape([batch, seen, COLUMNS as i64, TOLD as i64])?,
            course: self.course.forward(scenes)?,
        })
    }

    /// Frames and what changed in them, (N, 2, H, W).
    fn see(&self, pairs: &Tensor, train: bool) -> Result<Kept, NnError> {
        let mut x = channels_last(&pairs.f_to_kind(self.kind)?)?;
        for convolution in &self.convolutions {
            x = convolution.forward(&x, train)?.f_relu()?;
        }
        let columns = x.f_permute([0, 3, 1, 2])?.f_flatten(2, 3)?; // (N, 40, 64 * 10)
        let columns = self.column.forward(&columns)?.f_relu()?.f_to_kind(Kind::Float)?; // (N, 40, 48)
        let scene = self.scene.forward(&columns.f_flatten(1, 2)?.f_dropout(DROPOUT, train)?)?.f_relu()?; // (N, 64)
        let around = columns.f_add(&self.around.forward(&scene)?.f_unsqueeze(1)?)?.f_relu()?; // (N, 40, 48)
        let columns = self.kept.forward(&around.f_permute([0, 2, 1])?)?.f_relu()?; // (N, 24, 40)
        Ok(Kept { columns, scene })
    }

    /// Columns of the last frames (N, 24 * taps, 40), the newest's scene (N, 64) and speeds (N, 20) in km/h to (N, 2).
    fn decide(&self, windows: &Tensor, scene: &Tensor, speeds_kmh: &Tensor, train: bool) -> Result<Tensor, NnError> {
        let known = speeds_kmh.f_ne(NO_SPEED)?.f_to_kind(Kind::Float)?;
        let speeds = speeds_kmh.f_mul_scalar(1.0 / SPEED_UNIT_KMH)?.f_mul(&known)?;
        let mut x = windows.shallow_clone();
        for over in &self.over {
            x = over.forward(&x)?.f_relu()?;
        }
        let x = Tensor::f_cat(&[&x.f_flatten(1, 2)?, scene, &speeds, &known], 1)?;
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
        let Kept { columns, scene } = self.see(&pair, false)?;
        let kept = FRAMES - LAG as usize;
        push(&mut seen.columns, columns, kept);
        if seen.columns.len() < kept {
            return Ok(None);
        }
        let taps: Vec<&Tensor> = seen.columns.iter().step_by(STEP as usize).collect();
        let windows = Tensor::f_stack(&taps, 2)?.f_flatten(1, 2)?; // (1, 24 * taps, 40)
        let said = self.decide(&windows, &scene, &seen.speeds()?, false)?; // (1, 2)
        Ok(Some(Said { due: said.f_double_value(&[0, 0])?, blocked: said.f_double_value(&[0, 1])? }))
    }

    pub(super) fn set_kind(&mut self, kind: Kind) {
        self.kind = kind;
    }

    pub(super) fn fold(&mut self) -> Result<(), NnError> {
        self.convolutions.iter_mut().try_for_each(NormedConvolution::fold)
    }

    pub(super) fn share(&self) -> Self {
        Self {
            convolutions: self.convolutions.each_ref().map(NormedConvolution::share),
            kind: self.kind,
            column: self.column.share(),
            scene: self.scene.share(),
            around: self.around.share(),
            kept: self.kept.share(),
            over: self.over.each_ref().map(RowConvolution::share),
            hidden: self.hidden.share(),
            last: self.last.share(),
            stands: self.stands.share(),
            course: self.course.share(),
            near: self.near.share(),
        }
    }
}
