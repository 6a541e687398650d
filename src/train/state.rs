//! All that going on with a training takes, in one file.

use std::{collections::HashMap, fs, path::Path};

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, no_grad};

use super::{Epoch, TrainError};

/// Where a training is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Position {
    /// Epochs done.
    pub epoch: usize,
    /// Steps done in the epoch after those.
    pub step: usize,
    /// Steps done in all.
    pub steps: i64,
    /// Least validation error so far.
    pub best: Option<f64>,
    /// Epochs since then.
    pub waited: usize,
    /// What the plateau schedule has made of the learning rate.
    pub factor: f64,
    /// What the epochs done were like.
    pub history: Vec<Epoch>,
}

const KEY: &str = "lapwing.training";

/// Writes tensors and position; a file of that name is replaced once the new one is whole.
pub(super) fn save(path: &Path, position: &Position, tensors: &[(String, &Tensor)]) -> Result<(), TrainError> {
    let mut bytes = Vec::with_capacity(tensors.len());
    for (name, tensor) in tensors {
        let tensor = tensor.f_detach()?.f_to_device(Device::Cpu)?.f_to_kind(Kind::Float)?.f_contiguous()?;
        let mut values = vec![0f32; tensor.numel()];
        tensor.f_copy_data(&mut values, tensor.numel())?;
        let shape: Vec<usize> = tensor.size().into_iter().map(|n| n as usize).collect();
        bytes.push((name, shape, values.into_iter().flat_map(f32::to_le_bytes).collect::<Vec<u8>>()));
    }
    let wrong = |why: String| TrainError::State { path: path.to_owned(), why };
    let views = bytes
        .iter()
        .map(|(name, shape, data)| Ok((*name, TensorView::new(Dtype::F32, shape.clone(), data)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()
        .map_err(|why| wrong(why.to_string()))?;
    let json = serde_json::to_string(position).map_err(|why| wrong(why.to_string()))?;
    let metadata = HashMap::from([(KEY.to_owned(), json)]);
    let whole = safetensors::serialize(views, Some(metadata)).map_err(|why| wrong(why.to_string()))?;
    let partial = path.with_extension("safetensors.tmp");
    fs::write(&partial, whole)
        .and_then(|()| fs::rename(&partial, path))
        .map_err(TrainError::io("write the training's state", path))
}

/// Reads the position, and the tensors into those of the same names.
pub(super) fn load(path: &Path, tensors: &[(String, &Tensor)]) -> Result<Position, TrainError> {
    let bytes = fs::read(path).map_err(TrainError::io("read the training's state", path))?;
    let wrong = |why: String| TrainError::State { path: path.to_owned(), why };
    let file = SafeTensors::deserialize(&bytes).map_err(|why| wrong(why.to_string()))?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|why| wrong(why.to_string()))?;
    let json = header.metadata().as_ref().and_then(|m| m.get(KEY)).ok_or_else(|| wrong(format!("no key {KEY}")))?;
    let position = serde_json::from_str(json).map_err(|why| wrong(why.to_string()))?;
    for (name, tensor) in tensors {
        let view = file.tensor(name).map_err(|_| wrong(format!("expected the tensor {name}, got none")))?;
        let shape: Vec<i64> = view.shape().iter().map(|n| *n as i64).collect();
        if shape != tensor.size() || view.dtype() != Dtype::F32 {
            return Err(wrong(format!("tensor {name}: expected {:?}, got {shape:?}", tensor.size())));
        }
        let stored = Tensor::f_from_data_size(view.data(), &shape, Kind::Float)?;
        no_grad(|| tensor.shallow_clone().f_copy_(&stored))?;
    }
    Ok(position)
}
