//! Plays a scenario: moves what is on the road, step by step.
//!
//! Positions are kept in road coordinates, distance along and offset, and converted to the ground from there. Only
//! actors whose script says so react to our car: a lead car that keeps its gap, and a crosser that sets off to meet it.

use glam::DVec3;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};

use super::{
    obstacles::FRONT_M,
    scenario::{Draw, Scenario, ScenarioError, Script},
    scene::Actor,
    track::{Place, Track},
    vehicle::{BODY, Car},
};
use lapwing_core::units::MPS_PER_KMH;

/// How strongly a lead car corrects a wrong gap: metres a second for each metre. It closes 90% of an error within 5 s,
/// calmly enough for our own speed controller to follow.
const GAP_GAIN: f64 = 0.5;
/// The hardest a lead car accelerates or brakes to keep its gap, in m/s2; a brisk driver's.
const GAP_ACCELERATION: f64 = 4.0;
/// The top speed of anything here, in m/s.
const TOP_SPEED: f64 = 130.0 * MPS_PER_KMH;
/// Below this speed, in m/s, our car meets nobody.
const STANDING: f64 = 0.1;
/// The tightest that something turns off the road, in metres: the turning circle of a car is about 11 m across.
const TURNING_RADIUS_M: f64 = 6.0;
/// How strongly something that turns off steers for where it wants to be: radians for each metre.
const TURNING_GAIN: f64 = 0.25;
/// Pieces in which our car's way to a crossing is measured, in metres.
const PIECE_M: f64 = 2.0;

/// Everything on the road but our car.
#[derive(Debug, Clone)]
pub struct Traffic {
    actors: Vec<Actor>,
    movers: Vec<Mover>,
}

/// An actor that moves.
#[derive(Debug, Clone)]
struct Mover {
    /// Which actor.
    actor: usize,
    /// Metres along the road.
    s: f64,
    /// Metres to the right of the road's middle.
    offset: f64,
    /// m/s along its way.
    speed: f64,
    way: Way,
}

/// How it moves.
#[derive(Debug, Clone)]
enum Way {
    Lead {
        hold: Hold,
        deceleration: f64,
        build_up: f64,
        end: f64,
    },
    /// `hold` is the lead's way until the onset; `turned` in radians, clockwise from the road.
    TurnOff {
        hold: Hold,
        deceleration: f64,
        end: f64,
        angle: f64,
        to: f64,
        turned: f64,
    },
    Cruise {
        oncoming: bool,
    },
    Cross {
        from: f64,
        to: f64,
        walk: Walk,
        set_off: SetOff,
    },
}

/// Keeps a gap to our car until the onset, in seconds.
#[derive(Debug, Clone, Copy)]
struct Hold {
    gap: f64,
    onset: f64,
}

impl Hold {
    /// The speed after this step.
    fn speed(self, now: f64, between: f64, ego: &Car, dt: f64) -> f64 {
        let wanted = (ego.speed + GAP_GAIN * (self.gap - between)).clamp(0.0, TOP_SPEED);
        now + (wanted - now).clamp(-GAP_ACCELERATION * dt, GAP_ACCELERATION * dt)
    }
}

/// When a crosser sets off.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SetOff {
    /// At this time, in seconds.
    At(f64),
    /// When it needs as long as our car to meet at this share of the car's width.
    ToMeet(f64),
}

/// Standing, then even acceleration over `run_up` metres, then `speed`.
#[derive(Debug, Clone, Copy)]
struct Walk {
    speed: f64,
    run_up: f64,
}

impl Walk {
    /// Metres after this many seconds.
    fn distance(self, seconds: f64) -> f64 {
        let lasts = 2.0 * self.run_up / self.speed;
        if seconds < lasts {
            self.speed * seconds.max(0.0).powi(2) / (2.0 * lasts)
        } else {
            self.speed * seconds - self.run_up
        }
    }

    /// Seconds for this many metres.
    fn seconds(self, distance: f64) -> f64 {
        if distance < self.run_up {
            2.0 * (distance.max(0.0) * self.run_up).sqrt() / self.speed
        } else {
            (distance + self.run_up) / self.speed
        }
    }

