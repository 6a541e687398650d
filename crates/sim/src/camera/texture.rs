//! Pictures that surfaces and plants are covered with, in ever smaller copies.

use super::noise::{Fractal, mix, nearest, step, unit, value};

/// Red, green, blue and a fourth number, which is coverage for sprites and a mask for surfaces.
pub(super) type Texel = [u8; 4];

/// A picture whose sides are powers of two, with all its halvings.
#[derive(Debug, Clone)]
pub(super) struct Texture {
    texels: Vec<Texel>,
    levels: Vec<Level>,
}

#[derive(Debug, Clone, Copy)]
struct Level {
    start: usize,
    width: usize,
    height: usize,
}

impl Texture {
    /// Paints by `(x, y)` in pixels.
    pub(super) fn paint(width: usize, height: usize, mut texel: impl FnMut(usize, usize) -> [f32; 4]) -> Self {
        let mut texels = Vec::with_capacity(width * height * 4 / 3 + 2);
        for y in 0..height {
            texels.extend((0..width).map(|x| texel(x, y).map(|c| c.clamp(0.0, 255.0) as u8)));
        }
        Self::halve(texels, width, height)
    }

    fn halve(mut texels: Vec<Texel>, width: usize, height: usize) -> Self {
        let mut levels = vec![Level { start: 0, width, height }];
        let mut last = levels[0];
        while last.width > 1 || last.height > 1 {
            let next = Level { start: texels.len(), width: (last.width / 2).max(1), height: (last.height / 2).max(1) };
            for y in 0..next.height {
                for x in 0..next.width {
                    let at = |dx: usize, dy: usize| {
                        let (x, y) = ((2 * x + dx).min(last.width - 1), (2 * y + dy).min(last.height - 1));
                        texels[last.start + y * last.width + x]
                    };
                    let four = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
                    let cover: u32 = four.iter().map(|t| u32::from(t[3])).sum();
                    let mut mean = [0; 4];
                    for (c, mean) in mean.iter_mut().enumerate().take(3) {
                        // Weighted by coverage, so that empty texels add no colour.
                        let sum: u32 = four.iter().map(|t| u32::from(t[c]) * (1 + u32::from(t[3]))).sum();
                        *mean = (sum / (cover + 4)) as u8;
                    }
                    mean[3] = ((cover + 2) / 4) as u8;
                    texels.push(mean);
                }
            }
            levels.push(next);
            last = next;
        }
        Self { texels, levels }
    }

    /// The same, its smaller copies drawn twice as finely, interpolated between their texels. A surface seen at a flat
    /// angle is then soft across the line of sight, where a texel is wider than a pixel, as graphics cards draw it.
    pub(super) fn soft(self) -> Self {
        let mut soft = Self { texels: self.level(0).texels.to_vec(), levels: vec![self.levels[0]] };
        for number in 1..self.levels.len() {
            let copy = self.level(number);
            let finer = Level { start: soft.texels.len(), width: copy.width * 2, height: copy.height * 2 };
            for (y, x) in (0..finer.height).flat_map(|y| (0..finer.width).map(move |x| (y, x))) {
                // Of the nearest texel 9 parts, of its neighbours on this side 3, 3 and 1.
                let beside = |i: usize, n: usize| (i / 2 + n + (i % 2) * 2 - 1) % n;
                let (near, next) = ((x / 2, y / 2), (beside(x, copy.width), beside(y, copy.height)));
                let at = |x: usize, y: usize| copy.texels[y * copy.width + x].map(u32::from);
                let four = [at(near.0, near.1), at(next.0, near.1), at(near.0, next.1), at(next.0, next.1)];
                let [a, b, c, d] = four;
                soft.texels.push(std::array::from_fn(|i| ((9 * a[i] + 3 * (b[i] + c[i]) + d[i] + 8) / 16) as u8));
            }
            soft.levels.push(finer);
        }
        soft
    }

    /// One of the halvings: 0 is the full picture.
    #[inline]
    pub(super) fn level(&self, level: usize) -> Texels<'_> {
        let level = self.levels[level.min(self.levels.len() - 1)];
        Texels {
            texels: &self.texels[level.start..level.start + level.width * level.height],
            width: level.width,
            height: level.height,
        }
    }

    /// Width of the full picture.
    pub(super) fn width(&self) -> usize {
        self.levels[0].width
    }

    /// Height of the full picture.
    pub(super) fn height(&self) -> usize {
        self.levels[0].height
    }
}

/// One size of a picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Texels<'a> {
    pub(super) texels: &'a [Texel],
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Texels<'_> {
    /// The texel at a place in units of the picture's size, which repeats.
    #[inline]
    pub(super) fn wrapped(&self, u: f32, v: f32) -> Texel {
        let x = nearest(u * self.width as f32) & (self.width - 1);
        let y = nearest(v * self.height as f32) & (self.height - 1);
        self.texels[y * self.width + x]
    }
}

