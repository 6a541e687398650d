//! At which moments an emergency brake is due, by how fast the pedal goes down.
//!
//! | step | by default, at 15 Hz |
//! |---|---|
//! | the pedal is smoothed by a Gaussian | 5 taps, standard deviation 3.5 samples: .184 .208 .217 .208 .184 |
//! | its slope, where it rises | the first difference, over the time between the two samples |
//! | an event begins where the slope passes a threshold | 1 per second |
//! | and is labelled 1.0 | for 10 samples, from one before it on |
//!
//! At other rates, all lengths are the same in seconds.
//!
//! What the paper leaves open:
//!
//! - **The threshold** is the geometric mean of two pedals: a third of the way down in a second, the quickest that a gentle stop
//!   needs, and all the way down in a third of a second, the slowest of an emergency. Smoothed, a pedal that goes down at
//!   once rises by 3.2 per second.
//! - **Neighbouring slopes above it** are one event, which begins with the first of them: a foot goes down once.
//! - **Events closer together than a label is long** share one longer label.
//! - **At the ends of a drive** the Gaussian's taps that are left are weighted up to a sum of 1.
//! - **Where samples are missing** its taps lie on the straight line between the two samples on either side: smoothed over
//!   fewer taps, a foot that goes down evenly would seem to slow down before the gap, and be two events.
//! - **The Gaussian looks ahead** by half its taps, so a label begins two samples earlier than the pedal's own slope would have
//!   it: three samples, a fifth of a second, before the foot.

use serde::Serialize;

use super::Pressed;

/// How a pedal becomes labels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LabelRule {
    /// Samples per second at which the other lengths hold. 15 by default.
    pub hz: f64,
    /// Taps of the Gaussian; odd. 5 by default.
    pub taps: usize,
    /// Its standard deviation, in samples. 3.5 by default.
    pub deviation: f64,
    /// The slope at which braking is an emergency, in pedals per second. 1 by default.
    pub threshold_per_s: f64,
    /// Samples that an event labels. 10 by default.
    pub length: usize,
    /// How many of them lie before it. 1 by default.
    pub lead: usize,
}

impl Default for LabelRule {
    fn default() -> Self {
        Self { hz: 15.0, taps: 5, deviation: 3.5, threshold_per_s: 1.0, length: 10, lead: 1 }
    }
}

impl LabelRule {
    /// The same rule for so many samples per second: lengths of at least a sample, and an odd number of taps.
    pub fn at(self, hz: f64) -> Self {
        let times = hz / self.hz;
        let samples = |count: usize| ((count as f64 * times).round() as usize).max(1);
        Self {
            hz,
            taps: 2 * (((self.taps / 2) as f64 * times).round() as usize) + 1,
            deviation: self.deviation * times,
            length: samples(self.length),
            lead: samples(self.lead),
            ..self
        }
    }

    /// The Gaussian's weights from the middle tap outwards; their sum, but for the middle one twice, is 1.
    fn weights(&self) -> Vec<f64> {
        let weight = |i: usize| (-0.5 * (i as f64 / self.deviation).powi(2)).exp();
        let weights: Vec<f64> = (0..=self.taps / 2).map(weight).collect();
        let sum = 2.0 * weights.iter().sum::<f64>() - weights[0];
        weights.into_iter().map(|weight| weight / sum).collect()
    }
}

/// What is known of a moment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Label {
    /// The pedal, 0 to 1, smoothed.
    pub smoothed: f64,
    /// How fast it goes down, in pedals per second; 0 where it is held or let go.
    pub slope_per_s: f64,
    /// Whether an emergency brake is due: the label is 1.0, else 0.0.
    pub due: bool,
}

/// A drive and its labels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Braked {
    /// The label of each moment.
    pub labels: Vec<Label>,
    /// At which of them an emergency begins.
    pub events: Vec<usize>,
}

/// The labels of a drive without gaps. The rule is the one [`at`](LabelRule::at) 15 samples per second; the rate of the drive
/// is that of its median interval.
pub fn labels(drive: &[Pressed], rule: LabelRule) -> Braked {
    let rule = rate_hz(drive).map_or(rule, |hz| rule.at(hz));
    let weights = rule.weights();
    let smoothed: Vec<f64> = (0..drive.len()).map(|i| smoothed(drive, i, &weights, rule.hz)).collect();
    let slope = |i: usize| {
        let dt_s = if i == 0 { 0.0 } else { drive[i].at_s - drive[i - 1].at_s };
        if dt_s > 0.0 { ((smoothed[i] - smoothed[i - 1]) / dt_s).max(0.0) } else { 0.0 }
    };
    let slopes: Vec<f64> = (0..drive.len()).map(slope).collect();
    let steep = |i: usize| slopes[i] >= rule.threshold_per_s;
    let events: Vec<usize> = (0..drive.len()).filter(|&i| steep(i) && !(i > 0 && steep(i - 1))).collect();
    let mut labels: Vec<Label> = smoothed
        .iter()
        .zip(&slopes)
        .map(|(&smoothed, &slope_per_s)| Label { smoothed, slope_per_s, due: false })
        .collect();
    for event in &events {
        let first = event.saturating_sub(rule.lead);
        labels.iter_mut().skip(first).take(rule.length).for_each(|label| label.due = true);
    }
    Braked { labels, events }
}

