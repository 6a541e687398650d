//! A road's painted lines, searched for in a picture near where they are expected.

use glam::DVec2;
use lapwing_core::perception::Frame;

use lapwing_tools::course::{Course, Eye, Stand};

/// A line along the road.
#[derive(Debug, Clone, Copy)]
pub struct Line {
    /// Metres from the road's middle to the line's, positive to the right.
    pub offset_m: f64,
    /// Its width, in metres.
    pub width_m: f64,
    /// What it looks like.
    pub mark: Mark,
}

/// What a line looks like.
#[derive(Debug, Clone, Copy)]
pub enum Mark {
    /// Bright paint, with asphalt on both sides.
    Middle,
    /// Bright paint, with asphalt on one side and green on the other: 1 if that is the right one, -1 if it is the left.
    Edge(f64),
    /// No paint: asphalt ends and a band of yellow leaves begins, on the right side (1) or on the left one (-1).
    Leaves(f64),
}

/// A piece of a line: its place, as the spline's parameter, and its line.
#[derive(Debug, Clone, Copy)]
pub struct Piece {
    /// The spline's parameter.
    pub t: f64,
    /// Its line.
    pub line: Line,
    /// Where it is expected.
    pub at: DVec2,
    /// Unit vector across it in the picture, towards the road's right side.
    pub across: DVec2,
    /// How wide it is in the picture, in pixels.
    pub width_px: f64,
    /// How far ahead it lies, in metres.
    pub away_m: f64,
}

/// Pixels between pieces.
const APART_PX: f64 = 6.0;
/// Rows below this one may show the bonnet.
const LOWEST: f64 = 132.0;
/// A place lower in the picture than one nearer by, by this much of its distance, is behind a crest.
const HIDDEN: f64 = 0.003;

/// The pieces of lines that are seen from a stand.
pub fn pieces(course: &Course, stand: &Stand, lines: &[Line], far_m: f64) -> Vec<Piece> {
    let (eye, knot_m) = (Eye::new(course, stand), course.knot_m());
    let mut pieces = Vec::new();
    for line in lines {
        let (mut last, mut highest) = (None::<DVec2>, f64::MIN);
        let mut away_m: f64 = 1.0;
        while away_m < far_m {
            let t = stand[0] + away_m / knot_m;
            let point = course.point(t, line.offset_m);
            let seen = eye.turn(point);
            let step_m = 0.1 + away_m * 0.012;
            away_m += step_m;
            if seen.z < 1.5 {
                continue;
            }
            let height = seen.y / seen.z;
            if height < highest - HIDDEN {
                continue;
            }
            highest = highest.max(height);
            let at = Eye::project(seen);
            if !(3.0..317.0).contains(&at.x) || !(3.0..LOWEST).contains(&at.y) {
                last = None;
                continue;
            }
            if last.is_some_and(|last| last.distance(at) < APART_PX) {
                continue;
            }
            last = Some(at);
            let next = eye.see(course.point(t + 0.1 / knot_m, line.offset_m));
            let beside = eye.see(course.point(t, line.offset_m + line.width_m));
            let (Some(next), Some(beside)) = (next, beside) else { continue };
            let along = (next - at).normalize_or(DVec2::NEG_Y);
            let across = DVec2::new(-along.y, along.x);
            let width_px = (beside - at).dot(across);
            if width_px < 0.12 {
                continue; // seen from so flat that it cannot be
            }
            pieces.push(Piece { t, line: *line, at, across, width_px, away_m });
        }
    }
    pieces
}

/// A picture's brightness, and how little green it is.
fn look(frame: &Frame, at: DVec2) -> Option<[f64; 2]> {
    let (x, y) = (at.x - 0.5, at.y - 0.5);
    if !(x >= 0.0 && y >= 0.0 && x < (frame.width() - 1) as f64 && y < (frame.height() - 1) as f64) {
        return None;
    }
    let (column, row) = (x as usize, y as usize);
    let (right, down) = (x - column as f64, y - row as f64);
    let mut sum = [0.0; 3];
    let rgb = frame.rgb();
    for (dx, dy, share) in [
        (0, 0, (1.0 - right) * (1.0 - down)),
        (1, 0, right * (1.0 - down)),
        (0, 1, (1.0 - right) * down),
        (1, 1, right * down),
    ] {
        let i = ((row + dy) * frame.width() + column + dx) * 3;
        for c in 0..3 {
            sum[c] += share * f64::from(rgb[i + c]);
        }
    }
    Some([(sum[0] + sum[1] + sum[2]) / 3.0, (sum[2] + 8.0) / (sum[1] + 8.0)])
}

/// Steps of the search, in pixels.
const STEP: f64 = 0.5;

