//! A network that tells real pictures from drawn ones.
//!
//! It judges windows of [`WINDOW`] x [`WINDOW`] pixels, every [`STRIDE`] pixels one, each by itself; a picture is what the
//! mean over its windows says (Isola et al., "Image-to-Image Translation with Conditional Adversarial Networks", 2017,
//! arXiv:1611.07004, section 3.2.2). So it can be asked about any part of the picture, and shows by which parts it tells.

use std::fmt;

use anyhow::Result;
use tch::{
    Device, Kind, Reduction, Tensor,
    nn::{self, ModuleT, OptimizerConfig},
};

use crate::pairs::Pair;

/// Pixels along a side of what one answer of the network sees.
const WINDOW: i64 = 33;
/// Pixels between two windows.
pub const STRIDE: usize = 8;
/// Windows across and down.
pub const WINDOWS: (usize, usize) = (320 / STRIDE, 160 / STRIDE);
/// Pictures in a step of the training, half of them drawn.
const BATCH: i64 = 8;
/// Step width of Adam at the beginning; it falls to 0 in a straight line.
const RATE: f64 = 2e-3;

/// Parts of the picture that it is asked about: name, and columns and rows in pixels.
const REGIONS: [(&str, [i64; 4]); 4] = [
    ("whole picture", [0, 320, 0, 160]),
    ("above the horizon", [0, 320, 0, 64]),
    ("road, without bonnet", [64, 256, 72, 136]),
    ("bonnet", [96, 224, 136, 160]),
];

/// The network.
pub struct Judge {
    net: nn::SequentialT,
    _variables: nn::VarStore,
}

/// (B, 3, 160, 320) f32 in [-1, 1], and (B,) 1 for drawn ones.
fn batch(pairs: &[&Pair], which: &[(usize, usize)]) -> Result<(Tensor, Tensor)> {
    let pictures: Vec<Tensor> = which
        .iter()
        .map(|&(pair, kind)| Tensor::from_slice(pairs[pair].frames[kind].rgb()).view([160, 320, 3]))
        .collect();
    let pixels = Tensor::f_stack(&pictures, 0)?.permute([0, 3, 1, 2]).to_kind(Kind::Float) / 127.5 - 1.0;
    let drawn: Vec<f32> = which.iter().map(|&(_, kind)| kind as f32).collect();
    Ok((pixels, Tensor::from_slice(&drawn)))
}

impl Judge {
    /// Trains it on the learnt places.
    pub fn train(pairs: &[Pair], passes: usize, seed: i64) -> Result<Self> {
        tch::manual_seed(seed);
        let variables = nn::VarStore::new(Device::Cpu);
        let root = variables.root();
        let mut net = nn::seq_t();
        for (i, [inputs, outputs, kernel, stride]) in
            [[3, 16, 5, 2], [16, 32, 3, 2], [32, 48, 3, 2], [48, 48, 3, 1]].into_iter().enumerate()
        {
            let config = nn::ConvConfig { stride, padding: kernel / 2, bias: false, ..Default::default() };
            net = net
                .add(nn::conv2d(&root / format!("conv{i}"), inputs, outputs, kernel, config))
                .add(nn::batch_norm2d(&root / format!("norm{i}"), outputs, Default::default()))
                .add_fn(Tensor::relu);
        }
        net = net.add(nn::conv2d(&root / "last", 48, 1, 1, Default::default()));
        let learnt: Vec<&Pair> = pairs.iter().filter(|pair| pair.learnt()).collect();
        let all: Vec<(usize, usize)> = (0..learnt.len()).flat_map(|pair| [(pair, 0), (pair, 1)]).collect();
        let mut adam = nn::Adam::default().build(&variables, RATE)?;
        let steps = (all.len() as i64 / BATCH).max(1);
        for pass in 0..passes {
            let order = Vec::<i64>::try_from(Tensor::randperm(all.len() as i64, (Kind::Int64, Device::Cpu)))?;
            let mut sum = 0.0;
            for (step, some) in order.chunks(BATCH as usize).take(steps as usize).enumerate() {
                let done = (pass as i64 * steps + step as i64) as f64 / (passes as i64 * steps) as f64;
                adam.set_lr(RATE * (1.0 - done));
                let which: Vec<(usize, usize)> = some.iter().map(|&i| all[i as usize]).collect();
                let (pictures, drawn) = batch(&learnt, &which)?;
                let answers = net.forward_t(&pictures, true); // (B, 1, 20, 40), positive for drawn
                let expected = drawn.view([-1, 1, 1, 1]).expand_as(&answers);
                let loss =
                    answers.f_binary_cross_entropy_with_logits::<Tensor>(&expected, None, None, Reduction::Mean)?;
                adam.backward_step(&loss);
                sum += loss.double_value(&[]);
            }
            println!("pass {}: loss of a window {:.3}", pass + 1, sum / steps as f64);
        }
        Ok(Self { net, _variables: variables })
    }

    /// Asks it about the held-out places.
    pub fn verdict(&self, pairs: &[Pair]) -> Result<Verdict> {
        let asked: Vec<&Pair> = pairs.iter().filter(|pair| pair.held_out()).collect();
        let mut answers = Vec::new();
        for pair in 0..asked.len() {
            let (pictures, drawn) = batch(&asked, &[(pair, 0), (pair, 1)])?;
            let sign = (drawn * 2.0 - 1.0).view([-1, 1, 1, 1]);
            answers.push(tch::no_grad(|| self.net.forward_t(&pictures, false) * sign)); // positive where it is right
        }
        let right = Tensor::f_cat(&answers, 0)?; // (N, 1, 20, 40)
        let share = |of: &Tensor| of.gt(0.0).to_kind(Kind::Float).mean(Kind::Float).double_value(&[]);
        let stride = STRIDE as i64;
        let regions = REGIONS.iter().map(|&(_, [left, end, top, bottom])| {
            let part = right.slice(2, top / stride, bottom / stride, 1).slice(3, left / stride, end / stride, 1);
            [share(&part.mean_dim([1i64, 2, 3].as_slice(), false, Kind::Float)), share(&part)]
        });
        let regions = regions.collect();
        let map = right.gt(0.0).to_kind(Kind::Float).mean_dim([0i64, 1].as_slice(), false, Kind::Float);
        let map = Vec::<f32>::try_from(map.contiguous().view([-1]))?;
        Ok(Verdict { regions, map })
    }
}

/// How often the network was right on held-out places.
pub struct Verdict {
    /// For each region: of the pictures, and of single windows.
    regions: Vec<[f64; 2]>,
    /// For each window, row by row: how often it was right.
    pub map: Vec<f32>,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "told apart on held-out places  pictures  windows of {WINDOW}x{WINDOW} pixels")?;
        for ((name, _), [pictures, windows]) in REGIONS.iter().zip(&self.regions) {
            writeln!(f, "{name:29} {pictures:9.3} {windows:8.3}")?;
        }
        Ok(())
    }
}
