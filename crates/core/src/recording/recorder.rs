//! The recorder: takes items from the driving loop without ever blocking it, and writes them on a thread of its own.

use std::{
    fs,
    io::{self, Seek, Write},
    path::{Path, PathBuf},
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};

use jiff::tz::TimeZone;

use super::{
    Item, RecordingError, RunHeader,
    queue::{Next, Patient, RecordingQueue},
    scene::Roadway,
    writer::RunWriter,
};

/// How old an item in memory may get: half of the second that a crash may cost at most; the other half is for a busy
/// disk.
const FLUSH_EVERY: Duration = Duration::from_millis(500);
/// A chunk of this size is written at once.
const CHUNK_BYTES: usize = 1 << 20;

/// Options of a recorder.
#[derive(Debug, Clone)]
pub struct RecorderOptions {
    /// How many items may wait for the disk, frames up to three quarters of it and 64 MiB. Default 512: about six
    /// seconds of a simulator at 20 Hz.
    pub queue: usize,
    /// The roads that it may be on, for viewers; drawn is the one whose track the run tells. Default none.
    pub roads: Arc<[Roadway]>,
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self { queue: 512, roads: Arc::default() }
    }
}

/// The status of a recorder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecorderStatus {
    /// Items that are safely in the file: they would outlive this process.
    pub items_written: u64,
    /// Frames that the disk was too slow or too full for.
    pub frames_not_recorded: u64,
    /// Telemetries, commands and events likewise.
    pub items_not_recorded: u64,
    /// What is wrong at the moment, in words; cleared once a full disk has room again, or a file that was moved away is back.
    pub failed: Option<String>,
}

impl RecorderStatus {
    /// Frames and other items that were lost.
    pub fn lost(&self) -> u64 {
        self.frames_not_recorded + self.items_not_recorded
    }
}

/// The result of recording a run.
#[derive(Debug)]
pub struct RecordingReport {
    /// The run's file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Telemetries in it.
    pub telemetries: u64,
    /// Frames in it.
    pub frames: u64,
    /// Frames that were lost.
    pub frames_not_recorded: u64,
    /// Telemetries, commands and events that were lost.
    pub items_not_recorded: u64,
    /// Why the file ends before the run, if it does.
    pub error: Option<RecordingError>,
}

impl RecordingReport {
    /// Frames and other items that were lost.
    pub fn lost(&self) -> u64 {
        self.frames_not_recorded + self.items_not_recorded
    }
}

/// Records one run.
///
/// Items wait in a bounded queue. If the disk does not keep up, frames are dropped as soon as three quarters of it are
/// taken, and everything else only when it is full; all losses are counted, and the file gets one
/// [`EventRecord::FramesNotRecorded`](super::EventRecord::FramesNotRecorded) once there is room again.
///
/// A full disk is treated as a slow one: the writer keeps its current chunk and tries again every second, so once
/// somebody frees space the recording continues, with no gap except for what the queue could not hold. Any other error
/// ends the recording, not the drive. The file then stays readable up to the last whole chunk.
///
/// With each chunk it looks whether the file is still there. While it is not, the [status](Recorder::status) says so, but the file is
/// still written: one that was only moved away becomes whole where it is. If it is not there in the end, all of the run counts as lost.
///
/// Chunks go to the operating system at least every second, where they survive a crash of this program, but perhaps not
/// one of the machine (nothing is synced).
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    queue: Arc<RecordingQueue>,
    thread: Option<JoinHandle<Result<(), io::Error>>>,
}

impl Recorder {
    /// Makes the folder and a new file in it, named by local time and the header's hint.
    ///
    /// # Errors
    /// [`RecordingError::Io`] if the folder or the file cannot be made, [`RecordingError::Write`] if the header cannot
    /// be written.
    pub fn create(dir: &Path, header: RunHeader, options: RecorderOptions) -> Result<Self, RecordingError> {
        fs::create_dir_all(dir).map_err(RecordingError::io("make the folder", dir))?;
        let (file, path) = new_file(dir, &header)?;
        Self::in_file(file, path, &header, options)
    }

    /// Makes a file of exactly this name; its folder must exist.
    ///
    /// # Errors
    /// As [`create`](Self::create), and if there is such a file already.
    pub fn create_file(path: &Path, header: RunHeader, options: RecorderOptions) -> Result<Self, RecordingError> {
        let file = fs::File::create_new(path).map_err(RecordingError::io("create", path))?;
        Self::in_file(file, path.to_owned(), &header, options)
    }

    /// Records into a new file, which is removed if not even the header can be written to it.
    fn in_file(
        file: fs::File,
        path: PathBuf,
        header: &RunHeader,
        options: RecorderOptions,
    ) -> Result<Self, RecordingError> {
        let recorder = Self::with_sink(file, path.clone(), header, options).inspect_err(|_| {
            if let Err(error) = fs::remove_file(&path) {
                tracing::warn!("{}: an empty run is left here: {error}", path.display());
            }
        })?;
        recorder.queue.lock().is_file = true;
        Ok(recorder)
    }

