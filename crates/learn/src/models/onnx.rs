//! A network made elsewhere: an ONNX model, and a [`SideFile`] beside it.
//!
//! `model.onnx` is what `keras.Model.export`, `tf2onnx` or `torch.onnx.export` wrote; it takes one input of
//! [`Preprocess::tensor_shape`] in f32 and answers tensors of as many numbers as there are outputs, the steering first.
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

use super::{ModelError, SideFile, network::Eye};
use crate::nn::{NnError, first_line};
use lapwing_core::{
    perception::Preprocess,
    pilot::{Pilot, PilotError, Prediction, View},
    units::Clock,
};

/// The environment variable that names ONNX Runtime's library, as in ONNX Runtime's other bindings for Rust.
pub const LIBRARY: &str = "ORT_DYLIB_PATH";

static NAMED: OnceLock<PathBuf> = OnceLock::new();
static ENVIRONMENT: OnceLock<Environment> = OnceLock::new();

/// Names the library for the whole process, unless one is named already. Only what the user says may get here.
pub fn use_library(path: &Path) {
    let _ = NAMED.set(path.to_owned());
}

/// Steers by the first output of an ONNX model, on one thread of the CPU.
#[derive(Debug)]
pub struct OnnxPilot {
    eye: Eye,
    /// One for all pilots of the model, which therefore answer one after the other.
    session: Arc<Mutex<Session>>,
}

impl OnnxPilot {
    /// Loads a model of `bytes`, those of the file `path`, with the `.toml` of the same stem beside it, and warms it up.
    ///
    /// # Errors
    /// [`ModelError::NoSideFile`], [`ModelError::SideFile`], [`ModelError::NoOnnxRuntime`], [`ModelError::Onnx`],
    /// [`ModelError::OnnxInput`], [`ModelError::Unfit`].
    pub fn load(path: &Path, bytes: &[u8], clock: Clock) -> Result<Self, ModelError> {
        let SideFile { outputs, preprocess } = SideFile::beside(path)?;
        let expected = preprocess.tensor_shape();
        let unfit = |source: ModelError| ModelError::Unfit { path: path.to_owned(), source: Box::new(source) };
        let mut eye = Eye::new(preprocess, &outputs, clock).map_err(unfit)?;
        let environment = environment().map_err(|why| ModelError::NoOnnxRuntime { path: path.to_owned(), why })?;
        let session = session(environment, bytes).map_err(|why| ModelError::Onnx { path: path.to_owned(), why })?;
        check_input(&session, expected).map_err(|got| ModelError::OnnxInput {
            path: path.to_owned(),
            expected,
            got,
        })?;
        let session = Arc::new(Mutex::new(session));
        eye.warm_up(|input| answer(&session, input)).map_err(|error| unfit(error.into()))?;
        Ok(Self { eye, session })
    }

    /// What is done to a frame.
    pub fn preprocess(&self) -> &Preprocess {
        self.eye.preprocess()
    }

    /// What each number of an answer is.
    pub fn outputs(&self) -> &[String] {
        self.eye.outputs()
    }

    /// Another pilot with the same weights.
    pub fn share(&self) -> Self {
        Self { eye: self.eye.clone(), session: Arc::clone(&self.session) }
    }
}

impl Pilot for OnnxPilot {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        let Self { eye, session } = self;
        eye.steer(view.frame, |input| answer(session, input))
    }

    fn reset(&mut self) {}
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

/// All numbers that the model answers to `input`, (1, C, H, W) or (1, H, W, C) f32: (outputs).
fn answer(session: &Mutex<Session>, input: &Tensor) -> Result<Tensor, NnError> {
    let shape = input.size();
    let mut numbers = vec![0f32; input.numel()];
    input.f_copy_data(&mut numbers, input.numel())?;
    let wrong = |why: ort::Error| NnError::Onnx(first_line(&why.to_string()));
    let input = TensorRef::from_array_view((shape, &numbers[..])).map_err(wrong)?;
    let mut session = session.lock().unwrap_or_else(PoisonError::into_inner);
    let answered = session.run(ort::inputs![input]).map_err(wrong)?;
    let mut all = Vec::new();
    for (_, output) in answered.iter() {
        all.extend_from_slice(output.try_extract_tensor::<f32>().map_err(wrong)?.1);
    }
    Ok(Tensor::f_from_slice(&all)?)
}
