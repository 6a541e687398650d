//! The layers that several networks share.
//!
//! Each is built from a source's tensors under PyTorch's names and shapes. A weight is converted to the kind of the
//! input: f32 weights answer a bf16 input in bf16, and their gradients come back in f32, which is all that mixed
//! precision needs.

use tch::Tensor;

use super::{Init, NnError, TensorSource};

/// Which neighbourhood of its input a convolution or a pooling looks at: a square.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Reach {
    pub(crate) kernel: i64,
    pub(crate) stride: i64,
    pub(crate) padding: i64,
}

/// Is shown the output of each convolution and pooling, (B, C, H, W), after its activation.
pub(super) type Watch<'a> = dyn FnMut(&Tensor, Reach) + 'a;

/// The tensor in the kind of `x`; itself if it has that kind.
pub(super) fn in_kind_of(x: &Tensor, tensor: &Tensor) -> Result<Tensor, NnError> {
    let kind = x.kind();
    Ok(if tensor.kind() == kind { tensor.shallow_clone() } else { tensor.f_to_kind(kind)? })
}

/// Joins numbers of one batch: (B, N) and (B, 1) to (B, N + 1); without the second, returns the first.
pub(super) fn beside(x: Tensor, extra: Option<&Tensor>) -> Result<Tensor, NnError> {
    Ok(match extra {
        Some(extra) => Tensor::f_cat(&[&x, &in_kind_of(&x, extra)?], 1)?,
        None => x,
    })
}

/// Weights of a convolution or its input, channels last in memory.
pub(super) fn channels_last(weight: &Tensor) -> Result<Tensor, NnError> {
    Ok(weight.f_permute([0, 2, 3, 1])?.f_contiguous()?.f_permute([0, 3, 1, 2])?)
}

/// A linear layer: (B, inputs) to (B, outputs).
#[derive(Debug)]
pub(super) struct Linear {
    weight: Tensor,
    bias: Tensor,
}

