//! Where everything of a chart stands.

use super::{
    super::{Colour, INK, LETTER, LINE_PX, MARGIN, PAPER, Point, Shape, width_of},
    Chart, Marks, Series,
    axis::Scale,
};

/// Told apart by colour-blind people, too: Okabe and Ito (2008), the yellow left out, which is too pale on paper.
const PALETTE: [Colour; 7] = [
    [0x00, 0x72, 0xb2],
    [0xd5, 0x5e, 0x00],
    [0x00, 0x9e, 0x73],
    [0xcc, 0x79, 0xa7],
    [0x56, 0xb4, 0xe9],
    INK,
    [0xe6, 0x9f, 0x00],
];
/// Lines at the ticks, across the chart.
const GRID: Colour = [0xdd, 0xd8, 0xcc];
/// From an axis to the words at it, in pixels.
const APART: f64 = 6.0;
/// Least pixels from tick to tick, across and up.
const TICK: Point = (84.0, 40.0);
/// Half the side of a dot, in pixels; and where they are few.
const DOT: f64 = 1.5;
const BIG_DOT: f64 = 4.0;
const FEW: usize = 50;

/// The room between the axes, in pixels, and their scales.
struct Field {
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
    x: Scale,
    y: Scale,
}

impl Field {
    /// Where a pair of numbers is drawn: outside of a given range, at the rim.
    fn at(&self, (x, y): Point) -> Point {
        let across = self.x.share(x).clamp(0.0, 1.0);
        let up = self.y.share(y).clamp(0.0, 1.0);
        (self.left + (self.right - self.left) * across, self.bottom - (self.bottom - self.top) * up)
    }
}

/// Draws a chart of that size, `down` pixels from the sheet's top.
pub(super) fn draw(chart: &Chart, (width, height): Point, down: f64, shapes: &mut Vec<Shape>) {
    let points: Vec<Point> = chart.series.iter().flat_map(|series| series.marks.points()).collect();
    let x = chart.x.scale(points.iter().map(|p| p.0));
    // Bars stand on zero.
    let stands = chart.series.iter().any(|series| matches!(series.marks, Marks::Bars { .. }));
    let y = chart.y.scale(points.iter().map(|p| p.1).chain(stands.then_some(0.0)));
    let top = down + MARGIN + 2.0 * LINE_PX + APART;
    let bottom = down + height - MARGIN - 2.0 * LINE_PX - APART;
    let y_ticks = y.ticks(((bottom - top) / TICK.1).max(1.0));
    let widest = y_ticks.iter().map(|(_, text)| width_of(text)).fold(3.0 * LETTER, f64::max);
    let field = Field { left: MARGIN + widest + APART, top, right: width - MARGIN, bottom, x, y };

    shapes.push(Shape::Text { at: (MARGIN, down + MARGIN), text: chart.title.clone() });
    shapes.push(Shape::Text { at: (MARGIN, down + MARGIN + 1.25 * LINE_PX), text: chart.y.label.clone() });
    for (at, text) in &y_ticks {
        let (_, y) = field.at((field.x.from, *at));
        shapes.push(line(vec![(field.left, y), (field.right, y)], GRID, 1.0));
        shapes.push(Shape::text((field.left - APART, y), 1.0, text.clone()));
    }
    for (at, text) in field.x.ticks(((field.right - field.left) / TICK.0).max(1.0)) {
        let (x, _) = field.at((at, field.y.from));
        shapes.push(line(vec![(x, field.top), (x, field.bottom)], GRID, 1.0));
        // The last is kept on the sheet.
        let left = (width_of(&text) / 2.0).max(x + width_of(&text) - width + 2.0) / width_of(&text).max(1.0);
        shapes.push(Shape::text((x, field.bottom + APART + LINE_PX / 2.0), left, text));
    }
    let middle = (field.left + field.right) / 2.0;
    shapes.push(Shape::text((middle, field.bottom + APART + 2.0 * LINE_PX), 0.5, chart.x.label.clone()));

    let mut palette = PALETTE.into_iter().cycle();
    let colours: Vec<Colour> =
        chart.series.iter().map(|series| series.colour.or_else(|| palette.next()).unwrap_or(INK)).collect();
    for (series, colour) in chart.series.iter().zip(&colours) {
        marks(&series.marks, *colour, &field, shapes);
    }
    let corners = vec![(field.left, field.top), (field.left, field.bottom), (field.right, field.bottom)];
    shapes.push(line(corners, INK, 1.5));
    legend(&chart.series, &colours, (field.right, down + MARGIN + 1.25 * LINE_PX), shapes);
}

