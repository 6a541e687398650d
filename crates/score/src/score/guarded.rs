//! What a guard did in a run: how often and how long it braked in place of the pilot, and how hard.

use super::{Figure, Measure};
use lapwing_core::{motion::Deceleration, recording::CommandRecord};

const NO_GUARD: &str = "no guard watched";
/// It was there and never had a value to brake by.
pub(super) const BLIND: &str = "the guard could not watch";

/// Watches what a guard does.
#[derive(Debug, Clone, Default)]
pub(super) struct Guarded {
    /// Whether there is a guard, and whether it ever had a value to brake by.
    is_there: bool,
    watched: bool,
    activations: u32,
    since_s: Option<f64>,
    braked_s: f64,
    /// While it brakes.
    braking: Deceleration,
    /// The last telemetry's time in seconds and speed in m/s.
    last: Option<(f64, f64)>,
    /// Whether something was hit since it began: from there on, the impact takes speed off as well.
    was_hit: bool,
}

impl Guarded {
    /// A telemetry; `goes_on` says whether the car drove here from where the last one saw it.
    pub(super) fn telemetry(&mut self, at_s: f64, mps: f64, goes_on: bool) {
        if !goes_on {
            self.braking.restart(None);
        }
        self.last = Some((at_s, mps));
        if self.since_s.is_none() || self.was_hit {
            return;
        }
        self.braking.measure(at_s, mps);
    }

    pub(super) fn command(&mut self, command: &CommandRecord) {
        self.is_there |= command.guard_ns.is_some();
        self.watched |= command.brake_due.is_some();
    }

    pub(super) fn begins(&mut self, at_s: f64) {
        self.watched = true;
        self.activations += 1;
        self.since_s.get_or_insert(at_s);
        // What was seen when it began.
        self.braking.restart(self.last);
        self.was_hit = false;
    }

    /// Something was hit, which the next telemetry shows.
    pub(super) fn hit(&mut self) {
        self.braking.restart(None);
        self.was_hit = true;
    }

    pub(super) fn ends(&mut self, at_s: f64) {
        self.watched = true;
        self.braked_s += self.since_s.take().map_or(0.0, |since| (at_s - since).max(0.0));
    }

    pub(super) fn figures(mut self, end_s: f64) -> [(Figure, Measure); 3] {
        if self.since_s.is_some() {
            self.ends(end_s);
        }
        let why = if self.is_there { BLIND } else { NO_GUARD };
        let told = |value: f64| Measure::told(self.watched.then_some(value), why);
        [
            (Figure::GuardActivations, told(self.activations.into())),
            (Figure::GuardBrakedS, told(self.braked_s)),
            (Figure::GuardHardest, told(self.braking.hardest_g())),
        ]
    }
}

#[cfg(test)]
mod tests {
    use lapwing_core::{
        car::GRAVITY,
        units::{Steering, Throttle},
    };

    use super::*;

    /// A command beside which a guard was asked.
    fn command(brake_due: Option<f64>) -> CommandRecord {
        CommandRecord { brake_due, guard_ns: Some(5), ..CommandRecord::of_human(Steering::ZERO, Throttle::ZERO) }
    }

    fn values(guarded: Guarded) -> [Option<f64>; 3] {
        guarded.figures(10.0).map(|(_, measure)| measure.value())
    }

    #[test]
    fn an_activation_is_counted_timed_and_measured_by_the_speed_it_takes_off() {
        let mut guarded = Guarded::default();
        for i in 0..30 {
            let at_s = f64::from(i) / 15.0;
            // 0.5 g from the tenth on, for a second.
            let mps = 10.0 - 0.5 * GRAVITY * (at_s - 10.0 / 15.0).clamp(0.0, 1.0);
            guarded.telemetry(at_s, mps, i > 0);
            if i == 10 {
                guarded.begins(at_s);
            } else if i == 25 {
                guarded.ends(at_s);
            }
        }
        let [activations, braked_s, hardest] = values(guarded).map(Option::unwrap);
        assert_eq!(activations, 1.0);
        assert!((braked_s - 1.0).abs() < 1e-9 && (hardest - 0.5).abs() < 1e-9, "{braked_s} s, {hardest} g");
    }

    #[test]
    fn a_guard_that_only_watched_braked_never_and_one_still_braking_at_the_end_braked_until_then() {
        assert_eq!(values(Guarded::default()), [None; 3]);
        let mut guarded = Guarded::default();
        guarded.command(&command(Some(0.1)));
        // Networks look less often than frames come.
        guarded.command(&command(None));
        assert_eq!(values(guarded), [Some(0.0); 3]);
        let mut guarded = Guarded::default();
        guarded.begins(7.5);
        assert_eq!(values(guarded), [Some(1.0), Some(2.5), Some(0.0)]);
    }

    #[test]
    fn a_guard_that_could_never_watch_is_not_one_that_had_no_reason_to_brake() {
        let why = |guarded: Guarded| guarded.figures(10.0).map(|(_, measure)| measure);
        assert_eq!(why(Guarded::default()), [Measure::Unknown(NO_GUARD); 3]);
        let mut guarded = Guarded::default();
        guarded.command(&command(None));
        assert_eq!(why(guarded), [Measure::Unknown(BLIND); 3]);
    }

    #[test]
    fn what_an_impact_takes_off_was_not_braked() {
        let mut guarded = Guarded::default();
        let braked = |guarded: &mut Guarded, i: u32, mps: f64| guarded.telemetry(f64::from(i) / 10.0, mps, true);
        braked(&mut guarded, 0, 10.0);
        guarded.begins(0.0);
        for i in 1..5 {
            braked(&mut guarded, i, 10.0 - 0.05 * GRAVITY * f64::from(i));
        }
        guarded.hit();
        // It is stopped at once, or takes a while.
        (5..9).for_each(|i| braked(&mut guarded, i, 12.0 - f64::from(i)));
        let hardest = values(guarded.clone())[2].unwrap();
        assert!((hardest - 0.5).abs() < 1e-9, "{hardest} g");
        guarded.ends(0.9);
        guarded.begins(0.9);
        (9..13).for_each(|i| braked(&mut guarded, i, 4.0 - 0.08 * GRAVITY * f64::from(i - 8)));
        let hardest = values(guarded)[2].unwrap();
        assert!((hardest - 0.8).abs() < 1e-9, "{hardest} g: braking for something else is measured");
    }

    #[test]
    fn a_car_that_is_put_elsewhere_was_not_braked_there() {
        let mut guarded = Guarded::default();
        guarded.telemetry(0.0, 10.0, false);
        guarded.begins(0.0);
        guarded.telemetry(0.3, 0.0, false);
        guarded.telemetry(0.6, 0.0, true);
        assert_eq!(values(guarded)[2], Some(0.0));
    }
}
