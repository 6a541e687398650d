//! A run's file as a scorecard.

use std::time::Duration;

use super::{Scorecard, Scorer};
use crate::recording::{EventRecord, Item, RecordingError, RunReader};

/// Reads a run to its end and judges it by this scorer; `watch` sees each item, too, and as events what the scorer suspects
/// where the run does not tell. What is wrong with the file stands in the notes.
///
/// # Errors
/// [`RecordingError::Io`] where the file cannot be read any more.
pub fn of_run(
    run: &mut RunReader,
    mut scorer: Scorer,
    mut watch: impl FnMut(Duration, &Item),
) -> Result<Scorecard, RecordingError> {
    let mut unreadable: Option<(u64, RecordingError)> = None;
    let mut not_recorded = 0;
    for item in run.by_ref() {
        match item {
            Ok((at, item)) => {
                if let Item::Event(EventRecord::FramesNotRecorded { count }) = item {
                    not_recorded += count;
                }
                scorer.item(at, &item);
                watch(at, &item);
                if let Some(event) = scorer.suspicion() {
                    watch(at, &Item::Event(event));
                }
            }
            Err(error @ RecordingError::Message { .. }) => {
                unreadable = Some(unreadable.map_or_else(|| (1, error), |(n, first)| (n + 1, first)));
            }
            Err(error) => return Err(error),
        }
    }
    if let Some(truncation) = run.truncated() {
        scorer.note(truncation.to_string());
    }
    if let Some((n, first)) = unreadable {
        scorer.note(format!("{n} messages cannot be read, the first: {first}"));
    }
    if not_recorded > 0 {
        scorer.note(format!("{not_recorded} pictures were not recorded: the disk was too slow"));
    }
    Ok(scorer.finish())
}
