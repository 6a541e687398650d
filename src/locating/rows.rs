//! The numbers of a recording: how the car came to each moment that has a picture.

use std::{
    collections::{BTreeMap, HashMap},
    ops::Range,
    path::Path,
};

use glam::DVec3;
use rayon::prelude::*;

use super::pictures::decoded;
use lapwing_core::{
    motion::Motion,
    perception::Frame,
    protocol::Truth,
    recording::{Break, Moment, Picture, Recording, RecordingError, ReleasedAtOnce, released_at_once},
    units::{Degrees, Metres},
};
use lapwing_score::odometry::{Leg, Look, joins};
use lapwing_sim::{
    along::{Pyramid, turn},
    locate::{InLane, Pose},
    track::Track,
};

/// A moment with a picture.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Seconds since the recording began.
    pub at_s: f64,
    /// Which moment of the recording it is.
    pub moment: usize,
    /// Seconds since the row before.
    pub apart_s: f64,
    /// How the car came from there: how it turned is as its pictures show, or where they show nothing, as it was steered.
    pub motion: Motion,
    /// How it turned as it was steered, in radians clockwise.
    pub steered_rad: f64,
    /// Why it does not continue from there.
    pub broken: Option<Break>,
    /// What the recording itself tells of the place, or the table that was given.
    pub truth: Option<RowTruth>,
}

impl Row {
    /// How the car came to it, as the road is found by.
    pub(super) fn leg(&self) -> Leg {
        Leg { motion: self.motion, apart_s: self.apart_s, broken: self.broken }
    }

    /// The same, as it was steered.
    pub(super) fn leg_as_steered(&self) -> Leg {
        let turn_rad = self.steered_rad;
        Leg { motion: Motion { turn_rad, ..self.motion }, ..self.leg() }
    }
}

/// Where the car was, by a simulator that tells it.
#[derive(Debug, Clone, Copy)]
pub struct RowTruth {
    /// Metres to the right of the lane's middle.
    pub offset_m: f64,
    /// Degrees clockwise from the road's direction.
    pub heading_deg: Option<f64>,
    /// In the world.
    pub position: Option<DVec3>,
}

impl RowTruth {
    /// Of a car whose place on a track is known.
    pub fn of_pose(pose: Pose, track: &Track) -> Self {
        let InLane { offset_m, heading_rad, .. } = pose.in_lane(track);
        let position = Some(track.point(pose.s_m, pose.offset_m));
        Self { offset_m, heading_deg: Some(heading_rad.to_degrees()), position }
    }

    fn of(truth: &Truth) -> Option<Self> {
        Some(Self {
            offset_m: truth.cte?.get(),
            heading_deg: truth.heading_error.map(Degrees::get),
            position: truth.position.map(|at| DVec3::from_array(at.map(Metres::get))),
        })
    }
}

/// Rows whose pictures are compared in one go.
const BLOCK: usize = 64;

/// No car on its tyres turns faster, in radians a second.
const FASTEST_TURN: f64 = 1.5;

/// A row, what it looks like if it begins something, and why its picture cannot be looked at.
type Seen = (Row, Option<Look>, Option<String>);

/// What a recording tells before its pictures are laid over a road.
pub(super) struct Rows {
    /// The moments with a picture.
    pub rows: Vec<Row>,
    /// What the first of them looks like, and each that does not continue from the one before.
    pub looks: HashMap<usize, Look>,
    /// Why the pictures of these cannot be looked at.
    pub unreadable: BTreeMap<usize, String>,
    /// How many moments there are in all.
    pub moments: usize,
    /// The moments of the drives that a keyboard steered whose release is at once.
    pub released_at_once: Vec<Range<usize>>,
}

impl Rows {
    pub(super) fn read(path: &Path) -> Result<Self, RecordingError> {
        let mut reader = Reader::open(path)?;
        let mut last: Option<Picture> = None;
        let blocks = std::iter::from_fn(|| {
            let block: Result<Vec<_>, _> = reader.by_ref().take(BLOCK).collect();
            let block = match block {
                Ok(block) if block.is_empty() => return None,
                Ok(block) => block,
                Err(error) => return Some(Err(error)),
            };
            let before = std::mem::replace(&mut last, block.last().map(|(_, picture)| picture.clone()));
            Some(Ok((before, block)))
        });
        let mut blocks: Vec<(usize, Vec<Seen>)> = blocks
            .enumerate()
            .par_bridge()
            .map(|(i, block)| block.map(|(before, block)| (i, turned(before.as_ref(), block))))
            .collect::<Result<_, _>>()?;
        blocks.sort_by_key(|(i, _)| *i);
        let (mut rows, mut looks, mut unreadable) = (vec![], HashMap::new(), BTreeMap::new());
        for (row, look, why) in blocks.into_iter().flat_map(|(_, rows)| rows) {
            looks.extend(look.map(|look| (rows.len(), look)));
            unreadable.extend(why.map(|why| (rows.len(), why)));
            rows.push(row);
        }
        let Reader { moments, released_at_once, .. } = reader;
        let released_at_once = released_at_once.into_iter().map(|drive| drive.rows).collect();
        Ok(Self { rows, looks, unreadable, moments, released_at_once })
    }
}

