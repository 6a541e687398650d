//! The stretches of a recording to drive along: rows with pictures, cut where the car was stationary or time is missing.
//!
//! A recording is read twice, first its numbers, then picture by picture during the drive: memory stays bounded.

use std::{ops::Range, path::Path};

use bytes::Bytes;

use super::{ClosedLoopError, warp::SIZE};
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    recording::{Break, LONGEST_GAP, Picture, Recording, udacity::FALLBACK_INTERVAL},
    units::{Mph, Steering, Throttle},
};

/// Slower than this the car is stationary: the simulator's forks call it stuck at 1 mph.
pub const STANDS_MPH: f64 = 1.0;
/// A longer time between two rows is not driven, in seconds: half of what counts as a gap elsewhere ([`LONGEST_GAP`]).
/// The recorded car keeps its steering until the next row, and half a second of wrong steering leads half a metre
/// astray.
pub const GAP_S: f64 = LONGEST_GAP.as_secs_f64() / 2.0;

/// Every row of a recording, however many it has.
pub(super) const ALL_ROWS: Range<usize> = 0..usize::MAX;

/// A recorded moment in which the car moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PathRow {
    /// Seconds of driving before it, without standing and gaps.
    pub at_s: f64,
    /// What was recorded.
    pub speed: Mph,
    /// What is steered from here to the next row.
    pub steering: Steering,
    /// What was recorded.
    pub throttle: Throttle,
    /// Why the path does not continue from the row before: a new stretch begins.
    pub cut: Option<PathBreak>,
    /// Which row of the recording this is, from 0, of those with a picture.
    pub index: usize,
}

impl PathRow {
    /// Its speed in metres a second.
    pub(super) fn mps(&self) -> f64 {
        self.speed.metres_per_second().get()
    }
}

/// Why the recorded path is broken off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PathBreak {
    /// The recording begins.
    Begins,
    /// The car stood for this many rows.
    Stood(usize),
    /// This many seconds are missing, or an unknown time.
    Gap(Option<f64>),
    /// The car was put elsewhere, or a human took over, whose driving the run does not show.
    Put,
}

/// A row as it is in the recording.
struct Raw {
    at_s: f64,
    speed: Mph,
    steering: Steering,
    throttle: Throttle,
    /// The break of the path that earlier events report, if any.
    broken: Option<PathBreak>,
}

/// A recording to drive along.
pub(super) struct RecordedDrive {
    pub rows: Vec<PathRow>,
    /// Rows of the recording with a picture, and those of them in which the car was stationary.
    pub read: usize,
    pub stood: usize,
    /// The recording, read a second time up to the row that is shown.
    again: Recording,
    /// Rows read so far of it, with a picture.
    seen: usize,
    /// Rows so far whose centre camera's picture can be used, and those of them without a side camera's.
    pub loaded: usize,
    pub sideless: usize,
}

/// One moment's pictures: of the centre camera, the left and the right one.
#[derive(Debug, Default)]
pub(super) struct MomentPictures {
    /// The centre camera's bytes; none if they cannot be read.
    pub jpeg: Bytes,
    /// All empty if the centre camera's cannot be used; a side camera's that cannot is left out.
    pub frames: [Option<Frame>; 3],
    /// Why that of the centre camera cannot be used.
    pub unusable: Option<ClosedLoopError>,
}

impl MomentPictures {
    pub(super) fn frames(&self) -> [Option<&Frame>; 3] {
        self.frames.each_ref().map(Option::as_ref)
    }
}

impl RecordedDrive {
    /// Of the rows with a picture, these; [`ALL_ROWS`] ends where the recording does.
    pub(super) fn open(path: &Path, within: Range<usize>) -> Result<Self, ClosedLoopError> {
        let raw = raw(path)?;
        if within.start >= raw.len() || (within.end > raw.len() && within.end != ALL_ROWS.end) {
            return Err(ClosedLoopError::Rows { path: path.to_owned(), rows: raw.len(), got: within });
        }
        let rows = driven(&raw, &within);
        let wanted = raw.get(within.start..within.end.min(raw.len())).unwrap_or_default();
        let (read, stood) = (wanted.len(), wanted.iter().filter(|row| row.speed.get() < STANDS_MPH).count());
        if rows.len() < 2 {
            return Err(ClosedLoopError::NothingDriven { path: path.to_owned(), within, read, stood });
        }
        Ok(Self { rows, read, stood, again: Recording::open(path)?, seen: 0, loaded: 0, sideless: 0 })
    }

    /// Metres that the car drove, stretch by stretch.
    pub(super) fn length_m(&self) -> f64 {
        self.length_m_where(|_| true)
    }

    /// The same up to those rows of which this holds.
    pub(super) fn length_m_where(&self, holds: impl Fn(&PathRow) -> bool) -> f64 {
        let pairs = self.rows.windows(2).filter(|pair| pair[1].cut.is_none() && holds(&pair[1]));
        pairs.map(|pair| (pair[0].mps() + pair[1].mps()) / 2.0 * (pair[1].at_s - pair[0].at_s)).sum()
    }

    /// Where the recording is.
    pub(super) fn path(&self) -> &Path {
        self.again.path()
    }

    /// There are fewer rows than there were.
    pub(super) fn changed(&self) -> ClosedLoopError {
        ClosedLoopError::Changed { path: self.again.path().to_owned() }
    }

