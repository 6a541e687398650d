//! A map as SVG text.

use std::fmt::{Error, Write};

use super::{Colour, INK, LETTER, LINE_PX, PAPER, Point, Shape, Sheet};

/// The whole file.
pub(super) fn paint(sheet: &Sheet) -> String {
    let mut svg = String::new();
    write(sheet, &mut svg).expect("writing to a String cannot fail");
    svg
}

fn write(sheet: &Sheet, svg: &mut String) -> Result<(), Error> {
    let Sheet { width, height, title, shapes } = sheet;
    writeln!(
        svg,
        r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}">"#
    )?;
    writeln!(svg, "<title>{}</title>", escaped(title))?;
    writeln!(
        svg,
        "<style>polyline{{fill:none;stroke-linejoin:round}}text{{font:13px monospace;fill:{}}}</style>",
        hex(INK)
    )?;
    writeln!(svg, r#"<rect width="100%" height="100%" fill="{}"/>"#, hex(PAPER))?;
    for shape in shapes {
        match shape {
            Shape::Area { points, colour } => {
                writeln!(svg, r#"<polygon points="{}" fill="{}"/>"#, list(points), hex(*colour))?;
            }
            Shape::Line { points, colour, width } => writeln!(
                svg,
                r#"<polyline points="{}" stroke="{}" stroke-width="{width:.2}"/>"#,
                list(points),
                hex(*colour)
            )?,
            // Whatever the reader's font is, the text takes the room that was left for it.
            Shape::Text { at: (x, y), text } => writeln!(
                svg,
                r#"<text x="{x:.1}" y="{:.1}" textLength="{:.0}">{}</text>"#,
                y + 0.3 * LINE_PX,
                text.chars().count() as f64 * LETTER,
                escaped(text)
            )?,
        }
    }
    svg.write_str("</svg>\n")
}

fn hex([r, g, b]: Colour) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn list(points: &[Point]) -> String {
    points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
