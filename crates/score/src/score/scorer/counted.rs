//! The figures of a run without a judge: what its telemetry reports, and what follows from that.

use super::{
    Scorer,
    judgement::{NO_JUDGE, NO_LAPS_ASKED, NO_PILOT, NO_POSITION, NO_TIME, UNTIMED, over_way, per_km},
    within_run::Span,
};
use crate::{
    score::blind::Found,
    score::card::Figures,
    score::infractions::{INTERVENTION_S, Struck, autonomies, driving_scores},
    score::{Figure, Measure},
};

const NO_COLLISIONS: &str = "the run does not report collisions";
const NO_EDGE: &str = "the run does not report when the car is off the road";
const NO_DURATION: &str = "the run reports how often the car was off the road, not for how long";
const NO_PUTS: &str = "the run does not report when the car is put back on the road";
const NO_STUCK: &str = "the run does not report when the car is stuck";
const NO_LAPS: &str = "the run does not report laps";
const NO_ROAD: &str =
    "the run does not report how much of the last lap was driven, and matches no known road: add yours with --track";
const UNSURE_ROAD: &str =
    "the run does not report how much of the last lap was driven, and which of the known roads it was on is uncertain";
const NEARLY_KNOWN: &str = "the run does not report how much of the last lap was driven, and no known road explains it well enough: \
                            a longer recording may tell, or it was on another road: add that with --track";
const AT_LINE: &str = "the run may end at the end of a lap: lapwing score checks the pictures";

const LAST_LAP: &str = "reported waypoints: the run ends at the end of a lap";
const OF_ROAD: &str = "reported waypoints, and the length of the road";
const BY_CTE: &str = "the distance from the line when the road was left";
const PUT: &str = "waypoints reached while standing still";
const UNNAMED: &str = "collisions reported without what was hit";

impl Scorer {
    /// The figures that telemetry reports; those that the stock build's does not report are left to `blind`.
    pub(super) fn by_telemetry(
        &mut self,
        figures: &mut Figures,
        span: &Span,
        way: f64,
        distance: Measure,
        found: Option<&Found>,
    ) {
        use Figure as F;
        let tells = self.told.tells;
        let why = |of_richer: &'static str| if tells { of_richer } else { NO_JUDGE };
        let (crashes, left_road) = (self.told.crashes.total(), self.told.out_of_bounds.total());
        figures.told(F::Collisions, crashes, why(NO_COLLISIONS));
        let per_km = crashes.map_or(Measure::Unknown(why(NO_COLLISIONS)), |n| per_km(n, way, distance));
        figures.set(F::CollisionsPerKm, per_km);
        figures.told(F::OffRoads, left_road, why(NO_EDGE));
        figures.told(F::Stuck, None, why(NO_STUCK));
        let (off_road_s, share) = self.off_road(left_road, span);
        figures.set(F::OffRoadS, if left_road.is_none() { Measure::Unknown(why(NO_EDGE)) } else { off_road_s });
        figures.set(F::OffRoadShare, if left_road.is_none() { Measure::Unknown(why(NO_EDGE)) } else { share });

        // A car that hit nothing and never left the road was not put back.
        let is_clean = crashes == Some(0.0) && left_road == Some(0.0) && self.resets == 0;
        let measure = |value: f64, uncertainty: f64, from| {
            if is_clean { Measure::Told(value) } else { Measure::Estimate { value, uncertainty, from } }
        };
        let puts = self.told.waypoints.are_told().then_some(f64::from(self.resets));
        let no_puts = why(NO_PUTS);
        let put = |of: &dyn Fn(f64) -> Measure| puts.map_or(Measure::Unknown(no_puts), of);
        figures.set(F::Resets, put(&|n| measure(n, 1.0, PUT)));
        figures.set(F::Episodes, put(&|n| measure(n + 1.0, 1.0, PUT)));
        let struck = f64::from(self.struck_episodes);
        let rate = |n: f64| measure(struck / (n + 1.0), 1.0 / (n + 1.0), PUT);
        figures
            .set(F::CollisionRate, if crashes.is_some() { put(&rate) } else { Measure::Unknown(why(NO_COLLISIONS)) });

        let interventions = self.interventions(span.end_s);
        let is_judged = crashes.is_some() && left_road.is_some() && puts.is_some();
        let untold = match () {
            () if span.told_s <= 0.0 => Some(NO_TIME),
            () if self.no_pilot() => Some(NO_PILOT),
            () if crashes.is_none() => Some(why(NO_COLLISIONS)),
            () if !is_judged => Some(why(NO_EDGE)),
            () if !span.is_timed => Some(UNTIMED),
            () => None,
        };
        figures.told(F::Interventions, None, why(NO_EDGE));
        figures.told(F::InterventionsPerKm, None, why(NO_EDGE));
        if is_judged {
            let counted = measure(interventions.into(), 1.0, PUT);
            figures.set(F::Interventions, counted);
            let km = way / 1000.0;
            figures.set(F::InterventionsPerKm, over_way(way, distance, || counted.map(|n| n / km, 1.0 / km)));
        }
        let (counted, measured) = autonomies(span.time_s, self.takeovers, self.human_s, interventions);
        let one = if span.time_s > 0.0 { (INTERVENTION_S / span.time_s).min(1.0) } else { 1.0 };
        for (figure, share) in [(F::Autonomy, counted), (F::AutonomyMeasured, measured)] {
            figures.set(figure, untold.map_or_else(|| measure(share, one, PUT), Measure::Unknown));
        }

        self.laps(figures, span, found);
        if crashes.is_some() {
            let (survival_s, survival_m) = self.survival(span, way);
            figures.told(F::SurvivalS, self.last.map(|_| survival_s), NO_TIME);
            figures.set(F::SurvivalM, distance.part(survival_m, way));
        } else {
            figures.told(F::SurvivalS, None, why(NO_COLLISIONS));
            figures.told(F::SurvivalM, None, why(NO_COLLISIONS));
        }
    }

