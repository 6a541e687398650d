//! A recording as a world. Closed loop in [`closed_loop`]; here open loop: every recorded moment is shown to a driver
//! and its answer set against what was steered then.
//!
//! ```text
//! Run (.mcap) or Udacity folder ─▶ Replay: World ─▶ Driver, in process ──────┐
//!                                        └───────▶ simulator::client ▶ bridge ┤
//!        Report (MAE, MSE, r, latency) ◀── answers ◀────────────────────────┘
//!        Golden (frame by frame)      ◀──┘
//! ```

pub mod closed_loop;
mod golden;
mod report;
mod source;

pub use golden::{Difference, Golden, GoldenError};
pub use report::{Latency, Report};
pub use source::{Answered, Rate, Replay, ReplayError};

use std::time::{Duration, Instant};

use crate::{driver::Driver, protocol::World};

/// Shows a whole recording to a driver in this process; returns the driver's time for each answer.
/// `progress` is called after each answer.
///
/// # Errors
/// [`ReplayError`] where the recording cannot be read on.
pub fn run(
    replay: &mut Replay,
    driver: &mut Driver,
    mut progress: impl FnMut(),
) -> Result<Vec<Duration>, Box<dyn std::error::Error + Send + Sync>> {
    let mut times = Vec::new();
    while let Some(observation) = replay.observe()? {
        if replay.take_armed() {
            driver.arm();
        }
        let (answer, trace) = driver.drive(&observation);
        for happening in &trace.happenings {
            tracing::debug!("at {:.2} s: {happening:?}", observation.at.as_secs_f64());
        }
        times.push(trace.total);
        replay.apply(answer);
        progress();
    }
    Ok(times)
}

/// Waits until `at` after `began`, at `rate`.
fn pace(rate: Rate, began: Instant, frame: u64, at: Duration) {
    let due = match rate {
        Rate::Max => return,
        Rate::Real => at,
        Rate::Hz(hz) => Duration::from_secs_f64(frame as f64 / hz),
    };
    std::thread::sleep((began + due).saturating_duration_since(Instant::now()));
}
