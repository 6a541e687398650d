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
            blurred.mean(reach, (1, self.width), (self.width, self.height));
            blurred.mean(reach.div_ceil(2), (self.width, self.height), (1, self.width));
        }
        blurred
    }

    /// Means along lines: the step from one value to the next and the number of values, the same of lines.
    fn mean(&mut self, reach: usize, (step, count): (usize, usize), (aside, lines): (usize, usize)) {
        let mut line = vec![[0.0; 2]; count];
        let share = 1.0 / (2 * reach + 1) as f32;
        for first in (0..lines).map(|i| i * aside) {
            for (i, value) in line.iter_mut().enumerate() {
                *value = self.directions[first + i * step];
            }
            let mut sum: Direction = [0.0; 2];
            let add = |sum: &mut Direction, value: Direction, sign: f32| {
                *sum = [sum[0] + sign * value[0], sum[1] + sign * value[1]];
            };
            for i in 0..count + reach {
                if let Some(value) = line.get(i) {
                    add(&mut sum, *value, 1.0);
                }
                if let Some(gone) = i.checked_sub(2 * reach + 1) {
                    add(&mut sum, line[gone], -1.0);
                }
                if let Some(at) = i.checked_sub(reach) {
                    self.directions[first + at * step] = sum.map(|part| part * share);
                }
            }
        }
    }

    /// The direction at a place, between its four pixels; none outside.
    pub(super) fn at(&self, x: f32, y: f32) -> Option<Direction> {
        let (x, y) = (x - 0.5, y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f32 && y < (self.height - 1) as f32) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (right, down) = (x - column as f32, y - row as f32);
        let here = row * self.width + column;
        let mix = |a: Direction, b: Direction, share: f32| [0, 1].map(|c| a[c] + (b[c] - a[c]) * share);
        let of = |i: usize| mix(self.directions[i], self.directions[i + 1], right);
        Some(mix(of(here), of(here + self.width), down))
    }
}
