//! Networks and the file that holds one: the only door to weights.
//!
//! A [`Checkpoint`] is read from one `.safetensors` file that also says what its weights mean: [`Metadata`] with the
//! preprocessing, and the [`Network`] of the [`Design`] that it names. Everything in the file is checked against the
//! architecture before it is used. Training makes a network whose weights belong to a variable store
//! ([`in_variable_store`]), may start from pretrained ones ([`load_pretrained`]), and writes it with [`save`]. Tensors that
//! PyTorch saved under other names are mapped by [`rename`].
//!
//! There is one file per architecture, read top to bottom, which cites its source; its tensors have the same names as
//! in the file.
//!
//! | architecture | frames | answers | parameters |
//! |---|---|---|---|
//! | [`pilotnet`] | 1 | steering | 252,219 |
//! | [`cps`] | 1 | steering, acceleration | 160,578 |
//! | [`resnet18`, `resnet50`](resnet) | 1 | steering | 11.5 and 24.6 million |
//! | [`resnet18-gru`, `resnet50-gru`](gru) | 5, one after the other | steering | 13.1 and 28.6 million |
//! | [`resnet18-stack`, `resnet50-stack`](stack) | 5 as one picture | steering | 11.5 and 24.7 million |
//! | [`lane`] | 1 | offset and heading in the lane, and how sure it is of either | 309,308 |
//!
//! | [`brake-stacked`, `brake-live`](braking) | 20, with their speeds | whether an emergency brake is due | 5,909,219 and 345,500 |
//!
//! Each may take the speed as one more number. `pilot` decides which network drives, and when; `lane` and the braking networks do not
//! drive; the latter have a checkpoint of their own, [`BrakingCheckpoint`](braking::BrakingCheckpoint).

mod architecture;
pub mod braking;
pub(crate) mod checkpoint;
pub mod cps;
mod error;
pub mod gru;
pub mod lane;
mod layers;
mod network;
pub mod pilotnet;
mod pretrained;
pub mod rename;
pub mod resnet;
pub mod runtime;
mod source;
pub mod stack;

pub use architecture::{Architecture, Design};
pub(crate) use checkpoint::tensor_of;
pub use checkpoint::{Checkpoint, FORMAT, Metadata, Precision, encode, save};
pub use error::NnError;
#[cfg(feature = "onnx")]
pub(crate) use error::first_line;
pub(crate) use error::torch_words;
pub(crate) use layers::Reach;
pub use network::{Memory, Network, SPEED_UNIT_MPH};
pub use pretrained::load_pretrained;
pub use source::{Init, TensorSource, in_variable_store};