    /// The pictures of a row; rows must be asked for in order.
    pub(super) fn show(&mut self, row: usize) -> Result<MomentPictures, ClosedLoopError> {
        let index = self.rows[row].index;
        let moment = loop {
            let Some(moment) = self.again.next().transpose()? else {
                return Err(self.changed());
            };
            self.seen += usize::from(moment.is_seen());
            if self.seen == index + 1 {
                break moment;
            }
        };
        let look = |picture: &Picture| {
            let place = match picture {
                Picture::File(path) => path.clone(),
                _ => format!("{} at {:.3} s", self.again.path().display(), moment.at.as_secs_f64()).into(),
            };
            match picture.read() {
                Ok(jpeg) => (decode(&place, &jpeg), jpeg),
                Err(source) => (Err(ClosedLoopError::Read { path: place, source }), Bytes::new()),
            }
        };
        let mut shown = MomentPictures::default();
        for (i, (slot, picture)) in shown.frames.iter_mut().zip(&moment.pictures).enumerate() {
            let Some((frame, jpeg)) = picture.as_ref().map(look) else { continue };
            match frame {
                Ok(frame) => *slot = Some(frame),
                Err(why @ ClosedLoopError::Size { .. }) => return Err(why),
                Err(why) if i == 0 => shown.unusable = Some(why),
                Err(_) => {} // some keep only the centre's
            }
            if i == 0 {
                shown.jpeg = jpeg;
            }
            if shown.unusable.is_some() {
                break;
            }
        }
        if shown.unusable.is_none() {
            self.loaded += 1;
            self.sideless += usize::from(shown.frames[1..].iter().all(Option::is_none));
        }
        Ok(shown)
    }
}

/// Reads a picture of the stock camera, or says why it cannot be used.
///
/// # Errors
/// Which picture it is and what is wrong with it, in words: it cannot be read or decoded, or has another size than [`SIZE`].
pub fn read_stock(picture: &Picture, frame: &mut Frame) -> Result<(), String> {
    let jpeg = picture.read().map_err(|e| format!("{picture}: {e}"))?;
    decode_jpeg(&jpeg, frame).map_err(|e| format!("{picture}: {e}"))?;
    let size = (frame.width(), frame.height());
    if size == SIZE {
        return Ok(());
    }
    Err(format!("{picture}: expected {}x{} pixels, got {}x{}", SIZE.0, SIZE.1, size.0, size.1))
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

/// The rows with a picture.
fn raw(path: &Path) -> Result<Vec<Raw>, ClosedLoopError> {
    let mut raw: Vec<Raw> = Vec::new();
    let mut broken = None;
    let mut without = 0;
    // Whether the row before has no answer, so that the next telemetry shows what was steered.
    let mut unanswered = false;
    for moment in Recording::open(path)? {
        let moment = moment?;
        let told = moment.telemetry.steering.steering();
        if let Some(before) = raw.last_mut().filter(|_| unanswered) {
            before.steering = told;
        }
        broken = moment.broken.and_then(cut).or(broken);
        if !moment.is_seen() {
            without += 1;
            continue;
        }
        // The car followed safe answers, too; with the pilot off it did something else.
        let followed = moment.followed();
        unanswered = followed.is_none();
        raw.push(Raw {
            at_s: moment.at.as_secs_f64(),
            speed: moment.telemetry.speed,
            steering: followed.map_or(told, |command| command.steering),
            throttle: moment.telemetry.throttle,
            broken: broken.take(),
        });
    }
    if raw.is_empty() {
        return Err(ClosedLoopError::NoPictures { path: path.to_owned(), telemetries: without });
    }
    Ok(raw)
}

/// What a break means for driving along: where pictures are missing, the times of those that are there decide.
fn cut(broken: Break) -> Option<PathBreak> {
    match broken {
        Break::Gap(apart) => Some(PathBreak::Gap(Some(apart.as_secs_f64()))),
        Break::Back(_) | Break::Joined => Some(PathBreak::Gap(None)),
        Break::PutBack | Break::TakenOver => Some(PathBreak::Put),
        Break::Unseen(_) => None,
    }
}

/// The rows among these in which the car moves, on a clock that stops while it does not.
fn driven(raw: &[Raw], within: &Range<usize>) -> Vec<PathRow> {
    let mut rows: Vec<PathRow> = Vec::new();
    let mut cut = Some(PathBreak::Begins);
    let mut at_s = 0.0;
    let mut last_s: Option<f64> = None;
    for (index, row) in raw.iter().enumerate().take(within.end).skip(within.start) {
        let apart = last_s.map_or(0.0, |last| row.at_s - last);
        last_s = Some(row.at_s);
        let gap = (apart > GAP_S || (apart <= 0.0 && index > within.start))
            .then_some(PathBreak::Gap((apart > 0.0).then_some(apart)));
        cut = cut.or(row.broken).or(gap);
        if row.speed.get() < STANDS_MPH {
            cut = match cut {
                Some(PathBreak::Stood(rows)) => Some(PathBreak::Stood(rows + 1)),
                Some(PathBreak::Begins) => Some(PathBreak::Begins),
                _ => Some(PathBreak::Stood(1)),
            };
            continue;
        }
        if !rows.is_empty() {
            at_s += if cut.is_some() { FALLBACK_INTERVAL.as_secs_f64() } else { apart };
        }
        let Raw { speed, steering, throttle, .. } = *row;
        rows.push(PathRow { at_s, speed, steering, throttle, cut: cut.take(), index });
    }
    rows
}

#[cfg(test)]
#[path = "recorded_tests.rs"]
mod tests;
