//! OpenCV's resizing of bytes: `modules/imgproc/src/resize.cpp`. Its `INTER_LINEAR` and `INTER_CUBIC` do not widen with the
//! scale: of a picture made smaller they skip pixels.

use super::{Pixels, picked};

/// Weights of `INTER_LINEAR` and `INTER_CUBIC` have 11 bits.
const COEFFICIENTS: f32 = 2048.0;
const CUBIC: f32 = -0.75;
/// What both weights of a pixel, across and down, have in one.
const UNIT: f32 = COEFFICIENTS * COEFFICIENTS;
/// How many numbers of a row OpenCV's wheels compute at a time.
const LANES: usize = 8;

/// Columns or rows of the source that one number of the target is made of, and their weights.
type Taps<const N: usize, T> = Vec<([usize; N], [T; N])>;

/// `INTER_NEAREST`.
pub(super) fn nearest(source: Pixels<'_>, [width, height]: [usize; 2], out: &mut [u8]) {
    let places = |from: usize, to: usize| -> Vec<usize> {
        let step = 1.0 / (to as f64 / from as f64);
        (0..to).map(|i| ((i as f64 * step) as usize).min(from - 1)).collect()
    };
    picked(source, &places(source.width, width), &places(source.height, height), out);
}

/// `INTER_LINEAR`. Half the size on both sides is `INTER_AREA` to OpenCV.
pub(super) fn linear(source: Pixels<'_>, [width, height]: [usize; 2], out: &mut [u8]) {
    if source.width == 2 * width && source.height == 2 * height {
        return area(source, [width, height], out);
    }
    let place = |from: usize, to: usize| {
        let scale = 1.0 / (to as f64 / from as f64);
        move |i: usize| {
            let at = ((i as f64 + 0.5) * scale - 0.5) as f32;
            (at.floor() as i64, at - at.floor())
        }
    };
    let columns = taps(source.width, width, place(source.width, width), true);
    let rows = taps(source.height, height, place(source.height, height), false);
    bilinear(source, &columns, &rows, out);
}

/// Both neighbours of each place and their weights, which for columns beyond the edge are the edge's alone.
fn taps(from: usize, to: usize, place: impl Fn(usize) -> (i64, f32), at_edges: bool) -> Taps<2, i16> {
    let last = from as i64 - 1;
    (0..to)
        .map(|i| {
            let (mut first, mut part) = place(i);
            if at_edges && (first < 0 || first >= last) {
                (first, part) = (first.clamp(0, last), 0.0);
            }
            let near = [first, first + 1].map(|i| i.clamp(0, last) as usize);
            (near, [1.0 - part, part].map(fixed))
        })
        .collect()
}

/// To the nearest, ties to even, as `cvRound`.
fn fixed(weight: f32) -> i16 {
    (weight * COEFFICIENTS).round_ties_even() as i16
}

fn bilinear(source: Pixels<'_>, columns: &Taps<2, i16>, rows: &Taps<2, i16>, out: &mut [u8]) {
    let length = columns.len() * source.channels;
    let across: Vec<i32> = (0..source.height).flat_map(|y| blended(source, y, columns)).collect();
    for ((near, weights), out) in rows.iter().zip(out.chunks_exact_mut(length)) {
        let [upper, lower] = near.map(|y| &across[y * length..][..length]);
        let [first, second] = weights.map(i32::from);
        for ((out, upper), lower) in out.iter_mut().zip(upper).zip(lower) {
            let sum = ((first * (upper >> 4)) >> 16) + ((second * (lower >> 4)) >> 16);
            *out = ((sum + 2) >> 2) as u8;
        }
    }
}

/// A row of the source at the target's width, in 2048ths.
fn blended<const N: usize>(source: Pixels<'_>, y: usize, columns: &Taps<N, i16>) -> Vec<i32> {
    let (row, channels) = (source.row(y), source.channels);
    let mut blended = Vec::with_capacity(columns.len() * channels);
    for (near, weights) in columns {
        for channel in 0..channels {
            let weighed = near.iter().zip(weights).map(|(x, w)| i32::from(row[x * channels + channel]) * i32::from(*w));
            blended.push(weighed.sum());
        }
    }
    blended
}

/// `INTER_CUBIC`: Keys' filter with a = -0.75.
pub(super) fn cubic(source: Pixels<'_>, [width, height]: [usize; 2], out: &mut [u8]) {
    let (columns, rows) = (keys(source.width, width), keys(source.height, height));
    let length = width * source.channels;
    let across: Vec<i32> = (0..source.height).flat_map(|y| blended(source, y, &columns)).collect();
    for ((near, weights), out) in rows.iter().zip(out.chunks_exact_mut(length)) {
        let lines = near.map(|y| &across[y * length..][..length]);
        let (whole, shares) = (weights.map(i32::from), weights.map(|weight| f32::from(weight) / UNIT));
        for (x, out) in out.iter_mut().enumerate() {
            let sums = lines.map(|line| line[x]);
            // OpenCV's vector code takes the weights as f32, the last summand first; the rest of a row is in 2^22ths.
            let sum = if x < length / LANES * LANES {
                let [a, b, c, d] = sums.map(|sum| sum as f32);
                let sum = a * shares[0] + (b * shares[1] + (c * shares[2] + d * shares[3]));
                sum.round_ties_even() as i32
            } else {
                let sum: i32 = sums.iter().zip(whole).map(|(sum, weight)| sum * weight).sum();
                (sum + (1 << 21)) >> 22
            };
            *out = sum.clamp(0, 255) as u8;
        }
    }
}

