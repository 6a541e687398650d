//! A recording and its labels: as a table, drawn, in words.

use std::{
    fmt::{self, Write},
    path::{Path, PathBuf},
};

use serde::Serialize;

use super::{Braked, LabelRule, Pedal, PedalError, Pressed, labels};
use crate::drawing::chart::{Axis, Chart, Marks, Series};
use lapwing_core::words::count;

/// The columns of the table.
pub const COLUMNS: [&str; 7] = ["drive", "at_s", "speed_kmh", "pedal", "smoothed", "slope_per_s", "label"];

/// A recording with the labels of its moments.
#[derive(Debug, Clone)]
pub struct Labelled {
    source: PathBuf,
    rule: LabelRule,
    drives: Vec<(Vec<Pressed>, Braked)>,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Found {
    /// The recording.
    pub source: PathBuf,
    /// The rule, at the rate at which it is written down: 15 samples a second by default.
    pub rule: LabelRule,
    /// Drives without a gap.
    pub drives: usize,
    /// Moments of all of them.
    pub moments: usize,
    /// How many of those are labelled 1.0.
    pub due: usize,
    /// When an emergency begins, in seconds since the recording began.
    pub emergencies_s: Vec<f64>,
}

impl Labelled {
    /// Reads a recording ([`Pedal::open`]) and labels it.
    ///
    /// # Errors
    /// [`PedalError`].
    pub fn open(source: &Path, rule: LabelRule) -> Result<Self, PedalError> {
        let label = |drive: Vec<Pressed>| {
            let braked = labels(&drive, rule);
            (drive, braked)
        };
        let drives = Pedal::open(source)?.drives.into_iter().map(label).collect();
        Ok(Self { source: source.to_owned(), rule, drives })
    }

    /// What was found.
    pub fn found(&self) -> Found {
        let braked = || self.drives.iter().map(|(_, braked)| braked);
        let begins = |(drive, braked): &(Vec<Pressed>, Braked)| -> Vec<f64> {
            braked.events.iter().map(|&event| drive[event].at_s).collect()
        };
        Found {
            source: self.source.clone(),
            rule: self.rule,
            drives: self.drives.len(),
            moments: braked().map(|braked| braked.labels.len()).sum(),
            due: braked().flat_map(|braked| &braked.labels).filter(|label| label.due).count(),
            emergencies_s: self.drives.iter().flat_map(begins).collect(),
        }
    }

    /// The table: a heading of [`COLUMNS`] and a line for each moment. Drives are numbered from 1.
    pub fn csv(&self) -> String {
        let mut csv = COLUMNS.join(",") + "\n";
        for (number, (drive, braked)) in (1..).zip(&self.drives) {
            for (pressed, label) in drive.iter().zip(&braked.labels) {
                let Pressed { at_s, speed_kmh, pedal } = pressed;
                let (smoothed, slope, due) = (label.smoothed, label.slope_per_s, u8::from(label.due));
                // Writing to a string cannot fail.
                let _ = writeln!(csv, "{number},{at_s:.3},{speed_kmh:.2},{pedal:.4},{smoothed:.4},{slope:.3},{due}");
            }
        }
        csv
    }

    /// Pedal and label over time, and the slope under them.
    pub fn charts(&self) -> [Chart; 2] {
        let line = |of: &dyn Fn(&Pressed, &super::Label) -> f64| {
            let drive = |(drive, braked): &(Vec<Pressed>, Braked)| -> Vec<(f64, f64)> {
                let points =
                    drive.iter().zip(&braked.labels).map(|(pressed, label)| (pressed.at_s, of(pressed, label)));
                // What is not a number makes a gap.
                points.chain([(f64::NAN, f64::NAN)]).collect()
            };
            Marks::Line(self.drives.iter().flat_map(drive).collect())
        };
        let (from, to) = (self.drives.first(), self.drives.last());
        let ends = [from.and_then(|(drive, _)| drive.first()), to.and_then(|(drive, _)| drive.last())];
        let threshold = ends.iter().flatten().map(|pressed| (pressed.at_s, self.rule.threshold_per_s)).collect();
        let time = || Axis::new("time, s");
        let pedal = Chart {
            series: vec![
                Series::new("label", line(&|_, label| f64::from(u8::from(label.due)))),
                Series::new("pedal", line(&|pressed, _| pressed.pedal)),
                Series::new("smoothed", line(&|_, label| label.smoothed)),
            ],
            ..Chart::new(self.source.display().to_string(), time(), Axis::new("brake pedal, 0 to 1").from_to(0.0, 1.05))
        };
        let slope = Chart {
            series: vec![
                Series::new("slope", line(&|_, label| label.slope_per_s)),
                Series::new("threshold", Marks::Line(threshold)),
            ],
            ..Chart::new("How fast it goes down", time(), Axis::new("pedals per second"))
        };
        [pedal, slope]
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (drives, moments) = (count(self.drives, "drive"), count(self.moments, "moment"));
        writeln!(f, "{}: {drives}, {moments}", self.source.display())?;
        let begins: Vec<_> = self.emergencies_s.iter().map(|at_s| format!("{at_s:.1} s")).collect();
        let at = if begins.is_empty() { String::new() } else { format!(", at {}", begins.join(", ")) };
        writeln!(f, "  emergencies  {}{at}", begins.len())?;
        let share = 100.0 * self.due as f64 / self.moments.max(1) as f64;
        write!(f, "  labelled     {share:.1} % of the moments ({})", self.due)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labelled(text: &str) -> Labelled {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.csv");
        std::fs::write(&path, text).unwrap();
        Labelled { source: "drive.csv".into(), ..Labelled::open(&path, LabelRule::default()).unwrap() }
    }

    /// Two drives of two seconds at 15 Hz; in the second the pedal goes down at once after a second.
    fn two_drives() -> Labelled {
        let row = |i: u32| {
            let gap_s = if i < 30 { 0.0 } else { 10.0 };
            format!("{:.4},30,{}\n", f64::from(i) / 15.0 + gap_s, f64::from(u8::from(i >= 45)))
        };
        labelled(&("time_s,speed_kmh,brake\n".to_owned() + &(0..60).map(row).collect::<String>()))
    }

    #[test]
    fn what_was_found_is_counted_over_all_drives() {
        let found = two_drives().found();
        assert_eq!((found.drives, found.moments, found.due), (2, 60, 10));
        // Two samples before the foot, at 13 s.
        assert!((found.emergencies_s[0] - (13.0 - 2.0 / 15.0)).abs() < 1e-3, "{found:?}");
        let words =
            "drive.csv: 2 drives, 60 moments\n  emergencies  1, at 12.9 s\n  labelled     16.7 % of the moments (10)";
        assert_eq!(found.to_string(), words);
    }

    #[test]
    fn the_table_has_a_line_for_each_moment_and_the_drawing_a_gap_between_drives() {
        let labelled = two_drives();
        let csv = labelled.csv();
        let lines: Vec<_> = csv.lines().collect();
        assert_eq!((lines.len(), lines[0]), (61, "drive,at_s,speed_kmh,pedal,smoothed,slope_per_s,label"));
        assert_eq!(lines[1], "1,0.000,30.00,0.0000,0.0000,0.000,0");
        assert_eq!(lines.iter().skip(1).filter(|line| line.ends_with(",1")).count(), 10);
        let [pedal, _] = labelled.charts();
        let Marks::Line(points) = &pedal.series[0].marks else { panic!("a line") };
        assert_eq!((points.len(), points[30].0.is_nan()), (62, true));
    }
}
