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

#[cfg(test)]
mod tests {
    use super::{
        super::{
            missions::{BENCHMARK, Mission},
            roads::{Arm, Turn, way_of},
        },
        *,
    };

    const NOBODY: [bool; AGENTS] = [false; AGENTS];
    const FIRST: [bool; AGENTS] = [true, false, false, false];

    /// One agent on its way straight on from the south in the inner lane: its middle so far before the box, and its speed.
    fn agent(before_m: f32, speed: f32) -> Agents {
        let mut agents = Agents::default();
        let from_m = Arm::South.length_m() - before_m;
        agents.start([Mission { turn: Turn::Straight, from_m, ..BENCHMARK[0] }; AGENTS]);
        agents.speed[0] = speed;
        agents
    }

    /// Cars that stand so far before the line of their ways.
    fn standing(cars: &[(usize, f32)]) -> Traffic {
        let mut traffic = Traffic::default();
        for (way, before_m) in cars {
            traffic.put(*way, roads::ALL[*way].approach_m - LENGTH_M / 2.0 - before_m, 0.0);
        }
        traffic
    }

    fn crossing() -> usize {
        way_of(Arm::West, Turn::Straight, 1)
    }

    #[test]
    fn a_car_is_let_in_unless_an_agent_is_in_its_way_in_the_box_or_would_be_before_it_is_through() {
        // From a standstill it takes 5 s to be through, and leaves 0.3 s.
        for (name, way, agents, alive, expected) in [
            ("nobody is there", crossing(), agent(20.0, 8.0), NOBODY, Right::Granted),
            ("comes", crossing(), agent(20.0, 8.0), FIRST, Right::Asked),
            ("comes slowly, and may accelerate", crossing(), agent(20.0, 2.0), FIRST, Right::Asked),
            ("is too far away", crossing(), agent(54.0, 1.0), FIRST, Right::Granted),
            ("waits before the line", crossing(), agent(4.0, 0.0), FIRST, Right::Granted),
            ("stands in the box", crossing(), agent(1.0, 0.0), FIRST, Right::Asked),
            ("leaves the box", crossing(), agent(-22.0, 8.0), FIRST, Right::Asked),
            ("has left it", crossing(), agent(-23.0, 8.0), FIRST, Right::Granted),
            ("goes elsewhere", way_of(Arm::North, Turn::Straight, 1), agent(20.0, 8.0), FIRST, Right::Granted),
        ] {
            let mut traffic = standing(&[(way, 1.0)]);
            decide(&mut traffic, &agents, alive, 1);
            assert_eq!(traffic.right[0], expected, "an agent that {name}");
        }
    }

    #[test]
    fn impatient_drivers_go_where_patient_ones_still_wait() {
        // The agent may be there in 5.8 s.
        for (margin_s, expected) in [(0.3, Right::Granted), (1.0, Right::Asked)] {
            let mut traffic = standing(&[(crossing(), 1.0)]);
            traffic.margin_s[0] = margin_s;
            decide(&mut traffic, &agent(52.0, 1.0), FIRST, 1);
            assert_eq!(traffic.right[0], expected, "{margin_s} s");
        }
    }

    #[test]
    fn a_car_stands_at_the_line_as_long_as_an_agent_is_in_the_box_and_goes_when_it_is_gone() {
        // The agent stands where the box begins, well beside the car's way: nothing but the right of way stops the car.
        let (agents, line) = (agent(0.0, 0.0), roads::ALL[crossing()].approach_m);
        let mut traffic = Traffic::default();
        traffic.put(crossing(), 10.0, 10.0);
        for step in 1..300 {
            traffic.decide(&agents, if step < 200 { FIRST } else { NOBODY }, step);
            traffic.roll(step);
            traffic.roll(step);
            let to_line = line - traffic.along[0] - LENGTH_M / 2.0;
            assert!(step >= 200 || to_line > 0.0, "{to_line} m after {step} steps");
            assert!(step != 199 || to_line < 5.0 && traffic.speed[0] < 0.1, "{to_line} m, {} m/s", traffic.speed[0]);
        }
        assert!(!traffic.present[0] || traffic.right[0] == Right::Past, "{:?}", traffic.right[0]);
        assert!(traffic.entered[0].is_some_and(|step| (200..250).contains(&step)), "{:?}", traffic.entered[0]);
    }

    #[test]
    fn who_asked_first_goes_first_those_beside_it_go_too_and_the_others_when_it_is_through() {
        let opposite = way_of(Arm::East, Turn::Straight, 1);
        let across = way_of(Arm::North, Turn::Straight, 1);
        let mut traffic = standing(&[(across, 1.0), (crossing(), 1.0), (opposite, 1.0)]);
        traffic.right = [Right::Asked; CARS];
        traffic.since[..3].copy_from_slice(&[7, 5, 6]);
        let mut rights = |along: f32| {
            traffic.along[1] = along;
            traffic.along[2] = along;
            decide(&mut traffic, &agent(20.0, 8.0), NOBODY, 9);
            traffic.right[..3].to_vec()
        };
        assert_eq!(rights(60.0), [Right::Asked, Right::Granted, Right::Granted]);
        let leaves = roads::ALL[crossing()].leaves_m();
        assert_eq!(rights(leaves), [Right::Asked, Right::Granted, Right::Granted]);
        assert_eq!(rights(leaves + 3.0), [Right::Granted, Right::Past, Right::Past]);
    }

    #[test]
    fn nobody_is_let_in_who_would_have_to_stop_in_the_box() {
        let behind_box = roads::ALL[crossing()].leaves_m();
        for (beyond_m, speed, expected) in
            [(5.0, 0.0, Right::Asked), (5.0, 8.0, Right::Granted), (11.0, 0.0, Right::Granted)]
        {
            let mut traffic = standing(&[(crossing(), 1.0)]);
            let ahead = traffic.put(crossing(), behind_box + beyond_m, speed);
            traffic.right[ahead] = Right::Past;
            decide(&mut traffic, &agent(20.0, 8.0), NOBODY, 1);
            assert_eq!(traffic.right[0], expected, "{beyond_m} m, {speed} m/s");
        }
    }
}
