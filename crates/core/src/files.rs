//! Files that are written whole or not at all. Callers check that a file can be written before they start the work.

use std::{
    ffi::OsStr,
    fs::{self, File, OpenOptions, TryLockError},
    io::{self, Write},
    path::Path,
};

use tempfile::NamedTempFile;

/// Writes a file under a temporary name and renames it once it is whole and on the disk: whatever happens, either the
/// old or the new file is there. Anything but a regular file (a pipe, `/dev/stdout`) is written directly.
///
/// # Errors
/// The system's; no partial file is left then.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if is_special(path) {
        return OpenOptions::new().write(true).open(path)?.write_all(bytes);
    }
    // A link stays a link.
    let path = &fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let mut file = partial(path)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}

/// A file beside this one, under a name that nobody takes for a result: to be written whole and then
/// [persisted](NamedTempFile::persist), as readable as any new file. It is removed if it is dropped before.
///
/// # Errors
/// The system's.
pub fn partial(path: &Path) -> io::Result<NamedTempFile> {
    let mut name = path.file_name().map(OsStr::to_owned).unwrap_or_default();
    name.push(".");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&name).suffix(".partial");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666)); // less the umask
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    if matches!(folder.try_exists(), Ok(false)) {
        // Said of the folder, not of a file whose name nobody gave.
        return Err(io::Error::new(io::ErrorKind::NotFound, format!("there is no folder {}", folder.display())));
    }
    builder.tempfile_in(folder)
}

/// Whether a file could be written at this path, as far as can be told without writing it; nothing is changed.
///
/// # Errors
/// The system's, as [`write()`] would give it.
pub fn check(path: &Path) -> io::Result<()> {
    if path.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    if is_special(path) {
        return Ok(()); // opening it would be noticed at its other end
    }
    if path.exists() {
        OpenOptions::new().write(true).open(path)?;
    }
    let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    partial(&path).map(drop)
}

/// Whether files could be created in this folder, or the folder itself in its parent; nothing is changed.
///
/// # Errors
/// The system's.
pub fn check_folder(folder: &Path) -> io::Result<()> {
    let is_there = |above: &&Path| above.as_os_str().is_empty() || above.symlink_metadata().is_ok();
    let existing = folder.ancestors().find(is_there).filter(|path| !path.as_os_str().is_empty());
    let existing = existing.unwrap_or(Path::new("."));
    if !existing.is_dir() {
        return Err(io::ErrorKind::NotADirectory.into());
    }
    partial(&existing.join("lapwing")).map(drop)
}

/// Holds a folder for this process until what is returned is dropped, or the process ends: alone, or `shared` with others
/// that share it. `None` where the system cannot lock folders.
///
/// # Errors
/// If another one holds it.
pub fn lock(folder: &Path, shared: bool) -> io::Result<Option<File>> {
    let Ok(handle) = File::open(folder) else { return Ok(None) };
    match if shared { handle.try_lock_shared() } else { handle.try_lock() } {
        Ok(()) => Ok(Some(handle)),
        Err(TryLockError::WouldBlock) => {
            let why = "another lapwing is writing into this folder: wait for it, or choose another folder";
            Err(io::Error::new(io::ErrorKind::ResourceBusy, why))
        }
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Whether something else than a file or a folder is there: a pipe, whose reading may take forever, or a device, which may
/// have no end.
pub fn is_special(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_written_whole_and_a_link_to_it_stays() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.txt");
        write(&file, b"one").unwrap();
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("a.txt", dir.path().join("b.txt")).unwrap();
            write(&dir.path().join("b.txt"), b"two").unwrap();
            assert_eq!((fs::read(&file).unwrap().as_slice(), names(dir.path()).len()), (&b"two"[..], 2));
            assert!(dir.path().join("b.txt").is_symlink());
            let mode = |name: &str| fs::metadata(dir.path().join(name)).unwrap().permissions();
            fs::write(dir.path().join("plain"), "").unwrap();
            assert_eq!(mode("a.txt"), mode("plain"), "readable by the same users as any other file");
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_folder_is_held_by_one_or_shared_by_several() {
        let dir = tempfile::tempdir().unwrap();
        let lock = |shared| lock(dir.path(), shared);
        let alone = lock(false).unwrap().unwrap();
        assert!([true, false].iter().all(|shared| lock(*shared).is_err()));
        drop(alone);
        let shared = [lock(true), lock(true)];
        assert!(shared.iter().all(Result::is_ok) && lock(false).is_err());
        drop(shared);
        assert!(lock(false).is_ok() && names(dir.path()).is_empty());
    }

    #[test]
    fn a_look_at_what_could_be_written_leaves_no_trace() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("there"), "old").unwrap();
        check(&dir.path().join("there")).unwrap();
        check(&dir.path().join("new")).unwrap();
        check_folder(dir.path()).unwrap();
        check_folder(&dir.path().join("a/b/c")).unwrap();
        check_folder(Path::new("recordings")).unwrap();
        assert_eq!(names(dir.path()), ["there"]);
        assert_eq!(fs::read(dir.path().join("there")).unwrap(), b"old");
    }

    #[test]
    fn what_cannot_be_written_is_known_before() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("file"), "").unwrap();
        assert_eq!(check(dir.path()).unwrap_err().kind(), io::ErrorKind::IsADirectory);
        assert_eq!(check(&dir.path().join("no/such.html")).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert_eq!(check_folder(&dir.path().join("file/a")).unwrap_err().kind(), io::ErrorKind::NotADirectory);
        assert!(check_folder(Path::new("/proc/nowhere")).is_err());
        #[cfg(target_os = "linux")]
        {
            check(Path::new("/dev/full")).unwrap();
            assert_eq!(write(Path::new("/dev/full"), b"x").unwrap_err().kind(), io::ErrorKind::StorageFull);
        }
    }
}