/// So many intervals are timed together: a clock may tell 15 samples per second in steps of 20 ms.
const TIMED: usize = 15;

/// Samples per second, by the median time of some of them; `None` if there are too few, or time stands still.
fn rate_hz(drive: &[Pressed]) -> Option<f64> {
    let timed = TIMED.min(drive.len().checked_sub(1)?).max(1);
    let mut times_s: Vec<f64> = drive.windows(timed + 1).map(|some| some[timed].at_s - some[0].at_s).collect();
    times_s.sort_by(f64::total_cmp);
    let median_s = *times_s.get(times_s.len() / 2)?;
    (median_s > 0.0).then(|| timed as f64 / median_s)
}

/// The pedal at a moment, smoothed.
fn smoothed(drive: &[Pressed], i: usize, weights: &[f64], hz: f64) -> f64 {
    let reach = weights.len() as isize - 1;
    let (mut sum, mut weight) = (0.0, 0.0);
    for tap in -reach..=reach {
        let Some(pedal) = pedal_at(drive, i, tap, hz) else { continue };
        let share = weights[tap.unsigned_abs()];
        sum += share * pedal;
        weight += share;
    }
    sum / weight
}

/// A sample that is less than this from its time, in samples, is taken as it is: clocks are coarse, but one that is
/// missing puts the next a whole sample off.
const LATE: f64 = 0.6;

