//! Checks a run against its thresholds.

use super::{Figure, Scorecard};
use lapwing_core::{
    config::{Threshold, Thresholds},
    drive::too_many_bad_frames,
};

/// A threshold checked against a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// The setting, such as `min_completion`.
    pub name: &'static str,
    /// Whether the run reaches it. A figure that is not measurable does not.
    pub passed: bool,
    /// What was expected and what came, in words.
    pub words: String,
}

/// Every threshold that is set, checked against a run; a damaged run is never known to reach them, and one with too many bad
/// frames says too little.
pub fn checks(thresholds: &Thresholds, card: &Scorecard) -> Vec<Check> {
    let check = |threshold: Threshold| {
        let limit = threshold.limit(thresholds)?;
        let figure = Figure::of_key(threshold.figure)?;
        let (bound, unit, value) = (threshold.bound, figure.unit(), card.value(figure));
        let passed = value.is_some_and(|value| bound.holds(value, limit));
        // Where what came is rounded to what was expected, by how little it differs.
        let alike = value.filter(|value| !passed && unit.show(*value) == unit.show(limit));
        let alike = alike.map_or_else(String::new, |value| format!(" ({})", unit.show_given(value)));
        let (label, expected, got) = (figure.label(), unit.show_given(limit), card.words(figure));
        let words = format!("{label}: expected {} {expected}, got {got}{alike}", bound.words());
        Some(Check { name: threshold.key, passed, words })
    };
    let mut checks: Vec<Check> = Thresholds::ALL.into_iter().filter_map(check).collect();
    if card.damaged && !checks.is_empty() {
        let words = "the run's file: expected a complete one, got a damaged one: the lost part may have been worse";
        checks.push(Check { name: "whole", passed: false, words: words.into() });
    }
    // The rate is that of the intervals.
    let frames = card
        .value(Figure::FramesPerS)
        .zip(card.value(Figure::TimeS))
        .map(|(rate, time_s)| (rate * time_s).round() + 1.0);
    let bad = card.value(Figure::BadFrames).zip(frames).filter(|_| !checks.is_empty());
    if let Some(words) = bad.and_then(|(bad, frames)| too_many_bad_frames(bad as u64, frames as u64)) {
        checks.push(Check { name: "bad_frames", passed: false, words });
    }
    checks
}

/// Each threshold that a run misses, in words.
pub fn missed(thresholds: &Thresholds, card: &Scorecard) -> Vec<String> {
    checks(thresholds, card).into_iter().filter(|check| !check.passed).map(|check| check.words).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::{Better, Unit};
    use lapwing_core::config::{Bound, LimitUnit};

    #[test]
    fn each_threshold_bounds_a_figure_that_there_is_on_the_side_on_which_it_gets_worse() {
        for threshold in Thresholds::ALL {
            let figure = Figure::of_key(threshold.figure).expect(threshold.figure);
            let side = match figure.better() {
                Better::Higher => Bound::AtLeast,
                Better::Lower => Bound::AtMost,
                Better::Neither => panic!("{}: no side of it is better", threshold.figure),
            };
            assert_eq!(threshold.bound, side, "{}", threshold.key);
            let is_share = figure.unit() == Unit::Share;
            assert_eq!(is_share, threshold.unit == LimitUnit::Percent, "{}", threshold.key);
        }
    }

    #[test]
    fn a_run_of_mostly_bad_frames_passes_no_threshold() {
        let card = |bad: f64| {
            let mut figures = crate::score::card::Figures::unknown("");
            let told = [
                (Figure::Collisions, 0.0),
                (Figure::FramesPerS, 15.0),
                (Figure::TimeS, 20.0),
                (Figure::BadFrames, bad),
            ];
            told.into_iter().for_each(|(figure, value)| figures.told(figure, Some(value), ""));
            figures.card()
        };
        let limits = Thresholds { max_collisions: Some(0), ..Thresholds::default() };
        assert!(missed(&limits, &card(3.0)).is_empty());
        let words = "expected at most 1 % bad frames, which no network sees, got 4 of 301";
        assert_eq!(missed(&limits, &card(4.0)), [words]);
        assert!(missed(&Thresholds::default(), &card(300.0)).is_empty());
    }
}
