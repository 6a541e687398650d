//! Roads from above, for the map, and where on them a car seems to be that reports no position.

use std::sync::Arc;

use serde::Serialize;

use super::moment::Moment;
use lapwing_core::motion::{Motion, curvature};
use lapwing_core::units::MPS_PER_MPH;
use lapwing_score::{
    odometry::{Matcher, Road, SURE},
    score::page::Outline,
};

/// A road as a page draws it.
#[derive(Debug, Clone, Serialize)]
pub struct Course {
    /// Its name.
    pub name: String,
    /// Its edges.
    #[serde(flatten)]
    pub outline: Outline,
    /// The line to drive, closed, evenly spaced: x and z in metres.
    pub line: Vec<[f32; 2]>,
    /// The same road, on which cars are located that report no position: in its own direction, and the other way round.
    #[serde(skip)]
    pub ways: [Arc<Road>; 2],
}

/// Where a car is on the map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Place {
    /// x and z, in metres.
    pub at: [f32; 2],
    /// How far off that may be along the road, one standard deviation in metres; none where the position is told.
    pub off_m: Option<f32>,
}

/// Metres between two estimates.
const EVERY_M: f64 = 4.0;
/// An estimate worse than this, in metres, is none.
const WORST_M: f64 = 60.0;
/// Moments further apart, in seconds, do not tell how the car moved between them.
const APART_S: f64 = 1.0;
/// How far off such a way may be, as a share.
const UNSEEN: f64 = 0.2;
const SEED: u64 = 0;

/// Follows one drive for all pages that look at it.
#[derive(Debug, Default)]
pub(super) struct Located {
    /// Which course the map shows, by its place among the page's.
    pub course: Option<usize>,
    run: u32,
    matcher: Option<Matcher>,
    /// The turn taken last: number, seconds, m/s and curvature.
    last: Option<(u64, f64, f64, f64)>,
    gathered_m: f64,
    place: Option<Place>,
}

impl Located {
    /// Takes a moment; returns where the car is, or seems to be.
    pub fn take(&mut self, courses: &[Course], now: &Moment) -> Option<Place> {
        let turn = now.turn?;
        if let Some(track) = &now.status.track {
            self.course = courses.iter().position(|course| course.name == *track);
        }
        if let Some(at) = turn.at {
            return Some(Place { at, off_m: None });
        }
        if std::mem::replace(&mut self.run, now.status.run) != now.status.run {
            (self.matcher, self.last, self.place, self.gathered_m) = (None, None, None, 0.0);
        }
        if self.last.is_some_and(|(n, ..)| turn.n <= n) {
            return self.place;
        }
        let (Some(mph), Some(steering_deg)) = (turn.speed_mph, turn.steering_deg) else {
            self.last = None;
            return self.place;
        };
        let (mps, bend) = (mph * MPS_PER_MPH, curvature(steering_deg));
        let told = self.course.filter(|_| now.status.track.is_some());
        let matcher = self.matcher.get_or_insert_with(|| {
            let roads = courses.iter().enumerate().filter(|(i, _)| told.is_none_or(|told| told == *i));
            Matcher::new(roads.flat_map(|(_, course)| course.ways.clone()), SEED)
        });
        if let Some((_, t, was_mps, was_bend)) = self.last.replace((turn.n, turn.t, mps, bend)) {
            let (apart, mean) = (turn.t - t, (mps + was_mps) / 2.0);
            let way_m = apart.max(0.0) * mean;
            if apart > APART_S {
                matcher.skip(way_m, UNSEEN * way_m);
            } else {
                matcher.step(Motion { way_m, turn_rad: way_m * (bend + was_bend) / 2.0 });
            }
            self.gathered_m += way_m;
        }
        if self.gathered_m >= EVERY_M {
            self.gathered_m = 0.0;
            let matches = matcher.matches();
            let best = matches.first().filter(|best| {
                let next = matches.get(1);
                best.explains && next.is_none_or(|next| best.evidence - next.evidence > SURE)
            });
            self.place = best.filter(|best| best.place.deviation_m < WORST_M).and_then(|best| {
                let is_best = |course: &Course| course.ways.iter().any(|road| Arc::ptr_eq(road, &best.road));
                let course = courses.iter().position(is_best)?;
                self.course = Some(course);
                let at = courses[course].place(best.road.on_track(best.place.s_m))?;
                Some(Place { at, off_m: Some(best.place.deviation_m as f32) })
            });
        }
        self.place
    }
}

impl Course {
    /// The place on the line this many metres along the road, over any number of laps.
    pub(super) fn place(&self, s: f64) -> Option<[f32; 2]> {
        let count = self.line.len();
        let share = (s / self.ways[0].length_m).rem_euclid(1.0) * count as f64;
        let i = share as usize;
        let (here, next) = (self.line.get(i % count.max(1))?, self.line.get((i + 1) % count)?);
        let part = (share - i as f64) as f32;
        Some([here[0] + part * (next[0] - here[0]), here[1] + part * (next[1] - here[1])])
    }
}
