//! The directions of a picture's edges, everywhere in it.

use crate::camera::contour::{clearness, gradients};
use lapwing_core::perception::Frame;

/// Cosine and sine of twice the angle of the gradient, times how clear the edge is: so an edge counts the same whichever
/// of its sides is the brighter, and the mean over a grain of all directions is nothing (Granlund 1978).
type Direction = [f32; 2];

/// The directions at each pixel.
#[derive(Debug, Clone)]
pub(super) struct Field {
    width: usize,
    height: usize,
    directions: Vec<Direction>,
}

impl Field {
    pub(super) fn new(frame: &Frame) -> Self {
        let direction = |[x, y]: [f32; 2]| {
            let steep = (x * x + y * y).max(1e-6);
            [(x * x - y * y) / steep, 2.0 * x * y / steep].map(|part| part * clearness([x, y]))
        };
        let directions = gradients(frame).into_iter().map(direction).collect();
        Self { width: frame.width(), height: frame.height(), directions }
    }

    /// The means over a neighbourhood of about this many pixels to each side, and half as many rows: two box filters,
    /// one after the other.
    pub(super) fn blurred(&self, reach: usize) -> Self {
        let mut blurred = self.clone();
        for _ in 0..2 {
            blurred.along_rows(reach);
            blurred.along_columns(reach.div_ceil(2));
        }
        blurred
    }

    /// Means over so many pixels to each side; outside a picture all is zero.
    fn along_rows(&mut self, reach: usize) {
        let share = 1.0 / (2 * reach + 1) as f32;
        let mut kept = vec![[0.0; 2]; self.width + 3 * reach + 1];
        let (gone, now) = (0, 2 * reach + 1);
        for row in self.directions.chunks_exact_mut(self.width.max(1)) {
            kept[now..now + row.len()].copy_from_slice(row);
            let mut sum: Direction = [0.0; 2];
            for (i, ([cos, sin], [cos_gone, sin_gone])) in kept[now..].iter().zip(&kept[gone..]).enumerate() {
                sum = [sum[0] + cos - cos_gone, sum[1] + sin - sin_gone];
                if let Some(at) = i.checked_sub(reach) {
                    row[at] = [sum[0] * share, sum[1] * share];
                }
            }
        }
    }

    /// The same over rows above and below, for a whole row at a time.
    fn along_columns(&mut self, reach: usize) {
        let share = 1.0 / (2 * reach + 1) as f32;
        let (kept, width, height) = (self.directions.clone(), self.width, self.directions.len() / self.width.max(1));
        let (kept, means) = (kept.as_flattened(), self.directions.as_flattened_mut());
        let across = |row: usize| 2 * row * width..2 * (row + 1) * width;
        let mut sums = vec![0.0; 2 * width];
        for row in 0..height + reach {
            if row < height {
                sums.iter_mut().zip(&kept[across(row)]).for_each(|(sum, value)| *sum += value);
            }
            if let Some(gone) = row.checked_sub(2 * reach + 1) {
                sums.iter_mut().zip(&kept[across(gone)]).for_each(|(sum, value)| *sum -= value);
            }
            if let Some(at) = row.checked_sub(reach) {
                means[across(at)].iter_mut().zip(&sums).for_each(|(mean, sum)| *mean = sum * share);
            }
        }
    }

    /// The direction at a place, between its four pixels; none outside.
    #[inline]
    pub(super) fn at(&self, x: f32, y: f32) -> Option<Direction> {
        let (x, y) = (x - 0.5, y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f32 && y < (self.height - 1) as f32) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (right, down) = (x - column as f32, y - row as f32);
        let here = row * self.width + column;
        let mix = |a: f32, b: f32, share: f32| a + (b - a) * share;
        let of = |i: usize| {
            let ([cos, sin], [cos_next, sin_next]) = (*self.directions.get(i)?, *self.directions.get(i + 1)?);
            Some((mix(cos, cos_next, right), mix(sin, sin_next, right)))
        };
        let ((cos, sin), (cos_below, sin_below)) = (of(here)?, of(here + self.width)?);
        Some([mix(cos, cos_below, down), mix(sin, sin_below, down)])
    }
}
