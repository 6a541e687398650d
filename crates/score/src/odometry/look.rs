//! What a place looks like.

use lapwing_core::perception::Frame;

/// Cells of a look, across and down; the picture below them shows the bonnet.
const GRID: (usize, usize) = (40, 16);
/// The share of a picture's height that the cells cover.
const SHOWN: (usize, usize) = (4, 5);
/// A cell is compared with this many cells to each side of it.
const AROUND: usize = 3;
/// Contrast below this, in levels of 256, is noise.
const NOISE: f64 = 2.0;

/// A picture prepared for comparison with others of the same place.
///
/// It holds the brightness in cells of a grid, each minus the mean and divided by the deviation of the cells around it:
/// outlines remain, while light, weather and season are removed. After the patch normalisation of SeqSLAM (Milford and
/// Wyeth, 2012).
#[derive(Debug, Clone, PartialEq)]
pub struct Look(Vec<f32>);

impl Look {
    /// Looks at the same one of a few known places agree by at least this. Of 120 drawn starts, of three tracks, along them and
    /// the other way, in random weather, all agree with themselves by 0.33 at least, and with no other by more. Among arbitrary
    /// places one look proves nothing: pictures 60 m or more apart on one road agree by up to 0.5.
    pub const SAME: f64 = 0.28;

    /// The look of a picture; `None` if it is smaller than the grid.
    pub fn of(frame: &Frame) -> Option<Self> {
        let (across, down) = GRID;
        let (width, height) = (frame.width(), frame.height() * SHOWN.0 / SHOWN.1);
        let (cell_w, cell_h) = (width / across, height / down);
        if cell_w == 0 || cell_h == 0 {
            return None;
        }
        // Sums of red, green and blue: a picture has so many pixels that each must cost little.
        let mut sums = vec![[0_u32; 3]; across * down];
        for (y, row) in frame.rgb().chunks_exact(3 * width).take(cell_h * down).enumerate() {
            let of_row = &mut sums[y / cell_h * across..][..across];
            for (sum, cell) in of_row.iter_mut().zip(row.chunks_exact(3 * cell_w)) {
                for rgb in cell.as_chunks::<3>().0 {
                    (0..3).for_each(|i| sum[i] += u32::from(rgb[i]));
                }
            }
        }
        let size = (cell_w * cell_h) as f64;
        // Rec. 601, as JPEG has it.
        let luma = |[r, g, b]: [f64; 3]| (0.299 * r + 0.587 * g + 0.114 * b) / size;
        let cells: Vec<f64> = sums.iter().map(|sum| luma(sum.map(f64::from))).collect();
        let normalised = (0..across * down).map(|i| {
            let (x, y) = (i % across, i / across);
            let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
            for v in y.saturating_sub(AROUND)..(y + AROUND + 1).min(down) {
                for u in x.saturating_sub(AROUND)..(x + AROUND + 1).min(across) {
                    let cell = cells[v * across + u];
                    (n, sum, squares) = (n + 1.0, sum + cell, squares + cell * cell);
                }
            }
            let mean: f64 = sum / n;
            let deviation = (squares / n - mean * mean).max(0.0).sqrt();
            (cells[i] - mean) / (deviation + NOISE)
        });
        let normalised: Vec<f64> = normalised.collect();
        // Scaled so that the product of two looks is their correlation.
        let n = normalised.len() as f64;
        let mean = normalised.iter().sum::<f64>() / n;
        let length = normalised.iter().map(|x| (x - mean).powi(2)).sum::<f64>().sqrt();
        (length > 0.0).then(|| Self(normalised.iter().map(|x| ((x - mean) / length) as f32).collect()))
    }

    /// How well two looks agree: their correlation, -1 to 1.
    pub fn agrees(&self, other: &Self) -> f64 {
        self.0.iter().zip(&other.0).map(|(a, b)| f64::from(a * b)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of blocks, each pixel changed by `change`.
    fn picture(seed: u32, change: impl Fn(usize, f64) -> f64) -> Frame {
        let (width, height) = (320, 160);
        let pixel = |i: usize| {
            let block = (i / width / 16 * 20 + i % width / 16) as u32;
            let mixed = (block.wrapping_mul(2_654_435_761) ^ seed.wrapping_mul(40_503)) >> 7;
            let level = f64::from(mixed.wrapping_mul(2_246_822_519) >> 24);
            [change(i, level).clamp(0.0, 255.0) as u8; 3]
        };
        Frame::new(width, height, (0..width * height).flat_map(pixel).collect()).unwrap()
    }

    #[test]
    fn a_place_looks_the_same_at_dusk_and_through_noise_and_another_does_not() {
        let day = Look::of(&picture(1, |_, level| level)).unwrap();
        let dusk = Look::of(&picture(1, |i, level| 10.0 + 0.3 * level + f64::from(i as u32 * 7919 % 13))).unwrap();
        let elsewhere = Look::of(&picture(77, |_, level| level)).unwrap();
        assert!((day.agrees(&day) - 1.0).abs() < 1e-3);
        assert!(day.agrees(&dusk) > 0.8, "{}", day.agrees(&dusk));
        assert!(day.agrees(&elsewhere) < Look::SAME, "{}", day.agrees(&elsewhere));
    }

    #[test]
    fn the_bonnet_is_no_part_of_a_look() {
        let bonnet = |i: usize, level: f64| if i / 320 >= 130 { 255.0 - level } else { level };
        let (with, without) = (picture(1, bonnet), picture(1, |_, level| level));
        assert_eq!(Look::of(&with), Look::of(&without));
    }

    #[test]
    fn what_shows_nothing_has_no_look() {
        assert_eq!(Look::of(&picture(1, |_, _| 80.0)), None);
        assert_eq!(Look::of(&Frame::default()), None);
    }
}
