//! A model that is a network of this crate, from a checkpoint.

use std::fmt;

use tch::Tensor;

use super::ModelError;
use crate::nn::{Checkpoint, Memory, Network, NnError};
use lapwing_core::{
    perception::{Frame, Preprocess, Preprocessor},
    pilot::{Pilot, PilotError, Prediction, View},
    units::{Clock, Mph},
};

/// The name of a driving network's first output.
const STEERING: &str = "steering";

/// Steers by the first output of a [`Network`]. Others, the acceleration of `cps`, are not used: throttle is
/// `control`'s.
#[derive(Debug)]
pub struct NetworkPilot {
    eye: Eye,
    network: Network,
    /// Memory of this run's frames; not shared with other pilots.
    memory: Memory,
}

impl NetworkPilot {
    /// Makes a pilot from a checkpoint and warms it up.
    ///
    /// # Errors
    /// [`ModelError::NotSteering`], and those of an answer to a blank picture.
    pub fn new(checkpoint: Checkpoint, clock: Clock) -> Result<Self, ModelError> {
        let Checkpoint { metadata, network, .. } = checkpoint;
        let mut eye = Eye::new(metadata.preprocess, &metadata.outputs, clock)?;
        let mut memory = Memory::default();
        eye.warm_up(|input| answer(&network, input, Mph::ZERO, &mut memory))?;
        memory.clear();
        Ok(Self { eye, network, memory })
    }

    /// The network, with the same weights.
    pub fn network(&self) -> Network {
        self.network.share()
    }

    /// Another pilot with the same weights and nothing else in common.
    pub fn share(&self) -> Self {
        Self { eye: self.eye.clone(), network: self.network.share(), memory: Memory::default() }
    }
}

impl Pilot for NetworkPilot {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        let Self { eye, network, memory } = self;
        eye.steer(view.frame, |input| answer(network, input, view.speed, memory))
    }

    fn reset(&mut self) {
        self.memory.clear();
    }
}

/// Answers one frame, with the speed for a network that takes it.
fn answer(network: &Network, input: &Tensor, speed: Mph, memory: &mut Memory) -> Result<Tensor, NnError> {
    network.answer(input, network.speed_input(speed)?.as_ref(), memory)
}

/// What pilots of every kind of network have in common: from a frame through any forward pass to a prediction.
#[derive(Clone)]
pub(super) struct Eye {
    preprocessor: Preprocessor,
    /// What each number of an answer is, the steering first.
    outputs: Vec<String>,
    /// (C, H, W) f32, flat.
    input: Vec<f32>,
    clock: Clock,
}

impl fmt::Debug for Eye {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Eye").field("preprocess", self.preprocessor.preprocess()).finish_non_exhaustive()
    }
}

impl Eye {
    pub(super) fn new(preprocess: Preprocess, outputs: &[String], clock: Clock) -> Result<Self, ModelError> {
        if outputs.first().is_none_or(|first| first != STEERING) {
            return Err(ModelError::NotSteering(outputs.to_vec()));
        }
        let preprocessor = Preprocessor::new(preprocess).map_err(PilotError::from)?;
        Ok(Self { preprocessor, outputs: outputs.to_vec(), input: Vec::new(), clock })
    }

    pub(super) fn outputs(&self) -> &[String] {
        &self.outputs
    }

    pub(super) fn preprocess(&self) -> &Preprocess {
        self.preprocessor.preprocess()
    }

    /// Shows blank pictures, black, grey, white and black again, of the stock simulator's size or as high as the crop asks for.
    /// Afterwards libtorch has chosen and compiled its kernels (TorchScript does so on the second pass), so the first
    /// frame is answered as fast as the others, and a network that does not answer correctly is reported now.
    /// Returns the steering for the first picture, and for the same one after the others.
    pub(super) fn warm_up(
        &mut self,
        mut forward: impl FnMut(&Tensor) -> Result<Tensor, NnError>,
    ) -> Result<[f64; 2], PilotError> {
        let [width, height] = self.preprocess().picture_size();
        let mut answer = |shade| {
            let blank = Frame::new(width, height, vec![shade; width * height * 3]);
            let blank = blank.expect("there are three bytes for each pixel");
            self.steer(&blank, &mut forward).map(|answer| answer.steering)
        };
        let first = answer(0)?;
        answer(128)?;
        answer(255)?;
        Ok([first, answer(0)?])
    }

