//! From a log and the edges in its pictures to places on the road.

use super::{Edges, Pose, SurveyLens};
use lapwing_core::{car::FULL_STEERING_DEG, motion};
use lapwing_sim::track::{Edge, Side, Track};

/// Rows of a picture by which the car's offset and yaw are fitted. Rows 80, 100 and 120 and their
/// neighbours are not among them: there, rendered and real edges are compared.
pub const FIT_ROWS: [usize; 16] = [84, 86, 88, 90, 92, 94, 96, 104, 106, 108, 110, 112, 114, 116, 124, 126];

/// Metres from the road's edge outward to what the detector takes as the edge: the inner yellow line's middle lies 3.45
/// m from the lake road's middle, whose half width is 3.35 m.
const LINE_M: f64 = 0.1;
/// Metres ahead of the car's origin on which [`super::Detector::paved`] looks.
const PAVED_AHEAD_M: f64 = 4.5;
/// Metres between samples of curvature, and the half width of their Hann window.
const GRID_M: f64 = 1.0;
const WINDOW: usize = 15;

/// One row of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Sighting {
    /// Seconds from its beginning.
    pub at: f64,
    /// Metres a second.
    pub speed: f64,
    /// Normalised steering.
    pub steering: f64,
    /// Whether the ground ahead is a bridge's paving.
    pub paved: bool,
    /// The edges seen in [`FIT_ROWS`].
    pub edges: Vec<Edges>,
}

/// How distance driven becomes a place along the road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Odometry {
    /// Where the recording begins, in metres along the road.
    pub from_m: f64,
    /// Metres along the road per metre driven.
    pub scale: f64,
    /// How well curvature driven and curvature of the road agree, -1 to 1.
    pub correlation: f64,
}

/// Where the car was in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// The place.
    pub pose: Pose,
    /// Median distance, in columns, of the edges seen in [`FIT_ROWS`] from those of the pose.
    pub residual: f64,
    /// How many edges were seen.
    pub seen: usize,
}

/// Why a recording's place was not found.
#[derive(Debug, thiserror::Error)]
pub enum LocaliseError {
    /// The drive is too short to know its bends.
    #[error("recording: expected a drive of at least 100 m, got {got:.0} m")]
    Short {
        /// Its length.
        got: f64,
    },
}

/// Finds where each moment was. `start` is where the recording begins, if known.
///
/// # Errors
/// [`LocaliseError::Short`].
pub fn localise(
    track: &Track,
    lens: &SurveyLens,
    moments: &[Sighting],
    start: Option<f64>,
) -> Result<(Odometry, Vec<Fix>), LocaliseError> {
    let driven = driven(moments);
    let total = driven.last().copied().unwrap_or(0.0);
    if total < 100.0 {
        return Err(LocaliseError::Short { got: total });
    }
    let odometry = place(track, moments, &driven, start);
    let raw: Vec<Fix> = moments
        .iter()
        .zip(&driven)
        .map(|(moment, driven)| fit(track, lens, odometry.from_m + odometry.scale * driven, moment))
        .collect();
    let fixes = (0..raw.len()).map(|i| smooth(track, lens, &raw, moments, i)).collect();
    Ok((odometry, fixes))
}

/// Metres driven up to each moment, by the trapezoid rule.
fn driven(moments: &[Sighting]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut out = Vec::with_capacity(moments.len());
    for (i, now) in moments.iter().enumerate() {
        if let Some(before) = i.checked_sub(1).and_then(|i| moments.get(i)) {
            sum += (now.at - before.at) * (now.speed + before.speed) / 2.0;
        }
        out.push(sum);
    }
    out
}

