//! Splits a driving log in two: rows to train on, and rows to validate on.

use std::{
    fs::{self, OpenOptions},
    io,
    path::{self, Path, PathBuf},
};

use super::{Blocks, DatasetError, source};
use lapwing_core::{
    files,
    recording::udacity::{LOG_NAME, Row},
    recording::{Recording, RecordingError},
    words::count,
};

/// The result of a split.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Divided {
    /// The log of the rows to train on.
    pub train: PathBuf,
    /// How many rows it has.
    pub train_rows: usize,
    /// The log of the rows held out.
    pub validation: PathBuf,
    /// How many rows it has.
    pub validation_rows: usize,
}

/// Splits the log of a Udacity folder by [`Blocks`] into `driving_log.csv` files in two folders, which are created if
/// they do not exist. No picture is copied: the logs give the absolute path of each.
///
/// The rows are written without a header, with steering, throttle, brake and speed exactly as they were read; other
/// columns are left out. If the pictures' names contain times, these show the jumps from block to block.
///
/// # Errors
/// [`DatasetError`] for invalid blocks, a run instead of a folder, a log that cannot be read, one that leaves a half
/// empty, and folders that already have a log: nothing is overwritten.
pub fn divide(source: &Path, blocks: Blocks, train: &Path, validation: &Path) -> Result<Divided, DatasetError> {
    blocks.check(["--block", "--every"])?;
    let recording = Recording::open(source)?;
    let Some(log) = recording.log() else { return Err(DatasetError::Run { path: source.to_owned() }) };
    let repeated = source::repeated(log.rows.iter().map(|row| row.center.as_path()));
    if repeated > 0 {
        let rows = count(repeated, "row");
        tracing::warn!(
            "{}: {rows} repeat the picture of an earlier row, which may be in the other half",
            log.path.display()
        );
    }
    let mut texts = [String::new(), String::new()];
    let mut counts = [0, 0];
    for (i, row) in log.rows.iter().enumerate() {
        let half = usize::from(blocks.is_validation(i));
        texts[half] += &line(row)?;
        counts[half] += 1;
    }
    for (count, half) in counts.into_iter().zip(["validation", "training"]) {
        if count == 0 {
            return Err(DatasetError::OneHalf { path: log.path.clone(), rows: log.rows.len(), half });
        }
    }
    // Both are checked before the first is written.
    let paths = [train, validation].map(|dir| dir.join(LOG_NAME));
    if let Some(path) = paths.iter().find(|path| path.exists()) {
        return Err(exists(path));
    }
    // Paths are compared part by part, and `absolute` leaves out what says "here".
    let absolute = |dir: &Path| path::absolute(dir).unwrap_or_else(|_| dir.to_owned());
    if absolute(train) == absolute(validation) {
        let (expected, got) = ("two folders", format!("{} twice", train.display()));
        return Err(DatasetError::Setting { name: "--out-train and --out-validation", expected, got });
    }
    for dir in [train, validation] {
        let why = |why| DatasetError::Io { doing: "create the folder", path: dir.to_owned(), why };
        files::check_folder(dir).map_err(why)?;
    }
    write(&paths[0], &texts[0])?;
    write(&paths[1], &texts[1]).inspect_err(|_| {
        // Half a split looks like a whole data set; one error is enough.
        let _ = fs::remove_file(&paths[0]);
    })?;
    let ([train, validation], [train_rows, validation_rows]) = (paths, counts);
    Ok(Divided { train, train_rows, validation, validation_rows })
}

fn exists(path: &Path) -> DatasetError {
    DatasetError::Exists { path: path.to_owned(), got: "a driving log" }
}

fn write(path: &Path, text: &str) -> Result<(), DatasetError> {
    let io = |doing| move |why| DatasetError::Io { doing, path: path.to_owned(), why };
    if let Some(dir) = path.parent() {
        fs::create_dir_all(dir).map_err(io("create the folder of"))?;
    }
    let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(|why| match why.kind() {
        io::ErrorKind::AlreadyExists => exists(path),
        _ => io("create the driving log")(why),
    })?;
    io::Write::write_all(&mut file, text.as_bytes()).map_err(io("write the driving log")).inspect_err(|_| {
        let _ = fs::remove_file(path);
    })
}

/// A row with the paths of its pictures.
fn line(row: &Row) -> Result<String, DatasetError> {
    let mut line = String::new();
    for picture in [Some(&row.center), row.left.as_ref(), row.right.as_ref()] {
        if let Some(picture) = picture {
            line += &field(picture)?;
        }
        line.push(',');
    }
    let Row { steering, throttle, brake, speed, .. } = row;
    // The shortest text that reads back as the same number.
    Ok(format!("{line}{},{},{brake},{}\n", steering.get(), throttle.get(), speed.get()))
}

/// An absolute path, in quotes where a comma would end it.
fn field(picture: &Path) -> Result<String, DatasetError> {
    let path = path::absolute(picture).map_err(|why| DatasetError::Io {
        doing: "find the picture",
        path: picture.to_owned(),
        why,
    })?;
    // A path that is not Unicode would be another one when it is read back.
    match path.to_str() {
        Some(text) if !text.contains(['"', '\n', '\r']) => {
            Ok(if text.contains(',') { format!("\"{text}\"") } else { text.to_owned() })
        }
        _ => Err(RecordingError::LogFolder { path: path.parent().unwrap_or(&path).to_owned() }.into()),
    }
}

#[cfg(test)]
mod tests;
