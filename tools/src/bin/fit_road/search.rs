//! Where a car probably was, before a fit knows: by its motion, and by a search around that.

use glam::DVec3;
use lapwing_core::motion::{Motion, turn};
use lapwing_tools::course::Stand;
use rayon::prelude::*;

use crate::{
    fit::Fit,
    lines::{find, pieces},
    witness::slip,
};

/// A picture explained worse than this has been lost.
const LOST: f64 = 0.12;
/// One explained worse than this may be.
const DOUBTFUL: f64 = 0.25;
/// How far ahead a search looks, in metres: what is farther away says little about where the car is.
const NEAR_M: f64 = 14.0;
/// The share of a body's pitch and roll that is left in the next picture.
const SETTLING: f64 = 0.7;

impl Fit<'_> {
    /// Where the car is after a motion.
    fn moved(&self, from: &Stand, motion: Motion) -> Stand {
        let spot = self.course.at(from[0]);
        let yaw = spot.yaw() + from[2];
        let flat = motion.way_m / (1.0 + spot.grade * spot.grade).sqrt();
        let at = self.course.point(from[0], from[1]);
        let (sin, cos) = (yaw + motion.turn_rad / 2.0 + slip(motion)).sin_cos();
        let to = at + DVec3::new(sin, 0.0, cos) * flat;
        let mut t = from[0];
        for _ in 0..6 {
            let spot = self.course.at(t);
            let off = to - spot.position;
            let along = off.x * spot.ahead.x + off.z * spot.ahead.y;
            let bend = (1.0 - spot.curvature * off.dot(spot.right())).max(0.3);
            t += (along / spot.pace_m / bend).clamp(-0.5, 0.5);
        }
        let spot = self.course.at(t);
        let offset = (to - spot.position).dot(spot.right());
        let heading = turn(yaw + motion.turn_rad - spot.yaw());
        [t, offset, heading, SETTLING * from[3], SETTLING * from[4]]
    }

    /// Adds stands for the next pictures.
    pub fn extend(&mut self, until: usize) {
        while self.stands.len() < until.min(self.drive.frames.len()) {
            let next = match self.stands.last() {
                None => self.first,
                Some(last) => self.moved(last, self.drive.motions[self.stands.len()]),
            };
            self.stands.push(self.searched(self.stands.len(), next));
        }
    }

    /// Replaces a stand by one that leads to the next.
    pub fn precede(&mut self, i: usize) {
        let motion = self.drive.motions[i + 1];
        let back = Motion { way_m: -motion.way_m, turn_rad: -motion.turn_rad };
        let before = self.moved(&self.stands[i + 1], back);
        self.stands[i] = self.searched(i, before);
    }

    /// How well a picture is explained from a stand: the share of its pieces that are found about where they are
    /// expected.
    fn score(&self, i: usize, stand: &Stand) -> f64 {
        let pieces = pieces(&self.course, stand, &self.lines, NEAR_M);
        let found: f64 = pieces
            .iter()
            .filter_map(|piece| find(&self.drive.frames[i], piece, 5.0))
            .map(|(d, clear)| clear.min(0.6) * (-0.5 * (d / 2.5).powi(2)).exp())
            .sum();
        found / (pieces.len() as f64).max(15.0)
    }

    /// The best stand around one.
    fn searched(&self, i: usize, from: Stand) -> Stand {
        let search = |from: Stand, steps: [f64; 2], reach: [i32; 2]| {
            let grid: Vec<(i32, i32)> =
                (-reach[0]..=reach[0]).flat_map(|a| (-reach[1]..=reach[1]).map(move |b| (a, b))).collect();
            let worth = |&(aside, askew): &(i32, i32)| {
                let (aside, askew) = (steps[0] * f64::from(aside), steps[1] * f64::from(askew));
                let mut stand = from;
                stand[1] += aside;
                stand[2] += askew;
                let mut far = (aside / 0.5).powi(2) + (askew / 0.06).powi(2);
                if let Some(lane_m) = self.lane_m {
                    far += ((stand[1] - lane_m) / 1.0).powi(2) + (stand[2] / 0.3).powi(2);
                }
                (self.score(i, &stand) - 0.01 * far.min(20.0), stand)
            };
            let tried: Vec<(f64, Stand)> = grid.par_iter().map(worth).collect();
            tried.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, from))
        };
        let (worth, found) = search(from, [0.2, 0.03], [6, 5]);
        if worth > LOST {
            return found;
        }
        let mut home = from;
        if let Some(lane_m) = self.lane_m {
            home[1] = home[1].clamp(lane_m - 2.0, lane_m + 2.0);
            home[2] = home[2].clamp(-0.4, 0.4);
        }
        let (again, wide) = search(home, [0.3, 0.04], [10, 12]);
        if again > worth { wide } else { found }
    }

    /// Looks for a better stand of each picture that is explained badly; returns how many it moved.
    pub fn search_again(&mut self) -> usize {
        let mut moved = 0;
        for i in 0..self.stands.len() {
            let (stand, score) = (self.stands[i], self.score(i, &self.stands[i]));
            if score < DOUBTFUL {
                let other = self.searched(i, stand);
                if self.score(i, &other) > score + 0.05 {
                    self.stands[i] = other;
                    moved += 1;
                }
            }
        }
        moved
    }

    /// Lays the road between two pictures as it was given, between what was found before and after.
    pub fn forget(&mut self, from: usize, to: usize) {
        let n = self.course.points.len();
        let (low, high) = (self.stands[from][0].floor() as usize + 1, self.stands[to][0].floor() as usize);
        let off = |k: usize| self.course.points[k % n] - self.given.points[k % n];
        let (before, after) = (off(low), off(high));
        for k in low..high {
            let share = (k - low) as f64 / (high - low) as f64;
            self.course.points[k % n] = self.given.points[k % n] + before.lerp(after, share);
        }
    }
}