    /// Records into any sink, which messages call `path`.
    fn with_sink<W: Write + Seek + Send + 'static>(
        sink: W,
        path: PathBuf,
        header: &RunHeader,
        options: RecorderOptions,
    ) -> Result<Self, RecordingError> {
        let queue = Arc::new(RecordingQueue::new(options.queue, path.clone()));
        let writer = RunWriter::new(Patient { sink, queue: Arc::clone(&queue) }, header, options.roads)
            .map_err(|source| RecordingError::Write { path: path.clone(), source })?;
        queue.open();
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn({
                let queue = Arc::clone(&queue);
                move || {
                    let result = write_all(writer, &queue);
                    if let Err(error) = &result {
                        queue.give_up(error);
                    }
                    result
                }
            })
            .map_err(RecordingError::io("start a thread to write", &path))?;
        Ok(Self { path, queue, thread: Some(thread) })
    }

    /// The run's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Hands over an item that happened `at` this time since the run began.
    ///
    /// Never waits for the disk and never fails; items that cannot be recorded are counted. The telemetry, the frame
    /// and the command of one step must be handed over in this order, the frame with exactly its telemetry's time: that
    /// is how [`Entries`](super::Entries) joins them.
    pub fn record(&self, at: Duration, item: Item) {
        if let Some(lost) = self.queue.push(at, item.lean()) {
            tracing::warn!(
                run = %self.path.display(),
                frames_not_recorded = lost.frames,
                items_not_recorded = lost.others(),
                "the disk is too slow for this run: frames are dropped first, driving continues"
            );
        }
    }

    /// Waits for the disk until half of the queue is free: for a world that can stand still, so that nothing of its run is
    /// dropped. Does not wait for a full disk to be freed.
    pub fn wait_for_room(&self) {
        self.queue.wait_for_half();
    }

    /// The status of the recording. Cheap.
    pub fn status(&self) -> RecorderStatus {
        let state = self.queue.lock();
        RecorderStatus {
            items_written: state.written.frames + state.written.others(),
            frames_not_recorded: state.lost.frames,
            items_not_recorded: state.lost.others(),
            failed: state.trouble(),
        }
    }

    /// Writes what still waits, ends the file and returns the result. Waits for a slow disk; a full one is tried one
    /// last time.
    pub fn finish(mut self) -> RecordingReport {
        let (closed, path) = (self.close(), self.path.clone());
        let gone = self.queue.is_gone();
        let error = match closed {
            _ if gone => Some(RecordingError::Gone { path }),
            closed => closed.err().map(|source| RecordingError::Write { path, source }),
        };
        let mut state = self.queue.lock();
        state.gone = gone;
        let (written, lost) = state.written_and_lost();
        RecordingReport {
            path: self.path.clone(),
            bytes: fs::metadata(&self.path).map_or(0, |m| m.len()),
            telemetries: written.telemetries,
            frames: written.frames,
            frames_not_recorded: lost.frames,
            items_not_recorded: lost.others(),
            error,
        }
    }

    fn close(&mut self) -> Result<(), io::Error> {
        self.queue.close();
        match self.thread.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(_)) => Err(io::Error::other("the thread that writes it panicked")),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Reported already, by the thread that found it.
        let _ = self.close();
    }
}

/// Opens a new file, so that no run is ever overwritten.
fn new_file(dir: &Path, header: &RunHeader) -> Result<(fs::File, PathBuf), RecordingError> {
    let mut name = header.started.to_zoned(TimeZone::system()).strftime("%Y-%m-%dT%H-%M-%S").to_string();
    if let Some(hint) = &header.name_hint {
        let clean = |c: char| if c.is_alphanumeric() || c == '_' { c } else { '-' };
        name.extend(std::iter::once('-').chain(hint.chars().take(60).map(clean)));
    }
    let mut number = 1;
    loop {
        // '_' sorts after the '.' of the first run's name; '-' would sort before it.
        let count = if number == 1 { String::new() } else { format!("_{number}") };
        let path = dir.join(format!("{name}{count}.mcap"));
        match fs::File::create_new(&path) {
            Ok(file) => return Ok((file, path)),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists && number < 10_000 => number += 1,
            Err(e) => return Err(RecordingError::io("create", &path)(e)),
        }
    }
}

/// The writer's thread: from the queue to the sink until the recorder closes.
fn write_all<W: Write + Seek>(mut writer: RunWriter<W>, queue: &RecordingQueue) -> Result<(), io::Error> {
    let mut due: Option<Instant> = None;
    loop {
        match queue.next(due) {
            Next::Item(at, item) => {
                writer.write(at, &item)?;
                due.get_or_insert_with(|| Instant::now() + FLUSH_EVERY);
            }
            Next::Due => {}
            Next::Closed => break,
        }
        if writer.unflushed() >= CHUNK_BYTES || due.is_some_and(|due| due <= Instant::now()) {
            writer.flush()?;
            queue.flushed();
            queue.look();
            due = None;
        }
    }
    writer.flush()?;
    queue.flushed();
    let summary = queue.lock().summary();
    writer.finish(summary).map(drop)
}

#[cfg(test)]
mod tests;
