//! A recording as a scorecard.

use std::time::Duration;

use super::{Scorecard, Scorer};
use lapwing_core::{
    recording::{EventRecord, Item, Recording, RecordingError},
    words::count,
};

/// A scorer, its watcher, and what could not be read.
struct WatchedScorer<W> {
    scorer: Scorer,
    watch: W,
    /// The number of unreadable messages, and the first of them.
    unreadable: Option<(u64, RecordingError)>,
}

impl<W: FnMut(Duration, &Item)> WatchedScorer<W> {
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

    /// Says how many of these cannot be read, if any.
    fn unread(&mut self, what: &str) -> Option<String> {
        self.unreadable.take().map(|(n, first)| format!("{n} {what} cannot be read, the first: {first}"))
    }
}

/// Reads a recording to its end and judges it by this scorer; `watch` sees each item, too, with the time of the run,
/// and also events that the scorer suspects if the run does not report them. The notes say what is wrong with the
/// recording: where it is damaged, what cannot be read, drives that are joined in it.
///
/// # Errors
/// [`RecordingError::Io`] if the file cannot be read any further.
pub fn of_recording(
    recording: &mut Recording,
    scorer: Scorer,
    watch: impl FnMut(Duration, &Item),
) -> Result<Scorecard, RecordingError> {
    let mut judge = WatchedScorer::new(scorer.of_kind(recording.header().kind), watch);
    let (mut not_recorded, mut joined, mut second) = (0, 0, None);
    while let Some(item) = recording.next_item() {
        match item {
            Ok((at, item)) => {
                match item {
                    Item::Event(EventRecord::FramesNotRecorded { count }) => not_recorded += count,
                    Item::Event(EventRecord::Break { .. }) => {
                        joined += 1;
                        second.get_or_insert(at);
                    }
                    _ => {}
                }
                judge.item(at, &item);
            }
            Err(error @ (RecordingError::Message { .. } | RecordingError::Picture { .. })) => judge.unreadable(error),
            Err(error) => return Err(error),
        }
    }
    let log = recording.log();
    if let Some(truncation) = recording.truncated() {
        judge.scorer.damaged(truncation.to_string());
    }
    if not_recorded > 0 {
        judge.scorer.note(format!("{} not recorded: the disk was full or too slow", count(not_recorded, "picture")));
    }
    if let Some(second) = second {
        let (what, begins) = match log.and_then(|log| log.rows.iter().find(|row| row.broken.is_some())) {
            Some(row) => ("log", format!("in line {}", row.line)),
            None => ("run", format!("at {:.1} s", second.as_secs_f64())),
        };
        judge.scorer.note(format!("{} drives are joined in this {what}, the second begins {begins}", joined + 1));
    }
    if log.is_some() {
        // The figures come from the log.
        let unread = judge.unread("pictures");
        unread.into_iter().for_each(|unread| judge.scorer.note(unread));
    } else if let Some(unread) = judge.unread("messages") {
        judge.scorer.damaged(unread);
    }
    Ok(judge.scorer.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::Figure;
    use lapwing_core::{recording::udacity::FALLBACK_INTERVAL, units::MPS_PER_MPH};

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
        let mut log = Recording::open(&path).unwrap();
        let card = of_recording(&mut log, Scorer::on(&[], None), |_, _| watched += 1).unwrap();
        assert_eq!(card.value(Figure::Collisions), Some(0.0), "{card}");
        assert_eq!(watched, 201, "a telemetry and a command each, and that the second drive begins");
        // Neither distance nor time is invented for the gap between them.
        let (driven_m, passed_s) = (4.9 * (30.0 + 24.5) * MPS_PER_MPH, 9.8 + FALLBACK_INTERVAL.as_secs_f64());
        assert!((card.value(Figure::DistanceM).unwrap() - driven_m).abs() < 0.01, "{card}");
        assert!((card.value(Figure::TimeS).unwrap() - passed_s).abs() < 1e-6, "{card}");
        let [joined, lost] = &card.notes[..] else { panic!("{card}") };
        assert_eq!(joined, "2 drives are joined in this log, the second begins in line 51");
        assert!(
            lost.starts_with("100 pictures cannot be read, the first: ") && lost.contains("10_00_00_000.jpg"),
            "{lost}"
        );
    }
}