    pub(super) fn steer(
        &mut self,
        frame: &Frame,
        forward: impl FnMut(&Tensor) -> Result<Tensor, NnError>,
    ) -> Result<Prediction, PilotError> {
        let begin = (self.clock)();
        self.preprocessor.apply(frame, &mut self.input)?;
        let preprocessed = (self.clock)();
        let steering = self.answer(forward)?;
        Ok(Prediction {
            steering,
            preprocess: preprocessed - begin,
            forward: (self.clock)() - preprocessed,
            ..Prediction::default()
        })
    }

    /// The first number that `forward` computes from the input, if there are as many as outputs and all are finite.
    fn answer(&self, mut forward: impl FnMut(&Tensor) -> Result<Tensor, NnError>) -> Result<f64, PilotError> {
        let shape = self.preprocess().tensor_shape().map(|n| n as i64);
        tch::no_grad(|| {
            // (1, C, H, W) or (1, H, W, C) f32
            let input = torch(Tensor::f_from_slice(&self.input).and_then(|t| t.f_view(shape)))?;
            let output = forward(&input).map_err(failed)?;
            if output.numel() != self.outputs.len() {
                return Err(PilotError::OutputShape { outputs: self.outputs.clone(), got: output.size() });
            }
            let output = torch(output.f_reshape([-1]))?; // (outputs,)
            for (i, name) in self.outputs.iter().enumerate() {
                let got = torch(output.f_double_value(&[i as i64]))?;
                if !got.is_finite() {
                    return Err(PilotError::NotFinite { output: name.clone(), got });
                }
            }
            torch(output.f_double_value(&[0]))
        })
    }
}

fn torch<T>(result: Result<T, tch::TchError>) -> Result<T, PilotError> {
    result.map_err(|error| failed(error.into()))
}

