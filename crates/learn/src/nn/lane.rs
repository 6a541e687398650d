//! Where in its lane the camera is: a small network that looks at one picture of any road and says how far it is from the
//! lane's middle, how it is turned against the lane, and how sure it is of either.
//!
//! Six convolutions with batch norm, two linear layers, 309,308 parameters. The picture is first brought to a mean of 0 and
//! a standard deviation of 1, each channel by itself (Ulyanov et al., "Instance Normalization", 2016, arXiv:1607.08022):
//! light and tint do not tell where the lane is.
//!
//! The two answers are means of normal distributions, the other two outputs the logarithms of their variances, which the
//! picture decides: Kendall and Gal, "What Uncertainties Do We Need in Bayesian Deep Learning for Computer Vision?", 2017,
//! arXiv:1703.04977. [`loss`] is their equation 8.

use tch::{Kind, Tensor};

use super::{
    NnError, TensorSource,
    layers::{Linear, NormedConvolution, beside},
};

/// Outputs, inputs, kernel and stride of each convolution.
const CONVOLUTIONS: [[i64; 4]; 6] =
    [[24, 3, 5, 2], [32, 24, 3, 2], [48, 32, 3, 1], [64, 48, 3, 2], [64, 64, 3, 1], [64, 64, 3, 2]];

/// 64 channels of 3 x 10, channel by channel.
const FLAT: i64 = 1920;
const HIDDEN: i64 = 96;

/// The last layer counts headings in units of this many degrees, so that all of its outputs are of the order of 1.
const HEADING_UNIT_DEG: f64 = 5.0;
/// Logarithms of variances are kept within these: standard deviations from 0.01 to 20 units.
const LOG_VARIANCE: (f64, f64) = (-9.2, 6.0);
/// A picture of a single colour stays one.
const LEAST_VARIANCE: f64 = 1e-4;

/// The network. Tensors are `conv1.weight`, `norm1.weight` and so on to `norm6.running_var`, and `fc1.weight` to
/// `fc2.bias`, shaped as PyTorch's.
#[derive(Debug)]
pub struct Lane {
    convolutions: [NormedConvolution; 6],
    hidden: Linear,
    last: Linear,
}

impl Lane {
    /// Channels, rows and columns that it takes.
    pub const INPUT_SHAPE: [usize; 3] = [3, 44, 160];

