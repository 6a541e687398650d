//! A file read once, and the pilots that drive by it.

use std::{
    fs,
    path::Path,
    sync::{Mutex, PoisonError},
};

use super::{Pilot, PilotError, network::NetworkPilot, torchscript::TorchScriptPilot};
use crate::{
    nn::{Checkpoint, sha256_hex},
    perception::Preprocess,
    units::Clock,
};

/// A network in memory, of which any number of pilots share the weights. May be used by several threads.
#[derive(Debug)]
pub struct Model {
    sha256: String,
    architecture: &'static str,
    preprocess: Preprocess,
    /// The pilot that all others are shared from. It drives nobody; behind a lock because a tensor's handle belongs
    /// to one thread at a time.
    prototype: Mutex<Prototype>,
}

#[derive(Debug)]
enum Prototype {
    Network(NetworkPilot),
    TorchScript(TorchScriptPilot),
}

/// Reads a model: a checkpoint of this project (`.safetensors`, see
/// [`Checkpoint`]) or a TorchScript module (`.pt`, see [`torchscript`](super::torchscript)).
///
/// The network answers a few times before this returns: the first frame is as
/// fast as any. `clock` is what its pilots measure themselves by.
///
/// # Errors
/// [`PilotError`], naming the file.
pub fn load(path: impl AsRef<Path>, clock: Clock) -> Result<Model, PilotError> {
    let path = path.as_ref();
    let kind = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    if !matches!(kind, "safetensors" | "pt") {
        return Err(PilotError::Extension(path.to_owned()));
    }
    let bytes = fs::read(path).map_err(|source| PilotError::Read { path: path.to_owned(), source })?;
    if kind == "pt" {
        let pilot = TorchScriptPilot::load(path, &bytes, clock)?;
        return Ok(Model {
            sha256: sha256_hex(&bytes),
            architecture: "torchscript",
            preprocess: pilot.preprocess().clone(),
            prototype: Mutex::new(Prototype::TorchScript(pilot)),
        });
    }
    let checkpoint =
        Checkpoint::from_bytes(&bytes).map_err(|source| PilotError::Checkpoint { path: path.to_owned(), source })?;
    Ok(Model {
        sha256: checkpoint.sha256.clone(),
        architecture: checkpoint.network.architecture().name(),
        preprocess: checkpoint.metadata.preprocess.clone(),
        prototype: Mutex::new(Prototype::Network(NetworkPilot::new(checkpoint, clock)?)),
    })
}

impl Model {
    /// SHA-256 of the file in lower-case hexadecimal; a run names its model by it.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// The architecture's name in a checkpoint, or `torchscript`.
    pub fn architecture(&self) -> &str {
        self.architecture
    }

    /// What is done to a frame before the network sees it.
    pub fn preprocess(&self) -> &Preprocess {
        &self.preprocess
    }

    /// A pilot of its own for one car.
    pub fn pilot(&self) -> Box<dyn Pilot> {
        match &*self.prototype.lock().unwrap_or_else(PoisonError::into_inner) {
            Prototype::Network(pilot) => Box::new(pilot.share()),
            Prototype::TorchScript(pilot) => Box::new(pilot.share()),
        }
    }
}

#[cfg(test)]
mod tests;
