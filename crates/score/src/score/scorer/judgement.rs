//! The judgement of a run, after its end.

use super::{Scorer, within_run::Span};
use crate::{
    score::blind::DriveFacts,
    score::braking::Known,
    score::card::Figures,
    score::infractions::{autonomies, driving_scores},
    score::offline::not_replayed,
    score::scorer::{recorded, untimed},
    score::smoothness::Smoothness,
    score::{Figure, Measure, Scorecard},
};
use lapwing_core::{units::MPS_PER_MPH, words::count};

const CHANGED: &str =
    "a person changed the set speed, the speed law or the pilot during the run: its title and setting say how it began";
/// A run that ends within this many seconds of a collision ended because of it.
const AFTERMATH_S: f64 = 2.0;
/// How far off a distance computed from speed and time may be, as a share: the speed is momentary, and telemetries come
/// at uneven intervals.
const DISTANCE_OFF: f64 = 0.01;

pub(super) const NO_POSITION: &str = "the run reports no position: the stock build sends none";
pub(in crate::score) const NO_JUDGE: &str =
    "the run reports neither collisions nor the edge of the road: the stock build sends neither";
pub(super) const NO_LAPS_ASKED: &str = "no laps were asked for";
pub(in crate::score) const NO_TIME: &str = "the run has fewer than two telemetries at different times";
const ALL_APART: &str = "there is a break between every two telemetries of the run";
pub(super) const NOTHING: &str = "the run has no telemetry";
pub(super) const NO_WAY: &str = "the car did not move";
/// What lap times are estimated from.
const LAP_TIMES_TOLD: &str = "the telemetries around the end of each lap";
const LAP_TIMES_FOUND: &str = "where laps seem to have ended";
const NO_ANSWERS: &str = "the run has no answers";
pub(in crate::score) const NO_PILOT: &str = "no pilot drove";
const SPEED: &str = "speed over time";
const SPEED_BUT_GAPS: &str = "speed over time, gaps left out";
const NO_CTE: &str = "the run reports no distance from the line to drive";
const TOO_SHORT: &str = "the run has no half second without a gap in its telemetry";
const LIVE: &str = "needs the whole run: use lapwing score";
pub(super) const UNTIMED: &str = "a human drove at the run's beginning or end, and the simulator's clock, which runs faster than \
    real time, was not reported then";

