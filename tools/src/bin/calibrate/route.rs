//! Where on the track a drive was, and how steep it was there.

use lapwing_core::{car::REAR_AXLE_M, motion};
use lapwing_sim::{along::Rotation, locate::LaneTable, track::Track};

use super::recording::Logged;

/// Headings are compared over this distance, in metres.
const COMPARED_M: usize = 24;
/// The search's step, in metres driven.
const STEP_M: usize = 2;
/// A heading that differs by this, in radians, costs one unit; the cost stops growing at three times this.
const HEADING: f64 = 0.15;
/// The cost of driving a metre more or less than the track's middle, in the same unit.
const DETOUR: f64 = 0.15;
/// A drive whose heading fits worse than this, in radians, was not on that track.
const MISFIT: f64 = 0.2;
/// The track's slopes are averaged over this far to either side, in metres: about the car's length. More is worse.
const SMOOTH_M: i32 = 2;
/// Time constant, in seconds, with which the pitch integrated from the pictures returns to the track's grade, and the
/// roll to zero, as the roads are not banked. The flow drifts by about 0.01 rad a second in bends; the jungle's speed
/// RMSE after 5 s hardly depends on this: with the slopes of the scene's waypoints, 1.23 mph with 6 s, 1.37 mph with 12 s.
const PITCH_MEMORY_S: f64 = 6.0;
const ROLL_MEMORY_S: f64 = 1.0;

/// Grades along a drive, a value per row, in metres climbed per metre.
pub struct Route {
    /// The track's grades.
    pub track: Vec<f64>,
    /// Grades from the car's pitch in the pictures; in the long run the track's.
    pub seen: Vec<f64>,
    /// Where the drive began and ended, in metres along the track.
    pub from_to: (f64, f64),
    /// Median difference of heading over [`COMPARED_M`], in radians: how well it fits.
    pub misfit: f64,
}

/// Finds the drive on its track by heading over distance; `None` where it does not fit.
pub fn locate(rows: &[Logged], turns: &[Option<Rotation>], track: &Track) -> Option<Route> {
    // The heading seen at every STEP_M.
    let (rolled, heading) = odometry(rows, turns);
    let steps = (rolled[rolled.len() - 1] / STEP_M as f64) as usize;
    let seen: Vec<f64> = (0..=steps).map(|k| between(&rolled, &heading, (k * STEP_M) as f64)).collect();
    let lag = COMPARED_M / STEP_M;
    if steps <= lag {
        return None;
    }

    // The track's turn over the same distance, a value per metre.
    let metres = track.length().round() as usize;
    let grid = |i: usize| track.length() * i as f64 / metres as f64;
    let bend: Vec<f64> = (0..metres).map(|i| track.at(grid(i)).yaw).collect();
    let bend: Vec<f64> = (0..metres).map(|i| motion::turn(bend[i] - bend[(i + metres - 1) % metres])).collect();
    let turn_at = |i: usize| (0..COMPARED_M).map(|k| bend[(i + metres - k) % metres]).sum::<f64>();
    let turned: Vec<f64> = (0..metres).map(turn_at).collect();

    // The cheapest way along the track: each step is STEP_M, or one metre more or less.
    let mut cost = vec![0.0_f64; metres];
    let mut back: Vec<Vec<u8>> = Vec::new();
    for k in 1..=steps {
        let mut from = vec![0_u8; metres];
        let mut next = vec![0.0; metres];
        for i in 0..metres {
            let way = |d: u8| cost[(i + metres - usize::from(d)) % metres] + if d == 2 { 0.0 } else { DETOUR };
            let best = (1..=3).min_by(|&a, &b| way(a).total_cmp(&way(b))).unwrap_or(2);
            let miss = if k < lag { 0.0 } else { (seen[k] - seen[k - lag] - turned[i]) / HEADING };
            next[i] = way(best) + 0.1 * miss * miss / (1.0 + miss * miss / 9.0);
            from[i] = best;
        }
        cost = next;
        back.push(from);
    }
    let mut i = (0..metres).min_by(|&a, &b| cost[a].total_cmp(&cost[b]))?;
    let (mut places, mut misses, mut place) = (vec![i as f64; steps + 1], Vec::new(), i as f64);
    for k in (1..=steps).rev() {
        if k >= lag {
            misses.push((seen[k] - seen[k - lag] - turned[i]).abs());
        }
        let d = back[k - 1][i];
        i = (i + metres - usize::from(d)) % metres;
        place -= f64::from(d);
        places[k - 1] = place;
    }
    misses.sort_by(f64::total_cmp);
    if misses[misses.len() / 2] > MISFIT {
        return None;
    }

    let at_steps: Vec<f64> = (0..=steps).map(|k| (k * STEP_M) as f64).collect();
    let scale = track.length() / metres as f64;
    // A car heads where its rear axle goes.
    let place = |&rolled: &f64| between(&at_steps, &places, rolled) * scale + REAR_AXLE_M;
    Some(Route::new(rows, turns, track, &rolled.iter().map(place).collect::<Vec<_>>(), misses[misses.len() / 2]))
}

