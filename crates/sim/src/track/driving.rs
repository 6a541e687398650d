//! The line to drive: as near to the file's `driving_line_m` as a car can comfortably go.
//!
//! A lane's middle is not a line for a car: the inner lane of a sharp bend is tighter than any car turns, and every
//! bend begins with a jerk. So the line is smoothed once for each track: of all lines on the road, it is the one that
//! strays little from the lane's middle, changes its curvature little, and is nowhere tighter than a car can turn with
//! some steering to spare. That is least squares over the offsets of all stations, solved by Gauss-Newton; curvature
//! and edges are limits, enforced by penalties.

use std::f64::consts::TAU;

use glam::DVec3;

use super::Station;
use crate::vehicle::BODY;
use lapwing_core::motion::turn;

/// Over how many metres a change of the road's curvature is spread. Lower keeps nearer to the lane's middle.
const SPREAD_M: f64 = 3.5;
/// The tightest that the line may be, 1/m, where the road is wide enough: three quarters of the car's full lock.
const TIGHTEST: f64 = 0.12;
/// Distance kept between the body's side and the edge of the road, in metres.
const MARGIN_M: f64 = 0.6;
/// Weight of the squared curvature beyond [`TIGHTEST`], in m² per (1/m)².
const TOO_TIGHT: f64 = 1e5;
/// Weight of a metre beyond the edge, relative to one from the lane's middle.
const TOO_FAR: f64 = 1e3;
/// Steps of Gauss-Newton at most: the jungle needs 17, the others 4.
const STEPS: usize = 40;
/// Stations by which both ends overlap, as the road is closed but the solver's band is not: 60 m.
const OVERLAP: usize = 120;

/// A point of the line to drive, beside the road's station of the same number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePoint {
    /// Distance along this line from its first point, in metres.
    pub travelled: f64,
    /// Where it is, at the height of the road's middle.
    pub position: DVec3,
    /// Metres right of the road's middle.
    pub offset: f64,
    /// Direction, radians clockwise from +z.
    pub yaw: f64,
    /// 1/m, positive to the right.
    pub curvature: f64,
}

/// Finds the line around a closed road; also returns its length.
pub(super) fn smooth(stations: &[Station], wanted: f64, width: f64) -> (Vec<LinePoint>, f64) {
    let room = (width / 2.0 - BODY.x / 2.0 - MARGIN_M).max(0.0);
    let wanted = wanted.clamp(-room, room);
    let n = stations.len();
    let mut offsets = vec![wanted; n];
    for _ in 0..STEPS {
        let points = points(stations, &offsets);
        let step = improve(stations, &points, wanted, room);
        let largest = step.iter().fold(0.0f64, |m, d| m.max(d.abs()));
        let share = (0.5 / largest).min(1.0); // half a metre at once: beyond that, the linearisation is wrong
        for (offset, d) in offsets.iter_mut().zip(step) {
            *offset += share * d;
        }
        if largest < 1e-4 {
            break;
        }
    }
    let points = points(stations, &offsets);
    let closing = (points[0].position - points[n - 1].position).with_y(0.0).length();
    let length = points[n - 1].travelled + closing;
    (points, length)
}

/// The points of the line at these offsets.
fn points(stations: &[Station], offsets: &[f64]) -> Vec<LinePoint> {
    let n = stations.len();
    let position = |i: usize| stations[i].position + stations[i].right() * offsets[i];
    let mut travelled = 0.0;
    (0..n)
        .map(|i| {
            let (back, here, on) = (position((i + n - 1) % n), position(i), position((i + 1) % n));
            let (came, goes) = ((here - back).with_y(0.0), (on - here).with_y(0.0));
            if i > 0 {
                travelled += came.length();
            }
            let bent = turn(goes.x.atan2(goes.z) - came.x.atan2(came.z));
            LinePoint {
                travelled,
                position: here,
                offset: offsets[i],
                yaw: (came.x.atan2(came.z) + bent / 2.0).rem_euclid(TAU),
                curvature: bent / ((came.length() + goes.length()) / 2.0),
            }
        })
        .collect()
}

