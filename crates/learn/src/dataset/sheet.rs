//! The contact sheet: pictures over the drive, with the recorded steering.

use super::{DatasetError, Inspection, chart};
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    recording::{Moment, Recording},
    words::count,
};
use lapwing_score::drawing::{Colour, INK, LINE_PX, MARGIN, PAPER, Point, Shape, Sheet};

/// Pictures of each data set on a contact sheet.
pub const SHOWN: usize = 24;

/// Pictures side by side.
pub(super) const ACROSS: usize = 4;
/// Largest picture, in pixels: the stock camera's. Larger ones are shown smaller.
pub(super) const PICTURE: (usize, usize) = (320, 160);
/// Between pictures, in pixels.
pub(super) const GAP: f64 = 8.0;
/// How far the arrow leans at full lock, in degrees: more than the wheels, whose 25 degrees are hard to see.
const LEAN_DEG: f64 = 60.0;
/// How long it is, in pixels.
const ARROW: f64 = 60.0;
const ARROW_COLOUR: Colour = [0xff, 0xb0, 0x00];

/// Pictures of the centre camera, [`SHOWN`] of each data set at equal distances over its drive, each with its row,
/// time, speed and steering; an arrow leans by 60 degrees at full lock. A missing or broken one leaves an empty place.
///
/// # Errors
/// [`DatasetError::Recording`] if the log or the run can no longer be read.
pub fn contact_sheet(inspections: &[Inspection]) -> Result<Sheet, DatasetError> {
    let mut shapes = Vec::new();
    let mut y = MARGIN;
    let (wide, high) = (PICTURE.0 as f64 + GAP, PICTURE.1 as f64 + LINE_PX + GAP);
    for inspection in inspections {
        let name = chart::name(inspection);
        let text =
            format!("{name}: {}, {:.1} s; arrow: steering", count(inspection.rows, "row"), inspection.duration_s);
        shapes.push(Shape::Text { at: (MARGIN, y + LINE_PX / 2.0), text });
        y += 1.5 * LINE_PX;
        let chosen = chosen(usize::try_from(inspection.rows).unwrap_or(usize::MAX));
        let mut wanted = chosen.iter().copied().peekable();
        let mut shown = 0;
        for moment in Recording::open(&inspection.path)? {
            // The inspection reports messages that cannot be read.
            let Ok(moment) = moment else { continue };
            if wanted.next_if_eq(&moment.row).is_some() {
                let left = MARGIN + wide * (shown % ACROSS) as f64;
                place(&moment, (left, y + high * (shown / ACROSS) as f64), &mut shapes);
                shown += 1;
            }
            if wanted.peek().is_none() {
                break;
            }
        }
        y += high * chosen.len().div_ceil(ACROSS) as f64 + LINE_PX / 2.0;
    }
    let width = 2.0 * MARGIN + wide * ACROSS as f64 - GAP;
    Ok(Sheet { width, height: (y + MARGIN - GAP).ceil(), title: "Contact sheet".into(), shapes })
}

/// Rows at equal distances, the first and the last among them.
fn chosen(rows: usize) -> Vec<usize> {
    let (last, count) = (rows.saturating_sub(1), rows.min(SHOWN));
    (0..count).map(|i| if count > 1 { i * last / (count - 1) } else { 0 }).collect()
}

fn place(moment: &Moment, (left, top): Point, shapes: &mut Vec<Shape>) {
    let (width, height) = (PICTURE.0 as f64, PICTURE.1 as f64);
    let mut frame = Frame::default();
    let decoded = match &moment.pictures[0] {
        Some(picture) => picture.read().is_ok_and(|bytes| decode_jpeg(&bytes, &mut frame).is_ok()),
        None => false,
    };
    match decoded {
        true => shapes.push(Shape::Picture { at: (left, top), frame: fitted(frame) }),
        false => {
            shapes.push(Shape::rectangle((left, top), (left + width, top + height), [0xdd, 0xd8, 0xcc]));
            shapes.push(Shape::text((left + width / 2.0, top + height / 2.0), 0.5, "missing or broken"));
        }
    }
    let steered = match moment.steering() {
        Some(steering) => {
            arrow((left + width / 2.0, top + height - 10.0), steering.get(), shapes);
            format!("{:+.3}", steering.get())
        }
        None => "nobody steers".to_owned(),
    };
    let (row, at_s, mph) = (moment.row, moment.at.as_secs_f64(), moment.telemetry.speed.get());
    let text = format!("row {row}  {at_s:.1} s  {mph:.1} mph  {steered}");
    shapes.push(Shape::Text { at: (left, top + height + LINE_PX / 2.0), text });
}

/// Draws an arrow upwards from a place, leaning towards the steering, with a rim that sets it off from the picture.
pub(super) fn arrow((x, y): Point, steering: f64, shapes: &mut Vec<Shape>) {
    let (sin, cos) = (steering * LEAN_DEG).to_radians().sin_cos();
    let turned = |along: f64, across: f64| (x + along * sin + across * cos, y - along * cos + across * sin);
    for (colour, rim) in [(INK, 2.0), (PAPER, 0.5), (ARROW_COLOUR, 0.0)] {
        let half = 2.5 + rim;
        let points = vec![
            turned(-rim, -half),
            turned(ARROW - 18.0 - rim, -half),
            turned(ARROW - 18.0 - rim, -8.0 - 1.6 * rim),
            turned(ARROW + 1.6 * rim, 0.0),
            turned(ARROW - 18.0 - rim, 8.0 + 1.6 * rim),
            turned(ARROW - 18.0 - rim, half),
            turned(-rim, half),
        ];
        shapes.push(Shape::Area { points, colour });
    }
}

/// A picture no larger than its place: a larger one is reduced to every n-th pixel.
pub(super) fn fitted(frame: Frame) -> Frame {
    let step = frame.width().div_ceil(PICTURE.0).max(frame.height().div_ceil(PICTURE.1));
    if step <= 1 {
        return frame;
    }
    let (width, height) = (frame.width() / step, frame.height() / step);
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (x * step, y * step)));
    let rgb = places.flat_map(|(x, y)| frame.pixel(x, y).unwrap_or_default()).collect();
    Frame::new(width, height, rgb).unwrap_or(frame)
}

#[cfg(test)]
mod tests;
