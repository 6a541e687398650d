//! A network of any architecture.

use std::collections::VecDeque;

use tch::Tensor;

use super::{
    Architecture, Design, NnError, TensorSource,
    architecture::FRAMES,
    cps::Cps,
    gru::ResNetGru,
    lane::Lane,
    layers::{Reach, Watch, channels_last},
    pilotnet::PilotNet,
    pretrained,
    resnet::{self, Depth, ResNet},
    stack,
};
use lapwing_core::units::Mph;

/// The speed that is 1 to a network: it is given mph / 30.
pub const SPEED_UNIT_MPH: f64 = 30.0;

/// A network of any architecture, with its weights.
#[derive(Debug)]
pub struct Network {
    design: Design,
    /// All tensors, in the order in which they were asked for. The layers hold the same ones, unless batch norm is
    /// folded into them.
    tensors: Vec<(String, Tensor)>,
    layers: NetworkLayers,
}

#[derive(Debug)]
enum NetworkLayers {
    PilotNet(PilotNet),
    Cps(Cps),
    ResNet(ResNet),
    Gru(ResNetGru),
    Stack(ResNet),
    Lane(Lane),
}

/// What a network that uses several frames keeps of earlier frames of a run; empty at the run's beginning.
#[derive(Debug, Default)]
pub struct Memory {
    /// The oldest first, at most five: features (1, N) for `-gru`, frames (1, 3, H, W) for `-stack`.
    kept: VecDeque<Tensor>,
}

impl Memory {
    /// Another run begins.
    pub fn clear(&mut self) {
        self.kept.clear();
    }

    /// Adds one and returns all five along dimension 1; the first of a run fills all five places.
    fn remember(&mut self, new: Tensor) -> Result<Tensor, NnError> {
        if self.kept.len() >= FRAMES {
            self.kept.pop_front();
        }
        self.kept.push_back(new);
        while self.kept.len() < FRAMES {
            let first = self.kept[0].shallow_clone();
            self.kept.push_front(first);
        }
        Ok(Tensor::f_stack(self.kept.make_contiguous(), 1)?)
    }
}

