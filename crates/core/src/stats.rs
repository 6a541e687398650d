//! Statistics on how well two series agree.

use serde::Serialize;

/// How well two series of normalised steering agree.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Agreement {
    /// Frames compared.
    pub frames: u64,
    /// Mean absolute error.
    pub mae: f64,
    /// Mean squared error.
    pub mse: f64,
    /// Pearson's correlation coefficient; absent if one of the series does not vary.
    pub r: Option<f64>,
}

impl Agreement {
    /// The agreement of pairs (ours, recorded); `None` without any.
    pub fn of(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> Option<Self> {
        let n = pairs.clone().count() as f64;
        if n == 0.0 {
            return None;
        }
        let mean = |f: fn((f64, f64)) -> f64| pairs.clone().map(f).sum::<f64>() / n;
        let (mean_a, mean_b) = (mean(|(a, _)| a), mean(|(_, b)| b));
        let covariance = pairs.clone().map(|(a, b)| (a - mean_a) * (b - mean_b)).sum::<f64>();
        let variances = pairs.clone().map(|(a, _)| (a - mean_a).powi(2)).sum::<f64>()
            * pairs.clone().map(|(_, b)| (b - mean_b).powi(2)).sum::<f64>();
        Some(Self {
            frames: n as u64,
            mae: mean(|(a, b)| (a - b).abs()),
            mse: mean(|(a, b)| (a - b).powi(2)),
            // A smaller product comes from rounding: a series does not vary.
            r: (variances > 1e-20).then(|| (covariance / variances.sqrt()).clamp(-1.0, 1.0)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agreement_is_mae_mse_and_pearsons_r() {
        let pairs = [(1.0, 2.0), (2.0, 4.0), (3.0, 6.0)];
        let agreement = Agreement::of(pairs.into_iter()).unwrap();
        assert_eq!((agreement.frames, agreement.mae), (3, 2.0));
        assert!((agreement.mse - 14.0 / 3.0).abs() < 1e-12);
        assert!((agreement.r.unwrap() - 1.0).abs() < 1e-12);
        let opposite = Agreement::of(pairs.into_iter().map(|(a, b)| (a, -b))).unwrap();
        assert!((opposite.r.unwrap() + 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_series_that_does_not_vary_has_no_correlation() {
        assert_eq!(Agreement::of([(0.1, 0.0), (0.2, 0.0)].into_iter()).unwrap().r, None);
        assert_eq!(Agreement::of(std::iter::empty()), None);
    }
}
