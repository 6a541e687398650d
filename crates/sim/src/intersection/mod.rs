//! `intersection4`: four agents, four lanes, one intersection. The world of multi-agent learning.
//!
//! It is that of SMARTS' benchmark (Zhou et al. 2020, `benchmark/scenarios/intersections/4lane`) without SUMO, Bullet and Ray:
//!
//! ```text
//! actions ─▶ agents (controller, bicycle) ─▶ crash ─▶ observation, reward ─▶ Step
//!               ▲                              ▲
//!               └── roads, missions ── traffic (IDM, right of way)
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`roads`] | arms, lanes, the box, ways across it and which of them conflict |
//! | [`missions`] | where agents begin and go: the benchmark's, and random ones |
//! | [`agents`] | the agents' cars and what an action makes them do |
//! | [`traffic`] | background cars, and who of them may enter the box |
//! | [`crash`] | contacts, and whose fault they are |
//! | [`observation`], [`sight`], [`reward`] | what agents see and earn |
//! | [`Environment`] | one intersection, step by step |
//! | [`Batch`] | many at once, into the caller's buffers |
//! | [`parallel`] | one in the manner of PettingZoo |
//! | [`scripted`] | a driver who knows the rules |
//! | [`evaluation`] | collision and completion rates over episodes |
//!
//! A step is 0.1 s, in two halves. An agent ends when it reaches its goal, crashes or leaves the road (terminated), or
//! after 1000 steps (truncated); its car is gone then, and the others drive on. An episode is over when all have ended.
//! The same seed and actions give the same episode.
//!
//! # Example
//! An episode of the scripted driver without traffic:
//! ```
//! use lapwing_sim::intersection::{AGENTS, Ending, Environment, Settings, scripted};
//!
//! let mut environment = Environment::new(Settings::default(), 7);
//! while !environment.is_over() {
//!     let actions = std::array::from_fn(|i| scripted::act(&environment, i));
//!     environment.step(actions);
//! }
//! assert_eq!(environment.endings(), [Some(Ending::Goal); AGENTS]);
//! ```

pub mod agents;
mod batch;
pub mod crash;
mod environment;
pub mod evaluation;
pub mod missions;
pub mod observation;
pub mod parallel;
pub mod reward;
mod right_of_way;
pub mod roads;
pub mod scripted;
pub mod sight;
pub mod traffic;

pub use agents::{ACTIONS, Action};
pub use batch::{Batch, Buffers};
pub use crash::{Crash, Fault};
pub use environment::{Ending, Environment, Missions, Settings, Step, Tally};
pub use observation::{Axes, FRAME, OBSERVATION, STATE};
pub use reward::Reward;
pub use right_of_way::Right;
pub use sight::Sight;
pub use traffic::CARS;

/// Number of agents.
pub const AGENTS: usize = 4;
/// Length of all cars, in metres.
pub const LENGTH_M: f32 = 3.68;
/// Width of all cars, in metres.
pub const WIDTH_M: f32 = 1.47;
/// Steps after which an episode is truncated.
pub const STEPS: u32 = 1000;
/// A step has two halves of this length, in seconds.
pub const SUBSTEP_S: f32 = 0.05;

#[cfg(test)]
mod tests;
