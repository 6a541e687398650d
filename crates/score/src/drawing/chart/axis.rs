//! An axis: its range, and the round numbers along it.

/// What is counted along one side of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it counts, with its unit: `steering (-1 left, 1 right)`.
    pub label: String,
    /// Its two ends, the smaller first; none reaches around all numbers.
    pub range: Option<(f64, f64)>,
    /// Whether equal distances are equal ratios, as for losses.
    pub logarithmic: bool,
}

impl Axis {
    /// An axis that reaches around all numbers.
    pub fn new(label: impl Into<String>) -> Self {
        Self { label: label.into(), range: None, logarithmic: false }
    }

    /// The same with fixed ends. What lies outside is drawn at the rim.
    pub fn from_to(self, from: f64, to: f64) -> Self {
        Self { range: Some((from, to)), ..self }
    }

    /// The same with equal distances for equal ratios.
    pub fn logarithmic(self) -> Self {
        Self { logarithmic: true, ..self }
    }

    /// Whether a number has a place on such an axis.
    pub(super) fn shows(&self, value: f64) -> bool {
        value.is_finite() && (!self.logarithmic || value > 0.0)
    }

    /// The axis' scale for these numbers.
    pub(super) fn scale(&self, values: impl Iterator<Item = f64>) -> Scale {
        let given = self.range.filter(|(from, to)| self.shows(*from) && self.shows(*to) && from < to);
        let (from, to) = given.unwrap_or_else(|| {
            let (low, high) = values
                .filter(|value| self.shows(*value))
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
            match (low <= high, low == high, self.logarithmic) {
                (false, _, _) => (if self.logarithmic { 0.1 } else { 0.0 }, 1.0),
                (_, true, true) => (low / 2.0, high * 2.0),
                (_, true, false) => (low - low.abs().max(1.0) / 2.0, high + high.abs().max(1.0) / 2.0),
                (_, false, true) => (low, high),
                (_, false, false) => rounded(low, high),
            }
        });
        Scale { from, to, logarithmic: self.logarithmic }
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
    logarithmic: bool,
}

impl Scale {
    /// Where a number stands, 0 at the beginning and 1 at the end; beyond them for what lies outside.
    pub(super) fn share(&self, value: f64) -> f64 {
        if self.logarithmic {
            (value / self.from).ln() / (self.to / self.from).ln()
        } else {
            (value - self.from) / (self.to - self.from)
        }
    }

    /// Round numbers from end to end, at most about `most`, and how they are written.
    pub(super) fn ticks(&self, most: f64) -> Vec<(f64, String)> {
        if self.logarithmic {
            return self.ratios(most);
        }
        let step = step(self.to - self.from, most);
        let decimals = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
        let (first, last) = ((self.from / step - 1e-9).ceil() as i64, (self.to / step + 1e-9).floor() as i64);
        // A scale whose ends are no further apart than rounding has no ticks worth having.
        let count = usize::try_from(last.saturating_sub(first)).unwrap_or(0).min(100);
        (0..=count).map(|i| (first + i as i64) as f64 * step).map(|at| (at, format!("{at:.decimals$}"))).collect()
    }

    /// Powers of ten, and twice and five times them where there is room.
    fn ratios(&self, most: f64) -> Vec<(f64, String)> {
        let (low, high) = (self.from.log10().floor() as i32, self.to.log10().ceil() as i32);
        let decades = f64::from(high - low).max(1.0);
        let times: &[f64] = if 3.0 * decades <= most { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let every = ((decades / most).ceil() as usize).max(1);
        let inside = |at: &f64| *at >= self.from * (1.0 - 1e-9) && *at <= self.to * (1.0 + 1e-9);
        let ticks = (low..=high).step_by(every).flat_map(|power| times.iter().map(move |t| t * 10f64.powi(power)));
        ticks.filter(inside).map(|at| (at, written(at))).collect()
    }
}

/// A round number in as few letters as it needs.
fn written(value: f64) -> String {
    if (1e-4..1e6).contains(&value) {
        // Twice a power of ten is not exact.
        let text = format!("{value:.6}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{value:.0e}")
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
    fn a_logarithmic_axis_counts_in_powers_of_ten() {
        let axis = Axis::new("").logarithmic();
        assert_eq!(ticks(&axis, &[0.001, 10.0], 6.0), ["0.001", "0.01", "0.1", "1", "10"]);
        assert_eq!(ticks(&axis, &[0.04, 0.3], 8.0), ["0.05", "0.1", "0.2"]);
        let scale = axis.scale([0.01, 1.0].into_iter());
        assert!((scale.share(0.1) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn one_number_none_and_numbers_that_are_none_still_make_an_axis() {
        for values in [&[][..], &[5.0], &[0.0], &[f64::NAN, f64::INFINITY]] {
            for axis in [Axis::new(""), Axis::new("").logarithmic()] {
                let scale = axis.scale(values.iter().copied());
                assert!(scale.from < scale.to && scale.from.is_finite() && scale.to.is_finite(), "{values:?}");
                assert!(!scale.ticks(5.0).is_empty(), "{values:?}");
            }
        }
    }
}
