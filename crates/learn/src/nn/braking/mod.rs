//! Whether an emergency brake is due: two networks that look at the last [`FRAMES`] grey frames and speeds.
//!
//! | architecture | frames | parameters | looks |
//! |---|---|---|---|
//! | [`brake-stacked`](stacked) | 300 x 300 | 5,909,219 | at all frames at once, as 20 channels: Itu and Danescu's |
//! | [`brake-live`](live) | 80 x 320 | 345,500 | at each frame once, and keeps what stands in each of its columns: for driving on a CPU |
//!
//! Both take frames as bytes (0 to 255) and speeds in km/h, oldest first, and -1 for a speed that is not known. They answer
//! each window of 20 frames with one number, trained towards 1 where a brake is due and 0 elsewhere; the live one also says
//! whether something is close ahead, so that a guard knows when the way is free.

mod checkpoint;
pub mod live;
pub mod stacked;

use tch::{Device, Kind, Tensor};

use self::{live::Live, stacked::Stacked};
use super::{NnError, Precision, TensorSource};
use lapwing_core::perception::{ColourSpace, Crop, PixelScale, Preprocess, Resize, ResizeFilter};

pub use checkpoint::{BrakingCheckpoint, BrakingError, BrakingMetadata, save_braking};
pub use live::Seen;

/// How many frames and speeds an answer takes.
pub const FRAMES: usize = 20;

/// Samples per second at which the networks learn and look.
pub const HZ: f64 = 15.0;

/// What a speed is where none is known.
pub const NO_SPEED: f64 = -1.0;

/// Which of the two networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum BrakingArchitecture {
    /// Itu and Danescu's.
    #[serde(rename = "brake-stacked")]
    Stacked,
    /// The small one.
    #[serde(rename = "brake-live")]
    Live,
}

impl BrakingArchitecture {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Stacked, Self::Live];

    /// Its name in a checkpoint.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stacked => "brake-stacked",
            Self::Live => "brake-live",
        }
    }

    /// The one of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|a| a.name() == name)
    }

    /// What is done to a 320x160 picture before the network sees it.
    pub fn preprocess(self) -> Preprocess {
        let (crop, [height, width]) = match self {
            // The whole picture, whose sides become equal.
            Self::Stacked => (None, stacked::SIZE),
            // Pixel by pixel, as wide as it is: whoever crosses comes in at its edge. Above it is sky, below the bonnet.
            Self::Live => (Some(Crop::rows(44, 124)), live::SIZE),
        };
        let resize = Resize { height, width, filter: ResizeFilter::BilinearAntialiased };
        Preprocess::of(crop, resize, ColourSpace::Grey, PixelScale::Unit)
    }
}

/// What a network says of windows.
#[derive(Debug)]
pub struct Answers {
    /// (B, N): how much an emergency brake is due, trained towards 1 where it is and 0 elsewhere.
    pub due: Tensor,
    /// (B, N): whether something is close ahead in the car's way, 0 to 1. The live network alone says it.
    pub blocked: Option<Tensor>,
    /// What each frame shows by itself. Only the live network says it, and only while it learns, when it is told at each frame
    /// what it is to see.
    pub shows: Option<Shows>,
}

/// What a network says of S frames by themselves.
#[derive(Debug)]
pub struct Shows {
    /// (B, S, 2): the inverse of the time to collision, per second, and how near what is ahead is.
    pub near: Tensor,
    /// (B, S, 40, 5): for each column, what [`live::TOLD`] names; the first is a logit.
    pub columns: Tensor,
    /// (B, S, 3): where our path leads, in half widths of the picture to the right of its middle.
    pub course: Tensor,
}

/// What a network says of the newest window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Said {
    /// How much an emergency brake is due.
    pub due: f64,
    /// Whether something is close ahead, 0 to 1; 0 of a network that does not say it.
    pub blocked: f64,
}

/// A braking network.
#[derive(Debug)]
pub struct BrakingNetwork {
    architecture: BrakingArchitecture,
    layers: Layers,
    tensors: Vec<(String, Tensor)>,
}

#[derive(Debug)]
enum Layers {
    Stacked(Box<Stacked>),
    Live(Box<Live>),
}

