//! Summarises several runs.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

use super::{Better, Figure, Scorecard, Unit};

/// A figure over several runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Runs that report it.
    pub runs: usize,
    /// Mean over them.
    pub mean: f64,
    /// Standard deviation of one run (divisor n - 1); none for a single run.
    pub deviation: Option<f64>,
    /// Smallest.
    pub least: f64,
    /// Largest.
    pub most: f64,
}

impl Spread {
    /// The spread of equally weighted values; `None` without any.
    pub fn of(values: &[f64]) -> Option<Self> {
        Self::weighted(&values.iter().map(|value| (*value, 1.0)).collect::<Vec<_>>())
    }

    /// The spread of values, each with its weight above 0; `None` without any.
    ///
    /// The mean is sum(w x) / sum(w), and the deviation goes with it: the root of
    /// sum((w / mean w)^2 (x - mean)^2) / (n - 1), so that deviation / sqrt(n) is the mean's standard error (Cochran,
    /// Sampling Techniques, 1977, chapter 6: the ratio estimate). Equal weights make both the usual ones.
    pub fn weighted(values: &[(f64, f64)]) -> Option<Self> {
        let n = values.len() as f64;
        let weights: f64 = values.iter().map(|(_, weight)| weight).sum();
        let mean = values.iter().map(|(value, weight)| weight * value).sum::<f64>() / weights;
        let squares: f64 = values.iter().map(|(value, weight)| (weight * n / weights * (value - mean)).powi(2)).sum();
        let extreme = |of: fn(f64, f64) -> f64| values.iter().map(|(value, _)| *value).reduce(of);
        Some(Self {
            runs: values.len(),
            mean,
            deviation: (values.len() > 1).then(|| (squares / (n - 1.0)).sqrt()),
            least: extreme(f64::min)?,
            most: extreme(f64::max)?,
        })
    }

    /// Half the width of the mean's confidence interval at 95 %, by Student's t; none for a single run, and 0 if all runs
    /// report the same, but for the last digits.
    pub fn confidence(&self) -> Option<f64> {
        let deviation = self.deviation?;
        let half = student(self.runs - 1) * deviation / (self.runs as f64).sqrt();
        Some(if deviation > ROUNDING * self.mean.abs() { half } else { 0.0 })
    }

    /// The mean's confidence interval at 95 %, within the possible range of this figure's mean; none for a single run,
    /// and none if all runs report the same, as nothing is then known about their scatter.
    ///
    /// It is Student's t. For counts of occasional events (collisions, takeovers), which scatter at least like a
    /// Poisson distribution, it is the wider of that and Garwood's exact interval of their sum (1936).
    pub fn interval(&self, figure: Figure) -> Option<[f64; 2]> {
        let half = self.confidence()?;
        let (least, most) = figure.unit().range();
        let [low, high] = [(self.mean - half).max(least), (self.mean + half).min(most)];
        if figure.unit() == Unit::Count && figure.better() == Better::Lower {
            let runs = self.runs as f64;
            let [rarest, oftenest] = poisson(self.mean * runs).map(|sum| sum / runs);
            return Some([low.min(rarest), high.max(oftenest)]);
        }
        (half > 0.0).then_some([low, high])
    }
}

/// The expected counts with which this one is compatible at 95 %: Garwood's exact interval (1936).
fn poisson(count: f64) -> [f64; 2] {
    let chi_squared = |freedom: f64, share: f64| {
        let distribution = ChiSquared::new(freedom).expect("the degrees of freedom are above zero");
        distribution.inverse_cdf(share) / 2.0
    };
    let [low, high] = [(1.0 - CERTAINTY) / 2.0, (1.0 + CERTAINTY) / 2.0];
    [if count > 0.0 { chi_squared(2.0 * count, low) } else { 0.0 }, chi_squared(2.0 * count + 2.0, high)]
}

/// Values whose deviation is less than this part of their mean are equal but for their last digits.
pub(super) const ROUNDING: f64 = 1e-9;

/// How certain an interval is.
const CERTAINTY: f64 = 0.95;

/// The quantile of Student's t at 97.5 %, for at least one degree of freedom.
pub(super) fn student(freedom: usize) -> f64 {
    let distribution = StudentsT::new(0.0, 1.0, freedom.max(1) as f64).expect("the degrees of freedom are above zero");
    distribution.inverse_cdf((1.0 + CERTAINTY) / 2.0)
}

/// Each figure's spread over runs that `value` reads it from, by key.
///
/// A run counts once, except in the collision rate, where it counts once for each of its episodes: the mean is the rate
/// of all episodes together (Lu), and deviation and confidence are those of that mean.
pub fn spreads<R>(runs: &[R], value: impl Fn(&R, Figure) -> Option<f64>) -> BTreeMap<&'static str, Spread> {
    let weight = |run: &R, figure: Figure| match figure {
        Figure::CollisionRate => value(run, Figure::Episodes).filter(|episodes| *episodes > 0.0),
        _ => Some(1.0),
    };
    let spread = |figure: Figure| {
        let told: Vec<_> = runs.iter().filter_map(|run| value(run, figure).zip(weight(run, figure))).collect();
        Some((figure.key(), Spread::weighted(&told)?))
    };
    Figure::ALL.into_iter().filter_map(spread).collect()
}

