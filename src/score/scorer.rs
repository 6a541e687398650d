//! From the items of a run to its scorecard.

mod recorded;

use std::{sync::Arc, time::Duration};

use super::{
    Figure, Measure, Scorecard,
    blind::{Blind, Driven},
    braking::{Braking, Known},
    card::Figures,
    infractions::{Struck, autonomies, driving_scores},
    latency::Stages,
    offline::not_replayed,
    smoothness::{GAP_S, Sample, Smoothness},
};
use crate::{
    odometry::Road,
    protocol::Telemetry,
    recording::{By, CommandRecord, EventRecord, Item},
    units::{MPS_PER_MPH, Metres},
};

/// A run that ends within so many seconds of a collision ended by it.
const AFTERMATH_S: f64 = 2.0;
/// How far off a distance may be that follows from speed and time, as a share: the speed is that of the moment, and
/// telemetries come when they come.
const DISTANCE_OFF: f64 = 0.01;

const NO_POSITION: &str = "the run tells no position: the stock build does not";
pub(super) const NO_JUDGE: &str = "the run tells no collisions and no road: the stock build does not";
const NO_LAPS_ASKED: &str = "no laps were asked for";
pub(super) const NO_TIME: &str = "the run has fewer than two telemetries";
const NO_WAY: &str = "the car did not move";
const NO_ANSWERS: &str = "the run has no answers";
pub(super) const NO_PILOT: &str = "no pilot drove";
const TOO_SHORT: &str = "no half second of the run is told without a gap";

/// Watches one run.
#[derive(Debug, Clone, Default)]
pub struct Scorer {
    course: Option<Course>,
    first_s: Option<f64>,
    /// Time and speed of the telemetry before, in s and m/s.
    last: Option<(f64, f64)>,
    telemetries: u64,
    driven_m: f64,
    /// Metres of distance that fall into gaps.
    in_gaps_m: f64,
    off_road_m: f64,
    max_mph: f64,
    /// |cte| of each telemetry that tells it.
    offsets_m: Vec<f64>,
    samples: Vec<Sample>,
    /// The car was put elsewhere since the last sample.
    was_put: bool,
    /// Furthest that the car came, in laps.
    progress: f64,
    tells_waypoints: bool,
    laps: Vec<f64>,
    struck: Vec<Struck>,
    /// Episodes that had a collision, and whether this one has.
    struck_episodes: u32,
    struck_now: bool,
    last_collision_s: Option<f64>,
    off_roads: u32,
    off_road_s: f64,
    off_since: Option<f64>,
    ended_off_road: bool,
    resets: u32,
    stuck: u32,
    is_stuck: bool,
    takeovers: u32,
    human_s: f64,
    human_since: Option<f64>,
    /// Seconds and metres at the first infraction.
    survived: Option<(f64, f64)>,
    bad_frames: u32,
    missed_frames: u64,
    /// Answers, and those of a pilot.
    answers: (u64, u64),
    unanswered: bool,
    stages: Stages,
    braking: Braking,
    told: Told,
    ended: Option<String>,
    notes: Vec<String>,
    damaged: bool,
    /// For what the run does not tell.
    blind: Blind,
}

#[derive(Debug, Clone)]
struct Course {
    track: String,
    waypoints: u32,
    laps: Option<u32>,
    scenario: Option<String>,
    /// A recording's path, not a track.
    is_recorded: bool,
}

/// What worlds count themselves.
#[derive(Debug, Clone, Default)]
struct Told {
    laps: Counter,
    crashes: Counter,
    out_of_bounds: Counter,
    distance_m: Counter,
}

/// A count that was begun before the run, perhaps, and may begin anew.
#[derive(Debug, Clone, Default)]
struct Counter {
    last: Option<f64>,
    total: f64,
}

impl Counter {
    /// Whether it went up.
    fn take(&mut self, count: Option<f64>) -> bool {
        let more = count.zip(self.last).map_or(0.0, |(now, before)| (now - before).max(0.0));
        self.total += more;
        self.last = count.or(self.last);
        more > 0.0
    }