impl BrakingNetwork {
    /// Builds it from a source's tensors.
    ///
    /// # Errors
    /// The source's, and [`NnError::Torch`].
    pub fn build(architecture: BrakingArchitecture, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        let mut tensors = vec![];
        let source: &mut TensorSource<'_> = &mut |name, shape, init| {
            let tensor = source(name, shape, init)?;
            tensors.push((name.to_owned(), tensor.shallow_clone()));
            Ok(tensor)
        };
        let layers = match architecture {
            BrakingArchitecture::Stacked => Layers::Stacked(Box::new(Stacked::build(source)?)),
            BrakingArchitecture::Live => Layers::Live(Box::new(Live::build(source)?)),
        };
        Ok(Self { architecture, layers, tensors })
    }

    /// Which one it is.
    pub fn architecture(&self) -> BrakingArchitecture {
        self.architecture
    }

    /// One answer to each of the windows of `frames` (B, 20, H, W) in f32, 0 to 255, and `speeds` (B, 20) in km/h. The live
    /// network also takes an even number of frames more, and then answers each second window: N is 1 + more / 2.
    ///
    /// # Errors
    /// [`NnError::Input`], [`NnError::Torch`].
    pub fn forward(&self, frames: &Tensor, speeds: &Tensor, train: bool) -> Result<Answers, NnError> {
        let [_, height, width] = self.architecture.preprocess().shape().map(|n| n as i64);
        let size = frames.size();
        let fits = match size[..] {
            [batch, steps, h, w] => {
                let more = steps - FRAMES as i64;
                let suits = match self.layers {
                    Layers::Stacked(_) => more == 0,
                    Layers::Live(_) => more >= 0 && more % 2 == 0,
                };
                suits && (h, w) == (height, width) && speeds.size() == [batch, steps]
            }
            _ => false,
        };
        if !fits {
            let expected = format!("(B, {FRAMES}, {height}, {width}) with (B, {FRAMES}) speeds");
            return Err(NnError::Input { expected, got: size });
        }
        match &self.layers {
            Layers::Stacked(layers) => {
                Ok(Answers { due: layers.forward(frames, speeds, train)?, blocked: None, shows: None })
            }
            Layers::Live(layers) => layers.forward(frames, speeds, train),
        }
    }

    /// Answers the newest of a drive's frames, (1, H, W) in f32, 0 to 255, with its speed in km/h. `seen` belongs to one
    /// drive of this network; `None` until 20 frames were seen. No gradients are tracked.
    ///
    /// # Errors
    /// [`NnError::Torch`].
    pub fn answer(&self, frame: &Tensor, speed_kmh: f64, seen: &mut Seen) -> Result<Option<Said>, NnError> {
        tch::no_grad(|| match &self.layers {
            Layers::Live(layers) => layers.answer(frame, speed_kmh, seen),
            Layers::Stacked(layers) => {
                let Some((frames, speeds)) = seen.remember(frame, speed_kmh)? else { return Ok(None) };
                let due = layers.forward(&frames, &speeds, false)?.f_double_value(&[0, 0])?;
                Ok(Some(Said { due, blocked: 0.0 }))
            }
        })
    }

    /// Another handle on the same weights.
    pub fn share(&self) -> Self {
        let layers = match &self.layers {
            Layers::Stacked(layers) => Layers::Stacked(Box::new(layers.share())),
            Layers::Live(layers) => Layers::Live(Box::new(layers.share())),
        };
        Self { architecture: self.architecture, layers, tensors: self.tensors() }
    }

    /// Computes the live network's convolutions in these numbers from here on: for training.
    pub(crate) fn set_precision(&mut self, precision: Precision) {
        if let Layers::Live(layers) = &mut self.layers {
            layers.set_kind(if precision == Precision::Bf16 { Kind::BFloat16 } else { Kind::Float });
        }
    }

    /// Folds batch norm into the convolutions: for inference only.
    pub(super) fn fold(&mut self) -> Result<(), NnError> {
        match &mut self.layers {
            Layers::Stacked(_) => Ok(()),
            Layers::Live(layers) => tch::no_grad(|| layers.fold()),
        }
    }

    /// All tensors under their names in a checkpoint, including running statistics; handles, not copies.
    pub fn tensors(&self) -> Vec<(String, Tensor)> {
        self.tensors.iter().map(|(name, tensor)| (name.clone(), tensor.shallow_clone())).collect()
    }

    /// Where its tensors are, and its inputs belong.
    pub fn device(&self) -> Device {
        self.tensors[0].1.device()
    }

    /// How many numbers it learns.
    pub fn parameters(&self) -> usize {
        self.tensors.iter().filter(|(name, _)| !name.contains("running_")).map(|(_, tensor)| tensor.numel()).sum()
    }
}

