//! ResNet: He et al., "Deep Residual Learning for Image Recognition", 2015, arXiv:1512.03385, with 18 or 50 layers, and
//! Lu's perceptron in place of its last layer: 2048 (512 with 18 layers), 512, 128, 1 with ReLU between (Lu, "End to
//! End Learning for Self-Driving Cars").
//!
//! The backbone is torchvision's, with the stride in the 3 x 3 convolution of a bottleneck, and its tensors have
//! torchvision's names, `conv1.weight` to `layer4.2.bn3.running_var`, so torchvision's weights can be loaded, see
//! [`load_pretrained`](super::load_pretrained). The perceptron's are `head.1.weight` to `head.3.bias`. 11,504,961
//! parameters with 18 layers, 24,622,913 with 50; pictures of any size.

use tch::Tensor;

use super::{
    NnError, TensorSource,
    layers::{Linear, NormedConvolution, Reach, Watch, beside},
};
use lapwing_core::perception::PixelScale;

/// Red, green and blue.
pub(super) const CHANNELS: usize = 3;

/// The scale that torchvision's networks were trained with: mean and deviation of ImageNet's colours.
pub fn imagenet() -> PixelScale {
    PixelScale::Standardised { mean: vec![0.485, 0.456, 0.406], std: vec![0.229, 0.224, 0.225] }
}

/// Groups of blocks that see the picture at the same size: `layer1` to `layer4`.
pub const STAGES: usize = 4;

/// How many layers a ResNet has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Depth {
    Eighteen,
    Fifty,
}

impl Depth {
    /// Blocks of each stage.
    fn blocks(self) -> [usize; STAGES] {
        match self {
            Self::Eighteen => [2, 2, 2, 2],
            Self::Fifty => [3, 4, 6, 3],
        }
    }

    /// How many times wider the outputs of a block are than its 3 x 3 convolution.
    fn expansion(self) -> i64 {
        match self {
            Self::Eighteen => 1,
            Self::Fifty => 4,
        }
    }

    /// How many numbers the backbone computes from a picture.
    pub(super) fn features(self) -> i64 {
        512 * self.expansion()
    }
}

/// Two convolutions of 3 x 3, or three of 1 x 1, 3 x 3 and 1 x 1, with a shortcut for the input around them.
#[derive(Debug)]
struct Block {
    convolutions: Vec<NormedConvolution>,
    /// For inputs whose shape differs from the output's.
    downsample: Option<NormedConvolution>,
}

impl Block {
    fn build(
        source: &mut TensorSource<'_>,
        depth: Depth,
        name: &str,
        inputs: i64,
        width: i64,
        stride: i64,
    ) -> Result<Self, NnError> {
        let outputs = width * depth.expansion();
        // Outputs, inputs, kernel and stride.
        let shapes = match depth {
            Depth::Eighteen => vec![([width, inputs, 3], stride), ([width, width, 3], 1)],
            Depth::Fifty => vec![([width, inputs, 1], 1), ([width, width, 3], stride), ([outputs, width, 1], 1)],
        };
        let mut convolution = |conv: &str, bn: &str, shape, stride| {
            NormedConvolution::build(source, &format!("{name}.{conv}"), &format!("{name}.{bn}"), shape, stride)
        };
        let mut convolutions = Vec::new();
        for (i, (shape, stride)) in (1..).zip(shapes) {
            convolutions.push(convolution(&format!("conv{i}"), &format!("bn{i}"), shape, stride)?);
        }
        let downsample = if stride == 1 && inputs == outputs {
            None
        } else {
            Some(convolution("downsample.0", "downsample.1", [outputs, inputs, 1], stride)?)
        };
        Ok(Self { convolutions, downsample })
    }

    fn forward(&self, x: &Tensor, train: bool) -> Result<Tensor, NnError> {
        let by = match &self.downsample {
            Some(downsample) => downsample.forward(x, train)?,
            None => x.shallow_clone(),
        };
        let mut x = x.shallow_clone();
        for (i, convolution) in self.convolutions.iter().enumerate() {
            if i > 0 {
                x = x.f_relu()?;
            }
            x = convolution.forward(&x, train)?;
        }
        Ok(x.f_add(&by)?.f_relu()?)
    }

    /// As if it were one convolution: its 3 x 3 with the stride of all.
    fn reach(&self) -> Reach {
        let stride = self.convolutions.iter().map(|convolution| convolution.reach().stride).product();
        Reach { kernel: 3, stride, padding: 1 }
    }

    fn fold(&mut self) -> Result<(), NnError> {
        self.convolutions.iter_mut().chain(&mut self.downsample).try_for_each(NormedConvolution::fold)
    }

    fn share(&self) -> Self {
        Self {
            convolutions: self.convolutions.iter().map(NormedConvolution::share).collect(),
            downsample: self.downsample.as_ref().map(NormedConvolution::share),
        }
    }
}

/// All but the last layer: from pictures to features.
#[derive(Debug)]
pub(super) struct Backbone {
    first: NormedConvolution,
    stages: [Vec<Block>; STAGES],
    /// If not 0: the first convolution and this many of the stages use their running statistics even in training, and
    /// none of them changes.
    pub(super) frozen: usize,
}

