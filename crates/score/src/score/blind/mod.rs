//! Scores runs that contain neither position nor collisions: those of the stock build.
//!
//! | figure | from |
//! |---|---|
//! | track, completion, laps | speed and steering on known roads ([`crate::odometry::find`]), in place of the steering how the car turned by its pictures where that tells too little, the look of the roads' starts, and the look of the drive's own beginning ([`crate::odometry::laps`]) |
//! | lap times, a map | places along the road by distance driven (`passage`) |
//! | collisions, stuck, survival | speeds that the car cannot reach by itself (`impacts`) |
//! | autonomy | takeovers and collisions, if all laps were driven: a car that leaves the road for long does not
//! complete them |
//!
//! Drives that are joined in one run are found each by itself (`drive`), and added up.
//!
//! `cargo run --release --example blind` compares all of it with the judge of simulated runs.

mod drive;
mod impacts;
mod passage;

use std::sync::Arc;

use bytes::Bytes;

use self::{
    drive::{Drive, Placed},
    impacts::Impacts,
    passage::DistanceLog,
};
use super::{
    Figure, Measure,
    card::Figures,
    drives::{DriveFound, Sight, Turned},
    infractions::{INTERVENTION_S, autonomies},
    scorer::NO_PILOT,
    smoothness::GAP_S,
};
use crate::odometry::{Leg, Road, joins};
use lapwing_core::{
    config::Rules,
    motion::{self, Motion},
    recording::Break,
};

/// Nine of ten collisions are found, and nine of ten found ones are collisions: the example `blind`.
const IN_TEN: f64 = 0.1;

const SPEEDS: &str = "speeds that the car cannot lose by itself";
const INFRACTIONS: &str = "takeovers, and collisions that are suspected";
const NOT_AROUND: &str =
    "the run does not report whether the car left the road, and it is not known to have driven all laps";
const UNKNOWN_ROAD: &str = "the run reports no position and matches no known road: add yours with --track";
const UNSURE_ROAD: &str = "the run reports no position, and it is not sure on which of the known roads it was";
const NEARLY_KNOWN: &str = "the run reports no position, and no known road explains it well enough: a longer recording may tell, \
                            or it was on another road: add that with --track";
const NO_LAP: &str = "the run reports no position, matches no known road, and does not come back to where it began";
const UNSURE_LAP: &str = "the run reports no position, it is not sure on which of the known roads it was, and it does \
                          not come back to where it began";

const NEARLY_LAP: &str = "the run reports no position, no known road explains it well enough, and it does not come back to where \
                          it began";

/// Watches a run knowing the roads, but seeing only what the stock build reports.
#[derive(Debug, Clone, Default)]
pub(super) struct Blind {
    /// Laps that were asked for.
    pub laps_asked: Option<u32>,
    /// Looks at the pictures again, where that is possible.
    pub sight: Option<Sight>,
    /// In each direction in which they may be driven.
    roads: Vec<Arc<Road>>,
    /// Whether anybody asks for what is not reported.
    asks: bool,
    drives: Vec<Drive>,
    /// The last telemetry: seconds, m/s and 1/m.
    last: Option<(f64, f64, f64)>,
    /// Why the next telemetry does not continue from the last.
    cut: Option<Break>,
    /// Whether the time of the next is assumed.
    is_untimed: bool,
    way_m: f64,
    clock: DistanceLog,
    /// When humans took over, in seconds.
    takeovers: Vec<f64>,
    impacts: Impacts,
}

/// What was found.
#[derive(Debug)]
pub(super) struct Found {
    drives: Vec<Placed>,
    /// Why the pictures were not looked at, although they should have been.
    unseen: Option<String>,
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
    pub drives: Vec<DriveFound>,
    pub lap_times_s: Vec<f64>,
    pub lap_times_off_s: Option<f64>,
    pub whereabouts: Vec<(f64, f64)>,
    /// What a reader should know about it.
    pub note: Option<String>,
}

impl Blind {
    pub fn new(roads: &[Arc<Road>], laps_asked: Option<u32>) -> Self {
        Self { asks: true, roads: roads.into(), laps_asked, ..Self::default() }
    }

    /// A watcher that looks at nothing and only knows the length of these roads.
    pub fn of_known(roads: &[Arc<Road>]) -> Self {
        Self { roads: roads.into(), ..Self::default() }
    }

