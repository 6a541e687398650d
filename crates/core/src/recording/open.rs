//! Opens anything recorded. What kind of recording it is, is decided here and nowhere else.

use std::{
    collections::{BTreeSet, VecDeque},
    fs, io,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::Duration,
};

use jiff::{civil::DateTime, tz::TimeZone};

use super::{
    Break, Entries, Entry, EventRecord, Item, Moment, Picture, RecordingError, RunHeader, RunKind, RunReader, Step,
    Truncation,
    udacity::{DrivingLog, IMAGES, LOG_NAME, Row, UNTIMED, images_beside},
};
use crate::{
    protocol::CameraImage,
    words::{count, first_five},
};

/// How many events are kept between two moments: only a damaged file has more, and memory must stay bounded.
const MOST_EVENTS: usize = 1 << 16;

/// An open run, or driving log of any dialect. It yields its [`Moment`]s in order, with one chunk of a run in memory at
/// a time; pictures of a log are read on request.
///
/// The iterator yields [`RecordingError::Message`] for a message of a run that does not parse, and continues after it.
/// It yields [`RecordingError::Io`] if the file cannot be read any further, and ends.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    header: RunHeader,
    source: OpenedFile,
    /// The moments yielded so far.
    row: usize,
    /// Of a run: when the last one was, what has happened since, and how many had no picture.
    last: Option<Duration>,
    events: Vec<(Duration, EventRecord)>,
    unseen: usize,
    /// Of a run: local time at its beginning.
    began: DateTime,
    /// For a log that is read by items: the rest of the row.
    items: VecDeque<Result<(Duration, Item), RecordingError>>,
}

#[derive(Debug)]
enum OpenedFile {
    Run(Box<Entries>),
    Log(DrivingLog),
}

/// Whether a path is that of a run, by its extension or because it is a file but not a CSV; others are driving logs.
fn is_run(path: &Path) -> bool {
    is_run_name(path) || path.is_file() && !ends(path, "csv")
}

/// Whether this name means a run when one is made: it ends in `.mcap`.
pub fn is_run_name(path: &Path) -> bool {
    ends(path, "mcap")
}

fn ends(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending))
}

/// The recordings in a folder, by name: its runs, and its driving log.
///
/// # Errors
/// The system's, where the folder cannot be read.
pub fn recordings_in(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut inside = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?;
    inside.retain(|file| is_run_name(file) || file.file_name().is_some_and(|name| name == LOG_NAME));
    inside.sort();
    Ok(inside)
}

/// The folders in a folder that have recordings in them, by name.
pub fn folders_with_recordings(folder: &Path) -> Vec<PathBuf> {
    let mut below = all_in(folder);
    below.retain(|path| recordings_in(path).is_ok_and(|inside| !inside.is_empty()));
    below.sort();
    below
}

/// What lies in a folder; nothing if it cannot be read.
fn all_in(folder: &Path) -> Vec<PathBuf> {
    fs::read_dir(folder).map(|inside| inside.flatten().map(|entry| entry.path()).collect()).unwrap_or_default()
}

/// What a folder without recordings has in their place, and what to do, in words; `None` if there is nothing to say.
pub fn instead_of_recordings(folder: &Path) -> Option<String> {
    let inside = all_in(folder);
    let pictures = |inside: &[PathBuf]| inside.iter().filter(|path| ends(path, "jpg")).count();
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let is_like_a_log = |name: &String| {
        let name = name.to_lowercase();
        name.starts_with("driving_log") && name.ends_with(".csv")
    };
    if let Some(like) = inside.iter().map(|path| name(path)).filter(is_like_a_log).min() {
        return Some(format!("{like:?}: rename it to {LOG_NAME}"));
    }
    if let alone @ 1.. = pictures(&inside) {
        let pictures = count(alone, "picture");
        return Some(format!(
            "{pictures} alone, and pictures contain neither speed nor steering: let lapwing serve record the drive"
        ));
    }
    if let alone @ 1.. = images_beside(folder).map_or(0, |images| pictures(&all_in(&images))) {
        let pictures = count(alone, "picture");
        return Some(format!(
            "{IMAGES} with {pictures} alone: put the {LOG_NAME} beside it that the simulator wrote with them"
        ));
    }
    let below = folders_with_recordings(folder);
    let named = first_five(below.iter().map(|path| path.display().to_string()).collect());
    (!below.is_empty()).then(|| format!("only folders in it that hold recordings: name {}", named.join(" or ")))
}

