//! Judges a drive while it lasts: laps, collisions, leaving the road, being stuck, wrong way.
//!
//! It counts as the simulator's forks do (their rules are in brackets), with thresholds in [`Rules`]:
//! - **Lap** (+1 on reaching waypoint 0 in sequence). Waypoints are lines across the road, evenly spaced from where the
//!   car started, so waypoint 0 is its start. Only the next one in order counts, and only when crossed forwards:
//!   turning round at the line gains nothing, nor does a short cut until the missed waypoints have been passed.
//! - **Off road** (the car touches a trigger beside the road, or |cte| over a limit): the car's
//!   origin is further from the road's middle than the limit, until it is well inside again.
//! - **Collision** (a physics contact): the car's body touches an actor, or a corner of it is beyond a wall. Continued
//!   contact is the same collision; the next one needs a second without contact first.
//! - **Stuck** (under 1 mph for 120 game frames): under that speed for two seconds, with throttle all the while: a car
//!   that is told to stand waits. Not right after the start or a reset, and not while something within a few metres
//!   ahead blocks the way without being touched: standing there is right. The forks have no traffic to wait for, and
//!   nobody who stops the car. How long a car may wait is for the world to say, by [`Judge::stood_s`].
//! - **Wrong way**: facing against the road for a second. Reversing while facing the right way does not count.
//!
//! A car that moves further in a step than it can drive was put there (for a place nearby, [`Judge::put`] must be
//! called): that ends its contacts and its being stuck, and gives it time to start. A car put on its next waypoint, as
//! SelfOracle's build does after a crash, has reached that waypoint.

use serde::{Deserialize, Serialize};

use super::{
    obstacles::{Box2, ahead, flat},
    scene::{Actor, ActorKind},
    track::{Edge, Place, Side, Track},
    vehicle::Car,
};
use lapwing_core::{car::STUCK_THROTTLE, config::Rules, motion, units::MPS_PER_MPH};

/// Sides of the road that can be hit.
const WALLS: [Edge; 3] = [Edge::Bridge, Edge::Blocks, Edge::Rock];
/// A car that moves further between two steps was put there, in metres. 30 mph is 0.27 m in a step of
/// 0.02 s, and 0.9 m in one of 15 Hz.
const PUT_M: f64 = 3.0;
/// How far inside the limit the car must be to count as back on the road, in metres.
const BACK_M: f64 = 0.2;
/// Anything further above or below is on another level of the road, in metres.
const LEVEL_M: f64 = 2.5;
/// No corner is further from the car's origin, in metres: half the body's diagonal plus the offset of its middle.
const REACH_M: f64 = 2.75;
/// How wrong a corner's offset can be in a bend if it is not looked up: half the square of its distance from the car
/// times the sharpest curvature (1/8 m), in metres.
const BEND_M: f64 = 0.5;

/// What was hit.
#[derive(Serialize, Deserialize, Debug, Clone, Copy, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Hit {
    /// Something on the road.
    Actor {
        /// What it is.
        kind: ActorKind,
        /// Which one, in the order of the world's actors.
        index: usize,
    },
    /// A wall along the road.
    Wall(Edge),
}

/// Something that happened.
#[derive(Serialize, Deserialize, Debug, Clone, Copy, PartialEq)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// A lap was completed.
    Lap {
        /// How many laps are completed now.
        number: u32,
        /// How long it took, in seconds, the crossing of the line interpolated between steps.
        time_s: f64,
    },
    /// Something was hit.
    Collision {
        /// What.
        with: Hit,
        /// Speed relative to it in m/s, whatever the angle.
        speed: f64,
    },
    /// Left the road.
    OffRoad {
        /// Metres from the middle, positive to the right.
        offset_m: f64,
    },
    /// Came back to the road.
    BackOnRoad {
        /// Seconds since it was left.
        after_s: f64,
    },
    /// Is stuck.
    Stuck,
    /// Was stuck and moves again.
    Moving,
    /// Faces against the road.
    WrongWay,
    /// No longer faces against the road.
    RightWay,
    /// Reached the next waypoint: which, 0 being the start.
    Waypoint(usize),
}

/// Watches a car.
#[derive(Debug, Clone)]
pub struct Judge {
    rules: Rules,
    off_road_m: f64,
    start_s: f64,
    waypoints: usize,
    /// Waypoint last reached.
    waypoint: usize,
    laps: u32,
    lap_times: Vec<f64>,
    lap_began: f64,
    progress: f64,
    last: Option<Last>,
    off_since: Option<f64>,
    off_roads: u32,
    contacts: Vec<(Hit, f64)>,
    crashed: bool,
    crashes: u32,
    /// Since when it stands, and nothing is in its way.
    stands_since: Option<f64>,
    /// Since when it does so with throttle.
    slow_since: Option<f64>,
    stuck: bool,
    starts_until: f64,
    /// Since when its direction contradicts `wrong_way`.
    turned_since: Option<f64>,
    wrong_way: bool,
}

/// The step before.
#[derive(Debug, Clone, Copy)]
struct Last {
    t: f64,
    position: glam::DVec3,
    s: f64,
    /// Metres along the road from the next waypoint, negative before it.
    beyond: f64,
}