impl Linear {
    pub(super) fn build(source: &mut TensorSource<'_>, name: &str, outputs: i64, inputs: i64) -> Result<Self, NnError> {
        let init = Init::Uniform(inputs);
        Ok(Self {
            weight: source(&format!("{name}.weight"), &[outputs, inputs], init)?,
            bias: source(&format!("{name}.bias"), &[outputs], init)?,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor, NnError> {
        Ok(x.f_linear(&in_kind_of(x, &self.weight)?, Some(&in_kind_of(x, &self.bias)?))?)
    }

    pub(super) fn share(&self) -> Self {
        Self { weight: self.weight.shallow_clone(), bias: self.bias.shallow_clone() }
    }
}

/// A convolution with a bias and a square kernel: (B, inputs, H, W) to (B, outputs, ..).
#[derive(Debug)]
pub(super) struct Convolution {
    weight: Tensor,
    bias: Tensor,
    stride: i64,
    padding: i64,
}

impl Convolution {
    /// `shape`: outputs, inputs and side of the kernel.
    pub(super) fn build(
        source: &mut TensorSource<'_>,
        name: &str,
        [outputs, inputs, kernel]: [i64; 3],
        stride: i64,
        padding: i64,
    ) -> Result<Self, NnError> {
        let init = Init::Uniform(inputs * kernel * kernel);
        Ok(Self {
            weight: source(&format!("{name}.weight"), &[outputs, inputs, kernel, kernel], init)?,
            bias: source(&format!("{name}.bias"), &[outputs], init)?,
            stride,
            padding,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor, NnError> {
        let (weight, bias) = (in_kind_of(x, &self.weight)?, in_kind_of(x, &self.bias)?);
        Ok(x.f_conv2d(&weight, Some(&bias), [self.stride; 2], [self.padding; 2], [1, 1], 1)?)
    }

    pub(super) fn reach(&self) -> Reach {
        Reach { kernel: self.weight.size()[2], stride: self.stride, padding: self.padding }
    }

    pub(super) fn share(&self) -> Self {
        Self { weight: self.weight.shallow_clone(), bias: self.bias.shallow_clone(), ..*self }
    }
}

/// A convolution with a bias along a row, which keeps its length, apart from the stride: (B, inputs, W) to (B, outputs, W).
#[derive(Debug)]
pub(super) struct RowConvolution {
    weight: Tensor,
    bias: Tensor,
    stride: i64,
}

impl RowConvolution {
    /// `shape`: outputs, inputs and length of the kernel.
    pub(super) fn build(
        source: &mut TensorSource<'_>,
        name: &str,
        [outputs, inputs, kernel]: [i64; 3],
        stride: i64,
    ) -> Result<Self, NnError> {
        let init = Init::Uniform(inputs * kernel);
        Ok(Self {
            weight: source(&format!("{name}.weight"), &[outputs, inputs, kernel], init)?,
            bias: source(&format!("{name}.bias"), &[outputs], init)?,
            stride,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor, NnError> {
        let padding = self.weight.size()[2] / 2;
        Ok(x.f_conv1d(&self.weight, Some(&self.bias), [self.stride], [padding], [1], 1)?)
    }

    pub(super) fn share(&self) -> Self {
        Self { weight: self.weight.shallow_clone(), bias: self.bias.shallow_clone(), ..*self }
    }
}

/// A convolution without bias and the batch norm after it: Ioffe and Szegedy, "Batch Normalization", 2015,
/// arXiv:1502.03167.
#[derive(Debug)]
pub(super) struct NormedConvolution {
    weight: Tensor,
    norm: Norm,
    stride: i64,
    padding: i64,
}

#[derive(Debug)]
enum Norm {
    /// As trained, all (outputs,): weight, bias, and the running mean and variance.
    Batch { weight: Tensor, bias: Tensor, mean: Tensor, variance: Tensor },
    /// Already folded into the convolution's weight; the rest to add, (outputs,).
    Folded(Tensor),
}

/// How far a batch moves the running statistics, and the constant that keeps a variance above zero: PyTorch's defaults.
const MOMENTUM: f64 = 0.1;
const EPSILON: f64 = 1e-5;

impl NormedConvolution {
    /// `shape`: outputs, inputs and side of the kernel, which is padded to keep the size, apart from the stride.
    pub(super) fn build(
        source: &mut TensorSource<'_>,
        convolution: &str,
        norm: &str,
        [outputs, inputs, kernel]: [i64; 3],
        stride: i64,
    ) -> Result<Self, NnError> {
        let init = Init::KaimingNormal(outputs * kernel * kernel);
        let weight = source(&format!("{convolution}.weight"), &[outputs, inputs, kernel, kernel], init)?;
        let mut vector = |name: &str, init| source(&format!("{norm}.{name}"), &[outputs], init);
        let norm = Norm::Batch {
            weight: vector("weight", Init::Constant(1.0))?,
            bias: vector("bias", Init::Constant(0.0))?,
            mean: vector("running_mean", Init::Buffer(0.0))?,
            variance: vector("running_var", Init::Buffer(1.0))?,
        };
        Ok(Self { weight, norm, stride, padding: kernel / 2 })
    }

    /// With `train` the batch's own statistics are used, and update the running ones.
    pub(super) fn forward(&self, x: &Tensor, train: bool) -> Result<Tensor, NnError> {
        let weight = in_kind_of(x, &self.weight)?;
        let convolve =
            |bias: Option<&Tensor>| x.f_conv2d(&weight, bias, [self.stride; 2], [self.padding; 2], [1, 1], 1);
        Ok(match &self.norm {
            // libtorch takes f32 statistics for a bf16 input.
            Norm::Batch { weight, bias, mean, variance } => convolve(None)?.f_batch_norm(
                Some(weight),
                Some(bias),
                Some(mean),
                Some(variance),
                train,
                MOMENTUM,
                EPSILON,
                true,
            )?,
            Norm::Folded(bias) => convolve(Some(&in_kind_of(x, bias)?))?,
        })
    }

    pub(super) fn reach(&self) -> Reach {
        Reach { kernel: self.weight.size()[2], stride: self.stride, padding: self.padding }
    }

    /// Folds the batch norm into the convolution, by the running statistics: for inference only.
    pub(super) fn fold(&mut self) -> Result<(), NnError> {
        if let Norm::Batch { weight, bias, mean, variance } = &self.norm {
            let factor = weight.f_divide(&variance.f_add_scalar(EPSILON)?.f_sqrt()?)?; // (outputs,)
            let folded = bias.f_sub(&mean.f_mul(&factor)?)?;
            let kind = self.weight.kind();
            self.weight = self.weight.f_mul(&factor.f_reshape([-1, 1, 1, 1])?)?.f_to_kind(kind)?;
            self.norm = Norm::Folded(folded);
        }
        Ok(())
    }

    pub(super) fn share(&self) -> Self {
        let norm = match &self.norm {
            Norm::Batch { weight, bias, mean, variance } => Norm::Batch {
                weight: weight.shallow_clone(),
                bias: bias.shallow_clone(),
                mean: mean.shallow_clone(),
                variance: variance.shallow_clone(),
            },
            Norm::Folded(bias) => Norm::Folded(bias.shallow_clone()),
        };
        Self { weight: self.weight.shallow_clone(), norm, ..*self }
    }
}
