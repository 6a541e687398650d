//! From the items of a run to its scorecard.

mod counted;
mod judgement;
mod offsets;
mod recorded;
mod untimed;
mod within_run;

use std::{sync::Arc, time::Duration};

use bytes::Bytes;

use self::offsets::Offsets;
use super::{
    blind::Blind,
    braking::Braking,
    clock::RunClock,
    drives::{Sight, Turned},
    guarded::Guarded,
    infractions::Struck,
    latency::Stages,
    smoothness::{GAP_S, Tick, Wheel},
    told::{News, Now, Told},
};
use crate::odometry::{Road, joins};
use lapwing_core::{
    protocol::Telemetry,
    recording::{Break, By, CommandRecord, EventRecord, Item, RunKind},
    turn::MeasuredLine,
    units::{MPS_PER_MPH, Metres},
};

pub(super) use judgement::{NO_JUDGE, NO_PILOT, NO_TIME};
pub(super) use untimed::UNTIMED_LOG;

/// From one telemetry to the next a car comes no further along the road than this many times as far as it drives, besides so many
/// metres: it may be put at the next waypoint but one, and the inside of a bend is shorter than the middle.
const LEAP: f64 = 2.0;
const LEAP_M: f64 = 60.0;

/// Watches one run.
#[derive(Debug, Clone, Default)]
pub struct Scorer {
    kind: RunKind,
    course: Option<DrivenTrack>,
    clock: RunClock,
    /// Whether to keep nothing that grows with the run.
    is_live: bool,
    /// When the run began: with the first telemetry, or with a human before it.
    began_s: Option<f64>,
    first_s: Option<f64>,
    /// Time and speed of the previous telemetry, in s and m/s.
    last: Option<(f64, f64)>,
    /// When the last item came, whatever it was.
    latest_s: f64,
    telemetries: u64,
    driven_m: f64,
    /// Whether any telemetry follows another without a break.
    has_way: bool,
    /// Metres driven during gaps.
    in_gaps_m: f64,
    off_road_m: f64,
    max_mph: f64,
    offsets: Offsets,
    /// What the offsets of a drive along a recording are measured from now, and along how many metres it was the lane.
    line: MeasuredLine,
    from_lane_m: f64,
    /// How often a car along a recording was put back where the lane is not known.
    put_by_path: u32,
    /// From the middle of the course's road to its edge, in metres, and whether the recorded path has a nearer limit:
    /// then the limit is the road's edge, where that is known.
    edge_m: f64,
    lacks_edge: bool,
    wheel: Wheel,
    samples: Vec<Tick>,
    /// Whether the car was put elsewhere since the last sample.
    was_put: bool,
    /// Whether there was a break since the last telemetry, whatever time has passed by the clock.
    is_cut: bool,
    /// Whether the time of the next telemetry is assumed, and whether that between any two is.
    is_untimed: bool,
    assumes_time: bool,
    /// Whether a drive goes on after a gap whose time the recording leaves out.
    leaves_out: bool,
    /// How far it had driven when it reached the furthest point, in metres, and how many telemetries tell one farther away than that.
    progressed_m: f64,
    leaps: u64,
    /// Whether a person changed how it is driven.
    is_changed: bool,
    /// Furthest point that the car reached, in laps.
    progress: f64,
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
    /// Those before the laps asked for were done: the car did not drive to the waypoints at which it was put.
    carried: u32,
    /// Whether the laps asked for were done, by what the simulator reports.
    all_laps: bool,
    stuck: u32,
    is_stuck: bool,
    takeovers: u32,
    human_s: f64,
    human_since: Option<f64>,
    /// Seconds and metres at the first infraction.
    survived: Option<(f64, f64)>,
    bad_frames: u32,
    kicks: u32,
    missed_frames: u64,
    answers: AnswerCounts,
    unanswered: bool,
    stages: Stages,
    braking: Braking,
    guarded: Guarded,
    told: Told,
    ended: Option<String>,
    notes: Vec<String>,
    damaged: bool,
    /// Estimates what the run does not report.
    blind: Blind,
}

#[derive(Debug, Clone)]
struct DrivenTrack {
    track: String,
    waypoints: u32,
    laps: Option<u32>,
    length_m: f64,
    scenario: Option<String>,
}

/// How many answers there were, and who gave them.
#[derive(Debug, Clone, Copy, Default)]
struct AnswerCounts {
    all: u64,
    pilot: u64,
    human: u64,
}

