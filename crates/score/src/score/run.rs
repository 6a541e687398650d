//! A recording as a scorecard.

use std::time::Duration;

use super::{Scorecard, Scorer, breaks::Breaks};
use lapwing_core::{
    recording::{Break, EventRecord, Item, Recording, RecordingError},
    words::count,
};

/// The note on a driving log whose pictures' names hold no time.
fn untimed(n: usize) -> String {
    format!(
        "{n} pictures have names without a time: 15 rows a second are assumed, and what depends on that is not measurable; name the pictures as \
         the simulator does, center_2026_11_22_10_00_59_999.jpg, from year to millisecond"
    )
}

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
/// recording: where it is damaged, what cannot be read, what holds no time, where rows are missing or out of order, drives that are
/// joined in it.
///
/// # Errors
/// [`RecordingError::Io`] if the file cannot be read any further.
pub fn of_recording(
    recording: &mut Recording,
    scorer: Scorer,
    watch: impl FnMut(Duration, &Item),
) -> Result<Scorecard, RecordingError> {
    let mut judge = WatchedScorer::new(scorer.of_kind(recording.header().kind), watch);
    let untimed_rows = recording.untimed();
    let (mut not_recorded, mut breaks) = (0, Breaks::default());
    while let Some(item) = recording.next_item() {
        match item {
            Ok((at, item)) => {
                match item {
                    Item::Event(EventRecord::FramesNotRecorded { count }) => not_recorded += count,
                    Item::Event(ref event @ EventRecord::Break { .. }) => {
                        breaks.broken(Break::told(event).unwrap_or(Break::Joined));
                    }
                    Item::Telemetry(_) => {
                        let row = recording.log().and_then(|log| log.rows.get(breaks.telemetries()));
                        // A run made from a log says only how many.
                        if untimed_rows > 0 && row.is_none_or(|row| row.taken_at.is_none()) {
                            judge.scorer.untimed();
                        }
                        breaks.telemetry(at);
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
    if untimed_rows > 0 {
        judge.scorer.note(untimed(untimed_rows));
    }
    breaks.notes(log).into_iter().for_each(|note| judge.scorer.note(note));
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

    /// A log of rows, with the names of their centre pictures, at 30 mph.
    fn scored(dir: &std::path::Path, names: impl IntoIterator<Item = String>) -> Scorecard {
        let rows: Vec<_> = names.into_iter().map(|name| format!("{name},,,0,0.5,0,30")).collect();
        let path = dir.join("driving_log.csv");
        std::fs::write(&path, rows.join("\n")).unwrap();
        of_recording(&mut Recording::open(&path).unwrap(), Scorer::on(&[], Some(1)), |_, _| ()).unwrap()
    }

    /// The name of a picture taken so many tenths of a second after the beginning.
    fn named(tenth: u32) -> String {
        format!("center_2026_11_22_10_{:02}_{:02}_{:03}.jpg", tenth / 600, tenth / 10 % 60, tenth % 10 * 100)
    }

    #[test]
    fn pictures_whose_names_hold_no_time_are_said_and_nothing_that_depends_on_time_is_made_up() {
        let dir = tempfile::tempdir().unwrap();
        let card = scored(dir.path(), (0..100).map(|i| format!("{i}.jpg")));
        assert!(
            card.notes[0].starts_with("100 pictures have names without a time: 15 rows a second are assumed"),
            "{card}"
        );
        for figure in Figure::ALL {
            let known = [Figure::MeanMph, Figure::MaxMph, Figure::Kicks];
            assert_eq!(card.value(figure).is_some(), known.contains(&figure), "{}: {card}", figure.key());
        }
        assert_eq!(card.words(Figure::DistanceM), "not measurable: the pictures' names hold no time");
        let [drive] = &card.drives[..] else { panic!("{card}") };
        assert_eq!((drive.way_m, drive.unknown.as_deref()), (None, Some("the pictures' names hold no time")));
        let timed = scored(dir.path(), (0..100).map(named));
        assert!(timed.value(Figure::DistanceM).is_some() && timed.value(Figure::TimeS).is_some(), "{timed}");
        // A single picture without a time stands alone: no time is assumed.
        let one = scored(dir.path(), (0..100).map(|i| if i == 50 { "x.jpg".into() } else { named(i) }));
        assert!(one.value(Figure::DistanceM).is_some() && !one.to_string().contains("without a time"), "{one}");
    }

    #[test]
    fn rows_that_are_missing_are_a_gap_in_one_drive_and_the_distance_says_that_it_is_left_out() {
        let dir = tempfile::tempdir().unwrap();
        let card = scored(dir.path(), (0..50).chain(195..245).map(named));
        assert_eq!(card.drives.len(), 1, "{card}");
        assert_eq!(card.notes[0], "rows are missing for 14.6 s before line 51");
        assert!(card.words(Figure::DistanceM).contains("(estimated from speed over time, gaps left out, "), "{card}");
        let whole = scored(dir.path(), (0..50).map(named));
        assert!(whole.words(Figure::DistanceM).contains("(estimated from speed over time, \u{b1}"), "{whole}");
    }

    #[test]
    fn of_rows_in_the_wrong_order_the_card_says_so_and_does_not_name_each_as_a_drive() {
        let dir = tempfile::tempdir().unwrap();
        let card = scored(dir.path(), (0..60).rev().map(named));
        let says = "in 59 places the time goes back, the first in line 2: the rows are not in the order of time, so the \
                    figures are not the drive's; sort the rows by the pictures' names";
        assert_eq!(card.notes[0], says, "{card}");
        let text = card.to_string();
        assert!(
            !text.contains("joined") && text.contains("all 60 are shorter than 5 m, which tells nothing"),
            "{text}"
        );
        assert!(!text.contains("telemetries 3 to 3"), "{text}");
        assert_eq!(card.value(Figure::FramesPerS), None, "no row follows another: {text}");
        assert!(!text.contains(" of the run in "), "{text}");
    }
}
