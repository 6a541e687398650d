//! Reports what is in a data set, and what is wrong with it.

use std::{
    collections::{BTreeMap, HashSet},
    path::{Path, PathBuf},
    time::Duration,
};

use jiff::civil::DateTime;
use rayon::iter::{ParallelBridge, ParallelIterator};
use serde::Serialize;

use super::DatasetError;
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    recording::{Break, By, LONGEST_GAP, Moment, Picture, Recording, RecordingError},
    stats::quantile,
    units::Steering,
};

/// Names of the cameras, in the order in which a moment has its pictures.
const CAMERAS: [&str; 3] = ["center", "left", "right"];

/// Slower than this, in mph, the car is stationary.
const STANDS_MPH: f64 = 0.5;

/// What is in a data set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// A folder, its log, or a run.
    pub path: PathBuf,
    /// Which: `folder` or `run`.
    pub kind: &'static str,
    /// Moments recorded.
    pub rows: u64,
    /// The cameras that have pictures.
    pub cameras: Vec<CameraCount>,
    /// The steering to learn, -1 full left to 1 full right. Rows of a run in which nobody steered have none.
    pub steering: Distribution,
    /// Among the rows that have one, the share with a steering of exactly 0, 0 to 1.
    pub zero_steering: f64,
    /// The distribution of the steering.
    pub steering_histogram: Histogram,
    /// Speed, in mph.
    pub speed_mph: Distribution,
    /// Share of the rows at less than 0.5 mph, 0 to 1.
    pub standing: f64,
    /// From the first row to the last, without the time between drives, in seconds.
    pub duration_s: f64,
    /// From row to row, without gaps; absent if no two rows have times.
    pub intervals_ms: Option<Intervals>,
    /// Rows without a known time.
    pub untimed: u64,
    /// Where time jumps: pauses, cuts, drives joined.
    pub gaps: Vec<Gap>,
    /// Sizes of the pictures.
    pub sizes: Vec<Size>,
    /// Rows that name a centre picture that a row before them names, too.
    pub repeated: usize,
    /// All pictures together, in bytes.
    pub picture_bytes: u64,
    /// How many telemetries of a run were answered by each of: `pilot`, `human`, `safe`, `off` or `nobody`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub answered: BTreeMap<&'static str, u64>,
    /// Pictures that are missing or broken, and messages that cannot be read, by row.
    pub problems: Vec<Problem>,
    /// Where a run is cut off, if it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truncated: Option<String>,
}

/// The pictures of one camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CameraCount {
    /// `center`, `left` or `right`.
    pub camera: &'static str,
    /// Rows that name a picture of it.
    pub rows: u64,
    /// Those whose picture is missing.
    pub missing: u64,
    /// Those whose picture cannot be decoded.
    pub broken: u64,
}

/// The distribution of numbers. All fields are 0 if there are none.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Distribution {
    /// Mean.
    pub mean: f64,
    /// Standard deviation of these numbers themselves, not of the population they are a sample of.
    pub std: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

/// A histogram.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Histogram {
    /// Where the first bin begins.
    pub from: f64,
    /// How wide each is.
    pub width: f64,
    /// Numbers in each.
    pub counts: Vec<u64>,
}

/// Times from row to row, in milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Intervals {
    /// Half are shorter.
    pub median: f64,
    /// 95 of 100 are shorter.
    pub p95: f64,
    /// The longest that does not count as a gap.
    pub max: f64,
}

/// A jump in time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gap {
    /// The row after it, counted from 0.
    pub row: usize,
    /// Its line in the log, counted from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<usize>,
    /// From the row before it; negative where time goes back.
    pub seconds: f64,
}

/// A size of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Size {
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    /// How many pictures have it.
    pub pictures: u64,
}

/// Something that a training cannot use.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The row, counted from 0. A message that cannot be read has that of the next row.
    pub row: usize,
    /// Its line in the log, counted from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<usize>,
    /// The camera, if it is about a picture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<&'static str>,
    /// The picture's file, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Whether the file is missing.
    pub missing: bool,
    /// What was expected, and what is there.
    pub why: String,
}

impl Distribution {
    /// The spread of these numbers.
    pub fn of(numbers: &[f64]) -> Self {
        if numbers.is_empty() {
            return Self::default();
        }
        let n = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / n;
        let variance = numbers.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n;
        let (min, max) = numbers.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
        Self { mean, std: variance.sqrt(), min, max }
    }
}

