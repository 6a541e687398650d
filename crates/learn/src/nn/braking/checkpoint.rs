//! A braking network's checkpoint: one self-describing `.safetensors` file.
//!
//! The header's metadata, all text, has the keys of a driving network's [`Checkpoint`](crate::nn::Checkpoint) but for
//! `inputs` and `outputs`, and one more:
//!
//! | key | holds |
//! |---|---|
//! | `format` | `lapwing/1` |
//! | `architecture` | `brake-stacked` or `brake-live` |
//! | `preprocess` | JSON of [`Preprocess`] |
//! | `limits` | JSON, `{"fires":0.5,"releases":0.25}`: between which values a guard brakes and rests |
//! | `training` | how it was trained and on what: text or JSON, for people |
//! | `result` | how good it is, by which measure: text or JSON, for people |

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use safetensors::SafeTensors;

use super::{BrakingArchitecture, BrakingNetwork};
use crate::nn::{
    FORMAT, NnError, Precision,
    checkpoint::{encode_tensors, json, read_tensor},
};
use lapwing_core::{control::BrakeLimits, files, hash::sha256, perception::Preprocess, words::did_you_mean};

/// What a file says about its network.
#[derive(Debug, Clone, PartialEq)]
pub struct BrakingMetadata {
    /// What was done to the pictures that it was trained on.
    pub preprocess: Preprocess,
    /// Between which values a guard brakes and rests.
    pub limits: BrakeLimits,
    /// How it was trained and on what, for people.
    pub training: String,
    /// How good it is, for people.
    pub result: String,
}

/// A braking network as it was read.
#[derive(Debug)]
pub struct BrakingCheckpoint {
    /// What the file says about it.
    pub metadata: BrakingMetadata,
    /// The network, on the CPU, laid out for inference.
    pub network: BrakingNetwork,
    /// SHA-256 of the file in lower-case hexadecimal.
    pub sha256: String,
}

/// Why a braking network's file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BrakingError {
    /// The file cannot be read.
    #[error("{path} cannot be read: {source}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// What is in it.
    #[error("{path}: {source}", path = path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: NnError,
    },
    /// Another network.
    #[error(
        "{path}: expected a network that brakes ({known}), got {got:?}{meant}",
        path = path.display(),
        known = BrakingArchitecture::ALL.map(BrakingArchitecture::name).join(", "),
        meant = did_you_mean(got, BrakingArchitecture::ALL.map(BrakingArchitecture::name))
    )]
    Architecture {
        /// The file.
        path: PathBuf,
        /// What the file names.
        got: String,
    },
    /// Limits between which nothing lies.
    #[error(
        "{path}: expected limits above 0, the lower one first, got {} to {}",
        limits.releases, limits.fires, path = path.display()
    )]
    Limits {
        /// The file.
        path: PathBuf,
        /// What they are.
        limits: BrakeLimits,
    },
}

impl BrakingCheckpoint {
    /// Reads a file.
    ///
    /// # Errors
    /// [`BrakingError`].
    pub fn load(path: &Path) -> Result<Self, BrakingError> {
        let mut read = Self::read(path)?;
        read.network.fold().map_err(|source| BrakingError::Content { path: path.to_owned(), source })?;
        Ok(read)
    }

    /// Reads a file whose network is to learn more: its layers are those of the file.
    ///
    /// # Errors
    /// [`BrakingError`].
    pub(crate) fn read(path: &Path) -> Result<Self, BrakingError> {
        let bytes = fs::read(path).map_err(|source| BrakingError::Read { path: path.to_owned(), source })?;
        let content = |source| BrakingError::Content { path: path.to_owned(), source };
        let safe = |source| content(NnError::NotSafetensors(source));
        let file = SafeTensors::deserialize(&bytes).map_err(safe)?;
        let (_, table) = SafeTensors::read_metadata(&bytes).map_err(safe)?;
        let get = |key: &'static str| {
            let value = table.metadata().as_ref().and_then(|m| m.get(key)).map(String::as_str);
            value.ok_or(content(NnError::MissingKey(key)))
        };
        let format = get("format")?;
        if format != FORMAT {
            return Err(content(NnError::Format(format.to_owned())));
        }
        let name = get("architecture")?;
        let architecture = BrakingArchitecture::named(name)
            .ok_or_else(|| BrakingError::Architecture { path: path.to_owned(), got: name.to_owned() })?;
        let metadata = BrakingMetadata {
            preprocess: json("preprocess", get("preprocess")?).map_err(content)?,
            limits: json("limits", get("limits")?).map_err(content)?,
            training: get("training")?.to_owned(),
            result: get("result")?.to_owned(),
        };
        if metadata.preprocess != architecture.preprocess() {
            return Err(content(NnError::OtherPreprocess));
        }
        let limits = metadata.limits;
        if !(0.0 < limits.releases && limits.releases <= limits.fires && limits.fires.is_finite()) {
            return Err(BrakingError::Limits { path: path.to_owned(), limits });
        }
        let build = |name: &str, shape: &[i64]| read_tensor(&file, name, shape);
        let network = BrakingNetwork::build(architecture, &mut |name, shape, _| build(name, shape)).map_err(content)?;
        Ok(Self { metadata, network, sha256: sha256(&bytes) })
    }
}