impl Scorer {
    /// A scorer that, if the run does not report it, estimates which of these roads was driven, and how much of the
    /// laps asked for.
    pub fn on(roads: &[Arc<Road>], laps_asked: Option<u32>) -> Self {
        Self { blind: Blind::new(roads, laps_asked), ..Self::default() }
    }

    /// The same scorer, which may look at the pictures of the whole recording: in its order, how the car turned between
    /// them. It does so where speed and steering do not tell the road, and notes the reason if it cannot.
    pub fn seeing(mut self, look: impl Fn() -> Result<Vec<Turned>, String> + Send + Sync + 'static) -> Self {
        self.blind.sight = Some(Sight(Arc::new(look)));
        self
    }

    /// A scorer for a drive that may last for days: it stores no telemetry and looks at no picture. Figures that need
    /// either are not measurable; all others equal those of the run's file. It knows the length of these roads.
    pub fn live(roads: &[Arc<Road>]) -> Self {
        Self { is_live: true, blind: Blind::of_known(roads), ..Self::default() }
    }

    /// The same scorer for a run of this kind, which decides what can be measured.
    pub fn of_kind(self, kind: RunKind) -> Self {
        Self { kind, ..self }
    }

    /// Takes an item of a run, in the order of the file; returns when it happened, in the time of the run.
    pub fn item(&mut self, at: Duration, item: &Item) -> Duration {
        match item {
            Item::Telemetry(telemetry) => self.telemetry(at, telemetry),
            Item::Command(command) => self.command(command),
            Item::Event(event) => self.event(at, event),
            Item::Frame(jpeg) => self.frame(jpeg),
        }
        if !self.clock.is_told() {
            return at; // to the nanosecond
        }
        Duration::try_from_secs_f64(self.clock.at(at.as_secs_f64())).unwrap_or(at)
    }

    /// Telemetries so far.
    pub fn telemetries(&self) -> u64 {
        self.telemetries
    }

    /// Takes a telemetry, in the order of time.
    pub fn telemetry(&mut self, at: Duration, telemetry: &Telemetry) {
        let truth = &telemetry.truth;
        let at = self.clock.telemetry(at.as_secs_f64(), truth.sim_time_s);
        // After the clock is set back, time stands still until it has caught up.
        let at = self.last.map_or(at, |(before, _)| at.max(before));
        let mph = telemetry.speed.get();
        let speed_mps = mph * MPS_PER_MPH;
        self.telemetries += 1;
        self.missed_frames += u64::from(std::mem::replace(&mut self.unanswered, true));
        self.latest_s = self.latest_s.max(at);
        let is_beginning = self.began_s.is_none();
        self.began_s.get_or_insert(at);
        self.first_s.get_or_insert(at);
        let apart = self.last.map_or(0.0, |(before, _)| at - before);
        let is_cut = std::mem::take(&mut self.is_cut);
        let after_gap = is_cut || apart > GAP_S;
        if std::mem::take(&mut self.is_untimed) {
            self.assumes_time |= self.last.is_some() && !is_cut;
            self.blind.untimed();
        }
        // Nothing was driven between two drives.
        if let Some((_, was_mps)) = self.last.filter(|_| !is_cut) {
            self.has_way = true;
            // Trapezium: the speed changes evenly between two telemetries. Reversing counts as distance, too.
            let way = apart * (speed_mps.abs() + was_mps.abs()) / 2.0;
            self.driven_m += way;
            self.in_gaps_m += if after_gap { way } else { 0.0 };
            self.off_road_m += if self.off_since.is_some() { way } else { 0.0 };
            self.from_lane_m += if self.line == MeasuredLine::Lane { way } else { 0.0 };
        }
        let apart_s = self.last.map(|_| apart);
        let goes_on_from_last = self.last.is_some() && !after_gap && !self.was_put;
        let now = Now { at_s: at, apart_s, after_gap, mps: speed_mps, driven_m: self.driven_m, is_beginning };
        let news = self.told.telemetry(truth, now);
        if self.course.is_none() {
            self.judge(at, news);
        }
        // Of two at the same time only the first counts, as nothing turns in no time.
        if self.last.is_none() || apart > 0.0 {
            let goes_on = self.last.is_some() && !after_gap && !self.was_put;
            let sample = Tick { at_s: at, speed_mps, steering_deg: telemetry.steering.get(), goes_on };
            self.wheel.sample(sample);
            self.samples.extend((!self.is_live).then_some(sample));
            self.was_put = false;
            self.blind.telemetry(self.telemetries as usize - 1, at, speed_mps, telemetry.steering.get());
        }
        self.last = Some((at, speed_mps));
        self.max_mph = self.max_mph.max(mph);
        self.braking.telemetry(at, telemetry.speed, truth);
        self.guarded.telemetry(at, speed_mps, goes_on_from_last);
        match truth.cte {
            Some(cte) => self.offsets.take(at, cte.get(), !after_gap, !self.is_live),
            None => self.offsets.last = None,
        }
        if let (Some(course), Some(lap), Some(waypoint)) = (&self.course, truth.lap, truth.waypoint) {
            let progress = f64::from(lap) + f64::from(waypoint) / f64::from(course.waypoints.max(1));
            let ahead_m = (progress - self.progress) * course.length_m;
            // Nobody saw where a human drove.
            let is_unseen = after_gap || (apart_s.is_none() && !is_beginning);
            let can_be = is_unseen || ahead_m <= LEAP_M + LEAP * (self.driven_m - self.progressed_m);
            if waypoint > course.waypoints || !can_be {
                self.leaps += 1;
            } else if progress > self.progress {
                (self.progress, self.progressed_m) = (progress, self.driven_m);
            }
        }
    }

