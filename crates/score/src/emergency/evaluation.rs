//! How good a predictor of emergency brakes is on recorded episodes: by the paper's counting, and by what that leaves out.
//!
//! ```text
//! labels, values of each episode ─▶ Counts (paper) + activations (guard) ─▶ Evaluation, with intervals
//! ```
//! A guard's *activation* is what the bridge's guard makes of the values: they go through the same [`Warned`] and
//! [`EmergencyBrake`], with the speeds that the car had. It is right if it begins at most [`EARLY_S`] before a labelled signal
//! does, and before that ends. Each signal needs one. So a predictor that fires all the time is wrong, though by the paper's
//! counting its one run touches every signal and is no false positive.

#[cfg(test)]
mod tests;

use std::{fmt, ops::Range, time::Duration};

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde::Serialize;

use super::counting::{CountingRule, Counts, runs};
use lapwing_core::{
    control::{BrakeChange, BrakeLimits, EmergencyBrake, Warned},
    stats::quantile,
    units::Mph,
};

/// An activation this much before a label, in seconds, is still for the same danger: the longest reaction of a driver in the
/// data, 1.6 s, and as long again.
pub const EARLY_S: f64 = 3.2;

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
    /// Whether it says that something is close ahead, 0 to 1; empty of a predictor that does not say it.
    pub blocked: Vec<f64>,
    /// How fast the car is at it, in mph.
    pub speed_mph: Vec<f64>,
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
    /// At and above this value a frame is predicted, and a guard brakes …
    pub threshold: f64,
    /// … until its value is below this one.
    pub releases: f64,
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

    /// The frames at which the bridge's guard would begin to brake.
    pub fn activations(&self, limits: BrakeLimits) -> Vec<usize> {
        let (mut warned, mut brake) = (Warned::default(), EmergencyBrake::new(limits));
        let begins = |(i, (at_s, due)): (usize, (&f64, &f64))| {
            let blocked = self.blocked.get(i).copied().unwrap_or(0.0);
            let value = due.is_finite().then(|| warned.value(*due, blocked, limits));
            let speed = Mph::saturating(self.speed_mph.get(i).copied().unwrap_or(0.0));
            let change = brake.update(Duration::from_secs_f64(at_s.max(0.0)), speed, value);
            matches!(change, Some(BrakeChange::Began { .. })).then_some(i)
        };
        self.at_s.iter().zip(&self.values).enumerate().filter_map(begins).collect()
    }

    /// Whether an activation that begins there is for this signal.
    fn is_for(&self, began: usize, signal: &Range<usize>) -> bool {
        let at = |i: usize| self.at_s.get(i).copied().unwrap_or(f64::NAN);
        began < signal.end && at(began) >= at(signal.start) - EARLY_S
    }

    fn events(&self, limits: BrakeLimits) -> Counts {
        let (signals, activations) = (runs(self.due.iter().copied()), self.activations(limits));
        let found = signals.iter().filter(|signal| activations.iter().any(|a| self.is_for(*a, signal))).count();
        let wrong = activations.iter().filter(|a| !signals.iter().any(|signal| self.is_for(**a, signal))).count();
        Counts {
            frames: self.due.len(),
            true_positives: found,
            false_positives: wrong,
            false_negatives: signals.len() - found,
        }
    }

    fn tally(&self, limits: BrakeLimits, rule: CountingRule) -> Tally {
        let paper = Counts::of(&self.due, &self.predicted(limits.fires), rule);
        Tally { hours: self.hours(), paper, events: self.events(limits) }
    }

    /// Seconds from each right activation, the first of its signal, to the driver's foot.
    fn before_pedal(&self, limits: BrakeLimits) -> Vec<f64> {
        let activations = self.activations(limits);
        let lead = |signal: Range<usize>| {
            let onset = self.onsets.iter().find(|onset| signal.contains(onset))?;
            let first = activations.iter().find(|a| self.is_for(**a, &signal))?;
            Some(self.at_s.get(*onset)? - self.at_s.get(*first)?)
        };
        runs(self.due.iter().copied()).into_iter().filter_map(lead).collect()
    }

    /// Seconds from the first activation that may be for an impact to it.
    fn before_impact(&self, limits: BrakeLimits) -> Option<f64> {
        let impact_s = self.impact_s?;
        let before = |at: &f64| (impact_s - EARLY_S * 2.0..=impact_s).contains(at);
        Some(impact_s - self.activations(limits).into_iter().map(|began| self.at_s[began]).find(before)?)
    }
}

impl Evaluation {
    /// Judges a predictor on these episodes, and a guard that brakes by it within these limits, by the rule at their frame
    /// rate. `seed` draws the intervals.
    pub fn of(episodes: &[Episode], limits: BrakeLimits, rule: CountingRule, seed: u64) -> Self {
        let tallies: Vec<Tally> = episodes.iter().map(|episode| episode.tally(limits, rule)).collect();
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
            threshold: limits.fires,
            releases: limits.releases,
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
            before_pedal: Lead::of(episodes.iter().flat_map(|e| e.before_pedal(limits)).collect()),
            before_impact: Lead::of(episodes.iter().filter_map(|e| e.before_impact(limits)).collect()),
            curve: curve(episodes, rule),
        }
    }
}

/// At least this share of activations should be right: the project's target for precision.
const LEAST_RIGHT: f64 = 0.9;

/// By which rule a guard's limits were chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LimitRule {
    /// The lowest threshold at which nine of ten activations are right and there is none in what is harmless.
    NineOfTen,
    /// There is none: the one with the best F1 by activations.
    BestF1,
}

impl fmt::Display for LimitRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NineOfTen => "the lowest threshold with nine of ten activations right and none on laps",
            Self::BestF1 => "the best F1, as no threshold has nine of ten activations right and none on laps",
        })
    }
}

/// The limits for a guard, whose lower one is this share of the upper one, and the rule that chose them. The upper one is the
/// lowest threshold of the curve at which nine of ten activations are right and there is none in the `harmless` episodes, such
/// as ordinary laps; if there is none, the one with the best F1 by activations, the highest of equals.
pub fn chosen_limits(episodes: &[Episode], harmless: &[Episode], releases: f64) -> Option<(BrakeLimits, LimitRule)> {
    let of = |fires: f64| BrakeLimits { fires, releases: fires * releases };
    let counts = |limits: BrakeLimits, episodes: &[Episode]| {
        episodes.iter().map(|episode| episode.events(limits)).sum::<Counts>()
    };
    let is_right = |limits: &BrakeLimits| {
        let is_precise = counts(*limits, episodes).precision().is_some_and(|precision| precision >= LEAST_RIGHT);
        is_precise && counts(*limits, harmless).false_positives == 0
    };
    let f1 = |limits: BrakeLimits| Some((limits, counts(limits, episodes).f1()?));
    let best =
        || thresholds().map(of).filter_map(f1).max_by(|a, b| a.1.total_cmp(&b.1).then(a.0.fires.total_cmp(&b.0.fires)));
    let right = thresholds().map(of).find(is_right).map(|limits| (limits, LimitRule::NineOfTen));
    right.or_else(|| Some((best()?.0, LimitRule::BestF1)))
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
    let bound = |share| quantile(&values, share);
    Some([bound((1.0 - CERTAINTY) / 2.0)?, bound((1.0 + CERTAINTY) / 2.0)?])
}

impl Lead {
    fn of(mut leads: Vec<f64>) -> Option<Self> {
        leads.sort_by(f64::total_cmp);
        Some(Self { count: leads.len(), median: quantile(&leads, 0.5)?, tenth: quantile(&leads, 0.1)? })
    }
}
