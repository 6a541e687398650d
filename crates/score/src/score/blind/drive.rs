//! One drive of a run: what is kept of it until the run ends, and what is found from that.

use std::{collections::BTreeSet, ops::Range, sync::Arc};

use bytes::Bytes;

use super::passage::{DistanceLog, way_to};
use crate::{
    odometry::{
        BEGINNING_M, BENDS_M, EVERY_M, Found, Leg, Look, Match, PLAUSIBLE_WAY, Road, SURE, Tried, find, is_nearly, laps,
    },
    score::{
        drives::{DriveFound, OnRoad, RoadTried, Turned},
        scorer::UNTIMED_LOG,
    },
};
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    recording::Break,
};

/// Steering that explains a drive this well, as a log likelihood for each 10 m, is as good as pictures: steering that is geared
/// 0.7 to 1.4 times as ours named a wrong road on real recordings, each time with -1.2 or less.
const STEERED: f64 = -1.0;
/// Error of odometry at its best, and additional error if the driver weaves, in metres.
pub(super) const NEAR_M: f64 = 3.0;
const WEAVING_M: f64 = 6.0;
/// How many metres of uncertainty may complete a lap by themselves, and how far from the expected places the ends of
/// laps are looked for, at least and at most.
const SURELY_M: f64 = 20.0;
const SEARCH_M: (f64, f64) = (30.0, 80.0);

/// So many standard deviations the way along a road may be off besides.
const DEVIATIONS: f64 = 2.0;

/// How much longer or shorter one lap of an unknown road may be than another, as a share.
const UNEVEN: f64 = 0.08;

const BENDS: &str = "bends driven, matched with known roads";
const SEEN_AGAIN: &str = "pictures of the drive's beginning, seen again";

/// What is kept of a drive.
#[derive(Debug, Clone, Default)]
pub(super) struct Drive {
    /// When it began, in seconds, and the metres of the run driven until then.
    pub began_s: f64,
    pub from_m: f64,
    /// Its first and its last telemetry, counted over the run.
    first: usize,
    last: usize,
    /// Each leg, and the telemetry that it leads to.
    legs: Vec<(usize, Leg)>,
    /// What its first picture looks like.
    has_looked: bool,
    start: Option<Look>,
    /// JPEGs by the metres of this drive until then.
    pictures: Vec<(f64, Bytes)>,
    newest: Option<(f64, Bytes)>,
    /// Whether its times are assumed, so that nobody knows how far it went.
    pub is_untimed: bool,
}

/// What is found of a drive.
#[derive(Debug)]
pub(super) struct Placed {
    pub told: DriveFound,
    /// Length of a lap in metres, metres driven along it, how far off the latter may be, and the source.
    pub way: Option<(f64, f64, f64, &'static str)>,
    pub laps: Option<u32>,
    /// Whether the count of laps may be off by one.
    pub laps_unsure: bool,
    pub lap_times_s: Vec<f64>,
    /// How far off they may be, in seconds.
    pub lap_times_off_s: Option<f64>,
    /// Times and places along the track.
    pub whereabouts: Vec<(f64, f64)>,
}

impl Drive {
    pub fn begin(at: f64, from_m: f64, telemetry: usize) -> Self {
        Self { began_s: at, from_m, first: telemetry, last: telemetry, ..Self::default() }
    }

    pub fn leg(&mut self, telemetry: usize, leg: Leg) {
        self.last = telemetry;
        self.legs.push((telemetry, leg));
    }

    /// Takes the picture that belongs to so many metres of the run.
    pub fn frame(&mut self, way_m: f64, jpeg: &Bytes) {
        let way_m = way_m - self.from_m;
        if !std::mem::replace(&mut self.has_looked, true) && way_m < NEAR_M {
            self.start = look(jpeg, &mut Frame::default());
        }
        let apart = if way_m < BEGINNING_M { 1.0 } else { EVERY_M };
        if self.pictures.last().is_none_or(|(way, _)| way_m - way >= apart) {
            // A copy, as the original would keep a whole chunk of the file in memory.
            self.pictures.push((way_m, Bytes::copy_from_slice(jpeg)));
            self.newest = None;
        } else {
            self.newest = Some((way_m, jpeg.clone()));
        }
    }