    /// m/s after this many seconds.
    fn speed(self, seconds: f64) -> f64 {
        let lasts = 2.0 * self.run_up / self.speed;
        if seconds < lasts { self.speed * seconds.max(0.0) / lasts } else { self.speed }
    }
}

impl Traffic {
    /// Puts everything in its place. Numbers that the scenario leaves open are drawn from `seed`
    /// by [`Scenario::settle`], and so are the actors' looks.
    ///
    /// # Errors
    /// [`ScenarioError::Value`] if the scenario does not pass [`Scenario::check`], if our car would begin beyond the
    /// end of this track, or if it moves so fast that a crosser sets off too late to meet it.
    pub fn new(scenario: &Scenario, track: &Track, seed: u64) -> Result<Self, ScenarioError> {
        scenario.check()?;
        let scenario = scenario.settle(seed);
        let (ego_s, line) = scenario.ego.start(track);
        if ego_s > track.length() {
            return Err(ScenarioError::Value {
                name: scenario.name,
                what: "ego: s_m".into(),
                expected: format!("0 to {:.1}, the length of {}", track.length(), track.file().name),
                got: ego_s.to_string(),
            });
        }
        // Separate from the stream of the draws, so that a scenario keeps its colours when a number changes.
        let mut looks = ChaCha8Rng::seed_from_u64(scenario.seed ^ u64::MAX);
        looks.set_stream(seed);
        let ego_speed = scenario.ego.speed_kmh.value() * MPS_PER_KMH;
        let mut traffic = Self { actors: vec![], movers: vec![] };
        for script in &scenario.actors {
            let look = scenario.looks.look(looks.next_u32());
            let number = |draw: &Draw| draw.value();
            let size = |kind| Actor { kind, position: DVec3::ZERO, yaw: 0.0, speed: 0.0, look }.size();
            let ahead_of_us = |kind, gap_m: &Draw| FRONT_M + number(gap_m) + size(kind).z / 2.0;
            let actor = traffic.actors.len();
            let (kind, ahead, offset, turned, mover) = match script {
                Script::Parked { kind, ahead_m, offset_m, yaw_deg } => {
                    (*kind, number(ahead_m), number(offset_m), number(yaw_deg).to_radians(), None)
                }
                Script::Lead { kind, gap_m, offset_m, speed_kmh, onset_s, deceleration, build_up_s, final_kmh } => {
                    let way = Way::Lead {
                        hold: Hold { gap: number(gap_m), onset: number(onset_s) },
                        deceleration: number(deceleration),
                        build_up: number(build_up_s),
                        end: number(final_kmh) * MPS_PER_KMH,
                    };
                    let speed = speed_kmh.as_ref().map_or(ego_speed, |draw| number(draw) * MPS_PER_KMH);
                    (*kind, ahead_of_us(*kind, gap_m), number(offset_m), 0.0, Some((speed, way)))
                }
                Script::TurnOff { kind, gap_m, onset_s, deceleration, final_kmh, angle_deg, to_m } => {
                    let way = Way::TurnOff {
                        hold: Hold { gap: number(gap_m), onset: number(onset_s) },
                        deceleration: number(deceleration),
                        end: number(final_kmh) * MPS_PER_KMH,
                        angle: number(angle_deg).to_radians(),
                        to: line + number(to_m),
                        turned: 0.0,
                    };
                    (*kind, ahead_of_us(*kind, gap_m), 0.0, 0.0, Some((ego_speed, way)))
                }
                Script::Cruise { kind, ahead_m, offset_m, speed_kmh, oncoming } => {
                    let turned = if *oncoming { std::f64::consts::PI } else { 0.0 };
                    let mover = (number(speed_kmh) * MPS_PER_KMH, Way::Cruise { oncoming: *oncoming });
                    (*kind, number(ahead_m), number(offset_m), turned, Some(mover))
                }
                Script::Cross { kind, ahead_m, from_m, to_m, speed_kmh, run_up_m, at_s, share } => {
                    let set_off = match share {
                        Some(share) => SetOff::ToMeet(number(share)),
                        None => SetOff::At(at_s.as_ref().map_or(0.0, Draw::value)),
                    };
                    let (from, to) = (number(from_m), number(to_m));
                    let walk = Walk { speed: number(speed_kmh) * MPS_PER_KMH, run_up: number(run_up_m) };
                    let turned = std::f64::consts::FRAC_PI_2.copysign(to - from);
                    let way = Way::Cross { from: line + from, to: line + to, walk, set_off };
                    (*kind, number(ahead_m), from, turned, Some((0.0, way)))
                }
            };
            let (s, offset) = ((ego_s + ahead).rem_euclid(track.length()), line + offset);
            traffic.actors.push(Actor { kind, position: DVec3::ZERO, yaw: turned, speed: 0.0, look });
            let standing = Mover { actor, s, offset, speed: 0.0, way: Way::Cruise { oncoming: false } };
            place(&mut traffic.actors[actor], track, &standing, turned);
            if let Some((speed, way)) = mover {
                traffic.actors[actor].speed = speed;
                traffic.movers.push(Mover { speed, way, ..standing });
            }
        }
        traffic.check_meetings(&scenario, track, ego_s, line)?;
        Ok(traffic)
    }

