//! Many agents learn to drive through an intersection ([`lapwing_sim::intersection`]) without touching one another.
//!
//! | module | holds |
//! |---|---|
//! | [`ppo`] | the algorithm, top to bottom |
//! | [`policy`] | the network, its checkpoint, and how it drives |
//! | [`training`] | a run in a folder: checkpoints, resume state, log, TensorBoard |
//!
//! A run's folder holds:
//!
//! | file | is |
//! |---|---|
//! | `policy.safetensors` | the actor: all that driving needs |
//! | `state.safetensors` | weights, moments and position, to resume from |
//! | `log.csv` | a line for each update |
//! | `settings.json` | the settings as they were followed |
//! | `events.out.tfevents.…` | the same curves for TensorBoard |

mod error;
mod file;
pub mod policy;
pub mod ppo;
pub mod training;

pub use error::MarlError;
pub use policy::Policy;
pub use ppo::{Ppo, PpoSettings, Update};
pub use training::{MarlOutcome, Training};

#[cfg(test)]
mod tests;
