//! A network made elsewhere: a TorchScript module, and a TOML file beside it with what the module itself does not
//! contain.
//!
//! `model.pt` is what `torch.jit.trace` or `torch.jit.script` made and `torch.jit.save` wrote; it takes (1, C, H, W) f32 and
//! answers a tensor of as many numbers as there are outputs, the steering first. `model.toml` is a
//! [`SideFile`](super::SideFile). A TorchScript file contains code. Load only files that you trust.

use std::path::Path;

use tch::{CModule, Device, Tensor};

use super::{ModelError, elsewhere::Forward};
use crate::nn::{NnError, torch_words};

/// Loads a module of `bytes`, those of the file `path`, and puts it in evaluation mode.
///
/// # Errors
/// [`ModelError::NotTorchScript`].
pub(super) fn load(path: &Path, bytes: &[u8]) -> Result<CModule, ModelError> {
    let mut module = CModule::load_data_on_device(&mut &*bytes, Device::Cpu)
        .map_err(|e| ModelError::NotTorchScript { path: path.to_owned(), why: torch_words(&e) })?;
    module.f_set_eval().map_err(NnError::from)?;
    Ok(module)
}

impl Forward for CModule {
    fn forward(&self, input: &Tensor) -> Result<Tensor, NnError> {
        Ok(self.forward_ts(&[input])?)
    }
}

#[cfg(test)]
mod tests;
