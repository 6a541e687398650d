//! Supervised training: from data sets to a checkpoint that says how it was made.
//!
//! A [`Recipe`] defines everything; a [`Trainer`] follows it and leaves these files in its folder:
//!
//! | file | is |
//! |---|---|
//! | `model.safetensors` | the network, as `pilot` and `nn` read it |
//! | `state.safetensors` | the resume state: weights, moments, averages, position |
//! | `log.csv` | a line for each epoch |
//! | `recipe.toml` | the recipe as it was followed |
//! | `events.out.tfevents.…` | the same curves for TensorBoard |
//!
//! [`measure`] computes how far a network's answers are from a data set's labels.

mod closed_loop;
mod error;
pub mod events;
mod log;
mod measure;
mod metrics;
mod optimiser;
mod origin;
mod preparation;
mod progress;
mod recipe;
mod state;
mod trainer;

pub use closed_loop::{ClosedLoop, Lesson, PracticeAlong, PracticeDrive};
pub use error::TrainError;
pub use measure::{Measured, Tensors, measure};
pub use metrics::Metrics;
pub(crate) use optimiser::Stepper;
pub use progress::{Epoch, Go, Progress, TimedEpoch, TrainOutcome};
pub use recipe::{Keep, Optimiser, OptimiserKind, Recipe, Schedule, SimulatedData};
pub use trainer::Trainer;

#[cfg(test)]
mod tests;