/// Each figure's spread over scorecards, by key: [`spreads`].
pub fn summary(cards: &[&Scorecard]) -> BTreeMap<&'static str, Spread> {
    spreads(cards, |card, figure| card.value(figure))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_of_three_runs() {
        let spread = Spread::of(&[1.0, 2.0, 6.0]).unwrap();
        assert_eq!((spread.runs, spread.mean, spread.least, spread.most), (3, 3.0, 1.0, 6.0));
        assert!((spread.deviation.unwrap() - 7f64.sqrt()).abs() < 1e-12);
        assert!((spread.confidence().unwrap() - 4.302_652_73 * (7f64 / 3.0).sqrt()).abs() < 1e-7);
        let one = Spread::of(&[4.0]).unwrap();
        assert_eq!((one.deviation, one.confidence()), (None, None));
        assert_eq!(Spread::of(&[]), None);
    }

    #[test]
    fn the_interval_of_a_count_is_not_symmetric_and_not_below_nought() {
        let interval = |values: &[f64], figure: Figure| Spread::of(values).unwrap().interval(figure);
        let close = |got: Option<[f64; 2]>, expected: [f64; 2]| {
            let got = got.unwrap();
            assert!(got.iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 0.03), "{got:?}");
        };
        // Student's t is wider above; 0.5 ± 6.35 would be below zero.
        close(interval(&[0.0, 1.0], Figure::Collisions), [0.0, 6.853]);
        // Without any scatter, none is known: Garwood's is 3.689 over the runs.
        close(interval(&[0.0; 10], Figure::Collisions), [0.0, 0.369]);
        close(interval(&[1.0; 10], Figure::Takeovers), [0.4795, 1.839]);
        // Laps are not chance events, and nobody drives more of them than there are.
        assert_eq!(interval(&[1.0; 10], Figure::Laps), None);
        assert_eq!(interval(&[1.0, 1.0], Figure::Completion), None);
        close(interval(&[0.9, 1.0], Figure::Completion), [0.3147, 1.0]);
        assert_eq!(interval(&[1.0], Figure::Collisions), None);
        let speed = Spread::of(&[9.0, 10.0, 11.0]).unwrap();
        let half = speed.confidence().unwrap();
        assert_eq!(speed.interval(Figure::MeanMph), Some([10.0 - half, 10.0 + half]));
    }

    #[test]
    fn a_counts_interval_is_garwoods() {
        for (count, exact) in
            [(0.0, [0.0, 3.689]), (1.0, [0.0253, 5.572]), (10.0, [4.795, 18.39]), (100.0, [81.364, 121.627])]
        {
            let [low, high] = poisson(count);
            assert!((low - exact[0]).abs() < 0.006, "{count}: {low}");
            assert!((high - exact[1]).abs() < 0.006, "{count}: {high}");
        }
    }

    #[test]
    fn students_quantiles_are_those_of_the_tables() {
        for (freedom, expected) in
            [(0, 12.7062), (1, 12.7062), (2, 4.3027), (10, 2.2281), (31, 2.0395), (120, 1.9799), (1_000_000, 1.95997)]
        {
            assert!((student(freedom) - expected).abs() < 2e-4, "{freedom}: {}", student(freedom));
        }
        for freedom in 1..1000 {
            assert!(student(freedom + 1) < student(freedom), "{freedom}");
        }
    }

    #[test]
    fn values_of_equal_weight_are_spread_as_without() {
        let values = [0.2, 0.5, 0.9, 0.4];
        let weighted = Spread::weighted(&values.map(|value| (value, 3.0))).unwrap();
        let plain = Spread::of(&values).unwrap();
        assert!((weighted.mean - plain.mean).abs() < 1e-12);
        assert!((weighted.deviation.unwrap() - plain.deviation.unwrap()).abs() < 1e-12);
    }

    #[test]
    fn the_collision_rate_is_that_of_all_episodes_and_its_deviation_goes_with_it() {
        // Episodes and the share of them with a collision: 2 of 10 in all.
        let runs = [Some((1.0, 1.0)), Some((8.0, 0.125)), Some((1.0, 0.0)), None];
        let value = |run: &Option<(f64, f64)>, figure| match figure {
            Figure::Episodes => run.map(|(episodes, _)| episodes),
            Figure::CollisionRate => run.map(|(_, rate)| rate),
            _ => None,
        };
        let spreads = spreads(&runs, value);
        assert_eq!(spreads.keys().copied().collect::<Vec<_>>(), ["collision_rate", "episodes"]);
        let rate = spreads["collision_rate"];
        assert_eq!((rate.runs, rate.least, rate.most), (3, 0.0, 1.0));
        assert!((rate.mean - 0.2).abs() < 1e-12);
        // Each run's collisions less those that the mean expects of it, for a run of 10/3 episodes.
        let off: f64 = [1.0 - 0.2, 1.0 - 1.6, 0.0 - 0.2].map(|off: f64| (off / (10.0 / 3.0)).powi(2)).iter().sum();
        assert!((rate.deviation.unwrap() - (off / 2.0).sqrt()).abs() < 1e-12);
        assert!((rate.confidence().unwrap() - 4.302_652_73 * (off / 2.0 / 3.0).sqrt()).abs() < 1e-7);
    }

    #[test]
    fn a_run_without_episodes_says_nothing_of_their_share() {
        let value = |run: &f64, figure| match figure {
            Figure::Episodes => Some(*run),
            Figure::CollisionRate => Some(0.5),
            _ => None,
        };
        assert_eq!(spreads(&[0.0, 2.0], value)["collision_rate"], Spread::of(&[0.5]).unwrap());
        assert!(!spreads(&[0.0], value).contains_key("collision_rate"));
    }
}