fn keys(from: usize, to: usize) -> Taps<4, i16> {
    let scale = 1.0 / (to as f64 / from as f64);
    (0..to)
        .map(|i| {
            let at = ((i as f64 + 0.5) * scale - 0.5) as f32;
            let (first, x) = (at.floor() as i64 - 1, at - at.floor());
            let near = [0, 1, 2, 3].map(|k| (first + k).clamp(0, from as i64 - 1) as usize);
            let inner = |x: f32| ((CUBIC + 2.0) * x - (CUBIC + 3.0)) * x * x + 1.0;
            let outer = |x: f32| ((CUBIC * x - 5.0 * CUBIC) * x + 8.0 * CUBIC) * x - 4.0 * CUBIC;
            let [a, b, c] = [outer(x + 1.0), inner(x), inner(1.0 - x)];
            (near, [a, b, c, 1.0 - a - b - c].map(fixed))
        })
        .collect()
}

/// `INTER_AREA`: the mean of the area that a pixel covers; where a side grows, OpenCV blends neighbours instead.
pub(super) fn area(source: Pixels<'_>, [width, height]: [usize; 2], out: &mut [u8]) {
    if width > source.width || height > source.height {
        let columns = taps(source.width, width, grown(source.width, width), true);
        let rows = taps(source.height, height, grown(source.height, height), false);
        return bilinear(source, &columns, &rows, out);
    }
    if source.width.is_multiple_of(width) && source.height.is_multiple_of(height) {
        return tiles(source, [source.width / width, source.height / height], out);
    }
    let (columns, rows) = (shares(source.width, width), shares(source.height, height));
    let length = width * source.channels;
    let mut sums = vec![0f32; length];
    for (rows, out) in rows.iter().zip(out.chunks_exact_mut(length)) {
        for (nth, (y, share)) in rows.iter().enumerate() {
            let row = narrowed(source, *y, &columns);
            for (sum, x) in sums.iter_mut().zip(row) {
                *sum = if nth == 0 { share * x } else { *sum + share * x };
            }
        }
        out.iter_mut().zip(&sums).for_each(|(out, sum)| *out = sum.round_ties_even().clamp(0.0, 255.0) as u8);
    }
}

/// Where `INTER_AREA` blends neighbours on a side of `from` that becomes `to`.
fn grown(from: usize, to: usize) -> impl Fn(usize) -> (i64, f32) {
    let growth = to as f64 / from as f64;
    let scale = 1.0 / growth;
    move |i| {
        let first = (i as f64 * scale).floor();
        let part = ((i as f64 + 1.0) - (first + 1.0) * growth) as f32;
        (first as i64, if part <= 0.0 { 0.0 } else { part - part.floor() })
    }
}

/// Means of whole tiles.
fn tiles(source: Pixels<'_>, [across, down]: [usize; 2], out: &mut [u8]) {
    let (channels, width) = (source.channels, source.width / across);
    let share = 1.0 / (across * down) as f32;
    for (i, out) in out.iter_mut().enumerate() {
        let (channel, x, y) = (i % channels, i / channels % width, i / channels / width);
        let line =
            |row| source.row(y * down + row)[x * across * channels + channel..].iter().step_by(channels).take(across);
        let sum: u32 = (0..down).flat_map(line).map(|byte| u32::from(*byte)).sum();
        *out = if (across, down) == (2, 2) {
            ((sum + 2) >> 2) as u8
        } else {
            (sum as f32 * share).round_ties_even() as u8
        };
    }
}

/// For each of `to` numbers of a side: which of `from` it covers, and by which share of itself.
fn shares(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = 1.0 / (to as f64 / from as f64);
    (0..to)
        .map(|i| {
            let begin = i as f64 * scale;
            let end = begin + scale;
            let cell = scale.min(from as f64 - begin);
            let last = (end.floor() as usize).min(from - 1);
            let first = (begin.ceil() as usize).min(last);
            let mut shares = vec![];
            if first as f64 - begin > 1e-3 {
                shares.push((first - 1, ((first as f64 - begin) / cell) as f32));
            }
            shares.extend((first..last).map(|x| (x, (1.0 / cell) as f32)));
            if end - last as f64 > 1e-3 {
                shares.push((last, ((end - last as f64).min(1.0).min(cell) / cell) as f32));
            }
            shares
        })
        .collect()
}

/// A row of the source at the target's width.
fn narrowed(source: Pixels<'_>, y: usize, columns: &[Vec<(usize, f32)>]) -> Vec<f32> {
    let (row, channels) = (source.row(y), source.channels);
    let mut narrowed = Vec::with_capacity(columns.len() * channels);
    for shares in columns {
        for channel in 0..channels {
            let share = |sum: f32, (x, share): &(usize, f32)| sum + f32::from(row[x * channels + channel]) * share;
            narrowed.push(shares.iter().fold(0.0, share));
        }
    }
    narrowed
}
