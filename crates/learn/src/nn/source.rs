//! The source of a network's tensors while it is built.

use tch::{
    Tensor,
    nn::{self, Path},
};

use super::NnError;

/// Gives a network its tensors: called once for each, with name, shape and initialisation, while the network is built.
///
/// A checkpoint looks them up; [`in_variable_store`] makes new ones to train.
pub type TensorSource<'a> = dyn FnMut(&str, &[i64], Init) -> Result<Tensor, NnError> + 'a;

/// How an untrained tensor is initialised, and whether training changes it at all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Init {
    /// Drawn uniformly up to 1 / sqrt(n): PyTorch's default, where n is the number of inputs of a neuron for the
    /// weights and biases of convolutions and linear layers, and the hidden size for all of a GRU.
    Uniform(i64),
    /// Drawn from a normal distribution of variance 2 / n: He et al., "Delving Deep into Rectifiers", 2015,
    /// arXiv:1502.01852. n is the outputs of a convolution times its kernel in the ResNets, as in torchvision, and the
    /// inputs of a neuron in `cps`.
    KaimingNormal(i64),
    /// This number everywhere.
    Constant(f64),
    /// This number everywhere, and no gradient: a running statistic of batch norm.
    Buffer(f64),
}

/// A source of new tensors under `path` for [`Network::build`](super::Network::build): trainable variables, and
/// buffers that the store keeps but does not train, on its device, each as its [`Init`] says. Seed with
/// `tch::manual_seed`.
pub fn in_variable_store<'a>(path: Path<'a>) -> impl FnMut(&str, &[i64], Init) -> Result<Tensor, NnError> + 'a {
    move |name, shape, init| {
        let (layer, kind) = name.rsplit_once('.').unwrap_or(("", name));
        let path = layer.split('.').filter(|part| !part.is_empty()).fold(path.clone(), |path, part| path.sub(part));
        let init = match init {
            Init::Uniform(n) => {
                let up = 1.0 / (n as f64).sqrt();
                nn::Init::Uniform { lo: -up, up }
            }
            Init::KaimingNormal(n) => nn::Init::Randn { mean: 0.0, stdev: (2.0 / n as f64).sqrt() },
            Init::Constant(value) => nn::Init::Const(value),
            Init::Buffer(value) => {
                let mut buffer = path.f_zeros_no_train(kind, shape)?;
                return Ok(buffer.f_fill_(value)?);
            }
        };
        Ok(path.f_var(kind, shape, init)?)
    }
}
