//! Emergency braking: networks that say when one is due, how they are trained, and the guard that brakes by one.
//!
//! ```text
//! episodes.csv, runs ─▶ Episodes ─▶ windows ─▶ train ─▶ checkpoint ─▶ BrakingModel ─▶ Guard
//!                          └──────────▶ values ─▶ lapwing_score::emergency::Evaluation
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `episodes` | the data set that `lapwing brake record` writes, read back: frames, speeds, labels |
//! | `recipe` | how a network is trained, as a file |
//! | `targets` | what a network should say at each frame |
//! | `windows` | what a network learns from: windows, drawn and balanced |
//! | `told` | what it is told of single frames: what stands where, and where our way goes |
//! | `learning` | a network that learns, epoch by epoch |
//! | `train` | a training, from a recipe and a data set to a file |
//! | `state` | where a training is, to be resumed |
//! | `values` | what a network says over whole episodes, with and without speed |
//! | `report` | how good a network is on a part of the data set |
//! | `guard` | a network from its file, as a [`GuardModel`](lapwing_core::guard::GuardModel) |
//!
//! The networks are in [`nn::braking`](crate::nn::braking).

mod episodes;
mod guard;
mod learning;
mod recipe;
mod report;
mod state;
mod targets;
mod told;
mod train;
mod values;
mod windows;

pub use episodes::{BrakingDataError, Drive, Story, load, stories};
pub use guard::{BrakingModel, BrakingModelError};
pub use lapwing_sim::braking::Part;
pub use recipe::BrakingRecipe;
pub use report::{BrakingReport, Row, Target};
pub use train::{BrakingTrainError, Epoch, TrainOptions, Trained, train};
pub use values::{SpeedFailure, episodes};
