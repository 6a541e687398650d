//! The last minute of a drive, for a page that begins to watch it: its curves and its trail are complete at once.
//!
//! The driver's end adds each turn, and never waits: a turn that comes while a page copies the minute is left out.

use std::{
    collections::VecDeque,
    sync::{Mutex, PoisonError, TryLockError},
};

use serde::{Serialize, Serializer};

use super::moment::{Facts, Moment, few_digits};

/// Seconds that are kept: as many as the page's curves show.
const MINUTE_S: f64 = 60.0;
/// Kept turns are at least this many seconds apart, as a curve has no room for more. So there are 2000 at most.
const EVERY_S: f64 = 0.03;

/// The turns of a drive's last minute.
#[derive(Debug, Default)]
pub(super) struct Minute(Mutex<Kept>);

#[derive(Debug, Default)]
struct Kept {
    /// Number of the run.
    run: u32,
    /// The oldest first.
    turns: VecDeque<Past>,
}

/// What is drawn of a turn that is over. Pages get it as an array of eight numbers, in the order of these fields.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Past {
    /// Seconds of the run.
    t: f64,
    speed_mph: Option<f64>,
    set_mph: f64,
    /// The steering in effect, as reported.
    steering_deg: Option<f64>,
    /// The command's steering, normalised; none while a human drives at the simulator.
    steering: Option<f32>,
    /// The command's throttle, or else the reported one.
    throttle: Option<f64>,
    /// From above: x and z, in metres, where they are told.
    at: Option<[f32; 2]>,
}

impl Minute {
    /// Keeps a turn of this run, unless the one before it is too close, or a page is copying the minute.
    pub fn keep(&self, run: u32, turn: &Facts, set_mph: f64) {
        let mut kept = match self.0.try_lock() {
            Ok(kept) => kept,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        if kept.run != run || kept.turns.back().is_some_and(|last| turn.t < last.t) {
            *kept = Kept { run, ..Kept::default() };
        }
        if kept.turns.back().is_some_and(|last| turn.t < last.t + EVERY_S) {
            return;
        }
        while kept.turns.front().is_some_and(|first| first.t < turn.t - MINUTE_S) {
            kept.turns.pop_front();
        }
        kept.turns.push_back(Past::of(turn, set_mph));
    }

    /// The turns of this moment's run up to it, the oldest first.
    pub fn until(&self, now: &Moment) -> Vec<Past> {
        let Some(newest) = &now.turn else { return vec![] };
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.run != now.status.run {
            return vec![];
        }
        kept.turns.iter().take_while(|turn| turn.t <= newest.t).copied().collect()
    }
}

impl Past {
    fn of(turn: &Facts, set_mph: f64) -> Self {
        Self {
            t: turn.t,
            speed_mph: turn.speed_mph,
            set_mph,
            steering_deg: turn.steering_deg,
            steering: turn.command.map(|[steering, _]| steering),
            throttle: turn.command.map(|[_, throttle]| f64::from(throttle)).or(turn.throttle),
            at: turn.at,
        }
    }
}

impl Serialize for Past {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { t, speed_mph, set_mph, steering_deg, steering, throttle, at } = *self;
        let [x, z] = [0, 1].map(|axis| at.map(|at| f64::from(at[axis])));
        [Some(t), speed_mph, Some(set_mph), steering_deg, steering.map(f64::from), throttle, x, z]
            .map(|value| value.map(few_digits))
            .serialize(serializer)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::page::{counts::STAGES, moment::Status};
    use lapwing_core::turn::By;

    fn facts(t: f64) -> Facts {
        Facts {
            n: 1,
            t,
            speed_mph: Some(9.0),
            steering_deg: None,
            throttle: Some(0.125),
            command: Some([-0.5, 0.25]),
            by: By::Pilot,
            cte: None,
            at: Some([3.5, -4.0]),
            lap: None,
            brake_due: None,
            ms: [None; STAGES.len()],
            hz: 20.0,
        }
    }

    fn told(minute: &Minute, run: u32, t: f64) -> Vec<f64> {
        let status = Arc::new(Status { run, ..Status::default() });
        let now = Moment { status, turn: Some(facts(t)), ..Moment::default() };
        minute.until(&now).iter().map(|past| past.t).collect()
    }

    #[test]
    fn a_minute_of_the_run_is_kept_and_nothing_of_the_run_before() {
        let minute = Minute::default();
        for second in 0..100 {
            minute.keep(1, &facts(f64::from(second)), 12.0);
        }
        let kept = told(&minute, 1, 99.0);
        assert_eq!((kept.len(), kept.first(), kept.last()), (61, Some(&39.0), Some(&99.0)));
        assert_eq!(told(&minute, 1, 50.5).last(), Some(&50.0), "nothing that came after the moment");
        assert!(told(&minute, 2, 99.0).is_empty(), "another run has begun");
        minute.keep(2, &facts(200.0), 12.0);
        assert_eq!(told(&minute, 2, 200.0), [200.0]);
    }

    #[test]
    fn of_a_drive_with_very_many_turns_a_second_a_bounded_number_is_kept() {
        let minute = Minute::default();
        for ms in 0..100_000 {
            minute.keep(1, &facts(f64::from(ms) / 1e3), 12.0);
        }
        let kept = told(&minute, 1, 100.0).len();
        assert!((1900..=2001).contains(&kept), "{kept}");
    }

    #[test]
    fn who_drives_does_not_wait_for_a_page_that_copies_the_minute() {
        let minute = Minute::default();
        minute.keep(1, &facts(1.0), 12.0);
        let copying = minute.0.lock().unwrap();
        minute.keep(1, &facts(2.0), 12.0);
        drop(copying);
        minute.keep(1, &facts(3.0), 12.0);
        assert_eq!(told(&minute, 1, 3.0), [1.0, 3.0]);
    }

    #[test]
    fn pages_get_a_turn_as_eight_numbers_with_few_digits() {
        let told = |turn: &Facts| serde_json::to_string(&Past::of(turn, 12.0)).unwrap();
        assert_eq!(told(&facts(1.0 / 3.0)), "[0.3333,9.0,12.0,null,-0.5,0.25,3.5,-4.0]");
        let by_a_human = Facts { command: None, at: None, ..facts(2.0) };
        assert_eq!(told(&by_a_human), "[2.0,9.0,12.0,null,null,0.125,null,null]");
    }
}
