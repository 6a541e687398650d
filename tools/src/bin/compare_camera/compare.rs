//! Differences between a real picture and a rendered one of the same place.

use std::fmt;

use lapwing_core::perception::Frame;
use lapwing_sim::track::Track;
use lapwing_tools::survey::{Detector, Edges, Pose, SurveyLens};

/// Rows whose edges are compared.
pub const ROWS: [usize; 3] = [80, 100, 120];
/// Rows through which lines are fitted to the vanishing point.
const STRAIGHT_ROWS: [usize; 7] = [84, 86, 88, 90, 92, 94, 96];
/// Roads at most this curved, in 1/m, from here to 30 m ahead, have one.
const STRAIGHT: f64 = 0.003;
/// Areas whose colours are compared.
const PATCHES: [&str; 5] = ["sky, row 10", "sky, row 40", "road", "left verge", "right verge"];

/// The findings in a real and in a rendered picture of one place.
pub struct Pair {
    /// The edges in [`ROWS`], real and rendered.
    pub edges: [Vec<Edges>; 2],
    horizons: [Option<f64>; 2],
    colours: [[Option<[f64; 3]>; PATCHES.len()]; 2],
}

impl Pair {
    /// Analyses both pictures.
    pub fn new(track: &Track, lens: &SurveyLens, detector: Detector, pose: Pose, frames: [&Frame; 2]) -> Self {
        let straight = (0..=6).all(|i| track.at(pose.s + 5.0 * f64::from(i)).curvature.abs() < STRAIGHT);
        Self {
            edges: frames.map(|frame| detector.find(frame, &ROWS)),
            horizons: frames.map(|frame| straight.then(|| horizon(&detector.find(frame, &STRAIGHT_ROWS))).flatten()),
            colours: frames.map(|frame| {
                let verge = |side: f64| {
                    let [x, y] = lens.project_road(track, pose, pose.s + 9.0, side * (track.half_width() + 2.9))?;
                    let (x, y) = (x as isize, y as isize);
                    (x > 2 && x < 317).then(|| mean(frame, x - 2..x + 3, y - 1..y + 2, |_| true)).flatten()
                };
                let blue = |[r, _, b]: [f64; 3]| b > r + 20.0 && b > 90.0;
                [
                    mean(frame, 0..320, 10..11, blue),
                    mean(frame, 0..320, 40..41, blue),
                    mean(frame, 110..210, 104..128, |_| true),
                    verge(-1.0),
                    verge(1.0),
                ]
            }),
        }
    }
}

/// The row at which straight lines through both edges meet.
fn horizon(edges: &[Edges]) -> Option<f64> {
    let line = |side: usize| {
        let points: Vec<(f64, f64)> = STRAIGHT_ROWS
            .iter()
            .zip(edges)
            .filter_map(|(&row, edges)| Some((row as f64 + 0.5, edges[side]?)))
            .collect();
        let n = points.len() as f64;
        let (row, column) = points.iter().fold((0.0, 0.0), |(r, c), p| (r + p.0 / n, c + p.1 / n));
        let (over, under) = points
            .iter()
            .fold((0.0, 0.0), |(o, u), p| (o + (p.0 - row) * (p.1 - column), u + (p.0 - row) * (p.0 - row)));
        let slope = over / under;
        let bent = points.iter().map(|p| (p.1 - column - slope * (p.0 - row)).abs()).fold(0.0, f64::max);
        (points.len() >= 6 && bent < 3.0).then_some((slope, column - slope * row))
    };
    let ((a, b), (c, d)) = (line(0)?, line(1)?);
    Some((d - b) / (a - c))
}

fn mean(
    frame: &Frame,
    columns: std::ops::Range<isize>,
    rows: std::ops::Range<isize>,
    counts: impl Fn([f64; 3]) -> bool,
) -> Option<[f64; 3]> {
    let mut sum = [0.0; 3];
    let mut count = 0.0;
    for (y, x) in rows.flat_map(|y| columns.clone().map(move |x| (y, x))) {
        let Some(pixel) = frame.pixel(usize::try_from(x).ok()?, usize::try_from(y).ok()?) else { continue };
        let pixel = pixel.map(f64::from);
        if counts(pixel) {
            count += 1.0;
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += value;
            }
        }
    }
    (count > 0.0).then(|| sum.map(|s| s / count))
}

/// The differences of all pictures.
#[derive(Default)]
pub struct CameraComparison {
    /// Rendered minus real column, by row and side.
    shifts: [[Vec<f64>; 2]; ROWS.len()],
    /// Edges seen in only the real, only the rendered picture.
    lone: [[[usize; 2]; 2]; ROWS.len()],
    horizons: [Vec<f64>; 2],
    colours: [[Vec<[f64; 3]>; PATCHES.len()]; 2],
}

impl CameraComparison {
    /// Adds one place.
    pub fn add(&mut self, pair: &Pair) {
        for row in 0..ROWS.len() {
            for side in 0..2 {
                match (pair.edges[0][row][side], pair.edges[1][row][side]) {
                    (Some(real), Some(rendered)) => self.shifts[row][side].push(rendered - real),
                    (Some(_), None) => self.lone[row][side][0] += 1,
                    (None, Some(_)) => self.lone[row][side][1] += 1,
                    (None, None) => {}
                }
            }
        }
        // Only places where both are found: the horizon moves with the road's slope.
        if let [Some(real), Some(rendered)] = pair.horizons {
            self.horizons[0].push(real);
            self.horizons[1].push(rendered);
        }
        for which in 0..2 {
            for (all, colour) in self.colours[which].iter_mut().zip(pair.colours[which]) {
                all.extend(colour);
            }
        }
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

impl fmt::Display for CameraComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "road edges, columns between real and rendered (shift: rendered to the right)")?;
        writeln!(f, "row  side   both seen  only real  only rendered   mean  median  median shift")?;
        let mut all = Vec::new();
        for (row, (shifts, lone)) in ROWS.iter().zip(self.shifts.iter().zip(&self.lone)) {
            for (side, name) in ["left", "right"].into_iter().enumerate() {
                let shifts = &shifts[side];
                let mean = shifts.iter().map(|s| s.abs()).sum::<f64>() / shifts.len() as f64;
                writeln!(
                    f,
                    "{row:3}  {name:5} {:10} {:10} {:14} {mean:6.2} {:7.2} {:+13.2}",
                    shifts.len(),
                    lone[side][0],
                    lone[side][1],
                    median(shifts.iter().map(|s| s.abs())),
                    median(shifts.iter().copied())
                )?;
                all.extend(shifts.iter().map(|s| s.abs()));
            }
        }
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        writeln!(f, "all        {:10} {:>32.2} {:7.2}", all.len(), mean, median(all.iter().copied()))?;
        for (name, horizons) in ["real", "rendered"].into_iter().zip(&self.horizons) {
            let row = median(horizons.iter().copied());
            writeln!(f, "horizon of the {name} road: row {row:.1} ({} straight places)", horizons.len())?;
        }
        for (i, patch) in PATCHES.into_iter().enumerate() {
            write!(f, "{patch:12}")?;
            for (name, colours) in ["real", "rendered"].into_iter().zip(&self.colours) {
                let [r, g, b] = [0, 1, 2].map(|c| median(colours[i].iter().map(|colour| colour[c])));
                write!(f, "  {name} {r:3.0} {g:3.0} {b:3.0} ({})", colours[i].len())?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}