/// Writes a checkpoint and returns its SHA-256. A file of that name is replaced once the new one is whole.
///
/// # Errors
/// [`NnError::Write`], and libtorch's.
pub fn save_braking(
    path: &Path,
    metadata: &BrakingMetadata,
    network: &BrakingNetwork,
    precision: Precision,
) -> Result<String, NnError> {
    let preprocess = serde_json::to_string(&metadata.preprocess).expect("preprocessing is valid JSON");
    let limits = serde_json::to_string(&metadata.limits).expect("two numbers are valid JSON");
    let header = BTreeMap::from([
        ("format", FORMAT),
        ("architecture", network.architecture().name()),
        ("preprocess", &preprocess),
        ("limits", &limits),
        ("training", &metadata.training),
        ("result", &metadata.result),
    ]);
    let bytes = encode_tensors(header, network.tensors(), precision)?;
    files::write(path, &bytes).map_err(|source| NnError::Write { path: path.to_owned(), source })?;
    Ok(sha256(&bytes))
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind, Tensor, nn::VarStore};

    use super::*;
    use crate::nn::in_variable_store;

    fn saved(limits: BrakeLimits) -> (tempfile::TempDir, PathBuf, BrakingNetwork, VarStore) {
        saved_with(BrakingArchitecture::Live.preprocess(), limits)
    }

    fn saved_with(
        preprocess: Preprocess,
        limits: BrakeLimits,
    ) -> (tempfile::TempDir, PathBuf, BrakingNetwork, VarStore) {
        tch::manual_seed(5);
        let store = VarStore::new(Device::Cpu);
        let architecture = BrakingArchitecture::Live;
        let network = BrakingNetwork::build(architecture, &mut in_variable_store(store.root())).unwrap();
        let metadata = BrakingMetadata { preprocess, limits, training: "not at all".into(), result: "none".into() };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("brake.safetensors");
        save_braking(&path, &metadata, &network, Precision::F32).unwrap();
        (dir, path, network, store)
    }

    #[test]
    fn a_network_read_from_its_file_answers_as_the_one_that_was_saved() {
        let limits = BrakeLimits { fires: 0.5, releases: 0.25 };
        let (_dir, path, network, _store) = saved(limits);
        let read = BrakingCheckpoint::load(&path).unwrap();
        assert_eq!((read.metadata.limits, read.metadata.training.as_str()), (limits, "not at all"));
        let float = (Kind::Float, Device::Cpu);
        let (frames, speeds) = (Tensor::rand([2, 20, 80, 320], float) * 255.0, Tensor::rand([2, 20], float) * 40.0);
        let answer = |network: &BrakingNetwork| {
            Vec::<f64>::try_from(
                &network.forward(&frames, &speeds, false).unwrap().due.view([-1]).to_kind(Kind::Double),
            )
            .unwrap()
        };
        // Batch norm is folded into the convolutions of what is read.
        for (a, b) in answer(&network).iter().zip(answer(&read.network)) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }

    #[test]
    fn a_file_of_a_release_that_prepared_frames_otherwise_is_refused_with_what_to_do() {
        let earlier = BrakingArchitecture::Stacked.preprocess();
        assert_ne!(earlier, BrakingArchitecture::Live.preprocess());
        let (_dir, path, ..) = saved_with(earlier, BrakeLimits { fires: 0.5, releases: 0.25 });
        let error = BrakingCheckpoint::load(&path).unwrap_err().to_string();
        assert!(
            error.contains("use the release that wrote the file, or train the network anew by its recipe"),
            "{error}"
        );
    }

    #[test]
    fn a_file_of_another_network_or_with_impossible_limits_is_refused() {
        let (_dir, path, ..) = saved(BrakeLimits { fires: 0.2, releases: 0.5 });
        assert!(matches!(BrakingCheckpoint::load(&path), Err(BrakingError::Limits { .. })));
        let pilot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/pilotnet.safetensors");
        let error = BrakingCheckpoint::load(&pilot).unwrap_err().to_string();
        assert!(
            error.ends_with("expected a network that brakes (brake-stacked, brake-live), got \"pilotnet\""),
            "{error}"
        );
        let missing = BrakingCheckpoint::load(Path::new("/nowhere/brake.safetensors")).unwrap_err().to_string();
        assert!(missing.starts_with("/nowhere/brake.safetensors cannot be read"), "{missing}");
    }
}