impl Recording {
    /// Opens a run, a folder with `driving_log.csv`, or a CSV file.
    ///
    /// # Errors
    /// Those of [`RunReader::open`] and [`DrivingLog::open`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let (header, source) = if is_run(path) {
            let run = RunReader::open(path)?;
            (run.header().clone(), OpenedFile::Run(Box::new(run.entries())))
        } else {
            let log = DrivingLog::open(path)?;
            (log.header(), OpenedFile::Log(log))
        };
        let began = header.started.to_zoned(TimeZone::system()).datetime();
        Ok(Self {
            path: path.to_owned(),
            header,
            source,
            row: 0,
            last: None,
            events: vec![],
            unseen: 0,
            began,
            items: VecDeque::new(),
        })
    }

    /// Its moments whose centre camera's picture is there, and what cannot be read.
    pub fn seen(self) -> impl Iterator<Item = Result<Moment, RecordingError>> {
        self.filter(|moment| moment.as_ref().map_or(true, Moment::is_seen))
    }

    /// What was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How it was made; for a driving log, what a run made from it says.
    pub fn header(&self) -> &RunHeader {
        &self.header
    }

    /// The driving log, if it is one.
    pub fn log(&self) -> Option<&DrivingLog> {
        match &self.source {
            OpenedFile::Run(_) => None,
            OpenedFile::Log(log) => Some(log),
        }
    }

    /// How many of its moments have a time that is assumed, because the names of a driving log's pictures hold none: for them,
    /// nothing that depends on how fast time passed (how far the car went, how long it took) can be told. 0 of any other
    /// recording; a run made from such a log knows it, too.
    pub fn untimed(&self) -> usize {
        match &self.source {
            OpenedFile::Log(log) => log.untimed(),
            OpenedFile::Run(_) if self.header.kind == RunKind::DrivingLog => {
                let told = self.header.config.get(UNTIMED).and_then(serde_json::Value::as_u64);
                told.map_or(0, |untimed| usize::try_from(untimed).unwrap_or(usize::MAX))
            }
            OpenedFile::Run(_) => 0,
        }
    }

    /// How many moments are still to come, if that is known: a run that is cut off does not say.
    pub fn left(&self) -> Option<u64> {
        let all = match &self.source {
            OpenedFile::Run(entries) => entries.run().telemetries()?,
            OpenedFile::Log(log) => log.rows.len() as u64,
        };
        Some(all.saturating_sub(self.row as u64))
    }

    /// Where a run is cut off, once it has been read: `None` if it ends in good order.
    pub fn truncated(&self) -> Option<&Truncation> {
        match &self.source {
            OpenedFile::Run(entries) => entries.truncated(),
            OpenedFile::Log(_) => None,
        }
    }

    /// What happened after the last moment, once the iterator has ended.
    pub fn events_after(&mut self) -> Vec<(Duration, EventRecord)> {
        std::mem::take(&mut self.events)
    }

    /// The next item as it stands in the file, for scoring: use it instead of the iterator, not together with it. A
    /// driving log's rows come as items of a run made from it; a picture that cannot be read is
    /// [`RecordingError::Picture`], and the rest of the row follows.
    pub fn next_item(&mut self) -> Option<Result<(Duration, Item), RecordingError>> {
        match &mut self.source {
            OpenedFile::Run(entries) => entries.run_mut().next(),
            OpenedFile::Log(log) => {
                if self.items.is_empty() {
                    let row = log.rows.get(self.row)?;
                    self.row += 1;
                    let jpeg = row.jpeg().map_err(|error| self.items.push_back(Err(error))).ok();
                    self.items.extend(row.items(jpeg).map(|item| Ok((row.at, item))));
                }
                self.items.pop_front()
            }
        }
    }

    fn of_run(&mut self, step: Step) -> Moment {
        let Step { at, mut telemetry, frame_recorded, command } = step;
        let picture = match std::mem::take(&mut telemetry.image) {
            CameraImage::Jpeg(jpeg) if frame_recorded => Picture::Jpeg(jpeg),
            _ => Picture::NotRecorded,
        };
        let before = std::mem::take(&mut self.events);
        let told = before.iter().filter_map(|(_, event)| Break::told(event)).next_back();
        let timed = self.last.and_then(|last| match last.checked_sub(at) {
            Some(back) if !back.is_zero() => Some(Break::Back(back)),
            _ => Break::after(at.saturating_sub(last)),
        });
        let unseen = if frame_recorded { std::mem::take(&mut self.unseen) } else { 0 };
        self.unseen += usize::from(!frame_recorded);
        let broken = told.or(timed).or((unseen > 0).then_some(Break::Unseen(unseen)));
        let is_first = self.last.is_none();
        self.last = Some(at);
        Moment {
            row: self.row,
            line: None,
            at,
            taken_at: self.began.checked_add(at).ok(),
            pictures: [Some(picture), None, None],
            telemetry,
            command,
            before,
            broken: broken.filter(|_| !is_first),
        }
    }
}

fn of_log(row: usize, of_log: &Row) -> Moment {
    let Row { line, at, broken, center, left, right, taken_at, .. } = of_log;
    Moment {
        row,
        line: Some(*line),
        at: *at,
        taken_at: *taken_at,
        pictures: [Some(center), left.as_ref(), right.as_ref()].map(|path| path.cloned().map(Picture::File)),
        telemetry: of_log.telemetry(),
        command: Some(of_log.command()),
        before: vec![],
        broken: *broken,
    }
}

/// Logs, once for each file, that a run is cut off: whoever reads it may look no further than its moments.
fn tell_truncated(path: &Path, entries: &Entries) -> Option<Result<Entry, RecordingError>> {
    static TOLD: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    let why = entries.truncated()?;
    if TOLD.lock().unwrap_or_else(PoisonError::into_inner).insert(path.to_owned()) {
        tracing::warn!("{}: {why}", path.display());
    }
    None
}

impl Iterator for Recording {
    type Item = Result<Moment, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let moment = loop {
            match &mut self.source {
                OpenedFile::Log(log) => break of_log(self.row, log.rows.get(self.row)?),
                OpenedFile::Run(entries) => match entries.next().or_else(|| tell_truncated(&self.path, entries))? {
                    Ok(Entry::Step(step)) => break self.of_run(step),
                    Ok(Entry::Event { at, event }) => {
                        if self.events.len() < MOST_EVENTS {
                            self.events.push((at, event));
                        }
                    }
                    Err(error) => return Some(Err(error)),
                },
            }
        };
        self.row += 1;
        Some(Ok(moment))
    }
}