    /// Takes events that telemetry reports, if no judge reports them.
    fn judge(&mut self, at: f64, news: News) {
        if news.crashes > 0 {
            self.collided(at);
            self.braking.hit();
            self.guarded.hit();
        }
        if news.left_road > 0 {
            self.off_roads = self.off_roads.saturating_add(news.left_road);
            self.off_since = Some(at);
            self.infraction(at);
        }
        if news.put_back {
            self.put(at);
        } else if news.back_on_road {
            self.back_on_road(at);
        }
    }

    /// Whether the run itself reports what happened.
    fn tells(&self) -> bool {
        self.course.is_some() || self.told.crashes.total().is_some() || self.told.laps.total().is_some()
    }

    /// Whether the drive follows a recording.
    fn is_recorded(&self) -> bool {
        self.kind == RunKind::RecordedPath
    }

    /// What the last telemetry suggests, if the run itself does not report what happened.
    pub(super) fn suspicion(&mut self) -> Option<EventRecord> {
        let text = self.blind.suspicion()?.to_owned();
        (!self.tells()).then_some(EventRecord::Note { text })
    }

    /// Takes the picture of the last telemetry, as JPEG.
    pub fn frame(&mut self, jpeg: &Bytes) {
        self.blind.frame(jpeg);
    }

    /// Takes an answer.
    pub fn command(&mut self, command: &CommandRecord) {
        self.unanswered = false;
        self.answers.all += 1;
        self.answers.pilot += u64::from(command.by == By::Pilot);
        self.answers.human += u64::from(command.by == By::Human);
        self.blind.command(command.throttle.get());
        self.stages.take(command);
        self.braking.command(command);
        self.guarded.command(command);
    }

