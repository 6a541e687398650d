//! Scores runs that contain neither position nor collisions: those of the stock build.
//!
//! | figure | from |
//! |---|---|
//! | track, completion, laps | speed and steering on known roads ([`Matcher`]), the look of their starts, and the look of the drive's own beginning ([`laps`]) |
//! | lap times, a map | places along the road by distance driven (`passage`) |
//! | collisions, stuck, survival | speeds that the car cannot reach by itself (`impacts`) |
//! | autonomy | takeovers and collisions, if all laps were driven: a car that leaves the road for long does not
//! complete them |
//!
//! `cargo run --release --example blind` compares all of it with the judge of simulated runs.

mod impacts;
mod passage;

use std::{collections::BTreeSet, sync::Arc};

use bytes::Bytes;

use self::{
    impacts::Impacts,
    passage::{DistanceLog, way_to},
};
use super::{
    Figure, Measure,
    card::Figures,
    infractions::{INTERVENTION_S, autonomies},
    scorer::NO_PILOT,
    smoothness::GAP_S,
};
use crate::odometry::{BEGINNING_M, EVERY_M, Look, Match, Matcher, Road, laps};
use lapwing_core::{
    config::Rules,
    motion::{self, Motion},
    perception::{Frame, decode_jpeg},
};

/// A road counts as the one that was driven if it explains the drive better than all others by this much, as a log
/// likelihood: 150 to 1.
const SURE: f64 = 5.0;
/// Metres of road needed to recognise it by its bends if no picture shows the start.
const BENDS_M: f64 = 250.0;
/// Error of odometry at its best, and additional error if the driver weaves, in metres.
const NEAR_M: f64 = 3.0;
const WEAVING_M: f64 = 6.0;
/// How far the mean of the speeds before and after a gap may be from the mean speed in it, in m/s.
const UNSEEN_MPS: f64 = 2.5;
/// How many metres of uncertainty may complete a lap by themselves, and how far from the expected places the ends of
/// laps are looked for, at least and at most.
const SURELY_M: f64 = 20.0;
const SEARCH_M: (f64, f64) = (30.0, 80.0);
/// Nine of ten collisions are found, and nine of ten found ones are collisions: the example `blind`.
const IN_TEN: f64 = 0.1;

/// The seed of the particles: the same run always has the same scorecard.
const SEED: u64 = 0;

const SPEEDS: &str = "speeds that the car cannot lose by itself";
const INFRACTIONS: &str = "takeovers, and collisions that are suspected";
const NOT_AROUND: &str =
    "the run does not report whether the car left the road, and it is not known to have driven all laps";
const UNKNOWN_ROAD: &str = "the run reports no position and matches no known road: add yours with --track";
const NO_LAP: &str = "the run reports no position, matches no known road, and does not come back to where it began";

/// Watches a run knowing the roads, but seeing only what the stock build reports.
#[derive(Debug, Clone, Default)]
pub(super) struct Blind {
    /// Laps that were asked for.
    pub laps_asked: Option<u32>,
    roads: Vec<Arc<Road>>,
    /// None if nobody asks for what is not reported.
    matcher: Option<Matcher>,
    /// Whether the first picture was looked at, and whether it showed a known start.
    has_looked: bool,
    is_anchored: bool,
    /// The last telemetry: seconds, m/s and 1/m.
    last: Option<(f64, f64, f64)>,
    /// Whether the last telemetry belongs to another drive.
    is_cut: bool,
    way_m: f64,
    clock: DistanceLog,
    /// When humans took over, in seconds.
    takeovers: Vec<f64>,
    /// JPEGs by the metres driven until then.
    pictures: Vec<(f64, Bytes)>,
    newest: Option<(f64, Bytes)>,
    impacts: Impacts,
}

