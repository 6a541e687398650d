//! A recording as a world, open loop: every recorded moment is shown to a driver and its answer set against what was
//! steered then. (Closed loop is `along` in `lapwing-sim`.)
//!
//! ```text
//! Run (.mcap) or Udacity folder ─▶ Replay: World ─▶ Driver, in process ──────┐
//!                                        └───────▶ client ▶──────────▶ bridge ┤
//!        Report (MAE, MSE, r, latency) ◀── answers ◀────────────────────────┘
//!        Golden (frame by frame)      ◀──┘
//! ```
//! A frame that no network saw is a bad one: it is counted as such and is in no figure.

mod golden;
mod report;
mod source;

pub use golden::{Difference, Golden, GoldenError, Machine};
pub use report::{BadFrame, Latency, MOST_BAD_FRAMES, Report, too_many_bad_frames};
pub use source::{Answered, Rate, Replay, ReplayError, Response};

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
        replay.settle(Response::of(answer, &trace));
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