/// Where the drive begins: roughly from curvature, and exactly from the bridge's paving if there is one.
fn place(track: &Track, moments: &[Sighting], driven: &[f64], start: Option<f64>) -> Odometry {
    let steered = hann(&steered(moments, driven));
    let curved = hann(
        &(0..(track.length() / GRID_M) as usize).map(|i| track.at(i as f64 * GRID_M).curvature).collect::<Vec<_>>(),
    );
    let paving: Vec<(f64, bool)> =
        moments.iter().zip(driven).step_by(3).map(|(moment, &driven)| (driven, moment.paved)).collect();
    let score = |from_m: f64, scale: f64| {
        let correlation = correlation(&steered, |i| {
            curved[((from_m + i as f64 * GRID_M * scale).rem_euclid(track.length()) / GRID_M) as usize % curved.len()]
        });
        let wrong = paving
            .iter()
            .filter(|(driven, paved)| {
                let s = (from_m + driven * scale + PAVED_AHEAD_M).rem_euclid(track.length());
                track.file().has(Edge::Bridge, Side::Left, s) != *paved
            })
            .count();
        let share = wrong as f64 / paving.len() as f64;
        (correlation - 5.0 * share, Odometry { from_m: from_m.rem_euclid(track.length()), scale, correlation })
    };
    let best = |candidates: &mut dyn Iterator<Item = (f64, f64)>| {
        candidates.map(|(from, scale)| score(from, scale)).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, o)| o)
    };
    let around = |middle: Odometry, reach: i32, step: f64| {
        (-reach..=reach)
            .flat_map(move |i| (-8..=8).map(move |k| (middle.from_m + f64::from(i) * step, 1.0 + f64::from(k) * 0.001)))
    };
    let coarse = match start {
        Some(from_m) => Some(Odometry { from_m, scale: 1.0, correlation: 0.0 }),
        None => {
            let places = (track.length() / 3.0) as u32;
            best(&mut (0..places).flat_map(|i| [0.994, 0.998, 1.002].map(|scale| (f64::from(i) * 3.0, scale))))
        }
    };
    let coarse = coarse.unwrap_or(Odometry { from_m: 0.0, scale: 1.0, correlation: 0.0 });
    best(&mut around(coarse, if start.is_some() { 10 } else { 30 }, 0.5)).unwrap_or(coarse)
}

/// Curvature that the steering gives, for each metre driven.
fn steered(moments: &[Sighting], driven: &[f64]) -> Vec<f64> {
    let mut i = 0;
    (0..(driven.last().copied().unwrap_or(0.0) / GRID_M) as usize)
        .map(|k| {
            while driven.get(i + 1).is_some_and(|&d| d < k as f64 * GRID_M) {
                i += 1;
            }
            motion::curvature(moments[i].steering * FULL_STEERING_DEG)
        })
        .collect()
}

fn hann(values: &[f64]) -> Vec<f64> {
    let reach = WINDOW as isize;
    let weight = |k: isize| (std::f64::consts::PI * k as f64 / (reach + 1) as f64).cos() + 1.0;
    (0..values.len() as isize)
        .map(|i| {
            let inside = (-reach..=reach).filter_map(|k| Some((weight(k), values.get(usize::try_from(i + k).ok()?)?)));
            let (sum, total) = inside.fold((0.0, 0.0), |(sum, total), (w, v)| (sum + w * v, total + w));
            sum / total
        })
        .collect()
}

