//! Films for people: a drive as a video, an animated picture or a folder of pictures.
//!
//! The path decides which:
//!
//! | path | what | if it is interrupted |
//! |---|---|---|
//! | `out.mp4` | H.264 in MP4 | plays up to the last whole two seconds |
//! | `out.gif` | GIF that repeats for ever | plays up to the frame before the last |
//! | `frames/`, or any name without an extension | JPEG files in that folder | all pictures are there |
//! | `out.png`, `out.jpg` | numbered files beside that name, `out_00001.png` | all pictures are there |
//!
//! The same frames give the same bytes. Files of the same name are replaced; pictures in a folder are not. Nothing is
//! written before the first frame.

mod caption;
mod gif;
#[cfg(feature = "films")]
mod mp4;
mod stills;

use std::{
    io,
    path::{Path, PathBuf},
};

pub use self::caption::Moment;
#[cfg(feature = "films")]
use self::mp4::Mp4;
use self::{gif::Gif, stills::Stills};
use lapwing_core::{files, perception::Frame};

/// Why a film cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// A name that does not lead to a kind of film.
    #[error("{}: expected a film that ends in .mp4, .gif, .png or .jpg, or a folder's name, got .{got}", path.display())]
    Kind {
        /// The path.
        path: PathBuf,
        /// Its extension.
        got: String,
    },
    /// A kind of film that this program was built without.
    #[cfg(not(feature = "films"))]
    #[error("{}: this program was built without MP4: write a .gif or a folder, or build it with --features films", path.display())]
    LeftOut {
        /// The path.
        path: PathBuf,
    },
    /// A width and height that no such film can have.
    #[error("{}: expected {expected}, got {width}x{height}", path.display())]
    Size {
        /// The film.
        path: PathBuf,
        /// Sizes that would work.
        expected: &'static str,
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A number of frames a second that no film has.
    #[error("{}: expected 0.1 to 240 frames a second, got {fps}", path.display())]
    Rate {
        /// The film.
        path: PathBuf,
        /// The rate.
        fps: f64,
    },
    /// A frame of another size than the film.
    #[error("{}: expected frames of {}x{}, got {}x{}", path.display(), expected.0, expected.1, got.0, got.1)]
    Frame {
        /// The film.
        path: PathBuf,
        /// Width and height of the film.
        expected: (usize, usize),
        /// Width and height of the frame.
        got: (usize, usize),
    },
    /// A film that ends before it begins.
    #[error("{}: expected frames, got none", path.display())]
    Empty {
        /// The film.
        path: PathBuf,
    },
    /// An error of the file system.
    #[error("cannot {doing} {}: {source}", path.display())]
    Io {
        /// What was tried, a verb.
        doing: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The encoder failed.
    #[error("{}: cannot encode frame {frame}: {why}", path.display())]
    Encode {
        /// The film.
        path: PathBuf,
        /// Which frame, counted from 1.
        frame: u64,
        /// What the encoder says.
        why: String,
    },
}

impl FilmError {
    /// For `map_err`.
    fn io(doing: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { doing, path: path.to_owned(), source }
    }

    /// For `map_err`.
    fn encode<E: std::fmt::Display>(path: &Path, frame: u64) -> impl FnOnce(E) -> Self {
        move |error| Self::Encode { path: path.to_owned(), frame, why: error.to_string() }
    }
}

/// The state of a film of any kind: its path, and what it has so far.
#[derive(Debug)]
struct Reel {
    path: PathBuf,
    width: usize,
    height: usize,
    fps: f64,
    frames: u64,
}

/// A film being made.
pub struct Film {
    reel: Reel,
    kind: Kind,
}

enum Kind {
    #[cfg(feature = "films")]
    Mp4(Box<Mp4>),
    Gif(Box<Gif>),
    Stills(Stills),
}

/// A kind of film, by its path.
#[derive(Clone, Copy)]
enum Named {
    #[cfg(feature = "films")]
    Mp4,
    Gif,
    Stills {
        is_folder: bool,
    },
}

impl Named {
    fn of(path: &Path) -> Result<Self, FilmError> {
        let is_folder = path.is_dir() || path.as_os_str().to_string_lossy().ends_with(['/', std::path::MAIN_SEPARATOR]);
        let extension = path.extension().filter(|_| !is_folder).map(|e| e.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            #[cfg(feature = "films")]
            Some("mp4") => Ok(Self::Mp4),
            #[cfg(not(feature = "films"))]
            Some("mp4") => Err(FilmError::LeftOut { path: path.to_owned() }),
            Some("gif") => Ok(Self::Gif),
            None | Some("png" | "jpg" | "jpeg") => Ok(Self::Stills { is_folder }),
            Some(got) => Err(FilmError::Kind { got: got.to_owned(), path: path.to_owned() }),
        }
    }
}

impl Film {
    /// Checks that a film could be made at this path, before the work that it shows; nothing is changed.
    ///
    /// # Errors
    /// [`FilmError::Kind`] and [`FilmError::Io`].
    pub fn check(path: impl AsRef<Path>) -> Result<(), FilmError> {
        let path = path.as_ref();
        match Named::of(path)? {
            Named::Stills { is_folder } => Stills::new(path, is_folder).check(),
            _ => files::check(path).map_err(FilmError::io("create the film", path)),
        }
    }

    /// Begins a film of frames of that size.
    ///
    /// # Errors
    /// [`FilmError::Kind`], [`FilmError::Size`], [`FilmError::Rate`] and [`FilmError::Io`].
    pub fn create(path: impl AsRef<Path>, width: usize, height: usize, fps: f64) -> Result<Self, FilmError> {
        let path = path.as_ref().to_owned();
        if !(0.1..=240.0).contains(&fps) {
            return Err(FilmError::Rate { path, fps });
        }
        if !(1..=4096).contains(&width) || !(1..=4096).contains(&height) {
            return Err(FilmError::Size { path, expected: "1 to 4096 pixels each way", width, height });
        }
        let reel = Reel { path, width, height, fps, frames: 0 };
        let kind = match Named::of(&reel.path)? {
            #[cfg(feature = "films")]
            Named::Mp4 => Kind::Mp4(Box::new(Mp4::new(&reel)?)),
            Named::Gif => Kind::Gif(Box::default()),
            Named::Stills { is_folder } => Kind::Stills(Stills::new(&reel.path, is_folder)),
        };
        Self::check(&reel.path)?;
        Ok(Self { reel, kind })
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// [`FilmError::Frame`], [`FilmError::Encode`] and [`FilmError::Io`].
    pub fn frame(&mut self, frame: &Frame) -> Result<(), FilmError> {
        let (expected, got) = ((self.reel.width, self.reel.height), (frame.width(), frame.height()));
        if expected != got {
            return Err(FilmError::Frame { path: self.reel.path.clone(), expected, got });
        }
        self.reel.frames += 1;
        match &mut self.kind {
            #[cfg(feature = "films")]
            Kind::Mp4(mp4) => mp4.frame(&self.reel, frame),
            Kind::Gif(gif) => gif.frame(&self.reel, frame),
            Kind::Stills(stills) => stills.frame(&self.reel, frame),
        }
    }

    /// Frames so far.
    pub fn frames(&self) -> u64 {
        self.reel.frames
    }

    /// Where it is: the file, or the first and the last of its pictures.
    pub fn place(&self) -> String {
        match &self.kind {
            Kind::Stills(stills) => stills.place(self.reel.frames),
            _ => self.reel.path.display().to_string(),
        }
    }

    /// Ends the film, and says [where](Self::place) it is. A film that is dropped without this is left as if interrupted.
    ///
    /// # Errors
    /// [`FilmError::Empty`], [`FilmError::Encode`] and [`FilmError::Io`].
    pub fn finish(self) -> Result<String, FilmError> {
        if self.reel.frames == 0 {
            return Err(FilmError::Empty { path: self.reel.path });
        }
        let place = self.place();
        match self.kind {
            #[cfg(feature = "films")]
            Kind::Mp4(mp4) => mp4.finish(&self.reel)?,
            Kind::Gif(gif) => gif.finish(&self.reel)?,
            Kind::Stills(_) => {}
        }
        Ok(place)
    }
}

#[cfg(test)]
#[cfg(feature = "films")]
mod tests;
