//! Pillow's resizing: `libImaging/Resample.c` for the filters, `Geometry.c` for the nearest pixel.

use std::f64::consts::PI;

use super::{Pixels, picked};

/// How far a filter reaches at scale 1, and its weight at a distance.
pub(super) struct Kernel {
    support: f64,
    weight: fn(f64) -> f64,
}

pub(super) const BOX: Kernel = Kernel { support: 0.5, weight: |x| if x > -0.5 && x <= 0.5 { 1.0 } else { 0.0 } };

pub(super) const BILINEAR: Kernel = Kernel { support: 1.0, weight: |x| (1.0 - x.abs()).max(0.0) };

pub(super) const BICUBIC: Kernel = Kernel {
    support: 2.0,
    weight: |x| {
        const A: f64 = -0.5;
        let x = x.abs();
        if x < 1.0 {
            ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
        } else if x < 2.0 {
            (((x - 5.0) * x + 8.0) * x - 4.0) * A
        } else {
            0.0
        }
    },
};

pub(super) const LANCZOS: Kernel = Kernel {
    support: 3.0,
    weight: |x| {
        let sinc = |x: f64| if x == 0.0 { 1.0 } else { (x * PI).sin() / (x * PI) };
        if (-3.0..3.0).contains(&x) { sinc(x) * sinc(x / 3.0) } else { 0.0 }
    },
};

/// Bits behind the point of a weight.
const PRECISION: u32 = 32 - 8 - 2;

/// For one number of a side: the first of the source, and the weights from there on.
type Weights = (usize, Vec<i32>);

/// The weights of each of `to` numbers of a side of `from`.
fn weights(kernel: &Kernel, from: usize, to: usize) -> Vec<Weights> {
    let scale = from as f64 / to as f64;
    let widened = scale.max(1.0);
    let support = kernel.support * widened;
    (0..to)
        .map(|i| {
            let centre = (i as f64 + 0.5) * scale;
            let first = (centre - support + 0.5).max(0.0) as usize;
            let last = ((centre + support + 0.5) as usize).min(from);
            let weights: Vec<f64> =
                (first..last).map(|x| (kernel.weight)((x as f64 - centre + 0.5) * (1.0 / widened))).collect();
            let sum: f64 = weights.iter().sum();
            let fixed = |weight: &f64| {
                let weight = if sum == 0.0 { *weight } else { weight / sum } * f64::from(1u32 << PRECISION);
                (weight + if weight < 0.0 { -0.5 } else { 0.5 }) as i32
            };
            (first, weights.iter().map(fixed).collect())
        })
        .collect()
}

/// Across first, rounded to bytes, then down.
pub(super) fn convolved(source: Pixels<'_>, kernel: &Kernel, [width, height]: [usize; 2], out: &mut [u8]) {
    let channels = source.channels;
    let length = width * channels;
    let mut across = vec![0; length * source.height];
    if width == source.width {
        across.copy_from_slice(source.bytes);
    } else {
        let columns = weights(kernel, source.width, width);
        for (y, out) in across.chunks_exact_mut(length).enumerate() {
            let row = source.row(y);
            for ((first, weights), out) in columns.iter().zip(out.chunks_exact_mut(channels)) {
                for (channel, out) in out.iter_mut().enumerate() {
                    let bytes = row[first * channels + channel..].iter().step_by(channels);
                    *out = rounded(bytes.zip(weights).map(|(byte, weight)| i32::from(*byte) * weight).sum());
                }
            }
        }
    }
    if height == source.height {
        out.copy_from_slice(&across);
        return;
    }
    let mut sums = vec![0; length];
    for ((first, weights), out) in weights(kernel, source.height, height).iter().zip(out.chunks_exact_mut(length)) {
        sums.fill(0);
        for (row, weight) in across[first * length..].chunks_exact(length).zip(weights) {
            sums.iter_mut().zip(row).for_each(|(sum, byte)| *sum += i32::from(*byte) * weight);
        }
        out.iter_mut().zip(&sums).for_each(|(out, sum)| *out = rounded(*sum));
    }
}

fn rounded(sum: i32) -> u8 {
    ((sum + (1 << (PRECISION - 1))) >> PRECISION).clamp(0, 255) as u8
}

/// The pixel under the middle of the new one; places are summed up, as Pillow does.
pub(super) fn nearest(source: Pixels<'_>, [width, height]: [usize; 2], out: &mut [u8]) {
    let places = |from: usize, to: usize| -> Vec<usize> {
        let step = from as f64 / to as f64;
        let mut at = step * 0.5;
        let next = |_| {
            let place = (at as usize).min(from - 1);
            at += step;
            place
        };
        (0..to).map(next).collect()
    };
    picked(source, &places(source.width, width), &places(source.height, height), out);
}
