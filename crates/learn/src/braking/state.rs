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

/// The position of a training, after a whole epoch.
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
}

/// The file beside a network that is being trained.
pub(super) fn path_of(network: &Path) -> PathBuf {
    network.with_extension("state.safetensors")
}

/// Writes a position and the tensors; a file of that name is replaced once the new one is whole.
pub(super) fn save(path: &Path, position: &Position, tensors: Vec<(String, Tensor)>) -> Result<(), BrakingTrainError> {
    let text = serde_json::to_string(position).expect("a position is valid JSON");
    let bytes = encode_tensors(BTreeMap::from([(POSITION, &*text)]), tensors, Precision::F32)?;
    files::write(path, &bytes).map_err(|source| NnError::Write { path: path.to_owned(), source }.into())
}

/// Reads a position, and the tensors into those of the same names.
pub(super) fn load(path: &Path, tensors: &[(String, Tensor)]) -> Result<Position, BrakingTrainError> {
    let wrong = |why: String| BrakingTrainError::State { path: path.to_owned(), why };
    let bytes = fs::read(path).map_err(|why| wrong(why.to_string()))?;
    let file = SafeTensors::deserialize(&bytes).map_err(|why| wrong(why.to_string()))?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|why| wrong(why.to_string()))?;
    let text = header.metadata().as_ref().and_then(|metadata| metadata.get(POSITION));
    let position = json(POSITION, text.ok_or_else(|| wrong(format!("expected the key {POSITION}, got none")))?)?;
    for (name, tensor) in tensors {
        let view = file.tensor(name).map_err(|_| wrong(format!("expected the tensor {name}, got none")))?;
        let stored = tensor_of(&view, name, &tensor.size())?;
        no_grad(|| tensor.shallow_clone().f_copy_(&stored))?;
    }
    Ok(position)
}
