//! Haze, rain, night and camera faults, applied to a finished picture and its depths.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{raster::Raster, viewpoint::Viewpoint};
use crate::{conditions::Conditions, vehicle::Car};

/// How far the sky counts as, in metres.
const SKY_M: f32 = 900.0;

/// Working memory, kept from frame to frame.
#[derive(Debug, Default)]
pub(super) struct Weather {
    rows: Vec<f32>,
    noise: Vec<u8>,
}

impl Weather {
    /// Applies the conditions to a picture.
    pub(super) fn apply(
        &mut self,
        conditions: &Conditions,
        (seed, time_s): (u64, f64),
        (view, car): (&Viewpoint, &Car),
        raster: &Raster,
        rgb: &mut [u8],
    ) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ time_s.to_bits().wrapping_mul(0x9E37_79B9_7F4A_7C15));
        if conditions.haze > 0.0 || conditions.rain > 0.0 || conditions.night > 0.0 {
            atmosphere(conditions, view, car, raster, rgb);
        }
        if conditions.rain > 0.0 {
            streaks(conditions, view, &mut rng, rgb);
        }
        if conditions.brightness != 1.0 {
            let k = (conditions.brightness * 256.0) as u32;
            rgb.iter_mut().for_each(|c| *c = ((u32::from(*c) * k) >> 8).min(255) as u8);
        }
        if conditions.blur > 0.0 {
            self.blur(conditions.blur as f32, view.width, rgb);
        }
        if conditions.noise > 0.0 {
            self.noise(conditions.noise as f32, &mut rng, rgb);
        }
    }

    fn blur(&mut self, sigma: f32, width: usize, rgb: &mut [u8]) {
        let reach = (3.0 * sigma).ceil() as usize;
        let mut kernel: Vec<f32> = (0..=reach).map(|i| (-0.5 * (i as f32 / sigma).powi(2)).exp()).collect();
        let sum = kernel[0] + 2.0 * kernel[1..].iter().sum::<f32>();
        kernel.iter_mut().for_each(|k| *k /= sum);
        let height = rgb.len() / (3 * width);
        self.rows.clear();
        self.rows.resize(rgb.len(), 0.0);
        for (row, out) in rgb.chunks_exact(width * 3).zip(self.rows.chunks_exact_mut(width * 3)) {
            for x in 0..width {
                for c in 0..3 {
                    let mut sum = kernel[0] * f32::from(row[x * 3 + c]);
                    for (i, k) in kernel.iter().enumerate().skip(1) {
                        let (a, b) = (x.saturating_sub(i), (x + i).min(width - 1));
                        sum += k * (f32::from(row[a * 3 + c]) + f32::from(row[b * 3 + c]));
                    }
                    out[x * 3 + c] = sum;
                }
            }
        }
        for y in 0..height {
            for x in 0..width * 3 {
                let at = |y: usize| self.rows[y * width * 3 + x];
                let mut sum = kernel[0] * at(y);
                for (i, k) in kernel.iter().enumerate().skip(1) {
                    sum += k * (at(y.saturating_sub(i)) + at((y + i).min(height - 1)));
                }
                rgb[y * width * 3 + x] = (sum + 0.5) as u8;
            }
        }
    }

    fn noise(&mut self, deviation: f32, rng: &mut ChaCha8Rng, rgb: &mut [u8]) {
        // Four bytes make a number close enough to normal: mean 510, deviation 147.8.
        self.noise.resize(rgb.len() * 4, 0);
        rng.fill_bytes(&mut self.noise);
        for (c, four) in rgb.iter_mut().zip(self.noise.as_chunks::<4>().0) {
            let sum: i32 = four.iter().map(|b| i32::from(*b)).sum();
            let grey = f32::from(*c) + (sum - 510) as f32 * (deviation / 147.8);
            *c = (grey + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

/// Haze, the grey of rain, and night with headlights.
fn atmosphere(conditions: &Conditions, view: &Viewpoint, car: &Car, raster: &Raster, rgb: &mut [u8]) {
    let (haze, rain, night) = (conditions.haze as f32, conditions.rain as f32, conditions.night as f32);
    // Visibility ends at a contrast of a twentieth: three lengths of decay.
    let decay = 3.0 / 60.0 * haze * haze + 0.006 * rain * rain;
    let dark = 1.0 - 0.955 * night;
    let veil = [198.0, 203.0, 208.0].map(|c: f32| c * (1.0 - 0.25 * rain));
    let moon = [0.82 * dark, 0.92 * dark, (1.12 * dark).min(1.0)];
    let (sin, cos) = (car.yaw.sin() as f32, car.yaw.cos() as f32);
    let from_car = view.eye - car.position.as_vec3();
    for (y, row) in rgb.chunks_exact_mut(view.width * 3).enumerate() {
        let down = (y as f32 + 0.5 - view.cy) / view.focal;
        for (x, pixel) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let w = raster.depth[y * view.width + x];
            let depth = if w > 0.0 { 1.0 / w } else { SKY_M };
            let mut colour = pixel.map(f32::from);
            if rain > 0.0 {
                let grey = 0.34 * colour[0] + 0.5 * colour[1] + 0.16 * colour[2];
                let wet = if w > 0.0 { 1.0 - 0.28 * rain } else { 1.0 };
                colour = colour.map(|c| (c + (grey - c) * 0.6 * rain) * wet);
                if w == 0.0 {
                    colour = [0, 1, 2].map(|c| colour[c] + (veil[c] - colour[c]) * rain.min(0.95));
                }
            }
            let clear = (-decay * depth).exp();
            colour = [0, 1, 2].map(|c| veil[c] + (colour[c] - veil[c]) * clear);
            if night > 0.0 {
                let mut lit = 0.0;
                if w > 0.0 {
                    let aside = (x as f32 + 0.5 - view.cx) / view.focal;
                    let p = from_car + (view.forward + view.right * aside - view.up * down) * depth;
                    let (ahead, right) = (p.x * sin + p.z * cos - 1.8, p.x * cos - p.z * sin);
                    if ahead > 0.0 {
                        let wide = right / (ahead + 3.0);
                        let high = ((p.y - 0.6) / (ahead + 4.0)).max(0.0) * 5.0;
                        lit = night * 1.05
                            / ((1.0 + (ahead / 17.0).powi(2)) * (1.0 + 3.5 * wide * wide * wide * wide + high * high));
                        lit /= 1.0 + 4.0 * (wide.abs() - 0.6).max(0.0);
                    }
                }
                // Within the headlights' beam their light counts, elsewhere the moon's.
                colour = [0, 1, 2].map(|c| colour[c] * (moon[c] + lit * [1.0, 0.96, 0.86][c]).min(1.0));
            }
            *pixel = colour.map(|c| (c + 0.5).clamp(0.0, 255.0) as u8);
        }
    }
}

fn streaks(conditions: &Conditions, view: &Viewpoint, rng: &mut ChaCha8Rng, rgb: &mut [u8]) {
    let (width, height) = (view.width as f32, view.height as f32);
    let count = (conditions.rain * 340.0 * f64::from(width * height) / 51_200.0) as usize;
    let mut unit = || rng.random::<f32>();
    let bright = 190.0 * (1.0 - 0.75 * conditions.night as f32);
    for _ in 0..count {
        let (x, y) = (unit() * width, unit() * height * 1.1 - height * 0.1);
        let near = 0.4 + unit();
        let long = near * 0.075 * height;
        // Drops come towards the car: they lean away from the middle.
        let lean = (x / width - 0.5) * 0.7 + 0.08;
        let strength = 0.10 + 0.22 * near * conditions.rain as f32;
        for i in 0..long as usize {
            let (px, py) = (x + i as f32 * lean, y + i as f32);
            if px < 0.0 || py < 0.0 || px >= width || py >= height {
                continue;
            }
            let at = (py as usize * view.width + px as usize) * 3;
            for c in &mut rgb[at..at + 3] {
                *c = (f32::from(*c) + (bright - f32::from(*c)) * strength).clamp(0.0, 255.0) as u8;
            }
        }
    }
}
