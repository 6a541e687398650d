//! A track seen from above, as a picture: the road with what stands along it, the start and the driving direction, and
//! a driven line coloured by speed.
//!
//! Up is Unity's +z, right its +x. By the path's ending the picture is an SVG or a PNG, painted by
//! [`drawing`](lapwing_score::drawing). The same data give the same bytes.

mod legend;
mod road;

use std::path::{Path, PathBuf};

use glam::DVec3;

use lapwing_core::car;
use lapwing_score::drawing::{
    Colour, DrawingError, INK, LETTER, LINE_PX, MARGIN, PAPER, Point, Shape, Sheet, SheetFormat,
};
use lapwing_sim::track::{Track, TrackFile};

/// A moment of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrivenPoint {
    /// Where the car was.
    pub position: DVec3,
    /// How fast, in miles per hour.
    pub speed_mph: f64,
}

/// Something that happened at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Where.
    pub position: DVec3,
    /// What.
    pub kind: MarkKind,
}

/// The kind of a mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MarkKind {
    /// The car hit something: a red cross.
    Crash,
    /// The car left the road: an orange diamond.
    OffRoad,
}

/// Why a map cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// A size that no map may have.
    #[error("{}: expected a map 400 to 8000 pixels wide, got {got}", path.display())]
    Size {
        /// The path.
        path: PathBuf,
        /// The width asked for.
        got: u32,
    },
    /// A name without a picture's extension, or a file that cannot be written.
    #[error(transparent)]
    Drawing(#[from] DrawingError),
}

/// Draws a map `width` pixels wide, and as high as the track requires, into a file ending in `.svg` or `.png`. The line
/// is in the order in which it was driven; where it jumps by more than [`car::PUT_M`] the car was put there and no line is drawn.
/// Positions that are not finite are skipped.
///
/// # Errors
/// [`MapError`]
pub fn draw(
    track: &Track,
    line: &[DrivenPoint],
    marks: &[Mark],
    path: impl AsRef<Path>,
    width: u32,
) -> Result<(), MapError> {
    let path = path.as_ref();
    SheetFormat::of(path)?;
    if !(400..=8000).contains(&width) {
        return Err(MapError::Size { path: path.to_owned(), got: width });
    }
    let line: Vec<DrivenPoint> =
        line.iter().filter(|d| d.position.is_finite() && d.speed_mph.is_finite()).copied().collect();
    let marks: Vec<Mark> = marks.iter().filter(|m| m.position.is_finite()).copied().collect();
    Ok(sheet(track, &line, &marks, f64::from(width)).write(path)?)
}

const CRASH: Colour = [0xd9, 0x04, 0x29];
const OFF_ROAD: Colour = [0xf7, 0x7f, 0x00];

/// From metres to pixels.
#[derive(Debug, Clone, Copy)]
struct MapScale {
    px_per_m: f64,
    /// The left and the top of the map, as x and z in metres.
    left: f64,
    top: f64,
    /// Pixels above the map.
    above: f64,
    /// Pixels left of the map.
    beside: f64,
}

impl MapScale {
    fn at(&self, p: DVec3) -> Point {
        (self.beside + (p.x - self.left) * self.px_per_m, self.above + (self.top - p.z) * self.px_per_m)
    }
}

