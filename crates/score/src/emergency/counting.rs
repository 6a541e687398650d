//! How Itu and Danescu count a predictor of emergency brakes, and the rates that follow.
//!
//! | | is |
//! |---|---|
//! | true positive | a labelled signal that a predicted run of at least 2 frames touches |
//! | false negative | a labelled signal that none does |
//! | false positive | a predicted run of at least 10 frames that touches no labelled signal |
//! | true negatives | the frames that are left: frames - TP - FP - FN |
//!
//! So signals are counted for positives and frames for negatives. **Accuracy says little** by this counting: emergencies are
//! rare, and a predictor that never fires has an accuracy of about 0.99 ([`Counts::of_silence`]). A predictor may also fire
//! for nine frames wherever it likes at no cost; [`super::evaluation`] counts the activations of a guard as well.
//!
//! What the paper leaves open: a frame is predicted where the network's output reaches a threshold; a run may touch several
//! signals, each of which is then found; runs and signals do not reach from one drive into the next.

use std::{iter::Sum, ops::Range};

use serde::Serialize;

/// How long predicted runs must be to count, in frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct CountingRule {
    /// A run at least this long finds a signal. 2 in the paper.
    pub found: usize,
    /// A run at least this long that finds none is a false positive. 10 in the paper.
    pub false_alarm: usize,
}

impl Default for CountingRule {
    fn default() -> Self {
        Self { found: 2, false_alarm: 10 }
    }
}

/// Signals and frames, counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Counts {
    /// Frames in all.
    pub frames: usize,
    /// Signals that were found.
    pub true_positives: usize,
    /// Runs that found none.
    pub false_positives: usize,
    /// Signals that were not found.
    pub false_negatives: usize,
}

/// The runs of frames that are set, each from its first to before the frame after its last.
pub fn runs(frames: impl IntoIterator<Item = bool>) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = vec![];
    for (i, set) in frames.into_iter().enumerate() {
        match runs.last_mut() {
            Some(run) if set && run.end == i => run.end += 1,
            _ if set => runs.push(i..i + 1),
            _ => {}
        }
    }
    runs
}

/// Whether two runs have a frame in common.
pub(super) fn touch(a: &Range<usize>, b: &Range<usize>) -> bool {
    a.start < b.end && b.start < a.end
}

impl Counts {
    /// Counts a drive: whether each frame is labelled, and whether it is predicted.
    pub fn of(labelled: &[bool], predicted: &[bool], rule: CountingRule) -> Self {
        let signals = runs(labelled.iter().copied());
        let predicted = runs(predicted.iter().copied());
        let finds = |run: &Range<usize>, signal: &Range<usize>| run.len() >= rule.found && touch(run, signal);
        let found = signals.iter().filter(|signal| predicted.iter().any(|run| finds(run, signal))).count();
        let touches_none = |run: &&Range<usize>| !signals.iter().any(|signal| touch(run, signal));
        let false_positives = predicted.iter().filter(|run| run.len() >= rule.false_alarm).filter(touches_none).count();
        Self { frames: labelled.len(), true_positives: found, false_positives, false_negatives: signals.len() - found }
    }

    /// Counts the same drives for a predictor that never fires.
    pub fn of_silence(self) -> Self {
        Self {
            true_positives: 0,
            false_positives: 0,
            false_negatives: self.true_positives + self.false_negatives,
            ..self
        }
    }

    /// The frames that are left.
    pub fn true_negatives(self) -> usize {
        self.frames.saturating_sub(self.true_positives + self.false_positives + self.false_negatives)
    }

    /// (TP + TN) / frames.
    pub fn accuracy(self) -> Option<f64> {
        share(self.true_positives + self.true_negatives(), self.frames)
    }

    /// TP / (TP + FP): how many alarms are right. None without an alarm.
    pub fn precision(self) -> Option<f64> {
        share(self.true_positives, self.true_positives + self.false_positives)
    }

    /// TP / (TP + FN): how many signals are found (TPR). None without a signal.
    pub fn recall(self) -> Option<f64> {
        share(self.true_positives, self.true_positives + self.false_negatives)
    }

    /// FP / (FP + TN).
    pub fn false_positive_rate(self) -> Option<f64> {
        share(self.false_positives, self.false_positives + self.true_negatives())
    }

