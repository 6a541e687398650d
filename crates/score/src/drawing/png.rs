//! A sheet as pixels.

use image::{ExtendedColorType::Rgb8, ImageEncoder, codecs::png::PngEncoder};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster};
use tiny_skia::{Color, FillRule, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform};

use super::{Colour, INK, LETTER, LINE_PX, MAX_SIDE, PAPER, PaintError, Point, Shape, Sheet};
use lapwing_core::perception::Frame;

/// The whole file, or why it cannot be painted.
pub(super) fn paint(sheet: &Sheet) -> Result<Vec<u8>, PaintError> {
    let frame = pixels(sheet)?;
    encode(frame.rgb(), frame.width() as u32, frame.height() as u32)
}

/// The pixels alone.
pub(super) fn pixels(sheet: &Sheet) -> Result<Frame, PaintError> {
    let (width, height) = (sheet.width as u32, sheet.height as u32);
    let fits = sheet.width <= MAX_SIDE && sheet.height <= MAX_SIDE;
    let mut pixels = fits.then(|| Pixmap::new(width, height)).flatten().ok_or(PaintError::Size { width, height })?;
    pixels.fill(colour(PAPER));
    for shape in &sheet.shapes {
        match shape {
            Shape::Area { points, colour } => {
                if let Some(path) = path(points, true) {
                    pixels.fill_path(&path, &ink(*colour), FillRule::Winding, Transform::identity(), None);
                }
            }
            Shape::Line { points, colour, width } => {
                if let Some(path) = path(points, false) {
                    let stroke = Stroke { width: *width as f32, line_join: LineJoin::Round, ..Stroke::default() };
                    pixels.stroke_path(&path, &ink(*colour), &stroke, Transform::identity(), None);
                }
            }
            Shape::Text { at, text } => letters(&mut pixels, *at, text),
            Shape::Picture { at, frame } => picture(&mut pixels, *at, frame),
        }
    }
    // The paper is opaque, so no pixel is transparent.
    let rgb: Vec<u8> = pixels.pixels().iter().flat_map(|p| [p.red(), p.green(), p.blue()]).collect();
    Frame::new(width as usize, height as usize, rgb).ok_or(PaintError::Size { width, height })
}

/// Rows of red, green and blue bytes as a PNG file.
pub(super) fn encode(rgb: &[u8], width: u32, height: u32) -> Result<Vec<u8>, PaintError> {
    let mut png = Vec::new();
    PngEncoder::new(&mut png).write_image(rgb, width, height, Rgb8)?;
    Ok(png)
}

fn colour([r, g, b]: Colour) -> Color {
    Color::from_rgba8(r, g, b, 255)
}

fn ink(of: Colour) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color(colour(of));
    paint
}

/// `None` if the points make no path.
fn path(points: &[Point], closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for (i, (x, y)) in points.iter().enumerate() {
        if i == 0 {
            path.move_to(*x as f32, *y as f32);
        } else {
            path.line_to(*x as f32, *y as f32);
        }
    }
    if closed {
        path.close();
    }
    path.finish()
}

fn letters(pixels: &mut Pixmap, at: Point, text: &str) {
    let size = (pixels.width() as usize, pixels.height() as usize);
    inked(size, at, text, |pixel, ink| blend(&mut pixels.data_mut()[4 * pixel..4 * pixel + 3], INK, ink));
}

/// Words in a colour on a picture.
pub(super) fn write_on(frame: &mut Frame, at: Point, text: &str, colour: Colour) {
    let size = (frame.width(), frame.height());
    let rgb = frame.rgb_mut();
    inked(size, at, text, |pixel, ink| blend(&mut rgb[3 * pixel..3 * pixel + 3], colour, ink));
}

/// A pixel of red, green and blue under so much ink, of 255.
fn blend(pixel: &mut [u8], colour: Colour, ink: u8) {
    for (channel, of) in pixel.iter_mut().zip(colour) {
        let share = u32::from(ink);
        *channel = ((u32::from(of) * share + u32::from(*channel) * (255 - share)) / 255) as u8;
    }
}

/// Letters are rasterised already: their grey level is the amount of ink. Calls `draw` with each pixel's index and ink.
fn inked((width, height): (usize, usize), (x, y): Point, text: &str, mut draw: impl FnMut(usize, u8)) {
    for (i, letter) in text.chars().enumerate() {
        let raster = |letter| get_raster(letter, FontWeight::Regular, RasterHeight::Size16);
        let Some(raster) = raster(letter).or_else(|| raster('?')) else { continue };
        let (left, top) = ((x + i as f64 * LETTER).round(), (y - LINE_PX / 2.0).round());
        for (row, intensities) in raster.raster().iter().enumerate() {
            for (column, ink) in intensities.iter().enumerate() {
                let (x, y) = (left + column as f64, top + row as f64);
                if *ink == 0 || x < 0.0 || y < 0.0 || x >= width as f64 || y >= height as f64 {
                    continue;
                }
                draw(y as usize * width + x as usize, *ink);
            }
        }
    }
}

/// The part of a picture that lies on the sheet.
fn picture(pixels: &mut Pixmap, (x, y): Point, frame: &Frame) {
    let (width, height) = (pixels.width() as usize, pixels.height() as usize);
    let (left, top) = (x.round() as i64, y.round() as i64);
    for (row, line) in frame.rgb().chunks_exact(3 * frame.width().max(1)).enumerate() {
        for (column, rgb) in line.chunks_exact(3).enumerate() {
            let on_sheet = |from: i64, by: usize, side: usize| {
                usize::try_from(from + by as i64).ok().filter(|place| *place < side)
            };
            if let (Some(x), Some(y)) = (on_sheet(left, column, width), on_sheet(top, row, height)) {
                let at = (y * width + x) * 4;
                pixels.data_mut()[at..at + 3].copy_from_slice(rgb);
            }
        }
    }
}