fn sheet(track: &Track, line: &[DrivenPoint], marks: &[Mark], width: f64) -> Sheet {
    let title_px = 2.0 * LINE_PX;
    let room_px = 2.0 * LINE_PX; // for distances beside the road
    let seen = track.stations().iter().map(|s| s.position);
    let seen = seen.chain(line.iter().map(|d| d.position)).chain(marks.iter().map(|m| m.position));
    let (low, high) = seen.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    let beside_m = track.half_width() + 8.0;
    let (across, along) = (high.x - low.x + 2.0 * beside_m, high.z - low.z + 2.0 * beside_m);
    let inner = width - 2.0 * (MARGIN + room_px);
    let px_per_m = (inner / across).min(1.4 * inner / along);
    let scale = MapScale {
        px_per_m,
        left: low.x - beside_m,
        top: high.z + beside_m,
        above: MARGIN + title_px + room_px,
        beside: MARGIN + room_px + (inner - across * px_per_m) / 2.0,
    };
    let mut shapes = Vec::new();
    road::draw(track, &scale, &mut shapes);
    let fastest = fastest(line);
    drive(line, fastest, &scale, &mut shapes);
    road::start(track, &scale, &mut shapes);
    for mark in marks {
        symbol(mark.kind, scale.at(mark.position), &mut shapes);
    }
    let TrackFile { name, width_m, .. } = track.file();
    let title = format!("{name}: {:.0} m around, {width_m:.1} m wide", track.length());
    shapes.push(Shape::Text { at: (MARGIN, MARGIN + LINE_PX / 2.0), text: title.clone() });
    let below = scale.above + along * px_per_m + room_px;
    let height = legend::draw(track, (!line.is_empty()).then_some(fastest), marks, &scale, width, below, &mut shapes);
    Sheet { width, height: height.ceil(), title, shapes }
}

/// The speed at which the colours end: 30 mph, the stock car's, or more in tens if it was faster.
fn fastest(line: &[DrivenPoint]) -> f64 {
    line.iter().map(|d| (d.speed_mph / 10.0).ceil() * 10.0).fold(30.0, f64::max)
}

/// Colours that a driven line is drawn in.
const LEVELS: usize = 24;

/// From blue (slow) over green to red: easy to tell apart on dark asphalt.
fn speed_colour(level: usize) -> Colour {
    const STOPS: [Colour; 5] = [[75, 110, 255], [34, 211, 238], [74, 222, 100], [250, 215, 40], [255, 60, 50]];
    let at = level.min(LEVELS - 1) as f64 / (LEVELS - 1) as f64 * (STOPS.len() - 1) as f64;
    let i = (at as usize).min(STOPS.len() - 2);
    std::array::from_fn(|c| {
        let (from, to) = (f64::from(STOPS[i][c]), f64::from(STOPS[i + 1][c]));
        (from + (to - from) * (at - i as f64)).round() as u8
    })
}

/// The driven line, in pieces of one colour.
fn drive(line: &[DrivenPoint], fastest: f64, scale: &MapScale, shapes: &mut Vec<Shape>) {
    let width = (1.0 * scale.px_per_m).clamp(2.0, 6.0);
    let level = |d: &DrivenPoint| ((d.speed_mph / fastest).clamp(0.0, 1.0) * (LEVELS - 1) as f64).round() as usize;
    let mut piece: (usize, Vec<Point>) = (0, Vec::new());
    let mut last: Option<&DrivenPoint> = None;
    for here in line {
        let jumped = last.is_none_or(|last| last.position.distance(here.position) > car::PUT_M);
        if jumped || level(here) != piece.0 {
            // The next piece begins where this one ends.
            let joint = piece.1.last().copied().filter(|_| !jumped);
            let done = std::mem::replace(&mut piece, (level(here), joint.into_iter().collect()));
            if done.1.len() > 1 {
                shapes.push(Shape::Line { points: done.1, colour: speed_colour(done.0), width });
            }
        }
        piece.1.push(scale.at(here.position));
        last = Some(here);
    }
    if piece.1.len() > 1 {
        shapes.push(Shape::Line { points: piece.1, colour: speed_colour(piece.0), width });
    }
}

/// A mark at a place, with a pale rim that sets it off from what is under it.
fn symbol(kind: MarkKind, (x, y): Point, shapes: &mut Vec<Shape>) {
    const R: f64 = 7.0;
    match kind {
        MarkKind::Crash => {
            for (colour, width) in [(PAPER, 6.0), (CRASH, 3.0)] {
                for (dx, dy) in [(R, R), (R, -R)] {
                    shapes.push(Shape::Line { points: vec![(x - dx, y - dy), (x + dx, y + dy)], colour, width });
                }
            }
        }
        MarkKind::OffRoad => {
            for (colour, r) in [(PAPER, R + 3.0), (OFF_ROAD, R)] {
                shapes.push(Shape::Area { points: vec![(x, y - r), (x + r, y), (x, y + r), (x - r, y)], colour });
            }
        }
    }
}

#[cfg(test)]
mod tests;
