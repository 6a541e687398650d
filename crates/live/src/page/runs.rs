//! Recorded runs: which there are, and one of them opened to be looked at frame by frame.
//!
//! A request names a run. That name is compared with the names in the folder of runs and never made into a path, so
//! nothing but a run in that folder can be read, and no link out of it.

use std::{
    collections::HashMap,
    fs, io,
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, UNIX_EPOCH},
};

use bytes::Bytes;
use serde::Serialize;
use tokio::sync::Semaphore;

use super::Course;
use lapwing_core::{
    config::Thresholds,
    recording::{Item, RecordingError, is_run_name},
    units::Mph,
};
use lapwing_score::{
    odometry::Road,
    score::{
        Scorecard, Scorer,
        page::{Collector, Drawn, Outline, Shown, Strip, render},
        report::JudgedRun,
    },
};

/// Runs that are listed, the newest of them.
const LISTED: usize = 100;
/// Runs that are looked at, side by side.
const OPENED: usize = 2;
/// Bytes of pictures that are held of each of them.
const PICTURES: usize = 128 << 20;
/// Pictures that are held while one of a run's middle is looked for.
const GLANCED: usize = 4;
/// Commands of a run that are drawn at most.
const COMMANDS: usize = 20_000;

/// The folder of runs.
#[derive(Debug)]
pub(super) struct Runs {
    dir: PathBuf,
    /// What a list shows of each, by name; with the size that the file had.
    glances: Mutex<HashMap<String, (u64, Arc<Glance>)>>,
    /// The runs that are looked at, the newest first.
    opened: Mutex<Vec<Arc<Opened>>>,
    /// One run is read at a time, so that a page leaves the processor to the drives.
    pub reading: Semaphore,
}

/// A run in the list.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Listed {
    pub name: String,
    pub bytes: u64,
    /// When it was written last, in seconds since 1970.
    pub modified_s: u64,
}

/// What a list shows of a run.
#[derive(Debug, Serialize)]
pub(super) struct Glance {
    pub title: String,
    /// The score's rows, for people.
    pub rows: Vec<(&'static str, String)>,
    /// A picture of its middle.
    #[serde(skip)]
    pub picture: Option<Bytes>,
}

/// A run that is looked at.
#[derive(Debug, Serialize)]
pub(super) struct Opened {
    pub name: String,
    #[serde(skip)]
    bytes: u64,
    pub title: String,
    pub card: Scorecard,
    pub rows: Vec<(&'static str, String)>,
    pub drawn: Drawn,
    pub outline: Option<Outline>,
    /// SHA-256 of the model that drove, if one did.
    pub model_sha256: Option<String>,
    /// The commands: seconds of the run, and normalised steering.
    pub commands: Vec<[f32; 2]>,
    /// When each picture was taken, in seconds of the run.
    pub frames_s: Vec<f64>,
    #[serde(skip)]
    pub frames: Vec<Bytes>,
    /// How fast the car was at each telemetry: seconds of the run, and the speed.
    #[serde(skip)]
    speeds: Vec<(f64, Mph)>,
}

/// Why a run is not shown.
#[derive(Debug, thiserror::Error)]
pub(super) enum RunsError {
    #[error("no folder of runs is shown here")]
    None,
    #[error("expected the name of a run in the folder of runs, got another one")]
    Unknown,
    #[error("the folder of runs cannot be read: {0}")]
    Folder(io::Error),
    #[error("the run cannot be read: {0}")]
    File(io::Error),
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error("the report cannot be written: {0}")]
    Report(#[from] serde_json::Error),
    #[error("expected a picture from 0 to {last}, got {got}")]
    Frame { last: usize, got: usize },
}

impl Runs {
    pub fn of(dir: PathBuf) -> Self {
        Self { dir, glances: Mutex::default(), opened: Mutex::default(), reading: Semaphore::const_new(1) }
    }

