//! Converts the team's first PilotNet, weights under PyTorch's names and
//! preprocessing in words, to a checkpoint of this project:
//!
//! ```text
//! cargo run --release --example convert_parity -- pilotnet-lake.safetensors models/pilotnet.safetensors
//! ```

use std::{env, error::Error};

use lapwing::nn::{Architecture, Design, Metadata, Network, NnError, Precision, save};
use tch::Tensor;

const TRAINING: &str = "PyTorch 2.13; the first 2000 rows of a real manual drive on the lake track; left and right \
                        cameras with +-0.15, flips; 8 epochs";
const RESULT: &str = "agrees with PyTorch: forward pass within 1e-5, JPEG to steering within 0.01 on 30 frames; \
                      steering error and closed loop not measured";

fn main() -> Result<(), Box<dyn Error>> {
    let [_, from, to] = &env::args().collect::<Vec<_>>()[..] else {
        return Err("expected two arguments: the file to convert and the one to write".into());
    };
    let tensors = Tensor::read_safetensors(from)?;
    let design = Design::of(Architecture::PilotNet);
    let network = Network::build(&design, &mut |name, shape, _| {
        let found = tensors.iter().find(|(n, t)| n == name && t.size() == shape);
        let missing = || NnError::MissingTensor { name: name.to_owned(), expected: shape.to_vec() };
        found.map(|(_, tensor)| tensor.shallow_clone()).ok_or_else(missing)
    })?;
    let metadata = Metadata {
        preprocess: design.preprocess.clone(),
        outputs: vec!["steering".into()],
        training: TRAINING.into(),
        result: RESULT.into(),
    };
    println!("{}", save(to, &metadata, &network, Precision::F32)?);
    Ok(())
}
