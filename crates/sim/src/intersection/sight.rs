//! What kind of observation the agents have: the benchmark's, or what a driver sees who knows the others' routes.
//!
//! The benchmark's sectors show where other cars are, not where they go: whether the oncoming car turns across one's way,
//! whether the waiting one has been let in, shows when it moves. [`Sight::Routes`] gives what turn signals, lanes and the
//! right of way would tell, in one frame of [`ROUTES`] numbers, all of the order of one:
//!
//! | from | numbers |
//! |---|---|
//! | 0 | own car: offset (by half a lane), speed (by the limit), tangent of the front wheels' angle, sine of the angle to the lane, acceleration (by 8 m/s2), whether it is in the inner lane, whether its goal is, whether it turns left, whether right, metres to the box, to its end and to the goal (by 50 m) |
//! | 12 | for its own lane and the one beside, the next car ahead and the next behind: whether there is one, how far (by 50 m), its speed and how much faster it is than the own car (by the limit) |
//! | 28 | for each of the [`RIVALS`] cars that come first of those whose ways conflict with the own: 18 numbers, see `rivals` |

use serde::{Deserialize, Serialize};

use super::{
    AGENTS, CARS, LENGTH_M,
    agents::Agents,
    observation::OBSERVATION,
    right_of_way::{Right, seconds},
    roads::{self, CONFLICTS, LANE_M, SPANS, SPEED_LIMIT, Turn},
    traffic::Traffic,
};

/// What the agents see.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sight {
    /// The benchmark's: the nearest car in each of eight sectors, three frames.
    #[default]
    Sectors,
    /// Cars in its lanes, and those whose ways conflict with its own.
    Routes,
}

/// Cars in conflict that are seen.
pub const RIVALS: usize = 5;
/// Numbers of [`Sight::Routes`].
pub const ROUTES: usize = OWN + 4 * NEIGHBOUR + RIVALS * RIVAL;

const OWN: usize = 12;
const NEIGHBOUR: usize = 4;
const RIVAL: usize = 18;
/// By what distances are divided, in metres.
const FAR_M: f32 = 50.0;
/// By what accelerations are divided: full braking, in m/s2.
const HARD: f32 = 8.0;
/// How cars may accelerate, in m/s2.
const ACCELERATION: f32 = 2.6;
/// By what times are divided, in seconds.
const SECONDS: f32 = 5.0;
/// A car whose middle is this far or less beside a lane's middle is in that lane, in metres.
const IN_LANE_M: f32 = 1.9;

impl Sight {
    /// Numbers in an observation.
    pub fn numbers(self) -> usize {
        match self {
            Self::Sectors => OBSERVATION,
            Self::Routes => ROUTES,
        }
    }
}

/// A car as others see it.
#[derive(Debug, Clone, Copy)]
struct Seen {
    x: f32,
    y: f32,
    hx: f32,
    hy: f32,
    speed: f32,
    acceleration: f32,
    way: usize,
    along: f32,
    is_agent: bool,
    is_granted: bool,
}

/// All cars but one agent's own.
fn others(agents: &Agents, i: usize, alive: [bool; AGENTS], traffic: &Traffic) -> impl Iterator<Item = Seen> {
    let others = (0..AGENTS).filter(move |k| *k != i && alive[*k]).map(|k| Seen {
        x: agents.x[k],
        y: agents.y[k],
        hx: agents.hx[k],
        hy: agents.hy[k],
        speed: agents.speed[k],
        acceleration: agents.acceleration[k],
        way: agents.way(k),
        along: agents.along[k],
        is_agent: true,
        is_granted: false,
    });
    others.chain((0..traffic.places).filter(|j| traffic.present[*j]).map(|j| {
        let pose = &traffic.pose[j];
        Seen {
            x: pose.x,
            y: pose.y,
            hx: pose.hx,
            hy: pose.hy,
            speed: traffic.speed[j],
            acceleration: traffic.acceleration[j],
            way: usize::from(traffic.way[j]),
            along: traffic.along[j],
            is_agent: false,
            is_granted: traffic.right[j] == Right::Granted,
        }
    }))
}

