//! How good a predictor of emergency brakes is on recorded episodes: by the paper's counting, and by what that leaves out.
//!
//! ```text
//! labels, values of each episode ─▶ Counts (paper) + activations (guard) ─▶ Evaluation, with intervals
//! ```
//! A guard's *activation* is a run of at least two frames at or above the threshold, whatever its length. The bridge's guard
//! joins some of them, and starts none below 1.5 mph. It is right if it begins at most [`EARLY_S`] before a labelled signal
//! does, and before that ends. Each signal needs one. So a predictor that fires all the time is wrong, though by the paper's
//! counting its one run touches every signal and is no false positive.

use std::ops::Range;

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde::Serialize;

use super::counting::{CountingRule, Counts, runs};

/// An activation this much before a label, in seconds, is still for the same danger: a driver's reaction that is one
/// standard deviation longer than the mean, 1.3 s, and as long again.
pub const EARLY_S: f64 = 2.6;

/// Intervals are those of so many draws of as many episodes, with replacement (Efron, Bootstrap methods, 1979).
const DRAWS: usize = 1000;
const CERTAINTY: f64 = 0.95;

/// Thresholds of the precision-recall curve.
const STEPS: usize = 39;

/// An episode: a drive without gaps, its labels, and what a predictor says.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Episode {
    /// Its name.
    pub name: String,
    /// Time of each frame, in seconds.
    pub at_s: Vec<f64>,
    /// Whether an emergency brake is due at it.
    pub due: Vec<bool>,
    /// Frames at which the driver's foot goes down in an emergency.
    pub onsets: Vec<usize>,
    /// What the predictor says at it; NaN while it has not seen enough.
    pub values: Vec<f64>,
    /// When the car hit something, in seconds.
    pub impact_s: Option<f64>,
}

/// A rate, and what it may be: 95 % of the draws of episodes lie within. No interval where too few draws have one.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Rate {
    /// The rate.
    pub value: Option<f64>,
    /// Its interval.
    pub interval: Option<[f64; 2]>,
}

/// How far ahead of something activations are, in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Lead {
    /// Of how many.
    pub count: usize,
    /// Median; below 0 where it comes later.
    pub median: f64,
    /// A tenth are ahead by less.
    pub tenth: f64,
}

/// A point of the precision-recall curve, by the paper's counting.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CurvePoint {
    /// At and above this value a frame is predicted.
    pub threshold: f64,
    /// None where nothing is predicted.
    pub precision: Option<f64>,
    /// How many signals are found.
    pub recall: Option<f64>,
}

/// How good a predictor is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// At and above this value a frame is predicted.
    pub threshold: f64,
    /// Episodes, and their hours.
    pub episodes: usize,
    /// How long they are together.
    pub hours: f64,
    /// By the paper's counting.
    pub counts: Counts,
    /// (TP + TN) / frames.
    pub accuracy: Option<f64>,
    /// TP / (TP + FP).
    pub precision: Rate,
    /// TP / (TP + FN).
    pub recall: Rate,
    /// FP / (FP + TN).
    pub false_positive_rate: Option<f64>,
    /// The harmonic mean of precision and recall.
    pub f1: Rate,
    /// The accuracy of a predictor that never fires.
    pub silent_accuracy: Option<f64>,
    /// Activations of a guard that are right, that are not, and signals without one.
    pub activations: Counts,
    /// F1 of those.
    pub event_f1: Rate,
    /// Activations that are not right, an hour.
    pub false_alarms_per_h: Rate,
    /// How far right activations are ahead of the driver's foot.
    pub before_pedal: Option<Lead>,
    /// How far the first activation of an episode with an impact is ahead of that.
    pub before_impact: Option<Lead>,
    /// By the paper's counting, at all thresholds.
    pub curve: Vec<CurvePoint>,
}

/// What one episode adds up to.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    hours: f64,
    paper: Counts,
    events: Counts,
}

impl Episode {
    fn predicted(&self, threshold: f64) -> Vec<bool> {
        self.values.iter().map(|value| *value >= threshold).collect()
    }

