//! A driver who knows the rules: what learnt policies are compared with, and what shows the environment before there are
//! any. Unlike them it sees everything.
//!
//! It changes into its goal's lane where there is room, keeps its distance, and waits at the box for cars that are in
//! its way there or come first.

use super::{
    AGENTS, Action, Environment, LENGTH_M,
    agents::Agents,
    right_of_way::Right,
    roads::{self, CONFLICTS},
    sight,
};

/// How it brakes, in m/s2: less than its car can.
const BRAKING: f32 = 6.5;
/// The hardest that any agent's car brakes, with what it takes to begin, in m/s2.
const HARDEST: f32 = 7.0;
/// It waits with its nose this far in the box, in metres: the others' lanes begin after four.
const LINE_M: f32 = 2.5;
/// Room that it leaves, in metres.
const ROOM_M: f32 = 3.0;
/// It keeps this far from the car ahead, in seconds.
const HEADWAY_S: f32 = 0.7;
/// Room that it wants in the other lane before it changes, behind and ahead, in metres.
const GAP_M: (f32, f32) = (14.0, 12.0);

/// What it would do in an agent's place.
pub fn act(environment: &Environment, i: usize) -> Action {
    let agents = environment.agents();
    let (speed, along) = (agents.speed[i], agents.along[i]);
    let way = &roads::ALL[agents.way(i)];
    let to_line = to_line(agents, i);
    if to_line < speed * speed / (2.0 * BRAKING) + 0.15 * speed + 1.0 && must_wait(environment, i) {
        return Action::SlowDown;
    }
    let goal_lane = agents.missions[i].to_lane;
    let changes = agents.lane[i] != goal_lane && is_clear(environment, i, goal_lane);
    for lane in [Some(agents.lane[i]), changes.then_some(goal_lane)].into_iter().flatten() {
        if let Some((gap, its_speed)) = ahead(environment, i, lane)
            && gap < ROOM_M + HEADWAY_S * speed + (speed * speed - its_speed * its_speed).max(0.0) / (2.0 * BRAKING)
        {
            return Action::SlowDown;
        }
    }
    // Where the goal comes near and the lane beside is taken, it waits for a gap.
    let to_goal = agents.missions[i].goal_m(way) - along;
    if agents.lane[i] != goal_lane && !changes && to_goal < speed * speed / (2.0 * BRAKING) + 25.0 {
        return Action::SlowDown;
    }
    match (changes, goal_lane) {
        (false, _) => Action::KeepLane,
        (true, 1) => Action::ChangeLeft,
        (true, _) => Action::ChangeRight,
    }
}

/// Metres from its nose to where it waits.
fn to_line(agents: &Agents, k: usize) -> f32 {
    roads::ALL[agents.way(k)].approach_m + LINE_M - LENGTH_M / 2.0 - agents.along[k]
}

/// Whether an agent is too near and too fast to wait, or over the line already.
fn cannot_stop(agents: &Agents, k: usize) -> bool {
    let speed = agents.speed[k];
    to_line(agents, k) < (speed * speed / (2.0 * HARDEST) - 0.5).max(-0.5)
}

/// Whether somebody else goes first: is in the box in its way, has the right of way, or is nearer.
fn must_wait(environment: &Environment, i: usize) -> bool {
    let (agents, traffic) = (environment.agents(), environment.traffic());
    if cannot_stop(agents, i) {
        return false;
    }
    let conflicts = CONFLICTS[agents.way(i)] | CONFLICTS[agents.missions[i].way(1 - agents.lane[i])];
    let arrival = |k: usize| to_line(agents, k) / agents.speed[k].max(1.0);
    let goes_first = |k: usize| {
        let theirs = &roads::ALL[agents.way(k)];
        let is_past = agents.along[k] - LENGTH_M / 2.0 > theirs.leaves_m() + 1.0;
        let first = cannot_stop(agents, k) || (arrival(k), k) < (arrival(i), i);
        !is_past && first && conflicts & 1 << agents.way(k) != 0
    };
    let alive = environment.alive();
    (0..AGENTS).any(|k| k != i && alive[k] && goes_first(k))
        || (0..traffic.places)
            .any(|j| traffic.present[j] && traffic.right[j] == Right::Granted && conflicts & 1 << traffic.way[j] != 0)
}

/// Gap to the next car ahead in a lane of its route, in metres, and that car's speed along it.
fn ahead(environment: &Environment, i: usize, lane: u8) -> Option<(f32, f32)> {
    let own = environment.agents().along[i];
    in_lane(environment, i, lane)
        .filter(|(along, _)| *along > own)
        .map(|(along, speed)| (along - own - LENGTH_M, speed))
        .min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Whether there is room for it in a lane.
fn is_clear(environment: &Environment, i: usize, lane: u8) -> bool {
    let own = environment.agents().along[i];
    in_lane(environment, i, lane).all(|(along, _)| along < own - GAP_M.0 || along > own + GAP_M.1)
}

/// All other cars in a lane of its route: how far along it, and their speeds along it.
fn in_lane(environment: &Environment, i: usize, lane: u8) -> impl Iterator<Item = (f32, f32)> {
    sight::in_lane(environment.agents(), i, environment.alive(), environment.traffic(), lane)
}