/// All other cars in a lane of an agent's route, wherever they come from: how far along it, and their speeds along it.
pub(super) fn in_lane(
    agents: &Agents,
    i: usize,
    alive: [bool; AGENTS],
    traffic: &Traffic,
    lane: u8,
) -> impl Iterator<Item = (f32, f32)> {
    let way = &roads::ALL[agents.missions[i].way(lane)];
    others(agents, i, alive, traffic).filter_map(move |car| {
        let (along, _) = way.project_within(car.x, car.y, IN_LANE_M)?;
        let (wx, wy) = way.heading(along);
        Some((along, (car.speed * (car.hx * wx + car.hy * wy)).max(0.0)))
    })
}

/// Writes what an agent sees with [`Sight::Routes`].
pub(super) fn routes(agents: &Agents, i: usize, alive: [bool; AGENTS], traffic: &Traffic, out: &mut [f32; ROUTES]) {
    out.fill(0.0);
    let (mission, way, along) = (&agents.missions[i], &roads::ALL[agents.way(i)], agents.along[i]);
    let (wx, wy) = way.heading(along);
    let flag = |is: bool| f32::from(u8::from(is));
    let to_box = way.approach_m - LENGTH_M / 2.0 - along;
    out[..OWN].copy_from_slice(&[
        agents.offset[i] / (LANE_M / 2.0),
        agents.speed[i] / SPEED_LIMIT,
        agents.steering[i],
        agents.hy[i] * wx - agents.hx[i] * wy,
        agents.acceleration[i] / HARD,
        flag(agents.lane[i] == 1),
        flag(mission.to_lane == 1),
        flag(mission.turn == Turn::Left),
        flag(mission.turn == Turn::Right),
        to_box / FAR_M,
        (way.leaves_m() + LENGTH_M / 2.0 - along) / FAR_M,
        (mission.goal_m(way) - along) / FAR_M,
    ]);
    let (neighbours, conflicts) = out[OWN..].split_at_mut(4 * NEIGHBOUR);
    for (lane, out) in [agents.lane[i], 1 - agents.lane[i]].into_iter().zip(neighbours.chunks_exact_mut(2 * NEIGHBOUR))
    {
        let own = roads::ALL[mission.way(lane)].project(agents.x[i], agents.y[i]).0;
        let mut nearest = [f32::INFINITY; 2];
        for (other, speed) in in_lane(agents, i, alive, traffic, lane) {
            let side = usize::from(other < own);
            let far = (other - own).abs();
            if far < nearest[side] {
                nearest[side] = far;
                let seen = [1.0, far / FAR_M, speed / SPEED_LIMIT, (speed - agents.speed[i]) / SPEED_LIMIT];
                out[side * NEIGHBOUR..][..NEIGHBOUR].copy_from_slice(&seen);
            }
        }
    }
    rivals(agents, i, others(agents, i, alive, traffic), conflicts);
}

/// Writes the cars that come first where their ways cross or join an agent's: its way in its lane, or else that in the lane
/// beside. For each:
/// - that there is one, whether it is in conflict with the own lane, whether it is an agent, whether it has been let in;
/// - for the agent and then for the other car: metres until its nose is where their ways meet, and until its tail is out of
///   there, in how many seconds that could be at the soonest, and how much shorter it could stop;
/// - the other's speed and acceleration, and where it is to the right and ahead.
fn rivals(agents: &Agents, i: usize, others: impl Iterator<Item = Seen>, out: &mut [f32]) {
    let (x, y, hx, hy, speed) = (agents.x[i], agents.y[i], agents.hx[i], agents.hy[i], agents.speed[i]);
    let (own, beside) = (agents.way(i), agents.missions[i].way(1 - agents.lane[i]));
    let mut found = [(0.0_f32, [0.0_f32; RIVAL]); CARS + AGENTS];
    let mut count = 0;
    let flag = |is: bool| f32::from(u8::from(is));
    for car in others {
        let bit = 1 << car.way;
        let in_lane = CONFLICTS[own] & bit != 0;
        if !in_lane && CONFLICTS[beside] & bit == 0 {
            continue;
        }
        let way = if in_lane { own } else { beside };
        let mine = approach(SPANS[way][car.way], agents.along[i], speed);
        let theirs = approach(SPANS[car.way][way], car.along, car.speed);
        if mine[1] < 0.0 || theirs[1] < 0.0 {
            continue; // one of them is past
        }
        let (dx, dy) = (car.x - x, car.y - y);
        let numbers = &mut found[count].1;
        numbers[..4].copy_from_slice(&[1.0, flag(in_lane), flag(car.is_agent), flag(car.is_granted)]);
        numbers[4..9].copy_from_slice(&mine);
        numbers[9..14].copy_from_slice(&theirs);
        numbers[14..].copy_from_slice(&[
            car.speed / SPEED_LIMIT,
            (car.acceleration / HARD).max(-1.0),
            (dx * hy - dy * hx) / FAR_M,
            (dx * hx + dy * hy) / FAR_M,
        ]);
        found[count].0 = theirs[2] + 1e-3 * theirs[3] + if in_lane { 0.0 } else { 100.0 };
        count += 1;
    }
    let found = &mut found[..count];
    found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    for (out, (_, car)) in out.chunks_exact_mut(RIVAL).zip(found) {
        out.copy_from_slice(car);
    }
}

