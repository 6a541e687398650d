//! Many agents learn to drive through an intersection ([`lapwing_sim::intersection`]) without touching one another.
//!
//! | module | holds |
//! |---|---|
//! | [`ppo`] | the on-policy algorithm, top to bottom |
//! | [`maddpg`] | the off-policy one |
//! | `gradients` | what it learns from a batch |
//! | `asynchronous` | the same with learner threads |
//! | [`replay`] | what it learns from: a memory of joint transitions, with [`priorities`] kept in [`trees`] |
//! | [`learner`] | what both are to a training |
//! | [`policy`] | the network, its checkpoint, and how it drives |
//! | [`study`] | many trainings, and what they say of both |
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

mod asynchronous;
mod error;
mod file;
mod gradients;
pub mod learner;
pub mod maddpg;
pub mod policy;
pub mod ppo;
pub mod priorities;
pub mod replay;
pub mod study;
pub mod training;
pub mod trees;

pub use error::MarlError;
pub use learner::{Algorithm, Update, World};
pub use maddpg::{Maddpg, MaddpgSettings};
pub use policy::Policy;
pub use ppo::{Ppo, PpoSettings};
pub use training::{MarlOutcome, Training};

#[cfg(test)]
mod tests;