    /// Things kept of telemetries and pictures.
    #[cfg(test)]
    pub fn kept(&self) -> usize {
        self.pictures.len() + self.legs.len()
    }

    /// The roads that it may have been on, by its legs as they are.
    pub fn find(&self, roads: &[Arc<Road>]) -> Found {
        if self.is_untimed {
            return Found::default();
        }
        let legs: Vec<Leg> = self.legs.iter().map(|(_, leg)| *leg).collect();
        find(&legs, self.start.as_ref(), roads)
    }

    /// Whether how the car turned by its pictures may tell more of its road than how it was steered.
    pub fn may_turn_otherwise(&self, found: &Found) -> bool {
        let is_certain = found.sure().is_some_and(|on| on.fit() > STEERED);
        !self.is_untimed && !is_certain && (found.by_start || self.way_m() > BENDS_M)
    }

    /// Turns as the pictures show, in place of the steering, where they show it. Returns whether they do anywhere.
    pub fn turn(&mut self, turns: &[Turned]) -> bool {
        let mut turned = false;
        let mut from = turns.partition_point(|turned| turned.to <= self.first);
        let mut next = 0;
        while let Some(Turned { after, to, turn_rad }) =
            turns.get(from).copied().filter(|turned| turned.to <= self.last)
        {
            from += 1;
            let start = next + self.legs[next..].partition_point(|(telemetry, _)| *telemetry <= after);
            next = start + self.legs[start..].partition_point(|(telemetry, _)| *telemetry <= to);
            let legs: &mut [(usize, Leg)] = &mut self.legs[start..next];
            let way_m: f64 = legs.iter().map(|(_, leg)| leg.motion.way_m).sum();
            if way_m <= 0.0 {
                continue;
            }
            for (_, leg) in legs {
                leg.motion.turn_rad = turn_rad * leg.motion.way_m / way_m;
                turned = true;
            }
        }
        turned
    }

    fn way_m(&self) -> f64 {
        // The sum of nothing is -0.
        self.legs.iter().fold(0.0, |way_m, (_, leg)| way_m + leg.motion.way_m)
    }

    /// The looks of the pictures at these places; pictures that cannot be decoded are skipped.
    fn looks(&self, at: impl Fn(f64) -> bool) -> Vec<(f64, Look)> {
        let mut frame = Frame::default();
        let pictures = self.pictures.iter().filter(|(way, _)| at(*way));
        pictures.filter_map(|(way, jpeg)| Some((*way, look(jpeg, &mut frame)?))).collect()
    }

    /// The road that was driven, or why it is unknown.
    fn road(&self, found: &Found) -> Result<Match, String> {
        let way_m = self.way_m();
        if self.is_untimed {
            return Err(UNTIMED_LOG.to_owned());
        }
        if !found.tried.is_empty() && !found.by_start && way_m <= BENDS_M {
            return Err(format!("{way_m:.0} m tell too little, {BENDS_M} m are needed"));
        }
        let best = found.road().map_err(|why| match found.tried.first() {
            Some(nearest) if found.likely.is_empty() && is_nearly(way_m, nearest.fit) => {
                format!("{why}: a longer recording may tell, or it was on another road: add that with --track")
            }
            _ => why,
        })?;
        let legs: Vec<Leg> = self.legs.iter().map(|(_, leg)| *leg).collect();
        let best = best.clone().counted_from_its_start(found.by_start, &legs);
        // Across a gap the car goes on, and its speed is not known.
        let is_whole = legs.iter().all(|leg| leg.broken.is_none_or(|broken| matches!(broken, Break::Unseen(_))));
        let (gone_m, off_m) = (best.place.progress_m, DEVIATIONS * best.place.deviation_m);
        let is_plausible =
            gone_m + off_m >= PLAUSIBLE_WAY.start() * way_m && gone_m - off_m <= PLAUSIBLE_WAY.end() * way_m;
        if is_whole && way_m > BENDS_M && !is_plausible {
            let (road, times) = (best.road.words(), gone_m / way_m);
            return Err(format!(
                "its bends fit {road}, but there it would have gone {times:.2} times as far as its speed says: if it was on another \
                 road, add that with --track"
            ));
        }
        if best.fit() > STEERED {
            return Ok(best);
        }
        // Bends that are alike are not enough: the way around a road is as long as the road.
        let lap_m = lap_m(&best, way_m);
        let once_around = self.looks(|way| way <= lap_m + SEARCH_M.1 + BEGINNING_M);
        match laps(&once_around).first().filter(|way| (*way - lap_m).abs() >= SEARCH_M.1) {
            Some(way) => {
                let road = best.road.words();
                Err(format!(
                    "it came back to its beginning after {way:.0} m, by its speed a lap of {road} is {lap_m:.0} m"
                ))
            }
            None => Ok(best),
        }
    }

