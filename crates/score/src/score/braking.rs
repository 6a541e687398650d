//! Braking for obstacles: avoided or not, impact speed, closest approach, and false alarms.
//!
//! A *braking situation* is a stretch of a run in which the world reports a time to collision below [`COURSE_S`]. It
//! ends with an impact, or once no such time was reported for [`APART_S`]; then it counts as avoided,
//! unless something is hit before the car drives on. One that the run's end cuts short is not judged.

use super::{
    Figure, Measure,
    scorer::{NO_JUDGE, NO_TIME},
};
use lapwing_core::{
    car::REVERSES_BELOW_MPH,
    protocol::Truth,
    recording::{By, CommandRecord},
    units::Mph,
};

/// A time to collision below this is a collision course, in seconds. Euro NCAP's tests begin at 4 s; braking early and
/// gently should count as a situation, too.
const COURSE_S: f64 = 10.0;
/// A situation is over after this long without a collision course; emergency braking again after this long is another
/// event; in seconds.
const APART_S: f64 = 1.0;
/// A throttle of this or less is emergency braking. An emergency brake is full, -1; the default PI controller asks for
/// this much only at 8 mph over its speed.
const EMERGENCY: f64 = -0.8;
/// A drive that begins faster than it is to go is slowed down at first: from 30 to 9 mph the default PI controller brakes so hard for
/// 0.8 s, in rain 1.1 s. What lasts longer, in seconds, is an alarm.
const OPENING_S: f64 = 1.5;
/// A car this much faster than it was at its slowest drives on, in mph; and one that is not this much slower than at the
/// situation's begin; and any car after so many seconds.
const DRIVES_ON_MPH: f64 = 1.0;
const PAST_S: f64 = 5.0;

const NO_SCENARIO: &str = "no scenario asked for braking";
const NOT_TOLD: &str = "the run reports no time to collision: only drives with a scenario do";
const NOT_MET: &str = "nothing came onto a collision course, or the run ended first";
const NOT_HIT: &str = "nothing was hit";
const NOT_ON_COURSE: &str = "what was hit was not on a collision course";
const NOT_MEASURED: &str = "the run reports that something was hit, not how fast";
const CLEAR: &str = "nothing was within a minute of a collision";

/// Watches how a run is braked.
#[derive(Debug, Clone, Default)]
pub(super) struct Braking {
    at_s: f64,
    mph: f64,
    /// The shortest time to collision, if one is reported.
    least_s: Option<f64>,
    situation: Option<Situation>,
    /// The last situation, if it was avoided and the car has not driven on since.
    past: Option<Situation>,
    avoided: u32,
    /// Hits outside all situations.
    elsewhere: u32,
    impacts_mph: Vec<f64>,
    /// Hits that nobody measured.
    unmeasured: u32,
    reductions_mph: Vec<f64>,
    /// Whether the pilot has answered; and since when it brakes hard, if it did so from its first answer on.
    has_begun: bool,
    opening_s: Option<f64>,
    /// When emergency braking was asked for last.
    emergency_s: Option<f64>,
    false_alarms: u32,
}

#[derive(Debug, Clone)]
struct Situation {
    start_mph: f64,
    least_mph: f64,
    /// When the car was on the collision course last.
    last_s: f64,
    hit: bool,
}

/// What else about a run decides which figures can be measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    /// How long the run was, humans at its ends included.
    pub time_s: f64,
    /// Whether a judge reports collisions, or the world at least counts them.
    pub judged: bool,
    pub counted: bool,
    /// Whether there was other traffic by a script.
    pub scenario: bool,
}

impl Braking {
    pub(super) fn telemetry(&mut self, at_s: f64, speed: Mph, truth: &Truth) {
        (self.at_s, self.mph) = (at_s, speed.get());
        for situation in [&mut self.situation, &mut self.past].into_iter().flatten() {
            situation.least_mph = situation.least_mph.min(self.mph);
        }
        let brakes = |past: &Situation| {
            let slowest_mph = past.least_mph + DRIVES_ON_MPH;
            self.mph <= slowest_mph.min(past.start_mph - DRIVES_ON_MPH) && at_s - past.last_s <= PAST_S
        };
        self.past = self.past.take().filter(brakes);
        let Some(until_s) = truth.time_to_collision_s.filter(|s| s.is_finite()) else { return };
        let until_s = until_s.clamp(0.0, Truth::CLEAR_S);
        self.least_s = Some(self.least_s.map_or(until_s, |least| least.min(until_s)));
        let mph = self.mph;
        if until_s < COURSE_S {
            let new = || Situation { start_mph: mph, least_mph: mph, last_s: at_s, hit: false };
            self.situation.get_or_insert_with(new).last_s = at_s;
            self.past = None;
        } else if self.situation.as_ref().is_some_and(|situation| at_s - situation.last_s >= APART_S) {
            self.end_situation();
        }
    }

