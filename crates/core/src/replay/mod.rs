//! A recording as a world, open loop: every recorded moment is shown to a driver and its answer is compared with what
//! was steered then. (Closed loop is `along` in `lapwing-sim`.)
//!
//! ```text
//! Run (.mcap) or Udacity folder ─▶ Replay: World ─▶ drive::run, its observer Answers ─┐
//!                                        └───────▶ ForBridge ─▶ client ─▶ bridge ─────┤
//!  ReplayReport (MAE, MSE, r, latency) ◀── answers ◀──────────────────────────────────┘
//!  Golden (frame by frame)             ◀──┘
//! ```
//! A frame that no network saw is a bad frame: it is counted as such and enters no figure.

mod answers;
mod comparison;
mod golden;
mod report;
mod source;

pub use answers::{Answered, Answers, ForBridge, Response};
pub use comparison::GoldenComparison;
pub use golden::{Difference, Golden, GoldenError, Machine};
pub use report::{BadFrame, ReplayLatency, ReplayReport};
pub use source::{Rate, Replay, ReplayError};