    /// Where it was, on this of the roads that it may have been on.
    pub fn placed(&mut self, found: &Found, by_pictures: bool, clock: &DistanceLog) -> Placed {
        self.pictures.extend(self.newest.take()); // a lap may end with the drive
        let on = self.road(found);
        let told = DriveFound {
            moments: (self.first, self.last),
            way_m: (!self.is_untimed || self.legs.is_empty()).then(|| self.way_m()),
            turned_by: if by_pictures { "pictures" } else { "steering" },
            on: None,
            unknown: on.as_ref().err().cloned(),
            roads: found.tried.iter().map(RoadTried::of).collect(),
        };
        match on {
            Ok(on) => self.along(&on, told, clock),
            Err(_) if self.is_untimed => Placed::nowhere(told),
            Err(_) => self.around(told, clock),
        }
    }

    /// On an unknown road: the length of a lap is unknown until the beginning is seen again.
    fn around(&self, told: DriveFound, clock: &DistanceLog) -> Placed {
        let mut seen = laps(&self.looks(|_| true));
        // What comes again now and then, and not a lap after a lap, only resembles the beginning.
        let is_lap = |(i, way): (usize, &f64)| (way / seen[0] - (i + 1) as f64).abs() < UNEVEN * (i + 1) as f64;
        let way_m = self.way_m();
        let is_all = seen.first().is_some_and(|lap_m| way_m < lap_m * (seen.len() as f64 + 1.0) * (1.0 + UNEVEN));
        if !(is_all && seen.iter().enumerate().all(is_lap)) {
            seen.clear();
        }
        let way = seen.first().map(|lap_m| (*lap_m, way_m, NEAR_M, SEEN_AGAIN));
        let (laps, whereabouts) = ((!seen.is_empty()).then_some(seen.len() as u32), vec![]);
        let lap_times_s = self.lap_times(&seen, clock);
        let lap_times_off_s =
            way.and_then(|(length_m, ..)| longest(&lap_times_s).map(|time_s| time_s * NEAR_M / length_m));
        Placed { told, way, laps, laps_unsure: false, lap_times_s, lap_times_off_s, whereabouts }
    }