/// A step of Gauss-Newton for the offsets.
fn improve(stations: &[Station], points: &[LinePoint], wanted: f64, room: f64) -> Vec<f64> {
    let n = stations.len();
    let mut system = Banded::new(n + 2 * OVERLAP);
    let at = |k: usize| (k + n * (OVERLAP / n + 1) - OVERLAP) % n; // of the unrolled road
    let spacing = |i: usize| {
        let (a, b) = (points[(i + n - 1) % n].position, points[(i + 1) % n].position);
        ((b - a).with_y(0.0).length() / 2.0).max(0.05)
    };
    // How the curvature at a station depends on the offsets of the one before, its own and the one after.
    let answer = |i: usize| {
        let h = spacing(i);
        let c = 1.0 / (h * h);
        [c, points[i].curvature.powi(2) - 2.0 * c, c]
    };
    for k in 0..n + 2 * OVERLAP {
        let i = at(k);
        let point = &points[i];
        system.add(k, &[1.0], wanted - point.offset, 1.0);
        let beyond = point.offset - point.offset.clamp(-room, room);
        if beyond != 0.0 {
            system.add(k, &[1.0], -beyond, TOO_FAR);
        }
        if k == 0 || k + 2 >= n + 2 * OVERLAP {
            continue;
        }
        let here = answer(i);
        let too_tight = point.curvature - point.curvature.clamp(-TIGHTEST, TIGHTEST);
        if too_tight != 0.0 {
            system.add(k - 1, &here, -too_tight, TOO_TIGHT);
        }
        // Change of curvature to the next station, per metre.
        let next = (i + 1) % n;
        let on = answer(next);
        let h = spacing(i);
        let row = [-here[0], on[0] - here[1], on[1] - here[2], on[2]].map(|x| x / h);
        system.add(k - 1, &row, (point.curvature - points[next].curvature) / h, SPREAD_M.powi(6));
    }
    let solved = system.solve();
    solved[OVERLAP..OVERLAP + n].to_vec()
}

/// Normal equations that couple unknowns up to three apart: a symmetric matrix with a band of four.
struct Banded {
    /// Diagonal, then the three below it: `band[i][d]` couples `i` and `i - d`.
    band: Vec<[f64; 4]>,
    right: Vec<f64>,
}

impl Banded {
    fn new(n: usize) -> Self {
        Self { band: vec![[0.0; 4]; n], right: vec![0.0; n] }
    }

    /// One equation, `row` times the unknowns from `first` on `= value`, in the least-squares sense.
    fn add(&mut self, first: usize, row: &[f64], value: f64, weight: f64) {
        for (a, x) in row.iter().enumerate() {
            for (b, y) in row.iter().enumerate().take(a + 1) {
                self.band[first + a][a - b] += weight * x * y;
            }
            self.right[first + a] += weight * x * value;
        }
    }

    /// Cholesky. The matrix is positive definite: each unknown has an equation of its own.
    fn solve(mut self) -> Vec<f64> {
        let n = self.right.len();
        for i in 0..n {
            for d in (0..=3.min(i)).rev() {
                let j = i - d;
                // Columns that both rows reach: from i - 3 to j - 1.
                let sum: f64 = (i.saturating_sub(3)..j).map(|k| self.band[i][i - k] * self.band[j][j - k]).sum();
                let rest = self.band[i][d] - sum;
                self.band[i][d] = if d == 0 { rest.max(1e-12).sqrt() } else { rest / self.band[j][0] };
            }
            let sum: f64 = (1..=3.min(i)).map(|d| self.band[i][d] * self.right[i - d]).sum();
            self.right[i] = (self.right[i] - sum) / self.band[i][0];
        }
        for i in (0..n).rev() {
            let sum: f64 = (1..=3.min(n - 1 - i)).map(|d| self.band[i + d][d] * self.right[i + d]).sum();
            self.right[i] = (self.right[i] - sum) / self.band[i][0];
        }
        self.right
    }
}

#[cfg(test)]
mod tests {
    use super::{super::Track, *};

    #[test]
    fn the_solver_solves() {
        let mut system = Banded::new(6);
        let unknowns = [1.0, -2.0, 0.5, 3.0, -1.0, 2.0];
        let row = [1.0, -3.0, 3.5, -1.0];
        for i in 0..6 {
            system.add(i, &[1.0], unknowns[i], 0.5);
            if i < 3 {
                system.add(i, &row, (0..4).map(|k| row[k] * unknowns[i + k]).sum(), 7.0);
            }
        }
        for (got, expected) in system.solve().iter().zip(unknowns) {
            assert!((got - expected).abs() < 1e-9, "{got}, expected {expected}");
        }
    }

    #[test]
    fn the_line_keeps_on_the_road_and_is_nowhere_too_tight_for_the_car() {
        for name in Track::NAMES {
            let track = Track::named(name).unwrap();
            let line = track.driving_line();
            let tightest = line.iter().map(|p| p.curvature.abs()).fold(0.0, f64::max);
            assert!(tightest < 1.05 * TIGHTEST, "{name}: radius {:.2} m", 1.0 / tightest);
            let far = line.iter().map(|p| p.offset.abs()).fold(0.0, f64::max);
            assert!(far < track.half_width() - BODY.x / 2.0 - MARGIN_M + 0.1, "{name}: {far:.2} m from the middle");
        }
    }

    #[test]
    fn where_bends_are_wide_the_line_is_the_lanes_middle() {
        let track = Track::named("lake").unwrap();
        let line = track.driving_line();
        let mean = line.iter().map(|p| p.offset.abs()).sum::<f64>() / line.len() as f64;
        assert!(mean < 0.05, "{mean:.3} m");
    }
}
