//! Hills of a random road, its bridges over itself, and what stands along it.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{CROSSING_HEIGHT_M, Crossing, RandomTrack, WIDTHS_APART};
use crate::track::{Edge, Side, Station, Stretch, Theme, Track};

/// The shortest wave of the hills, in metres, and how many waves there are at most: usually, and where there are
/// crests. With the latter and [`CREST`], crests make up a third of a road, as in the jungle.
const WAVES: (f64, u32) = (150.0, 8);
const CREST_WAVES: (f64, u32) = (60.0, 16);
/// On a crest the grade falls by this much at least, over this many metres.
const CREST: f64 = 0.04;
const CREST_OVER_M: f64 = 20.0;
/// The height between roads that cross, with an allowance for what the spline takes off.
const CROSSING_WITH_SPARE_M: f64 = 1.12 * CROSSING_HEIGHT_M;
/// A straight bends less than this, 1/m.
const STRAIGHT: f64 = 1.0 / 150.0;
/// Bends of the jungle have posts from this on, 1/m.
const POSTS_FROM: f64 = 0.012;

/// The control point, out of `points`, nearest to the middle of the first half of the longest straight.
pub(super) fn longest_straight(stations: &[Station], points: usize) -> usize {
    let runs = runs(stations, |s| s.curvature.abs() < STRAIGHT);
    let (from, count) = runs.iter().copied().max_by_key(|(_, count)| *count).unwrap_or((0, 0));
    let station = (from + count / 4) % stations.len();
    (station as f64 / stations.len() as f64 * points as f64).round() as usize % points
}

/// Stretches of stations that all satisfy: first station and count, past the road's beginning if need be.
fn runs(stations: &[Station], is: impl Fn(&Station) -> bool) -> Vec<(usize, usize)> {
    let n = stations.len();
    let Some(begin) = (0..n).find(|&i| !is(&stations[i])) else { return vec![(0, n)] };
    let mut runs: Vec<(usize, usize)> = vec![];
    let mut within = false;
    for i in begin..begin + n {
        let now = is(&stations[i % n]);
        match runs.last_mut() {
            Some((_, count)) if now && within => *count += 1,
            _ if now => runs.push((i % n, 1)),
            _ => {}
        }
        within = now;
    }
    runs
}

