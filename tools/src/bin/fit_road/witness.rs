//! What a fit hears: from each picture where the lines are, and from the log how the car moved.

use std::fmt;

use glam::DVec2;
use lapwing_core::{
    car::REAR_AXLE_M,
    motion::{Motion, turn},
};

use lapwing_tools::course::{Course, Eye, STAND, Stand};

use crate::{
    fit::{Columns, Fit, NUDGE_M, Step},
    lines::{Piece, find, pieces},
    solve::Slope,
};

/// Steps over which derivatives by a stand's numbers are taken.
const NUDGE: Stand = [0.002, 0.02, 0.002, 0.002, 0.002];
/// What a piece of a line in one picture is worth: those of one picture err alike.
const WORTH: f64 = 0.3;

/// Standard deviation of a slope by the speed, as its sine: 0.05, but neighbouring rows err alike.
const CLIMB: f64 = 0.15;

/// Within so many pixels a line is found, where a fit is reported or shown.
pub const SHOWN_PX: f64 = 6.0;

/// A residual, its weight (one over its variance) and its derivatives.
pub type Witness = (f64, f64, Slope);

/// How many radians to the right of where the car heads its origin moves, which is in front of the rear axle.
pub fn slip(motion: Motion) -> f64 {
    let way_m = motion.way_m.abs().max(0.05).copysign(motion.way_m);
    REAR_AXLE_M * motion.turn_rad / way_m
}

/// How well a picture is explained.
#[derive(Debug, Clone, Copy)]
pub struct Explained {
    /// Pieces of lines expected.
    pub expected: usize,
    /// Pieces found within [`SHOWN_PX`].
    pub found: usize,
    /// Root mean square of how far off they are, in pixels.
    pub off_px: f64,
}

impl fmt::Display for Explained {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} pieces found, {:.1} px off", self.found, self.expected, self.off_px)
    }
}

