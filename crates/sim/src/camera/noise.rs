//! Noise that is the same everywhere: hashes of whole numbers, and smooth noise over the plane.

/// A well-mixed number for two whole ones and a seed (the finaliser of MurmurHash3).
pub(super) fn hash(x: i32, y: i32, seed: u32) -> u32 {
    let mut h =
        (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77) ^ seed.wrapping_mul(0xC2B2_AE3D);
    h ^= h >> 16;
    h = h.wrapping_mul(0x85EB_CA6B);
    h ^= h >> 13;
    h = h.wrapping_mul(0xC2B2_AE35);
    h ^ (h >> 16)
}

/// From 0 to less than 1.
pub(super) fn unit(x: i32, y: i32, seed: u32) -> f32 {
    (hash(x, y, seed) >> 8) as f32 / 16_777_216.0
}

/// Smooth noise from 0 to 1 with a grid of 1; repeats after `period` where that is not 0.
pub(super) fn value(x: f32, y: f32, period: i32, seed: u32) -> f32 {
    { Cell::NONE }.value((x, y), period, seed)
}

/// Octaves of smooth noise, each half as strong and twice as fine; from 0 to 1, mostly near 0.5.
pub(super) fn fractal(x: f32, y: f32, octaves: usize, period: i32, seed: u32) -> f32 {
    Fractal::new(octaves, period, seed).at(x, y)
}

/// The most octaves that [`Fractal`] adds up.
const OCTAVES: usize = 4;

/// [`fractal`] for one place after another: while they lie in the same cell of a grid, its corners are known.
#[derive(Debug, Clone)]
pub(super) struct Fractal {
    cells: [Cell; OCTAVES],
    octaves: usize,
    period: i32,
    seed: u32,
}

impl Fractal {
    pub(super) fn new(octaves: usize, period: i32, seed: u32) -> Self {
        Self { cells: [Cell::NONE; OCTAVES], octaves, period, seed }
    }

    pub(super) fn at(&mut self, x: f32, y: f32) -> f32 {
        let (mut sum, mut total, mut weight, mut scale, mut seed) = (0.0, 0.0, 1.0, 1, self.seed);
        for cell in &mut self.cells[..self.octaves] {
            sum += weight * cell.value((x * scale as f32, y * scale as f32), self.period * scale, seed);
            total += weight;
            weight *= 0.5;
            scale *= 2;
            seed = seed.wrapping_add(17);
        }
        sum / total
    }
}

/// A square of a grid, and the noise at its corners.
#[derive(Debug, Clone, Copy)]
struct Cell {
    at: Option<(i32, i32)>,
    corners: [f32; 4],
}

impl Cell {
    const NONE: Self = Self { at: None, corners: [0.0; 4] };

    /// See [`value`]; period and seed are always the same.
    #[inline]
    fn value(&mut self, (x, y): (f32, f32), period: i32, seed: u32) -> f32 {
        let (ix, iy) = (floor(x), floor(y));
        if self.at != Some((ix, iy)) {
            let wrap = |i: i32| if period > 0 { i.rem_euclid(period) } else { i };
            let corner = |dx, dy| unit(wrap(ix + dx), wrap(iy + dy), seed);
            *self = Self { at: Some((ix, iy)), corners: [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)] };
        }
        let [a, b, c, d] = self.corners;
        let (tx, ty) = (x - ix as f32, y - iy as f32);
        let (tx, ty) = (tx * tx * (3.0 - 2.0 * tx), ty * ty * (3.0 - 2.0 * ty));
        mix(mix(a, b, tx), mix(c, d, tx), ty)
    }
}

/// The next whole number down. `f32::floor` is a call where the compiler may not count on SSE4.1.
#[inline]
fn floor(x: f32) -> i32 {
    let whole = x as i32;
    whole - i32::from(whole as f32 > x)
}

/// The nearest whole number, kept to 22 bits: negative numbers count down from 2^22. Adding 1.5 * 2^23 leaves it in the
/// low bits of the sum, which is far cheaper than a conversion that checks its range.
#[inline]
pub(super) fn nearest(x: f32) -> usize {
    ((x + 12_582_912.0).to_bits() & 0x3F_FFFF) as usize
}

/// From `a` at 0 to `b` at 1.
pub(super) fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// Component by component from `a` at 0 to `b` at 1.
pub(super) fn mix3(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [mix(a[0], b[0], t), mix(a[1], b[1], t), mix(a[2], b[2], t)]
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn step(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periodic_noise_meets_itself() {
        for i in 0..50 {
            let y = i as f32 * 0.37;
            assert!((fractal(0.0, y, 4, 8, 3) - fractal(8.0, y, 4, 8, 3)).abs() < 1e-5);
        }
    }

    #[test]
    fn noise_stays_between_nought_and_one_and_varies() {
        let all: Vec<f32> = (0..1000).map(|i| fractal(i as f32 * 0.73, i as f32 * 0.31, 3, 0, 9)).collect();
        assert!(all.iter().all(|x| (0.0..=1.0).contains(x)));
        assert!(all.iter().any(|x| *x < 0.3) && all.iter().any(|x| *x > 0.7));
    }
}
