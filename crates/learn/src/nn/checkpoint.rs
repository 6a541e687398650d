//! A checkpoint: one self-describing `.safetensors` file.
//!
//! The tensors are those of an architecture, in f32, f16 or bf16, under the names in its file in this module. The
//! header's metadata, all text, has these keys; all but `inputs` are required:
//!
//! | key | holds |
//! |---|---|
//! | `format` | `lapwing/1` |
//! | `architecture` | a name out of [`Architecture::ALL`] |
//! | `preprocess` | JSON of [`Preprocess`] |
//! | `inputs` | JSON of what goes in, `{"frames":5,"speed":true}`; one frame and no speed if absent |
//! | `outputs` | JSON list of what each output is, `["steering"]` |
//! | `training` | how it was trained and on what: text or JSON, for people |
//! | `result` | how good it is, by which measure: text or JSON, for people |
//!
//! Other keys are ignored.

use std::{collections::BTreeMap, fs, path::Path};

use safetensors::{
    Dtype, SafeTensors,
    tensor::{Metadata as TensorTable, TensorInfo, TensorView},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use tch::{Device, Kind, Tensor};

use super::{Architecture, Design, Network, NnError};
use lapwing_core::{files, hash::sha256, perception::Preprocess};

/// The value of the metadata key `format`.
pub const FORMAT: &str = "lapwing/1";

/// How many bits numbers have: those stored, or those a training passes through the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Precision {
    /// 32: as they are.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    #[default]
    F32,
    /// 16, of which 8 are the exponent's: three significant digits in half the bytes. Vectors (biases and batch norm)
    /// are stored in 32; they are a thousandth of the file.
    #[cfg_attr(feature = "clap", value(help = None::<&str>))]
    Bf16,
}

/// A network's inputs that the architecture's name does not determine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CheckpointInputs {
    frames: usize,
    speed: bool,
}

/// What a checkpoint says about its network.
#[derive(Debug, Clone, PartialEq)]
pub struct Metadata {
    /// What was done to the pictures that it was trained on.
    pub preprocess: Preprocess,
    /// What each of its outputs is.
    pub outputs: Vec<String>,
    /// How it was trained and on what, for people.
    pub training: String,
    /// How good it is, for people.
    pub result: String,
}

/// A network as it was read.
#[derive(Debug)]
pub struct Checkpoint {
    /// What the file says about it.
    pub metadata: Metadata,
    /// The network, on the CPU, laid out for inference; no gradients are tracked.
    pub network: Network,
    /// SHA-256 of the file in lower-case hexadecimal: a run names its model by it.
    pub sha256: String,
}

impl Checkpoint {
    /// Reads a file.
    ///
    /// # Errors
    /// [`NnError::Read`], and those of [`Checkpoint::from_bytes`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self, NnError> {
        let path = path.as_ref();
        let bytes = fs::read(path).map_err(|source| NnError::Read { path: path.to_owned(), source })?;
        Self::from_bytes(&bytes)
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// [`NnError`], naming what is missing, surplus or unexpected.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, NnError> {
        let file = SafeTensors::deserialize(bytes).map_err(NnError::NotSafetensors)?;
        let (_, table) = SafeTensors::read_metadata(bytes).map_err(NnError::NotSafetensors)?;
        let get = |key: &'static str| {
            table.metadata().as_ref().and_then(|m| m.get(key)).map(String::as_str).ok_or(NnError::MissingKey(key))
        };
        let format = get("format")?;
        if format != FORMAT {
            return Err(NnError::Format(format.to_owned()));
        }
        let name = get("architecture")?;
        let architecture =
            Architecture::named(name).ok_or_else(|| NnError::UnknownArchitecture { got: name.to_owned() })?;
        let metadata = Metadata {
            preprocess: json("preprocess", get("preprocess")?)?,
            outputs: json("outputs", get("outputs")?)?,
            training: get("training")?.to_owned(),
            result: get("result")?.to_owned(),
        };
        let inputs = match get("inputs") {
            Ok(text) => json("inputs", text)?,
            Err(_) => CheckpointInputs { frames: 1, speed: false },
        };
        if inputs.frames != architecture.frames() {
            return Err(NnError::Frames { architecture, got: inputs.frames });
        }
        let design = Design { architecture, preprocess: metadata.preprocess.clone(), speed: inputs.speed };
        metadata.check(&design)?;

        let mut surplus = file.names();
        let network = Network::build(&design, &mut |name, shape, _| {
            surplus.retain(|n| *n != name);
            read_tensor(&file, name, shape)
        })?;
        if let Some(name) = surplus.into_iter().min() {
            return Err(NnError::SurplusTensor { architecture, name: name.to_owned() });
        }
        Ok(Self { metadata, network: network.for_inference()?, sha256: sha256(bytes) })
    }
}

impl Metadata {
    /// Checks that preprocessing and outputs are those of the design.
    fn check(&self, design: &Design) -> Result<(), NnError> {
        design.validate()?;
        if self.preprocess != design.preprocess {
            return Err(NnError::OtherPreprocess);
        }
        let architecture = design.architecture;
        let expected = architecture.outputs().len();
        if expected != self.outputs.len() {
            return Err(NnError::Outputs { architecture, expected, got: self.outputs.clone() });
        }
        Ok(())
    }
}

pub(crate) fn json<T: DeserializeOwned>(key: &'static str, text: &str) -> Result<T, NnError> {
    serde_json::from_str(text).map_err(|why| NnError::Metadata { key, why })
}