impl Histogram {
    /// The histogram of steering, -1 to 1, in bins of 0.05; the middle bin is centred on 0.
    pub fn of_steering(steering: &[f64]) -> Self {
        const BINS: usize = 41;
        let (from, width) = (-1.025, 0.05);
        let mut counts = vec![0; BINS];
        for x in steering {
            // No value is beyond the ends, and a cast saturates.
            counts[(((x - from) / width) as usize).min(BINS - 1)] += 1;
        }
        Self { from, width, counts }
    }
}

impl Intervals {
    fn of(mut ms: Vec<f64>) -> Option<Self> {
        ms.sort_by(f64::total_cmp);
        let of = |share| quantile(&ms, share);
        Some(Self { median: of(0.5)?, p95: of(0.95)?, max: of(1.0)? })
    }
}

/// Inspects a data set: a folder with `driving_log.csv`, such a file, or a run. Every picture is decoded, on all
/// processors. `progress` is told how many rows are done, and of how many if that is known.
///
/// # Errors
/// [`DatasetError::Recording`] if the log cannot be read or the run cannot be opened; [`DatasetError::Empty`] for a run
/// without telemetry. Pictures that cannot be read are not an error; they are in [`Inspection::problems`].
pub fn inspect(path: &Path, progress: &mut (dyn FnMut(u64, Option<u64>) + Send)) -> Result<Inspection, DatasetError> {
    let mut recording = Recording::open(path)?;
    let total = recording.left();
    let mut rows = RowFindings { is_run: recording.log().is_none(), ..RowFindings::default() };
    let mut ended = Ok(());
    // Whichever thread is free takes the next picture: the rows are read by one at a time, and in order.
    let jobs = recording.by_ref().map_while(|moment| match moment {
        Ok(moment) => {
            rows.take(&moment);
            progress(rows.count, total);
            Some(Job::of(&moment))
        }
        Err(error @ RecordingError::Message { .. }) => {
            rows.unreadable(&error);
            Some(vec![])
        }
        Err(error) => {
            ended = Err(DatasetError::from(error));
            None
        }
    });
    let none = PictureFindings::default;
    let pictures = jobs.flatten().par_bridge().fold(none, PictureFindings::with).reduce(none, PictureFindings::and);
    ended?;
    if rows.count == 0 {
        return Err(DatasetError::Empty { path: path.to_owned() });
    }
    Ok(rows.with(pictures, path, recording.truncated().map(ToString::to_string)))
}

/// A picture to be decoded.
struct Job {
    row: usize,
    line: Option<usize>,
    camera: usize,
    picture: Picture,
}

impl Job {
    fn of(moment: &Moment) -> Vec<Self> {
        let pictures = moment.pictures.iter().enumerate();
        let job = |(camera, picture): (_, &Option<Picture>)| {
            Some(Self { row: moment.row, line: moment.line, camera, picture: picture.clone()? })
        };
        pictures.filter_map(job).collect()
    }
}

/// What is found in pictures.
#[derive(Default)]
struct PictureFindings {
    /// By camera: rows, missing, broken.
    counts: [[u64; 3]; CAMERAS.len()],
    sizes: BTreeMap<(usize, usize), u64>,
    bytes: u64,
    problems: Vec<Problem>,
    /// The last picture, whose memory the next one takes.
    frame: Frame,
}

impl PictureFindings {
    /// And those of this picture.
    fn with(mut self, Job { row, line, camera, picture }: Job) -> Self {
        let [rows, missing, broken] = &mut self.counts[camera];
        *rows += 1;
        let decoded = picture.read().map_err(|why| (true, why.to_string())).and_then(|bytes| {
            self.bytes += bytes.len() as u64;
            decode_jpeg(&bytes, &mut self.frame).map_err(|e| (false, e.to_string()))
        });
        match decoded {
            Ok(()) => *self.sizes.entry((self.frame.width(), self.frame.height())).or_default() += 1,
            Err((is_missing, why)) => {
                *(if is_missing { missing } else { broken }) += 1;
                let file = if let Picture::File(path) = picture { Some(path) } else { None };
                let camera = Some(CAMERAS[camera]);
                self.problems.push(Problem { row, line, camera, file, missing: is_missing, why });
            }
        }
        self
    }