    /// On a known road.
    fn along(&self, on: &Match, told: DriveFound, clock: &DistanceLog) -> Placed {
        let (length_m, progress_m) = (on.road.length_m, on.place.progress_m.max(0.0));
        let near = |deviation_m: f64| (2.0 * deviation_m).hypot(WEAVING_M);
        let near_m = near(on.place.deviation_m).min(length_m / 2.0);
        let search_m = (3.0 * near_m).clamp(SEARCH_M.0, SEARCH_M.1);
        let counted = ((progress_m + near_m.min(SURELY_M)) / length_m) as u32;
        let from_line = (progress_m - length_m * (progress_m / length_m).round()).abs();
        let way_m = self.way_m();
        let lap_m = lap_m(on, way_m);
        let from_lap = |way: f64| ((way / lap_m) - (way / lap_m).round()).abs() * length_m;
        let expected = |way: f64| way > lap_m / 2.0 && from_lap(way) < search_m + BEGINNING_M;
        let again = laps(&self.looks(|way| way <= BEGINNING_M || expected(way)));
        // Places a little before and after the start may look like it: count one per lap.
        let near_lines = again.into_iter().filter(|way| from_lap(*way) < search_m);
        let seen = near_lines.map(|way| (way / lap_m).round() as u32).collect::<BTreeSet<_>>().len() as u32;
        // If the car has left the road since, it had still driven these.
        let sure = ((on.sure_m / length_m) as u32).max(seen);
        let laps = counted.max(sure);
        let lap_end = |lap: u32| {
            let end_m = f64::from(lap) * length_m;
            // A lap that is counted already may seem to end just after the drive's end.
            let at_end = || ((end_m - progress_m).abs() <= near_m).then_some((way_m, on.place.deviation_m));
            way_to(end_m, &on.trail).or_else(at_end).map(|(way_m, deviation_m)| (way_m, near(deviation_m)))
        };
        let ends: Vec<(f64, f64)> = (1..=laps).map(lap_end).collect::<Option<_>>().unwrap_or_default();
        let unseen_s = |(end_m, off_m): &(f64, f64)| clock.left_out_near(self.from_m + end_m, *off_m);
        let unseen_s = ends.iter().map(unseen_s).fold(0.0, f64::max);
        let (ends_m, off_m): (Vec<_>, Vec<_>) = ends.into_iter().unzip();
        let lap_times_s = self.lap_times(&ends_m, clock);
        let off_m = off_m.into_iter().fold(0.0, f64::max);
        let lap_times_off_s = longest(&lap_times_s).map(|time_s| time_s * off_m / length_m + unseen_s);
        let within = self.from_m..self.from_m + way_m;
        let road = OnRoad {
            track: on.road.name.clone(),
            reversed: on.road.reversed,
            clockwise: on.road.is_clockwise(),
            laps: progress_m / length_m,
            laps_uncertainty: near_m / length_m,
        };
        Placed {
            way: Some((length_m, progress_m, near_m, BENDS)),
            laps: Some(laps),
            laps_unsure: from_line < near_m && sure < counted,
            lap_times_s,
            lap_times_off_s,
            whereabouts: self.whereabouts(on, within, clock),
            told: DriveFound { on: Some(road), ..told },
        }
    }

    /// The times of laps that ended after so many metres of the drive.
    fn lap_times(&self, ends_m: &[f64], clock: &DistanceLog) -> Vec<f64> {
        let ends_m: Vec<f64> = ends_m.iter().map(|way_m| self.from_m + way_m).collect();
        clock.laps(self.began_s, &ends_m)
    }

    /// Times, and places along the track in its own direction.
    fn whereabouts(&self, on: &Match, within: Range<f64>, clock: &DistanceLog) -> Vec<(f64, f64)> {
        let length_m = on.road.length_m;
        let mut trail = on.trail.clone();
        trail.iter_mut().for_each(|stone| stone.way_m += self.from_m);
        let places = clock.whereabouts(&trail, within, length_m).into_iter();
        places.map(|(at, s_m)| (at, on.road.on_track(s_m))).collect()
    }
}

impl Placed {
    /// A drive of which no more is found.
    fn nowhere(told: DriveFound) -> Self {
        let (lap_times_s, whereabouts) = (vec![], vec![]);
        Self { told, way: None, laps: None, laps_unsure: false, lap_times_s, lap_times_off_s: None, whereabouts }
    }

    /// Whether no known road explains it, but the nearest may be the one all the same.
    pub fn is_nearly_known(&self) -> bool {
        let DriveFound { way_m, on, roads, .. } = &self.told;
        let nearest = roads.first().filter(|_| on.is_none() && !roads.iter().any(|road| road.explains));
        nearest.zip(*way_m).is_some_and(|(nearest, way_m)| is_nearly(way_m, nearest.fit))
    }
}

/// Length of a lap as measured by the reported speeds.
fn lap_m(on: &Match, way_m: f64) -> f64 {
    on.road.length_m * if on.place.progress_m > 0.0 { way_m / on.place.progress_m } else { 1.0 }
}

fn longest(times_s: &[f64]) -> Option<f64> {
    times_s.iter().copied().reduce(f64::max)
}

impl RoadTried {
    fn of(tried: &Tried) -> Self {
        let Tried { road, fit, behind, explains } = tried;
        let is_near = *behind <= SURE;
        Self {
            track: road.name.clone(),
            reversed: road.reversed,
            fit: *fit,
            behind: *behind,
            explains: *explains,
            is_near,
        }
    }
}

/// The look of a picture, which is decoded into `frame`; `None` if it cannot be.
fn look(jpeg: &[u8], frame: &mut Frame) -> Option<Look> {
    decode_jpeg(jpeg, frame).ok()?;
    Look::of(frame)
}