    /// The runs, the newest first. A folder that does not exist yet has none.
    pub fn list(&self) -> Result<Vec<Listed>, RunsError> {
        let entries = match fs::read_dir(&self.dir) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(vec![]),
            entries => entries.map_err(RunsError::Folder)?,
        };
        let run = |entry: fs::DirEntry| {
            // Not what a link points to, which may be anywhere.
            let is_file = entry.file_type().ok()?.is_file();
            let (name, told) = (entry.file_name().into_string().ok()?, entry.metadata().ok()?);
            let modified = told.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            let modified_s = modified.unwrap_or_default().as_secs();
            (is_file && is_run_name(name.as_ref())).then_some(Listed { name, bytes: told.len(), modified_s })
        };
        let mut runs: Vec<_> = entries.flatten().filter_map(run).collect();
        runs.sort_by(|a, b| b.modified_s.cmp(&a.modified_s).then_with(|| b.name.cmp(&a.name)));
        runs.truncate(LISTED);
        Ok(runs)
    }

    /// The file of a listed run, and its size.
    pub fn find(&self, name: &str) -> Result<(PathBuf, u64), RunsError> {
        let run = self.list()?.into_iter().find(|run| run.name == name).ok_or(RunsError::Unknown)?;
        Ok((self.dir.join(run.name), run.bytes))
    }

    /// What a list shows of a run. Reads the whole file where it was not read before or has grown.
    pub fn glance(&self, name: &str) -> Result<Arc<Glance>, RunsError> {
        let (path, bytes) = self.find(name)?;
        let known = self.glances.lock().unwrap_or_else(PoisonError::into_inner).get(name).cloned();
        if let Some((_, glance)) = known.filter(|(then, _)| *then == bytes) {
            return Ok(glance);
        }
        let mut pictures = Strip::within(GLANCED, PICTURES);
        let run = judged(path, &[], |at, item| {
            if let Item::Frame(jpeg) = item {
                pictures.take(at.as_secs_f64(), jpeg);
            }
        })?;
        let mut pictures = pictures.finish();
        let middle = pictures.len() / 2;
        let picture = (middle < pictures.len()).then(|| pictures.swap_remove(middle).1);
        let glance = Arc::new(Glance { title: title(&run, name), rows: run.card.known_rows(), picture });
        let mut glances = self.glances.lock().unwrap_or_else(PoisonError::into_inner);
        if glances.len() >= 2 * LISTED {
            glances.clear(); // of runs that were deleted, most of them
        }
        glances.insert(name.to_owned(), (bytes, glance.clone()));
        Ok(glance)
    }

    /// Opens a run to be looked at; the last ones opened are kept.
    pub fn open(&self, name: &str, courses: &[Course]) -> Result<Arc<Opened>, RunsError> {
        let (path, bytes) = self.find(name)?;
        let kept = || self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(opened) = kept().iter().find(|opened| opened.name == name && opened.bytes == bytes) {
            return Ok(opened.clone());
        }
        let (mut collector, mut pictures) = (Collector::default(), Strip::within(usize::MAX, PICTURES));
        let (mut commands, mut speeds) = (vec![], vec![]);
        let run = judged(path, courses, |at, item| {
            let t = at.as_secs_f64();
            match item {
                Item::Frame(jpeg) => return pictures.take(t, jpeg),
                Item::Telemetry(telemetry) => speeds.push((t, telemetry.speed)),
                Item::Command(command) => commands.push([t as f32, command.steering.get() as f32]),
                Item::Event(_) => {}
            }
            collector.item(at, item);
        })?;
        let every = commands.len().div_ceil(COMMANDS).max(1);
        let commands = commands.into_iter().step_by(every).collect();
        let (drawn, outline) = on_map(collector, &run.card, courses);
        let (frames_s, frames) = pictures.finish().into_iter().unzip();
        let (title, rows) = (title(&run, name), run.card.known_rows());
        let name = name.to_owned();
        let model_sha256 = run.header.model.map(|model| model.sha256);
        let card = run.card;
        let opened = Arc::new(Opened {
            name,
            bytes,
            title,
            card,
            rows,
            drawn,
            outline,
            model_sha256,
            commands,
            frames_s,
            frames,
            speeds,
        });
        let mut kept = kept();
        kept.retain(|other| other.name != opened.name);
        kept.insert(0, opened.clone());
        kept.truncate(OPENED);
        Ok(opened)
    }