    fn hours(&self) -> f64 {
        let frames = self.at_s.len();
        let (Some(first), Some(last)) = (self.at_s.first(), self.at_s.last()) else { return 0.0 };
        // A frame stands for the time to the next.
        if frames > 1 { (last - first) * frames as f64 / (frames - 1) as f64 / 3600.0 } else { 0.0 }
    }

    /// The activations of a guard: from the second frame on.
    fn activations(&self, threshold: f64) -> Vec<Range<usize>> {
        runs(self.predicted(threshold)).into_iter().filter(|run| run.len() > 1).collect()
    }

    /// Whether an activation is for this signal.
    fn is_for(&self, activation: &Range<usize>, signal: &Range<usize>) -> bool {
        let at = |i: usize| self.at_s.get(i).copied().unwrap_or(f64::NAN);
        let began = activation.start + 1;
        began < signal.end && at(began) >= at(signal.start) - EARLY_S
    }

    fn tally(&self, threshold: f64, rule: CountingRule) -> Tally {
        let (signals, activations) = (runs(self.due.iter().copied()), self.activations(threshold));
        let found = signals.iter().filter(|signal| activations.iter().any(|a| self.is_for(a, signal))).count();
        let wrong = activations.iter().filter(|a| !signals.iter().any(|signal| self.is_for(a, signal))).count();
        let events = Counts {
            frames: self.due.len(),
            true_positives: found,
            false_positives: wrong,
            false_negatives: signals.len() - found,
        };
        Tally { hours: self.hours(), paper: Counts::of(&self.due, &self.predicted(threshold), rule), events }
    }

    /// Seconds from each right activation, the first of its signal, to the driver's foot.
    fn before_pedal(&self, threshold: f64) -> Vec<f64> {
        let activations = self.activations(threshold);
        let lead = |signal: Range<usize>| {
            let onset = self.onsets.iter().find(|onset| signal.contains(onset))?;
            let first = activations.iter().find(|a| self.is_for(a, &signal))?;
            Some(self.at_s.get(*onset)? - self.at_s.get(first.start + 1)?)
        };
        runs(self.due.iter().copied()).into_iter().filter_map(lead).collect()
    }

    fn before_impact(&self, threshold: f64) -> Option<f64> {
        let impact_s = self.impact_s?;
        let began = |a: &Range<usize>| self.at_s.get(a.start + 1).copied();
        let before = |at: &f64| (impact_s - EARLY_S * 2.0..=impact_s).contains(at);
        Some(impact_s - self.activations(threshold).iter().filter_map(began).find(before)?)
    }
}

impl Evaluation {
    /// Judges a predictor on these episodes, by the rule at their frame rate. `seed` draws the intervals.
    pub fn of(episodes: &[Episode], threshold: f64, rule: CountingRule, seed: u64) -> Self {
        let tallies: Vec<Tally> = episodes.iter().map(|episode| episode.tally(threshold, rule)).collect();
        let all = sum(&tallies);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let draws: Vec<Tally> = (0..DRAWS)
            .map(|_| {
                let drawn = (0..tallies.len()).map(|_| tallies[random.random_range(0..tallies.len())]);
                sum(&drawn.collect::<Vec<_>>())
            })
            .collect();
        let rate = |of: &dyn Fn(&Tally) -> Option<f64>| Rate {
            value: of(&all),
            interval: interval(draws.iter().filter_map(of).collect()),
        };
        let per_hour = |t: &Tally| (t.hours > 0.0).then(|| t.events.false_positives as f64 / t.hours);
        Self {
            threshold,
            episodes: episodes.len(),
            hours: all.hours,
            counts: all.paper,
            accuracy: all.paper.accuracy(),
            precision: rate(&|t| t.paper.precision()),
            recall: rate(&|t| t.paper.recall()),
            false_positive_rate: all.paper.false_positive_rate(),
            f1: rate(&|t| t.paper.f1()),
            silent_accuracy: all.paper.of_silence().accuracy(),
            activations: all.events,
            event_f1: rate(&|t| t.events.f1()),
            false_alarms_per_h: rate(&per_hour),
            before_pedal: Lead::of(episodes.iter().flat_map(|e| e.before_pedal(threshold)).collect()),
            before_impact: Lead::of(episodes.iter().filter_map(|e| e.before_impact(threshold)).collect()),
            curve: curve(episodes, rule),
        }
    }
}

