//! Log lines that may come thousands of times a second.

use std::{
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// How long lines are counted together.
const WINDOW: Duration = Duration::from_secs(10);

/// Lets the first lines through and counts the others, until ten seconds after the first.
#[derive(Debug)]
pub(super) struct Throttled {
    most: u64,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    since: Option<Instant>,
    said: u64,
    held: u64,
}

impl Default for Throttled {
    fn default() -> Self {
        Self::of(1)
    }
}

impl Throttled {
    /// Lets so many lines through in ten seconds.
    pub fn of(most: u64) -> Self {
        Self { most, state: Mutex::default() }
    }

    /// `Some(n)` where a line is due: n lines were held back before it.
    pub fn due(&self, now: Instant) -> Option<u64> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.since.is_none_or(|since| now.saturating_duration_since(since) >= WINDOW) {
            (state.since, state.said) = (Some(now), 0);
        }
        if state.said == self.most {
            state.held += 1;
            return None;
        }
        state.said += 1;
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

    #[test]
    fn several_lines_may_pass_together() {
        let throttled = Throttled::of(3);
        let start = Instant::now();
        let due = |ms| throttled.due(start + Duration::from_millis(ms));
        assert_eq!([due(0), due(1), due(2), due(3), due(10_000)], [Some(0), Some(0), Some(0), None, Some(1)]);
    }
}
