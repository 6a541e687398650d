//! Where one picture was taken beside another of the same place: the two alone tell, whatever is drawn and whatever is known of
//! the road.
//!
//! The ground that the second picture shows is looked up in the first one, as if the second had been taken there; where the two
//! are most alike, it was. How far ahead that is, straight stretches do not tell.

use std::ops::Range;

use glam::Vec3;

use super::{super::flow::luminance, Beside, SIZE, Warp};
use lapwing_core::perception::Frame;

/// The ground that is compared: these rows, no farther ahead than this, in metres, as roads are flat no farther.
const ROWS: Range<usize> = 72..132;
const FAR_M: f32 = 25.0;
/// The share of it that both pictures must show.
const SHOWN: f64 = 0.4;
/// How far to search, and in which steps: metres aside, radians, metres ahead.
const REACH: [f64; 3] = [3.0, 0.2, 6.0];
const STEPS: [f64; 3] = [0.25, 0.025, 1.0];
/// Around a pixel is what lies within so many times the blur, and so many pixels more.
const AROUND: (usize, usize) = (3, 4);
/// Pictures are blurred by so many pixels, and every so many of them are compared, at first and at last.
const COARSE: (usize, usize) = (4, 6);
const FINE: (usize, usize) = (1, 3);
/// Turns are about the ground so many metres ahead, which leaves the near part of the road where it is.
const PIVOT_M: f64 = 5.0;
/// How often the steps are halved.
const HALVINGS: u32 = 6;

/// Where a picture was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Again {
    /// Beside the other one.
    pub beside: Beside,
    /// How alike the two are then, -1 to 1: the correlation of their luminance above that of the pixels around.
    pub alike: f64,
}

/// The luminance of each pixel, above that of the pixels around: lines and verges count, not how bright the ground is.
struct Relief(Vec<f32>);

impl Relief {
    fn of(picture: &Frame, reach: usize) -> Self {
        let levels: Vec<f32> = picture.rgb().as_chunks().0.iter().map(luminance).collect();
        let near = |i: usize, k: isize, size: usize| i.checked_add_signed(k).filter(|i| *i < size);
        let blurred = |reach: usize| {
            let across = mean(&levels, reach, |x, y, k| Some(y * SIZE.0 + near(x, k, SIZE.0)?));
            mean(&across, reach, |x, y, k| Some(near(y, k, SIZE.1)? * SIZE.0 + x))
        };
        Self(
            blurred(reach)
                .into_iter()
                .zip(blurred(AROUND.0 * reach + AROUND.1))
                .map(|(level, around)| level - around)
                .collect(),
        )
    }

    /// Between its four pixels.
    fn at(&self, [column, row]: [f32; 2]) -> f32 {
        let (x, y) = ((column - 0.5).clamp(0.0, SIZE.0 as f32 - 1.001), (row - 0.5).clamp(0.0, SIZE.1 as f32 - 1.001));
        let (i, s, t) = (y as usize * SIZE.0 + x as usize, x.fract(), y.fract());
        let mix = |i: usize| self.0[i] * (1.0 - s) + self.0[i + 1] * s;
        mix(i) * (1.0 - t) + mix(i + SIZE.0) * t
    }
}

/// Means over the neighbours up to `reach` pixels away, whose numbers `at` tells.
fn mean(levels: &[f32], reach: usize, at: impl Fn(usize, usize, isize) -> Option<usize>) -> Vec<f32> {
    let reach = reach as isize;
    let pixel = |i: usize| {
        let (x, y) = (i % SIZE.0, i / SIZE.0);
        let near = (-reach..=reach).filter_map(|k| at(x, y, k));
        let (sum, count) = near.fold((0.0, 0.0), |(sum, count), i| (sum + levels[i], count + 1.0));
        sum / f32::max(count, 1.0)
    };
    (0..levels.len()).map(pixel).collect()
}

