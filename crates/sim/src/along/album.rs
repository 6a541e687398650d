//! Pictures that were taken along a road in any drive and lap, ordered by place.

use std::{collections::VecDeque, path::Path};

use glam::DVec3;

use super::{
    ClosedLoopError,
    nearest::{Taken, When, light},
    recorded::read_stock,
    warp::Beside,
};
use crate::locate::LocatedDrive;
use lapwing_core::{
    motion::around,
    perception::Frame,
    recording::{Picture, Recording},
};

/// How many moments' pictures are kept in memory: a car at rest asks for the same dozen at most, again and again.
const LOADED: usize = 48;

/// A moment's pictures, and where they were taken.
#[derive(Debug)]
pub(super) struct View {
    pub when: When,
    /// Metres along the road, in the direction in which it is driven here.
    pub s_m: f64,
    /// The car's place in the world, without its height, and its yaw.
    pub at: (DVec3, f64),
    pub pictures: [Option<Picture>; 3],
}

/// The moments of drives along a road, in the order of their places.
#[derive(Debug, Default)]
pub(super) struct Album {
    length_m: f64,
    views: Vec<View>,
    /// The pictures that were read last.
    loaded: VecDeque<(usize, [Option<Frame>; 3])>,
    /// How many pictures could not be used, and why the first of them could not.
    unusable: (u32, Option<String>),
}

impl Album {
    /// The pictures of a road of this length.
    pub(super) fn new(length_m: f64, mut views: Vec<View>) -> Self {
        views.sort_by(|a, b| a.s_m.total_cmp(&b.s_m));
        Self { length_m, views, ..Self::default() }
    }

    pub(super) fn views(&self) -> &[View] {
        &self.views
    }

    pub(super) fn unusable(&self) -> &(u32, Option<String>) {
        &self.unusable
    }

    /// The moments within `reach_m` of a place along the road, and where the car that is `here` is beside each of them.
    pub(super) fn near(
        &self,
        here: (DVec3, f64),
        s_m: f64,
        reach_m: f64,
    ) -> impl Iterator<Item = (usize, Taken)> + use<'_> {
        let range = if s_m < reach_m || s_m > self.length_m - reach_m {
            0..self.views.len() // around the start
        } else {
            let first = self.views.partition_point(|view| view.s_m < s_m - reach_m);
            first..self.views.partition_point(|view| view.s_m <= s_m + reach_m)
        };
        range.filter_map(move |i| {
            let view = self.views.get(i).filter(|view| around(view.s_m - s_m, self.length_m).abs() <= reach_m)?;
            let cameras = view.pictures.each_ref().map(Option::is_some);
            Some((i, Taken { when: view.when, beside: Beside::between(here, view.at), cameras }))
        })
    }

    /// Why no centre camera's picture can be used, if that is so: of the first of them.
    pub(super) fn why_blank(&self) -> Option<String> {
        let mut frame = Frame::default();
        let mut centre = self.views.iter().filter_map(|view| view.pictures[0].as_ref());
        let first = read_stock(centre.next()?, &mut frame).err()?;
        centre.all(|picture| read_stock(picture, &mut frame).is_err()).then_some(first)
    }

    /// Reads the pictures of a moment, unless they were read lately, and says how light the centre camera's is; `None` if that
    /// cannot be used.
    pub(super) fn load(&mut self, i: usize) -> Option<f64> {
        if self.frames(i).is_none() {
            let unusable = &mut self.unusable;
            let frames = self.views.get(i)?.pictures.each_ref().map(|picture| {
                let mut frame = Frame::default();
                match read_stock(picture.as_ref()?, &mut frame) {
                    Ok(()) => Some(frame),
                    Err(why) => {
                        unusable.0 += 1;
                        unusable.1.get_or_insert(why);
                        None
                    }
                }
            });
            self.loaded.push_back((i, frames));
            if self.loaded.len() > LOADED {
                self.loaded.pop_front();
            }
        }
        self.frames(i)?[0].map(light)
    }

    /// The pictures of a moment that was loaded.
    pub(super) fn frames(&self, i: usize) -> Option<[Option<&Frame>; 3]> {
        self.loaded.iter().find_map(|(at, frames)| (*at == i).then(|| frames.each_ref().map(Option::as_ref)))
    }
}

/// The moments of a drive for whose row `s_m` gives a place along the road.
///
/// # Errors
/// Those of reading the recording; pictures are read later.
pub(super) fn read(
    number: usize,
    path: &Path,
    drive: &LocatedDrive,
    s_m: impl Fn(usize) -> Option<f64>,
) -> Result<Vec<View>, ClosedLoopError> {
    let mut views = vec![];
    for (row, (moment, place)) in Recording::open(path)?.seen().zip(&drive.places).enumerate() {
        let (moment, Some(located), Some(s_m)) = (moment?, place, s_m(row)) else { continue };
        views.push(View {
            when: When { drive: number, row },
            s_m,
            at: located.pose.in_world(&drive.track),
            pictures: moment.pictures,
        });
    }
    Ok(views)
}