    /// Time and share off the road.
    fn off_road(&self, left_road: Option<f64>, span: &Span) -> (Measure, Measure) {
        match left_road {
            Some(0.0) => (Measure::Told(0.0), Measure::Told(0.0)),
            Some(n) if self.told.tells_cte && span.told_s > 0.0 && self.driven_m > 0.0 => {
                // Each departure and return is known to within a telemetry.
                let off_s = 2.0 * n * span.told_s / (self.telemetries - 1) as f64;
                let estimate = |value, uncertainty| Measure::Estimate { value, uncertainty, from: BY_CTE };
                (
                    estimate(self.off_road_s, off_s),
                    estimate(self.off_road_m / self.driven_m, (off_s / span.told_s).min(1.0)),
                )
            }
            _ => (Measure::Unknown(NO_DURATION), Measure::Unknown(NO_DURATION)),
        }
    }

    /// Laps and completion, including the last lap, although the simulator leaves at its end.
    fn laps(&mut self, figures: &mut Figures, span: &Span, found: Option<&Found>) {
        use Figure as F;
        let (no_laps, no_completion) = match found {
            _ if !self.told.tells => (NO_POSITION, NO_POSITION),
            Some(found) => (NO_LAPS, found.why_unknown([UNSURE_ROAD, NEARLY_KNOWN, NO_ROAD])),
            None => (NO_LAPS, NO_ROAD),
        };
        let Some(laps) = self.told.laps.total() else {
            figures.told(F::Laps, None, no_laps);
            figures.told(F::Completion, None, no_completion);
            return;
        };
        let waypoints = &self.told.waypoints;
        let ends_lap = |road_m: &f64| waypoints.within(Some(*road_m)).is_some_and(|within| within.is_done);
        let matched_m = found.and_then(Found::lap_m);
        let known_m = || self.blind.roads().iter().map(|road| road.length_m).find(ends_lap);
        let within = waypoints.within(matched_m.or_else(known_m));
        let is_seen = found.is_some_and(|found| found.laps().map(f64::from) == Some(laps + 1.0));
        let may_end = !waypoints.are_told() || waypoints.is_at_line();
        let is_done = within.is_some_and(|within| within.is_done) || is_seen && may_end;
        let is_open = self.is_live && within.is_none() && may_end;
        let measure = match () {
            () if is_done => Measure::Estimate { value: laps + 1.0, uncertainty: 1.0, from: LAST_LAP },
            () if is_open => Measure::Unknown(AT_LINE),
            () => Measure::Told(laps),
        };
        figures.set(F::Laps, measure);
        // A human who drove before the first telemetry covered an unreported part of the lap.
        let by_human = self.began_s < self.first_s;
        let begun = within.filter(|_| !by_human).map_or(0.0, |within| within.begun);
        let share = within.map(|within| within.share).filter(|_| !is_done).or(is_done.then_some(1.0));
        let asked = self.blind.laps_asked.map(|asked| f64::from(asked.max(1)));
        let reported = asked.is_some_and(|asked| laps - begun >= asked);
        let completion = match (asked, share) {
            (None, _) => Measure::Unknown(NO_LAPS_ASKED),
            // How much of a lap it is from one waypoint to the next is unknown, too.
            (Some(_), None) if !reported || self.carried > 0 => Measure::Unknown(no_completion),
            (Some(asked), share) => {
                let driven = (laps - begun + share.unwrap_or(0.0)).clamp(0.0, asked);
                self.all_laps = driven >= asked;
                let each = within.map_or(0.0, |within| within.each);
                let value = ((driven - f64::from(self.carried) * each) / asked).max(0.0);
                let off = if reported { 0.0 } else { within.map_or(0.01, |within| within.off) / asked };
                match within {
                    _ if self.carried > 0 => Measure::Estimate { value, uncertainty: off + each / asked, from: PUT },
                    _ if reported => Measure::Told(value),
                    _ if is_done => Measure::Estimate { value, uncertainty: off, from: LAST_LAP },
                    Some(within) if within.is_counted => Measure::Told(value),
                    _ => Measure::Estimate { value, uncertainty: off, from: OF_ROAD },
                }
            }
        };
        figures.set(F::Completion, completion);
        if is_done {
            let apart_s = span.told_s / (self.telemetries - 1).max(1) as f64;
            self.told.last_lap_ended(span.last_s, 2.0 * apart_s);
        }
    }