    /// Checks that each crosser meant to meet our car can do so if our car holds its initial speed.
    fn check_meetings(&self, scenario: &Scenario, track: &Track, s: f64, offset: f64) -> Result<(), ScenarioError> {
        let place = Place { station: track.at(s), offset };
        let ego = Car { speed: scenario.ego.speed_kmh.value() * MPS_PER_KMH, ..Car::default() };
        for mover in &self.movers {
            let Way::Cross { from, to, walk, set_off: SetOff::ToMeet(share) } = mover.way else { continue };
            let width = self.actors[mover.actor].size().x;
            if let Some(at) = meeting(0.0, track, mover.s, from, to, walk, share, width, &ego, &place)
                && at < 0.0
            {
                let ahead = signed(track, s, mover.s);
                return Err(ScenarioError::Value {
                    name: scenario.name.clone(),
                    what: format!("actor {}: ahead_m", mover.actor),
                    expected: format!("at least {:.1}, or it sets off too late", ahead - at * ego.speed),
                    got: format!("{ahead:.1}"),
                });
            }
        }
        Ok(())
    }

    /// Everything on the road, in the scenario's order.
    pub fn actors(&self) -> &[Actor] {
        &self.actors
    }

    /// Advances everything by `dt` to time `t`, in seconds from the run's start. `ego` and its place are those at `t`:
    /// our car has moved already.
    pub fn step(&mut self, t: f64, dt: f64, track: &Track, ego: &Car, ego_place: &Place) {
        for mover in &mut self.movers {
            let actor = &mut self.actors[mover.actor];
            let turned = mover.step(t, dt, track, actor.size(), ego, ego_place);
            place(actor, track, mover, turned);
        }
    }
}

/// Puts an actor where its mover is, turned by `turned` from the road's direction.
fn place(actor: &mut Actor, track: &Track, mover: &Mover, turned: f64) {
    let station = track.at(mover.s);
    actor.position = station.position + station.right() * mover.offset;
    actor.yaw = station.yaw + turned;
    actor.speed = mover.speed;
}