    /// What it answers: metres right of the lane's middle, degrees clockwise from its direction, and the natural logarithms
    /// of the variances of both, in square metres and square degrees.
    pub const OUTPUTS: [&'static str; 4] = ["offset_m", "heading_deg", "offset_log_variance", "heading_log_variance"];

    pub(super) fn build(speed: bool, source: &mut TensorSource<'_>) -> Result<Self, NnError> {
        let mut convolution = |i: usize| {
            let [outputs, inputs, kernel, stride] = CONVOLUTIONS[i];
            let (convolution, norm) = (format!("conv{}", i + 1), format!("norm{}", i + 1));
            NormedConvolution::build(source, &convolution, &norm, [outputs, inputs, kernel], stride)
        };
        Ok(Self {
            convolutions: [
                convolution(0)?,
                convolution(1)?,
                convolution(2)?,
                convolution(3)?,
                convolution(4)?,
                convolution(5)?,
            ],
            hidden: Linear::build(source, "fc1", HIDDEN, FLAT + i64::from(speed))?,
            last: Linear::build(source, "fc2", Self::OUTPUTS.len() as i64, HIDDEN)?,
        })
    }

    /// (B, 3, 44, 160) and (B, 1) to (B, 4), as [`Lane::OUTPUTS`] has them.
    pub(super) fn forward(&self, frames: &Tensor, speed: Option<&Tensor>, train: bool) -> Result<Tensor, NnError> {
        let mean = frames.f_mean_dim(&[2i64, 3][..], true, None)?; // (B, 3, 1, 1)
        let apart = frames.f_sub(&mean)?;
        let variance = apart.f_square()?.f_mean_dim(&[2i64, 3][..], true, None)?;
        let mut x = apart.f_mul(&variance.f_add_scalar(LEAST_VARIANCE)?.f_rsqrt()?)?; // (B, 3, 44, 160)
        for convolution in &self.convolutions {
            x = convolution.forward(&x, train)?.f_relu()?;
        }
        // (B, 64, 3, 10) to (B, 1920): by channel, whatever the layout in memory.
        // Three significant digits are too few for the sums.
        let x = x.f_flatten(1, -1)?.f_to_kind(Kind::Float)?;
        let x = self.hidden.forward(&beside(x, speed)?)?.f_relu()?;
        let x = self.last.forward(&x)?; // (B, 4)
        let column = |i: i64| x.f_narrow(1, i, 1);
        let log_variance = |i: i64| column(i)?.f_clamp(LOG_VARIANCE.0, LOG_VARIANCE.1);
        let (offset, offset_log) = (column(0)?, log_variance(2)?);
        let heading = column(1)?.f_mul_scalar(HEADING_UNIT_DEG)?;
        let heading_log = log_variance(3)?.f_add_scalar(2.0 * HEADING_UNIT_DEG.ln())?;
        Ok(Tensor::f_cat(&[offset, heading, offset_log, heading_log], 1)?.f_to_kind(frames.kind())?)
    }

    /// Folds the batch norm into the convolutions: for inference only.
    pub(super) fn fold(&mut self) -> Result<(), NnError> {
        self.convolutions.iter_mut().try_for_each(NormedConvolution::fold)
    }

    pub(super) fn share(&self) -> Self {
        Self {
            convolutions: self.convolutions.each_ref().map(NormedConvolution::share),
            hidden: self.hidden.share(),
            last: self.last.share(),
        }
    }
}

/// How unlikely labels (B, 2) are by the answers (B, 4): the mean negative logarithm of their probability densities, but for
/// a constant.
///
/// # Errors
/// [`NnError::Torch`].
pub fn loss(answers: &Tensor, labels: &Tensor) -> Result<Tensor, NnError> {
    let (means, log_variances) = (answers.f_narrow(1, 0, 2)?, answers.f_narrow(1, 2, 2)?);
    let squares = means.f_sub(labels)?.f_square()?;
    let weighted = log_variances.f_neg()?.f_exp()?.f_mul(&squares)?;
    Ok(weighted.f_add(&log_variances)?.f_mul_scalar(0.5)?.f_mean(Kind::Float)?)
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;

    #[test]
    fn the_loss_is_least_where_the_variance_is_that_of_the_errors() {
        let labels = Tensor::from_slice(&[0.5f32, 2.0, -0.5, -2.0]).view([2, 2]);
        let of = |offset_sd: f64, heading_sd: f64| {
            let logs = [2.0 * offset_sd.ln(), 2.0 * heading_sd.ln()].map(|log| log as f32);
            let answers = Tensor::from_slice(&[0.0, 0.0, logs[0], logs[1], 0.0, 0.0, logs[0], logs[1]]).view([2, 4]);
            loss(&answers, &labels).unwrap().double_value(&[])
        };
        let best = of(0.5, 2.0);
        assert!((best - 0.5 * (1.0 + (0.5f64.ln() + 2f64.ln()))).abs() < 1e-6, "{best}");
        for (offset_sd, heading_sd) in [(0.4, 2.0), (0.6, 2.0), (0.5, 1.5), (0.5, 2.5)] {
            assert!(of(offset_sd, heading_sd) > best, "{offset_sd} {heading_sd}");
        }
    }

    #[test]
    fn light_and_tint_do_not_matter() {
        tch::manual_seed(3);
        let store = tch::nn::VarStore::new(Device::Cpu);
        let lane = Lane::build(false, &mut super::super::in_variable_store(store.root())).unwrap();
        let picture = Tensor::rand([1, 3, 44, 160], (Kind::Float, Device::Cpu));
        let tint = Tensor::from_slice(&[0.5f32, 0.7, 1.2]).view([1, 3, 1, 1]);
        let answer = |x: &Tensor| Vec::<f32>::try_from(lane.forward(x, None, false).unwrap().view([-1])).unwrap();
        let (plain, tinted) = (answer(&picture), answer(&(&picture * tint + 0.1)));
        for (a, b) in plain.iter().zip(&tinted) {
            assert!((a - b).abs() < 1e-2, "{plain:?} {tinted:?}");
        }
    }
}
