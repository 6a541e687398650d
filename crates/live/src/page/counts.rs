//! What is counted of drives for Prometheus: by the one who drives, without a lock, and read by whoever asks.

use std::time::Duration;

use lapwing_core::turn::{EventRecord, Turn};

/// The stages of an answer that are timed, in their order.
pub(super) const STAGES: [&str; 5] = ["decode", "preprocess", "forward", "driver", "answer"];

/// Upper bounds of the histograms' buckets, in seconds; one more has no bound.
pub(super) const BOUNDS_S: [f64; 11] = [0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25];

/// Counts of one drive, or of several.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Counts {
    /// Telemetries, those included that could not be read or came while a human drove.
    pub messages: u64,
    /// Telemetries or pictures that could not be used.
    pub bad_frames: u64,
    /// Times that a human took over.
    pub takeovers: u64,
    /// Times that the car was put back on the road.
    pub interventions: u64,
    /// Frames and other items of runs that did not make it into their files.
    pub not_recorded: u64,
    /// Times of the answers, by stage.
    pub stages: [Times; STAGES.len()],
}

/// A histogram.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Times {
    /// How many were in each bucket.
    pub buckets: [u64; BOUNDS_S.len() + 1],
    /// Their sum, in seconds.
    pub sum_s: f64,
}

impl Times {
    fn take(&mut self, time: Duration) {
        let s = time.as_secs_f64();
        let bucket = BOUNDS_S.iter().position(|bound| s <= *bound).unwrap_or(BOUNDS_S.len());
        self.buckets[bucket] += 1;
        self.sum_s += s;
    }

    fn add(&mut self, other: &Self) {
        self.buckets.iter_mut().zip(other.buckets).for_each(|(count, more)| *count += more);
        self.sum_s += other.sum_s;
    }
}

/// The times of a turn's stages; none where it was not answered, and none of a network's where none was asked: the expert
/// has no forward pass.
pub(super) fn times(turn: &Turn) -> [Option<Duration>; STAGES.len()] {
    let trace = &turn.trace;
    let looked = trace.prediction.is_some() && trace.forward > Duration::ZERO;
    let by_network = |time| looked.then_some(time);
    [by_network(trace.decode), by_network(trace.preprocess), by_network(trace.forward), Some(trace.total), turn.latency]
}

impl Counts {
    /// Takes a turn.
    pub fn turn(&mut self, turn: &Turn) {
        self.messages += 1;
        turn.trace.events.iter().for_each(|event| self.event(event));
        for (stage, time) in self.stages.iter_mut().zip(times(turn)) {
            time.into_iter().for_each(|time| stage.take(time));
        }
    }

    /// Takes an event.
    pub fn event(&mut self, event: &EventRecord) {
        match event {
            EventRecord::BadFrame { .. } => self.bad_frames += 1,
            EventRecord::TakeoverBegan => self.takeovers += 1,
            EventRecord::Reset { .. } => self.interventions += 1,
            _ => {}
        }
    }

    /// Adds those of another drive.
    pub fn add(&mut self, other: &Self) {
        self.messages += other.messages;
        self.bad_frames += other.bad_frames;
        self.takeovers += other.takeovers;
        self.interventions += other.interventions;
        self.not_recorded += other.not_recorded;
        self.stages.iter_mut().zip(&other.stages).for_each(|(times, more)| times.add(more));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_counted_in_the_smallest_bucket_that_holds_it() {
        let mut times = Times::default();
        for us in [100, 101, 1_000, 300_000] {
            times.take(Duration::from_micros(us));
        }
        assert_eq!(times.buckets, [1, 1, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1]);
        assert!((times.sum_s - 0.301201).abs() < 1e-12);
    }

    #[test]
    fn counts_of_drives_add_up() {
        let mut counts = Counts { messages: 2, ..Counts::default() };
        counts.event(&EventRecord::TakeoverBegan);
        counts.event(&EventRecord::Reset { waypoint: 3 });
        counts.event(&EventRecord::BadFrame { why: "no JPEG".into(), count_in_row: 1 });
        let mut all = counts;
        all.add(&counts);
        assert_eq!((all.messages, all.bad_frames, all.takeovers, all.interventions), (4, 2, 2, 2));
    }
}
