//! What a car sees anywhere along a known road, from the pictures that recorded drives took there: laps become a world,
//! not a film.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use glam::DVec3;

use super::{
    ClosedLoopError,
    around::{REACH_M, completing},
    recorded::read_stock,
    warp::{Beside, Glimpse, Warp},
};
use crate::{
    camera::Camera,
    locate::LocatedDrive,
    track::{Place, Track},
    vehicle::Car,
    world::Eyes,
};
use lapwing_core::{
    motion::around,
    perception::Frame,
    recording::{Picture, Recording},
};

/// A picture that was taken farther ahead or behind than this shows another piece of road, in metres.
const NEAR_M: f64 = 3.0;
/// What a picture costs that is not taken where the car is: each metre to the side of the nearest camera (what stands up is
/// smeared), each radian of heading (the picture ends), and another drive than the last one's (its places along the road
/// err differently), all as metres along the road.
const ASIDE: f64 = 1.5;
const ASKEW: f64 = 6.0;
const ANOTHER: f64 = 0.5;
/// The pictures of so many moments are kept in memory: a car at rest asks for at most a dozen again and again.
const LOADED: usize = 48;

/// A moment's pictures, and where they were taken.
#[derive(Debug)]
struct View {
    drive: usize,
    /// Metres along the road, in the direction in which it is driven here.
    s_m: f64,
    /// The car's place in the world, without its height, and its yaw.
    at: (DVec3, f64),
    pictures: [Option<Picture>; 3],
}

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

/// The pictures that were taken along a road. It is driven as the recordings were: forwards, or the other way round.
#[derive(Debug)]
pub struct Views {
    track: Arc<Track>,
    views: Vec<View>,
    warp: Warp,
    last: Option<usize>,
    loaded: Loaded,
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
            views.extend(read(i, path, drive, road, reversed)?);
        }
        views.sort_by(|a, b| a.s_m.total_cmp(&b.s_m));
        let track = if reversed { Arc::new(road.reversed()?) } else { road.clone() };
        let (warp, sights) = (Warp::new(), Arc::default());
        let mut views = Self { track, views, warp, last: None, loaded: Loaded::default(), sights };
        if let Some(start_m) = views.start() {
            views.track = Arc::new(Track::clone(&views.track).starting_at(start_m));
        }
        Ok(views)
    }

    /// Where to start, if there is no picture of the track's own start: where the longest recorded piece of road begins.
    fn start(&self) -> Option<f64> {
        let (start, length_m) = (self.track.file().start, self.track.length());
        let start_m = self.track.locate(DVec3::new(start.x, start.y, start.z), None).station.s;
        if self.views.iter().any(|view| around(view.s_m - start_m, length_m).abs() <= NEAR_M) {
            return None;
        }
        let places: Vec<f64> = self.views.iter().map(|view| view.s_m).collect();
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

    /// How many moments it has pictures of.
    pub fn moments(&self) -> usize {
        self.views.len()
    }

    /// The share of the road along which there is a picture near enough.
    pub fn covered(&self) -> f64 {
        let length_m = self.track.length();
        let gap = |(before, after): (f64, f64)| (after - before - 2.0 * NEAR_M).max(0.0);
        let places = self.views.iter().map(|view| view.s_m);
        let around = self.views.first().map(|view| view.s_m + length_m);
        let gaps = places.clone().zip(places.skip(1).chain(around)).map(gap);
        if self.views.is_empty() { 0.0 } else { 1.0 - gaps.sum::<f64>() / length_m }
    }

    /// Counts what is seen, while the world has the views.
    pub fn sights(&self) -> Arc<Mutex<Sights>> {
        self.sights.clone()
    }

    /// Those this near to a place: number, and where the car is beside them.
    fn near(&self, car: &Car, s_m: f64, reach_m: f64) -> impl Iterator<Item = (usize, Beside)> {
        let length_m = self.track.length();
        let range = if s_m < reach_m || s_m > length_m - reach_m {
            0..self.views.len() // around the start
        } else {
            let first = self.views.partition_point(|view| view.s_m < s_m - reach_m);
            first..self.views.partition_point(|view| view.s_m <= s_m + reach_m)
        };
        let here = (car.position, car.yaw);
        range.filter_map(move |i| {
            let view = self.views.get(i).filter(|view| around(view.s_m - s_m, length_m).abs() <= reach_m)?;
            Some((i, Beside::between(here, view.at)))
        })
    }

    /// Those that show the piece of road that the car is on, the best first.
    fn best(&self, car: &Car, s_m: f64) -> Vec<(usize, Beside)> {
        let last = self.last.and_then(|last| self.views.get(last)).map(|view| view.drive);
        let judged = |(i, beside): (usize, Beside)| {
            let view = self.views.get(i)?;
            let there = [Camera::CENTER, Camera::LEFT, Camera::RIGHT].into_iter().zip(&view.pictures);
            let asides = there
                .filter_map(|(camera, picture)| picture.as_ref().map(|_| beside.offset_m - camera.mount.position.x));
            let aside = asides.map(f64::abs).fold(f64::INFINITY, f64::min);
            let another = if last.is_some_and(|last| last != view.drive) { ANOTHER } else { 0.0 };
            let cost = beside.ahead_m.abs() + ASIDE * aside + ASKEW * beside.heading_rad.abs() + another;
            cost.is_finite().then_some((cost, (i, beside)))
        };
        let mut near: Vec<_> = self.near(car, s_m, NEAR_M).filter_map(judged).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.into_iter().map(|(_, view)| view).collect()
    }

    /// The views that are shown to this car: the best one whose pictures can be read, and those that complete it.
    fn shown(&mut self, car: &Car, s_m: f64, sights: &mut Sights) -> Option<Vec<(usize, Beside)>> {
        let best = self.best(car, s_m).into_iter().find(|(i, _)| self.loaded.load(*i, &self.views, sights))?;
        let others: Vec<_> = self.near(car, s_m, REACH_M).filter(|(i, _)| *i != best.0).collect();
        let others =
            completing(others.into_iter()).into_iter().filter(|(i, _)| self.loaded.load(*i, &self.views, sights));
        Some(std::iter::once(best).chain(others).collect())
    }
}

