//! Where a training is: all that it needs to go on as if it had not been interrupted, in one file.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};
use tch::{Tensor, no_grad};

use super::{BrakingRecipe, BrakingTrainError, Epoch};
use crate::nn::{
    NnError, Precision,
    checkpoint::{encode_tensors, json, tensor_of},
};
use lapwing_core::files;

/// The key of the position in the file's metadata.
const POSITION: &str = "lapwing.braking";

/// The position of a training, after a whole epoch or before the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Position {
    /// By which recipe.
    pub recipe: BrakingRecipe,
    /// The epochs that are done.
    pub epochs: Vec<Epoch>,
    /// Steps taken.
    pub steps: i64,
    /// The learning rate of a plateau schedule.
    pub rate: f64,
    /// Epochs since the best one.
    pub since_best: usize,
    /// SHA-256 of the rows of the episodes' table that are not held out; none in a state of an earlier
    /// version, which did not store it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub episodes_read: Option<String>,
}

/// The file beside a network that is being trained.
pub(super) fn path_of(network: &Path) -> PathBuf {
    network.with_extension("state.safetensors")
}

/// A position and the tensors, as a file holds them.
pub(super) fn encode(position: &Position, tensors: Vec<(String, Tensor)>) -> Result<Vec<u8>, BrakingTrainError> {
    let text = serde_json::to_string(position).expect("a position is valid JSON");
    Ok(encode_tensors(BTreeMap::from([(POSITION, &*text)]), tensors, Precision::F32)?)
}

/// Writes what was [encoded](encode); a file of that name is replaced once the new one is whole.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), BrakingTrainError> {
    files::write(path, bytes).map_err(|source| NnError::Write { path: path.to_owned(), source }.into())
}

/// A state that was read.
pub(super) struct Stored {
    path: PathBuf,
    bytes: Vec<u8>,
    pub position: Position,
}

impl Stored {
    pub(super) fn read(path: &Path) -> Result<Self, BrakingTrainError> {
        let path = path.to_owned();
        let bytes = fs::read(&path).map_err(|why| wrong(&path, why.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|why| wrong(&path, why.to_string()))?;
        let text = header.metadata().as_ref().and_then(|metadata| metadata.get(POSITION));
        let text = text.ok_or_else(|| wrong(&path, format!("expected the key {POSITION}, got none")))?;
        let position = json(POSITION, text)?;
        Ok(Self { path, bytes, position })
    }

    fn tensors(&self) -> Result<SafeTensors<'_>, BrakingTrainError> {
        SafeTensors::deserialize(&self.bytes).map_err(|why| wrong(&self.path, why.to_string()))
    }

    /// The size of a tensor; none if it has none of that name.
    pub(super) fn shape(&self, name: &str) -> Result<Option<Vec<usize>>, BrakingTrainError> {
        Ok(self.tensors()?.tensor(name).ok().map(|view| view.shape().to_vec()))
    }

    /// Copies its tensors into those of the same names.
    pub(super) fn copy_to(&self, tensors: &[(String, Tensor)]) -> Result<(), BrakingTrainError> {
        let file = self.tensors()?;
        for (name, tensor) in tensors {
            let missing = |_| wrong(&self.path, format!("expected the tensor {name}, got none"));
            let stored = tensor_of(&file.tensor(name).map_err(missing)?, name, &tensor.size())?;
            no_grad(|| tensor.shallow_clone().f_copy_(&stored))?;
        }
        Ok(())
    }
}

fn wrong(path: &Path, why: String) -> BrakingTrainError {
    BrakingTrainError::State { path: path.to_owned(), why }
}