    /// The page that `lapwing score --html` writes of it.
    pub fn report(&self, name: &str, courses: &[Course]) -> Result<String, RunsError> {
        let (path, _) = self.find(name)?;
        let mut collector = Collector::with_pictures();
        let run = judged(path, courses, |at, item| collector.item(at, item))?;
        let (drawn, outline) = on_map(collector, &run.card, courses);
        let (title, card) = (title(&run, name), &run.card);
        Ok(render(&[Shown { title, card, drawn: &drawn, outline: outline.as_ref(), missed: vec![] }])?)
    }
}

impl Opened {
    /// One of its pictures.
    pub fn frame(&self, n: usize) -> Result<Bytes, RunsError> {
        let last = self.frames.len().saturating_sub(1);
        self.frames.get(n).cloned().ok_or(RunsError::Frame { last, got: n })
    }

    /// How fast the car was when it was taken.
    pub fn speed(&self, n: usize) -> Mph {
        let taken = self.frames_s.get(n).copied().unwrap_or(0.0);
        let after = self.speeds.partition_point(|(t, _)| *t <= taken);
        self.speeds.get(after.saturating_sub(1)).map_or(Mph::ZERO, |(_, speed)| *speed)
    }
}

/// As `lapwing score` does without `--laps`.
fn judged(path: PathBuf, courses: &[Course], watch: impl FnMut(Duration, &Item)) -> Result<JudgedRun, RunsError> {
    let roads: Vec<Arc<Road>> = courses.iter().flat_map(|course| course.ways.clone()).collect();
    JudgedRun::open(path, &Thresholds::default(), || Ok(Scorer::on(&roads, Some(1))), watch)
}

/// The run, its model and its track, without the folder, which is nobody's business.
fn title(run: &JudgedRun, name: &str) -> String {
    run.title().replacen(&run.path.display().to_string(), name, 1)
}

/// What is drawn of a run, with its road where that is known.
fn on_map(collector: Collector, card: &Scorecard, courses: &[Course]) -> (Drawn, Option<Outline>) {
    let mut drawn = collector.finish();
    let course = card.track.as_deref().and_then(|name| courses.iter().find(|course| course.name == name));
    if let Some(course) = course {
        let places = card.whereabouts.iter().filter_map(|(at, s)| Some((*at, course.place(*s)?)));
        drawn.locate(&places.collect::<Vec<_>>());
    }
    (drawn, course.map(|course| course.outline.clone()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_runs_in_the_folder_are_found_and_no_link_out_of_it() {
        let dir = tempfile::tempdir().unwrap();
        let (folder, secret) = (dir.path().join("runs"), dir.path().join("secret.mcap"));
        fs::create_dir_all(folder.join("inner.mcap")).unwrap();
        for path in [&secret, &folder.join("a.mcap"), &folder.join("notes.txt")] {
            fs::write(path, "x").unwrap();
        }
        #[cfg(unix)]
        std::os::unix::fs::symlink(&secret, folder.join("link.mcap")).unwrap();
        let runs = Runs::of(folder);
        let names: Vec<_> = runs.list().unwrap().into_iter().map(|run| run.name).collect();
        assert_eq!(names, ["a.mcap"]);
        assert!(runs.find("a.mcap").is_ok());
        for name in ["../secret.mcap", "link.mcap", "inner.mcap", "notes.txt", "./a.mcap", "a.mcap/", "", "/etc/passwd"]
        {
            assert!(matches!(runs.find(name), Err(RunsError::Unknown)), "{name}");
        }
        assert!(Runs::of(dir.path().join("nowhere")).list().unwrap().is_empty());
    }
}