/// A height for each control point; `None` where a bridge would be too steep.
pub(super) fn heights(
    random: &RandomTrack,
    flat: &Track,
    crossings: &[Crossing],
    rng: &mut ChaCha8Rng,
) -> Option<Vec<f64>> {
    let points = flat.file().control_points.len();
    let length = flat.length();
    let (shortest_m, most) = if random.crests { CREST_WAVES } else { WAVES };
    let waves: Vec<(f64, f64, f64)> = (1..=((length / shortest_m) as u32).clamp(1, most))
        .map(|k| (f64::from(k), rng.random_range(0.3..1.0) / f64::from(k), rng.random_range(0.0..TAU)))
        .collect();
    let s = |i: usize| length * i as f64 / points as f64; // control points are a link apart
    let mut hills: Vec<f64> = (0..points)
        .map(|i| waves.iter().map(|(k, size, phase)| size * (TAU * k * s(i) / length + phase).sin()).sum())
        .collect();
    scale(&mut hills, random.hills_m);

    // Each bridge lifts one road by half the height and lowers the other by half, flat near the crossing, then with
    // ramps.
    let mut bridges = vec![0.0; points];
    for crossing in crossings {
        let (over, under) = (flat.at(crossing.over), flat.at(crossing.under));
        let slant = (over.yaw - under.yaw).sin().abs().max(0.3);
        let level = WIDTHS_APART * random.width_m / slant + 8.0;
        // A cosine ramp is steepest in its middle, by PI/2; part of the grade is left for the hills.
        let ramp = CROSSING_WITH_SPARE_M / 2.0 * PI / 2.0 / (0.75 * random.max_grade).max(1e-3);
        let between = flat.ahead(crossing.over, crossing.under).min(flat.ahead(crossing.under, crossing.over));
        if between < 2.0 * (level + ramp) {
            return None;
        }
        for (i, height) in bridges.iter_mut().enumerate() {
            for (at, sign) in [(crossing.over, 1.0), (crossing.under, -1.0)] {
                let away = flat.ahead(at, s(i)).min(flat.ahead(s(i), at));
                let share = ((away - level) / ramp).clamp(0.0, 1.0);
                *height += sign * CROSSING_WITH_SPARE_M / 4.0 * (1.0 + (PI * share).cos());
            }
        }
    }
    // Hills are lowered until nothing is too steep and no crossing too low.
    for _ in 0..40 {
        let sum: Vec<f64> = hills.iter().zip(&bridges).map(|(a, b)| a + b).collect();
        let steepest =
            (0..points).map(|i| (sum[(i + 1) % points] - sum[i]).abs() / (length / points as f64)).fold(0.0, f64::max);
        let height = |at: f64| sum[(at / length * points as f64).round() as usize % points];
        let low = crossings.iter().any(|c| {
            [-20.0, 0.0, 20.0].iter().any(|d| {
                [-20.0, 0.0, 20.0].iter().any(|e| {
                    height((c.over + d).rem_euclid(length)) - height((c.under + e).rem_euclid(length))
                        < 1.05 * CROSSING_HEIGHT_M
                })
            })
        });
        if steepest <= 0.97 * random.max_grade && !low {
            return Some(sum.iter().map(|h| (h * 100.0).round() / 100.0).collect());
        }
        let share = if low || !crossings.is_empty() { 0.85 } else { 0.96 * random.max_grade / steepest };
        hills.iter_mut().for_each(|h| *h *= share);
    }
    None
}

/// Scales and shifts so that the lowest is 0 and the highest `peak`.
fn scale(heights: &mut [f64], peak: f64) {
    let (low, high) = heights.iter().fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(*x), h.max(*x)));
    let size = if high > low { peak / (high - low) } else { 0.0 };
    heights.iter_mut().for_each(|h| *h = (*h - low) * size);
}

/// What stands along the road.
pub(super) fn stretches(
    random: &RandomTrack,
    track: &Track,
    crossings: &[Crossing],
    rng: &mut ChaCha8Rng,
) -> Vec<Stretch> {
    let mut dressing = Dressing { track, taken: vec![], stretches: vec![] };
    let wide = track.half_width() * 2.0;
    for crossing in crossings {
        dressing.put(crossing.over - 4.0 * wide, 8.0 * wide, Side::Both, Edge::Bridge);
    }
    let stations = track.stations();
    let step = track.length() / stations.len() as f64;
    let tightest = stations.iter().map(|s| s.curvature.abs()).fold(0.0, f64::max);

    if random.crests {
        posts_on_crests(&mut dressing, rng);
    }
    // A bridge on one of the straights.
    let mut straights = runs(stations, |s| s.curvature.abs() < STRAIGHT);
    straights.retain(|(_, count)| *count as f64 * step > 45.0);
    if !straights.is_empty() {
        let (from, count) = straights[rng.random_range(0..straights.len())];
        let room = count as f64 * step;
        let long = (room * rng.random_range(0.5..0.9)).min(120.0);
        dressing.put(stations[from].s + (room - long) / 2.0, long, Side::Both, Edge::Bridge);
    }
    // Bends: kerbs, and some with open dirt, blocks or rock on the outer side.
    for right in [true, false] {
        let (inner, outer) = if right { (Side::Right, Side::Left) } else { (Side::Left, Side::Right) };
        let bends = runs(stations, |s| (s.curvature > 0.0) == right && s.curvature.abs() > 0.35 * tightest);
        for (from, count) in bends {
            let (from, long) = (stations[from].s, count as f64 * step);
            if long < 12.0 {
                continue;
            }
            match rng.random_range(0..10) {
                0..5 => {
                    dressing.put(from - 4.0, long + 8.0, inner, Edge::Kerb);
                    dressing.put(from + long / 3.0, long, outer, Edge::Kerb);
                }
                5..7 => {
                    dressing.put(from - 4.0, long + 8.0, inner, Edge::Kerb);
                    dressing.put(from - 2.0, long + 10.0, outer, Edge::Dirt);
                }
                7..9 => dressing.put(from, long, outer, Edge::Blocks),
                _ => dressing.put(from - 5.0, long + 10.0, outer, Edge::Rock),
            }
        }
    }
    // Water and rock wherever there is room.
    for edge in [Edge::Water, Edge::Water, Edge::Rock, Edge::Blocks] {
        for _ in 0..20 {
            let (from, long) = (rng.random_range(0.0..track.length()), rng.random_range(40.0..160.0));
            let side = if rng.random_bool(0.5) { Side::Right } else { Side::Left };
            if dressing.is_free(from, long, side) && (edge != Edge::Water || clear(track, from, long, side)) {
                dressing.put(from, long, side, edge);
                break;
            }
        }
    }
    // In the jungle, posts along the outer side of bends that have nothing yet.
    if track.file().theme == Theme::Jungle {
        for (sign, outer) in [(1.0, Side::Left), (-1.0, Side::Right)] {
            for (from, count) in runs(stations, |s| s.curvature * sign > POSTS_FROM) {
                dressing.put(stations[from].s, count as f64 * step, outer, Edge::Posts);
            }
        }
    }
    dressing.stretches.sort_by(|a, b| a.from_m.total_cmp(&b.from_m));
    dressing.stretches
}