    fn total(&self) -> Option<f64> {
        self.last.map(|_| self.total)
    }
}

impl Scorer {
    /// A scorer that finds out, where the run does not tell, on which of these roads it was and how far it came of so
    /// many laps.
    pub fn on(roads: &[Arc<Road>], laps_asked: Option<u32>) -> Self {
        Self { blind: Blind::new(roads, laps_asked), ..Self::default() }
    }

    /// Takes an item of a run, in the order of the file.
    pub fn item(&mut self, at: Duration, item: &Item) {
        match item {
            Item::Telemetry(telemetry) => self.telemetry(at, telemetry),
            Item::Command(command) => self.command(command),
            Item::Event(event) => self.event(at, event),
            Item::Frame(jpeg) => self.blind.frame(jpeg),
        }
    }

    /// Takes a telemetry, in the order of time.
    pub fn telemetry(&mut self, at: Duration, telemetry: &Telemetry) {
        // A clock that was set back stands still until it has caught up.
        let at = self.last.map_or(at.as_secs_f64(), |(before, _)| at.as_secs_f64().max(before));
        let mph = telemetry.speed.get();
        let speed_mps = mph * MPS_PER_MPH;
        self.telemetries += 1;
        self.missed_frames += u64::from(std::mem::replace(&mut self.unanswered, true));
        self.first_s.get_or_insert(at);
        let apart = self.last.map_or(0.0, |(before, _)| at - before);
        if let Some((_, was_mps)) = self.last {
            // Trapezium: the speed changes evenly between two telemetries.
            let way = apart * (speed_mps + was_mps) / 2.0;
            self.driven_m += way;
            self.in_gaps_m += if apart > GAP_S { way } else { 0.0 };
            self.off_road_m += if self.off_since.is_some() { way } else { 0.0 };
        }
        // Of two at one time the first is what counts: in no time nothing turns.
        if self.last.is_none() || apart > 0.0 {
            let goes_on = self.last.is_some() && apart <= GAP_S && !self.was_put;
            self.samples.push(Sample { at_s: at, speed_mps, steering_deg: telemetry.steering.get(), goes_on });
            self.was_put = false;
            self.blind.telemetry(at, speed_mps, telemetry.steering.get());
        }
        self.last = Some((at, speed_mps));
        self.max_mph = self.max_mph.max(mph);
        let truth = &telemetry.truth;
        self.braking.telemetry(at, telemetry.speed, truth);
        self.told.distance_m.take(truth.distance.map(Metres::get));
        self.tells_waypoints |= truth.lap.is_some() && truth.waypoint.is_some();
        self.offsets_m.extend(truth.cte.map(|cte| cte.get().abs()));
        self.told.laps.take(truth.lap.map(f64::from));
        let infraction = self.told.crashes.take(truth.crashes.map(f64::from))
            | self.told.out_of_bounds.take(truth.out_of_bounds.map(f64::from));
        match (&self.course, truth.lap, truth.waypoint) {
            (Some(course), Some(lap), Some(waypoint)) => {
                let progress = f64::from(lap) + f64::from(waypoint) / f64::from(course.waypoints.max(1));
                self.progress = self.progress.max(progress);
            }
            (None, ..) if infraction => self.infraction(at),
            _ => {}
        }
    }

    /// Whether the run itself says what happened.
    fn tells(&self) -> bool {
        self.course.is_some() || self.told.crashes.total().is_some() || self.told.laps.total().is_some()
    }

    /// Whether it is a recording that is driven along.
    fn is_recorded(&self) -> bool {
        self.course.as_ref().is_some_and(|course| course.is_recorded)
    }

    /// What the last telemetry gives to suspect, where the run itself does not say what happened.
    pub(super) fn suspicion(&mut self) -> Option<EventRecord> {
        let text = self.blind.suspicion()?.to_owned();
        (!self.tells()).then_some(EventRecord::Note { text })
    }

    /// Takes an answer.
    pub fn command(&mut self, command: &CommandRecord) {
        self.unanswered = false;
        self.answers.0 += 1;
        self.answers.1 += u64::from(command.by == By::Pilot);
        self.blind.command(command.throttle.get());
        self.stages.take(command);
        self.braking.command(command);
    }

