//! Where patches of one picture are in the next: pyramidal Lucas-Kanade, checked there and back.

use std::path::Path;

use anyhow::{Context, Result, ensure};

const LEVELS: usize = 3;
/// Half the side of a patch, in pixels of its level.
const REACH: i32 = 7;
/// Rows of the picture that are used: sky, scenery, and what of the road lies just below the horizon.
const ROWS: usize = 104;
/// The distant scenery's rows, whose common shift is the first guess.
const BAND: std::ops::Range<usize> = 20..60;
/// Largest shift of the band from frame to frame, in pixels.
const FARTHEST: i32 = 44;
/// A patch tracked there and back must return this closely, in pixels.
const RETURNS: f32 = 0.5;

/// A grey picture, at its full size and at halves of it.
pub struct Pyramid(Vec<Grey>);

struct Grey {
    width: usize,
    height: usize,
    light: Vec<f32>,
}

impl Grey {
    fn at(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x.clamp(0.0, self.width as f32 - 1.001), y.clamp(0.0, self.height as f32 - 1.001));
        let (i, j) = (x as usize, y as usize);
        let (s, t) = (x - i as f32, y - j as f32);
        let k = j * self.width + i;
        let (above, below) = (&self.light[k..k + 2], &self.light[k + self.width..k + self.width + 2]);
        (above[0] * (1.0 - s) + above[1] * s) * (1.0 - t) + (below[0] * (1.0 - s) + below[1] * s) * t
    }

    fn half(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let pixel = |i: usize| {
            let k = (i / width) * 2 * self.width + (i % width) * 2;
            (self.light[k] + self.light[k + 1] + self.light[k + self.width] + self.light[k + self.width + 1]) / 4.0
        };
        Self { width, height, light: (0..width * height).map(pixel).collect() }
    }
}

impl Pyramid {
    /// Opens a camera picture.
    pub fn open(path: &Path) -> Result<Self> {
        let picture = image::open(path).with_context(|| format!("cannot open {}", path.display()))?.to_luma8();
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        ensure!((width, height) == (320, 160), "{}: expected 320x160, got {width}x{height}", path.display());
        let light = picture.as_raw()[..width * ROWS].iter().map(|&v| f32::from(v)).collect();
        let mut levels = vec![Grey { width, height: ROWS, light }];
        for level in 1..LEVELS {
            levels.push(levels[level - 1].half());
        }
        Ok(Self(levels))
    }

    /// How many pixels to the right the distant scenery moves from here to `next`, in whole pixels.
    pub fn shift(&self, next: &Self) -> i32 {
        let (a, b) = (&self.0[0], &next.0[0]);
        let difference = |shift: i32| {
            let columns = (-shift).max(40)..(320 - shift).min(280);
            let mut sum = 0.0;
            for y in BAND {
                for x in columns.clone() {
                    let (i, j) = (y * a.width + x as usize, y * a.width + (x + shift) as usize);
                    sum += (a.light[i] - b.light[j]).abs();
                }
            }
            sum / columns.len() as f32
        };
        (-FARTHEST..=FARTHEST).min_by(|&a, &b| difference(a).total_cmp(&difference(b))).unwrap_or(0)
    }

    /// Patches here and where they are in `next`, in pixels; `shift` is the first guess.
    pub fn track(&self, next: &Self, shift: i32) -> Vec<([f32; 2], [f32; 2])> {
        let mut found = Vec::new();
        for y in (10..74).step_by(8) {
            for x in (12..310).step_by(12) {
                let from = [x as f32, y as f32];
                let Some(to) = follow(self, next, from, [from[0] + shift as f32, from[1]]) else { continue };
                let Some(back) = follow(next, self, to, from) else { continue };
                if (back[0] - from[0]).hypot(back[1] - from[1]) < RETURNS {
                    found.push((from, to));
                }
            }
        }
        found
    }
}

/// One patch, from the coarsest level to the finest.
fn follow(here: &Pyramid, next: &Pyramid, from: [f32; 2], guess: [f32; 2]) -> Option<[f32; 2]> {
    let mut flow = [guess[0] - from[0], guess[1] - from[1]];
    for level in (0..LEVELS).rev() {
        let scale = (1 << level) as f32;
        let (a, b) = (&here.0[level], &next.0[level]);
        let (x, y) = ((from[0] + 0.5) / scale - 0.5, (from[1] + 0.5) / scale - 0.5);
        let mut patch = [(0.0, 0.0, 0.0); (2 * REACH as usize + 1).pow(2)];
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (i, pixel) in patch.iter_mut().enumerate() {
            let (u, v) = (x + (i as i32 % 15 - REACH) as f32, y + (i as i32 / 15 - REACH) as f32);
            let dx = (a.at(u + 1.0, v) - a.at(u - 1.0, v)) / 2.0;
            let dy = (a.at(u, v + 1.0) - a.at(u, v - 1.0)) / 2.0;
            (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
            *pixel = (a.at(u, v), dx, dy);
        }
        let determinant = xx * yy - xy * xy;
        let weakest = (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt()) / 2.0 / patch.len() as f32;
        if weakest < 2.0 {
            if level == 0 {
                return None;
            }
            continue;
        }
        let (mut u, mut v) = (flow[0] / scale, flow[1] / scale);
        for _ in 0..12 {
            let (mut ex, mut ey) = (0.0, 0.0);
            for (i, (light, dx, dy)) in patch.iter().enumerate() {
                let (px, py) = (x + u + (i as i32 % 15 - REACH) as f32, y + v + (i as i32 / 15 - REACH) as f32);
                let error = light - b.at(px, py);
                (ex, ey) = (ex + error * dx, ey + error * dy);
            }
            let (du, dv) = ((yy * ex - xy * ey) / determinant, (xx * ey - xy * ex) / determinant);
            (u, v) = (u + du, v + dv);
            if du.abs() + dv.abs() < 0.01 {
                break;
            }
        }
        flow = [u * scale, v * scale];
    }
    let to = [from[0] + flow[0], from[1] + flow[1]];
    let inside = (2.0..317.0).contains(&to[0]) && (2.0..ROWS as f32 - 3.0).contains(&to[1]);
    inside.then_some(to)
}