/// Posts along each crest: along half of them on both sides.
fn posts_on_crests(dressing: &mut Dressing<'_>, rng: &mut ChaCha8Rng) {
    let track = dressing.track;
    let stations = track.stations();
    let step = track.length() / stations.len() as f64;
    let grade = |s: f64| track.at(s).grade;
    let half_m = CREST_OVER_M / 2.0;
    for (from, count) in runs(stations, |here| grade(here.s - half_m) - grade(here.s + half_m) > CREST) {
        let side = [Side::Both, Side::Both, Side::Right, Side::Left][rng.random_range(0..4)];
        dressing.put(stations[from].s, count as f64 * step, side, Edge::Posts);
    }
}

/// Whether no other part of the road lies within 45 m beside a stretch, where water would be.
fn clear(track: &Track, from: f64, long: f64, side: Side) -> bool {
    let sign = if side == Side::Right { 1.0 } else { -1.0 };
    (0..=(long / 10.0) as u32).all(|k| {
        let s = from + f64::from(k) * 10.0;
        [20.0, 45.0].iter().all(|out| {
            let point: DVec3 = track.point(s, sign * out);
            let nearest = track.stations().iter().map(|st| (st.position - point).with_y(0.0).length());
            nearest.fold(f64::MAX, f64::min) > out - 5.0
        })
    })
}

/// What stands along a road so far.
struct Dressing<'a> {
    track: &'a Track,
    /// Start, length, side.
    taken: Vec<(f64, f64, Side)>,
    stretches: Vec<Stretch>,
}

impl Dressing<'_> {
    fn is_free(&self, from: f64, long: f64, side: Side) -> bool {
        self.taken.iter().all(|&(other, extent, at)| {
            let apart = side != at && side != Side::Both && at != Side::Both;
            let overlaps = self.track.ahead(from, other) < long || self.track.ahead(other, from) < extent;
            apart || !overlaps
        })
    }

    /// Puts it there, unless something is there already.
    fn put(&mut self, from: f64, long: f64, side: Side, edge: Edge) {
        if self.is_free(from, long, side) {
            let from = from.rem_euclid(self.track.length());
            self.taken.push((from, long, side));
            let round = |s: f64| (s.rem_euclid(self.track.length()) * 10.0).round() / 10.0;
            self.stretches.push(Stretch { from_m: round(from), to_m: round(from + long), side, edge });
        }
    }
}
