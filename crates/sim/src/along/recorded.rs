//! What of a recording is driven along: rows with their pictures, cut where the car stood or time is missing.
//!
//! A recording is read twice, its numbers first, then picture by picture as the drive goes on: memory stays flat.

use std::{
    io,
    path::{Path, PathBuf},
};

use bytes::Bytes;

use super::{ClosedLoopError, warp::SIZE};
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    protocol::CameraImage,
    recording::udacity::{self, DrivingLog, FALLBACK_INTERVAL},
    recording::{By, EventRecord, Moment, Moments, RunReader, read_picture},
    units::{Mph, Steering, Throttle},
};

/// Slower than this the car stands: the simulator's forks call it stuck at 1 mph.
pub const STANDS_MPH: f64 = 1.0;
/// A longer time between two rows is a gap, in seconds: slow machines record each 0.12 s, the stock build each 0.07 s.
pub const GAP_S: f64 = 0.5;

/// A recorded moment in which the car moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Row {
    /// Seconds of driving before it: standing and gaps do not count.
    pub at_s: f64,
    /// What was recorded.
    pub speed: Mph,
    /// What is steered from here to the next row.
    pub steering: Steering,
    /// What was recorded.
    pub throttle: Throttle,
    /// Why the path does not go on from the row before: a new stretch begins.
    pub cut: Option<Cut>,
    /// Which row of the recording this is, from 0, of those with a picture.
    index: usize,
}

/// Why the recorded path is broken off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Cut {
    /// The recording begins.
    Begins,
    /// The car stood for so many rows.
    Stood(usize),
    /// So many seconds are missing, or an unknown time.
    Gap(Option<f64>),
    /// The car was put elsewhere, or a human took over whom the run does not show.
    Put,
}

/// A row as it is in the recording.
struct Raw {
    at_s: f64,
    speed: Mph,
    steering: Steering,
    throttle: Throttle,
    /// Whether what came before says that the path is broken.
    broken: Option<Cut>,
}

/// A recording to drive along.
pub(super) struct Recorded {
    pub rows: Vec<Row>,
    /// Rows of the recording with a picture, and those of them in which the car stood.
    pub read: usize,
    pub stood: usize,
    pictures: Pictures,
    path: PathBuf,
    /// Rows of the run read so far, with a picture.
    seen: usize,
}

enum Pictures {
    Folder(Vec<[Option<PathBuf>; 3]>),
    Run(Box<Moments>),
}

/// One moment's pictures: of the centre camera, the left and the right one.
#[derive(Debug, Default)]
pub(super) struct Shown {
    pub jpeg: Bytes,
    pub frames: [Option<Frame>; 3],
}

impl Shown {
    pub(super) fn frames(&self) -> [Option<&Frame>; 3] {
        self.frames.each_ref().map(Option::as_ref)
    }
}

impl Recorded {
    pub(super) fn open(path: &Path) -> Result<Self, ClosedLoopError> {
        let is_log = path.is_dir() || path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
        let (raw, pictures) = if is_log { folder(path)? } else { run(path)? };
        let (read, rows) = (raw.len(), driven(&raw));
        let stood = raw.iter().filter(|row| row.speed.get() < STANDS_MPH).count();
        if rows.len() < 2 {
            return Err(ClosedLoopError::NothingDriven { path: path.to_owned(), read, stood });
        }
        Ok(Self { rows, read, stood, pictures, path: path.to_owned(), seen: 0 })
    }

    /// Metres that the car drove, stretch by stretch.
    pub(super) fn length_m(&self) -> f64 {
        let pairs = self.rows.windows(2).filter(|pair| pair[1].cut.is_none());
        let way = |pair: &[Row]| {
            let mps = |row: &Row| row.speed.metres_per_second().get();
            (mps(&pair[0]) + mps(&pair[1])) / 2.0 * (pair[1].at_s - pair[0].at_s)
        };
        pairs.map(way).sum()
    }

    /// The pictures of a row; rows are asked for in their order.
    pub(super) fn show(&mut self, row: usize) -> Result<Shown, ClosedLoopError> {
        let index = self.rows[row].index;
        let (jpeg, sides) = match &mut self.pictures {
            Pictures::Folder(paths) => {
                let [centre, left, right] = &paths[index];
                let read = |path: &Option<PathBuf>| match path {
                    None => Ok(None),
                    Some(path) => {
                        read_picture(path).map(|bytes| Some((path.clone(), bytes))).map_err(|e| (path.clone(), e))
                    }
                };
                let side = |path: &Option<PathBuf>| match read(path) {
                    Err((_, e)) if e.kind() == io::ErrorKind::NotFound => Ok(None), // some people keep the centre's only
                    other => other,
                };
                let failed = |(path, source)| ClosedLoopError::Read { path, source };
                let centre = read(centre).map_err(failed)?;
                (centre, [side(left).map_err(failed)?, side(right).map_err(failed)?])
            }
            Pictures::Run(moments) => {
                let mut found = None;
                for moment in moments.by_ref() {
                    let Moment::Step(step) = moment? else { continue };
                    if !step.frame_recorded {
                        continue;
                    }
                    self.seen += 1;
                    if self.seen == index + 1 {
                        let CameraImage::Jpeg(jpeg) = step.telemetry.image else { break };
                        let at = format!("{} at {:.3} s", self.path.display(), step.at.as_secs_f64());
                        found = Some((PathBuf::from(at), jpeg));
                        break;
                    }
                }
                (found, [None, None])
            }
        };
        let Some((place, jpeg)) = jpeg else {
            return Err(ClosedLoopError::Changed { path: self.path.clone() });
        };
        let frame = decode(&place, &jpeg)?;
        let mut shown = Shown { jpeg, frames: [Some(frame), None, None] };
        for (slot, side) in shown.frames[1..].iter_mut().zip(sides) {
            *slot = side.map(|(path, jpeg)| decode(&path, &jpeg)).transpose()?;
        }
        Ok(shown)
    }
}

