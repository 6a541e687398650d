//! A network made elsewhere: an ONNX model, and a [`SideFile`](super::SideFile) beside it.
//!
//! `model.onnx` is what `keras.Model.export`, `tf2onnx` or `torch.onnx.export` wrote; it takes one input of
//! [`Preprocess::tensor_shape`](lapwing_core::perception::Preprocess::tensor_shape) in f32 and answers tensors of as many numbers as there are outputs, the steering first.
//!
//! ONNX Runtime is a shared library that is loaded with the first model: the one that `ORT_DYLIB_PATH` names, that of
//! [`use_library`], or the one that the system's loader finds. An ONNX model holds no code, but the library is code: it is
//! never named by a file that others may have written.

use std::{
    env,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, OnceLock, PoisonError},
};

use ort::{
    environment::Environment,
    session::Session,
    value::{TensorElementType, TensorRef, ValueType},
};
use tch::Tensor;

use super::{ModelError, elsewhere::Forward};
use crate::nn::{NnError, first_line};

/// The environment variable that names ONNX Runtime's library, as in ONNX Runtime's other bindings for Rust.
pub const LIBRARY: &str = "ORT_DYLIB_PATH";

static NAMED: OnceLock<PathBuf> = OnceLock::new();
static ENVIRONMENT: OnceLock<Environment> = OnceLock::new();

/// Names the library for the whole process, unless one is named already. Only what the user says may get here.
pub fn use_library(path: &Path) {
    let _ = NAMED.set(path.to_owned());
}

/// Loads a model of `bytes`, those of the file `path`, which is to take inputs of this shape. All pilots share it, and therefore
/// answer one after the other, each on one thread of the CPU.
///
/// # Errors
/// [`ModelError::OnnxWeights`], [`ModelError::NoOnnxRuntime`], [`ModelError::Onnx`], [`ModelError::OnnxInput`].
pub(super) fn load(path: &Path, bytes: &[u8], expected: [usize; 4]) -> Result<Mutex<Session>, ModelError> {
    let path = || path.to_owned();
    if has_weights_elsewhere(bytes) {
        return Err(ModelError::OnnxWeights { path: path() });
    }
    let environment = environment().map_err(|why| ModelError::NoOnnxRuntime { path: path(), why })?;
    let session = session(environment, bytes).map_err(|why| ModelError::Onnx { path: path(), why })?;
    check_input(&session, expected).map_err(|got| ModelError::OnnxInput { path: path(), expected, got })?;
    Ok(Mutex::new(session))
}

/// Whether a tensor names the file that has its numbers: an entry of the key `location`, as protobuf writes it.
fn has_weights_elsewhere(bytes: &[u8]) -> bool {
    const KEY: &[u8] = b"\x0a\x08location\x12";
    bytes.windows(KEY.len()).any(|window| window == KEY)
}

/// ONNX Runtime, loaded once; or why it cannot be.
fn environment() -> Result<&'static Environment, String> {
    if let Some(environment) = ENVIRONMENT.get() {
        return Ok(environment);
    }
    let named = env::var_os(LIBRARY).filter(|path| !path.is_empty()).map(PathBuf::from);
    let found = format!("{}onnxruntime{}", env::consts::DLL_PREFIX, env::consts::DLL_SUFFIX);
    let path = named.or_else(|| NAMED.get().cloned()).unwrap_or_else(|| found.into());
    let built =
        ort::init_from(&path).map_err(|why| why.to_string())?.build().map_err(|why| first_line(&why.to_string()))?;
    Ok(ENVIRONMENT.get_or_init(|| built))
}

fn session(environment: &Environment, bytes: &[u8]) -> Result<Session, String> {
    let builder = Session::builder(environment).map_err(|why| first_line(&why.to_string()))?;
    // As PilotNet: the operations are so short that threads wait for each other.
    let mut builder = builder.with_intra_threads(1).map_err(|why| first_line(&why.to_string()))?;
    builder.commit_from_memory(bytes).map_err(|why| first_line(&why.to_string()))
}

/// Whether the model has one input that takes this shape; what it has instead.
fn check_input(session: &Session, expected: [usize; 4]) -> Result<(), String> {
    let [input] = session.inputs() else { return Err(format!("{} inputs", session.inputs().len())) };
    match input.dtype() {
        ValueType::Tensor { ty: TensorElementType::Float32, shape, .. }
            if shape.len() == expected.len()
                // -1 is of any size.
                && shape.iter().zip(expected).all(|(got, expected)| *got < 0 || *got == expected as i64) =>
        {
            Ok(())
        }
        ValueType::Tensor { ty, shape, .. } => Err(format!("{:?} {ty:?}", &shape[..])),
        other => Err(format!("{other:?}")),
    }
}

impl Forward for Mutex<Session> {
    /// All numbers of all tensors that the model answers: (outputs).
    fn forward(&self, input: &Tensor) -> Result<Tensor, NnError> {
        let shape = input.size();
        let mut numbers = vec![0f32; input.numel()];
        input.f_copy_data(&mut numbers, input.numel())?;
        let wrong = |why: ort::Error| NnError::Onnx(first_line(&why.to_string()));
        let input = TensorRef::from_array_view((shape, &numbers[..])).map_err(wrong)?;
        let mut session = self.lock().unwrap_or_else(PoisonError::into_inner);
        let answered = session.run(ort::inputs![input]).map_err(wrong)?;
        let mut all = Vec::new();
        for (_, output) in answered.iter() {
            all.extend_from_slice(output.try_extract_tensor::<f32>().map_err(wrong)?.1);
        }
        Ok(Tensor::f_from_slice(&all)?)
    }

    fn afresh(self: Arc<Self>) -> Result<Arc<dyn Forward>, ModelError> {
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_in_a_second_file_are_refused_with_what_to_do() {
        // A tensor as torch.onnx.export writes it: entries of its data's location, offset and length.
        let bytes = b"\x08\x0a\x6a\x19\x0a\x08location\x12\x0dnet.onnx.data\x70\x01";
        let error = load(Path::new("net.onnx"), bytes, [1, 3, 66, 200]).err().unwrap().to_string();
        assert!(error.starts_with("net.onnx: ") && error.contains("external_data=False"), "{error}");
        assert!(!has_weights_elsewhere(b"\x0a\x08location of the car"));
    }
}
