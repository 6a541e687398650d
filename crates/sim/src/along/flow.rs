//! Optical flow: where patches of one picture are in the next. Pyramidal Lucas-Kanade, checked forwards and backwards.

use super::warp::SIZE;
use lapwing_core::perception::Frame;

const LEVELS: usize = 3;
/// Half the side of a patch, in pixels of its level.
const REACH: usize = 7;
/// The side.
const SIDE: usize = 2 * REACH + 1;
/// Pixels in a row of a patch, the last of which counts for nothing: whole vectors of the processor.
const LANES: usize = SIDE + 1;
/// Rows of the picture that are used: sky, scenery, and the part of the road just below the horizon.
const ROWS: usize = 104;
/// The distant scenery's rows, whose common shift is the first guess.
const BAND: std::ops::Range<usize> = 20..60;
/// Largest shift of the band from frame to frame, in pixels.
const FARTHEST: i32 = 44;
/// A patch tracked there and back must return this closely, in pixels.
const RETURNS: f32 = 0.5;

/// The upper rows of a picture in grey, at its full size and at halves of it.
#[derive(Debug)]
pub struct Pyramid(Vec<Grey>);

/// The luminance of a pixel, 0 to 255 (Rec. 709).
pub(super) fn luminance(rgb: &[u8; 3]) -> f32 {
    0.2126 * f32::from(rgb[0]) + 0.7152 * f32::from(rgb[1]) + 0.0722 * f32::from(rgb[2])
}

#[derive(Debug)]
struct Grey {
    width: usize,
    height: usize,
    light: Vec<f32>,
}

impl Grey {
    /// The patch around the middle of `out`'s rows, at most 30 a side, in rows of which the last pixels may be more than are
    /// wanted; beyond the picture its rim is repeated. All its pixels lie at the same fraction between those of the picture, so
    /// four weights serve for all.
    fn square<const W: usize, const H: usize>(&self, x: f32, y: f32, out: &mut [[f32; W]; H]) {
        let (left, top) = (x.floor() as i32 - (H / 2) as i32, y.floor() as i32 - (H / 2) as i32);
        let (s, t) = (x - x.floor(), y - y.floor());
        let weights = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
        let within =
            |from: i32, i: usize, size: usize| from.saturating_add(i as i32).clamp(0, size as i32 - 1) as usize;
        let line = |j: usize| &self.light[within(top, j, self.height) * self.width..][..self.width];
        let first = within(left, 0, self.width);
        let inside = left >= 0 && first + W < self.width;
        let columns: [usize; 31] = if inside { [0; 31] } else { std::array::from_fn(|i| within(left, i, self.width)) };
        for (j, row) in out.iter_mut().enumerate() {
            let (above, below) = (line(j), line(j + 1));
            if inside {
                let (above, below) = (&above[first..][..W + 1], &below[first..][..W + 1]);
                for (i, pixel) in row.iter_mut().enumerate() {
                    let (up, down) = (
                        weights[0] * above[i] + weights[1] * above[i + 1],
                        weights[2] * below[i] + weights[3] * below[i + 1],
                    );
                    *pixel = up + down;
                }
            } else {
                for (pixel, at) in row.iter_mut().zip(columns.windows(2)) {
                    let (up, down) = (
                        weights[0] * above[at[0]] + weights[1] * above[at[1]],
                        weights[2] * below[at[0]] + weights[3] * below[at[1]],
                    );
                    *pixel = up + down;
                }
            }
        }
    }

    fn half(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let rows = self.light.chunks_exact(2 * self.width);
        let light = rows.flat_map(|rows| {
            let (above, below) = rows.split_at(self.width);
            let pairs = above.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0);
            pairs.map(|(above, below)| (above[0] + above[1] + below[0] + below[1]) / 4.0)
        });
        Self { width, height, light: light.collect() }
    }
}

impl Pyramid {
    /// The pyramid of a camera picture; `None` if it is not 320x160.
    pub fn of(picture: &Frame) -> Option<Self> {
        if (picture.width(), picture.height()) != SIZE {
            return None;
        }
        let light = picture.rgb().as_chunks().0.iter().take(SIZE.0 * ROWS).map(luminance).collect();
        let mut levels = vec![Grey { width: SIZE.0, height: ROWS, light }];
        for level in 1..LEVELS {
            levels.push(levels[level - 1].half());
        }
        Some(Self(levels))
    }

    /// How many pixels to the right the distant scenery moves from here to `next`, in whole pixels.
    pub fn shift(&self, next: &Self) -> i32 {
        let (a, b) = (&self.0[0], &next.0[0]);
        let difference = |shift: i32| {
            let columns = (-shift).max(40)..(320 - shift).min(280);
            let mut sum = 0.0;
            for y in BAND.step_by(3) {
                for x in columns.clone() {
                    let (i, j) = (y * a.width + x as usize, y * a.width + (x + shift) as usize);
                    sum += (a.light[i] - b.light[j]).abs();
                }
            }
            sum / columns.len() as f32
        };
        let all = (-FARTHEST..=FARTHEST).map(|shift| (shift, difference(shift)));
        all.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(shift, _)| shift)
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
        let mut wide = [[0.0; SIDE + 2]; SIDE + 2];
        a.square(x, y, &mut wide);
        // Whatever the last pixel of a row is, it is no error where nothing changes across and down.
        let (mut light, mut across, mut down) = ([[0.0; LANES]; SIDE], [[0.0; LANES]; SIDE], [[0.0; LANES]; SIDE]);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for j in 0..SIDE {
            for i in 0..SIDE {
                let dx = (wide[j + 1][i + 2] - wide[j + 1][i]) / 2.0;
                let dy = (wide[j + 2][i + 1] - wide[j][i + 1]) / 2.0;
                (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
                (light[j][i], across[j][i], down[j][i]) = (wide[j + 1][i + 1], dx, dy);
            }
        }
        let determinant = xx * yy - xy * xy;
        let weakest = (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt()) / 2.0 / (SIDE * SIDE) as f32;
        if weakest < 2.0 {
            if level == 0 {
                return None;
            }
            continue;
        }
        let (mut u, mut v) = (flow[0] / scale, flow[1] / scale);
        let mut there = [[0.0; LANES]; SIDE];
        for _ in 0..12 {
            b.square(x + u, y + v, &mut there);
            let (mut ex, mut ey) = ([0.0; LANES], [0.0; LANES]);
            for j in 0..SIDE {
                for i in 0..LANES {
                    let error = light[j][i] - there[j][i];
                    ex[i] += error * across[j][i];
                    ey[i] += error * down[j][i];
                }
            }
            let (ex, ey) = (ex.iter().sum::<f32>(), ey.iter().sum::<f32>());
            let (du, dv) = ((yy * ex - xy * ey) / determinant, (xx * ey - xy * ex) / determinant);
            (u, v) = (u + du, v + dv);
            if !(u.is_finite() && v.is_finite()) {
                return None;
            }
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
