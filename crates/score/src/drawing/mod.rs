//! Drawn sheets: maps, charts and contact sheets, as SVG or PNG.
//!
//! Callers make a [`Sheet`] of [`Shape`]s, in pixels; this module paints it, as either kind from the same shapes. The
//! same sheet always gives the same bytes. [`chart`] makes sheets from numbers. Nothing here knows about maps or data
//! sets.

pub mod chart;
mod png;
mod svg;

use std::{
    io,
    path::{Path, PathBuf},
};

use lapwing_core::{files, perception::Frame};

/// Red, green, blue.
pub type Colour = [u8; 3];

/// A place on the sheet in pixels: right and down from the upper left corner.
pub type Point = (f64, f64);

/// Colour of sheets.
pub const PAPER: Colour = [0xf5, 0xf2, 0xeb];
/// Colour of the text on them.
pub const INK: Colour = [0x22, 0x26, 0x2b];

/// Height of letters, in pixels.
pub const LINE_PX: f64 = 16.0;
/// Width of a letter, in pixels (Noto Sans Mono at 16).
pub const LETTER: f64 = 7.0;
/// Around everything, in pixels.
pub const MARGIN: f64 = 24.0;

/// Longest side of a PNG, in pixels: four such sides are 256 MiB in memory.
const MAX_SIDE: f64 = 16_384.0;

/// What a sheet consists of; painted in order.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A filled polygon.
    Area {
        /// Its corners.
        points: Vec<Point>,
        /// Its colour.
        colour: Colour,
    },
    /// A line from point to point.
    Line {
        /// Where it goes.
        points: Vec<Point>,
        /// Its colour.
        colour: Colour,
        /// In pixels.
        width: f64,
    },
    /// Words in [`INK`].
    Text {
        /// The middle of its left end.
        at: Point,
        /// The words: ASCII; in a PNG other letters are question marks.
        text: String,
    },
    /// A picture in its own size.
    Picture {
        /// Its upper left corner.
        at: Point,
        /// The picture.
        frame: Frame,
    },
}

impl Shape {
    /// A rectangle from its upper left to its lower right corner.
    pub fn rectangle((left, top): Point, (right, bottom): Point, colour: Colour) -> Self {
        Self::Area { points: vec![(left, top), (right, top), (right, bottom), (left, bottom)], colour }
    }

    /// Words with a share of their width left of a place: 0 to begin there, 0.5 to be centred, 1 to end there.
    pub fn text((x, y): Point, left: f64, text: impl Into<String>) -> Self {
        let text = text.into();
        Self::Text { at: (x - left * width_of(&text), y), text }
    }
}

/// Writes words on a picture; `at` is the middle of their left end. What lies beyond the picture is left out.
pub fn write_on(frame: &mut Frame, at: Point, text: &str, colour: Colour) {
    png::write_on(frame, at, text, colour);
}

/// How wide words are, in pixels.
pub fn width_of(text: &str) -> f64 {
    text.chars().count() as f64 * LETTER
}

/// A drawing, still to be painted.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// In pixels.
    pub width: f64,
    /// In pixels.
    pub height: f64,
    /// The title of an SVG.
    pub title: String,
    /// What is on it, from the bottom up.
    pub shapes: Vec<Shape>,
}

impl Sheet {
    /// As SVG text.
    ///
    /// # Errors
    /// [`PaintError::Encode`].
    pub fn svg(&self) -> Result<String, PaintError> {
        svg::paint(self)
    }

    /// As a PNG file's bytes.
    ///
    /// # Errors
    /// [`PaintError`].
    pub fn png(&self) -> Result<Vec<u8>, PaintError> {
        png::paint(self)
    }

    /// As a picture, for a film.
    ///
    /// # Errors
    /// [`PaintError::Size`].
    pub fn frame(&self) -> Result<Frame, PaintError> {
        png::pixels(self)
    }

    /// Paints into a file that ends in `.svg` or `.png`, replacing an existing one.
    ///
    /// # Errors
    /// [`DrawingError`]
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), DrawingError> {
        let path = path.as_ref();
        let bytes = match SheetFormat::of(path)? {
            SheetFormat::Svg => self.svg().map(String::into_bytes),
            SheetFormat::Png => self.png(),
        };
        let bytes = bytes.map_err(|why| DrawingError::Encode { path: path.to_owned(), why })?;
        files::write(path, &bytes).map_err(|source| DrawingError::Io { path: path.to_owned(), source })
    }
}

/// Why a sheet cannot be painted.
#[derive(Debug, thiserror::Error)]
pub enum PaintError {
    /// A side of zero, or one that is too long.
    #[error("expected 1 to {MAX_SIDE} pixels a side, got {width}x{height}")]
    Size {
        /// In pixels.
        width: u32,
        /// In pixels.
        height: u32,
    },
    /// The encoder of pictures failed.
    #[error(transparent)]
    Encode(#[from] image::ImageError),
    /// The text cannot be written.
    #[error(transparent)]
    Text(#[from] std::fmt::Error),
}

/// What a sheet is painted as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SheetFormat {
    /// Lines and words, at any size.
    Svg,
    /// Pixels.
    Png,
}

impl SheetFormat {
    /// The kind, by a file's extension. Check this before the work that makes the sheet.
    ///
    /// # Errors
    /// [`DrawingError::Kind`] for any other extension.
    pub fn of(path: &Path) -> Result<Self, DrawingError> {
        match path.extension().unwrap_or_default().to_string_lossy().to_lowercase().as_str() {
            "svg" => Ok(Self::Svg),
            "png" => Ok(Self::Png),
            _ => Err(DrawingError::Kind { path: path.to_owned() }),
        }
    }
}

/// Why a sheet cannot be painted into a file.
#[derive(Debug, thiserror::Error)]
pub enum DrawingError {
    /// A name without the extension of a picture.
    #[error("{}: expected the name of a picture that ends in .svg or .png", path.display())]
    Kind {
        /// The path.
        path: PathBuf,
    },
    /// The picture could not be encoded.
    #[error("{}: cannot encode the picture: {why}", path.display())]
    Encode {
        /// The path.
        path: PathBuf,
        /// The painter's error.
        why: PaintError,
    },
    /// An error of the file system.
    #[error("cannot write the picture {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

#[cfg(test)]
mod tests;
