//! Latency of answers, by stage.

use hdrhistogram::Histogram;
use serde::Serialize;

use lapwing_core::recording::{By, CommandRecord};

/// Quantiles of a time, in milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Latency {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// Longest time that is told apart from longer ones: an hour, in nanoseconds.
const LONGEST_NS: u64 = 3_600_000_000_000;

/// The stages of an answer, in their order; then what of the driver's time is its guard's, and how late commands take effect, where
/// the network was shown the road from there.
pub const STAGES: [&str; 7] = ["decode", "preprocess", "forward", "driver", "answer", "guard", "ahead"];

/// Times of the pilot's answers.
#[derive(Debug, Clone)]
pub(super) struct Stages([Histogram<u64>; STAGES.len()]);

impl Default for Stages {
    fn default() -> Self {
        let histogram = |_| Histogram::new(3).expect("three digits are a histogram's");
        Self(std::array::from_fn(histogram))
    }
}

impl Stages {
    pub(super) fn take(&mut self, command: &CommandRecord) {
        if command.by != By::Pilot {
            return;
        }
        let CommandRecord { decode_ns, preprocess_ns, forward_ns, driver_ns, latency_ns, guard_ns, ahead_ns, .. } =
            command;
        let [decode_ns, preprocess_ns, forward_ns, driver_ns] =
            [decode_ns, preprocess_ns, forward_ns, driver_ns].map(|ns| Some(*ns));
        let times = [decode_ns, preprocess_ns, forward_ns, driver_ns, *latency_ns, *guard_ns, *ahead_ns];
        for (histogram, ns) in self.0.iter_mut().zip(times) {
            ns.into_iter().for_each(|ns| histogram.record(ns.min(LONGEST_NS)).expect("it grows to an hour"));
        }
    }

    /// Latency of each stage; `None` if no time of it is known.
    pub(super) fn latencies(&self) -> [Option<Latency>; STAGES.len()] {
        self.0.each_ref().map(|histogram| {
            let ms = |quantile| histogram.value_at_quantile(quantile) as f64 / 1e6;
            (!histogram.is_empty()).then(|| Latency { p50: ms(0.5), p95: ms(0.95), p99: ms(0.99) })
        })
    }
}