impl Scorer {
    /// The judgement.
    pub fn finish(mut self) -> Scorecard {
        use Figure as F;
        let span = self.span();
        let Span { time_s, told_s, last_s, .. } = span;
        self.ended_off_road |= self.off_since.is_some(); // where the file is cut off
        self.back_on_road(last_s);
        if let Some(since) = span.human_since {
            self.human_s += (span.end_s - since).max(0.0);
        }
        let (seen, timed, judged) = (self.last.is_some(), told_s > 0.0, self.course.is_some());
        let mut figures = Figures::unknown(NOTHING);

        let is_apart = self.telemetries > 1 && !self.has_way;
        let told_m = self.told.distance_m.total();
        let distance = match told_m {
            Some(told) => Measure::Told(told),
            None if !seen => Measure::Unknown(NO_TIME),
            None if is_apart => Measure::Unknown(ALL_APART),
            None => Measure::Estimate {
                value: self.driven_m,
                uncertainty: DISTANCE_OFF * self.driven_m + self.in_gaps_m / 2.0,
                from: if self.leaves_out { SPEED_BUT_GAPS } else { SPEED },
            },
        };
        let way = told_m.unwrap_or(self.driven_m);
        figures.set(F::DistanceM, distance);
        figures.told(F::TimeS, (seen || time_s > 0.0).then_some(time_s), NO_TIME);
        let why = if is_apart { ALL_APART } else { NO_TIME };
        figures.told(F::MeanMph, (timed && !is_apart).then(|| self.driven_m / told_s / MPS_PER_MPH), why);
        figures.told(F::MaxMph, seen.then_some(self.max_mph), NO_TIME);

        // Who drove: a run with answers to bad frames only is not a human's.
        let by_human = self.answers.human > 0 && self.answers.human == self.answers.all;
        let no_pilot = self.no_pilot();
        let why = if no_pilot { NO_PILOT } else { NO_TIME };
        let somebody = seen || self.takeovers > 0;
        figures.told(F::Takeovers, (somebody && !no_pilot).then_some(self.takeovers.into()), why);
        let human_s = if by_human { time_s } else { self.human_s };
        figures.told(F::HumanS, (somebody && span.is_timed).then_some(human_s), if seen { UNTIMED } else { NO_TIME });

        let found = if judged || !timed { None } else { self.blind.find() };
        if judged {
            self.by_judge(&mut figures, &span, way, distance);
        } else {
            self.by_telemetry(&mut figures, &span, way, distance, found.as_ref());
        }

        let no_cte = if judged || self.told.tells { NO_CTE } else { NO_POSITION };
        let offsets = &mut self.offsets;
        offsets.all.sort_by(f64::total_cmp);
        let (n, kept) = (offsets.n as f64, offsets.all.len());
        let told = offsets.n > 0;
        figures.told(F::MeanCte, told.then(|| offsets.sum / n), no_cte);
        figures.told(F::RmsCte, told.then(|| (offsets.squares / n).sqrt()), no_cte);
        figures.told(F::MaxCte, told.then_some(offsets.most), no_cte);
        let p95 = (kept > 0).then(|| offsets.all[(kept * 95).div_ceil(100).max(1) - 1]);
        figures.told(F::P95Cte, p95, if told { LIVE } else { no_cte });
        let timed_s = offsets.timed_s;
        for (figure, beyond_s) in [F::Beyond1m, F::Beyond2m].into_iter().zip(offsets.beyond_s) {
            let share = (timed_s > 0.0).then(|| beyond_s / timed_s);
            figures.told(figure, share, if told { NO_TIME } else { no_cte });
        }

        figures.told(F::SteeringRate, self.wheel.rate_deg_s(), NO_TIME);
        figures.told(F::SteeringReversals, self.wheel.reversals_per_min(), NO_TIME);
        let smooth = Smoothness::of(&self.samples);
        let why = if self.is_live { LIVE } else { TOO_SHORT };
        figures.told(F::RmsJerk, smooth.rms_jerk, why);
        if let Some((value, uncertainty)) = smooth.comfort {
            figures.set(F::Comfort, Measure::Estimate { value, uncertainty, from: "the yaw rate of a bicycle" });
        } else {
            figures.told(F::Comfort, None, why);
        }

        figures.told(F::FromLane, None, recorded::NOT_ALONG);
        if self.is_recorded() {
            let from_lane = (self.driven_m > 0.0).then(|| self.from_lane_m / self.driven_m);
            figures.told(F::FromLane, from_lane, if is_apart { ALL_APART } else { NO_WAY });
            recorded::untell(&mut figures);
            self.notes.push(recorded::NOTE.to_owned());
            if (self.from_lane_m > 0.0 || self.lacks_edge) && self.put_by_path > 0 {
                self.notes.push(recorded::put_by_path(self.put_by_path, self.off_roads));
            }
        }
        if self.is_changed {
            self.notes.push(CHANGED.to_owned());
        }
        if self.leaps > 0 {
            let told = count(self.leaps, "message");
            self.notes.push(format!("{told} with a place that the car cannot have reached, which completion ignores"));
        }
        let scenario = self.course.as_ref().is_some_and(|course| course.scenario.is_some());
        let known = Known { time_s, judged, counted: self.told.crashes.total().is_some(), scenario };
        let braking = std::mem::take(&mut self.braking).figures(known);
        let guarded = std::mem::take(&mut self.guarded).figures(span.end_s);
        braking
            .into_iter()
            .chain(guarded)
            .chain(not_replayed())
            .for_each(|(figure, measure)| figures.set(figure, measure));
        let why = if is_apart { ALL_APART } else { NO_TIME };
        figures.told(F::FramesPerS, (timed && !is_apart).then(|| (self.telemetries - 1) as f64 / told_s), why);
        let (why, answered) = if by_human { (NO_PILOT, false) } else { (NO_ANSWERS, self.answers.all > 0) };
        figures.told(F::MissedFrames, answered.then_some(self.missed_frames as f64), why);
        if !seen {
            // Not even a count of 0 collisions is known.
            let known = [F::TimeS, F::Takeovers, F::HumanS];
            let others = F::ALL.into_iter().filter(|figure| !known.contains(figure));
            others.for_each(|figure| figures.told(figure, None, NOTHING));
        }
        let why = if by_human { NO_PILOT } else { NOTHING };
        let bad = (!by_human && (seen || self.bad_frames > 0)).then_some(self.bad_frames.into());
        figures.told(F::BadFrames, bad, why);
        figures.told(F::Kicks, (seen || self.kicks > 0).then_some(self.kicks.into()), NOTHING);

        let tells = self.told.tells;
        let laps_asked = match &self.course {
            Some(course) => course.laps,
            None => self.blind.laps_asked,
        };
        let besides = found.map(|found| {
            let by_pilot = !no_pilot;
            let drive = DriveFacts { distance, began_s: span.began_s, time_s, human_s, by_pilot };
            (found.lap_m(), std::mem::take(&mut self.blind).fill(found, &mut figures, &drive, tells))
        });
        let (road_m, found) = besides.unwrap_or_default();
        self.notes.extend(found.note);
        if !span.is_timed {
            [F::Autonomy, F::AutonomyMeasured].into_iter().for_each(|figure| figures.told(figure, None, UNTIMED));
        }
        if !judged {
            let lap_m = road_m.or(self.told.waypoints.lap_m());
            span.open_ended(&mut figures, lap_m, laps_asked, (self.driven_m, self.all_laps));
            self.scores(&mut figures);
        }
        if self.assumes_time {
            untimed::untell(&mut figures);
        }
        let (track, scenario) = self.course.map(|course| (course.track, course.scenario)).unzip();
        let (lap_times_s, lap_times_off_s, lap_times_from) = if judged {
            (self.laps, None, "")
        } else if !self.told.lap_times_s.is_empty() {
            (self.told.lap_times_s, Some(self.told.lap_times_off_s), LAP_TIMES_TOLD)
        } else {
            (found.lap_times_s, found.lap_times_off_s, LAP_TIMES_FOUND)
        };
        Scorecard {
            track: track.or(self.told.track).or(found.track),
            scenario: scenario.flatten(),
            ended: self.ended,
            laps_asked,
            lap_times_off_s: lap_times_off_s.filter(|_| !lap_times_s.is_empty()),
            lap_times_s,
            lap_times_from,
            drives: found.drives,
            whereabouts: found.whereabouts,
            latency: self.stages.latencies(),
            damaged: self.damaged,
            notes: self.notes,
            ..figures.card()
        }
    }