/// What was found.
#[derive(Debug)]
pub(super) struct Found {
    pub track: Option<String>,
    /// Length of a lap in metres, metres driven along it, how far off the latter may be, and the source.
    pub way: Option<(f64, f64, f64, &'static str)>,
    pub laps: Option<u32>,
    /// Whether the count of laps may be off by one.
    laps_unsure: bool,
    /// Metres driven when each lap ended, and how far off that may be; empty unless all are known.
    lap_ends_m: Vec<(f64, f64)>,
    /// Times and places along the track.
    whereabouts: Vec<(f64, f64)>,
}

/// What else is known about the drive.
#[derive(Debug, Clone, Copy)]
pub(super) struct DriveFacts {
    pub distance: Measure,
    /// When it began, in seconds.
    pub began_s: f64,
    pub time_s: f64,
    /// Seconds that a human drove.
    pub human_s: f64,
    /// Whether a pilot drove some of it.
    pub by_pilot: bool,
}

/// What is found apart from figures.
#[derive(Debug, Default)]
pub(super) struct Besides {
    pub track: Option<String>,
    pub lap_times_s: Vec<f64>,
    pub lap_times_off_s: Option<f64>,
    pub whereabouts: Vec<(f64, f64)>,
}

impl Blind {
    pub fn new(roads: &[Arc<Road>], laps_asked: Option<u32>) -> Self {
        let matcher = Some(Matcher::new(roads.iter().cloned(), SEED));
        Self { matcher, roads: roads.into(), laps_asked, ..Self::default() }
    }

    /// A watcher that looks at nothing and only knows the length of these roads.
    pub fn of_known(roads: &[Arc<Road>]) -> Self {
        Self { roads: roads.into(), ..Self::default() }
    }

    pub fn telemetry(&mut self, at: f64, mps: f64, steering_deg: f64) {
        self.impacts.speed(at, mps);
        let curvature = motion::curvature(steering_deg);
        if std::mem::take(&mut self.is_cut) {
            // Another drive on the same road may continue anywhere; mostly it continues after a pause.
            self.matcher.iter_mut().for_each(|matcher| matcher.skip(0.0, UNSEEN_MPS * GAP_S));
        } else if let Some((before, was_mps, was_curvature)) = self.last {
            let apart = at - before;
            let way_m = apart * (mps + was_mps) / 2.0;
            self.way_m += way_m;
            let turn_rad = way_m * (curvature + was_curvature) / 2.0;
            match &mut self.matcher {
                // While a human drives, the simulator reports nothing.
                Some(matcher) if apart > GAP_S => matcher.skip(way_m, UNSEEN_MPS * apart),
                Some(matcher) => matcher.step(Motion { way_m, turn_rad }),
                None => {}
            }
        }
        if self.matcher.is_some() {
            self.clock.note(at, self.way_m);
        }
        self.last = Some((at, mps, curvature));
    }

    /// The next telemetry does not continue from the last one.
    pub fn cut(&mut self) {
        self.is_cut = true;
        self.impacts.cut();
    }

    /// What the last telemetry suggests, once, if anybody asks.
    pub fn suspicion(&mut self) -> Option<&'static str> {
        self.impacts.suspicion.take().filter(|_| self.matcher.is_some())
    }