    fn and(mut self, mut other: Self) -> Self {
        for (all, more) in self.counts.iter_mut().flatten().zip(other.counts.iter().flatten()) {
            *all += more;
        }
        for (size, count) in other.sizes {
            *self.sizes.entry(size).or_default() += count;
        }
        self.problems.append(&mut other.problems);
        self.bytes += other.bytes;
        self
    }
}

/// What the rows themselves contain.
#[derive(Default)]
struct RowFindings {
    is_run: bool,
    count: u64,
    steering: Vec<f64>,
    speed_mph: Vec<f64>,
    first: Option<Duration>,
    last: Duration,
    last_taken: Option<DateTime>,
    intervals_ms: Vec<f64>,
    untimed: u64,
    gaps: Vec<Gap>,
    answered: BTreeMap<&'static str, u64>,
    /// The centre pictures so far, and how many rows name one of them again.
    named: HashSet<PathBuf>,
    repeated: usize,
    problems: Vec<Problem>,
}

/// Who answered a run's telemetry.
fn answered(moment: &Moment) -> &'static str {
    match moment.command.as_ref().map(|command| command.by) {
        None => "nobody",
        Some(By::Pilot) => "pilot",
        Some(By::Human) => "human",
        Some(By::Safe) => "safe",
        Some(By::Off) => "off",
    }
}

impl RowFindings {
    fn take(&mut self, moment: &Moment) {
        self.count += 1;
        self.steering.extend(moment.steering().map(Steering::get));
        self.speed_mph.push(moment.telemetry.speed.get());
        self.first.get_or_insert(moment.at);
        self.last = moment.at;
        if self.is_run {
            *self.answered.entry(answered(moment)).or_default() += 1;
        }
        if let Some(Picture::File(path)) = &moment.pictures[0] {
            self.repeated += usize::from(!self.named.insert(path.clone()));
        }
        self.untimed += u64::from(moment.taken_at.is_none());
        if let (Some(from), Some(to)) = (self.last_taken, moment.taken_at) {
            // A run made from a log states outright what the times of its moments do not show.
            let told = moment.broken.and_then(Break::seconds);
            let seconds = told.unwrap_or_else(|| to.duration_since(from).as_secs_f64());
            if (0.0..=LONGEST_GAP.as_secs_f64()).contains(&seconds) {
                self.intervals_ms.push(seconds * 1e3);
            } else {
                self.gaps.push(Gap { row: moment.row, line: moment.line, seconds });
            }
        }
        self.last_taken = moment.taken_at;
    }

    /// A message of a run.
    fn unreadable(&mut self, error: &RecordingError) {
        let (row, why) = (self.count as usize, error.to_string());
        self.problems.push(Problem { row, line: None, camera: None, file: None, missing: false, why });
    }

    fn with(mut self, pictures: PictureFindings, path: &Path, truncated: Option<String>) -> Inspection {
        let share = |count: usize, of: usize| count as f64 / of.max(1) as f64;
        let cameras = CAMERAS.into_iter().zip(pictures.counts).filter(|(_, counts)| counts[0] > 0);
        let cameras = cameras.map(|(camera, [rows, missing, broken])| CameraCount { camera, rows, missing, broken });
        let sizes = pictures.sizes.into_iter();
        self.problems.extend(pictures.problems);
        self.problems.sort_by_key(|p| (p.row, CAMERAS.iter().position(|camera| p.camera == Some(camera))));
        Inspection {
            path: path.to_owned(),
            kind: if self.is_run { "run" } else { "folder" },
            rows: self.count,
            cameras: cameras.collect(),
            steering: Distribution::of(&self.steering),
            zero_steering: share(self.steering.iter().filter(|x| **x == 0.0).count(), self.steering.len()),
            steering_histogram: Histogram::of_steering(&self.steering),
            speed_mph: Distribution::of(&self.speed_mph),
            standing: share(self.speed_mph.iter().filter(|mph| mph.abs() < STANDS_MPH).count(), self.speed_mph.len()),
            duration_s: self.last.saturating_sub(self.first.unwrap_or_default()).as_secs_f64(),
            intervals_ms: Intervals::of(self.intervals_ms),
            untimed: self.untimed,
            gaps: self.gaps,
            sizes: sizes.map(|((width, height), pictures)| Size { width, height, pictures }).collect(),
            repeated: self.repeated,
            picture_bytes: pictures.bytes,
            answered: self.answered,
            problems: self.problems,
            truncated,
        }
    }
}

#[cfg(test)]
mod tests;
