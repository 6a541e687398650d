//! A network made elsewhere: a TorchScript module, and a TOML file beside it with what the module itself does not
//! contain.
//!
//! `model.pt` is what `torch.jit.trace` or `torch.jit.script` made and `torch.jit.save` wrote; it takes (1, C, H, W) f32 and
//! answers a tensor of as many numbers as there are outputs, the steering first. `model.toml` is a
//! [`SideFile`](super::SideFile). A TorchScript file contains code. Load only files that you trust.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use tch::{CModule, Device, TchError, Tensor};

use super::{ModelError, elsewhere::Forward};
use crate::nn::{NnError, torch_words};

/// A module, and the file that it was loaded from.
#[derive(Debug)]
pub(super) struct Script {
    module: CModule,
    path: PathBuf,
    bytes: Arc<[u8]>,
}

impl Script {
    /// Loads a module of `bytes`, those of the file `path`, and puts it in evaluation mode.
    ///
    /// # Errors
    /// [`ModelError::NotTorchScript`].
    pub fn load(path: &Path, bytes: Arc<[u8]>) -> Result<Self, ModelError> {
        let mut module = CModule::load_data_on_device(&mut &*bytes, Device::Cpu)
            .map_err(|e| ModelError::NotTorchScript { path: path.to_owned(), why: torch_words(&e) })?;
        module.f_set_eval().map_err(NnError::from)?;
        Ok(Self { module, path: path.to_owned(), bytes })
    }
}

impl Forward for Script {
    fn forward(&self, input: &Tensor) -> Result<Tensor, NnError> {
        self.module.forward_ts(&[input]).map_err(|error| script_error(&error, input))
    }

    fn afresh(self: Arc<Self>) -> Result<Arc<dyn Forward>, ModelError> {
        Ok(Arc::new(Self::load(&self.path, self.bytes.clone())?))
    }
}

/// What went wrong in a module's own code. The interpreter says so first, then where in the code, and last what.
fn script_error(error: &TchError, input: &Tensor) -> NnError {
    let TchError::Torch(text) = error else { return NnError::Torch(torch_words(error)) };
    let is_reason = |line: &&str| line.split_once(": ").is_some_and(|(kind, _)| kind.ends_with("Error"));
    // Below it may stand C++'s own calls.
    match text.lines().map(str::trim).rfind(is_reason) {
        Some(reason) => {
            NnError::Torch(format!("{reason} (it was given {:?} f32, as the .toml beside it says)", input.size()))
        }
        None => NnError::Torch(torch_words(error)),
    }
}

#[cfg(test)]
mod tests;