    pub fn takeover(&mut self, at: f64) {
        self.takeovers.push(at);
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
            // A copy, as the original would keep a whole chunk of the file in memory.
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

    /// The looks of the pictures at these places; pictures that cannot be decoded are skipped.
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

    /// Whether the first return to the drive's beginning is one lap of this road away.
    fn comes_around(&self, on: &Match) -> bool {
        let lap_m = self.lap_m(on);
        let once_around = self.looks(|way| way <= lap_m + SEARCH_M.1 + BEGINNING_M);
        laps(&once_around).first().is_none_or(|way| (way - lap_m).abs() < SEARCH_M.1)
    }

    /// Length of a lap as measured by the reported speeds.
    fn lap_m(&self, on: &Match) -> f64 {
        on.road.length_m * if on.place.progress_m > 0.0 { self.way_m / on.place.progress_m } else { 1.0 }
    }

    /// The roads that are known.
    pub fn roads(&self) -> &[Arc<Road>] {
        &self.roads
    }

    /// Stops searching: the world itself reports what happens.
    pub fn stand_down(&mut self) {
        self.matcher = None;
    }

    /// Things kept of telemetries and pictures.
    #[cfg(test)]
    pub fn kept(&self) -> usize {
        self.pictures.len() + self.clock.len()
    }

    /// Looks for the road and the laps, if anybody asks.
    pub fn find(&mut self) -> Option<Found> {
        self.matcher.as_ref()?;
        Some(self.found())
    }

    fn found(&mut self) -> Found {
        self.pictures.extend(self.newest.take()); // a lap may end with the run
        let Some(on) = self.road().filter(|on| self.is_anchored || self.comes_around(on)) else {
            let seen = laps(&self.looks(|_| true));
            // The length of a lap is unknown until the beginning is seen again.
            let lap =
                seen.first().map(|lap_m| (*lap_m, self.way_m, NEAR_M, "pictures of the drive's beginning, seen again"));
            let laps = (!seen.is_empty()).then_some(seen.len() as u32);
            let lap_ends_m = seen.into_iter().map(|way_m| (way_m, NEAR_M)).collect();
            let whereabouts = vec![];
            return Found { track: None, way: lap, laps, laps_unsure: false, lap_ends_m, whereabouts };
        };
        let (length_m, progress_m) = (on.road.length_m, on.place.progress_m.max(0.0));
        let near = |deviation_m: f64| (2.0 * deviation_m).hypot(WEAVING_M);
        let near_m = near(on.place.deviation_m);
        let search_m = (3.0 * near_m).clamp(SEARCH_M.0, SEARCH_M.1);
        let counted = ((progress_m + near_m.min(SURELY_M)) / length_m) as u32;
        let from_line = (progress_m - length_m * (progress_m / length_m).round()).abs();
        let lap_m = self.lap_m(&on);
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
            let at_end = || ((end_m - progress_m).abs() <= near_m).then_some((self.way_m, on.place.deviation_m));
            way_to(end_m, &on.trail).or_else(at_end).map(|(way_m, deviation_m)| (way_m, near(deviation_m)))
        };
        Found {
            track: Some(on.road.name.clone()),
            way: Some((length_m, progress_m, near_m.min(length_m / 2.0), "bends driven, matched with known roads")),
            laps: Some(laps),
            laps_unsure: from_line < near_m && sure < counted,
            lap_ends_m: (1..=laps).map(lap_end).collect::<Option<_>>().unwrap_or_default(),
            whereabouts: self.clock.whereabouts(&on.trail, length_m),
        }
    }

    /// Fills in what the run itself does not report; if it `tells` something, its reasons stay.
    pub fn fill(self, found: Found, figures: &mut Figures, drive: &DriveFacts, tells: bool) -> Besides {
        use Figure as F;
        match (found.way, found.laps) {
            (Some((.., from)), Some(laps)) => {
                figures.suggest(F::Laps, estimate(laps.into(), if found.laps_unsure { 1.0 } else { 0.0 }, from));
            }
            _ if tells => {}
            _ => figures.told(F::Laps, None, NO_LAP),
        }
        // A car that has certainly driven all laps has done so, wherever it went afterwards.
        let is_whole = self.laps_asked.is_some_and(|asked| found.laps >= Some(asked.max(1)) && !found.laps_unsure);
        match (found.way, self.laps_asked) {
            (Some((length_m, progress_m, near_m, from)), Some(asked)) => {
                let asked = f64::from(asked.max(1));
                // Completion is counted in waypoints here, too.
                let waypoints = (length_m / Rules::default().waypoint_spacing_m).round().max(3.0);
                let reached = (progress_m / length_m * waypoints).floor() / waypoints;
                let share = reached.max(found.laps.unwrap_or(0).into()) / asked;
                let unsure = if is_whole { 0.0 } else { (near_m / length_m + 1.0 / waypoints) / asked };
                figures.suggest(F::Completion, estimate(share.min(1.0), unsure, from));
            }
            _ if tells => {}
            _ => figures.told(F::Completion, None, UNKNOWN_ROAD),
        }
        self.infractions(figures, drive, is_whole);
        let (ends_m, off_m): (Vec<_>, Vec<_>) = found.lap_ends_m.into_iter().unzip();
        let lap_times_s = self.clock.laps(&ends_m);
        let longest_s = lap_times_s.iter().copied().reduce(f64::max);
        let off_m = off_m.into_iter().fold(0.0, f64::max);
        let lap_times_off_s = longest_s.zip(found.way).map(|(time_s, (length_m, ..))| time_s * off_m / length_m);
        Besides { track: found.track, lap_times_s, lap_times_off_s, whereabouts: found.whereabouts }
    }

