//! A recording's pictures as files that other programs read, with a model's answers to them. Whoever trained the network elsewhere
//! can hold its answers against these on the same pixels: JPEG decoders differ by a level here and there, PNG decoders do not.

use std::{
    fmt::Write,
    fs, io,
    path::{Path, PathBuf},
};

use image::{ExtendedColorType::Rgb8, ImageEncoder, ImageError, codecs::png::PngEncoder};

use lapwing_core::{files, perception::Frame};

/// So many pictures are kept: enough to compare with, few enough for any disk.
pub const SHOWN: usize = 100;

/// Why a picture, or the answers, cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum ShownError {
    /// A file or folder.
    #[error("{}: cannot be written: {why}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// Why.
        why: io::Error,
    },
    /// A picture.
    #[error("{}: cannot be encoded: {why}", path.display())]
    Encode {
        /// Its file.
        path: PathBuf,
        /// Why.
        why: ImageError,
    },
}

/// A folder with `moment_00000.png` and so on, and `answers.csv`: the name of each, and the steering. The table is written at the
/// end: a folder that has one is whole.
pub(super) struct Shown {
    folder: PathBuf,
    table: String,
    kept: usize,
}

impl Shown {
    pub(super) fn new(folder: &Path) -> Result<Self, ShownError> {
        let table = folder.join("answers.csv");
        let removed = match fs::remove_file(&table) {
            Err(why) if why.kind() != io::ErrorKind::NotFound => Err(why),
            _ => fs::create_dir_all(folder),
        };
        removed.map_err(|why| ShownError::Write { path: folder.to_owned(), why })?;
        Ok(Self { folder: folder.to_owned(), table: "picture,steering\n".into(), kept: 0 })
    }

    /// Keeps one, unless there are [`SHOWN`] already.
    pub(super) fn keep(&mut self, row: usize, frame: &Frame, steering: f64) -> Result<(), ShownError> {
        if self.kept == SHOWN {
            return Ok(());
        }
        self.kept += 1;
        let name = format!("moment_{row:05}.png");
        let path = self.folder.join(&name);
        let mut png = Vec::new();
        PngEncoder::new(&mut png)
            .write_image(frame.rgb(), frame.width() as u32, frame.height() as u32, Rgb8)
            .map_err(|why| ShownError::Encode { path: path.clone(), why })?;
        files::write(&path, &png).map_err(|why| ShownError::Write { path, why })?;
        let _ = writeln!(self.table, "{name},{steering}");
        Ok(())
    }

    pub(super) fn finish(self) -> Result<(), ShownError> {
        let path = self.folder.join("answers.csv");
        files::write(&path, self.table.as_bytes()).map_err(|why| ShownError::Write { path, why })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::models::{built_in, check::check};
    use lapwing_core::{perception::decode_jpeg, pilot::View, recording::Recording};

    #[test]
    fn the_pictures_are_those_that_the_model_saw_and_the_answers_its_own() {
        let dir = tempfile::tempdir().unwrap();
        let lake = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../recordings/lake.mcap");
        let model = built_in(Instant::now).unwrap();
        let folder = dir.path().join("shown");
        check(&model, &lake, Some(&folder)).unwrap();
        let table = fs::read_to_string(folder.join("answers.csv")).unwrap();
        let mut lines = table.lines();
        assert_eq!(lines.next(), Some("picture,steering"));
        let (mut frame, mut pilot, mut count) = (Frame::default(), model.pilot(), 0);
        let moments = Recording::open(&lake).unwrap().seen().map(Result::unwrap);
        for (line, moment) in lines.zip(moments) {
            let (name, steering) = line.split_once(',').unwrap();
            decode_jpeg(&moment.pictures[0].as_ref().unwrap().read().unwrap(), &mut frame).unwrap();
            let png = image::open(folder.join(name)).unwrap().to_rgb8();
            assert!(png.as_raw() == frame.rgb(), "{name}");
            let answer = pilot.steer(&View { speed: moment.telemetry.speed, ..View::of(&frame) }).unwrap();
            assert_eq!(steering.parse(), Ok(answer.steering), "{name}");
            count += 1;
        }
        assert_eq!((count, fs::read_dir(&folder).unwrap().count()), (SHOWN, SHOWN + 1));
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("file");
        fs::write(&file, "").unwrap();
        let error = Shown::new(&file).err().unwrap().to_string();
        assert!(error.starts_with(&format!("{}: cannot be written: ", file.display())), "{error}");
    }
}