fn failed(error: NnError) -> PilotError {
    PilotError::Network(Box::new(error))
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use tch::{Device, Kind, nn::VarStore};

    use super::*;
    use crate::nn::{Architecture, Design, Metadata, Precision, encode, in_variable_store};

    fn eye() -> Eye {
        let preprocess = serde_json::from_str(
            r#"{"resize":{"height":2,"width":2,"filter":"bilinear-antialiased"},"colour":"rgb","scale":"x/255","layout":"nchw"}"#,
        );
        Eye::new(preprocess.unwrap(), &["steering".into()], Instant::now).unwrap()
    }

    fn frame() -> Frame {
        Frame::new(2, 2, vec![51; 12]).unwrap()
    }

    #[test]
    fn the_steering_is_one_number_in_whatever_shape() {
        for shape in [vec![], vec![1], vec![1, 1], vec![1, 1, 1]] {
            let output = |input: &Tensor| Ok(input.mean(Kind::Float).expand(shape.clone(), false));
            let prediction = eye().steer(&frame(), output).unwrap();
            assert!((prediction.steering - 0.2).abs() < 1e-6, "{shape:?} {prediction:?}");
        }
    }

    #[test]
    fn an_answer_of_another_shape_than_the_outputs_is_an_error() {
        let error = |outputs: &[&str], shape: &[i64]| {
            let outputs: Vec<String> = outputs.iter().map(|name| (*name).to_owned()).collect();
            let mut eye = Eye::new(eye().preprocess().clone(), &outputs, Instant::now).unwrap();
            let answer = |_: &Tensor| Ok(Tensor::zeros(shape, (Kind::Float, Device::Cpu)));
            eye.steer(&frame(), answer).map(|prediction| prediction.steering).map_err(|error| error.to_string())
        };
        assert_eq!(
            error(&["steering"], &[1, 3]).unwrap_err(),
            "expected 1 number from the network for its outputs steering, got a tensor of shape [1, 3]: name all of its numbers in outputs"
        );
        assert_eq!(
            error(&["steering", "acceleration"], &[1, 1]).unwrap_err(),
            "expected 2 numbers from the network for its outputs steering, acceleration, got a tensor of shape [1, 1]: name all of its numbers in outputs"
        );
        assert!(error(&["steering"], &[1, 0]).unwrap_err().contains("got a tensor of shape [1, 0]"));
        assert_eq!(error(&["steering", "acceleration"], &[1, 2]), Ok(0.0));
    }

    #[test]
    fn an_answer_that_is_no_number_is_an_error() {
        let error = |value: f64| eye().steer(&frame(), |_| Ok(Tensor::from(value))).unwrap_err().to_string();
        assert_eq!(error(f64::NAN), "expected a finite steering from the network, got NaN");
        assert_eq!(error(f64::INFINITY), "expected a finite steering from the network, got inf");
        let outputs = ["steering".to_owned(), "acceleration".to_owned()];
        let mut both = Eye::new(eye().preprocess().clone(), &outputs, Instant::now).unwrap();
        let answer = |_: &Tensor| Ok(Tensor::from_slice(&[0.1, f64::NAN]).unsqueeze(0));
        let error = both.steer(&frame(), answer).unwrap_err().to_string();
        assert_eq!(error, "expected a finite acceleration from the network, got NaN");
    }

    #[test]
    fn a_network_for_something_else_does_not_drive() {
        let preprocess = eye().preprocess().clone();
        let error = Eye::new(preprocess, &["brake".into()], Instant::now).unwrap_err();
        assert_eq!(error.to_string(), r#"expected a network whose first output is steering, got ["brake"]"#);
    }

    /// A pilot of new weights, drawn the same each time.
    fn pilot(architecture: Architecture, speed: bool) -> NetworkPilot {
        tch::manual_seed(1);
        let design = Design { speed, ..Design::of(architecture) };
        let store = VarStore::new(Device::Cpu);
        let network = Network::build(&design, &mut in_variable_store(store.root())).unwrap();
        let metadata = Metadata {
            preprocess: design.preprocess,
            outputs: architecture.outputs().iter().map(|name| (*name).to_owned()).collect(),
            training: String::new(),
            result: String::new(),
        };
        let bytes = encode(&metadata, &network, Precision::F32).unwrap();
        NetworkPilot::new(Checkpoint::from_bytes(&bytes).unwrap(), Instant::now).unwrap()
    }

    fn road(shade: u8) -> Frame {
        Frame::new(320, 160, (0..320 * 160 * 3).map(|i| shade.wrapping_add((i / 961 % 97) as u8)).collect()).unwrap()
    }

    #[test]
    fn a_pilot_that_remembers_begins_anew_after_a_reset_and_shares_no_memory() {
        for architecture in [Architecture::ResNet18Gru, Architecture::ResNet18Stack] {
            let mut pilot = pilot(architecture, false);
            let steer = |pilot: &mut NetworkPilot, shade| pilot.steer(&View::of(&road(shade))).unwrap().steering;
            let first = steer(&mut pilot, 20);
            steer(&mut pilot, 150);
            assert_ne!(steer(&mut pilot, 20), first, "{}", architecture.name());
            assert_eq!(steer(&mut pilot.share(), 20), first, "{}", architecture.name());
            pilot.reset();
            assert_eq!(steer(&mut pilot, 20), first, "{}", architecture.name());
        }
    }

    #[test]
    fn the_speed_counts_for_a_network_that_takes_it_and_for_no_other() {
        for takes_speed in [false, true] {
            let mut pilot = pilot(Architecture::Cps, takes_speed);
            let mut steer = |mph| {
                let frame = road(20);
                let view = View { speed: Mph::new(mph).unwrap(), ..View::of(&frame) };
                pilot.steer(&view).unwrap().steering
            };
            assert_eq!(steer(30.0) != steer(10.0), takes_speed);
        }
    }
}
