//! Which parts of a picture a network's steering comes from.
//!
//! ```text
//! LoadedModel ─▶ Explainer ─▶ explain(picture) ─▶ Explanation ─▶ over(picture): a picture to look at
//! ```
//!
//! Two methods, which look at different things: [`visual_back_prop`] shows what the convolutions react to, in one pass and
//! without asking what the network makes of it; [`integrated_gradients`] shares out the steering itself over the pixels, and
//! says which of them turn the car to the right and which to the left. Neither says why. Networks of one frame that steer are
//! explained: `pilotnet`, `cps`, `resnet18`, `resnet50`.

mod gradients;
mod visual;

use std::ops::Range;

use tch::Tensor;

pub use gradients::integrated_gradients;
pub use visual::visual_back_prop;

use crate::{
    models::LoadedModel,
    nn::{Network, NnError},
};
use lapwing_core::{
    perception::{Frame, PreprocessError, Preprocessor},
    units::Mph,
};

/// What is drawn over pixels that matter, at full strength: those that turn to the right, or in [`Method::VisualBackProp`]
/// all; and those that turn to the left.
const RIGHT: [f32; 3] = [255.0, 40.0, 0.0];
const LEFT: [f32; 3] = [0.0, 90.0, 255.0];
/// How much of a pixel the strongest colour covers; how bright the picture beneath is.
const COVER: f32 = 0.85;
const BENEATH: f32 = 0.6;
/// The share of pixels that are drawn at full strength: a few pixels of an attribution outshine all others.
const BRIGHTEST: f64 = 0.005;

/// Why a network cannot be explained.
#[derive(Debug, thiserror::Error)]
pub enum ExplainError {
    /// A model of another kind.
    #[error("expected a network that steers by one picture (pilotnet, cps, resnet18, resnet50), got {got}")]
    Model {
        /// The model.
        got: String,
    },
    /// Steps before the network that its answer cannot be followed back through.
    #[error("expected preprocessing of rows, bilinear-antialiased and rgb, bgr, yuv or grey, got other steps: {got}")]
    Steps {
        /// The model.
        got: String,
    },
    /// A picture that the network does not take.
    #[error(transparent)]
    Preprocess(#[from] PreprocessError),
    /// The network fails.
    #[error(transparent)]
    Network(#[from] NnError),
}

impl From<tch::TchError> for ExplainError {
    fn from(error: tch::TchError) -> Self {
        Self::Network(error.into())
    }
}

/// How a steering is explained.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// [`visual_back_prop`].
    VisualBackProp,
    /// [`integrated_gradients`].
    IntegratedGradients,
}

/// What a steering comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation {
    /// What the network answers to the picture: normalised steering, positive to the right, not clamped.
    pub steering: f64,
    /// The rows of the picture that the network sees.
    pub rows: Range<usize>,
    /// For each pixel of these rows, row by row, how much it matters, 1 the most: 0 to 1 by visual backpropagation; -1
    /// (turns to the left) to 1 (to the right) by integrated gradients.
    pub values: Vec<f32>,
}

/// A network that can be asked what its steering comes from.
#[derive(Debug)]
pub struct Explainer {
    preprocessor: Preprocessor,
    network: Network,
    /// (C, H, W) f32, flat.
    input: Vec<f32>,
}

impl Explainer {
    /// For a model's network.
    ///
    /// # Errors
    /// [`ExplainError::Model`], [`ExplainError::Steps`], [`ExplainError::Preprocess`]
    pub fn of(model: &LoadedModel) -> Result<Self, ExplainError> {
        let steers = |network: &Network| network.architecture().frames() == 1 && !network.architecture().locates();
        let network = model.network().filter(steers).ok_or_else(|| ExplainError::Model { got: model.name().into() })?;
        if !model.preprocess().is_plain() {
            return Err(ExplainError::Steps { got: model.name().into() });
        }
        Ok(Self::new(network, Preprocessor::new(model.preprocess().clone())?))
    }

    fn new(network: Network, preprocessor: Preprocessor) -> Self {
        Self { preprocessor, network, input: Vec::new() }
    }

