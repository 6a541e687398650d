//! The architectures that there are, and a network of any of them.

use tch::Tensor;

use super::{NnError, pilotnet::PilotNet};
use crate::perception::{Colour, Crop, Filter, Layout, Preprocess, Resize, Scale};

/// Gives a network its tensors: called once for each, with name and shape, while the network is built.
///
/// A checkpoint looks them up; [`in_variable_store`] makes new ones to be trained.
pub type TensorSource<'a> = dyn FnMut(&str, &[i64]) -> Result<Tensor, NnError> + 'a;

/// A kind of network, by the name that checkpoints call it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Architecture {
    /// `pilotnet`, see [`PilotNet`].
    PilotNet,
}

impl Architecture {
    /// All there are.
    pub const ALL: [Self; 1] = [Self::PilotNet];

    /// Its name in a checkpoint.
    pub fn name(self) -> &'static str {
        match self {
            Self::PilotNet => "pilotnet",
        }
    }

    /// The architecture of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|a| a.name() == name)
    }

    /// All names, for messages.
    pub(super) fn names() -> String {
        Self::ALL.map(Self::name).join(", ")
    }

    /// Channels, rows and columns that it takes.
    pub fn input_shape(self) -> [usize; 3] {
        match self {
            Self::PilotNet => PilotNet::INPUT_SHAPE,
        }
    }

    /// The preprocessing that a network of it is trained with where nothing else is said.
    pub fn default_preprocess(self) -> Preprocess {
        match self {
            Self::PilotNet => Preprocess {
                crop: Some(Crop { top: 60, bottom: 135 }),
                resize: Resize { height: 66, width: 200, filter: Filter::BilinearAntialiased },
                colour: Colour::Yuv,
                scale: Scale::Signed,
                layout: Layout::Nchw,
            },
        }
    }

    /// Threads for one frame's forward pass that serve best, `None` for as many as there are processors.
    ///
    /// PilotNet on two idle cores takes 1.00 ms with one thread and 0.64 ms with
    /// two, but beside other work 1.04 ms with one and 7.6 ms with two, 103 ms
    /// at worst: its operations are so short that the threads wait for each other.
    pub fn threads(self) -> Option<u16> {
        match self {
            Self::PilotNet => Some(1),
        }
    }

    /// How many numbers it answers.
    pub fn outputs(self) -> usize {
        match self {
            Self::PilotNet => PilotNet::OUTPUTS,
        }
    }
}

/// A network of any architecture, with its weights.
#[derive(Debug)]
pub enum Network {
    /// See [`PilotNet`].
    PilotNet(PilotNet),
}

impl Network {
    /// Builds the architecture of the tensors that `source` gives.
    ///
    /// # Errors
    /// Those of `source`.
    pub fn build(architecture: Architecture, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        Ok(match architecture {
            Architecture::PilotNet => Self::PilotNet(PilotNet::build(source)?),
        })
    }

    /// The same weights laid out in memory as they are fastest for one frame at
    /// a time. They are copies: a variable store that they came from trains on
    /// without them.
    ///
    /// # Errors
    /// [`NnError::Torch`] where libtorch finds no memory.
    pub fn for_inference(self) -> Result<Self, NnError> {
        Ok(match self {
            Self::PilotNet(network) => Self::PilotNet(network.for_inference()?),
        })
    }

    /// Which kind it is.
    pub fn architecture(&self) -> Architecture {
        match self {
            Self::PilotNet(_) => Architecture::PilotNet,
        }
    }

    /// Answers a batch: (B, C, H, W) f32 of the architecture's input shape to (B, outputs) f32.
    ///
    /// Gradients are tracked unless the caller holds `tch::no_grad`.
    ///
    /// # Errors
    /// [`NnError::Input`], [`NnError::Torch`].
    pub fn forward(&self, input: &Tensor) -> Result<Tensor, NnError> {
        match self {
            Self::PilotNet(network) => network.forward(input),
        }
    }

    /// Another handle on the same weights, for another thread; nothing is copied.
    pub fn share(&self) -> Self {
        match self {
            Self::PilotNet(network) => Self::PilotNet(network.share()),
        }
    }

    /// All tensors under the names that a checkpoint has them by.
    pub fn tensors(&self) -> Vec<(String, Tensor)> {
        match self {
            Self::PilotNet(network) => network.tensors(),
        }
    }
}

/// A source of new, trainable tensors under `path` for [`Network::build`], of
/// weights drawn as PyTorch draws them by default for convolutions and linear
/// layers: uniformly up to 1 / sqrt(inputs of a neuron), biases too. Seed with
/// `tch::manual_seed`.
pub fn in_variable_store<'a>(path: tch::nn::Path<'a>) -> impl FnMut(&str, &[i64]) -> Result<Tensor, NnError> + 'a {
    // A bias comes after its weight and is drawn from the same range.
    let mut fan_in = 1;
    move |name, shape| {
        let (layer, kind) = name.rsplit_once('.').unwrap_or(("", name));
        if kind == "weight" {
            fan_in = shape[1..].iter().product();
        }
        let up = 1.0 / (fan_in as f64).sqrt();
        let path = layer.split('.').filter(|part| !part.is_empty()).fold(path.clone(), |path, part| path.sub(part));
        Ok(path.f_var(kind, shape, tch::nn::Init::Uniform { lo: -up, up })?)
    }
}
