//! Writes a run without a thread and without a clock: the same header and items give the same bytes.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use tempfile::NamedTempFile;

use super::{Item, RecordingError, Roadway, RunHeader, writer::RunWriter};
use crate::files;

/// A chunk of this size is written at once.
const CHUNK_BYTES: usize = 1 << 20;

/// A run on its way to a file, for a world that can wait for the disk. Where a [`Recorder`](super::Recorder) divides its
/// chunks by the clock, this divides them by size alone. The file has its name only once it is whole.
pub struct RunFile {
    path: PathBuf,
    writer: RunWriter<NamedTempFile>,
    /// What was written, by kind.
    written: BTreeMap<&'static str, u64>,
}

impl RunFile {
    /// Begins a run whose file will be at this path, on one of these roads if it tells its track; the path's folder must
    /// exist.
    ///
    /// # Errors
    /// [`RecordingError::Io`] if the file cannot be created, [`RecordingError::Write`] if the header cannot be written.
    pub fn create(path: &Path, header: &RunHeader, roads: Arc<[Roadway]>) -> Result<Self, RecordingError> {
        let file = files::partial(path).map_err(RecordingError::io("create", path))?;
        let writer = RunWriter::new(file, header, roads)
            .map_err(|source| RecordingError::Write { path: path.to_owned(), source })?;
        let written = ["telemetries", "frames", "commands", "events"].into_iter().map(|kind| (kind, 0)).collect();
        Ok(Self { path: path.to_owned(), writer, written })
    }

    /// Adds an item that happened `at` this time since the run began, in the order that
    /// [`Recorder::record`](super::Recorder::record) asks for.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn write(&mut self, at: Duration, item: Item) -> Result<(), RecordingError> {
        let kind = match &item {
            Item::Telemetry(_) => "telemetries",
            Item::Frame(_) => "frames",
            Item::Command(_) => "commands",
            Item::Event(_) => "events",
        };
        let path = &self.path;
        let wrong = |source| RecordingError::Write { path: path.clone(), source };
        self.writer.write(at, &item.lean()).map_err(wrong)?;
        if self.writer.unflushed() >= CHUNK_BYTES {
            self.writer.flush().map_err(wrong)?;
        }
        *self.written.entry(kind).or_default() += 1;
        Ok(())
    }

    /// Ends the run: its file is whole from here on.
    ///
    /// # Errors
    /// [`RecordingError::Write`]; there is no file then.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        let wrong = |source| RecordingError::Write { path: self.path.clone(), source };
        let lost = [("frames_not_recorded", 0), ("items_not_recorded", 0)];
        let counts = self.written.into_iter().chain(lost);
        let summary = counts.map(|(kind, count)| (kind.to_owned(), count.to_string())).collect();
        self.writer.flush().map_err(wrong)?;
        let file = self.writer.finish(summary).map_err(wrong)?;
        file.persist(&self.path).map_err(|error| wrong(error.error))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{EventRecord, RunKind, RunReader};

    #[test]
    fn the_same_items_give_the_same_bytes_and_a_run_that_is_not_whole_has_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let header = RunHeader::new(RunKind::Driven, serde_json::json!({}), jiff::Timestamp::UNIX_EPOCH);
        let write = |name: &str| {
            let mut run = RunFile::create(&dir.path().join(name), &header, Arc::default()).unwrap();
            for i in 0..40 {
                run.write(Duration::from_millis(i), Item::Frame(vec![i as u8; 60_000].into())).unwrap();
            }
            run.write(Duration::from_secs(1), Item::Event(EventRecord::Kick)).unwrap();
            run
        };
        write("one.mcap").finish().unwrap();
        write("other.mcap").finish().unwrap();
        drop(write("broken.mcap"));
        let read = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
        assert!(read("one.mcap") == read("other.mcap"));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2);
        let items = RunReader::open(dir.path().join("one.mcap")).unwrap();
        assert_eq!(items.map(Result::unwrap).count(), 41);
    }
}
