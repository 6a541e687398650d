//! Log lines that may come thousands of times a second.

use std::{
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// The interval over which lines are counted.
const WINDOW: Duration = Duration::from_secs(10);

/// Lets the first lines through and counts the others, until ten seconds after the first.
#[derive(Debug)]
pub(super) struct Throttled {
    most: u64,
    state: Mutex<ThrottleState>,
}

#[derive(Debug, Default)]
struct ThrottleState {
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
    /// Lets this many lines through in ten seconds.
    pub fn of(most: u64) -> Self {
        Self { most, state: Mutex::default() }
    }

    /// If a line is due, the text that ends it: how many like it were held back.
    pub fn due(&self, now: Instant) -> Option<String> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.since.is_none_or(|since| now.saturating_duration_since(since) >= WINDOW) {
            (state.since, state.said) = (Some(now), 0);
        }
        if state.said == self.most {
            state.held += 1;
            return None;
        }
        state.said += 1;
        Some(match std::mem::take(&mut state.held) {
            0 => String::new(),
            held => format!(" (and {held} more like it)"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_passes_and_later_ones_are_counted_for_ten_seconds() {
        let throttled = Throttled::default();
        let start = Instant::now();
        let due = |ms| throttled.due(start + Duration::from_millis(ms));
        let due = [0, 1, 9_999, 10_000, 20_000].map(due);
        let due = due.each_ref().map(Option::as_deref);
        assert_eq!(due, [Some(""), None, None, Some(" (and 2 more like it)"), Some("")]);
    }

    #[test]
    fn several_lines_may_pass_together() {
        let throttled = Throttled::of(3);
        let start = Instant::now();
        let due = |ms| throttled.due(start + Duration::from_millis(ms));
        let due = [0, 1, 2, 3, 10_000].map(due);
        let due = due.each_ref().map(Option::as_deref);
        assert_eq!(due, [Some(""), Some(""), Some(""), None, Some(" (and 1 more like it)")]);
    }
}
