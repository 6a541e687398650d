//! Colours and grain in parts of the pictures, and the road's cross-section.

use std::{fmt, ops::Range};

use glam::DVec3;
use lapwing_core::perception::Frame;
use lapwing_sim::{
    camera::{Camera, RIDE_M},
    track::Track,
};
use lapwing_tools::survey::{self, SurveyLens};

use crate::pairs::Pair;

/// Parts of the picture: name, columns, rows.
const PARTS: [(&str, Range<usize>, Range<usize>); 6] = [
    ("sky", 0..320, 0..20),
    ("skyline", 0..320, 36..58),
    ("road, 12 m ahead", 130..190, 76..84),
    ("road, 6 m ahead", 115..205, 90..100),
    ("road, 3 m ahead", 100..220, 110..132),
    ("bonnet", 130..190, 142..150),
];

/// Metres from the road's edge, positive outward, at which the cross-section is told.
const FROM_EDGE_M: (f64, f64) = (-3.2, 3.2);
const STEP_M: f64 = 0.2;
/// Metres ahead at which it is looked at.
const AHEAD_M: [f64; 4] = [5.5, 6.5, 7.5, 8.5];

/// Grey level of a colour (ITU-R BT.601, as JPEG has it).
fn grey([r, g, b]: [u8; 3]) -> f64 {
    0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)
}

/// Mean colour; standard deviation of the grey levels; mean difference of neighbours across and down.
type Part = [f64; 6];

fn part(frame: &Frame, columns: &Range<usize>, rows: &Range<usize>) -> Part {
    let at = |x: usize, y: usize| frame.pixel(x, y).unwrap_or_default();
    let (mut colour, mut sum, mut squares, mut across, mut down) = ([0.0; 3], 0.0, 0.0, 0.0, 0.0);
    for (y, x) in rows.clone().flat_map(|y| columns.clone().map(move |x| (y, x))) {
        let pixel = at(x, y);
        let here = grey(pixel);
        for (colour, c) in colour.iter_mut().zip(pixel) {
            *colour += f64::from(c);
        }
        sum += here;
        squares += here * here;
        across += (grey(at(x + 1, y)) - here).abs();
        down += (grey(at(x, y + 1)) - here).abs();
    }
    let n = (columns.len() * rows.len()) as f64;
    let deviation = (squares / n - (sum / n).powi(2)).max(0.0).sqrt();
    [colour[0] / n, colour[1] / n, colour[2] / n, deviation, across / n, down / n]
}

/// The figures of real and drawn pictures: medians over the places.
pub struct Figures {
    parts: Vec<[Part; 2]>,
    /// Metres from the road's edge, and the colours there: of the left and of the right edge, real and drawn.
    section: Vec<(f64, [[[f64; 3]; 2]; 2])>,
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

impl Figures {
    /// Measures all pictures.
    pub fn of(track: &Track, pairs: &[Pair]) -> Self {
        let parts = PARTS.iter().map(|(_, columns, rows)| {
            [0, 1].map(|kind| {
                let all: Vec<Part> = pairs.iter().map(|pair| part(&pair.frames[kind], columns, rows)).collect();
                std::array::from_fn(|i| median(all.iter().map(|part| part[i]).collect()))
            })
        });
        let mount = Camera::CENTER.mount;
        let position = mount.position + DVec3::Y * RIDE_M;
        let lens = SurveyLens::new(mount.pitch_deg, mount.yaw_deg, mount.roll_deg, position);
        let steps = ((FROM_EDGE_M.1 - FROM_EDGE_M.0) / STEP_M).round() as usize;
        let section = (0..=steps).map(|i| {
            let from_edge_m = FROM_EDGE_M.0 + i as f64 * STEP_M;
            let sides = [-1.0, 1.0].map(|side| {
                let places: Vec<(usize, [usize; 2])> = pairs
                    .iter()
                    .enumerate()
                    .flat_map(|(k, pair)| seen(&lens, track, pair, side, from_edge_m).map(move |at| (k, at)))
                    .collect();
                [0, 1].map(|kind| {
                    std::array::from_fn(|c| {
                        let of = |&(k, [x, y]): &(usize, [usize; 2])| {
                            f64::from(pairs[k].frames[kind].pixel(x, y).unwrap_or_default()[c])
                        };
                        median(places.iter().map(of).collect())
                    })
                })
            });
            (from_edge_m, sides)
        });
        Self { parts: parts.collect(), section: section.collect() }
    }
}

/// The pixels that show places beside the road, on the car's left (-1) or right (1).
fn seen(
    lens: &SurveyLens,
    track: &Track,
    pair: &Pair,
    side: f64,
    from_edge_m: f64,
) -> impl Iterator<Item = [usize; 2]> {
    let pose = survey::Pose { s: pair.pose.s_m, offset: pair.pose.offset_m, yaw: pair.pose.heading_rad };
    let direction = pair.pose.direction();
    let beside = direction * side * (track.half_width() + from_edge_m);
    AHEAD_M.iter().filter_map(move |ahead| {
        let [x, y] = lens.project_road(track, pose, pose.s + direction * ahead, beside)?;
        ((0.0..320.0).contains(&x) && (0.0..134.0).contains(&y)).then_some([x as usize, y as usize])
    })
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "part of the picture       red green  blue   deviation  across   down (medians)")?;
        for ((name, ..), both) in PARTS.iter().zip(&self.parts) {
            for (kind, [r, g, b, deviation, across, down]) in ["real", "drawn"].into_iter().zip(both) {
                writeln!(f, "{name:17} {kind:6} {r:5.0} {g:5.0} {b:5.0} {deviation:11.1} {across:7.1} {down:6.1}")?;
            }
        }
        writeln!(f, "metres from the road's edge   left: real, drawn              right: real, drawn (medians)")?;
        for (from_edge_m, sides) in &self.section {
            write!(f, "{from_edge_m:26.1} ")?;
            for [r, g, b] in sides.as_flattened() {
                write!(f, "  {r:4.0} {g:4.0} {b:4.0}")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}
