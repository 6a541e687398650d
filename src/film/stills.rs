//! A film as numbered pictures.

use std::{
    ffi::OsString,
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use image::{
    ExtendedColorType::Rgb8,
    ImageEncoder,
    codecs::{jpeg::JpegEncoder, png::PngEncoder},
};

use super::{FilmError, Reel};
use lapwing_core::{files, perception::Frame};

/// JPEG quality of a film's pictures: for people's eyes, better than the camera's own 75.
const QUALITY: u8 = 92;

pub(super) struct Stills {
    folder: PathBuf,
    stem: OsString,
    extension: String,
}

impl Stills {
    pub(super) fn new(path: &Path, is_folder: bool) -> Self {
        let extension = path.extension().filter(|_| !is_folder);
        let (folder, stem) = match extension {
            None => (path.to_owned(), "frame".into()),
            Some(_) => {
                (path.parent().unwrap_or(Path::new("")).to_owned(), path.file_stem().unwrap_or_default().to_owned())
            }
        };
        let extension = extension.map_or("jpg".into(), |e| e.to_string_lossy().into_owned());
        Self { folder, stem, extension }
    }

    /// Checks that pictures can be written to the folder, and that it has none of these names.
    pub(super) fn check(&self) -> Result<(), FilmError> {
        files::check_folder(&self.folder).map_err(FilmError::io("create pictures in the folder", &self.folder))?;
        let first = self.path(1);
        if first.exists() {
            let why = "there are pictures already, and none is overwritten: name another folder";
            return Err(FilmError::io("create the picture", &first)(io::Error::new(io::ErrorKind::AlreadyExists, why)));
        }
        Ok(())
    }

    fn path(&self, number: u64) -> PathBuf {
        let mut name = self.stem.clone();
        name.push(format!("_{number:05}.{}", self.extension));
        self.folder.join(name)
    }

    /// The first and the last of so many pictures.
    pub(super) fn place(&self, frames: u64) -> String {
        format!("{} to {}", self.path(1).display(), self.path(frames).display())
    }

    pub(super) fn frame(&mut self, reel: &Reel, frame: &Frame) -> Result<(), FilmError> {
        if reel.frames == 1 && self.folder != Path::new("") {
            fs::create_dir_all(&self.folder).map_err(FilmError::io("create the folder", &self.folder))?;
        }
        let path = self.path(reel.frames);
        let mut file = BufWriter::new(File::create_new(&path).map_err(FilmError::io("create the picture", &path))?);
        let (width, height) = (reel.width as u32, reel.height as u32);
        if self.extension.eq_ignore_ascii_case("png") {
            PngEncoder::new(&mut file).write_image(frame.rgb(), width, height, Rgb8)
        } else {
            JpegEncoder::new_with_quality(&mut file, QUALITY).write_image(frame.rgb(), width, height, Rgb8)
        }
        .map_err(FilmError::encode(&path, reel.frames))?;
        file.flush().map_err(FilmError::io("write the picture", &path))
    }
}
