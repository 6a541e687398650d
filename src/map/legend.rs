//! The legend of a map: its colours, marks and scale.

use super::{INK, LETTER, LEVELS, LINE_PX, MARGIN, MapScale, Mark, MarkKind, Shape, road, speed_colour, symbol};
use lapwing_sim::track::{Side, Track};

/// Between two rows, in pixels.
const ROW: f64 = 1.75 * LINE_PX;

/// Draws the legend from `top` down, and returns where the sheet ends.
pub(super) fn draw(
    track: &Track,
    fastest: Option<f64>,
    marks: &[Mark],
    scale: &MapScale,
    width: f64,
    top: f64,
    shapes: &mut Vec<Shape>,
) -> f64 {
    let y = top + LINE_PX / 2.0;
    scale_bar(scale, (width - MARGIN, y), shapes);
    let mut row = LegendRow { x: MARGIN, y, right: width - MARGIN, shapes };
    if let Some(fastest) = fastest {
        row.text("0");
        for level in 0..LEVELS {
            let x = row.x + level as f64 * 6.0;
            let points = vec![(x, y - 6.0), (x + 6.5, y - 6.0), (x + 6.5, y + 6.0), (x, y + 6.0)];
            row.shapes.push(Shape::Area { points, colour: speed_colour(level) });
        }
        row.x += LEVELS as f64 * 6.0 + LETTER;
        row.text(&format!("{fastest:.0} mph"));
    }
    row.x = MARGIN;
    row.y += ROW;
    let stations = track.stations();
    for edge in road::EDGES {
        let has = |s: f64| [Side::Left, Side::Right].iter().any(|side| track.file().has(edge, *side, s));
        if stations.iter().any(|station| has(station.s)) {
            let (colour, _, name) = road::look(edge);
            row.make_room(name);
            let (x, y) = (row.x, row.y);
            row.shapes.push(Shape::Line { points: vec![(x, y), (x + 18.0, y)], colour, width: 8.0 });
            row.x += 18.0 + LETTER;
            row.text(name);
        }
    }
    for (kind, name) in [(MarkKind::Crash, "crash"), (MarkKind::OffRoad, "off the road")] {
        let count = marks.iter().filter(|m| m.kind == kind).count();
        if count > 0 {
            let text = format!("{name} ({count})");
            row.make_room(&text);
            symbol(kind, (row.x + 8.0, row.y), row.shapes);
            row.x += 18.0 + LETTER;
            row.text(&text);
        }
    }
    row.y + LINE_PX / 2.0 + MARGIN
}

/// A row of the legend, written from left to right.
struct LegendRow<'a> {
    x: f64,
    y: f64,
    /// The right end of the room.
    right: f64,
    shapes: &'a mut Vec<Shape>,
}

impl LegendRow<'_> {
    /// Moves to the next row if a symbol with this text would not fit.
    fn make_room(&mut self, text: &str) {
        if self.x > MARGIN && self.x + 18.0 + (text.len() as f64 + 1.0) * LETTER > self.right {
            self.x = MARGIN;
            self.y += ROW;
        }
    }

    fn text(&mut self, text: &str) {
        self.shapes.push(Shape::Text { at: (self.x, self.y), text: text.into() });
        self.x += (text.len() as f64 + 2.0) * LETTER;
    }
}

/// A bar of a round length, at most a quarter of the sheet, that ends at a place.
fn scale_bar(scale: &MapScale, (right, y): super::Point, shapes: &mut Vec<Shape>) {
    let longest = right / 4.0 / scale.px_per_m;
    let lengths = [1000.0, 500.0, 200.0, 100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0];
    let length = lengths.into_iter().find(|length| *length <= longest).unwrap_or(1.0);
    let text = format!("{length:.0} m");
    let text_left = right - text.len() as f64 * LETTER;
    shapes.push(Shape::Text { at: (text_left, y), text });
    let (from, to) = (text_left - LETTER - length * scale.px_per_m, text_left - LETTER);
    for points in [vec![(from, y), (to, y)], vec![(from, y - 5.0), (from, y + 5.0)], vec![(to, y - 5.0), (to, y + 5.0)]]
    {
        shapes.push(Shape::Line { points, colour: INK, width: 2.0 });
    }
}
