//! Whether runs got worse than they were.

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};

use super::{Better, Figure, Spread, Unit, summary::student};

/// A difference is none by chance where it is so many times the half width of its confidence interval at 95 %: some
/// forty figures are compared, and one of them would often lie outside the interval itself.
const CERTAIN: f64 = 2.0;
/// Where one run alone tells a figure nobody knows its noise; a change of so large a share is taken for one.
const ALONE: f64 = 0.05;

/// Which way a figure went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Turn {
    /// Better beyond noise.
    Better,
    /// Within noise.
    Same,
    /// Worse beyond noise, or not measurable any more.
    Worse,
}

/// A figure before and now.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Change {
    /// Its key.
    pub figure: &'static str,
    /// Over the baseline's runs.
    pub before: Spread,
    /// Over these; `None` where they do not tell it.
    pub now: Option<Spread>,
    /// How far apart the means may lie by chance.
    pub noise: f64,
    /// Which way it went.
    pub turn: Turn,
    #[serde(skip)]
    unit: Unit,
}

/// The part of a baseline (the JSON of `lapwing score`) that is held against.
#[derive(Debug, Clone, Deserialize)]
pub struct Baseline {
    /// Which JSON it is.
    pub schema: String,
    /// Each figure's spread, by key.
    pub summary: BTreeMap<String, Spread>,
}

/// Each figure of the baseline that has a better and a worse, before and now. Figures that the baseline does not know
/// are new, and left out.
pub fn changes(baseline: &Baseline, now: &BTreeMap<&'static str, Spread>) -> Vec<Change> {
    let change = |figure: Figure| {
        let before = *baseline.summary.get(figure.key()).filter(|before| before.runs > 0)?;
        let now = now.get(figure.key()).copied();
        let sign = match figure.better() {
            Better::Higher => 1.0,
            Better::Lower => -1.0,
            Better::Neither => return None,
        };
        let noise = now.map_or(0.0, |now| noise(figure.unit(), &before, &now));
        let turn = match now.map(|now| sign * (now.mean - before.mean)) {
            Some(gain) if gain > noise => Turn::Better,
            Some(gain) if gain >= -noise => Turn::Same,
            _ => Turn::Worse,
        };
        Some(Change { figure: figure.key(), before, now, noise, turn, unit: figure.unit() })
    };
    Figure::ALL.into_iter().filter_map(change).collect()
}

fn noise(unit: Unit, before: &Spread, now: &Spread) -> f64 {
    let of = |spread: &Spread| Some((spread.deviation?.powi(2), (spread.runs - 1) as f64));
    let each = 1.0 / before.runs as f64 + 1.0 / now.runs as f64;
    let chance = match (of(before), of(now)) {
        // A collision more is one however few runs there were.
        (None, None) if unit == Unit::Count => 0.0,
        (None, None) => ALONE * before.mean.abs(),
        // The scatter of both together; of one alone where the other is a single run.
        (a, b) => {
            let ((a, of_a), (b, of_b)) = (a.unwrap_or((0.0, 0.0)), b.unwrap_or((0.0, 0.0)));
            let freedom = of_a + of_b;
            let variance = (a * of_a + b * of_b) / freedom;
            CERTAIN * student(freedom as usize) * (variance * each).sqrt()
        }
    };
    chance.max(trifle(unit))
}

/// Differences that nobody cares for.
fn trifle(unit: Unit) -> f64 {
    match unit {
        Unit::Count => 0.0,
        Unit::Share | Unit::Lock => 0.001,
        Unit::LockSquared => 0.0001,
        Unit::PerKm | Unit::Metres | Unit::Correlation => 0.01,
        Unit::Mph | Unit::Points | Unit::Seconds | Unit::DegreesPerSecond => 0.1,
        Unit::PerMinute | Unit::PerSecond | Unit::PerHour => 0.5,
        Unit::Jerk => 0.05,
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let show = |mean: f64| self.unit.show_mean(mean);
        let now = self.now.map_or_else(|| "not measurable".into(), |now| show(now.mean));
        write!(f, "{}: {} before, {now} now, noise {}", self.figure, show(self.before.mean), show(self.noise))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changed(figure: Figure, before: &[f64], now: &[f64]) -> Turn {
        let key = figure.key();
        let summary = BTreeMap::from([(key.to_owned(), Spread::of(before).unwrap())]);
        let baseline = Baseline { schema: String::new(), summary };
        let now = Spread::of(now).map(|spread| (key, spread)).into_iter().collect();
        changes(&baseline, &now)[0].turn
    }

    #[test]
    fn what_lies_within_the_scatter_of_the_runs_is_no_change() {
        let before = [0.20, 0.24, 0.28];
        assert_eq!(changed(Figure::MeanCte, &before, &[0.22, 0.26, 0.30]), Turn::Same);
        assert_eq!(changed(Figure::MeanCte, &before, &[0.42, 0.46, 0.50]), Turn::Worse, "5.6 times 0.033");
        assert_eq!(changed(Figure::MeanCte, &before, &[0.05, 0.06, 0.07]), Turn::Better);
    }

    #[test]
    fn a_collision_more_is_worse_even_in_a_single_run() {
        assert_eq!(changed(Figure::Collisions, &[0.0], &[1.0]), Turn::Worse);
        assert_eq!(changed(Figure::Collisions, &[1.0], &[1.0]), Turn::Same);
        assert_eq!(changed(Figure::Completion, &[1.0], &[0.9]), Turn::Worse);
        assert_eq!(changed(Figure::Completion, &[0.98], &[1.0]), Turn::Same, "within 5 %");
    }

    #[test]
    fn one_run_is_held_against_the_scatter_of_many() {
        let before = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0];
        assert_eq!(changed(Figure::Collisions, &before, &[1.0]), Turn::Same);
        assert_eq!(changed(Figure::Collisions, &before, &[3.0]), Turn::Worse);
    }

    #[test]
    fn what_is_not_measurable_any_more_is_worse() {
        assert_eq!(changed(Figure::MeanCte, &[0.2], &[]), Turn::Worse);
    }
}
