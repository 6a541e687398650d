//! A sheet as SVG text.

use std::fmt::Write;

use base64::{Engine, prelude::BASE64_STANDARD};

use super::{Colour, INK, LINE_PX, PAPER, PaintError, Point, Shape, Sheet, png, width_of};

/// The whole file, or why it cannot be painted.
pub(super) fn paint(sheet: &Sheet) -> Result<String, PaintError> {
    // Pictures are encoded first, as nothing else can fail.
    let mut pictures = Vec::new();
    for shape in &sheet.shapes {
        if let Shape::Picture { frame, .. } = shape {
            let png = png::encode(frame.rgb(), frame.width() as u32, frame.height() as u32)?;
            pictures.push(BASE64_STANDARD.encode(png));
        }
    }
    let mut svg = String::new();
    write(sheet, pictures.into_iter(), &mut svg)?;
    Ok(svg)
}

fn write(sheet: &Sheet, mut pictures: impl Iterator<Item = String>, svg: &mut String) -> std::fmt::Result {
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
            // Whatever the reader's font is, the text fits the room that was left for it.
            Shape::Text { at: (x, y), text } => writeln!(
                svg,
                r#"<text x="{x:.1}" y="{:.1}" textLength="{:.0}">{}</text>"#,
                y + 0.3 * LINE_PX,
                width_of(text),
                escaped(text)
            )?,
            Shape::Picture { at: (x, y), frame } => writeln!(
                svg,
                r#"<image x="{x:.1}" y="{y:.1}" width="{}" height="{}" href="data:image/png;base64,{}"/>"#,
                frame.width(),
                frame.height(),
                pictures.next().unwrap_or_default()
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