impl Backbone {
    pub(super) fn build(depth: Depth, channels: i64, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        let first = NormedConvolution::build(source, "conv1", "bn1", [64, channels, 7], 2)?;
        let mut inputs = 64;
        let mut stages = [const { Vec::new() }; STAGES];
        for (stage, (blocks, count)) in stages.iter_mut().zip(depth.blocks()).enumerate() {
            let width = 64 << stage;
            for i in 0..count {
                let stride = if stage > 0 && i == 0 { 2 } else { 1 };
                let name = format!("layer{}.{i}", stage + 1);
                blocks.push(Block::build(source, depth, &name, inputs, width, stride)?);
                inputs = width * depth.expansion();
            }
        }
        Ok(Self { first, stages, frozen: 0 })
    }

    /// (B, channels, H, W) to (B, features). In what is frozen no gradient is tracked and `train` has no effect.
    pub(super) fn forward(&self, frames: &Tensor, train: bool, watch: &mut Watch<'_>) -> Result<Tensor, NnError> {
        let (frozen, learning) = self.stages.split_at(self.frozen);
        let x = if frozen.is_empty() {
            self.stem(frames, train, watch)?
        } else {
            tch::no_grad(|| through(frozen, self.stem(frames, false, watch)?, false, watch))?
        };
        let x = through(learning, x, train, watch)?;
        // (B, features, H / 32, W / 32) to (B, features)
        Ok(x.f_adaptive_avg_pool2d([1, 1])?.f_flatten(1, -1)?)
    }

    /// (B, channels, H, W) to (B, 64, H / 4, W / 4).
    fn stem(&self, frames: &Tensor, train: bool, watch: &mut Watch<'_>) -> Result<Tensor, NnError> {
        let x = self.first.forward(frames, train)?.f_relu()?; // (B, 64, H / 2, W / 2)
        watch(&x, self.first.reach());
        let x = x.f_max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false)?;
        watch(&x, Reach { kernel: 3, stride: 2, padding: 1 });
        Ok(x)
    }

    pub(super) fn fold(&mut self) -> Result<(), NnError> {
        self.first.fold()?;
        self.stages.iter_mut().flatten().try_for_each(Block::fold)
    }

    pub(super) fn share(&self) -> Self {
        let stages = self.stages.each_ref().map(|blocks| blocks.iter().map(Block::share).collect());
        Self { first: self.first.share(), stages, frozen: self.frozen }
    }
}

fn through(stages: &[Vec<Block>], mut x: Tensor, train: bool, watch: &mut Watch<'_>) -> Result<Tensor, NnError> {
    for block in stages.iter().flatten() {
        x = block.forward(&x, train)?;
        watch(&x, block.reach());
    }
    Ok(x)
}

/// Lu's perceptron: from features to the steering.
#[derive(Debug)]
pub(super) struct Head([Linear; 3]);

impl Head {
    pub(super) fn build(depth: Depth, speed: bool, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        Ok(Self([
            Linear::build(source, "head.1", 512, depth.features() + i64::from(speed))?,
            Linear::build(source, "head.2", 128, 512)?,
            Linear::build(source, "head.3", 1, 128)?,
        ]))
    }

    /// (B, features) to (B, 1).
    pub(super) fn forward(&self, features: &Tensor) -> Result<Tensor, NnError> {
        let [first, second, last] = &self.0;
        last.forward(&second.forward(&first.forward(features)?.f_relu()?)?.f_relu()?)
    }

    pub(super) fn share(&self) -> Self {
        Self(self.0.each_ref().map(Linear::share))
    }
}

/// Backbone and head: one picture, one steering.
#[derive(Debug)]
pub(super) struct ResNet {
    backbone: Backbone,
    head: Head,
}

impl ResNet {
    pub(super) fn build(
        depth: Depth,
        channels: i64,
        speed: bool,
        source: &mut TensorSource<'_>,
    ) -> Result<Self, NnError> {
        Ok(Self { backbone: Backbone::build(depth, channels, source)?, head: Head::build(depth, speed, source)? })
    }

    /// (B, channels, H, W) and (B, 1) to (B, 1): the steering.
    pub(super) fn forward(
        &self,
        frames: &Tensor,
        speed: Option<&Tensor>,
        train: bool,
        watch: &mut Watch<'_>,
    ) -> Result<Tensor, NnError> {
        self.head.forward(&beside(self.backbone.forward(frames, train, watch)?, speed)?)
    }

    /// (B, channels, H, W) to (B, features).
    pub(super) fn features(&self, frames: &Tensor, train: bool) -> Result<Tensor, NnError> {
        self.backbone.forward(frames, train, &mut |_, _| {})
    }

    pub(super) fn freeze(&mut self, stages: usize) {
        self.backbone.frozen = stages;
    }

    pub(super) fn is_frozen(&self) -> bool {
        self.backbone.frozen == STAGES
    }

    pub(super) fn fold(&mut self) -> Result<(), NnError> {
        self.backbone.fold()
    }

    pub(super) fn share(&self) -> Self {
        Self { backbone: self.backbone.share(), head: self.head.share() }
    }
}