impl Judge {
    /// A judge of a drive that begins at time 0 at `start_s` metres along the road.
    pub fn new(track: &Track, rules: Rules, start_s: f64) -> Self {
        let waypoints = ((track.length() / rules.waypoint_spacing_m).round() as usize).max(3);
        Self {
            off_road_m: rules.off_road_m.unwrap_or(track.half_width()),
            start_s: start_s.rem_euclid(track.length()),
            waypoints,
            waypoint: 0,
            laps: 0,
            lap_times: vec![],
            lap_began: 0.0,
            progress: 0.0,
            last: None,
            off_since: None,
            off_roads: 0,
            contacts: vec![],
            crashed: false,
            crashes: 0,
            stands_since: None,
            slow_since: None,
            stuck: false,
            starts_until: rules.grace_s,
            turned_since: None,
            wrong_way: false,
            rules,
        }
    }

    /// The car was put elsewhere at time `t`: its contacts end, it is no longer stuck and may stand for a while.
    /// [`Judge::step`] notices this itself if the car leaps by more than 3 m.
    pub fn put(&mut self, t: f64) {
        self.starts_until = t + self.rules.grace_s;
        (self.stands_since, self.slow_since) = (None, None);
        self.stuck = false;
        self.contacts.clear();
    }

    /// Looks at the car and everything on the road at time `t`, in seconds, and adds what happened
    /// since the step before to `out`.
    pub fn step(&mut self, t: f64, track: &Track, car: &Car, place: &Place, actors: &[Actor], out: &mut Vec<Verdict>) {
        if self.last.is_some_and(|last| last.position.distance_squared(car.position) > PUT_M * PUT_M) {
            self.put(t);
        }
        self.count_laps(t, track, car, place, out);
        self.watch_edge(t, place, out);
        self.watch_direction(t, car, place, out);
        self.watch_contacts(t, track, car, place, actors, out);
        self.watch_speed(t, car, actors, out);
    }

    fn count_laps(&mut self, t: f64, track: &Track, car: &Car, place: &Place, out: &mut Vec<Verdict>) {
        let s = place.station.s;
        let around = |metres: f64| motion::around(metres, track.length());
        let beyond =
            |waypoint: usize| around(s - self.start_s - track.length() * waypoint as f64 / self.waypoints as f64);
        let mut next = (self.waypoint + 1) % self.waypoints;
        let mut now = beyond(next);
        let last = self.last.unwrap_or(Last { t, position: car.position, s: self.start_s, beyond: now });
        self.progress += around(s - last.s);
        let spacing = track.length() / self.waypoints as f64;
        if last.beyond < 0.0 && (0.0..spacing / 2.0).contains(&now) {
            self.waypoint = next;
            out.push(Verdict::Waypoint(next));
            if next == 0 {
                let at = last.t + (t - last.t) * last.beyond / (last.beyond - now);
                self.laps += 1;
                let time_s = at - self.lap_began;
                self.lap_times.push(time_s);
                self.lap_began = at;
                out.push(Verdict::Lap { number: self.laps, time_s });
            }
            next = (next + 1) % self.waypoints;
            now = beyond(next);
        }
        self.last = Some(Last { t, position: car.position, s, beyond: now });
    }

    fn watch_edge(&mut self, t: f64, place: &Place, out: &mut Vec<Verdict>) {
        let from_middle = place.offset.abs();
        match self.off_since {
            None if from_middle > self.off_road_m => {
                self.off_since = Some(t);
                self.off_roads += 1;
                out.push(Verdict::OffRoad { offset_m: place.offset });
            }
            Some(since) if from_middle <= (self.off_road_m - BACK_M).max(self.off_road_m / 2.0) => {
                self.off_since = None;
                out.push(Verdict::BackOnRoad { after_s: t - since });
            }
            _ => {}
        }
    }

    fn watch_direction(&mut self, t: f64, car: &Car, place: &Place, out: &mut Vec<Verdict>) {
        let wrong = (car.yaw - place.station.yaw).cos() < self.rules.wrong_way_deg.to_radians().cos();
        if wrong == self.wrong_way {
            self.turned_since = None;
        } else if t - *self.turned_since.get_or_insert(t) >= self.rules.wrong_way_s {
            self.wrong_way = wrong;
            self.turned_since = None;
            out.push(if wrong { Verdict::WrongWay } else { Verdict::RightWay });
        }
    }

