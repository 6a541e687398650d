//! A film as numbered pictures.

use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use image::{
    ExtendedColorType::Rgb8,
    ImageEncoder,
    codecs::{jpeg::JpegEncoder, png::PngEncoder},
};

use super::{FilmError, Reel};
use crate::perception::Frame;

/// JPEG quality of a film's pictures: for people's eyes, better than the camera's own 75.
const QUALITY: u8 = 92;

pub(super) struct Stills {
    folder: PathBuf,
    stem: String,
    extension: String,
}

impl Stills {
    pub(super) fn create(reel: &Reel, is_folder: bool) -> Result<Self, FilmError> {
        let extension = reel.path.extension().filter(|_| !is_folder);
        let (folder, stem) = match extension {
            None => (reel.path.clone(), "frame".into()),
            Some(_) => (
                reel.path.parent().unwrap_or(Path::new("")).to_owned(),
                reel.path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            ),
        };
        if folder != Path::new("") {
            fs::create_dir_all(&folder).map_err(FilmError::io("create the folder", &folder))?;
        }
        let extension = extension.map_or("jpg".into(), |e| e.to_string_lossy().into_owned());
        Ok(Self { folder, stem, extension })
    }

    pub(super) fn frame(&mut self, reel: &Reel, frame: &Frame) -> Result<(), FilmError> {
        let path = self.folder.join(format!("{}_{:05}.{}", self.stem, reel.frames, self.extension));
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