/// A tensor of the file as f32, if it is the one expected.
pub(super) fn read_tensor(file: &SafeTensors<'_>, name: &str, shape: &[i64]) -> Result<Tensor, NnError> {
    let view =
        file.tensor(name).map_err(|_| NnError::MissingTensor { name: name.to_owned(), expected: shape.to_vec() })?;
    tensor_of(&view, name, shape)
}

/// A tensor as f32, if it has the shape expected and floating-point numbers, all of them finite.
pub(crate) fn tensor_of(view: &TensorView<'_>, name: &str, shape: &[i64]) -> Result<Tensor, NnError> {
    if !view.shape().iter().map(|n| *n as i64).eq(shape.iter().copied()) {
        return Err(NnError::Shape { name: name.to_owned(), expected: shape.to_vec(), got: view.shape().to_vec() });
    }
    let kind = match view.dtype() {
        Dtype::F32 => Kind::Float,
        Dtype::F16 => Kind::Half,
        Dtype::BF16 => Kind::BFloat16,
        got => return Err(NnError::Dtype { name: name.to_owned(), got }),
    };
    let tensor = Tensor::f_from_data_size(view.data(), shape, kind)?.f_to_kind(Kind::Float)?;
    let finite = tensor.f_isfinite()?.f_sum(Kind::Int64)?.f_int64_value(&[])?;
    match tensor.numel() as i64 - finite {
        0 => Ok(tensor),
        count => Err(NnError::NotFinite { name: name.to_owned(), count }),
    }
}

/// The header in a fixed order: the same network gives the same bytes, and so the same hash.
#[derive(Serialize)]
struct CheckpointHeader<'a> {
    #[serde(rename = "__metadata__")]
    metadata: BTreeMap<&'a str, &'a str>,
    #[serde(flatten)]
    tensors: TensorTable,
}

/// The bytes of a checkpoint.
///
/// # Errors
/// [`NnError`] if the metadata does not match the network's design or libtorch does not return a tensor.
pub fn encode(metadata: &Metadata, network: &Network, precision: Precision) -> Result<Vec<u8>, NnError> {
    let architecture = network.architecture();
    metadata.check(network.design())?;
    let preprocess = serde_json::to_string(&metadata.preprocess).expect("preprocessing is valid JSON");
    let outputs = serde_json::to_string(&metadata.outputs).expect("a list of text is valid JSON");
    let inputs = CheckpointInputs { frames: architecture.frames(), speed: network.design().speed };
    let inputs = serde_json::to_string(&inputs).expect("a number and a truth are valid JSON");
    let header = BTreeMap::from([
        ("format", FORMAT),
        ("architecture", architecture.name()),
        ("preprocess", &preprocess),
        ("inputs", &inputs),
        ("outputs", &outputs),
        ("training", &metadata.training),
        ("result", &metadata.result),
    ]);
    encode_tensors(header, network.tensors(), precision)
}

/// The bytes of a file with this header and these tensors.
pub(crate) fn encode_tensors(
    metadata: BTreeMap<&str, &str>,
    tensors: Vec<(String, Tensor)>,
    precision: Precision,
) -> Result<Vec<u8>, NnError> {
    let mut infos = Vec::new();
    let mut data = Vec::new();
    for (name, tensor) in tensors {
        let shape: Vec<usize> = tensor.size().into_iter().map(|n| n as usize).collect();
        let dtype = if precision == Precision::Bf16 && shape.len() > 1 { Dtype::BF16 } else { Dtype::F32 };
        let mut tensor = tensor.f_detach()?.f_to_device(Device::Cpu)?;
        if dtype == Dtype::BF16 {
            tensor = tensor.f_to_kind(Kind::BFloat16)?;
        }
        let tensor = tensor.f_to_kind(Kind::Float)?.f_contiguous()?;
        let mut values = vec![0f32; tensor.numel()];
        tensor.f_copy_data(&mut values, tensor.numel())?;
        let begin = data.len();
        match dtype {
            // Rounded above, so that the lower half is zero.
            Dtype::BF16 => data.extend(values.into_iter().flat_map(|v| ((v.to_bits() >> 16) as u16).to_le_bytes())),
            _ => data.extend(values.into_iter().flat_map(f32::to_le_bytes)),
        }
        infos.push((name, TensorInfo { dtype, shape, data_offsets: (begin, data.len()) }));
    }
    let tensors = TensorTable::new(None, infos).map_err(NnError::NotSafetensors)?;
    let mut header = serde_json::to_vec(&CheckpointHeader { metadata, tensors }).expect("a header is valid JSON");
    // The format requires the data to begin at a multiple of eight bytes.
    header.resize(header.len().next_multiple_of(8), b' ');
    Ok([&(header.len() as u64).to_le_bytes()[..], &header, &data].concat())
}

/// Writes a checkpoint and returns its SHA-256. A file of that name is replaced once the new one is whole.
///
/// # Errors
/// [`NnError::Write`], and those of [`encode`].
pub fn save(
    path: impl AsRef<Path>,
    metadata: &Metadata,
    network: &Network,
    precision: Precision,
) -> Result<String, NnError> {
    let path = path.as_ref();
    let bytes = encode(metadata, network, precision)?;
    files::write(path, &bytes).map_err(|source| NnError::Write { path: path.to_owned(), source })?;
    Ok(sha256(&bytes))
}

#[cfg(test)]
mod tests;
