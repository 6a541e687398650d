//! The time of a run: the simulator's own if it sends it, otherwise the time at which its messages came.
//!
//! In lock-step a world runs as fast as it is answered, so the stamps of a recording say how long a drive took to
//! compute; `sim_time` says how long the car drove. Builds of the SelfOracle family report it in whole seconds: there
//! the stamps fill in, at the pace known so far and within the second that is reported. A clock that stands still from
//! the beginning is ignored.

use lapwing_core::protocol::Truth;

/// At a pace in this range, in seconds of the run per second of the stamps, both clocks are taken to be the same.
const REAL_TIME: std::ops::RangeInclusive<f64> = 0.8..=1.25;

/// A second that has just begun is reported up to this much later, in seconds: with the next telemetry, which may come
/// late.
const BEHIND_S: f64 = 0.25;

/// A clock that has not moved for this long, in seconds of the stamps, stands still: one in whole seconds moves within
/// a second.
const STANDS_S: f64 = 2.5;

/// From stamps to the time of the run.
#[derive(Debug, Clone, Default)]
pub(crate) struct RunClock {
    /// Whether the stamps are the world's own time.
    is_world: bool,
    /// Where the count of the pace begins: a telemetry that reported another time than the one before.
    first: Option<TimedTelemetry>,
    changed: Option<TimedTelemetry>,
    /// The last telemetry that reported the time.
    last: Option<TimedTelemetry>,
    /// Seconds of the run minus those that the simulator reports.
    offset_s: f64,
    /// Seconds from the last telemetry but one to the last.
    step_s: f64,
    /// Whether whole seconds are reported, for several telemetries each; and whether one of them has ended.
    is_coarse: bool,
    has_ticked: bool,
    /// Whether it has not moved yet, for longer than any running clock.
    stands: bool,
}

/// A telemetry that reported the time.
#[derive(Debug, Clone, Copy)]
struct TimedTelemetry {
    stamp_s: f64,
    sim_s: f64,
    run_s: f64,
}

impl RunClock {
    /// The stamps are the world's own time: it was driven in the process that recorded it.
    pub fn is_the_worlds(&mut self) {
        self.is_world = true;
    }

    /// The time of a telemetry with this stamp, which reports this time of the simulator's.
    pub fn telemetry(&mut self, stamp_s: f64, sim_s: Option<f64>) -> f64 {
        let usable = |sim_s: &f64| !self.is_world && Truth::is_time(sim_s);
        let Some(sim_s) = sim_s.filter(usable) else { return self.at(stamp_s) };
        let Some(last) = self.last else {
            let told = TimedTelemetry { stamp_s, sim_s, run_s: stamp_s };
            (self.first, self.last, self.offset_s) = (Some(told), Some(told), stamp_s - sim_s);
            return stamp_s;
        };
        let (step_s, by_stamps) = (sim_s - last.sim_s, self.at(stamp_s).max(last.run_s));
        let is_whole = sim_s.fract() == 0.0 && last.sim_s.fract() == 0.0;
        self.is_coarse = is_whole && (self.is_coarse || step_s == 0.0);
        let exact = sim_s + self.offset_s;
        let still_s =
            self.first.filter(|_| step_s == 0.0 && self.changed.is_none()).map(|first| stamp_s - first.stamp_s);
        let stood_s = still_s.filter(|still_s| !self.stands && *still_s > STANDS_S);
        self.stands = still_s.is_some() && (self.stands || stood_s.is_some());
        let anew = step_s < 0.0 || self.stands || (self.is_coarse && step_s > 0.0 && !self.has_ticked);
        let run_s = match stood_s.zip(self.first) {
            // The time that it has not reported so far.
            Some((stood_s, first)) => by_stamps.max(first.run_s + stood_s),
            // Loaded anew, not begun, or the end of the first second, whose beginning is unknown.
            None if anew => by_stamps,
            None if self.is_coarse => by_stamps.clamp(exact - BEHIND_S, exact + 1.0).max(last.run_s),
            None => exact.max(last.run_s),
        };
        self.step_s = run_s - last.run_s;
        let told = TimedTelemetry { stamp_s, sim_s, run_s };
        if anew {
            (self.offset_s, self.first, self.has_ticked) = (run_s - sim_s, Some(told), step_s > 0.0);
        }
        if step_s != 0.0 {
            self.changed = Some(told);
        }
        self.last = Some(told);
        run_s
    }

    /// The time of anything else with this stamp.
    pub fn at(&self, stamp_s: f64) -> f64 {
        self.last.map_or(stamp_s, |last| last.run_s + (stamp_s - last.stamp_s).max(0.0) * self.pace())
    }

    /// The time of a message with this stamp that comes in place of the next telemetry. As fast as it is answered, a world is one
    /// telemetry further on then, however long that one took to compute.
    pub fn next(&self, stamp_s: f64) -> f64 {
        let at = self.at(stamp_s);
        let in_turn = self.last.filter(|_| !self.is_real_time() && !self.is_coarse);
        in_turn.map_or(at, |last| at.min(last.run_s + self.step_s))
    }

