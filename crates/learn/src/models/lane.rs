//! Networks that say where in its lane a camera is.

use std::{
    fs,
    path::Path,
    sync::{Mutex, PoisonError},
};

use tch::Tensor;

use super::ModelError;
use crate::nn::{Checkpoint, Network, NnError};
use lapwing_core::perception::{Frame, PreprocessError, Preprocessor};

/// What a network sees in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaneSeen {
    /// Metres that the camera is to the right of its lane's middle.
    pub offset_m: f64,
    /// Degrees that it is turned clockwise from the lane's direction.
    pub heading_deg: f64,
    /// Standard deviation of the offset, in metres: how sure the network is.
    pub offset_sd_m: f64,
    /// Standard deviation of the heading, in degrees.
    pub heading_sd_deg: f64,
}

/// Why a network does not say where the lane is.
#[derive(Debug, thiserror::Error)]
pub enum LaneError {
    /// A picture that it does not take.
    #[error(transparent)]
    Preprocess(#[from] PreprocessError),
    /// libtorch fails.
    #[error(transparent)]
    Network(#[from] NnError),
    /// An answer that is no number.
    #[error("expected finite numbers, got {got:?}")]
    NotFinite {
        /// The answer.
        got: Vec<f64>,
    },
}

/// A network in memory. Several threads may take a [`LaneFinder`] from it, each its own.
#[derive(Debug)]
pub struct LaneModel {
    name: String,
    /// That from which all others are made, behind a lock because a tensor's handle belongs to one thread at a time.
    prototype: Mutex<LaneFinder>,
}

impl LaneModel {
    /// Reads a checkpoint of the architecture `lane`.
    ///
    /// # Errors
    /// [`ModelError`], naming the file.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, ModelError> {
        let path = path.as_ref();
        let bytes = fs::read(path).map_err(|source| ModelError::Read { path: path.to_owned(), source })?;
        let wrong = |source| ModelError::Checkpoint { path: path.to_owned(), source };
        let checkpoint = Checkpoint::from_bytes(&bytes).map_err(wrong)?;
        if !checkpoint.network.architecture().locates() || checkpoint.network.design().speed {
            let source = Box::new(ModelError::NotLane(checkpoint.metadata.outputs));
            return Err(ModelError::Unfit { path: path.to_owned(), source });
        }
        let preprocessor =
            Preprocessor::new(checkpoint.metadata.preprocess).map_err(|source| wrong(NnError::Preprocess(source)))?;
        let finder = LaneFinder { preprocessor, network: checkpoint.network, input: vec![] };
        let name = format!("{} ({})", finder.network.architecture().name(), path.display());
        Ok(Self { name, prototype: Mutex::new(finder) })
    }

    /// Architecture and file, for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Another handle on the weights, for one thread.
    pub fn finder(&self) -> LaneFinder {
        self.prototype.lock().unwrap_or_else(PoisonError::into_inner).share()
    }
}

/// Looks at pictures one by one.
#[derive(Debug)]
pub struct LaneFinder {
    preprocessor: Preprocessor,
    network: Network,
    /// (C, H, W) f32, flat.
    input: Vec<f32>,
}

impl LaneFinder {
    fn share(&self) -> Self {
        Self { preprocessor: self.preprocessor.clone(), network: self.network.share(), input: vec![] }
    }

    /// Says where in its lane the camera is that took this picture.
    ///
    /// # Errors
    /// [`LaneError`].
    pub fn look(&mut self, frame: &Frame) -> Result<LaneSeen, LaneError> {
        self.preprocessor.apply(frame, &mut self.input)?;
        let [channels, height, width] = self.preprocessor.preprocess().shape().map(|n| n as i64);
        let got = tch::no_grad(|| {
            // (1, C, H, W) f32
            let input = Tensor::f_from_slice(&self.input)?.f_view([1, channels, height, width])?;
            let answer = self.network.forward(&input, None, false)?.f_view([-1])?; // (4)
            Ok::<_, NnError>(Vec::<f64>::try_from(&answer.f_to_kind(tch::Kind::Double)?)?)
        })?;
        match got[..] {
            [offset_m, heading_deg, offset_log, heading_log] if got.iter().all(|x| x.is_finite()) => {
                let [offset_sd_m, heading_sd_deg] = [offset_log, heading_log].map(|log| (log / 2.0).exp());
                Ok(LaneSeen { offset_m, heading_deg, offset_sd_m, heading_sd_deg })
            }
            _ => Err(LaneError::NotFinite { got }),
        }
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, nn::VarStore};

    use super::*;
    use crate::nn::{Architecture, Design, Metadata, Precision, in_variable_store, save};

    fn saved(architecture: Architecture) -> (tempfile::TempDir, std::path::PathBuf, Network, VarStore) {
        tch::manual_seed(7);
        let (store, design) = (VarStore::new(Device::Cpu), Design::of(architecture));
        let network = Network::build(&design, &mut in_variable_store(store.root())).unwrap();
        let metadata = Metadata {
            preprocess: design.preprocess,
            outputs: architecture.outputs().iter().map(|name| (*name).to_owned()).collect(),
            training: String::new(),
            result: String::new(),
        };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("model.safetensors");
        save(&path, &metadata, &network, Precision::F32).unwrap();
        (dir, path, network, store)
    }

    #[test]
    fn a_network_read_from_its_file_answers_as_the_one_that_was_saved() {
        let (_dir, path, network, _store) = saved(Architecture::Lane);
        let model = LaneModel::load(&path).unwrap();
        let bytes: Vec<u8> = (0..320 * 160 * 3).map(|i| (i * 7 % 251) as u8).collect();
        let frame = Frame::new(320, 160, bytes).unwrap();
        let mut finder = model.finder();
        let seen = finder.look(&frame).unwrap();
        let input = Tensor::from_slice(&finder.input).view([1, 3, 44, 160]);
        let answer = Vec::<f64>::try_from(&network.forward(&input, None, false).unwrap().view([-1])).unwrap();
        let expected = [answer[0], answer[1], (answer[2] / 2.0).exp(), (answer[3] / 2.0).exp()];
        let got = [seen.offset_m, seen.heading_deg, seen.offset_sd_m, seen.heading_sd_deg];
        // Batch norm is folded into the convolutions of what is read.
        assert!(got.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{got:?} {expected:?}");
        assert_eq!(model.finder().look(&frame).unwrap(), seen);
    }

    #[test]
    fn a_network_that_drives_does_not_locate() {
        let (_dir, path, ..) = saved(Architecture::PilotNet);
        let error = LaneModel::load(&path).unwrap_err().to_string();
        assert!(
            error.ends_with("expected a network that locates the lane (lane), got outputs [\"steering\"]"),
            "{error}"
        );
    }
}