/// The pedal so many samples after a moment; none before the drive begins or after it ends.
fn pedal_at(drive: &[Pressed], i: usize, tap: isize, hz: f64) -> Option<f64> {
    let at_s = drive[i].at_s + tap as f64 / hz;
    let counted = i.checked_add_signed(tap).and_then(|k| drive.get(k));
    if let Some(pressed) = counted.filter(|pressed| (pressed.at_s - at_s).abs() * hz <= LATE) {
        return Some(pressed.pedal);
    }
    let next = drive.partition_point(|pressed| pressed.at_s < at_s);
    let (before, after) = (drive.get(next.checked_sub(1)?)?, drive.get(next)?);
    let between_s = after.at_s - before.at_s;
    let share = if between_s > 0.0 { ((at_s - before.at_s) / between_s).clamp(0.0, 1.0) } else { 0.0 };
    Some(before.pedal + (after.pedal - before.pedal) * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pedal at so many samples per second.
    fn drive(hz: f64, pedal: impl IntoIterator<Item = f64>) -> Vec<Pressed> {
        let sample = |(i, pedal)| Pressed { at_s: i as f64 / hz, speed_kmh: 40.0, pedal };
        pedal.into_iter().enumerate().map(sample).collect()
    }

    /// Where labels are 1.0, as ranges with the last index included.
    fn due(braked: &Braked) -> Vec<(usize, usize)> {
        let mut ranges: Vec<(usize, usize)> = vec![];
        for i in (0..braked.labels.len()).filter(|&i| braked.labels[i].due) {
            match ranges.last_mut() {
                Some((_, last)) if *last + 1 == i => *last = i,
                _ => ranges.push((i, i)),
            }
        }
        ranges
    }

    #[test]
    fn samples_whose_time_is_told_in_coarse_steps_come_as_often_as_they_do() {
        let steps = |count: usize| -> Vec<Pressed> {
            (0..count).map(|i| Pressed { at_s: (i * 10 / 3) as f64 * 0.02, speed_kmh: 30.0, pedal: 0.0 }).collect()
        };
        assert!((rate_hz(&steps(100)).unwrap() - 15.0).abs() < 1e-9);
        assert!(rate_hz(&steps(2)).is_some() && rate_hz(&steps(1)).is_none() && rate_hz(&[]).is_none());
    }

    #[test]
    fn the_taps_are_those_of_the_paper() {
        let weights = LabelRule::default().weights();
        let rounded: Vec<f64> = weights.iter().map(|weight| (weight * 1000.0).round() / 1000.0).collect();
        assert_eq!(rounded, [0.217, 0.208, 0.184]);
    }

    #[test]
    fn a_pedal_that_goes_down_at_once_is_one_event_of_ten_samples_that_begins_one_before_the_smoothed_pedal_rises() {
        // Full from sample 20 on: the Gaussian feels it from 18 on.
        let braked = labels(&drive(15.0, (0..60).map(|i| f64::from(i >= 20))), LabelRule::default());
        assert_eq!(braked.events, [18]);
        assert_eq!(due(&braked), [(17, 26)]);
        let most = braked.labels.iter().map(|label| label.slope_per_s).fold(0.0, f64::max);
        assert!((most - 0.2165 * 15.0).abs() < 0.01, "{most}");
        let last = braked.labels[59];
        assert!((last.smoothed - 1.0).abs() < 1e-12 && last.slope_per_s == 0.0, "{last:?}");
    }

    #[test]
    fn a_gentle_stop_a_held_pedal_and_one_let_go_are_no_emergency() {
        let gentle = (0..60).map(|i| (f64::from(i) / 60.0).min(0.33));
        let let_go = (0..60).map(|i| f64::from(i < 30));
        for pedal in [drive(15.0, gentle), drive(15.0, let_go), drive(15.0, vec![0.7; 60])] {
            let braked = labels(&pedal, LabelRule::default());
            assert_eq!((braked.events.len(), due(&braked)), (0, vec![]));
        }
    }

    #[test]
    fn a_ramp_of_a_third_of_a_second_is_one_event_and_two_of_them_within_a_label_share_one() {
        let ramp = |from: usize, i: usize| (i.saturating_sub(from) as f64 / 5.0).min(1.0);
        let one = labels(&drive(15.0, (0..60).map(|i| ramp(20, i))), LabelRule::default());
        assert_eq!((one.events.len(), due(&one).len()), (1, 1), "{one:?}");
        // Let go half way and pressed again eight samples later.
        let again = |i: usize| if i < 26 { ramp(20, i) } else { ramp(28, i) };
        let two = labels(&drive(15.0, (0..60).map(again)), LabelRule::default());
        assert_eq!((two.events.len(), due(&two).len()), (2, 1), "{two:?}");
        let [(first, last)] = due(&two)[..] else { panic!("{two:?}") };
        assert_eq!((first, last), (two.events[0] - 1, two.events[1] + 8));
    }

    #[test]
    fn a_press_in_which_samples_are_missing_is_one_event_as_it_would_be_with_them() {
        for samples in 1..13 {
            let full = drive(15.0, (0..60).map(|i| (f64::from((i - 20).max(0)) / f64::from(samples)).min(1.0)));
            let events = labels(&full, LabelRule::default()).events.len();
            for from in 10..45 {
                let mut with_gap = full.clone();
                with_gap.drain(from..from + 3);
                let found = labels(&with_gap, LabelRule::default());
                assert_eq!(found.events.len(), events, "{samples} samples, three missing from {from} on: {found:?}");
            }
        }
    }

    /// As it was before it was weighed by time.
    fn smoothed_by_count(drive: &[Pressed], i: usize, weights: &[f64]) -> f64 {
        let reach = weights.len() - 1;
        let taps = || (i.saturating_sub(reach)..=i + reach).filter(|k| *k < drive.len());
        let share = |k: usize| weights[k.abs_diff(i)];
        let (mut sum, mut weight) = (0.0, 0.0);
        for k in taps() {
            sum += share(k) * drive[k].pedal;
            weight += share(k);
        }
        sum / weight
    }

    #[test]
    fn where_none_is_missing_a_clock_that_is_coarse_changes_nothing() {
        let pedal = |i: u32| f64::from(i * i % 17) / 16.0;
        let steady = drive(15.0, (0..90).map(pedal));
        let coarse: Vec<Pressed> =
            (0..90).map(|i| Pressed { at_s: f64::from(i * 10 / 3) * 0.02, speed_kmh: 30.0, pedal: pedal(i) }).collect();
        for drive in [steady, coarse, drive(30.0, (0..90).map(pedal))] {
            let weights = LabelRule::default().at(rate_hz(&drive).unwrap()).weights();
            for (i, label) in labels(&drive, LabelRule::default()).labels.iter().enumerate() {
                assert_eq!(label.smoothed, smoothed_by_count(&drive, i, &weights), "{i}");
            }
        }
    }

    #[test]
    fn lengths_are_the_same_in_seconds_at_another_rate() {
        let rule = LabelRule::default().at(30.0);
        assert_eq!((rule.taps, rule.deviation, rule.length, rule.lead), (9, 7.0, 20, 2));
        let braked = labels(&drive(30.0, (0..120).map(|i| f64::from(i >= 40))), LabelRule::default());
        let [(first, last)] = due(&braked)[..] else { panic!("{braked:?}") };
        assert_eq!(last + 1 - first, 20);
        assert_eq!(LabelRule::default().at(2.0).taps, 1);
    }

    #[test]
    fn a_drive_begins_and_ends_with_labels_too_and_an_empty_one_has_none() {
        let braked = labels(&drive(15.0, [0.0, 0.0, 0.0, 1.0, 1.0]), LabelRule::default());
        assert_eq!((braked.events.as_slice(), due(&braked)), ([1].as_slice(), vec![(0, 4)]));
        assert_eq!(labels(&[], LabelRule::default()), Braked::default());
        assert_eq!(labels(&drive(15.0, [1.0]), LabelRule::default()).events, [0; 0]);
    }
}