/// Takes the drive's places from a table; between those that are known, the car went on as it rolled. `None` if the table
/// knows less than two.
pub fn told(rows: &[Logged], turns: &[Option<Rotation>], track: &Track, table: &LaneTable) -> Option<Route> {
    let (rolled, heading) = odometry(rows, turns);
    let (mut at, mut places) = (vec![], vec![]);
    for (moment, pose) in &table.rows {
        let (Some(pose), Some(&rolled)) = (pose, rolled.get(*moment)) else { continue };
        let on = |last: &f64| last + motion::around(pose.s_m - last, track.length());
        places.push(places.last().map_or(pose.s_m, on));
        at.push(rolled);
    }
    if places.len() < 2 {
        return None;
    }
    let places: Vec<f64> = rolled.iter().map(|&rolled| between(&at, &places, rolled)).collect();
    let lag =
        (0..rows.len()).filter_map(|i| Some((i, rolled.iter().position(|&m| m >= rolled[i] + COMPARED_M as f64)?)));
    let mut misses: Vec<f64> = lag
        .map(|(i, k)| {
            let bend = motion::turn(track.at(places[k]).yaw - track.at(places[i]).yaw);
            motion::turn(heading[k] - heading[i] - bend).abs()
        })
        .collect();
    misses.sort_by(f64::total_cmp);
    Some(Route::new(rows, turns, track, &places, misses.get(misses.len() / 2).copied().unwrap_or_default()))
}

/// Metres rolled and radians turned by each row.
fn odometry(rows: &[Logged], turns: &[Option<Rotation>]) -> (Vec<f64>, Vec<f64>) {
    let (mut rolled, mut heading) = (vec![0.0_f64], vec![0.0_f64]);
    for (pair, turn) in rows.windows(2).zip(turns) {
        let step = (pair[0].speed + pair[1].speed) / 2.0 * (pair[1].time - pair[0].time);
        rolled.push(rolled[rolled.len() - 1] + step.max(1e-9));
        heading.push(heading[heading.len() - 1] + turn.map_or(0.0, |turn| turn.yaw));
    }
    (rolled, heading)
}

impl Route {
    /// By a place for each row, in metres along the track, counted on from lap to lap.
    fn new(rows: &[Logged], turns: &[Option<Rotation>], track: &Track, places: &[f64], misfit: f64) -> Self {
        let grade = |&s: &f64| {
            (-SMOOTH_M..=SMOOTH_M).map(|d| track.at(s + f64::from(d)).grade).sum::<f64>() / f64::from(2 * SMOOTH_M + 1)
        };
        let grades: Vec<f64> = places.iter().map(grade).collect();
        let around = |s: f64| s.rem_euclid(track.length());
        Self {
            seen: pitch_seen(rows, turns, &grades),
            track: grades,
            from_to: (around(places[0]), around(places[places.len() - 1])),
            misfit,
        }
    }
}

/// Integrates the turns seen, forward and backward in time, held to the track's grade in the long run.
fn pitch_seen(rows: &[Logged], turns: &[Option<Rotation>], grades: &[f64]) -> Vec<f64> {
    let n = rows.len();
    let integrate = |order: &[usize], sign: f64| {
        // The upright in the car's frame, right and ahead; level to start with.
        let (mut right, mut ahead) = (0.0_f64, grades[order[0]].atan().sin());
        let mut pitch = vec![0.0; n];
        pitch[order[0]] = ahead.asin();
        for pair in order.windows(2) {
            let turn = turns[pair[0].min(pair[1])].unwrap_or(Rotation { pitch: 0.0, yaw: 0.0, roll: 0.0 });
            let mut up = (1.0 - right * right - ahead * ahead).max(0.0).sqrt();
            let (sin, cos) = (sign * turn.yaw).sin_cos();
            (right, ahead) = (right * cos - ahead * sin, ahead * cos + right * sin);
            let (sin, cos) = (sign * turn.pitch).sin_cos();
            (up, ahead) = (up * cos - ahead * sin, ahead * cos + up * sin);
            right -= up * (sign * turn.roll).sin();
            let passed = (rows[pair[1]].time - rows[pair[0]].time).abs();
            right -= right * (passed / ROLL_MEMORY_S).min(1.0);
            ahead += (grades[pair[1]].atan().sin() - ahead) * (passed / PITCH_MEMORY_S).min(1.0);
            pitch[pair[1]] = ahead.clamp(-0.99, 0.99).asin();
        }
        pitch
    };
    let order: Vec<usize> = (0..n).collect();
    let reverse: Vec<usize> = (0..n).rev().collect();
    let (forward, backward) = (integrate(&order, 1.0), integrate(&reverse, -1.0));
    forward.iter().zip(backward).map(|(a, b)| ((a + b) / 2.0).tan()).collect()
}

/// `y` at `x`, linearly, for rising `xs`.
fn between(xs: &[f64], ys: &[f64], x: f64) -> f64 {
    motion::between(xs, x, |at| *at, |i| ys[i])
}
