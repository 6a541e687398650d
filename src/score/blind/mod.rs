//! What a run was worth that tells neither position nor collisions: the stock build's.
//!
//! | figure | from |
//! |---|---|
//! | track, completion, laps | speed and steering on known roads ([`Matcher`]), the look of their starts, and the look of the drive's own beginning ([`laps`]) |
//! | collisions, stuck, survival | speeds that the car cannot reach by itself (`impacts`) |
//!
//! `cargo run --release --example blind` holds all of it against the judge of simulated runs.

mod impacts;

use std::{collections::BTreeSet, sync::Arc};

use bytes::Bytes;

use self::impacts::Impacts;
use super::{Figure, Measure, card::Figures};
use crate::{
    config::Rules,
    odometry::{BEGINNING_M, EVERY_M, Look, Match, Matcher, Motion, Road, laps},
    perception::{Frame, decode_jpeg},
    units::WHEELBASE_M,
};

/// Telemetries further apart than this, in seconds, tell no way between them.
const GAP_S: f64 = 1.0;
/// A road is the one that was driven where it explains the drive better than all others by so much, as a log likelihood:
/// 150 to 1.
const SURE: f64 = 5.0;
/// Where no picture tells the start, metres of road that it takes to know one by its bends.
const BENDS_M: f64 = 250.0;
/// Metres that odometry is off at its best, and that it may be off besides where the driver weaves.
const NEAR_M: f64 = 3.0;
const WEAVING_M: f64 = 6.0;
/// How many metres of uncertainty may make a lap by themselves, and how far from where they are expected laps are looked
/// for, at least and at most.
const SURELY_M: f64 = 20.0;
const SEARCH_M: (f64, f64) = (30.0, 80.0);
/// Of ten collisions nine are found, and of ten found ones nine are collisions: the example `blind`.
const IN_TEN: f64 = 0.1;

/// Of the particles; the same run has the same scorecard.
const SEED: u64 = 0;

const UNKNOWN_ROAD: &str = "the run tells no position, and no known road explains it: --track names more of them";
const NO_LAP: &str = "the run tells no position, no known road explains it, and no picture shows its beginning again";

/// Watches a run as someone who knows the roads, and sees nothing but what the stock build tells.
#[derive(Debug, Clone, Default)]
pub(super) struct Blind {
    /// Laps that were asked for.
    pub laps_asked: Option<u32>,
    roads: Vec<Arc<Road>>,
    /// None where nobody asks for what is not told.
    matcher: Option<Matcher>,
    /// The first picture was looked at, and it showed a known start.
    has_looked: bool,
    is_anchored: bool,
    /// Seconds, m/s and 1/m.
    last: Option<(f64, f64, f64)>,
    way_m: f64,
    /// Metres driven until the first collision, or until it was stuck.
    unhurt_m: Option<f64>,
    /// JPEGs by the metres driven until then.
    pictures: Vec<(f64, Bytes)>,
    newest: Option<(f64, Bytes)>,
    impacts: Impacts,
}

/// What was found.
#[derive(Debug)]
struct Found {
    track: Option<String>,
    /// Metres once around, metres driven of them, how far off the latter may be, and what says so.
    way: Option<(f64, f64, f64, &'static str)>,
    laps: Option<u32>,
    /// Whether a lap more or less is possible.
    laps_unsure: bool,
}

impl Blind {
    pub fn new(roads: &[Arc<Road>], laps_asked: Option<u32>) -> Self {
        let matcher = Some(Matcher::new(roads.iter().cloned(), SEED));
        Self { matcher, roads: roads.into(), laps_asked, ..Self::default() }
    }

    pub fn telemetry(&mut self, at: f64, mps: f64, steering_deg: f64) {
        self.impacts.speed(at, mps);
        let curvature = steering_deg.to_radians().tan() / WHEELBASE_M;
        if let Some((before, was_mps, was_curvature)) = self.last.filter(|(before, ..)| at - before <= GAP_S) {
            let way_m = (at - before) * (mps + was_mps) / 2.0;
            self.way_m += way_m;
            let turn_rad = way_m * (curvature + was_curvature) / 2.0;
            if let Some(matcher) = &mut self.matcher {
                matcher.step(Motion { way_m, turn_rad });
            }
        }
        self.last = Some((at, mps, curvature));
        if self.unhurt_m.is_none() && self.impacts.any() {
            self.unhurt_m = Some(self.way_m);
        }
    }