fn decode(place: &Path, jpeg: &[u8]) -> Result<Frame, ClosedLoopError> {
    let mut frame = Frame::default();
    decode_jpeg(jpeg, &mut frame).map_err(|why| ClosedLoopError::Picture { place: place.to_owned(), why })?;
    let (width, height) = (frame.width(), frame.height());
    if (width, height) != SIZE {
        return Err(ClosedLoopError::Size { place: place.to_owned(), width, height });
    }
    Ok(frame)
}

fn folder(path: &Path) -> Result<(Vec<Raw>, Pictures), ClosedLoopError> {
    let log = DrivingLog::open(path)?;
    let mut raw: Vec<Raw> = Vec::with_capacity(log.rows.len());
    let mut before: Option<&udacity::Row> = None;
    for row in &log.rows {
        // The log fills what it cannot tell with its usual interval; the names of the pictures say more.
        let apart = before.and_then(|before| {
            let (then, now) = before.taken_at.zip(row.taken_at)?;
            Some(now.duration_since(then).as_secs_f64())
        });
        let broken = match apart {
            Some(apart) if apart > GAP_S => Some(Cut::Gap(Some(apart))),
            Some(apart) if apart <= 0.0 => Some(Cut::Gap(None)),
            _ => None,
        };
        let (steering, throttle) = (row.steering, row.throttle);
        raw.push(Raw { at_s: row.at.as_secs_f64(), speed: row.speed, steering, throttle, broken });
        before = Some(row);
    }
    let paths = log.rows.into_iter().map(|row| [Some(row.center), row.left, row.right]).collect();
    Ok((raw, Pictures::Folder(paths)))
}

fn run(path: &Path) -> Result<(Vec<Raw>, Pictures), ClosedLoopError> {
    let mut raw: Vec<Raw> = Vec::new();
    let mut broken = None;
    let mut without = 0;
    // Whether the row before has no answer, so that the next telemetry says what was steered.
    let mut unanswered = false;
    for moment in RunReader::open(path)?.moments() {
        match moment? {
            Moment::Step(step) => {
                let told = step.telemetry.steering.steering();
                if let Some(before) = raw.last_mut().filter(|_| unanswered) {
                    before.steering = told;
                }
                let answer = step.command.filter(|c| matches!(c.by, By::Pilot | By::Human | By::Safe));
                if !step.frame_recorded {
                    without += 1;
                    continue;
                }
                unanswered = answer.is_none();
                raw.push(Raw {
                    at_s: step.at.as_secs_f64(),
                    speed: step.telemetry.speed,
                    steering: answer.map_or(told, |c| c.steering),
                    throttle: step.telemetry.throttle,
                    broken: std::mem::take(&mut broken),
                });
            }
            Moment::Event { event: EventRecord::Reset { .. } | EventRecord::TakeoverBegan, .. } => {
                broken = Some(Cut::Put);
            }
            Moment::Event { .. } => {}
        }
    }
    if raw.is_empty() {
        return Err(ClosedLoopError::NoPictures { path: path.to_owned(), telemetries: without });
    }
    Ok((raw, Pictures::Run(Box::new(RunReader::open(path)?.moments()))))
}

/// The rows in which the car moves, on a clock that stands while it does not.
fn driven(raw: &[Raw]) -> Vec<Row> {
    let mut rows: Vec<Row> = Vec::new();
    let mut cut = Some(Cut::Begins);
    let mut at_s = 0.0;
    let mut last_s: Option<f64> = None;
    for (index, row) in raw.iter().enumerate() {
        let apart = last_s.map_or(0.0, |last| row.at_s - last);
        last_s = Some(row.at_s);
        let gap = (apart > GAP_S || (apart <= 0.0 && index > 0)).then_some(Cut::Gap((apart > 0.0).then_some(apart)));
        cut = cut.or(row.broken).or(gap);
        if row.speed.get() < STANDS_MPH {
            cut = match cut {
                Some(Cut::Stood(rows)) => Some(Cut::Stood(rows + 1)),
                Some(Cut::Begins) => Some(Cut::Begins),
                _ => Some(Cut::Stood(1)),
            };
            continue;
        }
        if !rows.is_empty() {
            at_s += if cut.is_some() { FALLBACK_INTERVAL.as_secs_f64() } else { apart };
        }
        let Raw { speed, steering, throttle, .. } = *row;
        rows.push(Row { at_s, speed, steering, throttle, cut: cut.take(), index });
    }
    rows
}

#[cfg(test)]
#[path = "recorded_tests.rs"]
mod tests;