/// At least this share of activations should be right: the project's target for precision.
const LEAST_RIGHT: f64 = 0.9;

/// The threshold for a guard, of those of the curve: the lowest at which nine of ten activations are right and there is none in
/// the `harmless` episodes, such as ordinary laps; if there is none, the one with the best F1 by activations, the highest of equals.
pub fn guarding_threshold(episodes: &[Episode], harmless: &[Episode]) -> Option<f64> {
    let counts = |threshold: f64, episodes: &[Episode]| {
        let tally = |episode: &Episode| episode.tally(threshold, CountingRule::default());
        sum(&episodes.iter().map(tally).collect::<Vec<_>>()).events
    };
    let is_right = |threshold: &f64| {
        let is_precise = counts(*threshold, episodes).precision().is_some_and(|precision| precision >= LEAST_RIGHT);
        is_precise && counts(*threshold, harmless).false_positives == 0
    };
    let f1 = |threshold: f64| Some((threshold, counts(threshold, episodes).f1()?));
    let best = || thresholds().filter_map(f1).max_by(|a, b| a.1.total_cmp(&b.1).then(a.0.total_cmp(&b.0)));
    thresholds().find(is_right).or_else(|| Some(best()?.0))
}

fn thresholds() -> impl Iterator<Item = f64> {
    (1..=STEPS).map(|step| step as f64 / (STEPS + 1) as f64)
}

fn curve(episodes: &[Episode], rule: CountingRule) -> Vec<CurvePoint> {
    let point = |threshold: f64| {
        let counts: Counts = episodes.iter().map(|e| Counts::of(&e.due, &e.predicted(threshold), rule)).sum();
        CurvePoint { threshold, precision: counts.precision(), recall: counts.recall() }
    };
    thresholds().map(point).collect()
}

fn sum(tallies: &[Tally]) -> Tally {
    Tally {
        hours: tallies.iter().map(|t| t.hours).sum(),
        paper: tallies.iter().map(|t| t.paper).sum(),
        events: tallies.iter().map(|t| t.events).sum(),
    }
}

/// Between which values the middle of these lie.
fn interval(mut values: Vec<f64>) -> Option<[f64; 2]> {
    if values.len() < DRAWS / 2 {
        return None;
    }
    values.sort_by(f64::total_cmp);
    Some([(1.0 - CERTAINTY) / 2.0, (1.0 + CERTAINTY) / 2.0].map(|share| quantile(&values, share)))
}

/// A quantile of sorted values, of which there is one.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

