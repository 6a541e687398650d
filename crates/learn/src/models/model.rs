//! A model is read once from its file; its pilots share it.

use std::{
    fs, io,
    path::Path,
    sync::{Arc, Mutex, PoisonError},
};

use safetensors::SafeTensors;

#[cfg(feature = "onnx")]
use super::onnx;
use super::{ModelError, elsewhere::ForeignPilot, foreign, network::NetworkPilot, torchscript::Script};
use crate::nn::{Architecture, Checkpoint, Network, NnError, braking::BrakingArchitecture};
use lapwing_core::{
    files,
    hash::sha256,
    perception::Preprocess,
    pilot::{self, Pilot},
    units::Clock,
};
use lapwing_sim::ahead::Ahead;

/// A network in memory, whose weights any number of pilots share. Several threads may use it.
#[derive(Debug)]
pub struct LoadedModel {
    name: String,
    sha256: String,
    preprocess: Preprocess,
    outputs: Vec<String>,
    training: Option<String>,
    threads: Option<u16>,
    clock: Clock,
    /// The pilot from which all others are made. It does not drive; it is behind a lock because a tensor's handle
    /// belongs to one thread at a time.
    prototype: Mutex<Prototype>,
}

#[derive(Debug)]
enum Prototype {
    Network(Box<NetworkPilot>),
    Foreign(Box<ForeignPilot>),
}

/// The model that drives if none is named.
const BUILT_IN: &[u8] = include_bytes!("../../../../models/pilotnet.safetensors");

/// The model built into the program: `models/pilotnet.safetensors`.
///
/// # Errors
/// [`ModelError`], if libtorch itself fails.
pub fn built_in(clock: Clock) -> Result<LoadedModel, ModelError> {
    LoadedModel::of_checkpoint(Path::new("built in"), BUILT_IN, clock)
}

/// Whether [`load`] takes this file for TorchScript, and runs the code in it.
pub fn is_torchscript(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "pt")
}

/// Whether the network was made elsewhere, so that a `.toml` beside it says how its frames are prepared.
pub fn is_foreign(path: &Path) -> bool {
    is_torchscript(path) || path.extension().is_some_and(|extension| extension == "onnx")
}

/// Reads a model: a checkpoint of this project (`.safetensors`, see
/// [`Checkpoint`]), a TorchScript module (`.pt`, see [`torchscript`](super::torchscript)) or, with the feature `onnx`, an ONNX
/// model (`.onnx`, see `onnx`).
///
/// The network answers a few times before this returns, so the first frame is as fast as any, and a network that does
/// not answer correctly is refused. Its pilots measure themselves with `clock`.
///
/// A TorchScript module is code, which runs here and now: load only what the
/// user named or trusts.
///
/// # Errors
/// [`ModelError`], naming the file.
pub fn load(path: impl AsRef<Path>, clock: Clock) -> Result<LoadedModel, ModelError> {
    let path = path.as_ref();
    let read = || {
        match files::is_special(path) {
            true => Err(io::Error::other("expected a file, got a device or a pipe")),
            false => fs::read(path),
        }
        .map_err(|source| ModelError::Read { path: path.to_owned(), source })
    };
    match path.extension().and_then(|e| e.to_str()) {
        Some("safetensors") => LoadedModel::of_checkpoint(path, &read()?, clock),
        Some(_) if is_torchscript(path) => {
            let bytes: Arc<[u8]> = read()?.into();
            // Before the file beside it: a state dict's users would write that for nothing.
            let script = Script::load(path, bytes.clone())?;
            let pilot = ForeignPilot::load(path, clock, |_| Ok(script))?;
            Ok(LoadedModel::of_foreign("torchscript", path, &bytes, pilot, (None, clock)))
        }
        #[cfg(feature = "onnx")]
        Some("onnx") => {
            let bytes = read()?;
            let pilot = ForeignPilot::load(path, clock, |shape| onnx::load(path, &bytes, shape))?;
            Ok(LoadedModel::of_foreign("onnx", path, &bytes, pilot, (Some(1), clock)))
        }
        _ => Err(match foreign::advice(path) {
            Some((kind, todo)) => ModelError::Foreign { path: path.to_owned(), kind, todo },
            None => ModelError::Extension(path.to_owned()),
        }),
    }
}