    pub(super) fn command(&mut self, command: &CommandRecord) {
        let brakes = command.by == By::Pilot && command.throttle.get() <= EMERGENCY && self.mph > REVERSES_BELOW_MPH;
        let is_first = command.by == By::Pilot && !std::mem::replace(&mut self.has_begun, true);
        if brakes {
            let before = self.emergency_s.replace(self.at_s);
            if is_first {
                self.opening_s = Some(self.at_s);
                return;
            }
            let lasts = self.opening_s.take_if(|began| self.at_s - *began > OPENING_S).is_some();
            let begins = lasts || before.is_none_or(|before| self.at_s - before >= APART_S);
            self.false_alarms += u32::from(begins && self.situation.is_none());
        } else if command.by == By::Pilot {
            self.opening_s = None;
        }
    }

    /// Something was hit at `speed_mph`, relative to it, by the car at `own_mph`.
    pub(super) fn collision(&mut self, speed_mph: f64, own_mph: Option<f64>) {
        // A file may say anything.
        let own_mph = own_mph.map_or(self.mph, |mph| Mph::saturating(mph).get());
        if self.strike(own_mph) {
            self.impacts_mph.push(Mph::saturating(speed_mph).get().abs());
        }
    }

    /// Something was hit, at an unknown speed.
    pub(super) fn hit(&mut self) {
        self.unmeasured += u32::from(self.strike(self.mph));
    }

    /// The car hits the situation's obstacle at `own_mph`; returns whether that is its first hit. A situation that
    /// seemed avoided was not if the car has not driven on since.
    fn strike(&mut self, own_mph: f64) -> bool {
        let start_mph = match (&mut self.situation, self.past.take()) {
            (Some(situation), _) if situation.hit => return false,
            (Some(situation), _) => {
                situation.hit = true;
                situation.start_mph
            }
            (None, Some(past)) => {
                self.avoided -= 1;
                self.reductions_mph.pop(); // its own: none began since
                past.start_mph
            }
            (None, None) => {
                self.elsewhere += 1;
                return false;
            }
        };
        self.least_s = Some(0.0);
        self.reductions_mph.push((start_mph - own_mph).max(0.0));
        true
    }

    /// The car was put elsewhere: what it was heading for is no longer ahead.
    pub(super) fn put(&mut self) {
        (self.situation, self.past) = (None, None);
    }

    fn end_situation(&mut self) {
        if let Some(situation) = self.situation.take().filter(|situation| !situation.hit) {
            self.avoided += 1;
            self.reductions_mph.push(situation.start_mph - situation.least_mph);
            self.past = Some(situation);
        }
    }

    pub(super) fn figures(mut self, known: Known) -> [(Figure, Measure); 5] {
        use Figure as F;
        let Known { time_s, judged, counted, scenario } = known;
        if self.situation.as_ref().is_some_and(|situation| situation.last_s < self.at_s) {
            self.end_situation();
        }
        let hits = self.impacts_mph.len() as f64 + f64::from(self.unmeasured);
        let situations = f64::from(self.avoided) + hits;
        let untold = if judged && !scenario { NO_SCENARIO } else { NOT_TOLD };
        let judged = judged || counted;
        let measure = |value: Option<f64>, why| match self.least_s {
            Some(_) => Measure::told(value, why),
            None => Measure::Unknown(untold),
        };
        let (no_situation, no_impact) = match (judged, self.avoided) {
            (false, _) => (NO_JUDGE, NO_JUDGE),
            _ if self.unmeasured > 0 => (NOT_MET, NOT_MEASURED),
            (true, 0) => (NOT_MET, NOT_MET),
            _ if self.elsewhere > 0 => (NOT_MET, NOT_ON_COURSE),
            (true, _) => (NOT_MET, NOT_HIT),
        };
        let share = (judged && situations > 0.0).then(|| f64::from(self.avoided) / situations);
        let mean =
            |values: &[f64]| (judged && !values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
        let alarms_per_h = (time_s > 0.0).then(|| f64::from(self.false_alarms) * 3600.0 / time_s);
        [
            (F::BrakingAvoided, measure(share, no_situation)),
            (F::Impact, measure(mean(&self.impacts_mph), no_impact)),
            (F::SpeedReduction, measure(mean(&self.reductions_mph), no_situation)),
            (F::MinTimeToCollision, measure(self.least_s.filter(|s| *s < Truth::CLEAR_S), CLEAR)),
            (F::FalseAlarms, measure(alarms_per_h, NO_TIME)),
        ]
    }
}

#[cfg(test)]
mod tests;
