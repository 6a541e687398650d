//! The bounded queue between the driving loop and the recorder's thread, and how a full disk is waited for.

use std::{
    collections::{BTreeMap, VecDeque},
    io::{self, Seek, Write},
    path::PathBuf,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use super::{EventRecord, GONE, Item};

/// How often a full disk is tried again.
const RETRY_EVERY: Duration = Duration::from_secs(1);
/// Most bytes of waiting frames, whatever their number: a fork may send large ones.
const MAX_WAITING_BYTES: usize = 64 << 20;
/// Driving time between two warnings about a slow disk.
const WARN_EVERY: Duration = Duration::from_secs(10);

/// Items by kind.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    pub(super) telemetries: u64,
    pub(super) frames: u64,
    commands: u64,
    events: u64,
}

impl Counts {
    fn add(&mut self, item: &Item) {
        *match item {
            Item::Telemetry(_) => &mut self.telemetries,
            Item::Frame(_) => &mut self.frames,
            Item::Command(_) => &mut self.commands,
            Item::Event(_) => &mut self.events,
        } += 1;
    }

    fn add_all(&mut self, other: Self) {
        self.telemetries += other.telemetries;
        self.frames += other.frames;
        self.commands += other.commands;
        self.events += other.events;
    }

    /// All but the frames.
    pub(super) fn others(self) -> u64 {
        self.telemetries + self.commands + self.events
    }
}

/// What the driving loop and the writer's thread share. The lock is held only for a few moves in memory, never during
/// disk access.
#[derive(Debug)]
pub(super) struct RecordingQueue {
    path: PathBuf,
    state: Mutex<QueueState>,
    /// Something was queued, or the recorder closes.
    changed: Condvar,
    /// Something was taken out, or the writer is gone.
    taken: Condvar,
}

#[derive(Debug)]
pub(super) struct QueueState {
    waiting: VecDeque<(Duration, Item)>,
    /// Bytes of the frames that wait.
    waiting_bytes: usize,
    capacity: usize,
    /// Do not wait for a full disk: the recorder is being made or closed.
    closing: bool,
    /// The writer is gone for good.
    dead: bool,
    pub(super) failed: Option<String>,
    /// The sink is a file of the queue's path.
    pub(super) is_file: bool,
    /// There is no file of that name any more. It is written to all the same: perhaps it was only moved.
    pub(super) gone: bool,
    pub(super) written: Counts,
    /// In the chunk in memory.
    unflushed: Counts,
    pub(super) lost: Counts,
    /// Frames lost since the last one that was kept.
    gap: u64,
    warned: Option<Duration>,
    last: Duration,
}

/// What the writer's thread does next.
#[expect(clippy::large_enum_variant, reason = "nearly always an item, and never stored")]
pub(super) enum Next {
    Item(Duration, Item),
    Due,
    Closed,
}

impl QueueState {
    /// Queues the item or counts it as lost; returns the losses so far if it is time to warn about them.
    fn take(&mut self, at: Duration, item: Item) -> Option<Counts> {
        self.last = at;
        let is_frame = matches!(item, Item::Frame(_));
        let room = if is_frame { self.capacity / 4 * 3 } else { self.capacity };
        if self.dead {
            self.lost.add(&item);
            return None;
        }
        let bytes = bytes_of(&item);
        if self.waiting.len() < room && self.waiting_bytes + bytes <= MAX_WAITING_BYTES {
            if is_frame {
                self.tell_gap(at);
            }
            self.waiting_bytes += bytes;
            self.waiting.push_back((at, item));
            return None;
        }
        self.lost.add(&item);
        self.gap += u64::from(is_frame);
        let again = self.warned.is_none_or(|warned| at.saturating_sub(warned) >= WARN_EVERY);
        // A full disk has warnings of its own, at its beginning and end.
        (again && self.failed.is_none()).then(|| {
            self.warned = Some(at);
            self.lost
        })
    }

    /// Nothing waits.
    #[cfg(test)]
    pub(super) fn is_idle(&self) -> bool {
        self.waiting.is_empty()
    }

    fn tell_gap(&mut self, at: Duration) {
        if self.gap > 0 {
            self.waiting.push_back((at, Item::Event(EventRecord::FramesNotRecorded { count: self.gap })));
            self.gap = 0;
        }
    }

    /// What is in the file of the run's name, and what is not: all of it, if there is none.
    pub(super) fn written_and_lost(&self) -> (Counts, Counts) {
        if !self.gone {
            return (self.written, self.lost);
        }
        let mut lost = self.lost;
        lost.add_all(self.written);
        (Counts::default(), lost)
    }

    /// What is wrong at the moment, in words.
    pub(super) fn trouble(&self) -> Option<String> {
        if self.gone { Some(GONE.to_owned()) } else { self.failed.clone() }
    }

    pub(super) fn summary(&self) -> BTreeMap<String, String> {
        [
            ("telemetries", self.written.telemetries),
            ("frames", self.written.frames),
            ("commands", self.written.commands),
            ("events", self.written.events),
            ("frames_not_recorded", self.lost.frames),
            ("items_not_recorded", self.lost.others()),
        ]
        .into_iter()
        .map(|(name, count)| (name.to_owned(), count.to_string()))
        .collect()
    }
}

