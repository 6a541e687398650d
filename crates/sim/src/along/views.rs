//! What a car sees anywhere along a known road, from the pictures that recorded drives took there: laps become a world,
//! not a film.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use glam::DVec3;

use super::{
    ClosedLoopError,
    album::{self, Album},
    nearest::{Last, NEAR_M, REACH_M, Taken},
    warp::{Glimpse, Warp},
};
use crate::{
    locate::LocatedDrive,
    track::{Place, Track},
    vehicle::Car,
    world::Eyes,
};
use lapwing_core::{motion::around, perception::Frame};

/// How often what was seen came from a recording, and how well.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sights {
    /// Pictures that were taken from a recording.
    pub recorded: u32,
    /// Pictures for which none was recorded near enough: they were drawn.
    pub drawn: u32,
    /// How far the cameras that recorded them were from where they are seen: the sum over the recorded pictures, in metres.
    pub apart_m: f64,
    /// The share of [`PILOTNET_ROWS`](super::PILOTNET_ROWS) that no recorded camera showed: the sum over the recorded
    /// pictures, and the most of one.
    pub filled: (f64, f64),
    /// Recorded pictures that could not be used, and why not, of the first one.
    pub unusable: (u32, Option<String>),
}

impl Sights {
    /// One more recorded picture, and how much was filled in.
    pub(super) fn add(&mut self, taken: &Taken, filled: f64) {
        self.recorded += 1;
        self.apart_m += taken.apart_m();
        self.filled = (self.filled.0 + filled, self.filled.1.max(filled));
    }
}

/// The pictures that were taken along a road. It is driven as the recordings were: forwards, or the other way round.
#[derive(Debug)]
pub struct Views {
    track: Arc<Track>,
    album: Album,
    warp: Warp,
    last: Last,
    sights: Arc<Mutex<Sights>>,
}

impl Views {
    /// Reads where the pictures of these drives are. All must be located on `road`; what was driven the other way round than
    /// `reversed` says is left out. The track that is driven is then the [reversed](Track::reversed) one.
    ///
    /// # Errors
    /// [`ClosedLoopError::Recording`]; [`ClosedLoopError::Track`] if the road cannot be driven the other way round.
    pub fn open(
        road: &Arc<Track>,
        reversed: bool,
        drives: &[(PathBuf, LocatedDrive)],
    ) -> Result<Self, ClosedLoopError> {
        let mut views = vec![];
        for (i, (path, drive)) in drives.iter().enumerate() {
            let along_m = |row: usize| {
                let pose = drive.places[row]?.pose;
                let s_m = if reversed { -pose.s_m } else { pose.s_m };
                ((pose.direction() < 0.0) == reversed).then(|| s_m.rem_euclid(road.length()))
            };
            views.extend(album::read(i, path, drive, along_m)?);
        }
        let track = if reversed { Arc::new(road.reversed()?) } else { road.clone() };
        let album = Album::new(road.length(), views);
        let mut views = Self { track, album, warp: Warp::new(), last: Last::default(), sights: Arc::default() };
        if let Some(start_m) = views.start() {
            views.track = Arc::new(Track::clone(&views.track).starting_at(start_m));
        }
        Ok(views)
    }

    /// Where to start, if there is no picture of the track's own start: where the longest recorded piece of road begins.
    fn start(&self) -> Option<f64> {
        let (start, length_m) = (self.track.file().start, self.track.length());
        let start_m = self.track.locate(DVec3::new(start.x, start.y, start.z), None).station.s;
        if self.album.views().iter().any(|view| around(view.s_m - start_m, length_m).abs() <= NEAR_M) {
            return None;
        }
        let places: Vec<f64> = self.album.views().iter().map(|view| view.s_m).collect();
        // The pieces twice around, as one may go on past the start.
        let (mut best, mut first, mut last) = ((0.0, *places.first()?), *places.first()?, *places.first()?);
        for place in places.iter().copied().chain(places.iter().map(|place| place + length_m)) {
            if place - last > 2.0 * NEAR_M {
                first = place;
            }
            last = place;
            if last - first > best.0 {
                best = (last - first, first);
            }
        }
        Some(best.1.rem_euclid(length_m))
    }

    /// The road in the direction in which it is driven. If there is no picture of its start, it starts where the longest
    /// recorded piece of it does.
    pub fn track(&self) -> &Arc<Track> {
        &self.track
    }

    /// Why none of the pictures can be used, if that is so: of the first of them.
    pub fn why_blank(&self) -> Option<String> {
        self.album.why_blank()
    }

    /// How many moments it has pictures of.
    pub fn moments(&self) -> usize {
        self.album.views().len()
    }

    /// How many moments of a drive have no picture of a side camera, and how many moments it has. Drives are counted
    /// from 0, in the order in which [`open`](Self::open) was given them.
    pub fn without_side_cameras(&self, drive: usize) -> (usize, usize) {
        let of = self.album.views().iter().filter(|view| view.when.drive == drive);
        let (with, without): (Vec<_>, Vec<_>) = of.partition(|view| view.pictures[1..].iter().any(Option::is_some));
        (without.len(), with.len() + without.len())
    }

    /// The share of the road along which there is a picture near enough.
    pub fn covered(&self) -> f64 {
        let (length_m, views) = (self.track.length(), self.album.views());
        let gap = |(before, after): (f64, f64)| (after - before - 2.0 * NEAR_M).max(0.0);
        let places = views.iter().map(|view| view.s_m);
        let around = views.first().map(|view| view.s_m + length_m);
        let gaps = places.clone().zip(places.skip(1).chain(around)).map(gap);
        if views.is_empty() { 0.0 } else { 1.0 - gaps.sum::<f64>() / length_m }
    }

    /// Counts what is seen, while the world has the views.
    pub fn sights(&self) -> Arc<Mutex<Sights>> {
        self.sights.clone()
    }
}

impl Eyes for Views {
    fn see(&mut self, car: &Car, place: &Place, frame: &mut Frame) -> bool {
        let s_m = place.station.s.rem_euclid(self.track.length());
        let near: Vec<_> = self.album.near((car.position, car.yaw), s_m, REACH_M).collect();
        let shown = self.last.next(&near, |_| true, |i| self.album.load(i));
        let glimpse =
            |(i, taken): &(usize, Taken)| Some(Glimpse { pictures: self.album.frames(*i)?, beside: taken.beside });
        let glimpses: Vec<Glimpse<'_>> = shown.iter().filter_map(glimpse).collect();
        let filled = self.warp.render(&glimpses, frame);
        let mut sights = self.sights.lock().unwrap_or_else(PoisonError::into_inner);
        sights.unusable.clone_from(self.album.unusable());
        let (Some(filled), Some((_, first))) = (filled, shown.first()) else {
            sights.drawn += 1;
            return false;
        };
        sights.add(first, filled);
        true
    }
}