    /// Infractions, and figures that depend on them.
    fn infractions(&self, figures: &mut Figures, drive: &DriveFacts, is_whole: bool) {
        use Figure as F;
        let DriveFacts { distance, began_s, time_s, human_s, by_pilot } = *drive;
        let struck = self.impacts.collisions.len() as f64;
        // If none was found, one may have been missed.
        let off = (IN_TEN * struck).ceil().max(1.0);
        figures.suggest(F::Collisions, estimate(struck, off, SPEEDS));
        if let Some(way) = distance.value().filter(|way| *way > 0.0) {
            figures.suggest(F::CollisionsPerKm, estimate(struck / way * 1000.0, off / way * 1000.0, SPEEDS));
        }
        figures.suggest(F::Stuck, estimate(self.impacts.stuck.len() as f64, 1.0, "speed under throttle"));
        let suspected = self.impacts.times();
        let first = suspected.iter().chain(&self.takeovers).copied().reduce(f64::min);
        figures.suggest(F::SurvivalS, estimate(first.map_or(time_s, |at| (at - began_s).max(0.0)), 1.0, INFRACTIONS));
        let way_m = first.map_or(self.way_m, |at| self.clock.way_m(at));
        figures.suggest(F::SurvivalM, distance.map(|_| way_m, 1.0));
        if !is_whole || !by_pilot || time_s <= 0.0 {
            let why = if by_pilot { NOT_AROUND } else { NO_PILOT };
            for figure in [F::Interventions, F::InterventionsPerKm, F::Autonomy, F::AutonomyMeasured] {
                if figures.get(figure).value().is_none() {
                    figures.told(figure, None, why);
                }
            }
            return;
        }
        // One that a human handled belongs to the takeover, and one that soon follows another is the same.
        let soon = |at: f64, then: f64| (0.0..=INTERVENTION_S).contains(&(then - at));
        let mut own: Vec<f64> = vec![];
        for at in suspected {
            let is_known =
                own.last().is_some_and(|last| soon(*last, at)) || self.takeovers.iter().any(|t| soon(at, *t));
            own.extend((!is_known).then_some(at));
        }
        let (takeovers, own) = (self.takeovers.len() as u32, own.len() as u32);
        let (counted, measured) = autonomies(time_s, takeovers, human_s, own);
        let one = (INTERVENTION_S / time_s).min(1.0);
        figures.suggest(F::Interventions, estimate(own.into(), 1.0, SPEEDS));
        if let Some(km) = distance.value().map(|way_m| way_m / 1000.0).filter(|km| *km > 0.0) {
            figures.suggest(F::InterventionsPerKm, estimate(f64::from(own) / km, 1.0 / km, SPEEDS));
        }
        figures.suggest(F::Autonomy, estimate(counted, one, INFRACTIONS));
        figures.suggest(F::AutonomyMeasured, estimate(measured, one, INFRACTIONS));
    }
}

fn estimate(value: f64, uncertainty: f64, from: &'static str) -> Measure {
    Measure::Estimate { value, uncertainty, from }
}

/// The look of a picture, which is decoded into `frame`; `None` if it cannot be.
fn look(jpeg: &[u8], frame: &mut Frame) -> Option<Look> {
    decode_jpeg(jpeg, frame).ok()?;
    Look::of(frame)
}

#[cfg(test)]
mod tests;