    fn watch_contacts(
        &mut self,
        t: f64,
        track: &Track,
        car: &Car,
        place: &Place,
        actors: &[Actor],
        out: &mut Vec<Verdict>,
    ) {
        self.crashed = false;
        let velocity = ahead(car.yaw) * car.speed;
        let near_wall = place.offset.abs() + REACH_M + BEND_M > track.half_width() + WALLS[0].stands_off_m();
        if !near_wall && actors.is_empty() && self.contacts.is_empty() {
            return;
        }
        let body = Box2::of_car(car);
        for (index, actor) in actors.iter().enumerate() {
            let same_level = (actor.position.y - car.position.y).abs() < LEVEL_M;
            if same_level && actor.kind.is_obstacle() && body.touches(&Box2::of_actor(actor)) {
                let speed = (velocity - ahead(actor.yaw) * actor.speed).length();
                self.touch(t, Hit::Actor { kind: actor.kind, index }, speed, out);
            }
        }
        if near_wall && let Some(edge) = wall(track, car, place, &body) {
            self.touch(t, Hit::Wall(edge), velocity.length(), out);
        }
        let apart_s = self.rules.apart_s;
        self.contacts.retain(|&(_, touched)| t - touched < apart_s);
    }

    fn touch(&mut self, t: f64, with: Hit, speed: f64, out: &mut Vec<Verdict>) {
        self.crashed = true;
        if let Some((_, touched)) = self.contacts.iter_mut().find(|(hit, _)| *hit == with) {
            *touched = t;
        } else {
            self.contacts.push((with, t));
            self.crashes += 1;
            out.push(Verdict::Collision { with, speed });
        }
    }

    fn watch_speed(&mut self, t: f64, car: &Car, actors: &[Actor], out: &mut Vec<Verdict>) {
        if car.speed.abs() >= self.rules.stuck_mph * MPS_PER_MPH {
            (self.stands_since, self.slow_since) = (None, None);
            if self.stuck {
                self.stuck = false;
                out.push(Verdict::Moving);
            }
        } else if !self.stuck {
            if t < self.starts_until || self.waits(car, actors) {
                (self.stands_since, self.slow_since) = (None, None);
                return;
            }
            self.stands_since.get_or_insert(t);
            if car.throttle < STUCK_THROTTLE {
                self.slow_since = None;
            } else if t - *self.slow_since.get_or_insert(t) >= self.rules.stuck_s {
                self.stuck = true;
                out.push(Verdict::Stuck);
            }
        }
    }

    /// Whether something ahead blocks the way and was not run into.
    fn waits(&self, car: &Car, actors: &[Actor]) -> bool {
        let way = Box2::of_car(car).lengthened(self.rules.waiting_m);
        !self.crashed
            && actors
                .iter()
                .any(|actor| (actor.position.y - car.position.y).abs() < LEVEL_M && way.touches(&Box2::of_actor(actor)))
    }

    /// Laps done.
    pub fn laps(&self) -> u32 {
        self.laps
    }

    /// How long each lap took, in seconds.
    pub fn lap_times(&self) -> &[f64] {
        &self.lap_times
    }

    /// The waypoint last reached; 0 is the start.
    pub fn waypoint(&self) -> usize {
        self.waypoint
    }

    /// How many waypoints there are.
    pub fn waypoints(&self) -> usize {
        self.waypoints
    }

    /// Where the next waypoint is, in metres along the road: a car is put there after a crash.
    pub fn next_waypoint_s(&self, track: &Track) -> f64 {
        let next = (self.waypoint + 1) % self.waypoints;
        (self.start_s + track.length() * next as f64 / self.waypoints as f64).rem_euclid(track.length())
    }

    /// Whether it touches something now.
    pub fn crashed(&self) -> bool {
        self.crashed
    }

    /// Collisions so far.
    pub fn crashes(&self) -> u32 {
        self.crashes
    }

    /// Whether it is off the road now.
    pub fn off_road(&self) -> bool {
        self.off_since.is_some()
    }

    /// How often it left the road so far: `tot_obes` of the forks.
    pub fn off_roads(&self) -> u32 {
        self.off_roads
    }

    /// Whether it is stuck now.
    pub fn stuck(&self) -> bool {
        self.stuck
    }

    /// For how long it has been standing at time `t` with nothing in its way, whatever the throttle, in seconds.
    pub fn stood_s(&self, t: f64) -> f64 {
        self.stands_since.map_or(0.0, |since| t - since)
    }

    /// Whether it faces the wrong way now.
    pub fn wrong_way(&self) -> bool {
        self.wrong_way
    }

    /// Metres along the road from the start, over all laps; driving back subtracts.
    pub fn progress_m(&self) -> f64 {
        self.progress
    }
}

/// The wall that a corner of the car is beyond, if any.
fn wall(track: &Track, car: &Car, place: &Place, body: &Box2) -> Option<Edge> {
    let nearest = track.half_width() + WALLS.iter().fold(f64::INFINITY, |m, wall| m.min(wall.stands_off_m()));
    let middle = flat(place.station.position);
    let right = flat(place.station.right());
    body.corners().into_iter().find_map(|corner| {
        if (corner - middle).dot(right).abs() + BEND_M < nearest {
            return None;
        }
        let point = glam::DVec3::new(corner.x, car.position.y, corner.y);
        let there = track.locate(point, Some(place.station.s));
        let side = if there.offset > 0.0 { Side::Right } else { Side::Left };
        WALLS.into_iter().find(|&edge| {
            there.offset.abs() > track.half_width() + edge.stands_off_m()
                && track.file().has(edge, side, there.station.s)
        })
    })
}

#[cfg(test)]
mod tests;
