//! Statistics on how well two series agree.

use std::cmp::Ordering;

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

/// Ranks from 1, the least first; equal values share the mean of their ranks.
pub fn ranks<T>(values: &[T], order: impl Fn(&T, &T) -> Ordering) -> Vec<f64> {
    let rank = |value: &T| {
        let count = |wanted| values.iter().filter(|other| order(other, value) == wanted).count() as f64;
        count(Ordering::Less) + (count(Ordering::Equal) + 1.0) / 2.0
    };
    values.iter().map(rank).collect()
}

/// The interval in which a share lies with 95 % confidence that was found in so many independent trials (Wilson 1927). It
/// is never empty: nothing seen in a hundred trials may still be there in 3.7 % of them.
pub fn share_interval(share: f64, trials: u64) -> [f64; 2] {
    const Z: f64 = 1.96;
    let n = trials.max(1) as f64;
    let (middle, half) =
        (share + Z * Z / (2.0 * n), Z * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).max(0.0).sqrt());
    [middle - half, middle + half].map(|bound| (bound / (1.0 + Z * Z / n)).clamp(0.0, 1.0))
}

/// The interval that holds 95 % of a statistic of samples drawn anew, with repetition, from `size` that there are (the
/// percentile bootstrap of Efron 1979). `draw` gives a random number below its argument; the statistic is of the numbers
/// of those drawn. `None` if the statistic is absent from more than half of the samples.
pub fn bootstrap(
    size: usize,
    samples: usize,
    mut draw: impl FnMut(usize) -> usize,
    statistic: impl Fn(&[usize]) -> Option<f64>,
) -> Option<[f64; 2]> {
    let mut sample = vec![0; size];
    let mut found: Vec<f64> = (0..samples)
        .filter_map(|_| {
            sample.fill_with(|| draw(size));
            statistic(&sample)
        })
        .collect();
    (2 * found.len() >= samples).then(|| middle_95(&mut found))?
}

/// The interval that holds the middle 95 % of these values, such as a statistic of many bootstrap samples; they are sorted.
/// `None` of none.
pub fn middle_95(found: &mut [f64]) -> Option<[f64; 2]> {
    found.sort_by(f64::total_cmp);
    let last = found.len().checked_sub(1)?;
    Some([0.025, 0.975].map(|share| found[(last as f64 * share).round() as usize]))
}

/// A quantile of sorted values: between two of them, by how near it is to each. None if there are no values.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let at = sorted.len().checked_sub(1)? as f64 * share;
    let (below, above) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    // Also between infinite ones.
    Some(if below == above { below } else { below + (above - below) * at.fract() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantile_lies_between_two_values() {
        let sorted = [1.0, 2.0, 4.0, 8.0];
        assert_eq!([0.0, 0.5, 0.75, 1.0].map(|share| quantile(&sorted, share)), [1.0, 3.0, 5.0, 8.0].map(Some));
        assert_eq!(quantile(&[], 0.5), None);
    }

    #[test]
    fn a_share_is_known_the_better_the_more_trials_there_are_and_never_for_certain() {
        let rounded = |interval: [f64; 2]| interval.map(|bound| (bound * 1000.0).round() / 1000.0);
        // Known values of Wilson's interval.
        assert_eq!(rounded(share_interval(0.0, 100)), [0.0, 0.037]);
        assert_eq!(rounded(share_interval(0.5, 10)), [0.237, 0.763]);
        assert_eq!(rounded(share_interval(0.5, 100)), [0.404, 0.596]);
        assert_eq!(rounded(share_interval(1.0, 100)), [0.963, 1.0]);
    }

    #[test]
    fn equal_values_share_the_mean_of_their_ranks() {
        assert_eq!(ranks(&[0.3, 0.1, 0.3, 9.0], f64::total_cmp), [2.5, 1.0, 2.5, 4.0]);
        assert_eq!(ranks(&[(1, 0.2), (0, 0.9), (1, 0.1)], |a, b| a.partial_cmp(b).unwrap()), [3.0, 1.0, 2.0]);
    }

    #[test]
    fn the_bootstrap_of_a_mean_is_as_wide_as_its_standard_error_says() {
        // Whole numbers from 0 to 99: a standard deviation of 28.9, so 2.89 of the mean of a hundred.
        let mut state = 1_u64;
        let draw = |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % below
        };
        let mean = |sample: &[usize]| Some(sample.iter().sum::<usize>() as f64 / sample.len() as f64);
        let [low, high] = bootstrap(100, 2000, draw, mean).unwrap();
        assert!((low - (49.5 - 1.96 * 2.89)).abs() < 0.6 && (high - (49.5 + 1.96 * 2.89)).abs() < 0.6, "{low} {high}");
        assert_eq!(bootstrap(3, 10, |_| 0, |_| None), None);
        assert_eq!(bootstrap(0, 0, |_| 0, mean), None);
    }

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