impl Network {
    /// Builds the design from the tensors that `source` gives.
    ///
    /// # Errors
    /// Those of [`Design::validate`] and of `source`.
    pub fn build(design: &Design, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        design.validate()?;
        let mut tensors = Vec::new();
        let source: &mut TensorSource<'_> = &mut |name, shape, init| {
            let tensor = source(name, shape, init)?;
            tensors.push((name.to_owned(), tensor.shallow_clone()));
            Ok(tensor)
        };
        let (speed, channels) = (design.speed, resnet::CHANNELS as i64);
        let layers = match design.architecture {
            Architecture::PilotNet => NetworkLayers::PilotNet(PilotNet::build(speed, source)?),
            Architecture::Cps => NetworkLayers::Cps(Cps::build(speed, source)?),
            Architecture::Lane => NetworkLayers::Lane(Lane::build(speed, source)?),
            Architecture::ResNet18 => NetworkLayers::ResNet(ResNet::build(Depth::Eighteen, channels, speed, source)?),
            Architecture::ResNet50 => NetworkLayers::ResNet(ResNet::build(Depth::Fifty, channels, speed, source)?),
            Architecture::ResNet18Gru => NetworkLayers::Gru(ResNetGru::build(Depth::Eighteen, speed, source)?),
            Architecture::ResNet50Gru => NetworkLayers::Gru(ResNetGru::build(Depth::Fifty, speed, source)?),
            Architecture::ResNet18Stack => {
                NetworkLayers::Stack(ResNet::build(Depth::Eighteen, stack::CHANNELS, speed, source)?)
            }
            Architecture::ResNet50Stack => {
                NetworkLayers::Stack(ResNet::build(Depth::Fifty, stack::CHANNELS, speed, source)?)
            }
        };
        Ok(Self { design: design.clone(), tensors, layers })
    }

    /// The same weights made ready to answer one frame at a time. They are copied or detached: the variable store they
    /// came from can go on training without them, and [`Network::forward`] with `train` is no longer useful.
    ///
    /// PilotNet's convolutions become channels-last, and so do the activations: 17% faster at batch 1 on one thread of
    /// an EPYC with AVX512, 19% on two; converting the input as well gains nothing. A ResNet's batch norm is folded
    /// into its convolutions: 5% (50 layers) to 8% (18) faster on one thread, for twice the memory, since
    /// [`Network::tensors`] still keeps both separately.
    ///
    /// # Errors
    /// [`NnError::Torch`] if libtorch finds no memory.
    pub fn for_inference(self) -> Result<Self, NnError> {
        let Self { design, tensors, layers } = self;
        let relayout = matches!(layers, NetworkLayers::PilotNet(_));
        drop(layers);
        // The same design asks for the same tensors in the same order.
        let mut tensors = tensors.into_iter();
        let mut network = Self::build(&design, &mut |name, shape, _| {
            let missing = || NnError::MissingTensor { name: name.to_owned(), expected: shape.to_vec() };
            let tensor = tensors.next().ok_or_else(missing)?.1.f_detach()?;
            if relayout && shape.len() == 4 { channels_last(&tensor) } else { Ok(tensor) }
        })?;
        tch::no_grad(|| match &mut network.layers {
            NetworkLayers::PilotNet(_) | NetworkLayers::Cps(_) => Ok(()),
            NetworkLayers::ResNet(layers) | NetworkLayers::Stack(layers) => layers.fold(),
            NetworkLayers::Gru(layers) => layers.fold(),
            NetworkLayers::Lane(layers) => layers.fold(),
        })?;
        Ok(network)
    }

    /// Excludes a ResNet's first convolution and as many of its four stages from training: their weights get no gradient,
    /// none is computed through them, and their batch norm uses the running statistics, which stay fixed. The layers after
    /// them keep learning. With [`STAGES`](resnet::STAGES) that is the whole backbone, with 0 nothing.
    ///
    /// # Errors
    /// [`NnError::NoBackbone`] for a network of another kind.
    pub fn freeze(&mut self, stages: usize) -> Result<(), NnError> {
        let architecture = self.architecture();
        let stages = stages.min(resnet::STAGES);
        match &mut self.layers {
            NetworkLayers::PilotNet(_) | NetworkLayers::Cps(_) | NetworkLayers::Lane(_) => {
                return Err(NnError::NoBackbone { architecture });
            }
            NetworkLayers::ResNet(layers) | NetworkLayers::Stack(layers) => layers.freeze(stages),
            NetworkLayers::Gru(layers) => layers.freeze(stages),
        }
        for (_, tensor) in
            self.tensors.iter().filter(|(name, _)| pretrained::stage(name).is_some_and(|stage| stage <= stages))
        {
            let _ = tensor.set_requires_grad(false);
        }
        Ok(())
    }

    /// Whether training normalises by the batch: a batch of a single picture is then useless.
    pub fn normalises_by_batch(&self) -> bool {
        match &self.layers {
            NetworkLayers::PilotNet(_) | NetworkLayers::Cps(_) => false,
            NetworkLayers::Lane(_) => true,
            NetworkLayers::ResNet(layers) | NetworkLayers::Stack(layers) => !layers.is_frozen(),
            NetworkLayers::Gru(layers) => !layers.is_frozen(),
        }
    }

    /// The design that it was built from.
    pub fn design(&self) -> &Design {
        &self.design
    }

    /// Which kind it is.
    pub fn architecture(&self) -> Architecture {
        self.design.architecture
    }

    /// Answers a batch with (B, outputs), not clamped, in the kind of `frames`.
    ///
    /// `frames`: (B, C, H, W) for a network of one frame, (B, 5, C, H, W) with the oldest first for one of five; f32 or
    /// bf16, any layout in memory. `speed`: (B, 1), mph / [`SPEED_UNIT_MPH`] at the newest frame, `Some` exactly if the
    /// design uses it. `train`: dropout is on, and batch norm uses the batch and updates its running statistics.
    /// Gradients are tracked unless the caller holds `tch::no_grad`.
    ///
    /// # Errors
    /// [`NnError::Input`], [`NnError::Speed`], [`NnError::Torch`].
    pub fn forward(&self, frames: &Tensor, speed: Option<&Tensor>, train: bool) -> Result<Tensor, NnError> {
        self.watched(frames, speed, train, &mut |_, _| {})
    }

    /// The outputs of its convolutions and poolings for one-frame batches (B, C, H, W), from the first to the last, each
    /// after its activation function, and where each looks in the one before; a block of a ResNet counts as one convolution.
    /// None for networks of several frames and `lane`. No gradients are tracked.
    ///
    /// # Errors
    /// As [`Network::forward`].
    pub(crate) fn activations(&self, frames: &Tensor, speed: Option<&Tensor>) -> Result<Vec<(Tensor, Reach)>, NnError> {
        let mut seen = Vec::new();
        tch::no_grad(|| self.watched(frames, speed, false, &mut |map, reach| seen.push((map.shallow_clone(), reach))))
            .map(drop)?;
        Ok(seen)
    }

    fn watched(
        &self,
        frames: &Tensor,
        speed: Option<&Tensor>,
        train: bool,
        watch: &mut Watch<'_>,
    ) -> Result<Tensor, NnError> {
        let size = frames.size();
        let frame_size = match (self.architecture().frames(), &size[..]) {
            (1, [_, frame @ ..]) => frame,
            (n, [_, steps, frame @ ..]) if *steps == n as i64 => frame,
            _ => &[],
        };
        self.check_frame(frame_size, &size)?;
        self.check_speed(speed, size[0])?;
        match &self.layers {
            NetworkLayers::PilotNet(layers) => layers.forward(frames, speed, watch),
            NetworkLayers::Cps(layers) => layers.forward(frames, speed, train, watch),
            NetworkLayers::Lane(layers) => layers.forward(frames, speed, train),
            NetworkLayers::ResNet(layers) => layers.forward(frames, speed, train, watch),
            NetworkLayers::Gru(layers) => layers.forward(frames, speed, train),
            NetworkLayers::Stack(layers) => layers.forward(&stack::stacked(frames)?, speed, train, &mut |_, _| {}),
        }
    }

    /// Answers one frame while driving, (1, C, H, W), with (1, outputs); no gradients are tracked.
    ///
    /// `speed`: (1, 1), as in [`Network::forward`]. `memory` belongs to one run of this network. The answer is that of
    /// `forward` to the last five frames, with the first of the run in place of those before it; but a `-gru` passes
    /// only this frame through its backbone.
    ///
    /// # Errors
    /// [`NnError::Input`], [`NnError::Speed`], [`NnError::Torch`].
    pub fn answer(&self, frame: &Tensor, speed: Option<&Tensor>, memory: &mut Memory) -> Result<Tensor, NnError> {
        tch::no_grad(|| match &self.layers {
            NetworkLayers::PilotNet(_) | NetworkLayers::Cps(_) | NetworkLayers::ResNet(_) | NetworkLayers::Lane(_) => {
                self.forward(frame, speed, false)
            }
            NetworkLayers::Stack(_) => {
                self.check_one(frame)?;
                self.forward(&memory.remember(frame.shallow_clone())?, speed, false)
            }
            NetworkLayers::Gru(layers) => {
                self.check_one(frame)?;
                self.check_speed(speed, 1)?;
                layers.steer(&memory.remember(layers.see(frame, false)?)?, speed, false)
            }
        })
    }

    /// A speed as one frame's input, (1, 1); `None` for a network that takes none.
    ///
    /// # Errors
    /// [`NnError::Torch`]
    pub fn speed_input(&self, speed: Mph) -> Result<Option<Tensor>, NnError> {
        let input = |mph: f64| Tensor::f_from_slice(&[(mph / SPEED_UNIT_MPH) as f32])?.f_view([1, 1]);
        Ok(self.design.speed.then(|| input(speed.get())).transpose()?)
    }

    /// The features that a ResNet computes from one-frame batches (B, 3, H, W): (B, 512) or (B, 2048), using the
    /// running statistics; `None` for other architectures.
    ///
    /// # Errors
    /// [`NnError::Input`], [`NnError::Torch`].
    pub fn features(&self, frames: &Tensor) -> Result<Option<Tensor>, NnError> {
        let NetworkLayers::ResNet(layers) = &self.layers else { return Ok(None) };
        let size = frames.size();
        self.check_frame(size.get(1..).unwrap_or(&[]), &size)?;
        layers.features(frames, false).map(Some)
    }

    /// Another handle on the same weights, for another thread; nothing is copied.
    pub fn share(&self) -> Self {
        let layers = match &self.layers {
            NetworkLayers::PilotNet(layers) => NetworkLayers::PilotNet(layers.share()),
            NetworkLayers::Cps(layers) => NetworkLayers::Cps(layers.share()),
            NetworkLayers::Lane(layers) => NetworkLayers::Lane(layers.share()),
            NetworkLayers::ResNet(layers) => NetworkLayers::ResNet(layers.share()),
            NetworkLayers::Gru(layers) => NetworkLayers::Gru(layers.share()),
            NetworkLayers::Stack(layers) => NetworkLayers::Stack(layers.share()),
        };
        Self { design: self.design.clone(), tensors: self.tensors(), layers }
    }

    /// All tensors under their names in a checkpoint, including running statistics; handles, not copies.
    pub fn tensors(&self) -> Vec<(String, Tensor)> {
        self.tensors.iter().map(|(name, tensor)| (name.clone(), tensor.shallow_clone())).collect()
    }

    /// Whether `frame` is the size of a frame that the network takes; `whole` is what it was given.
    fn check_frame(&self, frame: &[i64], whole: &[i64]) -> Result<(), NnError> {
        let architecture = self.architecture();
        let fits = <[i64; 3]>::try_from(frame)
            .is_ok_and(|shape| architecture.takes(shape.map(|n| usize::try_from(n).unwrap_or(0))));
        if fits { Ok(()) } else { Err(NnError::Input { expected: architecture.batch_shape(), got: whole.to_vec() }) }
    }

    fn check_one(&self, frame: &Tensor) -> Result<(), NnError> {
        let size = frame.size();
        match &size[..] {
            [1, one @ ..] if self.check_frame(one, &size).is_ok() => Ok(()),
            _ => Err(NnError::Input { expected: "(1, 3, H, W)".into(), got: size }),
        }
    }

    fn check_speed(&self, speed: Option<&Tensor>, batch: i64) -> Result<(), NnError> {
        let got = speed.map(Tensor::size);
        let expected = self.design.speed.then(|| vec![batch, 1]);
        if got == expected { Ok(()) } else { Err(NnError::Speed { expected, got }) }
    }
}

#[cfg(test)]
mod tests;