impl RecordingQueue {
    pub(super) fn new(capacity: usize, path: PathBuf) -> Self {
        let state = QueueState {
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            // Below four, a quarter of the queue would be zero.
            capacity: capacity.max(4),
            closing: true,
            dead: false,
            failed: None,
            is_file: false,
            gone: false,
            written: Counts::default(),
            unflushed: Counts::default(),
            lost: Counts::default(),
            gap: 0,
            warned: None,
            last: Duration::ZERO,
        };
        Self { path, state: Mutex::new(state), changed: Condvar::new(), taken: Condvar::new() }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, QueueState> {
        // Nothing that holds the lock can leave the state half changed.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From here on, waits if the disk is full.
    pub(super) fn open(&self) {
        self.lock().closing = false;
    }

    /// Ends the writer's thread once it has written what waits.
    pub(super) fn close(&self) {
        self.lock().closing = true;
        self.changed.notify_one();
    }

    /// Queues the item or counts it as lost; returns the losses so far if it is time to warn about them.
    pub(super) fn push(&self, at: Duration, item: Item) -> Option<Counts> {
        let warn = self.lock().take(at, item);
        self.changed.notify_one();
        warn
    }

    /// Waits until half of the queue is free, or until nothing empties it. A full disk is not waited for: perhaps nobody ever frees
    /// it.
    pub(super) fn wait_for_half(&self) {
        let full = |state: &mut QueueState| {
            let bytes = state.waiting_bytes > MAX_WAITING_BYTES / 2;
            !state.dead && state.failed.is_none() && (state.waiting.len() > state.capacity / 2 || bytes)
        };
        drop(self.taken.wait_while(self.lock(), full).unwrap_or_else(PoisonError::into_inner));
    }

    /// Waits for an item, for `due`, or for the end.
    pub(super) fn next(&self, due: Option<Instant>) -> Next {
        let mut state = self.lock();
        loop {
            if state.closing && state.waiting.is_empty() {
                let last = state.last;
                state.tell_gap(last);
            }
            if let Some((at, item)) = state.waiting.pop_front() {
                state.unflushed.add(&item);
                state.waiting_bytes -= bytes_of(&item);
                self.taken.notify_one();
                return Next::Item(at, item);
            }
            if state.closing {
                return Next::Closed;
            }
            state = match due.map(|due| due.saturating_duration_since(Instant::now())) {
                None => self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                Some(Duration::ZERO) => return Next::Due,
                Some(wait) => self.changed.wait_timeout(state, wait).unwrap_or_else(PoisonError::into_inner).0,
            };
        }
    }

    pub(super) fn flushed(&self) {
        let mut state = self.lock();
        let unflushed = std::mem::take(&mut state.unflushed);
        state.written.add_all(unflushed);
    }

    /// Looks whether the file is still there under its name, and says so if that changed. The lock is not held while the disk is asked.
    pub(super) fn look(&self) {
        let gone = self.is_gone();
        let was = std::mem::replace(&mut self.lock().gone, gone);
        match (was, gone) {
            (false, true) => tracing::error!(
                run = %self.path.display(),
                "the run's file is gone: {GONE}. The drive continues. If the file was only moved, it is still being written; move it back"
            ),
            (true, false) => tracing::info!(run = %self.path.display(), "the run is there again"),
            _ => {}
        }
    }

    /// Whether there is no file of the run's name any more. A disk that does not answer tells nothing.
    pub(super) fn is_gone(&self) -> bool {
        let is_file = self.lock().is_file;
        is_file && matches!(self.path.try_exists(), Ok(false))
    }

    /// The writer ends here: all that it holds and all that will come is lost.
    pub(super) fn give_up(&self, error: &io::Error) {
        let mut state = self.lock();
        state.dead = true;
        let unflushed = std::mem::take(&mut state.unflushed);
        state.lost.add_all(unflushed);
        state.waiting_bytes = 0;
        for (_, item) in std::mem::take(&mut state.waiting) {
            state.lost.add(&item);
        }
        self.taken.notify_one();
        if state.failed.is_none() {
            state.failed = Some(error.to_string());
            drop(state);
            tracing::error!(
                run = %self.path.display(),
                "cannot write the run: {error}. Everything else continues; what was written so far can be read. Record the next run to another disk"
            );
        }
    }

    /// Waits until a full disk may be asked again. False when it is for the last time.
    fn wait_for_room(&self, error: &io::Error) -> bool {
        let mut state = self.lock();
        if !state.closing && state.failed.is_none() {
            state.failed = Some(error.to_string());
            drop(state);
            self.taken.notify_one();
            tracing::error!(
                run = %self.path.display(),
                "cannot write the run: {error}. Everything else continues; free some space and recording continues, too"
            );
            state = self.lock();
        }
        let wait = self.changed.wait_timeout_while(state, RETRY_EVERY, |state| !state.closing);
        !wait.unwrap_or_else(PoisonError::into_inner).0.closing
    }

    fn has_room_again(&self) {
        if self.lock().failed.take().is_some() {
            tracing::info!(run = %self.path.display(), "the disk has room again, recording continues");
        }
    }
}

/// The picture's size; the rest of an item is small.
fn bytes_of(item: &Item) -> usize {
    if let Item::Frame(jpeg) = item { jpeg.len() } else { 0 }
}

/// A sink that waits for room on a full disk, so that a chunk continues where it stopped.
pub(super) struct Patient<W> {
    pub(super) sink: W,
    pub(super) queue: Arc<RecordingQueue>,
}

impl<W: Write> Write for Patient<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let (mut waited, mut last_time) = (false, false);
        loop {
            match self.sink.write(bytes) {
                Err(e) if matches!(e.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded) => {
                    if last_time {
                        return Err(e);
                    }
                    last_time = !self.queue.wait_for_room(&e);
                    waited = true;
                }
                result => {
                    if waited && result.is_ok() {
                        self.queue.has_room_again();
                    }
                    return result;
                }
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}

impl<W: Seek> Seek for Patient<W> {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        self.sink.seek(to)
    }
}