    /// Takes what happened besides.
    pub fn event(&mut self, at: Duration, event: &EventRecord) {
        let at = at.as_secs_f64();
        match event {
            EventRecord::Course { track, waypoints, laps, scenario, .. } => {
                let (track, scenario) = (track.clone(), scenario.clone());
                let is_recorded = event.is_recorded_path();
                self.course = Some(Course { track, waypoints: *waypoints, laps: *laps, scenario, is_recorded });
            }
            EventRecord::Lap { number, time_s } => {
                self.laps.push(within(*time_s, at));
                self.progress = self.progress.max(f64::from(*number));
            }
            EventRecord::Collision { with, speed_mph, own_mph } => {
                self.braking.collision(*speed_mph, *own_mph);
                self.struck.push(Struck::by_name(with));
                self.struck_episodes += u32::from(!std::mem::replace(&mut self.struck_now, true));
                self.last_collision_s = Some(at);
                self.infraction(at);
            }
            EventRecord::OffRoad { offset_m } => {
                if self.is_recorded() {
                    // It is put back before a telemetry shows it there.
                    self.offsets_m.push(Metres::saturating(*offset_m).get().abs());
                }
                self.off_roads += 1;
                self.off_since = Some(at);
                self.infraction(at);
            }
            // After a reset it was counted already.
            EventRecord::BackOnRoad { after_s } if self.off_since.take().is_some() => {
                self.off_road_s += within(*after_s, at);
            }
            EventRecord::Reset { .. } => {
                self.resets += 1;
                self.was_put = true; // the wheel is put straight with the car
                self.braking.put();
                self.struck_now = false;
                self.last_collision_s = None;
                self.is_stuck = false;
                self.back_on_road(at);
                self.infraction(at);
            }
            EventRecord::Stuck => {
                self.stuck += 1;
                self.is_stuck = true;
                self.infraction(at);
            }
            EventRecord::Moving => self.is_stuck = false,
            EventRecord::TakeoverBegan => {
                self.takeovers += 1;
                self.blind.takeover(at);
                self.human_since = Some(at);
                self.unanswered = false;
                self.infraction(at);
            }
            EventRecord::TakeoverEnded { duration_s } => {
                self.human_s += within(*duration_s, at);
                self.human_since = None;
            }
            EventRecord::BadFrame { .. } => self.bad_frames += 1,
            EventRecord::RunEnded { why } => {
                self.ended = Some(why.clone());
                self.ended_off_road = self.off_since.is_some();
                self.back_on_road(at);
            }
            _ => {}
        }
    }

    /// Something about the run that whoever reads its scorecard should know.
    pub fn note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// Parts of the run cannot be read, for this reason.
    pub fn damaged(&mut self, why: String) {
        self.damaged = true;
        self.note(why);
    }

    fn infraction(&mut self, at: f64) {
        let (first, way) = (self.first_s.unwrap_or(at), self.told.distance_m.total().unwrap_or(self.driven_m));
        self.survived.get_or_insert(((at - first).max(0.0), way));
    }

    fn back_on_road(&mut self, at: f64) {
        if let Some(since) = self.off_since.take() {
            self.off_road_s += (at - since).max(0.0);
        }
    }

    /// Whether the run ended in a way that somebody would have had to end.
    fn ended_badly(&self, last_s: f64) -> bool {
        self.ended_off_road || self.is_stuck || self.last_collision_s.is_some_and(|at| last_s - at <= AFTERMATH_S)
    }