#[cfg(test)]
mod tests {
    use tch::nn::VarStore;

    use super::*;
    use crate::nn::in_variable_store;

    fn network(architecture: BrakingArchitecture) -> (BrakingNetwork, VarStore) {
        tch::manual_seed(11);
        let store = VarStore::new(Device::Cpu);
        let network = BrakingNetwork::build(architecture, &mut in_variable_store(store.root())).unwrap();
        (network, store)
    }

    fn frames(steps: i64, architecture: BrakingArchitecture) -> (Tensor, Tensor) {
        let [_, height, width] = architecture.preprocess().shape().map(|n| n as i64);
        let float = (Kind::Float, Device::Cpu);
        (Tensor::rand([1, steps, height, width], float) * 255.0, Tensor::rand([1, steps], float) * 40.0)
    }

    #[test]
    fn they_have_the_parameters_that_the_documentation_says() {
        let parameters = [5_909_219, 345_500];
        assert_eq!(parameters.len(), BrakingArchitecture::ALL.len());
        for (architecture, parameters) in BrakingArchitecture::ALL.into_iter().zip(parameters) {
            assert_eq!(network(architecture).0.parameters(), parameters, "{}", architecture.name());
            assert_eq!(BrakingArchitecture::named(architecture.name()), Some(architecture));
        }
    }

    #[test]
    fn the_papers_network_drops_some_of_what_it_sees_while_it_learns_and_nothing_after() {
        let (network, _store) = network(BrakingArchitecture::Stacked);
        let (frames, speeds) = frames(20, BrakingArchitecture::Stacked);
        let answer = |train: bool| {
            let answer = network.forward(&frames, &speeds, train).unwrap();
            answer.due.double_value(&[0, 0])
        };
        assert_eq!(answer(false), answer(false));
        assert_ne!(answer(true), answer(true));
    }

    #[test]
    fn frame_by_frame_the_answer_is_that_to_the_whole_window() {
        for architecture in BrakingArchitecture::ALL {
            let (network, _store) = network(architecture);
            let (frames, speeds) = frames(22, architecture);
            let mut seen = Seen::default();
            let mut answers = vec![];
            for i in 0..22 {
                let frame = frames.select(0, 0).narrow(0, i, 1);
                answers.push(network.answer(&frame, speeds.double_value(&[0, i]), &mut seen).unwrap());
            }
            assert!(answers[..19].iter().all(Option::is_none) && answers[19..].iter().all(Option::is_some));
            for end in 19..22 {
                let window = |x: &Tensor| x.narrow(1, end - 19, 20);
                let whole =
                    network.forward(&window(&frames), &window(&speeds), false).unwrap().due.double_value(&[0, 0]);
                let got = answers[end as usize].unwrap().due;
                assert!((whole - got).abs() < 1e-3, "{}: {whole} {got}", architecture.name());
            }
        }
    }

    #[test]
    fn windows_of_another_size_are_refused_and_longer_ones_are_answered_twice() {
        let (live, _store) = network(BrakingArchitecture::Live);
        let (frames, speeds) = frames(22, BrakingArchitecture::Live);
        let both = live.forward(&frames, &speeds, false).unwrap().due;
        assert_eq!(both.size(), [1, 2]);
        let last = live.forward(&frames.narrow(1, 2, 20), &speeds.narrow(1, 2, 20), false).unwrap().due;
        assert!((both.double_value(&[0, 1]) - last.double_value(&[0, 0])).abs() < 1e-4);
        let error = live.forward(&frames.narrow(1, 0, 21), &speeds.narrow(1, 0, 21), false).unwrap_err().to_string();
        assert!(error.contains("(B, 20, 80, 320)"), "{error}");
    }

    #[test]
    fn an_unknown_speed_is_no_standing_car_to_the_live_network() {
        let (live, _store) = network(BrakingArchitecture::Live);
        let (frames, _) = frames(20, BrakingArchitecture::Live);
        let answer = |speed: f64| {
            let speeds = Tensor::full([1, 20], speed, (Kind::Float, Device::Cpu));
            live.forward(&frames, &speeds, false).unwrap().due.double_value(&[0, 0])
        };
        assert!((answer(NO_SPEED) - answer(0.0)).abs() > 1e-4);
    }
}