    /// Whether the simulator reports the time.
    pub fn is_told(&self) -> bool {
        self.last.is_some()
    }

    /// Whether stamps can be used as the time when the simulator reports none.
    pub fn is_real_time(&self) -> bool {
        self.pace() == 1.0
    }

    /// Seconds of the run for each second of the stamps; exactly 1 if both clocks are the same.
    fn pace(&self) -> f64 {
        let Some((first, last)) = self.first.zip(self.changed) else { return 1.0 };
        let (sim_s, stamps_s) = (last.sim_s - first.sim_s, last.stamp_s - first.stamp_s);
        let pace = if sim_s > 0.0 && stamps_s > 0.0 { sim_s / stamps_s } else { 1.0 };
        if REAL_TIME.contains(&pace) { 1.0 } else { pace }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The times of telemetries reported at these stamps.
    fn times(told: impl IntoIterator<Item = (f64, f64)>) -> (RunClock, Vec<f64>) {
        let mut clock = RunClock::default();
        let times = told.into_iter().map(|(stamp_s, sim_s)| clock.telemetry(stamp_s, Some(sim_s))).collect();
        (clock, times)
    }

    #[test]
    fn a_world_that_runs_eleven_times_as_fast_is_timed_by_its_own_clock() {
        let (clock, times) = times((0..=600).map(|i| (2.0 + f64::from(i) / 165.0, f64::from(i) / 15.0)));
        assert!((times[600] - 42.0).abs() < 1e-9 && times[0] == 2.0, "{times:?}");
        assert!(!clock.is_real_time());
        // A message in place of the next telemetry is not late, however long it took.
        assert!((clock.next(4.0 + 601.0 / 165.0) - 42.0 - 1.0 / 15.0).abs() < 1e-9);
        // An item right after a telemetry is off by about as much.
        assert!((clock.at(2.0 + 601.0 / 165.0) - 42.0 - 1.0 / 15.0).abs() < 1e-9);
    }

    #[test]
    fn whole_seconds_say_how_fast_stamps_tell_the_time() {
        // A build that has been running for 7.4 s, at its own pace and three times as fast.
        for pace in [1.0, 3.0] {
            let told = (0..900).map(|i| (f64::from(i) / 15.0 / pace, (7.4 + f64::from(i) / 15.0).floor()));
            let (clock, times) = times(told);
            let apart = times.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
            let off = (times[899] - 899.0 / 15.0).abs();
            assert!(off < if pace == 1.0 { 0.1 } else { 1.0 }, "pace {pace}: {off} s off");
            assert!(apart < 1.01 && times.is_sorted(), "pace {pace}: {apart} s between two telemetries");
            assert_eq!(clock.is_real_time(), pace == 1.0);
        }
    }

    #[test]
    fn a_clock_that_does_not_move_leaves_the_time_to_the_stamps_until_it_does() {
        for stands_at in [0.0, 12.345] {
            let (clock, times) = times((0..=9000).map(|i| (f64::from(i) / 15.0, stands_at)));
            assert!((times[9000] - 600.0).abs() < 1e-6 && times.is_sorted(), "{stands_at}: {} s", times[9000]);
            assert!(clock.is_real_time());
        }
        // Ten seconds in the menu, and ten seconds' drive.
        let (_, times) = times((0..=300).map(|i| (f64::from(i) / 15.0, (f64::from(i) / 15.0 - 10.0).max(0.0))));
        assert!((times[300] - 20.0).abs() < 1e-6 && times.is_sorted(), "{} s", times[300]);
    }

    #[test]
    fn a_fine_clock_that_stands_for_a_telemetry_does_not_drift() {
        // 60 telemetries a second of a world that steps 50 times, some of whose times are reported twice.
        let (_, times) = times((0..6000).map(|i| (f64::from(i) / 60.0, (f64::from(i) / 60.0 * 50.0).floor() / 50.0)));
        assert!((times[5999] - 99.96).abs() < 0.03, "{}", times[5999]);
    }

    #[test]
    fn a_track_that_is_loaded_anew_goes_on_where_the_run_was() {
        let told = [(0.0, 50.0), (1.0, 51.0), (2.0, 52.0), (3.0, 0.5), (4.0, 1.5)];
        assert_eq!(times(told).1, [0.0, 1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn stamps_count_where_nothing_is_told_or_what_is_told_is_no_time() {
        let mut clock = RunClock::default();
        for sim_s in [None, Some(f64::NAN), Some(1e300), Some(-1.0)] {
            assert_eq!(clock.telemetry(3.5, sim_s), 3.5);
        }
        assert!(!clock.is_told() && clock.is_real_time());
        clock.is_the_worlds();
        assert_eq!((clock.telemetry(4.0, Some(0.02)), clock.at(5.0)), (4.0, 5.0));
    }
}
