//! All architectures, and the design of a network.

use super::{NnError, cps::Cps, lane::Lane, pilotnet::PilotNet, resnet};
use lapwing_core::perception::{ColourSpace, Crop, PixelScale, Preprocess, Resize, ResizeFilter, TensorLayout};

/// A kind of network, named as in checkpoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Architecture {
    /// `pilotnet`, see [`PilotNet`].
    PilotNet,
    /// `cps`, see [`Cps`].
    Cps,
    /// `resnet18`, see [`resnet`].
    ResNet18,
    /// `resnet50`, see [`resnet`].
    ResNet50,
    /// `resnet18-gru`, see [`gru`](super::gru).
    ResNet18Gru,
    /// `resnet50-gru`, see [`gru`](super::gru).
    ResNet50Gru,
    /// `resnet18-stack`, see [`stack`](super::stack).
    ResNet18Stack,
    /// `resnet50-stack`, see [`stack`](super::stack).
    ResNet50Stack,
    /// `lane`, see [`Lane`].
    Lane,
}

/// The number of frames of a network that takes several.
pub(super) const FRAMES: usize = 5;

impl Architecture {
    /// All architectures.
    pub const ALL: [Self; 9] = [
        Self::PilotNet,
        Self::Cps,
        Self::ResNet18,
        Self::ResNet50,
        Self::ResNet18Gru,
        Self::ResNet50Gru,
        Self::ResNet18Stack,
        Self::ResNet50Stack,
        Self::Lane,
    ];

    /// Its name in a checkpoint.
    pub fn name(self) -> &'static str {
        match self {
            Self::PilotNet => "pilotnet",
            Self::Cps => "cps",
            Self::ResNet18 => "resnet18",
            Self::ResNet50 => "resnet50",
            Self::ResNet18Gru => "resnet18-gru",
            Self::ResNet50Gru => "resnet50-gru",
            Self::ResNet18Stack => "resnet18-stack",
            Self::ResNet50Stack => "resnet50-stack",
            Self::Lane => "lane",
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

    /// How many frames one answer takes: 1, or 5 that follow each other, oldest first.
    pub fn frames(self) -> usize {
        match self {
            Self::PilotNet | Self::Cps | Self::ResNet18 | Self::ResNet50 | Self::Lane => 1,
            Self::ResNet18Gru | Self::ResNet50Gru | Self::ResNet18Stack | Self::ResNet50Stack => FRAMES,
        }
    }

    /// What each of its output numbers is: normalised steering, and for `cps` the acceleration after it, both in -1..=1
    /// if they were so in training, and not clamped; for `lane` [`Lane::OUTPUTS`].
    pub fn outputs(self) -> &'static [&'static str] {
        match self {
            Self::Cps => &["steering", "acceleration"],
            Self::Lane => &Lane::OUTPUTS,
            _ => &["steering"],
        }
    }

    /// Whether it learns where in its lane the camera is, and not to drive.
    pub fn locates(self) -> bool {
        self == Self::Lane
    }

    /// The default preprocessing of a 320x160 picture: that of its authors, as far as they describe it.
    pub fn default_preprocess(self) -> Preprocess {
        let (crop, [height, width], colour, scale) = match self {
            Self::PilotNet => ((60, 135), [66, 200], ColourSpace::Yuv, PixelScale::Signed),
            // Crops the upper 60%.
            Self::Cps => ((96, 160), [12, 40], ColourSpace::Grey, PixelScale::Unit),
            // From above the horizon, uphill too, to the bonnet, at half the size.
            Self::Lane => ((44, 132), [44, 160], ColourSpace::Rgb, PixelScale::Unit),
            // Crops most of the sky and the bonnet; colours as ImageNet's networks take them.
            _ => ((40, 140), [80, 160], ColourSpace::Rgb, resnet::imagenet()),
        };
        let resize = Resize { height, width, filter: ResizeFilter::BilinearAntialiased };
        Preprocess::of(Some(Crop::rows(crop.0, crop.1)), resize, colour, scale)
    }

    /// Channels, rows and columns of each frame; `None` for a network that takes three channels of any size.
    pub fn input_shape(self) -> Option<[usize; 3]> {
        match self {
            Self::PilotNet => Some(PilotNet::INPUT_SHAPE),
            Self::Cps => Some(Cps::INPUT_SHAPE),
            Self::Lane => Some(Lane::INPUT_SHAPE),
            _ => None,
        }
    }