    /// The figures that the course's judge reports.
    fn by_judge(&self, figures: &mut Figures, span: &Span, way: f64, distance: Measure) {
        use Figure as F;
        let laps_asked = self.course.as_ref().and_then(|course| course.laps);
        let waypoints = self.course.as_ref().map_or(1, |course| course.waypoints.max(1));
        let carried = f64::from(self.carried) / f64::from(waypoints);
        // Laps alone say nothing about the last, unfinished one.
        let tells_waypoints = self.told.laps.total().is_some() && self.told.waypoints.are_told();
        let asked = laps_asked.map(|asked| f64::from(asked.max(1)));
        let completion = asked
            .filter(|asked| tells_waypoints || self.progress >= *asked)
            .map(|asked| ((self.progress.min(asked) - carried) / asked).max(0.0));
        let no_completion = if laps_asked.is_none() { NO_LAPS_ASKED } else { NO_POSITION };
        figures.told(F::Completion, completion, no_completion);
        figures.told(F::Laps, Some(self.laps.len() as f64), NO_POSITION);
        let collisions = self.struck.len() as f64;
        figures.told(F::Collisions, Some(collisions), NO_JUDGE);
        figures.set(F::CollisionsPerKm, per_km(collisions, way, distance));
        let episodes = f64::from(self.resets + 1);
        let off_road_share = if self.driven_m > 0.0 { self.off_road_m / self.driven_m } else { 0.0 };
        let interventions = self.interventions(span.end_s);
        for (figure, value) in [
            (F::Episodes, episodes),
            (F::CollisionRate, f64::from(self.struck_episodes) / episodes),
            (F::OffRoads, self.off_roads.into()),
            (F::OffRoadS, self.off_road_s),
            (F::OffRoadShare, off_road_share),
            (F::Stuck, self.stuck.into()),
            (F::Resets, self.resets.into()),
            (F::Interventions, interventions.into()),
        ] {
            figures.set(figure, Measure::Told(value));
        }
        figures.set(F::InterventionsPerKm, per_km(interventions.into(), way, distance));
        let scores = completion.map(|completion| driving_scores(completion, off_road_share, &self.struck));
        figures.told(F::DrivingScore, scores.map(|(new, _)| new), no_completion);
        figures.told(F::DrivingScoreProduct, scores.map(|(_, old)| old), no_completion);

        let autonomies = (span.told_s > 0.0 && !self.no_pilot())
            .then(|| autonomies(span.time_s, self.takeovers, self.human_s, interventions));
        let why = if span.told_s > 0.0 { NO_PILOT } else { NO_TIME };
        figures.told(F::Autonomy, autonomies.map(|(counted, _)| counted), why);
        figures.told(F::AutonomyMeasured, autonomies.map(|(_, measured)| measured), why);
        let (survival_s, survival_m) = self.survival(span, way);
        figures.told(F::SurvivalS, Some(survival_s), NO_TIME);
        figures.set(F::SurvivalM, distance.part(survival_m, way));
    }

    /// Whether there are answers, and none is a pilot's.
    pub(super) fn no_pilot(&self) -> bool {
        self.answers.all > 0 && self.answers.pilot == 0
    }

    /// Times that the car was put back, plus one if the run ended in a situation that would have needed an
    /// intervention.
    pub(super) fn interventions(&self, end_s: f64) -> u32 {
        let struck = self.last_collision_s.is_some_and(|at| end_s - at <= AFTERMATH_S);
        self.resets + u32::from(self.ended_off_road || self.is_stuck || struck)
    }

    /// Seconds and metres to the first infraction, or to the end.
    pub(super) fn survival(&self, span: &Span, way: f64) -> (f64, f64) {
        self.survived.unwrap_or((span.time_s, way))
    }
}

/// A count over the distance driven.
pub(super) fn per_km(count: f64, way: f64, distance: Measure) -> Measure {
    over_way(way, distance, || distance.map(|way| count / (way / 1000.0), count / way / way * 1000.0))
}

/// Something over the distance driven, if that is known and not zero.
pub(super) fn over_way(way: f64, distance: Measure, divided: impl FnOnce() -> Measure) -> Measure {
    match distance {
        Measure::Unknown(_) => distance,
        _ if way > 0.0 => divided(),
        _ => Measure::Unknown(NO_WAY),
    }
}
