//! A network's answers to a data set.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, no_grad};

use super::{Metrics, TrainError};
use crate::{
    dataset::{Augmentation, Batch, Cache, Inputs, Label, Loader, Numbers, Samples, Workers},
    nn::{Architecture, Network, SPEED_UNIT_MPH},
};

/// What an architecture's first outputs are trained towards.
pub(super) fn labels(architecture: Architecture) -> &'static [Label] {
    match architecture {
        Architecture::Cps => &[Label::Steering, Label::Acceleration],
        Architecture::Lane => &[Label::OffsetM, Label::HeadingDeg],
        _ => &[Label::Steering],
    }
}

/// How far answers are from labels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// From the labels as recorded.
    pub raw: Metrics,
    /// From labels averaged over nine rows: a keyboard steers in strokes, and no picture shows when the next one comes.
    pub smooth: Metrics,
}

impl Measured {
    /// Measures answers to these samples, one for each, in order, by this label. Only steering is averaged.
    pub fn of(answers: &[f64], samples: &Samples, label: Label) -> Self {
        let labels: Vec<f64> = samples.samples.iter().map(|sample| sample.label(label)).collect();
        if label != Label::Steering {
            let raw = Metrics::of(answers, &labels);
            return Self { raw, smooth: raw };
        }
        let smooth: Vec<f64> = samples.samples.iter().map(|sample| samples.mean_steering(sample, SMOOTH)).collect();
        Self { raw: Metrics::of(answers, &labels), smooth: Metrics::of(answers, &smooth) }
    }
}

/// Rows that a label is averaged over for [`Measured::smooth`].
const SMOOTH: usize = 9;

/// Samples that [`measure`] passes through the network at once.
pub(super) const BATCH: usize = 64;

/// A batch as libtorch sees it.
#[derive(Debug)]
pub struct Tensors {
    /// (B, C, H, W) or, for a network that looks at several frames, (B, T, C, H, W), in the kind and layout of the
    /// inputs. On the CPU its numbers are those of `batch`.
    pub(super) frames: Tensor,
    /// (B, labels), what the first outputs should be.
    pub(super) labels: Tensor,
    /// (B, 1).
    pub(super) speed: Tensor,
    /// The memory of the frames; dropped after them, as the last field.
    batch: Batch,
}

impl Tensors {
    /// Moves a batch of these inputs, with these labels, to a device.
    ///
    /// # Errors
    /// [`TrainError::Network`] if libtorch finds no memory.
    pub fn new(batch: Batch, inputs: &Inputs, labels: &[Label], device: Device) -> Result<Self, TrainError> {
        let [c, h, w] = inputs.preprocess.shape();
        let (b, t) = (batch.size, inputs.frames);
        let (pointer, numbers, kind) = match &*batch.frames {
            Numbers::F32(all) => (all.as_ptr().cast::<u8>(), all.len(), Kind::Float),
            Numbers::Bf16(all) => (all.as_ptr().cast::<u8>(), all.len(), Kind::BFloat16),
        };
        let strides = if inputs.channels_last { [1, w * c, c] } else { [h * w, w, 1] };
        let (shape, strides) = match t {
            1 => (vec![b, c, h, w], [&[c * h * w][..], &strides].concat()),
            _ => (vec![b, t, c, h, w], [&[t * c * h * w, c * h * w][..], &strides].concat()),
        };
        assert_eq!(shape.iter().product::<usize>(), numbers, "a loader fills its batches");
        let [shape, strides] = [shape, strides].map(|n| n.into_iter().map(|n| n as i64).collect::<Vec<_>>());
        // SAFETY: shape and strides span exactly the numbers of that kind at the pointer. They are neither moved nor
        // freed before the tensor, since `Tensors` owns both and nothing else can reach the batch's memory; and a
        // backward pass keeps nothing of the frames after it ends.
        let frames = unsafe { Tensor::f_from_blob(pointer, &shape, &strides, kind, Device::Cpu)? };
        let columns = labels.iter().map(|label| Tensor::f_from_slice(batch.labels(*label)));
        let labels = Tensor::f_stack(&columns.collect::<Result<Vec<_>, _>>()?, 1)?.f_to_device(device)?;
        let speed = Tensor::f_from_slice(&batch.speed_mph)?.f_reshape([b as i64, 1])?.f_div_scalar(SPEED_UNIT_MPH)?;
        let speed = speed.f_to_kind(kind)?.f_to_device(device)?;
        Ok(Self { frames: frames.f_to_device(device)?, labels, speed, batch })
    }

    /// The batch.
    pub fn batch(&self) -> &Batch {
        &self.batch
    }
}

/// Passes all samples through the network, in order and as a pilot would, whatever form the inputs have in training.
/// Returns the errors, and each answer's first number.
///
/// # Errors
/// [`TrainError`].
pub fn measure(
    network: &Network,
    samples: &Arc<Samples>,
    cache: &Arc<Cache>,
    inputs: &Inputs,
) -> Result<(Measured, Vec<f64>), TrainError> {
    let device = network.tensors().first().map_or(Device::Cpu, |(_, tensor)| tensor.device());
    let order = (0..samples.samples.len() as u32).collect();
    let inputs = Inputs::plain(inputs.preprocess.clone(), inputs.frames);
    let loader = Loader::start(
        Arc::clone(samples),
        Arc::clone(cache),
        inputs.clone(),
        Augmentation::none(),
        order,
        BATCH,
        (0, 0, 0),
        Workers::all(device != Device::Cpu),
    )?;
    let mut answers = Vec::with_capacity(samples.samples.len());
    for batch in loader {
        let tensors = Tensors::new(batch?, &inputs, labels(network.architecture()), device)?;
        let answer = no_grad(|| super::trainer::forward(network, &tensors, false))?;
        let first = answer.f_select(1, 0)?.f_to_kind(Kind::Double)?.f_to_device(Device::Cpu)?;
        answers.extend(Vec::<f64>::try_from(&first)?);
    }
    Ok((Measured::of(&answers, samples, labels(network.architecture())[0]), answers))
}