impl Fit<'_> {
    /// What a picture says.
    pub fn seen(&self, i: usize, number: usize, columns: &Columns, step: Step) -> Vec<Witness> {
        let stand = self.stands[i];
        let pieces = pieces(&self.course, &stand, &self.lines, self.far_m);
        let found: Vec<(Piece, f64, f64)> = pieces
            .into_iter()
            .filter_map(|piece| find(&self.drive.frames[i], &piece, step.reach_px).map(|(d, clear)| (piece, d, clear)))
            .collect();
        let places = |course: &Course, stand: &Stand| -> Vec<DVec2> {
            let eye = Eye::new(course, stand);
            found.iter().map(|(p, ..)| eye.see(course.point(p.t, p.line.offset_m)).unwrap_or(p.at)).collect()
        };
        let across = |at: &[DVec2], k: usize| (at[k] - found[k].0.at).dot(found[k].0.across);
        let mut slopes: Vec<Slope> =
            found.iter().map(|_| Slope { stand: Some((number, [0.0; STAND])), ..Slope::default() }).collect();
        for a in 0..STAND {
            let mut other = stand;
            other[a] += NUDGE[a];
            let at = places(&self.course, &other);
            for (k, slope) in slopes.iter_mut().enumerate() {
                if let Some((_, row)) = &mut slope.stand {
                    row[a] = across(&at, k) / NUDGE[a];
                }
            }
        }
        let n = self.course.points.len();
        let last = found.iter().map(|(p, ..)| p.t).fold(stand[0], f64::max);
        let mut course = self.course.clone();
        for j in 0..=(last.floor() - stand[0].floor()) as usize + 3 {
            let point = (self.course.first_of(stand[0]) + j) % n;
            let Some(first) = columns[point] else { continue };
            for axis in 0..3 {
                let was = course.points[point];
                course.points[point][axis] += NUDGE_M;
                let at = places(&course, &stand);
                course.points[point] = was;
                for (k, slope) in slopes.iter_mut().enumerate() {
                    let by = across(&at, k) / NUDGE_M;
                    if by != 0.0 {
                        slope.road.push((first + axis, by));
                    }
                }
            }
        }
        // A car that stands still sees the same over and over.
        let news = (self.drive.motions[i].way_m / 0.4).clamp(0.02, 1.0);
        found
            .iter()
            .zip(slopes)
            .map(|((piece, d, clear), slope)| {
                let doubt = 1.0 + (d / step.robust_px).powi(2);
                // Beyond the piece's own noise, what is far is less surely where a spline leads.
                let deviation = 0.7 + 0.02 * piece.away_m;
                (-d, news * WORTH * clear / (deviation * doubt).powi(2), slope)
            })
            .collect()
    }

    /// What the motion to the next picture says.
    pub fn linked(&self, i: usize, number: usize, columns: &Columns) -> [Witness; 3] {
        let motion = self.drive.motions[i + 1];
        let slip = slip(motion);
        let off = |course: &Course, here: &Stand, next: &Stand| -> [f64; 3] {
            let (a, b) = (course.at(here[0]), course.at(next[0]));
            let (yaw, turned) = (a.yaw() + here[2], turn(b.yaw() + next[2] - a.yaw() - here[2]));
            let way = course.point(next[0], next[1]) - course.point(here[0], here[1]);
            let (sin, cos) = (yaw + turned / 2.0 + slip).sin_cos();
            let (along, aside) = (way.x * sin + way.z * cos, way.x * cos - way.z * sin);
            [along.hypot(way.y) - motion.way_m, aside, turned - motion.turn_rad]
        };
        // Keyboards steer in leaps, and when in the interval is not told.
        let near = &self.drive.motions[i..(i + 3).min(self.drive.motions.len())];
        let steered = near.iter().map(|motion| motion.turn_rad.abs()).fold(0.0, f64::max);
        let deviations = [
            0.01 + 0.02 * motion.way_m,
            0.004 + 0.03 * motion.way_m + 0.5 * motion.turn_rad.abs(),
            0.003 + 0.005 * motion.way_m + 0.1 * steered,
        ];
        let (here, next) = (self.stands[i], self.stands[i + 1]);
        let base = off(&self.course, &here, &next);
        let mut slopes =
            [(); 3].map(|()| Slope { stand: Some((number, [0.0; STAND])), next: Some([0.0; STAND]), road: Vec::new() });
        for a in 0..3 {
            let (mut moved, mut moved_next) = (here, next);
            moved[a] += NUDGE[a];
            moved_next[a] += NUDGE[a];
            let (by, by_next) = (off(&self.course, &moved, &next), off(&self.course, &here, &moved_next));
            for (c, slope) in slopes.iter_mut().enumerate() {
                if let (Some((_, row)), Some(row_next)) = (&mut slope.stand, &mut slope.next) {
                    row[a] = (by[c] - base[c]) / NUDGE[a];
                    row_next[a] = (by_next[c] - base[c]) / NUDGE[a];
                }
            }
        }
        let n = self.course.points.len();
        let mut course = self.course.clone();
        for j in 0..=(next[0].floor() - here[0].floor()).max(0.0) as usize + 3 {
            let point = (self.course.first_of(here[0]) + j) % n;
            let Some(first) = columns[point] else { continue };
            for axis in 0..3 {
                let was = course.points[point];
                course.points[point][axis] += NUDGE_M;
                let by = off(&course, &here, &next);
                course.points[point] = was;
                for (c, slope) in slopes.iter_mut().enumerate() {
                    slope.road.push((first + axis, (by[c] - base[c]) / NUDGE_M));
                }
            }
        }
        let mut c = 0;
        slopes.map(|slope| {
            c += 1;
            (base[c - 1], deviations[c - 1].powi(-2), slope)
        })
    }

    /// What the log says of the road's slope at a picture: how much slower the car became than on level ground.
    pub fn climbed(&self, i: usize, columns: &Columns) -> Option<Witness> {
        let expected = self.drive.climbs[i]?;
        let (here, by) = self.course.climb_by(self.stands[i][0]);
        let height = |(point, by): (usize, f64)| Some((columns[point]? + 1, by));
        let slope = Slope { road: by.into_iter().filter_map(height).collect(), ..Slope::default() };
        Some((here - expected, CLIMB.powi(-2), slope))
    }

    /// How far from where they are expected lines are found, in metres outwards from the road's middle, and how far away
    /// they are.
    pub fn outwards(&self, i: usize) -> Vec<(f64, f64)> {
        let pieces = pieces(&self.course, &self.stands[i], &self.lines, self.far_m);
        let beside = pieces.iter().filter(|piece| piece.line.offset_m != 0.0);
        let found = beside.filter_map(|piece| {
            let (d, _) = find(&self.drive.frames[i], piece, SHOWN_PX)?;
            let line = &piece.line;
            Some((d * line.offset_m.signum() * line.width_m / piece.width_px, piece.away_m))
        });
        found.collect()
    }

    /// How well a picture is explained.
    pub fn explained(&self, i: usize) -> Explained {
        let pieces = pieces(&self.course, &self.stands[i], &self.lines, self.far_m);
        let found: Vec<f64> =
            pieces.iter().filter_map(|piece| find(&self.drive.frames[i], piece, SHOWN_PX).map(|(d, _)| d)).collect();
        let sum: f64 = found.iter().map(|d| d * d).sum();
        Explained { expected: pieces.len(), found: found.len(), off_px: (sum / found.len().max(1) as f64).sqrt() }
    }
}