/// The pictures that were read last.
#[derive(Debug, Default)]
struct Loaded(VecDeque<(usize, [Option<Frame>; 3])>);

impl Loaded {
    /// Reads the pictures of a view, unless they were read lately. Returns whether there is one of its centre camera.
    fn load(&mut self, i: usize, views: &[View], sights: &mut Sights) -> bool {
        if self.frames(i).is_none() {
            let frames = views[i].pictures.each_ref().map(|picture| {
                let mut frame = Frame::default();
                match read_stock(picture.as_ref()?, &mut frame) {
                    Ok(()) => Some(frame),
                    Err(why) => {
                        sights.unusable.0 += 1;
                        sights.unusable.1.get_or_insert(why);
                        None
                    }
                }
            });
            self.0.push_back((i, frames));
            if self.0.len() > LOADED {
                self.0.pop_front();
            }
        }
        self.frames(i).is_some_and(|frames| frames[0].is_some())
    }

    fn frames(&self, i: usize) -> Option<&[Option<Frame>; 3]> {
        self.0.iter().find_map(|(at, frames)| (*at == i).then_some(frames))
    }
}

impl Eyes for Views {
    fn see(&mut self, car: &Car, place: &Place, frame: &mut Frame) -> bool {
        let sights = self.sights.clone();
        let mut sights = sights.lock().unwrap_or_else(PoisonError::into_inner);
        let s_m = place.station.s.rem_euclid(self.track.length());
        let shown = self.shown(car, s_m, &mut sights).unwrap_or_default();
        let glimpse = |(i, beside): &(usize, Beside)| {
            let pictures = self.loaded.frames(*i)?.each_ref().map(Option::as_ref);
            Some(Glimpse { pictures, beside: *beside })
        };
        let glimpses: Vec<Glimpse<'_>> = shown.iter().filter_map(glimpse).collect();
        let filled = self.warp.render(&glimpses, frame);
        self.last = filled.and(shown.first()).map(|(i, _)| *i);
        let (Some(filled), Some((_, beside))) = (filled, shown.first()) else {
            sights.drawn += 1;
            return false;
        };
        sights.recorded += 1;
        sights.apart_m += beside.offset_m.hypot(beside.ahead_m);
        sights.filled = (sights.filled.0 + filled, sights.filled.1.max(filled));
        true
    }
}

/// The moments of a drive that are located and driven in the given direction.
fn read(
    number: usize,
    path: &Path,
    drive: &LocatedDrive,
    road: &Track,
    reversed: bool,
) -> Result<Vec<View>, ClosedLoopError> {
    let seen = Recording::open(path)?.seen();
    let mut views = vec![];
    for (moment, place) in seen.zip(&drive.places) {
        let (moment, Some(located)) = (moment?, place) else { continue };
        let pose = located.pose;
        if (pose.direction() < 0.0) != reversed {
            continue;
        }
        let s_m = if reversed { -pose.s_m } else { pose.s_m };
        views.push(View {
            drive: number,
            s_m: s_m.rem_euclid(road.length()),
            at: pose.in_world(road),
            pictures: moment.pictures,
        });
    }
    Ok(views)
}
