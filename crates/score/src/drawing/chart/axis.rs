//! An axis: its range, and the round numbers along it.

/// What is counted along one side of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it counts, with its unit: `steering (-1 left, 1 right)`.
    pub label: String,
    /// Its two ends, the smaller first; none reaches around all numbers.
    pub range: Option<(f64, f64)>,
}

impl Axis {
    /// An axis that reaches around all numbers.
    pub fn new(label: impl Into<String>) -> Self {
        Self { label: label.into(), range: None }
    }

    /// The same with fixed ends. What lies outside is drawn at the rim.
    pub fn from_to(self, from: f64, to: f64) -> Self {
        Self { range: Some((from, to)), ..self }
    }

    /// The axis' scale for these numbers.
    pub(super) fn scale(&self, values: impl Iterator<Item = f64>) -> Scale {
        let given = self.range.filter(|(from, to)| from.is_finite() && to.is_finite() && from < to);
        let (from, to) = given.unwrap_or_else(|| {
            let (low, high) = values
                .filter(|value| value.is_finite())
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
            if low > high {
                (0.0, 1.0)
            } else if low == high {
                let reach = low.abs().max(1.0) / 2.0;
                (low - reach, high + reach)
            } else {
                rounded(low, high)
            }
        });
        Scale { from, to }
    }
}

/// Ends at the next round numbers outside.
fn rounded(low: f64, high: f64) -> (f64, f64) {
    let step = step(high - low, 5.0);
    ((low / step).floor() * step, (high / step).ceil() * step)
}

/// The least of 1, 2 and 5 times a power of ten that divides a length into at most about so many parts.
fn step(length: f64, parts: f64) -> f64 {
    let rough = length / parts.max(1.0);
    let power = 10f64.powf(rough.log10().floor());
    let times = [1.0, 2.0, 5.0].into_iter().find(|times| times * power >= rough * (1.0 - 1e-9));
    power * times.unwrap_or(10.0)
}

/// An axis with its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    pub from: f64,
    pub to: f64,
}

impl Scale {
    /// Where a number stands, 0 at the beginning and 1 at the end; beyond them for what lies outside.
    pub(super) fn share(&self, value: f64) -> f64 {
        (value - self.from) / (self.to - self.from)
    }

    /// Round numbers from end to end, at most about `most`, and how they are written.
    pub(super) fn ticks(&self, most: f64) -> Vec<(f64, String)> {
        let step = step(self.to - self.from, most);
        let decimals = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
        let (first, last) = ((self.from / step - 1e-9).ceil() as i64, (self.to / step + 1e-9).floor() as i64);
        // A scale whose ends are no further apart than rounding has no ticks worth having.
        let count = usize::try_from(last.saturating_sub(first)).unwrap_or(0).min(100);
        (0..=count).map(|i| (first + i as i64) as f64 * step).map(|at| (at, format!("{at:.decimals$}"))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticks(axis: &Axis, values: &[f64], most: f64) -> Vec<String> {
        axis.scale(values.iter().copied()).ticks(most).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn ticks_are_round_numbers_around_all_values() {
        assert_eq!(ticks(&Axis::new(""), &[0.03, 0.97], 5.0), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(ticks(&Axis::new(""), &[-37.0, 220.0], 4.0), ["-100", "0", "100", "200", "300"]);
        assert_eq!(ticks(&Axis::new("").from_to(-1.0, 1.0), &[9.0], 4.0), ["-1.0", "-0.5", "0.0", "0.5", "1.0"]);
    }

    #[test]
    fn one_number_none_and_numbers_that_are_none_still_make_an_axis() {
        for values in [&[][..], &[5.0], &[0.0], &[f64::NAN, f64::INFINITY]] {
            let scale = Axis::new("").scale(values.iter().copied());
            assert!(scale.from < scale.to && scale.from.is_finite() && scale.to.is_finite(), "{values:?}");
            assert!(!scale.ticks(5.0).is_empty(), "{values:?}");
        }
    }
}
