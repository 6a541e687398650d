//! What the virtual car of a drive along a recording is shown: the nearest picture, warped.
//!
//! The rows before and after the one that is abreast of the car are at hand anyway. Where the car is beside them is known from
//! their places or, for those before, from how the car has moved since. If places are known, pictures of other laps of the
//! recording that show the same place serve as well. Their brightness is never changed: those of a lap that was recorded in
//! other light [are not used](super::nearest).

use std::collections::VecDeque;

use glam::DVec3;

use super::{
    ClosedLoopError, Sights,
    album::{self, Album},
    nearest::{Last, REACH_M, Taken, When, light},
    recorded::{MomentPictures, PathRow, RecordedDrive},
    reel::{ROWS, Reel},
    warp::{Beside, Glimpse, Warp},
};
use crate::locate::{LocatedDrive, Pose};
use lapwing_core::{motion::around, perception::Frame};

/// What the virtual car is shown, and what that was taken from.
pub(super) struct Screen {
    warp: Warp,
    reel: Reel,
    /// The moments whose places the recording shows more than once.
    album: Album,
    /// Where the recorded car was in the rows before, since the path began: row, place and yaw.
    trail: VecDeque<(usize, (DVec3, f64))>,
    last: Last,
    pub picture: Frame,
    pub sights: Sights,
    /// How many of the pictures were taken in another lap than the one that is driven along.
    pub of_another_lap: u32,
}

/// Where pictures come from: a row on the reel, or a moment of the album.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Source {
    Reel(usize),
    Album(usize),
}

impl Screen {
    /// For a drive along these rows.
    ///
    /// # Errors
    /// Those of reading the recording and its first row; why none of the first pictures can be used, if that is so: then there
    /// are probably no others.
    pub(super) fn new(recorded: &mut RecordedDrive, located: Option<&LocatedDrive>) -> Result<Self, ClosedLoopError> {
        let mut reel = Reel::default();
        reel.wind(recorded, 0)?;
        reel.unusable().map_or(Ok(()), Err)?;
        let album = located.map(|drive| seen_again(recorded, drive)).transpose()?.unwrap_or_default();
        Ok(Self {
            warp: Warp::new(),
            reel,
            album,
            trail: VecDeque::new(),
            last: Last::default(),
            picture: Frame::default(),
            sights: Sights::default(),
            of_another_lap: 0,
        })
    }

    /// Loads the rows around this one; rows must be asked for in order.
    ///
    /// # Errors
    /// Those of reading this row.
    pub(super) fn wind(&mut self, recorded: &mut RecordedDrive, row: usize) -> Result<(), ClosedLoopError> {
        self.reel.wind(recorded, row)
    }

    /// The pictures of a row that is loaded.
    pub(super) fn recorded(&self, row: usize) -> Option<&MomentPictures> {
        self.reel.at(row)
    }

    /// Starts again in this row, to which no path leads from the rows before.
    pub(super) fn cut(&mut self, row: &PathRow) {
        self.trail.clear();
        self.last = Last::of(when(row));
    }

    /// Paints what the virtual car sees beside the recorded car of this row, which has come to `place`.
    pub(super) fn paint(
        &mut self,
        rows: &[PathRow],
        row: usize,
        located: Option<&LocatedDrive>,
        (beside, place): (Beside, (DVec3, f64)),
    ) {
        self.trail.push_back((row, place));
        if self.trail.len() > ROWS {
            self.trail.pop_front();
        }
        // The pilot is sent what cannot be used: what was shown before stays.
        let is_unusable = self.reel.at(row).is_some_and(|own| own.unusable.is_some());
        let Some(own) = rows.get(row).map(when).filter(|_| !is_unusable) else { return };
        let pose = located.and_then(|drive| Some((drive, pose(drive, own.row)?)));
        let around = self.around(rows, row, pose, (beside, place));
        // Without a located pose, the road may lie elsewhere in pictures of other rows.
        let leads = |taken: &Taken| taken.when == own || pose.is_some();
        let (reel, album) = (&self.reel, &mut self.album);
        let shown = self.last.next(&around, leads, |source| match source {
            Source::Reel(row) => reel.at(row)?.frames[0].as_ref().map(light),
            Source::Album(i) => album.load(i),
        });
        let pictures = |source| match source {
            Source::Reel(row) => self.reel.at(row).map(MomentPictures::frames),
            Source::Album(i) => self.album.frames(i),
        };
        let glimpse =
            |(source, taken): &(Source, Taken)| Some(Glimpse { pictures: pictures(*source)?, beside: taken.beside });
        let glimpses: Vec<Glimpse<'_>> = shown.iter().filter_map(glimpse).collect();
        let Some((filled, (_, first))) = self.warp.render(&glimpses, &mut self.picture).zip(shown.first()) else {
            return;
        };
        self.of_another_lap += u32::from(!first.when.is_same_lap(own));
        self.sights.add(first, filled);
    }

