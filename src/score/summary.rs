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
        assert_eq!(Spread::of(&[4.0]).unwrap().deviation, None);
        assert_eq!(Spread::of(&[]), None);
    }
}
