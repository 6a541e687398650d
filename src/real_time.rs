//! Keeps a world that could go faster in step with time.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

use lapwing_core::{
    drive::{Observer, ObserverError},
    turn::Turn,
};

/// A world that is later than this does not hurry to catch up.
const LATE: Duration = Duration::from_millis(250);

/// The world's time beside the clock's.
#[derive(Debug, Clone, Default)]
pub struct RealTime {
    /// When its last moment was due, and the world's time then; none before the first.
    last: Option<(Instant, Duration)>,
}

impl RealTime {
    /// Waits until the moment `at` of the world is due; the first one is due at once.
    pub fn wait(&mut self, at: Duration) {
        let due = self.due(at, Instant::now());
        sleep(due.saturating_duration_since(Instant::now()));
    }

    /// Time has stood still: the next moment is due at once, as the first one was.
    pub fn restart(&mut self) {
        self.last = None;
    }

    /// When that moment is due.
    fn due(&mut self, at: Duration, now: Instant) -> Instant {
        let on_time = self.last.map_or(now, |(due, before)| due + at.saturating_sub(before));
        let due = if now > on_time + LATE { now } else { on_time };
        self.last = Some((due, at));
        due
    }
}

/// Lets a drive go no faster than time.
impl<W: ?Sized> Observer<W> for RealTime {
    fn ready(&mut self, at: Duration) {
        self.wait(at);
    }

    fn turn(&mut self, _: &W, _: &Turn) -> Result<(), ObserverError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn each_moment_is_due_as_long_after_the_one_before_as_in_the_world() {
        let (mut real_time, began) = (RealTime::default(), Instant::now());
        assert_eq!(real_time.due(700 * MS, began), began, "the first, whatever its time");
        assert_eq!(real_time.due(750 * MS, began), began + 50 * MS);
        assert_eq!(real_time.due(800 * MS, began + 90 * MS), began + 100 * MS);
    }

    #[test]
    fn a_short_delay_is_made_up_for_and_a_long_one_is_not() {
        let (mut real_time, began) = (RealTime::default(), Instant::now());
        real_time.due(Duration::ZERO, began);
        assert_eq!(real_time.due(50 * MS, began + 200 * MS), began + 50 * MS);
        assert_eq!(real_time.due(100 * MS, began + 900 * MS), began + 900 * MS);
        assert_eq!(real_time.due(150 * MS, began + 910 * MS), began + 950 * MS);
    }

    #[test]
    fn after_a_pause_the_next_moment_is_due_at_once() {
        let (mut real_time, began) = (RealTime::default(), Instant::now());
        real_time.due(Duration::ZERO, began);
        real_time.restart();
        assert_eq!(real_time.due(50 * MS, began + 5 * MS), began + 5 * MS);
    }
}
