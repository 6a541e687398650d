//! A chart of the distribution of steering.

use super::Inspection;
use lapwing_core::words::count;
use lapwing_score::{
    drawing::Sheet,
    drawing::chart::{self, Axis, Chart, Marks, Series},
};

/// Each data set's own chart, in pixels.
const SIZE: (u32, u32) = (1000, 320);
/// A bar this many times higher than the next is cut, so that the others remain visible.
const TOWERS: f64 = 3.0;

/// The distribution of the steering, one chart below the other, one for each data set.
///
/// Straight on is so frequent, above all with a keyboard, that its bar would flatten the others: it is then cut and
/// labelled with its height.
pub fn steering_chart(inspections: &[Inspection]) -> Sheet {
    let charts: Vec<Chart> = inspections.iter().map(of).collect();
    Sheet { title: "Distribution of the steering".into(), ..chart::stack(&charts, SIZE.0, SIZE.1) }
}

fn of(inspection: &Inspection) -> Chart {
    let histogram = &inspection.steering_histogram;
    let steered: u64 = histogram.counts.iter().sum();
    let share = |count: &u64| 100.0 * *count as f64 / steered.max(1) as f64;
    let heights: Vec<f64> = histogram.counts.iter().map(share).collect();
    let mut sorted = heights.clone();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let mut y = Axis::new("share of the rows (%)");
    if let [highest, next, ..] = sorted[..]
        && next > 0.0
        && highest > TOWERS * next
    {
        y = y.from_to(0.0, 1.5 * next);
    }
    let title = format!(
        "{}: {}, {:.1} % exactly straight on, mean {:+.3}, standard deviation {:.3}",
        name(inspection),
        count(inspection.rows, "row"),
        100.0 * inspection.zero_steering,
        inspection.steering.mean,
        inspection.steering.std
    );
    let end = histogram.from.abs();
    let x = Axis::new("steering, -1 full left to 1 full right").from_to(-end, end);
    let bars = Marks::Bars { from: histogram.from, width: histogram.width, heights };
    Chart { series: vec![Series::new("", bars)], ..Chart::new(title, x, y) }
}

/// The end of its path, short enough for a title.
pub(super) fn name(inspection: &Inspection) -> String {
    const LETTERS: usize = 40;
    let name = inspection.path.file_name().unwrap_or(inspection.path.as_os_str()).to_string_lossy();
    let skip = name.chars().count().saturating_sub(LETTERS);
    name.chars().skip(skip).collect()
}
