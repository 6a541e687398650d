//! The course and the drive along it that explain the pictures best.

use std::ops::Range;

use glam::DVec3;
use lapwing_tools::{
    course::{Course, STAND, Stand},
    drive::Drive,
};
use rayon::prelude::*;

use crate::{
    lines::Line,
    solve::{Equations, Slope},
    witness::Witness,
};

/// By how many metres a control point is moved to take derivatives.
pub const NUDGE_M: f64 = 0.02;
/// Standard deviations of a body's pitch and roll, in radians, and of the first stand.
const PITCH_RAD: f64 = 0.012;
const ROLL_RAD: f64 = 0.01;
const FIRST: Stand = [0.4, 0.5, 0.1, 0.02, 0.02];
/// The same of a stand that was found before.
const KNOWN: f64 = 0.003;
/// Standard deviations of a step, as what is found in a picture holds for small steps only: of a stand's place, offset
/// and heading, and of a control point in metres.
const LEAPS: [f64; 3] = [0.1, 3.0, 0.5];
const LEAP_M: f64 = 0.5;
/// The farthest that a control point moves in one step, in metres.
const FARTHEST_M: f64 = 3.0;
/// Standard deviations of a car from its lane, in metres and radians, where that guides the fit.
const LANE_M: f64 = 1.5;
const LANE_RAD: f64 = 0.4;
/// The road is free up to here beyond the last picture's place, in metres.
const BEYOND_M: f64 = 60.0;
/// The tightest bend and how firmly it is held, in 1/m. A car at full lock turns on 1/6.2; the tracks' bends stay below
/// 1/8, so that every one can be driven in either lane.
const TIGHTEST: f64 = 0.119;
const FIRMLY: f64 = 0.002;

/// How far the course may move from what was given, as standard deviations in metres.
#[derive(Debug, Clone, Copy)]
pub struct Trust {
    /// Of a control point on the ground plane.
    pub flat_m: f64,
    /// Of its height.
    pub height_m: f64,
    /// Whether its bends are known: then neighbours move alike, otherwise they bend alike.
    pub bends_known: bool,
    /// Of the third difference of four neighbours' moves, or of their places, on the ground plane.
    pub smooth_m: f64,
    /// The same in height.
    pub smooth_height_m: f64,
}

/// How a step is taken.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// How far from where it is expected a line is searched for, in pixels.
    pub reach_px: f64,
    /// A line found so far off counts for a quarter.
    pub robust_px: f64,
    /// Whether the road is known from the last picture's place on, rather than up to the first one's.
    pub known_ahead: bool,
}

/// Which column of the equations a control point's x has, if it is free; y and z follow.
pub type Columns = [Option<usize>];

/// A fit in progress.
#[derive(Debug)]
pub struct Fit<'a> {
    /// What is explained.
    pub drive: &'a Drive,
    /// The road's lines.
    pub lines: Vec<Line>,
    /// The course as it was given.
    pub given: Course,
    /// The course as it is found.
    pub course: Course,
    /// Where the car stands in each picture so far.
    pub stands: Vec<Stand>,
    /// Where the first one is, about.
    pub first: Stand,
    /// How far the course may move.
    pub trust: Trust,
    /// Where on the road the car usually is, if that is to guide the fit: metres to the right of the middle.
    pub lane_m: Option<f64>,
    /// How far ahead lines are searched for, in metres.
    pub far_m: f64,
}

