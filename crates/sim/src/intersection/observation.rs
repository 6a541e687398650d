//! What an agent sees: the benchmark's 65 numbers (`benchmark/agents/common.py` of SMARTS), three times.
//!
//! | from | numbers |
//! |---|---|
//! | 0 | way to the goal in a straight line, two axes, in metres |
//! | 2 | offset from the middle of the nearer lane, in metres, positive to the right |
//! | 3 | speed, in km/h |
//! | 4 | angle of the front wheels, in quarters of a turn |
//! | 5 | sines of the angles to the lane's direction here and at each of the next 19 metres |
//! | 25 | for each of eight sectors the nearest other car within 50 m: distance in metres, how fast it comes nearer in m/s, in how many seconds it would be here (at most 5), and where it is, two axes, in metres; zeros if there is none |
//!
//! The benchmark's axes are the world's, east and north: the way a car faces does not show. [`Axes::Car`] gives the same
//! numbers on the car's axes, right and ahead. The benchmark's closing speed takes cosines that are not normalised and
//! headings in the wrong unit; here it is the speed along the line between the two cars.

use serde::{Deserialize, Serialize};

use super::{
    AGENTS,
    agents::Agents,
    roads::{self, Way},
    traffic::Traffic,
};

/// Numbers in a frame.
pub const FRAME: usize = 65;
/// Frames in an observation.
pub const FRAMES: usize = 3;
/// Numbers in an observation, the latest frame last.
pub const OBSERVATION: usize = FRAME * FRAMES;

/// Sines of heading errors in a frame.
pub(super) const HEADINGS: std::ops::Range<usize> = 5..25;
/// Where the other cars begin, five numbers each.
pub(super) const OTHERS: usize = 25;
const SECTORS: usize = 8;
const EACH: usize = 5;

/// Others are seen up to here, in metres.
const RADIUS_M: f32 = 50.0;
/// The longest time to a meeting, in seconds.
const LONGEST_S: f32 = 5.0;
/// From m/s to km/h.
pub(super) const KMH: f32 = 3.6;

/// The axes on which places are given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axes {
    /// East and north, as the benchmark has them.
    #[default]
    World,
    /// To the car's right and ahead of it, with one sector straight ahead.
    Car,
}

/// By what to divide each number of a frame to bring it to the order of one: metres by 50, speeds by the limit.
pub const SCALE: [f32; FRAME] = {
    let mut scale = [1.0; FRAME];
    (scale[0], scale[1], scale[2], scale[3]) = (RADIUS_M, RADIUS_M, roads::LANE_M / 2.0, roads::SPEED_LIMIT * KMH);
    let mut i = OTHERS;
    while i < FRAME {
        (scale[i], scale[i + 1], scale[i + 2]) = (RADIUS_M, roads::SPEED_LIMIT, LONGEST_S);
        (scale[i + 3], scale[i + 4]) = (RADIUS_M, RADIUS_M);
        i += EACH;
    }
    scale
};