/// How far a car is from a span of its way: metres to it and to its end (by 50 m), seconds to both at the soonest (by 5 s),
/// and metres left if it brakes hard now (by 50 m).
fn approach((from, until): (f32, f32), along: f32, speed: f32) -> [f32; 5] {
    let (to_begin, to_end) = (from - LENGTH_M / 2.0 - along, until + LENGTH_M / 2.0 - along);
    let soonest = |metres: f32| (seconds(metres, speed, ACCELERATION) / SECONDS).min(2.0);
    let stops = speed * speed / (2.0 * HARD);
    [to_begin / FAR_M, to_end / FAR_M, soonest(to_begin), soonest(to_end), (to_begin - stops) / FAR_M]
}

#[cfg(test)]
mod tests {
    use super::{super::missions::BENCHMARK, *};

    #[test]
    fn who_crosses_first_is_first_among_the_rivals_and_who_drives_beside_is_none() {
        let agents = Agents::default();
        let mut seen = [f32::NAN; ROUTES];
        routes(&agents, 0, [true; AGENTS], &Traffic::default(), &mut seen);
        // From the south to the left, 14.2 m before the box at the limit; the goal's lane is the outer one.
        let to_box = (14.2 - LENGTH_M / 2.0) / FAR_M;
        let expected = [0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, to_box];
        assert!(seen[..10].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{seen:?}");
        assert!(seen[OWN..OWN + 4 * NEIGHBOUR].iter().all(|number| *number == 0.0));
        // All three others cross its way: that from the north is first where they meet, some 9 m into the box.
        let rivals = &seen[OWN + 4 * NEIGHBOUR..];
        assert_eq!([0, 1, 2, 3].map(|k| rivals[k * RIVAL]), [1.0, 1.0, 1.0, 0.0]);
        assert_eq!((rivals[1], rivals[2], rivals[3], rivals[14]), (1.0, 1.0, 0.0, 1.0));
        assert!(rivals[9] * FAR_M > 7.0 - LENGTH_M / 2.0 && rivals[9] * FAR_M < 18.0, "{rivals:?}");
        // It is there sooner than the agent, and comes towards it.
        assert!(rivals[11] < rivals[6] && rivals[9] < rivals[10] && rivals[17] > 0.0, "{rivals:?}");
    }

    #[test]
    fn a_car_ahead_in_the_lane_is_a_neighbour_with_its_gap_and_speed() {
        let mut agents = Agents::default();
        agents.start([BENCHMARK[1]; AGENTS]);
        agents.x[1] += 10.0;
        agents.along[1] += 10.0;
        agents.speed[1] = 0.0;
        let mut seen = [f32::NAN; ROUTES];
        routes(&agents, 0, [true, true, false, false], &Traffic::default(), &mut seen);
        let expected = [1.0, 10.0 / FAR_M, 0.0, -1.0];
        assert!(seen[OWN..].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{seen:?}");
        assert!(seen[OWN + NEIGHBOUR..].iter().all(|number| *number == 0.0));
    }
}