/// For a file of this project that does not steer: what it is, by its metadata. `None` for all others.
fn other_kind(bytes: &[u8]) -> Option<&'static str> {
    let (_, table) = SafeTensors::read_metadata(bytes).ok()?;
    let text = table.metadata().as_ref()?;
    let has = |key: &str| text.contains_key(key);
    let architecture = text.get("architecture").map_or("", String::as_str);
    match () {
        () if has("lapwing.policy") => Some("a policy for agents at an intersection, for lapwing marl"),
        () if has("lapwing.training") || has("lapwing.braking") => {
            Some("the resume state of a training run, whose network lies beside it")
        }
        () if BrakingArchitecture::named(architecture).is_some() => Some("a network that brakes, for --brake-model"),
        () if Architecture::named(architecture).is_some_and(Architecture::locates) => {
            Some("a network that finds the lane, for lapwing locate --network")
        }
        () => None,
    }
}

impl LoadedModel {
    fn of_checkpoint(path: &Path, bytes: &[u8], clock: Clock) -> Result<Self, ModelError> {
        if let Some(what) = other_kind(bytes) {
            return Err(ModelError::OtherKind { path: path.to_owned(), what });
        }
        let checkpoint = Checkpoint::from_bytes(bytes).map_err(|source| match source {
            NnError::MissingKey("format") => ModelError::TensorsAlone { path: path.to_owned() },
            source => ModelError::Checkpoint { path: path.to_owned(), source },
        })?;
        let unfit = |source| ModelError::Unfit { path: path.to_owned(), source: Box::new(source) };
        Ok(Self {
            name: format!("{} ({})", checkpoint.network.architecture().name(), path.display()),
            sha256: checkpoint.sha256.clone(),
            preprocess: checkpoint.metadata.preprocess.clone(),
            outputs: checkpoint.metadata.outputs.clone(),
            training: Some(checkpoint.metadata.training.clone()),
            threads: checkpoint.network.architecture().threads(),
            clock,
            prototype: Mutex::new(Prototype::Network(Box::new(NetworkPilot::new(checkpoint, clock).map_err(unfit)?))),
        })
    }

    fn of_foreign(
        kind: &str,
        path: &Path,
        bytes: &[u8],
        pilot: ForeignPilot,
        (threads, clock): (Option<u16>, Clock),
    ) -> Self {
        Self {
            name: format!("{kind} ({})", path.display()),
            sha256: sha256(bytes),
            preprocess: pilot.preprocess().clone(),
            outputs: pilot.outputs().to_vec(),
            training: None,
            threads,
            clock,
            prototype: Mutex::new(Prototype::Foreign(Box::new(pilot))),
        }
    }

    /// The best number of threads for one forward pass; `None` for as many as there are processors.
    pub fn threads(&self) -> Option<u16> {
        self.threads
    }

    /// What is done to a frame before the network sees it.
    pub fn preprocess(&self) -> &Preprocess {
        &self.preprocess
    }

    /// What each number of an answer is, the steering first.
    pub fn outputs(&self) -> &[String] {
        &self.outputs
    }

    /// How it was trained and on what, as its author describes it; a TorchScript module does not say.
    pub fn training(&self) -> Option<&str> {
        self.training.as_deref()
    }

    /// Its network, with the same weights, if it is one of this project's architectures.
    pub fn network(&self) -> Option<Network> {
        match &*self.prototype.lock().unwrap_or_else(PoisonError::into_inner) {
            Prototype::Network(pilot) => Some(pilot.network()),
            Prototype::Foreign(_) => None,
        }
    }

    /// Architecture and file, for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// SHA-256 of the file in lower-case hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// A new pilot for one car, which allows for commands that take effect late.
    pub fn pilot(&self) -> Box<dyn Pilot> {
        let pilot: Box<dyn Pilot> = match &*self.prototype.lock().unwrap_or_else(PoisonError::into_inner) {
            Prototype::Network(pilot) => Box::new(pilot.share()),
            Prototype::Foreign(pilot) => pilot.clone(),
        };
        Box::new(Ahead::of(pilot, self.clock))
    }
}

impl pilot::Model for LoadedModel {
    fn name(&self) -> &str {
        self.name()
    }

    fn sha256(&self) -> &str {
        self.sha256()
    }

    fn pilot(&self) -> Box<dyn Pilot> {
        self.pilot()
    }
}

#[cfg(test)]
mod tests;