/// Writes an agent's present frame.
pub(super) fn observe(
    agents: &Agents,
    i: usize,
    alive: [bool; AGENTS],
    traffic: &Traffic,
    axes: Axes,
    frame: &mut [f32; FRAME],
) {
    let (x, y, hx, hy) = (agents.x[i], agents.y[i], agents.hx[i], agents.hy[i]);
    let on_axes = |dx: f32, dy: f32| match axes {
        Axes::World => (dx, dy),
        Axes::Car => (dx * hy - dy * hx, dx * hx + dy * hy),
    };
    let (gx, gy) = agents.goals[i];
    (frame[0], frame[1]) = on_axes(gx - x, gy - y);
    frame[2] = agents.offset[i];
    frame[3] = agents.speed[i] * KMH;
    frame[4] = agents.steering[i].atan() / std::f32::consts::FRAC_PI_2;
    headings(&roads::ALL[agents.way(i)], agents.along[i], hx, hy, &mut frame[HEADINGS]);

    let others = &mut frame[OTHERS..];
    others.fill(0.0);
    let mut nearest = [RADIUS_M * RADIUS_M; SECTORS];
    let own = agents.speed[i];
    let mut see = |dx: f32, dy: f32, vx: f32, vy: f32| {
        let squared = dx * dx + dy * dy;
        if squared >= RADIUS_M * RADIUS_M {
            return;
        }
        let (px, py) = on_axes(dx, dy);
        let sector = match axes {
            Axes::World => octant(px, py),
            // A sixteenth of a turn, so that what is ahead stays in one sector.
            Axes::Car => octant(0.923_879_5 * px - 0.382_683_43 * py, 0.382_683_43 * px + 0.923_879_5 * py),
        };
        if squared < nearest[sector] {
            nearest[sector] = squared;
            let distance = squared.sqrt();
            let closing = (dx * (hx * own - vx) + dy * (hy * own - vy)) / distance.max(1e-3);
            let seconds = (distance / closing.max(1e-5)).min(LONGEST_S);
            others[sector * EACH..][..EACH].copy_from_slice(&[distance, closing, seconds, px, py]);
        }
    };
    for k in (0..AGENTS).filter(|k| *k != i && alive[*k]) {
        let speed = agents.speed[k];
        see(agents.x[k] - x, agents.y[k] - y, agents.hx[k] * speed, agents.hy[k] * speed);
    }
    for j in (0..traffic.places).filter(|j| traffic.present[*j]) {
        let (pose, speed) = (&traffic.pose[j], traffic.speed[j]);
        see(pose.x - x, pose.y - y, pose.hx * speed, pose.hy * speed);
    }
}

/// Sines of the angles from a heading, to the right, to the way's direction at each metre from here on.
fn headings(way: &Way, along: f32, hx: f32, hy: f32, sines: &mut [f32]) {
    let sine = |(wx, wy): (f32, f32)| hy * wx - hx * wy;
    let last = along + sines.len() as f32 - 1.0;
    if last <= way.approach_m || along >= way.leaves_m() || way.curvature == 0.0 {
        sines.fill(sine(way.heading(along)));
        return;
    }
    // In the arc each metre turns by the same angle.
    let (sin, cos) = way.curvature.sin_cos();
    let mut inside: Option<(f32, f32)> = None;
    for (i, value) in sines.iter_mut().enumerate() {
        let s = along + i as f32;
        *value = if s <= way.approach_m || s >= way.leaves_m() {
            sine(way.heading(s))
        } else {
            let (x, y) = inside.map_or_else(|| way.heading(s), |(x, y)| (x * cos + y * sin, y * cos - x * sin));
            inside = Some((x, y));
            sine((x, y))
        };
    }
}

/// The eighth of the circle in which a direction lies, counted anticlockwise from the first axis.
fn octant(x: f32, y: f32) -> usize {
    match (y >= 0.0, x > 0.0, x < 0.0) {
        (true, true, _) => usize::from(y >= x),
        (true, false, _) => 2 + usize::from(-x >= y),
        (false, _, true) => 4 + usize::from(y <= x),
        (false, _, false) => 6 + usize::from(x >= -y),
    }
}

/// Numbers of the whole situation, see [`Environment::state`](super::Environment::state).
pub const STATE: usize = AGENTS * 9 + super::CARS * 6;

