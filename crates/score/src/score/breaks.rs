//! Where a recording does not continue from the telemetry before: drives that are joined, rows that are missing, rows that are
//! out of order. What counts as a drive of its own is what [`joins`] says, as for the roads and laps of each.

use std::time::Duration;

use crate::odometry::joins;
use lapwing_core::recording::{Break, LONGEST_GAP, udacity::DrivingLog};

/// Collects a recording's breaks.
#[derive(Debug, Default)]
pub(super) struct Breaks {
    telemetries: usize,
    first: Duration,
    last: Duration,
    /// Why the next telemetry does not continue from the last.
    next: Option<Break>,
    all: Vec<Seam>,
}

/// One of them.
#[derive(Debug, Clone, Copy)]
struct Seam {
    broken: Break,
    /// The telemetry that it precedes, counted from 0.
    row: usize,
    /// Times of the telemetries before and behind.
    before: Duration,
    behind: Duration,
}

impl Breaks {
    /// The next telemetry does not continue from the last, for this reason.
    pub fn broken(&mut self, broken: Break) {
        self.next = Some(broken);
    }

    /// A telemetry at this time.
    pub fn telemetry(&mut self, at: Duration) {
        let broken = self.next.take().filter(|_| self.telemetries > 0);
        self.all.extend(broken.map(|broken| Seam { broken, row: self.telemetries, before: self.last, behind: at }));
        if self.telemetries == 0 {
            self.first = at;
        }
        self.last = at;
        self.telemetries += 1;
    }

    /// Telemetries so far.
    pub fn telemetries(&self) -> usize {
        self.telemetries
    }

    /// What a reader of the scorecard should know of them.
    pub fn notes(&self, log: Option<&DrivingLog>) -> Vec<String> {
        let begins = |seam: &Seam| match log.and_then(|log| log.rows.get(seam.row)) {
            Some(row) => format!("line {}", row.line),
            None => format!("{:.1} s", seam.behind.as_secs_f64()),
        };
        let (what, place, rows) = if log.is_some() { ("log", "in", "rows are") } else { ("run", "at", "telemetry is") };
        let (drives, gaps): (Vec<&Seam>, Vec<&Seam>) = self.all.iter().partition(|seam| joins(seam.broken));
        let disordered = self.disordered(&drives);
        if let Some(first) = disordered.first() {
            // What looks like drives and gaps is neither, then.
            let times =
                if disordered.len() == 1 { "one place".to_owned() } else { format!("{} places", disordered.len()) };
            let sort = match log {
                Some(_) => "sort the rows by the pictures' names",
                None => {
                    "sort the rows of the log that the run was made from by the pictures' names, and convert it anew"
                }
            };
            return vec![format!(
                "in {times} the time goes back, the first {place} {}: the rows are not in the order of time, so the figures are not the drive's; {sort}",
                begins(first)
            )];
        }
        let mut notes = vec![];
        if let Some(second) = drives.first() {
            let n = drives.len() + 1;
            notes.push(format!("{n} drives are joined in this {what}, the second begins {place} {}", begins(second)));
        }
        let missing_s: f64 = gaps.iter().filter_map(|seam| seam.broken.seconds()).sum();
        let before = if log.is_some() { "before" } else { "until" };
        notes.extend(gaps.first().map(|first| match gaps.len() {
            1 => format!("{rows} missing for {missing_s:.1} s {before} {}", begins(first)),
            n => format!("{rows} missing in {n} places, {missing_s:.1} s in all, the first {before} {}", begins(first)),
        }));
        notes
    }

    /// Where the time goes back as it does only if rows are out of order: by a moment, or to or from a drive of a moment. Who joins
    /// two drives, the older behind the newer, has two of some length, and goes back by both.
    fn disordered<'a>(&self, drives: &[&'a Seam]) -> Vec<&'a Seam> {
        let begins = std::iter::once(self.first).chain(drives.iter().map(|seam| seam.behind));
        let ends = drives.iter().map(|seam| seam.before).chain([self.last]);
        let long: Vec<bool> = begins.zip(ends).map(|(from, to)| to.saturating_sub(from) > LONGEST_GAP).collect();
        let is_out = |(seam, around): (&&'a Seam, &[bool])| match seam.broken {
            Break::Back(by) => (by <= LONGEST_GAP || around.contains(&false)).then_some(*seam),
            _ => None,
        };
        drives.iter().zip(long.windows(2)).filter_map(is_out).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stretches of rows, 0.1 s apart, each with how many there are and why it does not continue from the one before.
    fn notes(stretches: &[(usize, Break)]) -> Vec<String> {
        let (mut breaks, mut row) = (Breaks::default(), 0);
        for (rows, broken) in stretches {
            breaks.broken(*broken);
            for _ in 0..*rows {
                breaks.telemetry(Duration::from_millis(100 * row));
                row += 1;
            }
        }
        breaks.notes(None)
    }

    fn gap(seconds: f64) -> Break {
        Break::Gap(Duration::from_secs_f64(seconds))
    }

    fn back(seconds: f64) -> Break {
        Break::Back(Duration::from_secs_f64(seconds))
    }

    #[test]
    fn a_gap_is_a_gap_and_only_what_counts_as_a_drive_is_called_one() {
        assert_eq!(notes(&[(50, Break::Joined)]), [""; 0]);
        assert_eq!(notes(&[(50, Break::Joined), (50, gap(14.5))]), ["telemetry is missing for 14.5 s until 5.0 s"]);
        let several = [(50, Break::Joined), (50, gap(14.5)), (50, gap(300.0)), (50, gap(2.5))];
        let [drives, gaps] = &notes(&several)[..] else { panic!("{:?}", notes(&several)) };
        assert_eq!(drives, "2 drives are joined in this run, the second begins at 10.0 s");
        assert_eq!(gaps, "telemetry is missing in 2 places, 17.0 s in all, the first until 5.0 s");
    }

    #[test]
    fn an_older_drive_that_is_joined_is_no_row_out_of_order() {
        assert_eq!(
            notes(&[(50, Break::Joined), (50, back(86_400.0))]),
            ["2 drives are joined in this run, the second begins at 5.0 s"]
        );
    }

    #[test]
    fn rows_out_of_order_are_said_once_and_are_neither_drives_nor_gaps() {
        let newest_first: Vec<_> = (0..30).map(|_| (1, back(0.1))).collect();
        let said = notes(&newest_first);
        assert!(
            said.len() == 1 && said[0].starts_with("in 29 places the time goes back, the first at 0.1 s: "),
            "{said:?}"
        );
        // Two rows swapped in a drive.
        let said = notes(&[(50, Break::Joined), (50, back(0.1)), (50, gap(3.0))]);
        assert!(said.len() == 1 && said[0].starts_with("in one place the time goes back"), "{said:?}");
    }
}
