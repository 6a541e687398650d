//! Emergency braking as a signal over time: what a driver's pedal says, moment by moment.
//!
//! ```text
//! run, driving log, table ─▶ pedal ─▶ label ─▶ table of labels
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`pedal`] | brake pedal and speed over time, from whatever recorded them |
//! | [`label`] | at which moments an emergency brake is due, by how fast the pedal goes down |
//! | [`trial`] | what a guard is worth in the closed loop |
//! | [`labelled`] | a recording and its labels: as a table, drawn, in words |
//! | [`counting`] | how the paper counts a predictor, and the rates |
//! | [`evaluation`] | how good a predictor is on episodes: that, activations, lead times, intervals |
//!
//! After Itu and Danescu, Fully Convolutional Neural Network for Vehicle Speed and Emergency-Brake Prediction, Sensors
//! 2024, 24(1), 212. How a run was braked for obstacles is another question: see [`crate::score`].

pub mod counting;
pub mod evaluation;
pub mod label;
pub mod labelled;
pub mod pedal;
pub mod trial;

pub use counting::{CountingRule, Counts};
pub use evaluation::{Episode, Evaluation};
pub use label::{Braked, Label, LabelRule, labels};
pub use labelled::{Found, Labelled};
pub use pedal::{Pedal, PedalError, Pressed};