fn line(points: Vec<Point>, colour: Colour, width: f64) -> Shape {
    Shape::Line { points, colour, width }
}

fn marks(marks: &Marks, colour: Colour, field: &Field, shapes: &mut Vec<Shape>) {
    let shown = |(x, y): &Point| x.is_finite() && y.is_finite();
    match marks {
        Marks::Line(points) => {
            for piece in points.split(|point| !shown(point)).filter(|piece| !piece.is_empty()) {
                let mut points: Vec<Point> = piece.iter().map(|point| field.at(*point)).collect();
                if let [(x, y)] = points[..] {
                    // A single point between two gaps is to be seen, too.
                    points = vec![(x - DOT, y), (x + DOT, y)];
                }
                shapes.push(line(points, colour, 2.0));
            }
        }
        Marks::Points(points) => {
            let dot = if points.len() <= FEW { BIG_DOT } else { DOT };
            for (x, y) in points.iter().filter(|point| shown(point)).map(|point| field.at(*point)) {
                shapes.push(Shape::rectangle((x - dot, y - dot), (x + dot, y + dot), colour));
            }
        }
        Marks::Bars { from, width, heights } => {
            for (i, height) in heights.iter().enumerate() {
                let begin = from + width * i as f64;
                let outside = begin + width <= field.x.from || begin >= field.x.to;
                if outside || !shown(&(begin + width / 2.0, *height)) || *height == 0.0 {
                    continue;
                }
                let (left, top) = field.at((begin, *height));
                let (right, bottom) = field.at((begin + width, 0.0));
                // A little of the paper is left between bars.
                let gap = if right - left > 4.0 { 1.0 } else { 0.0 };
                shapes.push(Shape::rectangle((left, top), (right - gap, bottom), colour));
                if *height > field.y.to {
                    cut((left, right - gap, field.top), &format!("{height:.1}"), field, shapes);
                }
            }
        }
    }
}

/// A gap near a bar's top, and how high it really is.
fn cut((left, right, top): (f64, f64, f64), height: &str, field: &Field, shapes: &mut Vec<Shape>) {
    let tooth = |x: f64, y: f64| (x, top + 14.0 + y);
    shapes.push(line(vec![tooth(left - 2.0, 3.0), tooth(right + 2.0, -3.0)], PAPER, 4.0));
    let beside = right + APART;
    let fits = beside + width_of(height) < field.right;
    let (x, share) = if fits { (beside, 0.0) } else { (left - APART, 1.0) };
    shapes.push(Shape::text((x, top + LINE_PX / 2.0), share, height));
}

/// Names with their colours in one line that ends at a place. One series alone needs none.
fn legend(series: &[Series], colours: &[Colour], (right, y): Point, shapes: &mut Vec<Shape>) {
    let named: Vec<_> = series.iter().zip(colours).filter(|(series, _)| !series.name.is_empty()).collect();
    let mut x = right - named.iter().map(|(series, _)| width_of(&series.name) + 5.0 * LETTER).sum::<f64>();
    for (series, colour) in named.iter().filter(|_| named.len() > 1) {
        x += 2.0 * LETTER;
        shapes.push(Shape::rectangle((x, y - 5.0), (x + 2.0 * LETTER, y + 5.0), **colour));
        x += 3.0 * LETTER;
        shapes.push(Shape::Text { at: (x, y), text: series.name.clone() });
        x += width_of(&series.name);
    }
}
