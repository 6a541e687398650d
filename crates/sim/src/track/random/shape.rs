//! The plan of a random road: a round trip through random points, relaxed.
//!
//! The shortest round trip through scattered points never crosses itself and has all that a road should: straights,
//! bends either way, hairpins. As a chain of links of equal length it is then relaxed (position-based dynamics,
//! Müller et al. 2007): links keep their length, joints their largest angle, and links that are not neighbours
//! their distance.

use std::f64::consts::{PI, TAU};

use glam::DVec2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{RandomTrack, WIDTHS_APART};

/// Bends are relaxed to this many times the smallest radius: the spline through the joints bends a little more than
/// they do.
const RADIUS_IN_HAND: f64 = 1.07;
/// Distances are relaxed to this many times the smallest.
const DISTANCE_IN_HAND: f64 = 1.08;
/// Rounds of the relaxation before it counts as failed.
const ROUNDS: usize = 3000;
/// Rounds for which a list of nearby joints is valid.
const ROUNDS_A_LIST: usize = 25;

/// Control points of the road's middle, with legs `ease` times longer than usual; `None` where this draw does not relax.
pub(super) fn draw(track: &RandomTrack, ease: f64, rng: &mut ChaCha8Rng) -> Option<Vec<DVec2>> {
    let mut corners = round_trip(scatter(track, ease, rng));
    let crossing = track.crossings && rng.random_bool(0.7) && cross(&mut corners, rng);
    // Long links first: they bring the whole into shape in few rounds, and short ones then only the details.
    let mut link = (track.min_radius_m / 2.5).clamp(4.0, 12.0);
    let mut halvings = 0;
    while link * 2.0 < 0.85 * track.min_radius_m {
        (link, halvings) = (link * 2.0, halvings + 1);
    }
    let mut chain = chain(&corners, track.length_m, (track.length_m / link).round() as usize);
    let mut relaxed = relax(&mut chain, track, crossing);
    for _ in 0..halvings {
        chain = halve(&chain);
        relaxed = relax(&mut chain, track, crossing);
    }
    relaxed.then_some(chain)
}

/// Random points, not too near to each other, in an ellipse or a box.
fn scatter(track: &RandomTrack, ease: f64, rng: &mut ChaCha8Rng) -> Vec<DVec2> {
    let feature = track.min_radius_m.max(0.55 * WIDTHS_APART * track.width_m);
    let leg = ease * feature * rng.random_range(2.1..4.2);
    let count = ((track.length_m / leg).round() as usize).clamp(if ease > 1.5 { 3 } else { 5 }, 60);
    let (slim, boxed) = (rng.random_range(1.0..2.4f64).sqrt(), rng.random_bool(0.5));
    let mut points: Vec<DVec2> = vec![];
    let mut apart = 1.1 / (count as f64).sqrt(); // of the unit shape; lowered until all points find room
    while points.len() < count {
        let candidate = if boxed {
            DVec2::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0))
        } else {
            let (angle, radius) = (rng.random_range(0.0..TAU), rng.random_range(0.0..1.0f64).sqrt());
            DVec2::new(angle.cos(), angle.sin()) * radius * 1.1
        };
        let candidate = candidate * DVec2::new(slim, 1.0 / slim);
        if points.iter().all(|p| p.distance(candidate) > apart) {
            points.push(candidate);
        } else {
            apart *= 0.998;
        }
    }
    let turned = DVec2::from_angle(rng.random_range(0.0..PI));
    points.iter().map(|p| turned.rotate(*p)).collect()
}

/// The points in the order of a round trip that no exchange of two legs makes shorter, so no two legs cross.
fn round_trip(mut points: Vec<DVec2>) -> Vec<DVec2> {
    let n = points.len();
    for i in 1..n {
        let here = points[i - 1];
        let nearest = (i..n).min_by(|&a, &b| here.distance(points[a]).total_cmp(&here.distance(points[b])));
        points.swap(i, nearest.unwrap_or(i));
    }
    let mut shorter = true;
    while shorter {
        shorter = false;
        for i in 0..n - 1 {
            for j in i + 2..n {
                let (a, b, c, d) = (points[i], points[i + 1], points[j], points[(j + 1) % n]);
                if a.distance(c) + b.distance(d) + 1e-9 < a.distance(b) + c.distance(d) {
                    points[i + 1..=j].reverse();
                    shorter = true;
                }
            }
        }
    }
    points
}

/// Exchanges two legs so that they cross, at a fair angle and with both loops long enough; returns whether there are
/// such legs.
fn cross(corners: &mut [DVec2], rng: &mut ChaCha8Rng) -> bool {
    let n = corners.len();
    for _ in 0..200 {
        let (i, j) = (rng.random_range(0..n - 1), rng.random_range(0..n));
        if j < i + 3 || i + n < j + 3 {
            continue;
        }
        let mut crossed = corners.to_vec();
        crossed[i + 1..=j].reverse();
        let legs: Vec<(DVec2, DVec2)> = (0..n).map(|k| (crossed[k], crossed[(k + 1) % n])).collect();
        let meet = |(a, b): (DVec2, DVec2), (c, d): (DVec2, DVec2)| {
            (b - a).perp_dot(c - a) * (b - a).perp_dot(d - a) < 0.0
                && (d - c).perp_dot(a - c) * (d - c).perp_dot(b - c) < 0.0
        };
        let pairs: Vec<(usize, usize)> =
            (0..n).flat_map(|p| (p + 1..n).map(move |q| (p, q))).filter(|&(p, q)| meet(legs[p], legs[q])).collect();
        let [(p, q)] = pairs[..] else { continue };
        let (u, v) = ((legs[p].1 - legs[p].0).normalize(), (legs[q].1 - legs[q].0).normalize());
        if u.perp_dot(v).abs() > 0.75 {
            corners.copy_from_slice(&crossed);
            return true;
        }
    }
    false
}

