//! A run's file, or a Udacity folder, as a scorecard.

use std::time::Duration;

use super::{Scorecard, Scorer};
use lapwing_core::{
    recording::udacity::DrivingLog,
    recording::{EventRecord, Item, RecordingError, RunKind, RunReader},
    words::count,
};

/// What passes between two drives joined in one log: just more than anything is concluded over.
const BETWEEN_DRIVES: Duration = Duration::from_millis(1200);

/// A scorer, whoever watches it, and what it could not be told.
struct Judge<W> {
    scorer: Scorer,
    watch: W,
    /// How many, and the first of them.
    unreadable: Option<(u64, RecordingError)>,
}

impl<W: FnMut(Duration, &Item)> Judge<W> {
    fn new(scorer: Scorer, watch: W) -> Self {
        Self { scorer, watch, unreadable: None }
    }

    fn item(&mut self, at: Duration, item: &Item) {
        let at = self.scorer.item(at, item);
        (self.watch)(at, item);
        if let Some(event) = self.scorer.suspicion() {
            (self.watch)(at, &Item::Event(event));
        }
    }

    fn unreadable(&mut self, error: RecordingError) {
        self.unreadable = Some(self.unreadable.take().map_or_else(|| (1, error), |(n, first)| (n + 1, first)));
    }

    /// Says that so many of these cannot be read, if any.
    fn unread(&mut self, what: &str) -> Option<String> {
        self.unreadable.take().map(|(n, first)| format!("{n} {what} cannot be read, the first: {first}"))
    }
}

/// Reads a run to its end and judges it by this scorer; `watch` sees each item, too, with the time of the run, and as events what the scorer suspects
/// where the run does not tell. What is wrong with the file stands in the notes.
///
/// # Errors
/// [`RecordingError::Io`] where the file cannot be read any more.
pub fn of_run(
    run: &mut RunReader,
    scorer: Scorer,
    watch: impl FnMut(Duration, &Item),
) -> Result<Scorecard, RecordingError> {
    let mut judge = Judge::new(scorer.of_kind(run.header().kind), watch);
    let mut not_recorded = 0;
    for item in run.by_ref() {
        match item {
            Ok((at, item)) => {
                if let Item::Event(EventRecord::FramesNotRecorded { count }) = item {
                    not_recorded += count;
                }
                judge.item(at, &item);
            }
            Err(error @ RecordingError::Message { .. }) => judge.unreadable(error),
            Err(error) => return Err(error),
        }
    }
    if let Some(truncation) = run.truncated() {
        judge.scorer.damaged(truncation.to_string());
    }
    if not_recorded > 0 {
        judge.scorer.note(format!("{} not recorded: the disk was too slow", count(not_recorded, "picture")));
    }
    if let Some(unread) = judge.unread("messages") {
        judge.scorer.damaged(unread);
    }
    Ok(judge.scorer.finish())
}

/// The same of a driving log, which a human drove. Pictures that cannot be read stand in the notes, and drives joined in one
/// log, between which time passes here.
pub fn of_log(log: &DrivingLog, scorer: Scorer, watch: impl FnMut(Duration, &Item)) -> Scorecard {
    let mut judge = Judge::new(scorer.of_kind(RunKind::DrivingLog), watch);
    let mut joined = 0;
    for row in &log.rows {
        joined += u32::from(row.joined);
        let jpeg = row.jpeg().map_err(|error| judge.unreadable(error)).ok();
        row.items(jpeg).for_each(|item| judge.item(row.at + BETWEEN_DRIVES * joined, &item));
    }
    if joined > 0 {
        let first = log.rows.iter().find(|row| row.joined).map_or(0, |row| row.line);
        judge.scorer.note(format!("{} drives are joined in this log, the second begins in line {first}", joined + 1));
    }
    // The figures come from the log.
    if let Some(unread) = judge.unread("pictures") {
        judge.scorer.note(unread);
    }
    judge.scorer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::Figure;

    #[test]
    fn drives_joined_in_a_log_are_no_collision_and_lost_pictures_are_said() {
        let dir = tempfile::tempdir().unwrap();
        let row = |minute: u32, i: u32, mph: u32| {
            format!("center_2026_11_22_10_{minute:02}_{:02}_{:03}.jpg,,,0,0.5,0,{mph}", i / 10, i % 10 * 100)
        };
        let rows: Vec<_> = (0..50).map(|i| row(0, i, 30)).chain((0..50).map(|i| row(5, i, i))).collect();
        let path = dir.path().join("driving_log.csv");
        std::fs::write(&path, rows.join("\n")).unwrap();
        let mut watched = 0;
        let card = of_log(&DrivingLog::open(&path).unwrap(), Scorer::on(&[], None), |_, _| watched += 1);
        assert_eq!(card.value(Figure::Collisions), Some(0.0), "{card}");
        assert_eq!(watched, 200, "a telemetry and a command each");
        let [joined, lost] = &card.notes[..] else { panic!("{card}") };
        assert_eq!(joined, "2 drives are joined in this log, the second begins in line 51");
        assert!(
            lost.starts_with("100 pictures cannot be read, the first: ") && lost.contains("10_00_00_000.jpg"),
            "{lost}"
        );
    }
}
