//! Several runs in one.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{Figure, Scorecard};

/// A figure over several runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Runs that tell it.
    pub runs: usize,
    /// Mean over them.
    pub mean: f64,
    /// Standard deviation of one run (n - 1 below); none of a single one.
    pub deviation: Option<f64>,
    /// Smallest.
    pub least: f64,
    /// Largest.
    pub most: f64,
}

impl Spread {
    /// Of the values; `None` of none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let extreme = |of: fn(f64, f64) -> f64| values.iter().copied().reduce(of);
        Some(Self {
            runs: values.len(),
            mean,
            deviation: (values.len() > 1).then(|| (squares / (n - 1.0)).sqrt()),
            least: extreme(f64::min)?,
            most: extreme(f64::max)?,
        })
    }
}

/// Quantiles of Student's t at 97.5 %, for 1, 2, 3 … degrees of freedom.
const STUDENT: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120,
    2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
];
/// And of the normal distribution, which it becomes.
const NORMAL: f64 = 1.960;

/// The quantile for so many degrees of freedom, at least one.
pub(super) fn student(freedom: usize) -> f64 {
    STUDENT.get(freedom.max(1) - 1).copied().unwrap_or(NORMAL)
}

impl Spread {
    /// Half the width of the mean's confidence interval at 95 %, by Student's t; none of a single run.
    pub fn confidence(&self) -> Option<f64> {
        Some(student(self.runs - 1) * self.deviation? / (self.runs as f64).sqrt())
    }
}

/// Each figure's spread, by key; the collision rate is that of all episodes together.
pub fn summary(cards: &[&Scorecard]) -> BTreeMap<&'static str, Spread> {
    let values = |figure| cards.iter().filter_map(|card| card.value(figure)).collect::<Vec<_>>();
    let mut spreads: BTreeMap<_, _> =
        Figure::ALL.into_iter().filter_map(|figure| Some((figure.key(), Spread::of(&values(figure))?))).collect();
    if let Some(rate) = spreads.get_mut(Figure::CollisionRate.key()) {
        let (mut episodes, mut with) = (0.0, 0.0);
        for card in cards {
            if let Some((n, rate)) = card.value(Figure::Episodes).zip(card.value(Figure::CollisionRate)) {
                (episodes, with) = (episodes + n, with + n * rate);
            }
        }
        rate.mean = with / episodes;
    }
    spreads
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_of_three_runs() {
        let spread = Spread::of(&[1.0, 2.0, 6.0]).unwrap();
        assert_eq!((spread.runs, spread.mean, spread.least, spread.most), (3, 3.0, 1.0, 6.0));
        assert!((spread.deviation.unwrap() - 7f64.sqrt()).abs() < 1e-12);
        assert!((spread.confidence().unwrap() - 4.303 * (7f64 / 3.0).sqrt()).abs() < 1e-12);
        let one = Spread::of(&[4.0]).unwrap();
        assert_eq!((one.deviation, one.confidence()), (None, None));
        assert_eq!(Spread::of(&[]), None);
    }
}