impl Lead {
    fn of(mut leads: Vec<f64>) -> Option<Self> {
        leads.sort_by(f64::total_cmp);
        (!leads.is_empty()).then(|| Self {
            count: leads.len(),
            median: quantile(&leads, 0.5),
            tenth: quantile(&leads, 0.1),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 20 seconds at 15 Hz, a label of ten frames from 150 on, and a value of 1.0 in a range.
    fn episode(predicted: Option<Range<usize>>, has_signal: bool) -> Episode {
        Episode {
            name: String::new(),
            at_s: (0..300).map(|i| f64::from(i) / 15.0).collect(),
            due: (0..300).map(|i| has_signal && (150..160).contains(&i)).collect(),
            onsets: if has_signal { vec![151] } else { vec![] },
            values: (0..300)
                .map(|i| {
                    if i < 19 {
                        f64::NAN
                    } else {
                        f64::from(u8::from(predicted.clone().is_some_and(|p| p.contains(&i))))
                    }
                })
                .collect(),
            impact_s: None,
        }
    }

    fn judged(episodes: &[Episode]) -> Evaluation {
        Evaluation::of(episodes, 0.5, CountingRule::default(), 7)
    }

    #[test]
    fn an_activation_before_the_label_is_right_for_a_guard_and_touches_nothing_by_the_papers_counting() {
        // A second ahead of the label, for five frames.
        let early = judged(&[episode(Some(135..140), true)]);
        assert_eq!((early.counts.true_positives, early.counts.false_positives), (0, 0));
        assert_eq!((early.activations.true_positives, early.activations.false_positives), (1, 0));
        let lead = early.before_pedal.unwrap();
        assert!((lead.median - 1.0).abs() < 1e-9, "{lead:?}");
        // Held until the label, it is both.
        let held = judged(&[episode(Some(135..155), true)]);
        assert_eq!((held.counts.true_positives, held.activations.true_positives), (1, 1));
        // Far too early it is neither, and it is right by the paper's counting alone if it never ends.
        let far = judged(&[episode(Some(80..85), true)]);
        assert_eq!((far.activations.true_positives, far.activations.false_positives), (0, 1));
        let always = judged(&[episode(Some(19..300), true)]);
        assert_eq!((always.counts.true_positives, always.counts.false_positives), (1, 0));
        assert_eq!((always.activations.true_positives, always.activations.false_positives), (0, 1));
    }

    #[test]
    fn a_short_alarm_costs_a_guard_what_the_paper_forgives() {
        let alarmed = judged(&[episode(Some(100..105), false)]);
        assert_eq!((alarmed.counts.false_positives, alarmed.activations.false_positives), (0, 1));
        let per_h = alarmed.false_alarms_per_h.value.unwrap();
        assert!((per_h - 180.0).abs() < 1e-6, "one in 20 s: {per_h}");
        assert_eq!(judged(&[episode(Some(100..101), false)]).activations.false_positives, 0, "one frame alone");
    }

    #[test]
    fn intervals_hold_the_rate_and_are_wider_with_fewer_episodes() {
        let mix =
            |n: usize| -> Vec<Episode> { (0..n).map(|i| episode((i % 4 != 0).then_some(150..160), true)).collect() };
        let width = |n: usize| {
            let Rate { value, interval } = judged(&mix(n)).recall;
            let [low, high] = interval.unwrap();
            assert_eq!(value, Some(0.75));
            assert!(low <= 0.75 && 0.75 <= high, "{low} {high}");
            high - low
        };
        assert!(width(8) > width(80));
        let silent = judged(&[episode(None, true)]);
        assert_eq!((silent.precision.value, silent.precision.interval, silent.recall.value), (None, None, Some(0.0)));
        assert!(silent.silent_accuracy.unwrap() > 0.99);
    }

    #[test]
    fn the_curve_falls_from_all_found_to_none_and_a_guards_threshold_is_above_the_noise() {
        let mut weak = episode(Some(150..160), true);
        weak.values.iter_mut().for_each(|value| *value *= 0.6);
        let mut noise = episode(Some(100..120), false);
        noise.values.iter_mut().for_each(|value| *value *= 0.3);
        let episodes = [weak, noise];
        let curve = judged(&episodes).curve;
        assert_eq!((curve[0].recall, curve[0].precision), (Some(1.0), Some(0.5)));
        assert_eq!((curve[STEPS - 1].recall, curve[STEPS - 1].precision), (Some(0.0), None));
        // The noise reaches 0.3.
        assert_eq!(guarding_threshold(&episodes, &[]), Some(0.325));
        assert_eq!(guarding_threshold(&episodes, &episodes[..1]), Some(0.325), "its activation is right");
    }

    #[test]
    fn no_episodes_have_no_rates() {
        let nothing = judged(&[]);
        assert_eq!((nothing.recall.value, nothing.false_alarms_per_h.value, nothing.hours), (None, None, 0.0));
        assert_eq!(guarding_threshold(&[], &[]), None);
    }
}
