//! Latency compensation: a network is shown the road from where the car will be when its command takes effect.
//!
//! ```text
//! own commands ─┐
//!               ├─▶ how late they take effect ─▶ how the car moves until then ─┐
//! telemetry ────┘                                                              ├─▶ Pilot
//! picture ───────────────────────────────────────▶ warp ───────────────────────┘
//! ```
//! A network learns what to steer where it is. If its command takes effect 200 ms later, a car at 30 mph has gone 2.7 m by
//! then, and in a hairpin it has missed the bend. A network that sees single pictures cannot allow for that, as it knows
//! neither its speed nor the delay. The pilot here does: it wraps any other pilot, which needs no training for it.
//!
//! - *How late?* The simulator reports the steering that was in effect when it took the picture, and we know when we sent
//!   that command. How long ago that was, less the time from one picture to the next, which passes without any latency,
//!   too, is the delay.
//! - *Where to?* The commands that are still on their way are known, too. The simulator's own model of the car ([`Car`])
//!   moves as they say, at the speed that is reported.
//! - *What is seen there?* The picture, warped as if all of it lay on the ground ([`Warp`]). Cliffs, posts and crests do
//!   not, and a turning car sees past the picture's edge. So the car is moved for 0.7 of the delay only, which drives
//!   better than all of it; the network copes with the rest.
//!
//! Pictures of another size than the stock camera's are passed on as they are.

use std::{collections::VecDeque, time::Duration};

use glam::DVec3;

use crate::{
    along::{Beside, Glimpse, Warp},
    vehicle::{Car, STEP_S},
};
use lapwing_core::{
    perception::Frame,
    pilot::{InEffect, Pilot, PilotError, Prediction, View},
    units::{Clock, Degrees, Mph, Steering},
};

/// The time from one picture to the next in training data, in seconds: as the stock simulator records.
const PERIOD_S: f64 = 1.0 / 15.0;
/// A shorter delay is left alone, in seconds.
const LEAST_S: f64 = 0.02;
/// No more of a longer delay than this is allowed for, in seconds: the picture shows too little of the road from further on.
const MOST_S: f64 = 0.5;
/// The share of the delay that is allowed for. When it was chosen, the `pilotnet` of the day left the road in the jungle at 25 mph
/// with 200 ms at 15 % of the lap without it, at 54 % with 0.8, and at 86 % with 1; with 0.6 and 0.7 it got around, 0.26 m and
/// 0.28 m from the line. The `pilotnet` of today, trained on such pictures, drives it with the shares 0.6, 0.7, 0.8 and 0.9, too:
/// 0.21, 0.23, 0.26 and 0.32 m from the line. With 1 it leaves the road at 28 % of the lap.
const SHARE: f64 = 0.7;
/// The delay is the median of the last so many measurements, and unknown until more than half of so many agree with it,
/// to one period.
const AGES: usize = 15;
/// After so long without a picture everything begins anew, in seconds; older commands are forgotten.
const FORGOTTEN_S: f64 = 1.5;
/// The reported steering is that of a command if they differ by no more than this, in degrees: both are sent as text with
/// about four decimals.
const SAME_DEG: f64 = 0.002;

/// A pilot that is shown the road from where the car will be when its command takes effect.
pub struct Ahead {
    pilot: Box<dyn Pilot>,
    clock: Clock,
    /// Made when it is first needed.
    warp: Option<Warp>,
    ahead: Frame,
    /// What was answered, and when, the oldest first.
    sent: VecDeque<(Duration, Steering)>,
    /// How long ago the command in effect had been sent, in seconds: the latest measurements; `None` where it was none of ours.
    ages: VecDeque<Option<f64>>,
    /// The car, moved by the steering and speed that are reported.
    car: Car,
    last: Option<Duration>,
    /// How far apart telemetries come, in seconds: a running mean.
    apart_s: f64,
}

impl Ahead {
    /// This pilot, shown the road ahead.
    pub fn of(pilot: Box<dyn Pilot>, clock: Clock) -> Self {
        Self {
            pilot,
            clock,
            warp: None,
            ahead: Frame::default(),
            sent: VecDeque::new(),
            ages: VecDeque::new(),
            car: Car::default(),
            last: None,
            apart_s: PERIOD_S,
        }
    }

    fn forget(&mut self) {
        self.sent.clear();
        self.ages.clear();
        self.car = Car::default();
        self.last = None;
        self.apart_s = PERIOD_S;
    }