    /// The judgement.
    pub fn finish(mut self) -> Scorecard {
        use Figure as F;
        let first = self.first_s.unwrap_or_default();
        let last = self.last.map_or(first, |(at, _)| at);
        let time_s = last - first;
        self.ended_off_road |= self.off_since.is_some(); // where the file is cut off
        self.back_on_road(last);
        if let Some(since) = self.human_since.take() {
            self.human_s += (last - since).max(0.0);
        }
        let (judged, tells) = (self.course.is_some(), self.tells());
        let laps_asked = self.course.as_ref().and_then(|course| course.laps);
        let mut figures = Figures::unknown("nothing says it");

        let told_m = self.told.distance_m.total();
        let distance = match told_m {
            Some(told) => Measure::Told(told),
            None if self.last.is_none() => Measure::Unknown(NO_TIME),
            None => Measure::Estimate {
                value: self.driven_m,
                uncertainty: DISTANCE_OFF * self.driven_m + self.in_gaps_m / 2.0,
                from: "speed over time",
            },
        };
        let way = told_m.unwrap_or(self.driven_m);
        figures.set(F::DistanceM, distance);
        figures.told(F::TimeS, self.last.map(|_| time_s), NO_TIME);
        let timed = time_s > 0.0;
        figures.told(F::MeanMph, timed.then(|| self.driven_m / time_s / MPS_PER_MPH), NO_TIME);
        figures.told(F::MaxMph, self.last.map(|_| self.max_mph), NO_TIME);

        let completion = laps_asked.map(|asked| (self.progress / f64::from(asked.max(1))).min(1.0));
        // Laps alone say nothing of the last, unfinished one.
        let completion = completion.filter(|share| self.tells_waypoints || *share >= 1.0);
        let no_completion = if judged && laps_asked.is_none() { NO_LAPS_ASKED } else { NO_POSITION };
        figures.told(F::Completion, completion, no_completion);
        let count = |told: &Counter, judge: u32| if judged { Some(f64::from(judge)) } else { told.total() };
        let collisions = count(&self.told.crashes, self.struck.len() as u32);
        figures.told(F::Laps, count(&self.told.laps, self.laps.len() as u32), NO_POSITION);
        figures.told(F::Collisions, collisions, NO_JUDGE);
        match collisions {
            Some(n) if way > 0.0 => {
                figures.set(F::CollisionsPerKm, distance.map(|way| n / (way / 1000.0), n / way / way * 1000.0))
            }
            Some(_) => figures.told(F::CollisionsPerKm, None, NO_WAY),
            None => figures.told(F::CollisionsPerKm, None, NO_JUDGE),
        }
        let by_judge = |value: f64| judged.then_some(value);
        let episodes = f64::from(self.resets + 1);
        figures.told(F::Episodes, by_judge(episodes), NO_JUDGE);
        figures.told(F::CollisionRate, by_judge(f64::from(self.struck_episodes) / episodes), NO_JUDGE);
        figures.told(F::OffRoads, count(&self.told.out_of_bounds, self.off_roads), NO_JUDGE);
        figures.told(F::OffRoadS, by_judge(self.off_road_s), NO_JUDGE);
        let off_road_share = if self.driven_m > 0.0 { self.off_road_m / self.driven_m } else { 0.0 };
        figures.told(F::OffRoadShare, by_judge(off_road_share), NO_JUDGE);
        figures.told(F::Stuck, by_judge(self.stuck.into()), NO_JUDGE);
        figures.told(F::Resets, by_judge(self.resets.into()), NO_JUDGE);
        let scores = completion.map(|completion| driving_scores(completion, off_road_share, &self.struck));
        figures.told(F::DrivingScore, scores.map(|(new, _)| new), no_completion);
        figures.told(F::DrivingScoreProduct, scores.map(|(_, old)| old), no_completion);

        let interventions = self.resets + u32::from(self.ended_badly(last));
        let seen = self.last.is_some();
        let by_human = self.answers.0 > 0 && self.answers.1 == 0;
        let why = if seen { NO_PILOT } else { NO_TIME };
        figures.told(F::Takeovers, (seen && !by_human).then_some(self.takeovers.into()), why);
        figures.told(F::HumanS, seen.then_some(if by_human { time_s } else { self.human_s }), NO_TIME);
        figures.told(F::Interventions, by_judge(interventions.into()), NO_JUDGE);
        // Nobody may have been there to take over, so that takeovers alone say nothing.
        let autonomies =
            (timed && !by_human && judged).then(|| autonomies(time_s, self.takeovers, self.human_s, interventions));
        let why = if !timed {
            NO_TIME
        } else if by_human {
            NO_PILOT
        } else {
            NO_JUDGE
        };
        figures.told(F::Autonomy, autonomies.map(|(counted, _)| counted), why);
        figures.told(F::AutonomyMeasured, autonomies.map(|(_, measured)| measured), why);

        self.offsets_m.sort_by(f64::total_cmp);
        let (n, offsets) = (self.offsets_m.len(), &self.offsets_m);
        let told = n > 0;
        let mean = |of: fn(&f64) -> f64| told.then(|| offsets.iter().map(of).sum::<f64>() / n as f64);
        figures.told(F::MeanCte, mean(|cte| *cte), NO_POSITION);
        figures.told(F::RmsCte, mean(|cte| cte * cte).map(f64::sqrt), NO_POSITION);
        figures.told(F::P95Cte, told.then(|| offsets[(n * 95).div_ceil(100).max(1) - 1]), NO_POSITION);
        figures.told(F::MaxCte, offsets.last().copied(), NO_POSITION);

        let smooth = Smoothness::of(&self.samples);
        figures.told(F::SteeringRate, smooth.steering_rate_deg_s, NO_TIME);
        figures.told(F::SteeringReversals, smooth.reversals_per_min, NO_TIME);
        figures.told(F::RmsJerk, smooth.rms_jerk, TOO_SHORT);
        if let Some((value, uncertainty)) = smooth.comfort {
            figures.set(F::Comfort, Measure::Estimate { value, uncertainty, from: "the yaw rate of a bicycle" });
        } else {
            figures.told(F::Comfort, None, TOO_SHORT);
        }

        let (survival_s, survival_m) = self.survived.unwrap_or((time_s, way));
        if judged || self.told.crashes.total().is_some() {
            figures.told(F::SurvivalS, seen.then_some(survival_s), NO_TIME);
            figures.set(F::SurvivalM, distance.map(|_| survival_m, 1.0));
        } else {
            figures.told(F::SurvivalS, None, NO_JUDGE);
            figures.told(F::SurvivalM, None, NO_JUDGE);
        }
        if self.is_recorded() {
            recorded::untell(&mut figures);
            self.notes.push(recorded::NOTE.to_owned());
        }
        let scenario = self.course.as_ref().is_some_and(|course| course.scenario.is_some());
        let braking = self.braking.figures(Known { time_s, judged, scenario });
        braking.into_iter().chain(not_replayed()).for_each(|(figure, measure)| figures.set(figure, measure));
        figures.told(F::FramesPerS, timed.then(|| (self.telemetries - 1) as f64 / time_s), NO_TIME);
        let why = if by_human { NO_PILOT } else { NO_TIME };
        figures.told(F::BadFrames, (seen && !by_human).then_some(self.bad_frames.into()), why);
        let why = if by_human { NO_PILOT } else { NO_ANSWERS };
        let answered = self.answers.0 > 0 && !by_human;
        figures.told(F::MissedFrames, answered.then_some(self.missed_frames as f64), why);
        let laps_asked = laps_asked.or(self.blind.laps_asked.filter(|_| !tells));
        let found = if tells {
            None
        } else {
            self.blind.fill(&mut figures, &Driven { distance, time_s, human_s: self.human_s, by_pilot: !by_human })
        };
        let found = found.unwrap_or_default();
        let (track, scenario) = self.course.map(|course| (course.track, course.scenario)).unzip();
        Scorecard {
            track: track.or(found.track),
            scenario: scenario.flatten(),
            ended: self.ended,
            laps_asked,
            lap_times_s: if found.lap_times_off_s.is_some() { found.lap_times_s } else { self.laps },
            lap_times_off_s: found.lap_times_off_s,
            whereabouts: found.whereabouts,
            latency: self.stages.latencies(),
            damaged: self.damaged,
            notes: self.notes,
            ..figures.card()
        }
    }
}

/// A duration of a file, which may say anything, in seconds: not below 0, and not longer than the run was then.
fn within(seconds: f64, at: f64) -> f64 {
    if seconds.is_finite() { seconds.clamp(0.0, at.max(0.0)) } else { 0.0 }
}

#[cfg(test)]
mod tests;
