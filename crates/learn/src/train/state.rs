//! The resume state of a training, in one file.

use std::{
    collections::HashMap,
    fs,
    path::{Path, PathBuf},
};

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, no_grad};

use super::{Epoch, TimedEpoch, TrainError, origin::Origin};
use lapwing_core::files;

/// The position of a training.
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
    /// The plateau schedule's factor on the learning rate.
    pub factor: f64,
    /// For the steps done in this epoch: the answers, the labels, and the time taken.
    #[serde(default)]
    pub answers: Vec<f64>,
    #[serde(default)]
    pub labels: Vec<f64>,
    #[serde(default)]
    pub seconds: f64,
    /// The results of the epochs done.
    pub history: Vec<TimedEpoch>,
}

/// The names of the file in a training's folder, and of the checkpoint beside it.
pub(super) const STATE: &str = "state.safetensors";
pub(super) const MODEL: &str = "model.safetensors";

const POSITION: &str = "lapwing.training";
const ORIGIN: &str = "lapwing.origin";

/// Writes tensors, position and origin; a file of that name is replaced once the new one is whole.
pub(super) fn save(
    path: &Path,
    position: &Position,
    origin: &Origin,
    tensors: &[(String, &Tensor)],
) -> Result<(), TrainError> {
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
    let json = |value: serde_json::Result<String>| value.map_err(|why| wrong(why.to_string()));
    let metadata = HashMap::from([
        (POSITION.to_owned(), json(serde_json::to_string(position))?),
        (ORIGIN.to_owned(), json(serde_json::to_string(origin))?),
    ]);
    let whole = safetensors::serialize(views, Some(metadata)).map_err(|why| wrong(why.to_string()))?;
    files::write(path, &whole).map_err(TrainError::io("write the training's state", path))
}

/// A resume state as read.
#[derive(Debug)]
pub(super) struct Stored {
    path: PathBuf,
    bytes: Vec<u8>,
    /// Where the training was.
    pub position: Position,
    /// The origin; missing in files from before it was stored.
    pub origin: Option<Origin>,
}

impl Stored {
    pub fn open(path: &Path) -> Result<Self, TrainError> {
        let bytes = fs::read(path).map_err(TrainError::io("read the training's state", path))?;
        let wrong = |why: String| TrainError::State { path: path.to_owned(), why };
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|why| wrong(why.to_string()))?;
        let text = |key: &str| header.metadata().as_ref().and_then(|m| m.get(key));
        let position = text(POSITION).ok_or_else(|| wrong(format!("expected the key {POSITION}, got none")))?;
        let position = serde_json::from_str(position).map_err(|why| wrong(format!("{POSITION}: {why}")))?;
        let origin = text(ORIGIN).map(|origin| serde_json::from_str(origin)).transpose();
        let origin = origin.map_err(|why| wrong(format!("{ORIGIN}: {why}")))?;
        Ok(Self { path: path.to_owned(), bytes, position, origin })
    }

    /// Copies the tensors into those of the same names.
    pub fn copy_to(&self, tensors: &[(String, &Tensor)]) -> Result<(), TrainError> {
        let wrong = |why: String| TrainError::State { path: self.path.clone(), why };
        let file = SafeTensors::deserialize(&self.bytes).map_err(|why| wrong(why.to_string()))?;
        for (name, tensor) in tensors {
            let view = file.tensor(name).map_err(|_| wrong(format!("expected the tensor {name}, got none")))?;
            let shape: Vec<i64> = view.shape().iter().map(|n| *n as i64).collect();
            if shape != tensor.size() || view.dtype() != Dtype::F32 {
                return Err(wrong(format!("tensor {name}: expected {:?}, got {shape:?}", tensor.size())));
            }
            let stored = Tensor::f_from_data_size(view.data(), &shape, Kind::Float)?;
            no_grad(|| tensor.shallow_clone().f_copy_(&stored))?;
        }
        Ok(())
    }
}

/// The epoch whose weights a checkpoint holds, as [`Metadata::result`](crate::nn::Metadata) says; none if training was
/// stopped before the first was complete.
pub(super) fn epoch_of(model: &[u8]) -> Option<Epoch> {
    let (_, header) = SafeTensors::read_metadata(model).ok()?;
    serde_json::from_str(header.metadata().as_ref()?.get("result")?).ok()?
}