    /// What the last telemetry gives to suspect, once, if anybody asks.
    pub fn suspicion(&mut self) -> Option<&'static str> {
        self.impacts.suspicion.take().filter(|_| self.matcher.is_some())
    }

    pub fn command(&mut self, throttle: f64) {
        self.impacts.command(throttle);
    }

    pub fn frame(&mut self, jpeg: &Bytes) {
        if self.matcher.is_none() {
            return; // nobody asks
        }
        if !std::mem::replace(&mut self.has_looked, true) {
            self.look_around(jpeg);
        }
        let apart = if self.way_m < BEGINNING_M { 1.0 } else { EVERY_M };
        if self.pictures.last().is_none_or(|(way, _)| self.way_m - way >= apart) {
            // A copy: what it is cut from is a whole chunk of the file.
            self.pictures.push((self.way_m, Bytes::copy_from_slice(jpeg)));
            self.newest = None;
        } else {
            self.newest = Some((self.way_m, jpeg.clone()));
        }
    }

    /// Whether the drive begins where a known road does.
    fn look_around(&mut self, jpeg: &[u8]) {
        let Some(look) = look(jpeg, &mut Frame::default()) else { return };
        let agrees = |road: &&Arc<Road>| road.start.as_ref().map_or(0.0, |start| start.agrees(&look));
        let best = self.roads.iter().max_by(|a, b| agrees(a).total_cmp(&agrees(b)));
        if let Some(road) = best.filter(|road| agrees(road) >= Look::SAME && self.way_m < NEAR_M) {
            self.matcher = Some(Matcher::at_start(road.clone(), SEED));
            self.is_anchored = true;
        }
    }

    /// The looks of the pictures at these places; what cannot be decoded is passed over.
    fn looks(&self, at: impl Fn(f64) -> bool) -> Vec<(f64, Look)> {
        let mut frame = Frame::default();
        let pictures = self.pictures.iter().filter(|(way, _)| at(*way));
        pictures.filter_map(|(way, jpeg)| Some((*way, look(jpeg, &mut frame)?))).collect()
    }

    /// The road that was driven.
    fn road(&mut self) -> Option<Match> {
        let matches = self.matcher.as_mut()?.matches();
        let margin = matches.get(1).map(|second| matches[0].evidence - second.evidence);
        let best = matches.into_iter().next()?;
        let sure = self.is_anchored || (margin.is_none_or(|margin| margin > SURE) && self.way_m > BENDS_M);
        (sure && best.explains).then_some(best)
    }

    fn find(&mut self) -> Found {
        self.pictures.extend(self.newest.take()); // a lap may end with the run
        let Some(on) = self.road() else {
            let seen = laps(&self.looks(|_| true));
            // Until the beginning comes again, nobody knows how long a lap is.
            let lap =
                seen.first().map(|lap_m| (*lap_m, self.way_m, NEAR_M, "pictures of the drive's beginning, seen again"));
            let laps = (!seen.is_empty()).then_some(seen.len() as u32);
            return Found { track: None, way: lap, laps, laps_unsure: false };
        };
        let (length_m, progress_m) = (on.road.length_m, on.place.progress_m.max(0.0));
        let near_m = (2.0 * on.place.deviation_m).hypot(WEAVING_M);
        let search_m = (3.0 * near_m).clamp(SEARCH_M.0, SEARCH_M.1);
        let counted = ((progress_m + near_m.min(SURELY_M)) / length_m) as u32;
        let from_line = (progress_m - length_m * (progress_m / length_m).round()).abs();
        // Laps as long as the speeds told make them.
        let lap_m = length_m * if progress_m > 0.0 { self.way_m / progress_m } else { 1.0 };
        let from_lap = |way: f64| ((way / lap_m) - (way / lap_m).round()).abs() * length_m;
        let expected = |way: f64| way > lap_m / 2.0 && from_lap(way) < search_m + BEGINNING_M;
        let again = laps(&self.looks(|way| way <= BEGINNING_M || expected(way)));
        // Places may look like the start a little before and after it: each lap is one.
        let near_lines = again.into_iter().filter(|way| from_lap(*way) < search_m);
        let seen = near_lines.map(|way| (way / lap_m).round() as u32).collect::<BTreeSet<_>>().len() as u32;
        // Where the car went astray since, it had driven these.
        let sure = ((on.sure_m / length_m) as u32).max(seen);
        Found {
            track: Some(on.road.name.clone()),
            way: Some((length_m, progress_m, near_m.min(length_m / 2.0), "bends driven, matched with known roads")),
            laps: Some(counted.max(sure)),
            laps_unsure: from_line < near_m && sure < counted,
        }
    }

