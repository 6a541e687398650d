//! A network's answers to a data set.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, no_grad};

use super::{Metrics, TrainError};
use crate::{
    dataset::{Augmentation, Batch, Cache, Inputs, Loader, Numbers, Samples},
    nn::{Network, SPEED_UNIT_MPH},
};

/// How far answers lie from labels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// From the labels as recorded.
    pub raw: Metrics,
    /// From labels averaged over nine rows: a keyboard steers in strokes, and no picture tells when the next one comes.
    pub smooth: Metrics,
}

/// Rows that a label is averaged over for [`Measured::smooth`].
const SMOOTH: usize = 9;

/// A batch as tensors: frames (B, C, H, W) or, of a network that looks at several, (B, T, C, H, W), in the kind and
/// layout of the inputs; labels (B, outputs); speed (B, 1).
///
/// # Errors
/// [`TrainError::Network`] where libtorch finds no memory.
pub fn tensors(batch: &Batch, inputs: &Inputs, outputs: usize, device: Device) -> Result<[Tensor; 3], TrainError> {
    let [c, h, w] = inputs.preprocess.shape().map(|n| n as i64);
    let (b, t) = (batch.size as i64, inputs.frames as i64);
    let frames = match &batch.frames {
        Numbers::F32(all) => Tensor::f_from_slice(all)?,
        Numbers::Bf16(all) => Tensor::f_from_slice(all)?,
    };
    let frames = match (inputs.channels_last, t) {
        (false, 1) => frames.f_reshape([b, c, h, w])?,
        (false, _) => frames.f_reshape([b, t, c, h, w])?,
        (true, 1) => frames.f_reshape([b, h, w, c])?.f_permute([0, 3, 1, 2])?,
        (true, _) => frames.f_reshape([b, t, h, w, c])?.f_permute([0, 1, 4, 2, 3])?,
    };
    let kind = frames.kind();
    let columns = [&batch.steering, &batch.acceleration].map(|column| Tensor::from_slice(column));
    let labels = Tensor::f_stack(&columns[..outputs], 1)?.f_to_device(device)?;
    let speed = Tensor::f_from_slice(&batch.speed_mph)?.f_reshape([b, 1])?.f_div_scalar(SPEED_UNIT_MPH)?;
    Ok([frames.f_to_device(device)?, labels, speed.f_to_kind(kind)?.f_to_device(device)?])
}

/// Passes all samples through the network, in their order and as a pilot would, whatever form the inputs have in
/// training. Says the errors, and each answer's steering.
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
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let order = (0..samples.samples.len() as u32).collect();
    let inputs = Inputs::plain(inputs.preprocess.clone(), inputs.frames);
    let loader = Loader::start(
        Arc::clone(samples),
        Arc::clone(cache),
        inputs.clone(),
        Augmentation::none(),
        order,
        64,
        (0, 0, 0),
        threads,
    )?;
    let mut answers = Vec::with_capacity(samples.samples.len());
    for batch in loader {
        let batch = batch?;
        let [frames, _, speed] = tensors(&batch, &inputs, 1, device)?;
        let answer = no_grad(|| super::trainer::forward(network, &frames, &speed, false))?;
        let steering = answer.f_select(1, 0)?.f_to_kind(Kind::Double)?.f_to_device(Device::Cpu)?;
        answers.extend(Vec::<f64>::try_from(&steering)?);
    }
    let labels: Vec<f64> = samples.samples.iter().map(|sample| sample.steering).collect();
    let smooth: Vec<f64> = samples.samples.iter().map(|sample| samples.mean_steering(sample, SMOOTH)).collect();
    let measured = Measured { raw: Metrics::of(&answers, &labels), smooth: Metrics::of(&answers, &smooth) };
    Ok((measured, answers))
}
