//! Who of the background traffic may enter the box: no lights, first come, first served.
//!
//! A car that comes near asks. It is let in when no car is in the box, or has been let in, on a way in
//! [conflict](roads::CONFLICTS) with its own, when nobody who asked before it waits for such a way, when the lane behind
//! the box is moving, and when no agent is in the box in its way or would come into it before the car is through (gap
//! acceptance; impatient drivers leave less time). Once let in it goes on: it has the right of way. So two background
//! cars never meet in the box, and all crashes in it are with agents.

use super::{
    AGENTS, LENGTH_M, WIDTH_M,
    agents::Agents,
    roads::{self, CONFLICTS, Way},
    traffic::{CARS, Traffic},
};

/// Whether a car may enter the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Right {
    /// It is not near yet.
    #[default]
    None,
    /// It has asked.
    Asked,
    /// It may.
    Granted,
    /// It has left the box.
    Past,
}

impl Right {
    /// Whether it must stop at the line.
    pub fn must_wait(self) -> bool {
        matches!(self, Self::None | Self::Asked)
    }
}

/// A car asks this far before it would have to brake for the line, in metres.
const EARLY_M: f32 = 12.0;
/// Braking with which that is reckoned, in m/s2.
const BRAKING: f32 = 3.0;
/// How cars are taken to accelerate in the box, in m/s2.
const ACCELERATION: f32 = 2.0;
/// How an agent may accelerate towards it, in m/s2.
const AGENTS_ACCELERATION: f32 = 2.6;
/// An agent slower than this waits, in m/s.
const WAITING: f32 = 0.5;
/// The lane behind the box must be free of slow cars for this far, in metres: one car's length and gap.
const EXIT_M: f32 = LENGTH_M * 2.0 + 2.5;
/// Slower than this is slow, in m/s.
const SLOW: f32 = 3.0;
/// How far its tail must be out of the box until a car counts as past it, in metres.
const PAST_M: f32 = 1.0;

/// Grants and ends rights for this step.
pub(super) fn decide(traffic: &mut Traffic, agents: &Agents, alive: [bool; AGENTS], step: u32) {
    let mut taken = 0; // ways that conflict with one that is granted
    let mut asking = [0_usize; CARS];
    let mut count = 0;
    for i in 0..traffic.places {
        if !traffic.present[i] {
            continue;
        }
        let own = usize::from(traffic.way[i]);
        let way = &roads::ALL[own];
        match traffic.right[i] {
            Right::Granted if traffic.along[i] - LENGTH_M / 2.0 > way.leaves_m() + PAST_M => {
                traffic.right[i] = Right::Past;
            }
            Right::Granted => taken |= CONFLICTS[own],
            Right::None if is_next(traffic, i, way) => {
                (traffic.right[i], traffic.since[i]) = (Right::Asked, step);
            }
            _ => {}
        }
        if traffic.right[i] == Right::Asked {
            asking[count] = i;
            count += 1;
        }
    }
    let asking = &mut asking[..count];
    asking.sort_unstable_by_key(|i| (traffic.since[*i], *i));
    let mut claimed = 0; // ways that conflict with one that somebody waits for
    for i in asking.iter().copied() {
        let own = usize::from(traffic.way[i]);
        let bit = 1 << own;
        if (taken | claimed) & bit != 0 {
            claimed |= CONFLICTS[own];
        } else if exit_is_free(traffic, agents, alive, own) && agents_leave_room(traffic, i, agents, alive) {
            traffic.right[i] = Right::Granted;
            taken |= CONFLICTS[own];
        }
    }
}

/// Whether a car is near enough to ask, and the first in its lane without the right.
fn is_next(traffic: &Traffic, i: usize, way: &Way) -> bool {
    let (s, speed) = (traffic.along[i], traffic.speed[i]);
    let needs = speed * speed / (2.0 * BRAKING) + EARLY_M;
    way.approach_m - s - LENGTH_M / 2.0 < needs
        && !(0..traffic.places).any(|j| {
            let other = &roads::ALL[traffic.way[j] as usize];
            traffic.present[j]
                && traffic.right[j].must_wait()
                && (other.from, other.lane) == (way.from, way.lane)
                && traffic.along[j] > s
        })
}

/// Whether a car would not have to stop in the box.
fn exit_is_free(traffic: &Traffic, agents: &Agents, alive: [bool; AGENTS], own: usize) -> bool {
    let way = &roads::ALL[own];
    let is_slow = |beyond: f32, speed: f32| beyond > -LENGTH_M && beyond < EXIT_M && speed < SLOW;
    let cars = (0..traffic.places).any(|j| {
        let other = &roads::ALL[traffic.way[j] as usize];
        traffic.present[j]
            && (other.to, other.lane) == (way.to, way.lane)
            && is_slow(traffic.along[j] - other.leaves_m(), traffic.speed[j])
    });
    !cars
        && !(0..AGENTS).any(|k| {
            let place = way.project_within(agents.x[k], agents.y[k], WIDTH_M);
            alive[k] && place.is_some_and(|(along, _)| is_slow(along - way.leaves_m(), agents.speed[k]))
        })
}

/// Whether a car would be through before any agent comes into its way.
fn agents_leave_room(traffic: &Traffic, i: usize, agents: &Agents, alive: [bool; AGENTS]) -> bool {
    let own = usize::from(traffic.way[i]);
    let way = &roads::ALL[own];
    let through = way.leaves_m() + LENGTH_M / 2.0 - traffic.along[i];
    let needs = seconds(through, traffic.speed[i], ACCELERATION) + traffic.margin_s[i];
    !(0..AGENTS).any(|k| {
        let their = &roads::ALL[agents.way(k)];
        let to_box = their.approach_m - LENGTH_M / 2.0 - agents.along[k];
        let is_before = agents.along[k] - LENGTH_M / 2.0 < their.leaves_m();
        let comes = agents.speed[k] > WAITING && seconds(to_box.max(0.0), agents.speed[k], AGENTS_ACCELERATION) < needs;
        alive[k] && CONFLICTS[own] & 1 << agents.way(k) != 0 && is_before && (to_box < 0.0 || comes)
    })
}

/// How long so many metres take from a speed.
pub(super) fn seconds(metres: f32, speed: f32, acceleration: f32) -> f32 {
    ((speed * speed + 2.0 * acceleration * metres.max(0.0)).sqrt() - speed) / acceleration
}
