//! The runs that paths stand for: files, and the contents of folders.

use std::{
    collections::HashSet,
    fs, io,
    path::{Path, PathBuf},
};

use lapwing_core::recording::{instead_of_recordings, recordings_in};

/// Paths that do not lead to runs.
#[derive(Debug, thiserror::Error)]
pub enum FilesError {
    /// A folder cannot be read.
    #[error("{}: cannot be read", path.display())]
    Read {
        /// The folder.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// A folder without runs.
    #[error("{}: expected runs (.mcap) or a driving_log.csv in the folder, got {got}", path.display())]
    NoRuns {
        /// The folder.
        path: PathBuf,
        /// What is there.
        got: String,
    },
}

/// The runs and driving logs that the paths stand for, each once; for a folder, all in it, by name.
///
/// # Errors
/// [`FilesError`].
pub fn runs_in(paths: &[PathBuf]) -> Result<Vec<PathBuf>, FilesError> {
    let mut files = vec![];
    for path in paths {
        if path.is_dir() {
            files.extend(in_folder(path)?);
        } else {
            files.push(path.clone());
        }
    }
    // A run that is named twice counts once.
    let mut seen = HashSet::new();
    files.retain(|file| seen.insert(fs::canonicalize(file).unwrap_or_else(|_| file.clone())));
    Ok(files)
}

fn in_folder(path: &Path) -> Result<Vec<PathBuf>, FilesError> {
    let cannot = |source| FilesError::Read { path: path.to_owned(), source };
    let inside = recordings_in(path).map_err(cannot)?;
    if inside.is_empty() {
        let got = instead_of_recordings(path).unwrap_or_else(|| "neither".to_owned());
        return Err(FilesError::NoRuns { path: path.to_owned(), got });
    }
    Ok(inside)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_means_its_runs_by_name_and_a_run_that_is_named_twice_is_one() {
        let dir = tempfile::tempdir().unwrap();
        let [a, b, log] = ["a.mcap", "b.MCAP", "driving_log.csv"].map(|name| dir.path().join(name));
        for file in [&b, &a, &log] {
            fs::write(file, "").unwrap();
        }
        assert_eq!(runs_in(&[a.clone(), dir.path().to_owned()]).unwrap(), [a, b, log]);
    }

    #[test]
    fn pictures_alone_are_no_run() {
        let dir = tempfile::tempdir().unwrap();
        let error = || runs_in(&[dir.path().to_owned()]).unwrap_err().to_string();
        assert!(error().ends_with("in the folder, got neither"), "{}", error());
        fs::write(dir.path().join("1.jpg"), "").unwrap();
        assert!(error().contains("got 1 picture alone, and pictures contain neither"), "{}", error());
    }
}
