//! Log lines that may come thousands of times a second.

use std::{
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// At most one line in this time.
const EVERY: Duration = Duration::from_secs(10);

/// Lets the first line through, then at most one in ten seconds with the number of those held back.
#[derive(Default)]
pub(super) struct Throttled(Mutex<State>);

#[derive(Default)]
struct State {
    last: Option<Instant>,
    held: u64,
}

impl Throttled {
    /// `Some(n)` where a line is due: n lines were held back before it.
    pub fn due(&self, now: Instant) -> Option<u64> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if state.last.is_some_and(|last| now.saturating_duration_since(last) < EVERY) {
            state.held += 1;
            return None;
        }
        state.last = Some(now);
        Some(std::mem::take(&mut state.held))
    }
}

/// How a line tells of those held back.
pub(super) fn held_back(held: u64) -> String {
    if held == 0 { String::new() } else { format!(" (and {held} more like it)") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_passes_and_later_ones_are_counted_for_ten_seconds() {
        let throttled = Throttled::default();
        let start = Instant::now();
        let due = |ms| throttled.due(start + Duration::from_millis(ms));
        assert_eq!([due(0), due(1), due(9_999), due(10_000), due(20_000)], [Some(0), None, None, Some(2), Some(0)]);
        assert_eq!(held_back(2), " (and 2 more like it)");
    }
}
