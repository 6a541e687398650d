//! What follows from a verdict: an event of the run, a wreck that stands for a while, the end or a fresh start.

use std::time::Duration;

use super::{Ending, Simulation, stand};
use crate::{
    judge::{Hit, Verdict},
    vehicle::{self, Car},
};
use lapwing_core::{config::OnCrash, turn::EventRecord, units::MPS_PER_MPH};

/// How long a car that hit something stands before the run ends or it is put back, in seconds.
const WRECKED_S: f64 = 1.0;

impl Simulation {
    pub(super) fn judged(&mut self, t: f64, verdict: Verdict) {
        let at = Duration::from_secs_f64(t);
        let event = match verdict {
            Verdict::Waypoint(_) => return,
            Verdict::Lap { number, time_s } => {
                if self.setup.laps.is_some_and(|laps| number >= laps) {
                    self.end(Ending::LapsDone);
                }
                EventRecord::Lap { number, time_s }
            }
            Verdict::Collision { with, speed } => {
                let with = name_of(&with);
                let own_mph = Some(std::mem::take(&mut self.car.speed).abs() / MPS_PER_MPH);
                if self.wrecked.is_none() {
                    let until = self.steps + (WRECKED_S / vehicle::STEP_S) as u64;
                    self.wrecked = Some((until, Ending::Collision(with.clone())));
                }
                EventRecord::Collision { with, speed_mph: speed / MPS_PER_MPH, own_mph }
            }
            Verdict::OffRoad { offset_m } => {
                if self.setup.on_crash == OnCrash::Reset && self.wrecked.is_none() {
                    self.wrecked = Some((self.steps + 1, Ending::Lost));
                }
                EventRecord::OffRoad { offset_m }
            }
            Verdict::BackOnRoad { after_s } => EventRecord::BackOnRoad { after_s },
            Verdict::Stuck => {
                if self.wrecked.is_none() {
                    self.wrecked = Some((self.steps + 1, Ending::Stuck));
                }
                EventRecord::Stuck
            }
            Verdict::Moving => EventRecord::Moving,
            Verdict::WrongWay => EventRecord::WrongWay,
            Verdict::RightWay => EventRecord::RightWay,
        };
        self.events.push((at, event));
    }

    /// A car that stands for longer than it may counts as stuck, whether it was told to stand or not.
    pub(super) fn watch_idle(&mut self, t: f64) {
        let Some(longest_s) = self.setup.idle_s.map(|idle_s| idle_s.max(self.setup.rules.stuck_s)) else { return };
        if self.wrecked.is_none() && self.ending.is_none() && self.judge.stood_s(t) >= longest_s {
            self.wrecked = Some((self.steps + 1, Ending::Idle(longest_s)));
            self.events.push((Duration::from_secs_f64(t), EventRecord::Stuck));
        }
    }

    /// After a crash: the end, or the next waypoint.
    pub(super) fn crashed(&mut self, why: Ending) {
        self.wrecked = None;
        match self.setup.on_crash {
            OnCrash::Stop => self.end(why),
            OnCrash::Reset => {
                let s = self.judge.next_waypoint_s(&self.setup.track);
                let waypoint = (self.judge.waypoint() + 1) % self.judge.waypoints();
                let offset = self.setup.track.file().driving_line_m;
                self.place = self.setup.track.locate(self.setup.track.point(s, offset), Some(s));
                self.car = Car::default();
                stand(&mut self.car, &self.place);
                self.judge.put(self.time_s());
                let at = Duration::from_secs_f64(self.time_s());
                self.events.push((at, EventRecord::Reset { waypoint: waypoint as u32 }));
            }
        }
    }
}

fn name_of(hit: &Hit) -> String {
    match hit {
        Hit::Actor { kind, .. } => kind.to_string(),
        Hit::Wall(edge) => edge.to_string(),
    }
}