    /// Takes note of what is reported.
    fn told(&mut self, InEffect { at, steering }: InEffect, speed: Mph) {
        let gone_s = self.last.map_or(0.0, |last| at.as_secs_f64() - last.as_secs_f64());
        if (0.0..=FORGOTTEN_S).contains(&gone_s) {
            self.apart_s += (gone_s - self.apart_s) / AGES as f64;
            for _ in 0..(gone_s / STEP_S).round() as usize {
                self.car.step_at(speed.metres_per_second().get(), steering.steering());
            }
        } else {
            self.forget();
        }
        self.last = Some(at);
        let age_s = |sent: &Duration| at.saturating_sub(*sent).as_secs_f64();
        while self.sent.pop_front_if(|(sent, _)| age_s(sent) > FORGOTTEN_S).is_some() {}
        // A command that was given several times tells nothing, and neither does zero: keys that nobody presses give it, too.
        let is_it = |(_, sent): &&(Duration, Steering)| (sent.degrees().get() - steering.get()).abs() <= SAME_DEG;
        let mut of_it = self.sent.iter().filter(is_it);
        let (first, next) = (of_it.next(), of_it.next());
        if next.is_none() && steering.get().abs() > SAME_DEG {
            self.ages.push_back(first.map(|(sent, _)| age_s(sent)));
            if self.ages.len() > AGES {
                self.ages.pop_front();
            }
        }
    }

    /// How late the next command will take effect, in seconds; `None` if that is unknown or too short to matter.
    fn late_s(&self) -> Option<f64> {
        let mut ages: Vec<f64> = self.ages.iter().flatten().copied().collect();
        ages.sort_by(f64::total_cmp);
        let median = *ages.get(ages.len() / 2)?;
        // Where somebody else drives, as in a replay, what is reported equals one of our commands now and then, by chance.
        // In a replay that is as fast as we answer, they lie close together: so must those that agree.
        let near_s = (2.0 * self.apart_s).min(PERIOD_S);
        let agree = ages.iter().filter(|age| (*age - median).abs() <= near_s).count();
        let late_s = median - PERIOD_S;
        (agree > AGES / 2 && late_s >= LEAST_S).then_some(late_s.min(MOST_S))
    }

    /// Where the car will be in `ahead_s` seconds, beside where it is now, if commands take effect `late_s` seconds late.
    fn moved(&self, at: Duration, (ahead_s, late_s): (f64, f64), speed: Mph) -> Beside {
        let mut car = Car { position: DVec3::ZERO, yaw: 0.0, ..self.car };
        let sent_by_s = at.as_secs_f64() - late_s;
        let steps = (ahead_s / STEP_S).round().max(1.0);
        let mut sent = self.sent.iter().peekable();
        let mut steering = Degrees::saturating(self.car.steering.to_degrees()).steering();
        for step in 0..steps as usize {
            let by_s = sent_by_s + (step as f64 + 0.5) * ahead_s / steps;
            while let Some((_, next)) = sent.next_if(|(sent, _)| sent.as_secs_f64() <= by_s) {
                steering = *next;
            }
            car.step_at(speed.metres_per_second().get(), steering);
        }
        Beside { offset_m: car.position.x, ahead_m: car.position.z, heading_rad: car.yaw }
    }

    /// Warps the picture to where the car will be; returns how far ahead that is in time.
    fn look(&mut self, frame: &Frame, told: InEffect, speed: Mph) -> Option<Duration> {
        let late_s = self.late_s()?;
        let ahead_s = SHARE * late_s;
        let beside = self.moved(told.at, (ahead_s, late_s), speed);
        self.warp
            .get_or_insert_default()
            .render(&[Glimpse { pictures: [Some(frame), None, None], beside }], &mut self.ahead)?;
        Some(Duration::from_secs_f64(ahead_s))
    }
}

impl Pilot for Ahead {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        let Some(told) = view.in_effect else { return self.pilot.steer(view) };
        self.told(told, view.speed);
        let began = (self.clock)();
        let ahead = self.look(view.frame, told, view.speed);
        let warped = (self.clock)() - began;
        let frame = if ahead.is_some() { &self.ahead } else { view.frame };
        let prediction = self.pilot.steer(&View { frame, ..*view })?;
        self.sent.push_back((told.at, Steering::saturating(prediction.steering)));
        let preprocess = prediction.preprocess + warped;
        Ok(Prediction { ahead: ahead.unwrap_or_default(), preprocess, ..prediction })
    }

    fn needs_picture(&self) -> bool {
        self.pilot.needs_picture()
    }

    fn reset(&mut self) {
        self.forget();
        self.pilot.reset();
    }
}

#[cfg(test)]
mod tests;