    /// Takes an event.
    pub fn event(&mut self, at: Duration, event: &EventRecord) {
        let stamp_s = at.as_secs_f64();
        let at = match event {
            EventRecord::TakeoverBegan => self.clock.next(stamp_s),
            _ => self.clock.at(stamp_s),
        };
        self.latest_s = self.latest_s.max(at);
        match event {
            EventRecord::Course { track, waypoints, laps, edge_m, scenario, length_m } => {
                self.edge_m = *edge_m;
                let (track, scenario) = (track.clone(), scenario.clone());
                let (waypoints, laps, length_m) = (*waypoints, *laps, *length_m);
                self.course = Some(DrivenTrack { track, waypoints, laps, length_m, scenario });
                self.clock.is_the_worlds();
                self.blind.stand_down();
            }
            EventRecord::SpeedSet { .. } | EventRecord::SpeedLawSet { .. } | EventRecord::PilotSet { .. } => {
                self.is_changed = true;
            }
            EventRecord::Lap { number, time_s } => {
                self.laps.push(within(*time_s, at));
                // Laps are counted one by one; one that could not be read may lie between.
                if *number as usize <= self.laps.len() + 1 {
                    self.progress = self.progress.max(f64::from(*number));
                } else {
                    self.leaps += 1;
                }
            }
            EventRecord::Collision { with, speed_mph, own_mph } => {
                self.braking.collision(*speed_mph, *own_mph);
                self.guarded.hit();
                self.struck.push(Struck::by_name(with));
                self.collided(at);
            }
            EventRecord::MeasuredFrom { line, right_m, .. } => {
                self.line = *line;
                self.lacks_edge |= *line == MeasuredLine::RecordedPath && *right_m < self.edge_m;
            }
            EventRecord::OffRoad { offset_m } => {
                if self.is_recorded() {
                    // The car is put back before a telemetry shows it there.
                    self.offsets.take(at, Metres::saturating(*offset_m).get(), true, !self.is_live);
                    self.put_by_path += u32::from(self.line != MeasuredLine::Lane);
                }
                self.off_roads += 1;
                self.off_since = Some(at);
                self.infraction(at);
            }
            // After a reset the time off the road was counted already.
            EventRecord::BackOnRoad { after_s } if self.off_since.take().is_some() => {
                self.off_road_s += within(*after_s, at);
            }
            EventRecord::Reset { .. } => self.put(at),
            EventRecord::Break { .. } => {
                let broken = Break::told(event).unwrap_or(Break::Joined);
                self.is_cut = true;
                self.leaves_out |= self.last.is_some() && !joins(broken);
                self.blind.cut(broken);
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
                self.began_s.get_or_insert(at);
                self.unanswered = false;
                self.infraction(at);
            }
            EventRecord::TakeoverEnded { duration_s } => {
                let since = self.human_since.take();
                // The event gives its duration by the clock that stamps messages.
                let by_clock = since.filter(|_| self.clock.is_told()).map(|since| (at - since).max(0.0));
                self.human_s += by_clock.unwrap_or(within(*duration_s, at));
            }
            EventRecord::GuardBrakes { .. } => self.guarded.begins(at),
            EventRecord::GuardReleases { .. } => self.guarded.ends(at),
            EventRecord::BadFrame { .. } => self.bad_frames += 1,
            EventRecord::Kick => self.kicks += 1,
            EventRecord::RunEnded { why } => {
                self.ended = Some(why.clone());
                self.ended_off_road = self.off_since.is_some();
                self.back_on_road(at);
            }
            _ => {}
        }
    }

    /// Something about the run that anyone who reads its scorecard should know.
    pub fn note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// The time of the next telemetry is assumed: nothing that is recorded tells it.
    pub(super) fn untimed(&mut self) {
        self.is_untimed = true;
    }

    /// Parts of the run cannot be read, for this reason.
    pub fn damaged(&mut self, why: String) {
        self.damaged = true;
        self.note(why);
    }

    fn collided(&mut self, at: f64) {
        self.struck_episodes += u32::from(!std::mem::replace(&mut self.struck_now, true));
        self.last_collision_s = Some(at);
        self.infraction(at);
    }

    /// The car was put back on the road.
    fn put(&mut self, at: f64) {
        self.resets += 1;
        let done = match &self.course {
            Some(course) => course.laps.map(|asked| self.progress >= f64::from(asked.max(1))),
            None => {
                self.blind.laps_asked.zip(self.told.laps.total()).map(|(asked, laps)| laps >= f64::from(asked.max(1)))
            }
        };
        self.carried += u32::from(done != Some(true));
        self.was_put = true; // the reset also straightens the wheel
        self.braking.put();
        self.struck_now = false;
        self.last_collision_s = None;
        self.is_stuck = false;
        self.back_on_road(at);
        self.infraction(at);
    }

    fn infraction(&mut self, at: f64) {
        let (began, way) = (self.began_s.unwrap_or(at), self.told.distance_m.total().unwrap_or(self.driven_m));
        self.survived.get_or_insert(((at - began).max(0.0), way));
    }

    fn back_on_road(&mut self, at: f64) {
        if let Some(since) = self.off_since.take() {
            self.off_road_s += (at - since).max(0.0);
        }
    }
}

/// A duration from a file, which may say anything, in seconds: clamped to 0 and the run's length so far.
fn within(seconds: f64, at: f64) -> f64 {
    if seconds.is_finite() { seconds.clamp(0.0, at.max(0.0)) } else { 0.0 }
}

#[cfg(test)]
mod tests;