impl Fit<'_> {
    /// One step of Gauss and Newton over the pictures `range` and the control points that they see; over the whole drive,
    /// all control points are free. Returns the sum of squares before it, or `None` if it is not determined.
    pub fn step(&mut self, range: Range<usize>, step: Step) -> Option<f64> {
        let (free, columns) = self.free(&range, step.known_ahead);
        let this = &*self;
        let heard = |i: usize| -> Vec<Witness> {
            let mut heard = this.seen(i, i - range.start, &columns, step);
            if i + 1 < range.end {
                heard.extend(this.linked(i, i - range.start, &columns));
            }
            heard.extend(this.climbed(i, &columns));
            heard
        };
        let heard: Vec<Vec<Witness>> = range.clone().into_par_iter().map(heard).collect();
        let mut equations = Equations::new(range.len(), free.len() * 3);
        let mut sum = 0.0;
        for (residual, weight, slope) in heard.iter().flatten() {
            equations.add(*residual, *weight, slope);
            sum += residual * residual * weight;
        }
        self.stands_before(&range, step.known_ahead, &mut equations);
        self.road_before(&free, &columns, &mut equations);
        self.bends(&columns, &mut equations);
        let (stands, road) = equations.solve()?;
        for (stand, step) in self.stands[range].iter_mut().zip(stands) {
            for (value, step) in stand.iter_mut().zip(step) {
                *value += step;
            }
        }
        for (&k, step) in free.iter().zip(road.as_chunks::<3>().0) {
            self.course.points[k] += DVec3::from_array(*step).clamp_length_max(FARTHEST_M);
        }
        Some(sum)
    }

    /// Which control points are free, and their columns.
    fn free(&self, range: &Range<usize>, known_ahead: bool) -> (Vec<usize>, Vec<Option<usize>>) {
        let n = self.course.points.len() as i64;
        let place = |i: usize| self.stands[i][0].floor() as i64;
        let (from, to) = (place(range.start), place(range.end - 1));
        let low = if range.start == 0 || known_ahead { from - 1 } else { from + 1 };
        let high = if known_ahead { to + 1 } else { to + (BEYOND_M / self.course.knot_m()) as i64 };
        let all = if range.start == 0 && range.len() == self.drive.frames.len() {
            low..low + n
        } else {
            low..(high + 1).min(place(0) + n - 1) // on the second lap, the road is known from the first
        };
        let free: Vec<usize> = all.map(|k| k.rem_euclid(n) as usize).collect();
        let mut columns = vec![None; n as usize];
        for (i, &k) in free.iter().enumerate() {
            columns[k] = Some(i * 3);
        }
        (free, columns)
    }

    /// What is known of the stands beforehand.
    fn stands_before(&self, range: &Range<usize>, known_ahead: bool, equations: &mut Equations) {
        let known = if known_ahead { range.len() - 1 } else { 0 };
        for (i, stand) in self.stands[range.clone()].iter().enumerate() {
            let mut expect = |a: usize, residual: f64, deviation: f64| {
                let mut one = [0.0; STAND];
                one[a] = 1.0;
                let slope = Slope { stand: Some((i, one)), ..Slope::default() };
                equations.add(residual, deviation.powi(-2), &slope);
            };
            // A narrower road seen from a nose that is lower looks the same: on average it is not lower.
            expect(3, stand[3], PITCH_RAD);
            expect(4, stand[4], ROLL_RAD);
            if let Some(lane_m) = self.lane_m {
                expect(1, stand[1] - lane_m, LANE_M);
                expect(2, stand[2], LANE_RAD);
            }
            for (a, leap) in LEAPS.into_iter().enumerate() {
                expect(a, 0.0, leap);
            }
            for a in (0..STAND).filter(|_| i == known) {
                if range.start == 0 {
                    expect(a, stand[a] - self.first[a], FIRST[a]);
                } else {
                    expect(a, 0.0, KNOWN);
                }
            }
        }
    }

    /// What is known of the road beforehand.
    fn road_before(&self, free: &[usize], columns: &Columns, equations: &mut Equations) {
        let n = self.course.points.len();
        let trust = self.trust;
        for &k in free {
            let off = self.course.points[k] - self.given.points[k];
            for (axis, deviation) in [(0, trust.flat_m), (1, trust.height_m), (2, trust.flat_m)] {
                let slope = Slope { road: vec![(columns[k].unwrap_or(0) + axis, 1.0)], ..Slope::default() };
                equations.add(off[axis], deviation.powi(-2), &slope);
                equations.add(0.0, LEAP_M.powi(-2), &slope);
            }
            let four = [0, 1, 2, 3].map(|j| (k + j) % n);
            let weights = [-1.0, 3.0, -3.0, 1.0];
            for (axis, deviation) in [(0, trust.smooth_m), (1, trust.smooth_height_m), (2, trust.smooth_m)] {
                let given = |j: usize| if trust.bends_known { self.given.points[j][axis] } else { 0.0 };
                let moved = |j: usize| self.course.points[j][axis] - given(j);
                let residual: f64 = four.iter().zip(weights).map(|(&j, w)| w * moved(j)).sum();
                let road = four.iter().zip(weights).filter_map(|(&j, w)| Some((columns[j]? + axis, w))).collect();
                equations.add(residual, deviation.powi(-2), &Slope { road, ..Slope::default() });
            }
        }
    }

    /// No bend is tighter than a car can turn.
    fn bends(&self, columns: &Columns, equations: &mut Equations) {
        let n = self.course.points.len();
        let mut course = self.course.clone();
        for i in 0..4 * n {
            let t = i as f64 / 4.0;
            let bend = course.at(t).curvature;
            if bend.abs() < TIGHTEST {
                continue;
            }
            let mut slope = Slope::default();
            for j in 0..4 {
                let point = (course.first_of(t) + j) % n;
                let Some(first) = columns[point] else { continue };
                for axis in [0, 2] {
                    let was = course.points[point];
                    course.points[point][axis] += NUDGE_M;
                    slope.road.push((first + axis, (course.at(t).curvature - bend) / NUDGE_M));
                    course.points[point] = was;
                }
            }
            equations.add(bend - TIGHTEST.copysign(bend), FIRMLY.powi(-2), &slope);
        }
    }
}