    /// Explains the answer to a picture at a speed, which counts for a network that takes it.
    ///
    /// # Errors
    /// [`ExplainError::Preprocess`] for a picture that is too small, [`ExplainError::Network`].
    pub fn explain(&mut self, frame: &Frame, speed: Mph, method: Method) -> Result<Explanation, ExplainError> {
        let rows = self.preprocessor.preprocess().area_of(frame.width(), frame.height())?;
        let input = self.input_of(frame)?; // (1, C, H, W)
        let speed = self.network.speed_input(speed)?;
        let steering = tch::no_grad(|| self.network.forward(&input, speed.as_ref(), false))?.f_double_value(&[0, 0])?;
        let map = match method {
            Method::VisualBackProp => visual_back_prop(&self.network, &input, speed.as_ref())?,
            Method::IntegratedGradients => {
                let plain = self.input_of(&plain(frame, rows.top..rows.bottom))?;
                let shares = integrated_gradients(&self.network, &input, &plain, speed.as_ref())?;
                shares.f_sum_dim_intlist([1i64].as_slice(), true, tch::Kind::Float)? // (1, 1, H, W)
            }
        };
        let size = [(rows.bottom - rows.top) as i64, frame.width() as i64];
        let map = map.f_upsample_bilinear2d(size, false, None, None)?.f_reshape([-1])?;
        let values = relative(Vec::try_from(&map.f_contiguous()?)?);
        Ok(Explanation { steering, rows: rows.top..rows.bottom, values })
    }

    /// (1, C, H, W): what the network is given for a picture.
    fn input_of(&mut self, frame: &Frame) -> Result<Tensor, ExplainError> {
        self.preprocessor.apply(frame, &mut self.input)?;
        let [channels, height, width] = self.preprocessor.preprocess().shape().map(|n| n as i64);
        Ok(Tensor::f_from_slice(&self.input)?.f_view([1, channels, height, width])?)
    }
}

/// A picture without anything in it: of the mean colour of these rows.
fn plain(frame: &Frame, rows: Range<usize>) -> Frame {
    let mut sums = [0usize; 3];
    let seen = &frame.rgb()[rows.start * frame.width() * 3..rows.end * frame.width() * 3];
    for pixel in seen.chunks_exact(3) {
        for (sum, level) in sums.iter_mut().zip(pixel) {
            *sum += usize::from(*level);
        }
    }
    let mean = sums.map(|sum| (sum * 3 / seen.len().max(1)) as u8);
    let pixels = mean.repeat(frame.width() * frame.height());
    Frame::new(frame.width(), frame.height(), pixels).unwrap_or_default()
}

/// Relative to the brightest few.
fn relative(mut values: Vec<f32>) -> Vec<f32> {
    let mut sizes: Vec<f32> = values.iter().map(|value| value.abs()).collect();
    sizes.sort_by(f32::total_cmp);
    let brightest = ((1.0 - BRIGHTEST) * sizes.len() as f64) as usize;
    let full = sizes.get(brightest).copied().unwrap_or(0.0).max(f32::MIN_POSITIVE);
    values.iter_mut().for_each(|value| *value = (*value / full).clamp(-1.0, 1.0));
    values
}

impl Explanation {
    /// The picture, darker, with what matters in red, and in blue what turns to the left.
    pub fn over(&self, frame: &Frame) -> Frame {
        let mut rgb = frame.rgb().to_vec();
        for (pixel, (colour, opacity)) in rgb.as_chunks_mut::<3>().0.iter_mut().zip(self.paint(frame.width())) {
            for (level, full) in pixel.iter_mut().zip(colour) {
                *level = (f32::from(*level) * (1.0 - opacity) + full * opacity) as u8;
            }
        }
        Frame::new(frame.width(), frame.height(), rgb).unwrap_or_default()
    }

    /// What [`Explanation::over`] puts over a picture of this size, by itself: red, green, blue and opacity of each pixel,
    /// row by row.
    pub fn layer(&self, width: usize, height: usize) -> Vec<u8> {
        let level = |share: f32| share.round() as u8;
        let pixel = |([red, green, blue], opacity): ([f32; 3], f32)| [red, green, blue, 255.0 * opacity].map(level);
        self.paint(width).take(width * height).flat_map(pixel).collect()
    }

    /// Colour and opacity of each pixel, row by row without an end: above and below what the network sees it is black, which
    /// only darkens.
    fn paint(&self, width: usize) -> impl Iterator<Item = ([f32; 3], f32)> {
        let nothing = std::iter::repeat_n(&0.0, self.rows.start * width);
        nothing.chain(&self.values).chain(std::iter::repeat(&0.0)).map(|value| {
            let (colour, cover) = (if *value < 0.0 { LEFT } else { RIGHT }, value.abs() * COVER);
            // The picture shows through both: what darkens it, and the colour.
            let opacity = 1.0 - BENEATH * (1.0 - cover);
            (colour.map(|full| full * cover / opacity), opacity)
        })
    }
}

#[cfg(test)]
mod tests;