    /// The function between its layers, which no file of weights tells.
    pub fn activation(self) -> &'static str {
        if self == Self::PilotNet { "ELU" } else { "ReLU" }
    }

    /// The best number of threads for one frame's forward pass; `None` for as many as there are processors.
    ///
    /// PilotNet on two idle cores takes 1.00 ms with one thread and 0.64 ms with two, but beside other work 1.04 ms
    /// with one and 7.6 ms with two, 103 ms at worst: its operations are so short that the threads wait for each other.
    /// Those of `cps` are shorter still. A ResNet is slow and uses all threads.
    pub fn threads(self) -> Option<u16> {
        match self {
            Self::PilotNet | Self::Cps | Self::Lane => Some(1),
            _ => None,
        }
    }

    /// Whether it has a ResNet's backbone.
    pub(super) fn is_resnet(self) -> bool {
        !matches!(self, Self::PilotNet | Self::Cps | Self::Lane)
    }

    /// Whether it takes frames of this shape: channels, rows and columns.
    pub(super) fn takes(self, shape: [usize; 3]) -> bool {
        self.input_shape().map_or(shape[0] == resnet::CHANNELS && shape[1] > 0 && shape[2] > 0, |s| s == shape)
    }

    /// The shape of a batch of frames, for messages: `(B, 3, 66, 200)`, `(B, 5, 3, H, W)`.
    pub(super) fn batch_shape(self) -> String {
        let frames = if self.frames() > 1 { format!("{}, ", self.frames()) } else { String::new() };
        let frame = self.input_shape().map_or(format!("{}, H, W", resnet::CHANNELS), |s| joined(s, ", "));
        format!("(B, {frames}{frame})")
    }

    /// The shape of a frame, for messages: `3x66x200`, `3xHxW`.
    pub(super) fn frame_shape(self) -> String {
        self.input_shape().map_or(format!("{}xHxW", resnet::CHANNELS), |s| joined(s, "x"))
    }
}

fn joined(shape: [usize; 3], between: &str) -> String {
    shape.map(|n| n.to_string()).join(between)
}

/// The design of a network: all that a checkpoint must say to rebuild it.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// The kind of network.
    pub architecture: Architecture,
    /// What is done to a picture before the network sees it.
    pub preprocess: Preprocess,
    /// Whether the network takes the speed as well: one more number, in units of
    /// [`SPEED_UNIT_MPH`](super::SPEED_UNIT_MPH), beside the input of its first linear layer or of its GRU.
    pub speed: bool,
}

impl Design {
    /// An architecture with its own preprocessing and no speed.
    pub fn of(architecture: Architecture) -> Self {
        Self { architecture, preprocess: architecture.default_preprocess(), speed: false }
    }

    /// Checks that the preprocessing is valid and gives what the architecture takes.
    ///
    /// # Errors
    /// [`NnError::Preprocess`], [`NnError::Layout`], [`NnError::InputShape`].
    pub fn validate(&self) -> Result<(), NnError> {
        self.preprocess.validate()?;
        if self.preprocess.layout != TensorLayout::Nchw {
            return Err(NnError::Layout { architecture: self.architecture });
        }
        let (architecture, got) = (self.architecture, self.preprocess.shape());
        if architecture.takes(got) { Ok(()) } else { Err(NnError::InputShape { architecture, got }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_architecture_is_found_by_its_name_and_no_other() {
        for architecture in Architecture::ALL {
            assert_eq!(Architecture::named(architecture.name()), Some(architecture));
        }
        assert_eq!(Architecture::named("PilotNet"), None);
    }

    #[test]
    fn the_preprocessing_that_comes_with_an_architecture_suits_it() {
        for architecture in Architecture::ALL {
            let design = Design::of(architecture);
            design.validate().unwrap();
            assert!(design.preprocess.crop.is_some_and(|crop| crop.bottom <= 160));
            let first = if architecture.locates() { "offset_m" } else { "steering" };
            assert_eq!(architecture.outputs()[0], first);
        }
        assert_eq!(Architecture::Cps.default_preprocess().shape(), [1, 12, 40]);
    }

    #[test]
    fn a_network_for_any_size_still_wants_three_channels() {
        let mut design = Design::of(Architecture::ResNet18);
        design.preprocess.resize.height = 33;
        design.validate().unwrap();
        design.preprocess.colour = ColourSpace::Grey;
        design.preprocess.scale = PixelScale::Unit;
        let error = design.validate().unwrap_err().to_string();
        assert_eq!(error, "expected preprocessing to 3xHxW for resnet18, got 1x33x160");
    }
}