/// Writes the whole situation, for a centralised critic: for each agent whether it drives, place (by 50 m), heading,
/// speed (by the limit), steering and the way to its goal (by 50 m); for each background car whether it is there,
/// place, heading and speed. Zeros for who is not there.
pub(super) fn state(agents: &Agents, alive: [bool; AGENTS], traffic: &Traffic, out: &mut [f32]) {
    out.fill(0.0);
    let (own, others) = out.split_at_mut(AGENTS * 9);
    for (i, out) in own.chunks_exact_mut(9).enumerate().filter(|(i, _)| alive[*i]) {
        let (x, y, (gx, gy)) = (agents.x[i], agents.y[i], agents.goals[i]);
        let speed = agents.speed[i] / roads::SPEED_LIMIT;
        let place = [1.0, x / RADIUS_M, y / RADIUS_M, agents.hx[i], agents.hy[i], speed, agents.steering[i]];
        out[..7].copy_from_slice(&place);
        out[7..].copy_from_slice(&[(gx - x) / RADIUS_M, (gy - y) / RADIUS_M]);
    }
    for (j, out) in others.chunks_exact_mut(6).enumerate().filter(|(j, _)| traffic.present[*j]) {
        let (pose, speed) = (&traffic.pose[j], traffic.speed[j] / roads::SPEED_LIMIT);
        out.copy_from_slice(&[1.0, pose.x / RADIUS_M, pose.y / RADIUS_M, pose.hx, pose.hy, speed]);
    }
}

#[cfg(test)]
mod tests {
    use super::{super::missions::BENCHMARK, *};

    fn frame(axes: Axes, alive: [bool; AGENTS]) -> [f32; FRAME] {
        let mut frame = [f32::NAN; FRAME];
        observe(&Agents::default(), 0, alive, &Traffic::default(), axes, &mut frame);
        frame
    }

    #[test]
    fn the_first_frame_of_the_benchmark_holds_what_it_says() {
        let frame = frame(Axes::World, [true, true, false, false]);
        // From (1.6, -24.6) to the goal at (-70.4, 4.8).
        assert!((frame[0] + 72.0).abs() < 1e-4 && (frame[1] - 29.4).abs() < 1e-4, "{frame:?}");
        assert_eq!(frame[2..5], [0.0, 13.89 * 3.6, 0.0]);
        // The arc begins 14.2 m ahead: straight up to there, then to the left, 1/12 rad a metre.
        assert!(frame[HEADINGS][..15].iter().all(|sine| *sine == 0.0));
        assert!((frame[HEADINGS][19] + (4.8_f32 / 12.0).sin()).abs() < 1e-4);
        // The second agent at (-23.8, -1.6) is in the third sector, to the north-west; both come nearer.
        let (dx, dy) = (-25.4_f32, 23.0_f32);
        let distance = dx.hypot(dy);
        let closing = 13.89 * (-dx + dy) / distance;
        let expected = [distance, closing, distance / closing, dx, dy];
        let seen = &frame[OTHERS + 3 * EACH..][..EACH];
        assert!(seen.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{seen:?}, expected {expected:?}");
        assert!(frame[OTHERS..OTHERS + 3 * EACH].iter().all(|number| *number == 0.0));
    }

    #[test]
    fn on_the_cars_axes_a_car_ahead_is_ahead_whichever_way_the_car_faces() {
        for agent in 0..AGENTS {
            let mut agents = Agents::default();
            agents.start(BENCHMARK);
            let other = (agent + 1) % AGENTS;
            agents.x[other] = agents.x[agent] + 10.0 * agents.hx[agent];
            agents.y[other] = agents.y[agent] + 10.0 * agents.hy[agent];
            let mut alive = [false; AGENTS];
            (alive[agent], alive[other]) = (true, true);
            let mut frame = [0.0; FRAME];
            observe(&agents, agent, alive, &Traffic::default(), Axes::Car, &mut frame);
            let ahead = &frame[OTHERS + 2 * EACH..][..EACH];
            assert!((ahead[0] - 10.0).abs() < 1e-4 && ahead[3].abs() < 1e-4 && (ahead[4] - 10.0).abs() < 1e-4);
        }
    }

    #[test]
    fn sectors_are_eighths_of_the_circle_from_east_to_north() {
        for i in 0..8 {
            let (sin, cos) = (i as f32 * std::f32::consts::FRAC_PI_4 + 0.3).sin_cos();
            assert_eq!(octant(cos, sin), i);
        }
        assert_eq!((octant(1.0, 0.0), octant(0.0, 1.0), octant(-1.0, 0.0), octant(0.0, -1.0)), (0, 2, 3, 6));
    }
}
