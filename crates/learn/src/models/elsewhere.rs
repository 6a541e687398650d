//! Pilots of networks that were made elsewhere, each with a [`SideFile`] beside it.

use std::{fmt, path::Path, sync::Arc};

use tch::Tensor;

use super::{ModelError, SideFile, network::Eye};
use crate::nn::NnError;
use lapwing_core::{
    perception::Preprocess,
    pilot::{Pilot, PilotError, Prediction, View},
    units::Clock,
};

/// A network made elsewhere, which any number of threads may use.
pub(super) trait Forward: fmt::Debug + Send + Sync {
    /// (1, C, H, W) or (1, H, W, C) f32 to as many numbers as there are outputs, in whatever shape.
    fn forward(&self, input: &Tensor) -> Result<Tensor, NnError>;

    /// The same network as it was loaded, without what it has kept since; itself if it cannot keep anything.
    fn afresh(self: Arc<Self>) -> Result<Arc<dyn Forward>, ModelError>;
}

/// Steers by the first output of such a network. Clones of one that remembers nothing share it. One that remembers is loaded anew
/// before its first picture and after each reset, because nothing else makes it forget.
#[derive(Debug, Clone)]
pub(super) struct ForeignPilot {
    eye: Eye,
    network: Arc<dyn Forward>,
    /// Whether its answer depends on earlier pictures.
    remembers: bool,
    /// Whether it must be loaded anew before the next picture.
    is_stale: bool,
}

/// Answers to the same picture that differ by no more than this are the same: TorchScript compiles itself meanwhile.
const SAME: f64 = 1e-4;

impl ForeignPilot {
    /// A pilot of the file `path`, with the `.toml` of the same stem beside it, warmed up. `load` makes the network, which
    /// will get inputs of this shape.
    ///
    /// # Errors
    /// [`ModelError::NoSideFile`], [`ModelError::SideFile`], [`ModelError::Unfit`], and those of `load`.
    pub fn load<N: Forward + 'static>(
        path: &Path,
        clock: Clock,
        load: impl FnOnce([usize; 4]) -> Result<N, ModelError>,
    ) -> Result<Self, ModelError> {
        let SideFile { outputs, preprocess } = SideFile::beside(path)?;
        let shape = preprocess.tensor_shape();
        let unfit = |source: ModelError| ModelError::Unfit { path: path.to_owned(), source: Box::new(source) };
        let mut eye = Eye::new(preprocess, &outputs, clock).map_err(unfit)?;
        let network = Arc::new(load(shape)?);
        let [first, again] = eye.warm_up(|input| network.forward(input)).map_err(|error| unfit(error.into()))?;
        let remembers = (first - again).abs() > SAME;
        Ok(Self { eye, network, remembers, is_stale: remembers })
    }

    /// What is done to a frame.
    pub fn preprocess(&self) -> &Preprocess {
        self.eye.preprocess()
    }

    /// What each number of an answer is.
    pub fn outputs(&self) -> &[String] {
        self.eye.outputs()
    }
}

impl Pilot for ForeignPilot {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        let Self { eye, network, is_stale, .. } = self;
        if *is_stale {
            *network = network.clone().afresh().map_err(|error| PilotError::Network(error.into()))?;
            *is_stale = false;
        }
        eye.steer(view.frame, |input| network.forward(input))
    }

    fn reset(&mut self) {
        self.is_stale = self.remembers;
    }
}
