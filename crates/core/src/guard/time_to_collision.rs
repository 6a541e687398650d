//! The guard that needs no network: it brakes by the time to collision that this project's own worlds report.

use super::{Guard, GuardError, GuardModel, Watched};
use crate::control::{BrakeLimits, TIME_TO_COLLISION};

/// It brakes where a collision is this near, in seconds. At the car's top speed of 30 mph full brake on a dry road (7.1 m/s²)
/// takes 0.95 s of that, the two frames that make an emergency and the car's answer to them 0.2 s; the rest is margin.
const FIRES_S: f64 = 1.4;

/// What it braked for and is still this close ahead, in metres, is braked for whatever the time: a car that sets off before it
/// has no time left to be braked in; and one that is let go of at 0.7 mph, as the rule of a standstill has it, rolls on for 3 m
/// and more. Who comes this close gently is not braked.
const CLOSE_M: f64 = 6.0;

/// It no longer does once a collision is this far, in seconds: where Euro NCAP's tests of emergency braking begin.
const RELEASES_S: f64 = 4.0;

/// A nearer collision is not told apart, in seconds.
const NEAREST_S: f64 = 0.05;

/// Brakes by the time to collision. Its value is the inverse, per second, which grows as the danger does (Kiefer,
/// LeBlanc and Flannagan, Developing an inverse time-to-collision crash alert timing approach, 2005).
#[derive(Debug, Clone, Copy, Default)]
pub struct TimeToCollision {
    /// Whether it braked for what is close.
    warned: bool,
}

impl Guard for TimeToCollision {
    fn name(&self) -> &str {
        TIME_TO_COLLISION
    }

    fn limits(&self) -> BrakeLimits {
        BrakeLimits { fires: FIRES_S.recip(), releases: RELEASES_S.recip() }
    }

    fn watch(&mut self, now: &Watched<'_>) -> Result<Option<f64>, GuardError> {
        let until_s = now.time_to_collision_s.ok_or(GuardError::NoTimeToCollision)?;
        if until_s.is_nan() {
            return Err(GuardError::NotFinite(until_s));
        }
        let is_close = now.gap_m.is_some_and(|gap_m| gap_m < CLOSE_M);
        self.warned = until_s <= FIRES_S || self.warned && is_close;
        let until_s = if self.warned { until_s.min(FIRES_S) } else { until_s };
        Ok(Some(until_s.max(NEAREST_S).recip()))
    }

    fn needs_picture(&self) -> bool {
        false
    }

    fn reset(&mut self) {
        self.warned = false;
    }
}

impl GuardModel for TimeToCollision {
    fn name(&self) -> &str {
        TIME_TO_COLLISION
    }

    fn sha256(&self) -> Option<&str> {
        None
    }

    fn guard(&self) -> Box<dyn Guard> {
        Box::new(Self::default())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::{perception::Frame, units::Mph};

    #[test]
    fn it_warns_of_a_near_collision_rests_at_a_far_one_and_needs_to_be_told() {
        let frame = Frame::default();
        let mut guard = TimeToCollision::default();
        let mut watch = |time_to_collision_s, gap_m| {
            guard.watch(&Watched { at: Duration::ZERO, frame: &frame, speed: Mph::ZERO, time_to_collision_s, gap_m })
        };
        let at_rest = Some(60f64.recip());
        assert_eq!(watch(Some(60.0), Some(1.0)).unwrap(), at_rest, "it came close gently");
        assert_eq!(watch(Some(1.0), Some(5.0)).unwrap(), Some(1.0));
        assert_eq!(
            watch(Some(60.0), Some(1.0)).unwrap(),
            Some(FIRES_S.recip()),
            "it stands right before what it braked for"
        );
        assert_eq!(watch(Some(60.0), Some(7.0)).unwrap(), at_rest);
        assert_eq!(watch(Some(60.0), Some(1.0)).unwrap(), at_rest, "something else");
        let mut value = |until_s| watch(until_s, None);
        let BrakeLimits { fires, releases } = TimeToCollision::default().limits();
        for (until_s, warns, rests) in
            [(0.0, true, false), (1.3, true, false), (1.5, false, false), (4.1, false, true), (60.0, false, true)]
        {
            let value = value(Some(until_s)).unwrap().unwrap();
            assert_eq!((value >= fires, value < releases), (warns, rests), "{until_s} s");
        }
        assert!(value(None).unwrap_err().to_string().starts_with("expected telemetry with a time to collision"));
        assert!(matches!(value(Some(f64::NAN)), Err(GuardError::NotFinite(_))));
    }
}
