//! When a run began and ended, and what is unknown if a human drove at one of its ends: meanwhile the simulator reports
//! nothing.

use super::{Scorer, judgement::UNTIMED};
use crate::{
    score::card::Figures,
    score::{Figure, Measure},
};

/// A human who drove for less than this at the end leaves nothing unknown, in seconds.
const MOMENT_S: f64 = 1.0;
const NOT_TOLD: &str = "a human drove to the end, and the simulator sends no telemetry meanwhile";

/// When a run was, in seconds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    /// The first telemetry, or a human's takeover before it.
    pub began_s: f64,
    /// The last telemetry, and the end: that of a human's drive after it.
    pub last_s: f64,
    pub end_s: f64,
    /// From the beginning to the end, and between the telemetries.
    pub time_s: f64,
    pub told_s: f64,
    /// Since when a human drove to the end.
    pub human_since: Option<f64>,
    /// Whether it is known how long humans drove.
    pub is_timed: bool,
}

impl Scorer {
    pub(super) fn span(&self) -> Span {
        let first_s = self.first_s.or(self.began_s).unwrap_or_default();
        let began_s = self.began_s.unwrap_or(first_s);
        let last_s = self.last.map_or(first_s, |(at, _)| at);
        let end_s = self.human_since.map_or(last_s, |_| self.latest_s.max(last_s));
        let told_s = last_s - first_s;
        let is_timed = self.clock.is_real_time() || (began_s == first_s && self.human_since.is_none());
        let time_s = if is_timed { end_s - began_s } else { told_s };
        Span { began_s, last_s, end_s, time_s, told_s, human_since: self.human_since, is_timed }
    }
}

impl Span {
    /// A human who drove on after the last telemetry came further than reported, limited by the car's top speed.
    pub(super) fn open_ended(
        &self,
        figures: &mut Figures,
        lap_m: Option<f64>,
        asked: Option<u32>,
        (driven_m, all_laps): (f64, bool),
    ) {
        let Some(open_s) = self.human_since.map(|since| self.end_s - since) else { return };
        if self.is_timed && open_s < MOMENT_S || self.told_s <= 0.0 {
            return;
        }
        let open =
            lap_m.filter(|lap_m| *lap_m > 0.0 && self.is_timed).map(|lap_m| driven_m / self.told_s * open_s / lap_m);
        let asked = f64::from(asked.unwrap_or(1).max(1));
        for (figure, more) in [(Figure::Completion, open.map(|laps| laps / asked)), (Figure::Laps, open.map(f64::ceil))]
        {
            let whole = figure == Figure::Completion && all_laps;
            let measure = match (figures.get(figure), more) {
                (Measure::Unknown(_), _) => continue,
                _ if whole => continue,
                (_, None) => Measure::Unknown(if self.is_timed { NOT_TOLD } else { UNTIMED }),
                (Measure::Told(value), Some(more)) => Measure::Estimate {
                    value,
                    uncertainty: more,
                    from: "what was reported until a human drove to the end",
                },
                (Measure::Estimate { value, uncertainty, from }, Some(more)) => {
                    Measure::Estimate { value, uncertainty: uncertainty + more, from }
                }
            };
            figures.set(figure, measure);
        }
    }
}
