//! What an open-loop replay says of a driver.

use std::{fmt, time::Duration};

use serde::Serialize;

use super::Answered;
use crate::{protocol::Answer, score::Agreement};

/// Quantiles of a time, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Latency {
    /// Median.
    pub p50_ms: f64,
    /// 95th percentile.
    pub p95_ms: f64,
    /// 99th percentile.
    pub p99_ms: f64,
}

impl Latency {
    /// Of measured times; `None` of none.
    pub fn of(times: &[Duration]) -> Option<Self> {
        let mut sorted = times.to_vec();
        sorted.sort_unstable();
        let last = sorted.len().checked_sub(1)?;
        let quantile = |q: f64| sorted[(q * last as f64).round() as usize].as_secs_f64() * 1e3;
        Some(Self { p50_ms: quantile(0.5), p95_ms: quantile(0.95), p99_ms: quantile(0.99) })
    }
}

/// What an open-loop replay says of a driver.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// What was replayed.
    pub source: String,
    /// What answered: a model, or a bridge.
    pub driver: String,
    /// Moments replayed.
    pub moments: u64,
    /// Those at which a human was said to drive.
    pub human: u64,
    /// Telemetries in the recording without a picture, skipped: it was broken, or the disk too slow for it.
    pub skipped: u64,
    /// Steering against the recorded one; absent where the recording has none.
    pub steering: Option<Agreement>,
    /// Time of an answer: the driver's alone in process, the round trip over a connection.
    pub latency: Option<Latency>,
    /// Moments a second, all told.
    pub frames_per_s: f64,
    /// Whether and where the recording ends before its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cut_off: Option<String>,
}

impl Report {
    /// From a replay's answers and their times.
    pub fn new(
        (source, driver): (String, String),
        answers: &[Answered],
        (skipped, cut_off): (u64, Option<String>),
        (times, wall): (&[Duration], Duration),
    ) -> Self {
        let pairs = answers.iter().filter_map(|a| match a.answer {
            Answer::Steer(command) => Some((command.steering.get(), a.recorded?.get())),
            Answer::Manual => None,
        });
        Self {
            source,
            driver,
            moments: answers.len() as u64,
            human: answers.iter().filter(|a| a.answer == Answer::Manual).count() as u64,
            skipped,
            steering: Agreement::of(pairs),
            latency: Latency::of(times),
            frames_per_s: answers.len() as f64 / wall.as_secs_f64().max(1e-9),
            cut_off,
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "replay of {} to {}", self.source, self.driver)?;
        write!(f, "  frames           {:9}", self.moments)?;
        if self.human > 0 {
            write!(f, " ({} with a human driving)", self.human)?;
        }
        if self.skipped > 0 {
            write!(f, " ({} more are without a picture)", self.skipped)?;
        }
        match &self.steering {
            Some(Agreement { frames, mae, mse, r }) => {
                let r = r.map_or("not measurable: the steering does not vary".into(), |r| format!("{r:.3}"));
                write!(f, "\n  steering error   {mae:9.4} MAE, {mse:.5} MSE, r {r} (over {frames} frames)")?;
            }
            None => write!(f, "\n  steering error   not measurable: the recording has no steering")?,
        }
        if let Some(Latency { p50_ms, p95_ms, p99_ms }) = self.latency {
            write!(f, "\n  latency          {p50_ms:9.2} ms p50, {p95_ms:.2} ms p95, {p99_ms:.2} ms p99")?;
        }
        write!(f, "\n  frame rate       {:9.1} /s", self.frames_per_s)?;
        self.cut_off.as_ref().map_or(Ok(()), |why| write!(f, "\n  cut off          {why}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latency_is_quantiles_in_milliseconds() {
        let times: Vec<Duration> = (0..=100).map(Duration::from_millis).collect();
        assert_eq!(Latency::of(&times), Some(Latency { p50_ms: 50.0, p95_ms: 95.0, p99_ms: 99.0 }));
        assert_eq!(Latency::of(&[]), None);
    }
}