    /// Driving scores; if it is unknown what was hit, a range over all kinds.
    pub(super) fn scores(&self, figures: &mut Figures) {
        use Figure as F;
        let crashes = self.told.crashes.total();
        let (completion, share) = (figures.get(F::Completion), figures.get(F::OffRoadShare));
        let untold = [completion, share, Measure::told(crashes, NO_COLLISIONS)].into_iter().find_map(|one| match one {
            Measure::Unknown(why) => Some(why),
            _ => None,
        });
        if let Some(why) = untold {
            let why = if self.told.tells || self.last.is_none() { why } else { NO_POSITION };
            [F::DrivingScore, F::DrivingScoreProduct].into_iter().for_each(|figure| figures.told(figure, None, why));
            return;
        }
        let off = |measure: Measure| match measure {
            Measure::Estimate { uncertainty, .. } => uncertainty,
            _ => 0.0,
        };
        let from = match (completion, share) {
            (Measure::Estimate { from, .. }, _) | (_, Measure::Estimate { from, .. }) => from,
            _ => UNNAMED,
        };
        let (done, off_road) = (completion.value().unwrap_or(0.0), share.value().unwrap_or(0.0));
        let struck = crashes.unwrap_or(0.0);
        let named = Some(&self.told.struck).filter(|named| named.len() as f64 == struck);
        let of = |kind: Struck| match named {
            Some(named) => driving_scores(done, off_road, named),
            // A file may give any number; after a hundred nothing is left of a score.
            None => driving_scores(done, off_road, &vec![kind; struck.min(100.0) as usize]),
        };
        let (least, most) = (of(Struck::Person), of(Struck::Static));
        let off_way = 100.0 * (off(completion) + off(share));
        for (figure, least, most) in [(F::DrivingScore, least.0, most.0), (F::DrivingScoreProduct, least.1, most.1)] {
            let uncertainty = (most - least) / 2.0 + off_way;
            let from = if most > least { UNNAMED } else { from };
            figures.set(
                figure,
                if uncertainty > 0.0 {
                    Measure::Estimate { value: (least + most) / 2.0, uncertainty, from }
                } else {
                    Measure::Told(most)
                },
            );
        }
    }
}

#[cfg(test)]
mod tests;
