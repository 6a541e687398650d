//! A closed uniform cubic B-spline, laid out in stations of equal distance.
//!
//! The spline has a continuous curvature and each control point moves only the
//! road around it.

use glam::{DVec2, DVec3};

use super::Station;

/// Pieces of a spline segment over which its length is summed up.
const PIECES: usize = 64;

/// Lays stations at most `step` metres apart; also returns the line's length on the ground plane.
pub(super) fn lay_out(control: &[[f64; 3]], step: f64) -> (Vec<Station>, f64) {
    let fine = control.len() * PIECES;
    let parameter = |i: usize| i as f64 / PIECES as f64;
    let mut travelled = Vec::with_capacity(fine + 1);
    travelled.push(0.0);
    let mut last = position(control, 0.0);
    for i in 1..=fine {
        let here = position(control, parameter(i));
        let moved = DVec2::new(here.x - last.x, here.z - last.z).length();
        travelled.push(travelled[i - 1] + moved);
        last = here;
    }
    let length = travelled[fine];
    let count = (length / step).ceil() as usize;
    let mut i = 0;
    let stations = (0..count)
        .map(|k| {
            let s = length * k as f64 / count as f64;
            while travelled[i + 1] <= s {
                i += 1;
            }
            let within = (s - travelled[i]) / (travelled[i + 1] - travelled[i]);
            station(control, s, parameter(i) + within / PIECES as f64)
        })
        .collect();
    (stations, length)
}

fn weights(u: f64) -> [f64; 4] {
    [
        (1.0 - u).powi(3) / 6.0,
        (3.0 * u.powi(3) - 6.0 * u * u + 4.0) / 6.0,
        (-3.0 * u.powi(3) + 3.0 * u * u + 3.0 * u + 1.0) / 6.0,
        u.powi(3) / 6.0,
    ]
}

fn blend(control: &[[f64; 3]], t: f64, weights: impl Fn(f64) -> [f64; 4]) -> DVec3 {
    let n = control.len();
    let segment = t.floor();
    let weights = weights(t - segment);
    let first = segment as usize + n - 1;
    (0..4).map(|k| DVec3::from_array(control[(first + k) % n]) * weights[k]).sum()
}

fn position(control: &[[f64; 3]], t: f64) -> DVec3 {
    blend(control, t, weights)
}

fn station(control: &[[f64; 3]], s: f64, t: f64) -> Station {
    let first = blend(control, t, |u| {
        [-(1.0 - u).powi(2) / 2.0, (3.0 * u * u - 4.0 * u) / 2.0, (-3.0 * u * u + 2.0 * u + 1.0) / 2.0, u * u / 2.0]
    });
    let second = blend(control, t, |u| [1.0 - u, 3.0 * u - 2.0, 1.0 - 3.0 * u, u]);
    let flat = first.x.hypot(first.z);
    Station {
        s,
        position: position(control, t),
        yaw: first.x.atan2(first.z),
        // Clockwise positive in a left-handed plane.
        curvature: (first.z * second.x - first.x * second.z) / flat.powi(3),
        grade: first.y / flat,
    }
}