/// Coarse asphalt, 4 m a side: grey level 128 is the road's mean colour. The mask is a slower noise: leaves, dirt.
pub(super) fn asphalt(contrast: f32, seed: u32) -> Texture {
    let (mut patches, mut fallen) = (Fractal::new(3, 16, seed + 9), Fractal::new(3, 24, seed + 31));
    Texture::paint(256, 256, |x, y| {
        let (fx, fy) = (x as f32 / 256.0, y as f32 / 256.0);
        let stones = value(fx * 100.0, fy * 100.0, 100, seed) - 0.5;
        let grain = unit(x as i32, y as i32, seed + 5) - 0.5;
        let patches = patches.at(fx * 16.0, fy * 16.0) - 0.5;
        // A few bright stones, as in the real one.
        let bright = if value(fx * 64.0, fy * 64.0, 64, seed + 3) > 0.86 { 0.35 } else { 0.0 };
        let grey = 128.0 * (1.0 + contrast * (1.2 * stones + 0.8 * grain + 0.6 * patches + bright - 0.03));
        let mask = 255.0 * step(0.42, 0.62, fallen.at(fx * 24.0, fy * 24.0));
        [grey, grey, grey * 0.99, mask]
    })
}

/// Round cobbles in ten crooked rows along the way, each of which repeats after eight, with pale joints between them.
/// Grey level 128 is their mean; only the first channel counts, so they are grey.
pub(super) fn cobbles(seed: u32) -> Texture {
    // Crooked: no joint is straight, no stone as wide as the next.
    let mut bent = [1, 2].map(|more| Fractal::new(2, 16, seed + more));
    let mut rough = Fractal::new(2, 32, seed + 3);
    Texture::paint(256, 256, |x, y| {
        let (fx, fy) = (x as f32 / 256.0, y as f32 / 256.0);
        let [bent_across, bent_along] = bent.each_mut().map(|bent| bent.at(fx * 16.0, fy * 16.0) - 0.5);
        let across = (fy * 10.0 + 0.5 * bent_across).rem_euclid(10.0);
        let row = across as i32;
        let along = (fx * 8.0 + 0.7 * bent_along + 0.37 * (row * row % 7) as f32).rem_euclid(8.0);
        let (in_x, in_y) = (2.0 * along.fract() - 1.0, 2.0 * across.fract() - 1.0);
        let out = (in_x.powi(4) + in_y.powi(4)).sqrt().sqrt();
        let stone = step(1.02, 0.84, out);
        let rough = rough.at(fx * 32.0, fy * 32.0) - 0.5;
        let tone = 0.68 + 0.44 * unit(along as i32, row, seed) + 0.16 * rough;
        let grey = 128.0 * mix(COBBLE_JOINT, tone, stone);
        [grey, grey, grey, 0.0]
    })
}

/// How much brighter than their mean the joints between cobbles are.
const COBBLE_JOINT: f32 = 1.45;

/// Fine structure of open ground: grey level 128 is the ground's own colour.
pub(super) fn ground(contrast: f32, seed: u32) -> Texture {
    let mut noise = Fractal::new(4, 16, seed);
    Texture::paint(256, 256, |x, y| {
        let (fx, fy) = (x as f32 / 256.0, y as f32 / 256.0);
        let n = noise.at(fx * 16.0, fy * 16.0) - 0.5;
        let blades = value(fx * 128.0, fy * 64.0, 64, seed + 7) - 0.5;
        let grey = 128.0 * (1.0 + contrast * (1.5 * n + 0.5 * blades));
        [grey, grey, grey, 255.0]
    })
}

/// Rock with cracks, 8 m a side: grey level 128 is the rock's own colour.
pub(super) fn rock(contrast: f32, seed: u32) -> Texture {
    // Layers and clefts: coarse lumps, finer along the height than along the road.
    let (mut lumps, mut clefts) = (Fractal::new(3, 5, seed), Fractal::new(4, 8, seed + 1));
    Texture::paint(256, 256, |x, y| {
        let (fx, fy) = (x as f32 / 256.0, y as f32 / 256.0);
        let lumps = lumps.at(fx * 5.0, fy * 5.0) - 0.5;
        let clefts = clefts.at(fx * 24.0, fy * 8.0) - 0.5;
        let grey = 128.0 * (1.0 + contrast * (0.5 * lumps + 1.5 * clefts));
        [grey, grey, grey, 255.0]
    })
}

/// A concrete block's face with slanting yellow stripes, one block a picture.
pub(super) fn striped_block(seed: u32) -> Texture {
    let mut dirt = Fractal::new(3, 4, seed);
    Texture::paint(64, 32, |x, y| {
        let stripe = (x + y) / 11 % 2 == 0 && y > 3 && y < 28;
        let dirt = 0.75 + 0.5 * dirt.at(x as f32 / 16.0, y as f32 / 16.0);
        let colour = if stripe { [122.0, 104.0, 50.0] } else { [106.0, 106.0, 104.0] };
        let colour = colour.map(|c: f32| c * mix(0.75, 1.0, 1.0 - y as f32 / 32.0) * dirt);
        [colour[0], colour[1], colour[2], 255.0]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_copy_is_the_mean() {
        let half = Texture::paint(8, 8, |x, _| if x < 4 { [200.0, 0.0, 0.0, 255.0] } else { [100.0, 0.0, 0.0, 255.0] });
        assert_eq!(half.level(9).texels, [[150, 0, 0, 255]]);
    }

    #[test]
    fn what_is_not_covered_lends_no_colour() {
        let half = Texture::paint(4, 4, |x, _| if x % 2 == 0 { [200.0; 4] } else { [0.0; 4] });
        let [r, _, _, a] = half.level(1).texels[0];
        assert!(r > 195 && a == 100, "{r} {a}");
    }

    #[test]
    fn surfaces_are_of_their_colour_on_average() {
        for texture in [asphalt(0.6, 1), cobbles(4), ground(0.5, 2), rock(0.5, 3)] {
            let mean = texture.level(12).texels[0][0];
            assert!((108..=148).contains(&mean), "{mean}");
        }
    }
}
