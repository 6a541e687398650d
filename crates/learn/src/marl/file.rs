//! Tensors and text in one `.safetensors` file.

use std::{
    collections::HashMap,
    fmt::Display,
    fs,
    path::{Path, PathBuf},
};

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::de::DeserializeOwned;
use tch::{Tensor, no_grad};

use super::MarlError;
use crate::nn::{NnError, tensor_of};
use lapwing_core::files;

/// The bytes of a file with these tensors, as f32, and this text.
pub(super) fn encode(
    path: &Path,
    text: HashMap<String, String>,
    tensors: &[(String, Tensor)],
) -> Result<Vec<u8>, MarlError> {
    let mut bytes = Vec::with_capacity(tensors.len());
    for (name, tensor) in tensors {
        let mut values = vec![0_f32; tensor.numel()];
        tensor.f_detach()?.f_contiguous()?.f_copy_data(&mut values, tensor.numel())?;
        let shape: Vec<usize> = tensor.size().into_iter().map(|n| n as usize).collect();
        bytes.push((name, shape, values.into_iter().flat_map(f32::to_le_bytes).collect::<Vec<u8>>()));
    }
    let wrong = |why: safetensors::SafeTensorError| MarlError::File { path: path.to_owned(), why: why.to_string() };
    let views = bytes
        .iter()
        .map(|(name, shape, data)| Ok((*name, TensorView::new(Dtype::F32, shape.clone(), data)?)))
        .collect::<Result<Vec<_>, _>>()
        .map_err(wrong)?;
    safetensors::serialize(views, Some(text)).map_err(wrong)
}

/// Writes such a file, whole or not at all.
pub(super) fn save(path: &Path, text: HashMap<String, String>, tensors: &[(String, Tensor)]) -> Result<(), MarlError> {
    files::write(path, &encode(path, text, tensors)?).map_err(MarlError::io("write", path))
}

/// Such a file as read.
pub(super) struct Read {
    path: PathBuf,
    /// What it should be, for messages.
    what: &'static str,
    bytes: Vec<u8>,
    text: HashMap<String, String>,
}

impl Read {
    /// Reads a file; `what` it should be is told where it is something else.
    pub fn open(path: &Path, what: &'static str) -> Result<Self, MarlError> {
        let bytes = fs::read(path).map_err(MarlError::io("read", path))?;
        let mut read = Self { path: path.to_owned(), what, bytes, text: HashMap::new() };
        let header = SafeTensors::read_metadata(&read.bytes).map_err(NnError::NotSafetensors);
        let (_, header) = header.map_err(|why| read.wrong(why))?;
        read.text = header.metadata().clone().unwrap_or_default();
        Ok(read)
    }

    /// The error that says why it is not what it should be.
    pub fn wrong(&self, why: impl Display) -> MarlError {
        MarlError::File {
            path: self.path.clone(),
            why: format!("expected {}, but could not read it as one: {why}", self.what),
        }
    }

    /// The JSON under a key.
    pub fn json<T: DeserializeOwned>(&self, key: &str) -> Result<T, MarlError> {
        let none = || self.wrong(format_args!("expected the key {key}, got none"));
        let text = self.text.get(key).ok_or_else(none)?;
        serde_json::from_str(text).map_err(|why| self.wrong(format_args!("{key}: {why}")))
    }

    /// Copies the tensors of the file into those of the same names.
    pub fn copy_to(&self, tensors: &[(String, Tensor)]) -> Result<(), MarlError> {
        let file = SafeTensors::deserialize(&self.bytes).map_err(NnError::NotSafetensors);
        let file = file.map_err(|why| self.wrong(why))?;
        for (name, tensor) in tensors {
            let none = |_| self.wrong(format_args!("expected the tensor {name}, got none"));
            let view = file.tensor(name).map_err(none)?;
            let stored = tensor_of(&view, name, &tensor.size()).map_err(|why| self.wrong(why))?;
            no_grad(|| tensor.shallow_clone().f_copy_(&stored))?;
        }
        Ok(())
    }
}
