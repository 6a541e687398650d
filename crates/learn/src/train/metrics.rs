//! The errors of answers relative to labels.

use serde::{Deserialize, Serialize};

/// Errors over a set of answers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Mean squared error, of normalised steering.
    pub mse: f64,
    /// Mean absolute error.
    pub mae: f64,
    /// Pearson's correlation, -1 to 1; absent if labels or answers do not vary.
    pub r: Option<f64>,
}

impl Metrics {
    /// The errors of answers, given as many labels.
    pub fn of(answers: &[f64], labels: &[f64]) -> Self {
        let n = answers.len().max(1) as f64;
        let pairs = || answers.iter().zip(labels);
        let mean = |sum: f64| sum / n;
        let (answer, label) = (mean(answers.iter().sum()), mean(labels.iter().sum()));
        let covariance = mean(pairs().map(|(a, l)| (a - answer) * (l - label)).sum());
        let variance = |of: &[f64], around: f64| mean(of.iter().map(|x| (x - around) * (x - around)).sum());
        let spread = (variance(answers, answer) * variance(labels, label)).sqrt();
        Self {
            mse: mean(pairs().map(|(a, l)| (a - l) * (a - l)).sum()),
            mae: mean(pairs().map(|(a, l)| (a - l).abs()).sum()),
            r: (spread > 1e-12).then(|| covariance / spread),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_and_correlation_of_four_answers() {
        let metrics = Metrics::of(&[0.0, 0.5, 1.0, 0.5], &[0.0, 1.0, 1.0, 0.0]);
        assert_eq!((metrics.mse, metrics.mae), (0.125, 0.25));
        assert!((metrics.r.unwrap() - 0.125 / (0.125f64 * 0.25).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn answers_that_do_not_vary_have_no_correlation() {
        assert_eq!(Metrics::of(&[0.1; 3], &[0.0, 0.5, 1.0]).r, None);
    }
}