/// Joints at equal distances along a polygon scaled to a length.
fn chain(corners: &[DVec2], length: f64, joints: usize) -> Vec<DVec2> {
    let n = corners.len();
    let around: f64 = (0..n).map(|i| corners[i].distance(corners[(i + 1) % n])).sum();
    let (mut leg, mut before) = (0, 0.0);
    (0..joints)
        .map(|k| {
            let wanted = around * k as f64 / joints as f64;
            loop {
                let (a, b) = (corners[leg % n], corners[(leg + 1) % n]);
                let long = a.distance(b);
                if before + long > wanted || leg + 1 == n {
                    break a.lerp(b, ((wanted - before) / long).min(1.0)) * (length / around);
                }
                before += long;
                leg += 1;
            }
        })
        .collect()
}

/// Adds a joint in each link, on the cubic through the four around it.
fn halve(chain: &[DVec2]) -> Vec<DVec2> {
    let n = chain.len();
    let between = |i: usize| {
        let outer = chain[(i + n - 1) % n] + chain[(i + 2) % n];
        (9.0 * (chain[i] + chain[(i + 1) % n]) - outer) / 16.0
    };
    (0..n).flat_map(|i| [chain[i], between(i)]).collect()
}

/// Relaxes until all conditions hold; returns whether they do.
fn relax(chain: &mut [DVec2], track: &RandomTrack, crossing: bool) -> bool {
    let n = chain.len();
    let link = track.length_m / n as f64;
    // The largest distance of a joint from the middle of its neighbours: that on a circle.
    let bulge = link * link / (2.0 * track.min_radius_m * RADIUS_IN_HAND);
    let apart = WIDTHS_APART * track.width_m * DISTANCE_IN_HAND;
    let neighbours = (track.neighbourhood_m() * 0.95 / link) as usize;
    let crossed = if crossing { crossings(chain) } else { vec![] };
    // At a crossing the road may come near itself, for as long as a slanting one needs.
    let exempt = (2.0 * apart / link) as usize;
    let around = |a: usize, b: usize| a.abs_diff(b).min(n - a.abs_diff(b));
    let allowed = |i: usize, j: usize| {
        crossed.iter().any(|&(p, q)| {
            around(i, p) < exempt && around(j, q) < exempt || around(i, q) < exempt && around(j, p) < exempt
        })
    };
    let mut near: Vec<(usize, usize)> = vec![];
    for round in 0..ROUNDS {
        if round % ROUNDS_A_LIST == 0 {
            near.clear();
            for i in 0..n {
                for j in i + neighbours + 1..n {
                    if chain[i].distance_squared(chain[j]) < (apart * 1.6).powi(2) && around(i, j) > neighbours {
                        near.push((i, j));
                    }
                }
            }
            near.retain(|&(i, j)| !allowed(i, j));
        }
        let mut worst: f64 = 0.0;
        for &(i, j) in &near {
            let between = chain[j] - chain[i];
            let missing = apart - between.length();
            if missing > 0.0 {
                worst = worst.max(missing / apart);
                let push = between.normalize_or(DVec2::X) * (missing * 0.25);
                chain[i] -= push;
                chain[j] += push;
            }
        }
        for i in 0..n {
            let (back, on) = ((i + n - 1) % n, (i + 1) % n);
            let out = chain[i] - (chain[back] + chain[on]) / 2.0;
            let beyond = out.length() - bulge;
            if beyond > 0.0 {
                worst = worst.max(beyond / bulge);
                let back_in = out.normalize_or(DVec2::X) * beyond;
                chain[i] -= back_in * 0.5;
                chain[back] += back_in * 0.25;
                chain[on] += back_in * 0.25;
            }
        }
        for i in 0..n {
            let on = (i + 1) % n;
            let between = chain[on] - chain[i];
            let long = between.length() - link;
            worst = worst.max(long.abs() / link);
            let pull = between.normalize_or(DVec2::X) * (long * 0.5);
            chain[i] += pull;
            chain[on] -= pull;
        }
        if worst < 0.02 && round % ROUNDS_A_LIST == 0 {
            return true;
        }
    }
    false
}

/// Pairs of joints at which a chain crosses itself.
fn crossings(chain: &[DVec2]) -> Vec<(usize, usize)> {
    let n = chain.len();
    let meet = |i: usize, j: usize| {
        let (a, b, c, d) = (chain[i], chain[(i + 1) % n], chain[j], chain[(j + 1) % n]);
        (b - a).perp_dot(c - a) * (b - a).perp_dot(d - a) < 0.0
            && (d - c).perp_dot(a - c) * (d - c).perp_dot(b - c) < 0.0
    };
    (0..n).flat_map(|i| (i + 2..n).map(move |j| (i, j))).filter(|&(i, j)| meet(i, j)).collect()
}