impl Mover {
    /// Advances; returns how far it is turned from the road's direction, in radians.
    fn step(&mut self, t: f64, dt: f64, track: &Track, size: DVec3, ego: &Car, ego_place: &Place) -> f64 {
        // Where our car has moved already, it will have moved, too.
        let between = |s: f64, speed: f64| signed(track, ego_place.station.s, s + speed * dt) - FRONT_M - size.z / 2.0;
        match &mut self.way {
            Way::Lead { hold, deceleration, build_up, end } => {
                let before = self.speed;
                if t <= hold.onset {
                    self.speed = hold.speed(before, between(self.s, before), ego, dt);
                } else {
                    // The speed lost at a time after the onset; exact for any step.
                    let lost = |since: f64| match since {
                        s if s <= 0.0 => 0.0,
                        s if s < *build_up => *deceleration * s * s / (2.0 * *build_up),
                        s => *deceleration * (s - *build_up / 2.0),
                    };
                    let loses = lost(t - hold.onset) - lost(t - dt - hold.onset);
                    self.speed = (self.speed - loses).max(end.min(self.speed));
                }
                self.s = forward(track, self.s, self.offset, (before + self.speed) / 2.0 * dt);
                0.0
            }
            Way::TurnOff { hold, deceleration, end, angle, to, turned } => {
                let before = self.speed;
                if t <= hold.onset {
                    self.speed = hold.speed(before, between(self.s, before), ego, dt);
                } else {
                    self.speed = (before - *deceleration * dt).max(end.min(before));
                    if self.speed <= *end + 0.5 {
                        let wanted = (TURNING_GAIN * (*to - self.offset)).clamp(-*angle, *angle);
                        let most = self.speed / TURNING_RADIUS_M * dt;
                        *turned += (wanted - *turned).clamp(-most, most);
                    }
                }
                let moved = (before + self.speed) / 2.0 * dt;
                self.s = forward(track, self.s, self.offset, moved * turned.cos());
                self.offset += moved * turned.sin();
                *turned
            }
            Way::Cruise { oncoming } => {
                let (sign, turned) = if *oncoming { (-1.0, std::f64::consts::PI) } else { (1.0, 0.0) };
                self.s = forward(track, self.s, self.offset, sign * self.speed * dt);
                turned
            }
            Way::Cross { from, to, walk, set_off } => {
                if let SetOff::ToMeet(share) = *set_off
                    && let Some(at) = meeting(t, track, self.s, *from, *to, *walk, share, size.x, ego, ego_place)
                    && at <= t
                {
                    *set_off = SetOff::At(at.max(t - dt));
                }
                if let SetOff::At(at) = *set_off {
                    let (way, since) = ((*to - *from).abs(), t - at);
                    let walked = walk.distance(since).min(way);
                    self.offset = *from + walked.copysign(*to - *from);
                    self.speed = if walked < way { walk.speed(since) } else { 0.0 };
                }
                std::f64::consts::FRAC_PI_2.copysign(*to - *from)
            }
        }
    }
}

/// Distance from `from` to `to` along the road, in metres, negative if `to` is behind: the shorter way round.
pub(super) fn signed(track: &Track, from: f64, to: f64) -> f64 {
    let ahead = track.ahead(from, to);
    if ahead > track.length() / 2.0 { ahead - track.length() } else { ahead }
}

/// The distance along the road after `metres` at an offset, where a bend is longer or shorter.
fn forward(track: &Track, s: f64, offset: f64, metres: f64) -> f64 {
    let bend = (1.0 - track.at(s).curvature * offset).max(0.2);
    (s + metres / bend).rem_euclid(track.length())
}

/// When a crosser at `s` has to set off so that our car's front meets it with the given share of the car's width
/// between the crosser's middle and the side it comes from; `width` is the crosser's. Assumes that the car keeps its speed, as Euro NCAP does to
/// synchronise its targets. None if the car does not come.
#[expect(clippy::too_many_arguments, reason = "the geometry of a meeting has that many parts")]
fn meeting(
    t: f64,
    track: &Track,
    s: f64,
    from: f64,
    to: f64,
    walk: Walk,
    share: f64,
    width: f64,
    ego: &Car,
    ego_place: &Place,
) -> Option<f64> {
    if ego.speed < STANDING {
        return None;
    }
    let way = signed(track, ego_place.station.s, s);
    if way < 0.0 {
        return None;
    }
    // The way on the car's own line, and its end: the front touches the crosser's side, which
    // as it faces across the road is half its width before its middle.
    let pieces = (way / PIECE_M).ceil().max(1.0);
    let piece = way / pieces;
    let metres: f64 = (0..pieces as usize)
        .map(|i| piece * (1.0 - track.at(ego_place.station.s + (i as f64 + 0.5) * piece).curvature * ego_place.offset))
        .sum();
    let until = (metres - FRONT_M - width / 2.0) / ego.speed;
    let side = (from - to).signum(); // 1 where it comes from the right
    let meets = ego_place.offset + side * BODY.x * (0.5 - share);
    let walks = walk.seconds(((meets - from) * -side).max(0.0));
    Some(t + until - walks)
}

#[cfg(test)]
mod tests;