    /// Fills in what the run itself does not tell. Says the track.
    pub fn fill(mut self, figures: &mut Figures, distance: Measure, time_s: f64) -> Option<String> {
        use Figure as F;
        self.matcher.as_ref()?; // nobody asked
        let found = self.find();
        let estimate =
            |value: f64, uncertainty: f64, from: &'static str| Measure::Estimate { value, uncertainty, from };
        match (found.way, found.laps) {
            (Some((.., from)), Some(laps)) => {
                figures.set(F::Laps, estimate(laps.into(), if found.laps_unsure { 1.0 } else { 0.0 }, from));
            }
            _ => figures.told(F::Laps, None, NO_LAP),
        }
        match (found.way, self.laps_asked) {
            (Some((length_m, progress_m, near_m, from)), Some(asked)) => {
                let asked = f64::from(asked.max(1));
                // Completion goes by waypoints, whoever counts it.
                let waypoints = (length_m / Rules::default().waypoint_spacing_m).round().max(3.0);
                let reached = (progress_m / length_m * waypoints).floor() / waypoints;
                let share = reached.max(found.laps.unwrap_or(0).into()) / asked;
                // Who drove all laps for certain has, wherever the car went then.
                let whole = !found.laps_unsure && f64::from(found.laps.unwrap_or(0)) >= asked;
                let unsure = if whole { 0.0 } else { (near_m / length_m + 1.0 / waypoints) / asked };
                figures.set(F::Completion, estimate(share.min(1.0), unsure, from));
            }
            _ => figures.told(F::Completion, None, UNKNOWN_ROAD),
        }
        let from = "speeds that the car cannot lose by itself";
        let struck = self.impacts.collisions.len() as f64;
        figures.set(F::Collisions, estimate(struck, (IN_TEN * struck).ceil(), from));
        if let Some(way) = distance.value().filter(|way| *way > 0.0) {
            figures.set(
                F::CollisionsPerKm,
                estimate(struck / way * 1000.0, (IN_TEN * struck).ceil() / way * 1000.0, from),
            );
        }
        let stuck = self.impacts.stuck.len() as f64;
        figures.set(F::Stuck, estimate(stuck, 0.0, "speed under throttle"));
        let first = self.impacts.collisions.iter().chain(&self.impacts.stuck).copied().reduce(f64::min);
        figures.set(F::SurvivalS, estimate(first.map_or(time_s, |at| at - self.first_s()), 1.0, from));
        let way_m = self.unhurt_m.unwrap_or(self.way_m);
        figures.set(F::SurvivalM, distance.map(|_| way_m, 1.0));
        found.track
    }

    fn first_s(&self) -> f64 {
        self.impacts.first_s.unwrap_or_default()
    }
}

/// The look of a picture, which is decoded into `frame`; `None` where it cannot be.
fn look(jpeg: &[u8], frame: &mut Frame) -> Option<Look> {
    decode_jpeg(jpeg, frame).ok()?;
    Look::of(frame)
}

#[cfg(test)]
mod tests;