    /// Takes a telemetry, by its number in the run.
    pub fn telemetry(&mut self, number: usize, at: f64, mps: f64, steering_deg: f64) {
        let is_untimed = std::mem::take(&mut self.is_untimed);
        if !is_untimed {
            self.impacts.speed(at, mps);
        }
        let curvature = motion::curvature(steering_deg);
        let cut = self.cut.take();
        let leg = self.last.map(|(before, was_mps, was_curvature)| {
            let apart_s = at - before;
            let way_m = apart_s * (mps + was_mps) / 2.0;
            let motion = Motion { way_m, turn_rad: way_m * (curvature + was_curvature) / 2.0 };
            // While a human drives, the simulator reports nothing.
            let gap = (apart_s > GAP_S).then_some(Break::TakenOver);
            Leg { motion, apart_s, broken: cut.or(gap) }
        });
        if let Some(leg) = leg {
            // Nothing was driven between two drives.
            self.way_m += if leg.broken.is_some_and(joins) { 0.0 } else { leg.motion.way_m.abs() };
        }
        if self.asks {
            match (leg, self.drives.last_mut()) {
                (Some(leg), Some(drive)) if !leg.broken.is_some_and(joins) => drive.leg(number, leg),
                _ => self.drives.push(Drive::begin(at, self.way_m, number)),
            }
            if let Some(drive) = self.drives.last_mut() {
                drive.is_untimed |= is_untimed;
            }
            if let Some(Leg { broken: Some(broken @ Break::Gap(passed)), apart_s, .. }) = leg
                && !joins(broken)
            {
                self.clock.leave_out(at, (passed.as_secs_f64() - apart_s).max(0.0));
            }
            self.clock.note(at, self.way_m);
        }
        self.last = Some((at, mps, curvature));
    }

    /// The next telemetry does not continue from the last one.
    pub fn cut(&mut self, broken: Break) {
        self.cut = Some(broken);
        self.impacts.cut();
    }

    /// The time of the next telemetry is assumed.
    pub fn untimed(&mut self) {
        self.is_untimed = true;
    }