/// The moments with a picture, without a look at the pictures: the turning follows from the steering.
pub(super) fn by_steering(path: &Path) -> Result<Vec<Row>, RecordingError> {
    Reader::open(path)?.map(|seen| Ok(seen?.0)).collect()
}

/// Rows whose turning comes from their pictures, where they show it, and what those look like that begin something.
fn turned(before: Option<&Picture>, block: Vec<(Row, Picture)>) -> Vec<Seen> {
    let mut frame = Frame::default();
    let mut seen = |picture: &Picture, begins: bool| match decoded(Some(picture), &mut frame) {
        Ok(()) => (Pyramid::of(&frame), if begins { Look::of(&frame) } else { None }, None),
        Err(why) => (None, None, Some(why)),
    };
    let mut continues = before.is_some();
    let mut before = before.and_then(|picture| seen(picture, false).0);
    let turned = block.into_iter().map(|(mut row, picture)| {
        continues &= row.broken.is_none();
        let (now, look, why) = seen(&picture, !continues);
        let pair = before.as_ref().zip(now.as_ref()).filter(|_| continues);
        let turn = pair.and_then(|(before, now)| turn(before, now, row.motion.way_m)).map(|turn| turn.yaw);
        if let Some(turn_rad) = turn.filter(|turn| turn.abs() < FASTEST_TURN * row.apart_s) {
            row.motion.turn_rad = turn_rad;
        }
        (before, continues) = (now, true);
        (row, look, why)
    });
    turned.collect()
}

/// What happened since the last moment that has a picture.
#[derive(Default)]
struct Carried {
    motion: Motion,
    broken: Option<Break>,
    last_s: f64,
}

/// Reads the moments with a picture one by one.
struct Reader {
    recording: Recording,
    moments: usize,
    before: Option<Moment>,
    carried: Carried,
    released_at_once: Vec<ReleasedAtOnce>,
}

impl Reader {
    fn open(path: &Path) -> Result<Self, RecordingError> {
        let released_at_once = released_at_once(Recording::open(path)?, joins)?;
        let recording = Recording::open(path)?;
        Ok(Self { recording, moments: 0, before: None, carried: Carried::default(), released_at_once })
    }
}

impl Iterator for Reader {
    type Item = Result<(Row, Picture), RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let mut moment = match self.recording.next()? {
                Ok(moment) => moment,
                Err(error) => return Some(Err(error)),
            };
            self.moments += 1;
            let Carried { motion, broken, last_s } = &mut self.carried;
            if let Some(before) = &self.before {
                let keys = self.released_at_once.iter().find(|drive| drive.rows.contains(&moment.row));
                let more = moment.motion_from(before, keys);
                motion.way_m += more.way_m;
                motion.turn_rad += more.turn_rad;
            }
            *broken = moment.broken.filter(|broken| !matches!(broken, Break::Unseen(_))).or(*broken);
            // The picture would keep its part of the file in memory.
            let [picture, ..] = std::mem::take(&mut moment.pictures);
            let seen = match picture {
                Some(picture @ (Picture::File(_) | Picture::Jpeg(_))) => {
                    let at_s = moment.at.as_secs_f64();
                    let apart_s = (at_s - *last_s).max(0.0);
                    *last_s = at_s;
                    let (motion, broken) = (std::mem::take(motion), broken.take());
                    let truth = RowTruth::of(&moment.telemetry.truth);
                    let (moment, steered_rad) = (moment.row, motion.turn_rad);
                    Some((Row { at_s, moment, apart_s, motion, steered_rad, broken, truth }, picture))
                }
                _ => None,
            };
            self.before = Some(moment);
            if let Some(seen) = seen {
                return Some(Ok(seen));
            }
        }
    }
}
