//! A network made elsewhere: a TorchScript module, and a TOML file beside it with what the module itself does not
//! contain.
//!
//! `model.pt` is what `torch.jit.trace` or `torch.jit.script` made and
//! `torch.jit.save` wrote; it takes (1, C, H, W) f32 and answers a tensor of as
//! many numbers as there are outputs, the steering first. `model.toml` is a [`SideFile`].
//! A TorchScript file contains code. Load only files that you trust.

use std::{path::Path, sync::Arc};

use tch::{CModule, Device};

use super::{ModelError, SideFile, network::Eye};
use crate::nn::{NnError, torch_words};
use lapwing_core::{
    perception::Preprocess,
    pilot::{Pilot, PilotError, Prediction, View},
    units::Clock,
};

/// Steers by the first output of a TorchScript module, on the CPU.
#[derive(Debug)]
pub struct TorchScriptPilot {
    eye: Eye,
    module: Arc<CModule>,
}

impl TorchScriptPilot {
    /// Loads a module of `bytes`, those of the file `path`, with the `.toml` of
    /// the same stem beside it, puts it in evaluation mode and warms it up.
    ///
    /// # Errors
    /// [`ModelError::NoSideFile`], [`ModelError::SideFile`], [`ModelError::NotTorchScript`], [`ModelError::Unfit`].
    pub fn load(path: &Path, bytes: &[u8], clock: Clock) -> Result<Self, ModelError> {
        let SideFile { outputs, preprocess } = SideFile::beside(path)?;
        let unfit = |source: ModelError| ModelError::Unfit { path: path.to_owned(), source: Box::new(source) };
        let mut eye = Eye::new(preprocess, &outputs, clock).map_err(unfit)?;

        let mut module = CModule::load_data_on_device(&mut &*bytes, Device::Cpu)
            .map_err(|e| ModelError::NotTorchScript { path: path.to_owned(), why: torch_words(&e) })?;
        module.f_set_eval().map_err(NnError::from)?;
        eye.warm_up(|input| Ok(module.forward_ts(&[input])?)).map_err(|error| unfit(error.into()))?;
        Ok(Self { eye, module: Arc::new(module) })
    }

    /// What is done to a frame.
    pub fn preprocess(&self) -> &Preprocess {
        self.eye.preprocess()
    }

    /// What each number of an answer is.
    pub fn outputs(&self) -> &[String] {
        self.eye.outputs()
    }

    /// Another pilot with the same weights. Frames do not share state, unless the module itself keeps some.
    pub fn share(&self) -> Self {
        Self { eye: self.eye.clone(), module: Arc::clone(&self.module) }
    }
}

impl Pilot for TorchScriptPilot {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        self.eye.steer(view.frame, |input| Ok(self.module.forward_ts(&[input])?))
    }

    fn reset(&mut self) {}
}

#[cfg(test)]
mod tests;