    /// The moments around the one of this row, whose pose may be known.
    fn around(
        &self,
        rows: &[PathRow],
        row: usize,
        located: Option<(&LocatedDrive, Pose)>,
        (beside, place): (Beside, (DVec3, f64)),
    ) -> Vec<(Source, Taken)> {
        let here = located.map(|(drive, pose)| beside.from(pose.in_world(&drive.track)));
        let beside_row = |other: usize| {
            if other == row {
                return Some(beside);
            }
            if let Some((_, there)) = self.trail.iter().find(|(before, _)| *before == other) {
                return Some(Beside::between(beside.from(place), *there));
            }
            let (drive, _) = located?;
            Some(Beside::between(here?, pose(drive, rows.get(other)?.index)?.in_world(&drive.track)))
        };
        let on_reel = self.reel.around().filter_map(|(other, pictures)| {
            let cameras = pictures.frames.each_ref().map(Option::is_some);
            if !cameras[0] {
                return None;
            }
            let taken = Taken { when: when(rows.get(other)?), beside: beside_row(other)?, cameras };
            Some((Source::Reel(other), taken))
        });
        // A car that is where the recorded one was needs no other picture.
        if beside == Beside::default() {
            return on_reel.filter(|(source, _)| *source == Source::Reel(row)).collect();
        }
        let own = rows.get(row).map(when);
        let places = here.zip(located).map(|(here, (_, pose))| self.album.near(here, pose.s_m, REACH_M));
        let of_another =
            places.into_iter().flatten().filter(|(_, taken)| own.is_some_and(|own| !own.is_same_lap(taken.when)));
        on_reel.chain(of_another.map(|(i, taken)| (Source::Album(i), taken))).collect()
    }
}

fn when(row: &PathRow) -> When {
    When { drive: 0, row: row.index }
}

fn pose(drive: &LocatedDrive, row: usize) -> Option<Pose> {
    Some(drive.places.get(row).copied().flatten()?.pose)
}

/// Those of the rows driven along whose place another lap shows, too.
fn seen_again(recorded: &RecordedDrive, drive: &LocatedDrive) -> Result<Album, ClosedLoopError> {
    let length_m = drive.track.length();
    let known = recorded.rows.iter().filter_map(|row| Some((when(row), pose(drive, row.index)?)));
    let mut known: Vec<(f64, When, f64)> =
        known.map(|(when, pose)| (pose.s_m.rem_euclid(length_m), when, pose.direction())).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let is_again = |at: usize| {
        let (s_m, when, direction) = known[at];
        // Both ways along the road, and on past its start.
        let back = known[..at].iter().rev().chain(known[at..].iter().rev());
        let ahead = known[at..].iter().chain(&known[..at]);
        let is_near = |(other_m, ..): &&(f64, When, f64)| around(other_m - s_m, length_m).abs() <= REACH_M;
        let mut near = back.take_while(is_near).chain(ahead.take_while(is_near));
        near.any(|(_, other, its)| *its == direction && !other.is_same_lap(when))
    };
    let mut again = vec![None; drive.places.len()];
    for at in (0..known.len()).filter(|at| is_again(*at)) {
        let (s_m, when, _) = known[at];
        again[when.row] = Some(s_m);
    }
    if again.iter().all(Option::is_none) {
        return Ok(Album::default());
    }
    Ok(Album::new(length_m, album::read(0, recorded.path(), drive, |row| again[row])?))
}