    /// What the last telemetry suggests, once, if anybody asks.
    pub fn suspicion(&mut self) -> Option<&'static str> {
        self.impacts.suspicion.take().filter(|_| self.asks)
    }

    pub fn takeover(&mut self, at: f64) {
        self.takeovers.push(at);
    }

    pub fn command(&mut self, throttle: f64) {
        self.impacts.command(throttle);
    }

    pub fn frame(&mut self, jpeg: &Bytes) {
        if let Some(drive) = self.drives.last_mut() {
            drive.frame(self.way_m, jpeg);
        }
    }

    /// The roads that are known.
    pub fn roads(&self) -> &[Arc<Road>] {
        &self.roads
    }

    /// Stops searching: the world itself reports what happens.
    pub fn stand_down(&mut self) {
        self.asks = false;
        self.drives.clear();
    }

    /// Things kept of telemetries and pictures.
    #[cfg(test)]
    pub fn kept(&self) -> usize {
        self.clock.len() + self.drives.iter().map(Drive::kept).sum::<usize>()
    }

    /// Looks for the road and the laps of each drive, if anybody asks.
    pub fn find(&mut self) -> Option<Found> {
        self.asks.then(|| self.found())
    }

    fn found(&mut self) -> Found {
        let (mut turns, mut unseen): (Option<Vec<Turned>>, Option<String>) = (None, None);
        let mut drives = vec![];
        for drive in &mut self.drives {
            let (mut found, mut by_pictures) = (drive.find(&self.roads), false);
            if let Some(sight) = self.sight.as_ref().filter(|_| drive.may_turn_otherwise(&found)) {
                let turns = turns.get_or_insert_with(|| {
                    (sight.0)().unwrap_or_else(|why| {
                        unseen = Some(format!("how the car turned is told by its steering alone: {why}"));
                        vec![]
                    })
                });
                if drive.turn(turns) {
                    (found, by_pictures) = (drive.find(&self.roads), true);
                }
            }
            drives.push(drive.placed(&found, by_pictures, &self.clock));
        }
        Found { drives, unseen }
    }

    /// Fills in what the run itself does not report; if it `tells` something, its reasons stay.
    pub fn fill(self, found: Found, figures: &mut Figures, drive: &DriveFacts, tells: bool) -> Besides {
        use Figure as F;
        let laps = found.laps();
        match (found.from(), laps) {
            (Some(from), Some(laps)) => {
                figures.suggest(F::Laps, estimate(laps.into(), found.laps_off(&self.roads), from))
            }
            _ if tells => {}
            _ => figures.told(F::Laps, None, found.why_unknown([UNSURE_LAP, NEARLY_LAP, NO_LAP])),
        }
        // A car that has certainly driven all laps has done so, wherever it went afterwards.
        let surely = found
            .drives
            .iter()
            .map(|drive| drive.laps.unwrap_or(0).saturating_sub(drive.laps_unsure.into()))
            .sum::<u32>();
        let is_whole = self.laps_asked.is_some_and(|asked| surely >= asked.max(1));
        match (found.from(), self.laps_asked) {
            (Some(from), Some(asked)) => {
                let asked = f64::from(asked.max(1));
                let (driven, unsure) = found.completed();
                let unsure = if is_whole { found.waypoint() } else { unsure };
                figures.suggest(F::Completion, estimate((driven / asked).min(1.0), unsure / asked, from));
            }
            _ if tells => {}
            _ => figures.told(F::Completion, None, found.why_unknown([UNSURE_ROAD, NEARLY_KNOWN, UNKNOWN_ROAD])),
        }
        self.infractions(figures, drive, is_whole);
        let track = found.track();
        let Found { drives, unseen } = found;
        let mut besides = Besides { track, note: unseen, ..Besides::default() };
        for placed in drives {
            besides.lap_times_s.extend(placed.lap_times_s);
            besides.lap_times_off_s =
                besides.lap_times_off_s.into_iter().chain(placed.lap_times_off_s).reduce(f64::max);
            // A map shows one track.
            if placed.told.on.as_ref().map(|on| &on.track) == besides.track.as_ref() {
                besides.whereabouts.extend(placed.whereabouts);
            }
            besides.drives.push(placed.told);
        }
        besides
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
        // Uncertain by what is driven in the second by which its end is, too.
        let second_m = first.map_or(0.0, |at| (self.clock.way_m(at + 1.0) - self.clock.way_m(at - 1.0)) / 2.0);
        figures.suggest(
            F::SurvivalM,
            match distance.part(way_m, self.way_m) {
                Measure::Estimate { value, uncertainty, from } => estimate(value, uncertainty + second_m, from),
                Measure::Told(value) if second_m > 0.0 => estimate(value, second_m, INFRACTIONS),
                _ if first.is_none() => distance,
                part => part,
            },
        );
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

impl Found {
    /// The track of all drives whose road is known, if that is one.
    fn track(&self) -> Option<String> {
        let mut tracks = self.drives.iter().filter_map(|drive| Some(&drive.told.on.as_ref()?.track));
        let first = tracks.next()?;
        tracks.all(|track| track == first).then(|| first.clone())
    }

    /// Whether a known road explains the drive, but not for certain: the drive was too short, or several roads explain it.
    fn is_unsure(&self) -> bool {
        let mut unknown = self.drives.iter().filter(|drive| drive.told.on.is_none());
        unknown.any(|drive| drive.told.roads.iter().any(|road| road.explains))
    }

    /// Which of these says why the road is unknown: several roads may be the one; the nearest may be, although it explains the
    /// drive too badly; or none.
    pub(super) fn why_unknown(&self, [unsure, nearly, other]: [&'static str; 3]) -> &'static str {
        let unknown = self.drives.iter().filter(|drive| drive.told.on.is_none());
        let longest = unknown.max_by(|a, b| a.told.way_m.unwrap_or(0.0).total_cmp(&b.told.way_m.unwrap_or(0.0)));
        match longest {
            _ if self.is_unsure() => unsure,
            Some(drive) if drive.is_nearly_known() => nearly,
            _ => other,
        }
    }

    /// Length of a lap, in metres.
    pub fn lap_m(&self) -> Option<f64> {
        self.drives.iter().find_map(|drive| drive.way).map(|(length_m, ..)| length_m)
    }

    /// Whole laps, each drive's counted by itself; `None` if none can be counted.
    pub fn laps(&self) -> Option<u32> {
        let counted = self.drives.iter().filter_map(|drive| drive.laps);
        self.drives.iter().any(|drive| drive.laps.is_some()).then(|| counted.sum())
    }

    fn from(&self) -> Option<&'static str> {
        self.drives.iter().find_map(|drive| drive.way).map(|(.., from)| from)
    }

    /// By how many laps the count may be off: by one for each drive that ends about where a lap does, and by all that a drive
    /// on an unknown road may have driven.
    fn laps_off(&self, roads: &[Arc<Road>]) -> f64 {
        let unsure = self.drives.iter().filter(|drive| drive.laps_unsure).count() as f64;
        let shortest_m = roads.iter().map(|road| road.length_m).reduce(f64::min);
        let uncounted = self.drives.iter().filter(|drive| drive.laps.is_none());
        let way_m = |drive: &Placed| drive.told.way_m.unwrap_or(0.0);
        let most: f64 = uncounted.map(|drive| shortest_m.map_or(0.0, |lap_m| (way_m(drive) / lap_m).floor())).sum();
        unsure.max(1.0) + most
    }

    /// The share of a lap that one waypoint is: completion is counted in waypoints here, too.
    fn waypoint(&self) -> f64 {
        self.drives
            .iter()
            .filter_map(|drive| drive.way)
            .map(|(length_m, ..)| 1.0 / waypoints(length_m))
            .fold(0.0, f64::max)
    }

    /// Laps driven, whole and begun, those of all drives added up, and how far off that may be. No drive counts for
    /// less than its whole laps.
    fn completed(&self) -> (f64, f64) {
        let driven = |drive: &Placed| {
            let (length_m, progress_m, near_m, _) = drive.way?;
            let reached = (progress_m / length_m * waypoints(length_m)).floor() / waypoints(length_m);
            Some((reached.max(f64::from(drive.laps.unwrap_or(0))), near_m / length_m + 1.0 / waypoints(length_m)))
        };
        let all = self.drives.iter().filter_map(driven);
        all.fold((0.0, 0.0), |(laps, off), (more, near)| (laps + more, off + near))
    }
}

/// How many waypoints a lap of this length has.
fn waypoints(length_m: f64) -> f64 {
    (length_m / Rules::default().waypoint_spacing_m).round().max(3.0)
}

fn estimate(value: f64, uncertainty: f64, from: &'static str) -> Measure {
    Measure::Estimate { value, uncertainty, from }
}

#[cfg(test)]
mod tests;