fn correlation(a: &[f64], b: impl Fn(usize) -> f64) -> f64 {
    let n = a.len() as f64;
    let (mut sa, mut sb, mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (i, &x) in a.iter().enumerate() {
        let y = b(i);
        (sa, sb, aa, bb, ab) = (sa + x, sb + y, aa + x * x, bb + y * y, ab + x * y);
    }
    (ab - sa * sb / n) / ((aa - sa * sa / n) * (bb - sb * sb / n)).sqrt().max(1e-12)
}

/// Metres from the middle to the edges that the detector sees.
fn edge_offsets(track: &Track, s: f64, paved: bool) -> [f64; 2] {
    let ahead = (s + PAVED_AHEAD_M).rem_euclid(track.length());
    let out =
        if paved && track.file().has(Edge::Bridge, Side::Left, ahead) { Edge::Bridge.stands_off_m() } else { LINE_M };
    [-track.half_width() - out, track.half_width() + out]
}

/// The columns of both edges of a pose, row by row of [`FIT_ROWS`].
fn expected(track: &Track, lens: &SurveyLens, pose: Pose, paved: bool) -> Vec<Edges> {
    let [left, right] = edge_offsets(track, pose.s, paved).map(|offset| lens.line(track, pose, offset, &FIT_ROWS));
    left.into_iter().zip(right).map(|(left, right)| [left, right]).collect()
}

/// Offset and yaw at `s` by Gauss-Newton, with outliers weighted down more in each step.
fn fit(track: &Track, lens: &SurveyLens, s: f64, moment: &Sighting) -> Fix {
    let mut pose = Pose { s, offset: track.file().driving_line_m, yaw: 0.0 };
    let home = pose;
    let (step_offset, step_yaw) = (0.02, 0.002);
    for round in 0..12 {
        let spread = (40.0 * 0.55_f64.powi(round)).max(1.0);
        let at = expected(track, lens, pose, moment.paved);
        let aside = expected(track, lens, Pose { offset: pose.offset + step_offset, ..pose }, moment.paved);
        let turned = expected(track, lens, Pose { yaw: pose.yaw + step_yaw, ..pose }, moment.paved);
        // Priors of 1.2 m and 4.5 degrees against edges that are accurate to 1.2 columns: a picture without edges stays
        // on the driving line.
        let (mut a, mut b, mut c) = (1.0, 0.0, 400.0);
        let (mut p, mut q) = (home.offset - pose.offset, -400.0 * pose.yaw);
        for (((seen, at), aside), turned) in moment.edges.iter().zip(&at).zip(&aside).zip(&turned) {
            for side in 0..2 {
                let (Some(seen), Some(at), Some(aside), Some(turned)) =
                    (seen[side], at[side], aside[side], turned[side])
                else {
                    continue;
                };
                let error = seen - at;
                if error.abs() > (160.0 / f64::from(round + 1)).max(25.0) {
                    continue;
                }
                let weight = 1.0 / (1.0 + (error / spread).powi(2));
                let (by_offset, by_yaw) = ((aside - at) / step_offset, (turned - at) / step_yaw);
                a += weight * by_offset * by_offset;
                b += weight * by_offset * by_yaw;
                c += weight * by_yaw * by_yaw;
                p += weight * by_offset * error;
                q += weight * by_yaw * error;
            }
        }
        let determinant = a * c - b * b;
        pose.offset = (pose.offset + ((c * p - b * q) / determinant).clamp(-1.0, 1.0)).clamp(-6.0, 6.0);
        pose.yaw = (pose.yaw + ((a * q - b * p) / determinant).clamp(-0.15, 0.15)).clamp(-0.6, 0.6);
    }
    judged(track, lens, pose, moment)
}

/// A pose, and how well it explains the edges.
fn judged(track: &Track, lens: &SurveyLens, pose: Pose, moment: &Sighting) -> Fix {
    let at = expected(track, lens, pose, moment.paved);
    let mut errors: Vec<f64> = moment
        .edges
        .iter()
        .zip(&at)
        .flat_map(|(seen, at)| [0, 1].map(|side| Some((seen[side]? - at[side]?).abs())))
        .flatten()
        .collect();
    errors.sort_by(f64::total_cmp);
    let seen = errors.len();
    Fix { pose, residual: errors.get(seen / 2).copied().unwrap_or(f64::INFINITY), seen }
}

/// The pose at `i` from a line through its neighbours' within four moments: a car moves steadily.
fn smooth(track: &Track, lens: &SurveyLens, raw: &[Fix], moments: &[Sighting], i: usize) -> Fix {
    let near = &raw[i.saturating_sub(4)..(i + 5).min(raw.len())];
    let first = i.saturating_sub(4);
    let middle = |value: &dyn Fn(&Fix) -> f64| {
        let mut values: Vec<f64> = near.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let through = |value: &dyn Fn(&Fix) -> f64, spread: f64| {
        let usual = middle(value);
        let (mut w0, mut w1, mut w2, mut v0, mut v1) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (k, fix) in near.iter().enumerate() {
            let t = (first + k) as f64 - i as f64;
            let trust = if fix.seen >= 6 { 1.0 / (fix.residual.powi(2) + 0.3) } else { 1e-3 };
            let w = trust / (1.0 + ((value(fix) - usual) / spread).powi(2));
            (w0, w1, w2) = (w0 + w, w1 + w * t, w2 + w * t * t);
            (v0, v1) = (v0 + w * value(fix), v1 + w * value(fix) * t);
        }
        w2 += 2.0 * w0; // slopes only where the moments agree on one
        (w2 * v0 - w1 * v1) / (w0 * w2 - w1 * w1)
    };
    let pose = Pose {
        s: raw[i].pose.s.rem_euclid(track.length()),
        offset: through(&|fix| fix.pose.offset, 0.25),
        yaw: through(&|fix| fix.pose.yaw, 0.05),
    };
    judged(track, lens, pose, &moments[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A weaving drive along the lake from a place on, with edges where geometry puts them.
    fn weaving(track: &Track, lens: &SurveyLens, from: f64, count: usize) -> (Vec<Sighting>, Vec<Pose>) {
        let speed = 12.0;
        let poses: Vec<Pose> = (0..count)
            .map(|i| {
                let s = (from + speed * i as f64 / 15.0).rem_euclid(track.length());
                Pose { s, offset: 0.8 * (s / 20.0).sin(), yaw: 0.04 * (s / 20.0).cos() }
            })
            .collect();
        let moments = poses
            .iter()
            .enumerate()
            .map(|(i, &pose)| {
                let ahead = (pose.s + PAVED_AHEAD_M).rem_euclid(track.length());
                let paved = track.file().has(Edge::Bridge, Side::Left, ahead);
                let inside = |column: f64| (0.0..320.0).contains(&column).then_some(column);
                let edges = expected(track, lens, pose, paved)
                    .into_iter()
                    .map(|edges| edges.map(|edge| edge.and_then(inside)))
                    .collect();
                let curvature = track.at(pose.s).curvature;
                let steering = motion::steering_deg(curvature) / FULL_STEERING_DEG;
                Sighting { at: i as f64 / 15.0, speed, steering, paved, edges }
            })
            .collect();
        (moments, poses)
    }

    #[test]
    fn a_drive_is_found_where_it_was() {
        let track = Track::named("lake").unwrap();
        let lens = SurveyLens::stock();
        let (moments, poses) = weaving(&track, &lens, 500.0, 600);
        let (odometry, fixes) = localise(&track, &lens, &moments, None).unwrap();
        assert!((odometry.from_m - 500.0).abs() < 4.0 && odometry.correlation > 0.95, "{odometry:?}");
        let mut worst: f64 = 0.0;
        for (fix, pose) in fixes.iter().zip(&poses).filter(|(fix, _)| fix.seen > 10) {
            worst = worst.max((fix.pose.offset - pose.offset).abs());
            assert!((fix.pose.yaw - pose.yaw).abs() < 0.1, "{fix:?}, {pose:?}");
        }
        assert!(worst < 0.6, "{worst:.2} m");
    }

    #[test]
    fn an_offset_and_a_yaw_are_fitted_from_edges() {
        let track = Track::named("lake").unwrap();
        let lens = SurveyLens::stock();
        let (moments, poses) = weaving(&track, &lens, 200.0, 40);
        for (moment, pose) in moments.iter().zip(&poses) {
            let fix = fit(&track, &lens, pose.s, moment);
            assert!((fix.pose.offset - pose.offset).abs() < 0.02, "{fix:?}, {pose:?}");
            assert!((fix.pose.yaw - pose.yaw).abs() < 0.003 && fix.residual < 0.3, "{fix:?}, {pose:?}");
        }
    }

    #[test]
    fn a_recording_that_stands_is_refused() {
        let track = Track::named("lake").unwrap();
        let standing = Sighting { at: 1.0, speed: 0.0, steering: 0.0, paved: false, edges: vec![] };
        let error = localise(&track, &SurveyLens::stock(), &[standing], None).unwrap_err();
        assert_eq!(error.to_string(), "recording: expected a drive of at least 100 m, got 0 m");
    }
}