impl Warp {
    /// Where the second picture was taken beside the first; `None` if either is not 320x160, or they have too little ground in
    /// common.
    pub fn again(&self, first: &Frame, second: &Frame) -> Option<Again> {
        if [first, second].iter().any(|picture| (picture.width(), picture.height()) != SIZE) {
            return None;
        }
        let sharp = |(reach, step): (usize, usize)| Pair {
            warp: self,
            first: Relief::of(first, reach),
            second: Relief::of(second, reach),
            ground: self.ground(step),
        };
        let (coarse, fine) = (sharp(COARSE), sharp(FINE));
        let steps = |axis: usize| {
            let most = (REACH[axis] / STEPS[axis]).round() as i32;
            (-most..=most).map(move |i| f64::from(i) * STEPS[axis])
        };
        let all = steps(0).flat_map(|offset_m| {
            steps(1).flat_map(move |heading_rad| steps(2).map(move |ahead_m| Beside { offset_m, ahead_m, heading_rad }))
        });
        let found = all.filter_map(|beside| Some(Again { beside, alike: coarse.alike(beside)? }));
        let best = found.max_by(|a, b| a.alike.total_cmp(&b.alike))?;
        fine.refined(best.beside)
    }

    /// Every so many pixels of the ground, and where it is.
    fn ground(&self, step: usize) -> Vec<(usize, Vec3)> {
        let pixels =
            ROWS.step_by(step.div_ceil(2)).flat_map(|y| (0..SIZE.0).step_by(step).map(move |x| y * SIZE.0 + x));
        let place = |i: usize| Some((i, self.points[i].filter(|to| to.z <= FAR_M)?));
        pixels.filter_map(place).collect()
    }
}

/// Two pictures of a place.
struct Pair<'a> {
    warp: &'a Warp,
    first: Relief,
    second: Relief,
    ground: Vec<(usize, Vec3)>,
}

impl Pair<'_> {
    /// How alike they are if the second was taken there.
    fn alike(&self, beside: Beside) -> Option<f64> {
        let view = self.warp.view(&self.warp.cameras[0], beside);
        let (mut n, mut sums, mut squares, mut product) = (0.0, [0.0; 2], [0.0; 2], 0.0);
        for (i, to) in &self.ground {
            let at = view.find(*to);
            if view.shows(at) {
                let pair = [f64::from(self.first.at(at)), f64::from(self.second.0[*i])];
                n += 1.0;
                for (k, level) in pair.into_iter().enumerate() {
                    sums[k] += level;
                    squares[k] += level * level;
                }
                product += pair[0] * pair[1];
            }
        }
        let variances = [0, 1].map(|k| squares[k] - sums[k] * sums[k] / n);
        let scale = (variances[0] * variances[1]).sqrt();
        // Also where n is 0.
        let tells = n >= SHOWN * self.ground.len() as f64 && scale > 1.0;
        tells.then(|| (product - sums[0] * sums[1] / n) / scale)
    }

    /// A better place, step by step: aside, turned, ahead.
    fn refined(&self, from: Beside) -> Option<Again> {
        let mut best = Again { beside: from, alike: self.alike(from)? };
        let mut size = 0.5;
        for _ in 0..HALVINGS {
            let mut better = true;
            while better {
                better = false;
                for [aside_m, turned_rad, ahead_m] in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
                    for step in [-size, size] {
                        let turned_rad = turned_rad * step * STEPS[1];
                        let Beside { offset_m, ahead_m: ahead, heading_rad } = best.beside;
                        let beside = Beside {
                            offset_m: offset_m + aside_m * step * STEPS[0] - PIVOT_M * turned_rad,
                            ahead_m: ahead + ahead_m * step * STEPS[2],
                            heading_rad: heading_rad + turned_rad,
                        };
                        if let Some(alike) = self.alike(beside).filter(|alike| *alike > best.alike) {
                            best = Again { beside, alike };
                            better = true;
                        }
                    }
                }
            }
            size /= 2.0;
        }
        Some(best)
    }
}