    /// 2 TP / (2 TP + FP + FN): the harmonic mean of precision and recall. None without signal and alarm.
    pub fn f1(self) -> Option<f64> {
        let twice = 2 * self.true_positives;
        share(twice, twice + self.false_positives + self.false_negatives)
    }
}

impl Sum for Counts {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |a, b| Self {
            frames: a.frames + b.frames,
            true_positives: a.true_positives + b.true_positives,
            false_positives: a.false_positives + b.false_positives,
            false_negatives: a.false_negatives + b.false_negatives,
        })
    }
}

fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

/// A rate as the paper prints it: cut off after so many decimals, not rounded.
pub fn truncated(rate: f64, decimals: u32) -> f64 {
    let power = 10f64.powi(decimals as i32);
    // A rate that has these decimals exactly may lie a hair below them in binary.
    (rate * power + 1e-9).floor() / power
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `-` for a frame that is not set, anything else for one that is.
    fn frames(text: &str) -> Vec<bool> {
        text.chars().map(|c| c != '-').collect()
    }

    fn counted(labelled: &str, predicted: &str) -> (usize, usize, usize, usize) {
        let counts = Counts::of(&frames(labelled), &frames(predicted), CountingRule::default());
        (counts.true_positives, counts.false_positives, counts.false_negatives, counts.true_negatives())
    }

    #[test]
    fn a_run_of_two_frames_that_touches_a_signal_finds_it_and_one_frame_does_not() {
        assert_eq!(counted("----LLLL----", "-------PP---"), (1, 0, 0, 11));
        assert_eq!(counted("----LLLL----", "-------P----"), (0, 0, 1, 11));
        assert_eq!(counted("----LLLL----", "--------PP--"), (0, 0, 1, 11), "beside it is not on it");
        assert_eq!(counted("--LL--LL----", "---PPPP-----"), (2, 0, 0, 10), "one run finds both");
    }

    #[test]
    fn a_run_of_ten_frames_beside_every_signal_is_a_false_alarm_and_one_of_nine_is_not() {
        assert_eq!(counted("LL--------------", "----PPPPPPPPP---"), (0, 0, 1, 15));
        assert_eq!(counted("LL--------------", "----PPPPPPPPPP--"), (0, 1, 1, 14));
        assert_eq!(counted("LL--------------", "-PPPPPPPPPPPPP--"), (1, 0, 0, 15));
    }

    /// What could be checked against the paper: one recall and one false positive rate, with the counts behind them. What could
    /// not: all else in its tables I and II, which have eight columns. The tables themselves could not be read where this was
    /// written (of the paper, only its beginning), so the other counts are not known and none is made up. Counts that do not
    /// enter into these two rates are left at 0.
    #[test]
    fn the_papers_rates_follow_from_its_counts_cut_off_and_not_rounded() {
        let found = Counts { frames: 58, true_positives: 51, false_negatives: 7, ..Counts::default() };
        assert_eq!(truncated(found.recall().unwrap(), 3), 0.879);
        let negatives = Counts { frames: 2344, false_positives: 1, ..Counts::default() };
        assert_eq!(negatives.true_negatives(), 2343);
        assert_eq!(truncated(negatives.false_positive_rate().unwrap(), 4), 0.0004);
        // Where cutting off and rounding differ.
        assert_eq!((truncated(0.8799, 3), truncated(0.872, 3), truncated(2.0 / 3.0, 3)), (0.879, 0.872, 0.666));
    }

    #[test]
    fn a_predictor_that_never_fires_has_a_high_accuracy_and_finds_nothing() {
        let silent = Counts { frames: 1000, true_positives: 8, false_positives: 3, false_negatives: 2 }.of_silence();
        assert_eq!(silent.accuracy(), Some(0.99));
        assert_eq!((silent.recall(), silent.precision(), silent.f1()), (Some(0.0), None, Some(0.0)));
    }

    #[test]
    fn rates_of_nothing_are_none_and_drives_add_up() {
        assert_eq!(Counts::default().accuracy(), None);
        let one = Counts { frames: 10, true_positives: 1, false_positives: 2, false_negatives: 3 };
        let sum: Counts = [one, one].into_iter().sum();
        assert_eq!(sum, Counts { frames: 20, true_positives: 2, false_positives: 4, false_negatives: 6 });
        assert_eq!((sum.precision(), sum.recall(), sum.f1()), (Some(1.0 / 3.0), Some(0.25), Some(4.0 / 14.0)));
    }
}