/// How many pixels across from where it is expected a piece is found, within `reach`, and how clearly.
pub fn find(frame: &Frame, piece: &Piece, reach: f64) -> Option<(f64, f64)> {
    let half = (piece.width_px / 2.0).max(0.6);
    let beyond = half + 3.5;
    let count = (2.0 * (reach + beyond) / STEP) as usize + 1;
    let along = DVec2::new(piece.across.y, -piece.across.x);
    let mut profile = Vec::with_capacity(count);
    for i in 0..count {
        let d = i as f64 * STEP - reach - beyond;
        let mut sum = [0.0; 2];
        for shift in [-1.5, 0.0, 1.5] {
            let [l, g] = look(frame, piece.at + piece.across * d + along * shift)?;
            sum = [sum[0] + l / 3.0, sum[1] + g / 3.0];
        }
        profile.push(sum);
    }
    // Running sums, to take means quickly.
    let mut sums = vec![[0.0; 2]; count + 1];
    for (i, value) in profile.iter().enumerate() {
        sums[i + 1] = [sums[i][0] + value[0], sums[i][1] + value[1]];
    }
    let mean = |from: f64, to: f64, c: usize| {
        let index = |d: f64| (((d + reach + beyond) / STEP).round().max(0.0) as usize).min(count);
        let (a, b) = (index(from), index(to));
        let b = b.max(a + 1).min(count);
        let a = a.min(b - 1);
        (sums[b][c] - sums[a][c]) / (b - a) as f64
    };
    let strength = |d: f64| {
        let core = mean(d - half, d + half + STEP, 0);
        let (left, right) = (mean(d - half - 2.5, d - half - 0.5, 0), mean(d + half + 1.0, d + half + 3.0, 0));
        let ridge = (core - left.max(right)) / (0.3 * core + 12.0);
        let side = match piece.line.mark {
            Mark::Middle => {
                let (left, right) = (mean(d - half - 3.0, d - half, 1), mean(d + half + 0.5, d + half + 3.5, 1));
                return ridge - 1.5 * ((left - right).abs() - 0.06).max(0.0);
            }
            Mark::Leaves(side) => {
                // The band is as wide as the line.
                let band = (2.0 * half).min(3.5);
                let (left, right) = (mean(d - 3.5, d - 0.5, 1), mean(d + 0.5, d + band, 1));
                let (left_of, right_of) = (mean(d - band, d - 0.5, 1), mean(d + 0.5, d + 3.5, 1));
                return if side > 0.0 { left - right } else { right_of - left_of };
            }
            Mark::Edge(side) => side,
        };
        // Asphalt inside, green outside.
        let (inside, outside) = if side > 0.0 {
            (mean(d - half - 2.5, d + half, 1), mean(d + half + 0.5, d + half + 3.0, 1))
        } else {
            (mean(d - half, d + half + 2.5, 1), mean(d - half - 3.0, d - half - 0.5, 1))
        };
        let step = inside - outside;
        if step < 0.04 { 0.0 } else { ridge.clamp(-0.3, 1.0) + 1.2 * step.min(0.5) }
    };
    let tries = (reach / STEP) as i32;
    let (mut best, mut most) = (None, 0.0);
    let mut strengths = Vec::with_capacity(2 * tries as usize + 1);
    for i in -tries..=tries {
        strengths.push(strength(f64::from(i) * STEP));
    }
    for i in -tries + 1..tries {
        let k = (i + tries) as usize;
        let (before, here, after) = (strengths[k - 1], strengths[k], strengths[k + 1]);
        if here < before || here < after || here < 0.12 {
            continue;
        }
        let d = f64::from(i) * STEP;
        let worth = here * (-0.5 * (d / (0.7 * reach)).powi(2)).exp();
        if worth > most {
            most = worth;
            let bend = before + after - 2.0 * here;
            let finer = if bend < -1e-9 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
            best = Some((d + finer * STEP, here.min(1.0)));
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A white line four pixels wide about this column, asphalt to its left and grass to its right.
    fn painted(column: f64) -> Frame {
        let rgb = (0..320 * 160).flat_map(|i| match f64::from(i % 320) + 0.5 - column {
            x if x.abs() < 2.0 => [220, 220, 215],
            x if x < 0.0 => [130, 129, 126],
            _ => [86, 96, 60],
        });
        Frame::new(320, 160, rgb.collect()).unwrap()
    }

    #[test]
    fn a_line_is_found_beside_where_it_is_expected_and_only_with_its_verge() {
        let frame = painted(163.0);
        let piece = |side: f64| Piece {
            t: 0.0,
            line: Line { offset_m: 4.5, width_m: 0.14, mark: Mark::Edge(side) },
            at: DVec2::new(160.0, 100.0),
            across: DVec2::X,
            width_px: 4.0,
            away_m: 5.0,
        };
        let (aside, _) = find(&frame, &piece(1.0), 6.0).unwrap();
        assert!((aside - 3.0).abs() < 0.6, "{aside}");
        assert!(find(&frame, &piece(-1.0), 6.0).is_none(), "the grass is on the other side");
        assert!(find(&frame, &piece(1.0), 2.0).is_none(), "it is farther away");
    }
}
