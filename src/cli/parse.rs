//! What flags mean by their text.

use lapwing_core::protocol::number::Culture;

#[cfg(feature = "networks")]
pub(super) fn rows_and_columns(text: &str) -> Result<(usize, usize), String> {
    let parsed = text.split_once('x').and_then(|(rows, columns)| Some((rows.parse().ok()?, columns.parse().ok()?)));
    parsed.ok_or_else(|| "expected rows x columns, such as 80x160".into())
}

#[cfg(all(feature = "networks", feature = "simulator"))]
pub(super) fn range(text: &str) -> Result<std::ops::Range<usize>, String> {
    let parsed = text.split_once("..").and_then(|(first, end)| Some(first.parse().ok()?..end.parse().ok()?));
    let range = parsed.filter(|range: &std::ops::Range<usize>| !range.is_empty());
    range.ok_or_else(|| "expected the first row and the one after the last, such as 1360..2040".into())
}

pub(super) fn culture(name: &str) -> Result<Culture, String> {
    let known = || Culture::ALL.map(|c| c.name).join(", ");
    Culture::named(name).ok_or_else(|| format!("expected one of {}", known()))
}

pub(super) fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "expected a number".into())
}

pub(super) fn count(text: &str) -> Result<u32, String> {
    text.parse().map_err(|_| "expected a whole number of at least 0".into())
}

pub(super) fn above_zero(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|x: &f64| x.is_finite() && *x > 0.0);
    number.ok_or_else(|| "expected a number above 0".into())
}

pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|x: &f64| x.is_finite() && *x >= 0.0);
    number.ok_or_else(|| "expected a number of at least 0".into())
}
