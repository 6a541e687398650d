//! What is said of a drive when it ends. The scorecard proper is made from the
//! run file; this is the bridge's own account, also of drives not recorded.

use std::{fmt, path::PathBuf, time::Duration};

use hdrhistogram::Histogram;
use serde::Serialize;

use crate::{
    driver::{By, Happening, Trace},
    protocol::Dialect,
    units::{MPS_PER_MPH, Mph},
};

/// A gap longer than this is a pause of the simulator, not driving.
const LONGEST_STEP: Duration = Duration::from_secs(1);

/// Counts while the drive goes on.
pub(super) struct Statistics {
    first: Option<Duration>,
    last: Duration,
    last_speed: Mph,
    driven: Duration,
    distance_m: f64,
    max_speed: Mph,
    telemetries: u64,
    human: u64,
    takeovers: u64,
    bad_frames: u64,
    kicks: u64,
    /// Message in to answer out, microseconds.
    latency: Histogram<u64>,
}

impl Statistics {
    pub fn new() -> Self {
        Self {
            first: None,
            last: Duration::ZERO,
            last_speed: Mph::ZERO,
            driven: Duration::ZERO,
            distance_m: 0.0,
            max_speed: Mph::ZERO,
            telemetries: 0,
            human: 0,
            takeovers: 0,
            bad_frames: 0,
            kicks: 0,
            latency: Histogram::new_with_bounds(1, 60_000_000, 3).expect("these bounds are valid"),
        }
    }

    /// One answered message.
    pub fn count(&mut self, at: Duration, speed: Option<Mph>, trace: &Trace, latency: Option<Duration>) {
        let step = self.first.map_or(Duration::ZERO, |_| at.saturating_sub(self.last).min(LONGEST_STEP));
        self.first.get_or_insert(at);
        // Trapezoid between two telemetries; a human's or a bad one keeps the speed known last.
        let speed = speed.unwrap_or(self.last_speed);
        self.distance_m += 0.5 * (speed.get() + self.last_speed.get()) * MPS_PER_MPH * step.as_secs_f64();
        self.driven += step;
        (self.last, self.last_speed) = (at, speed);
        if speed > self.max_speed {
            self.max_speed = speed;
        }
        if trace.by == By::Human {
            self.human += 1
        } else {
            self.telemetries += 1
        }
        for happening in &trace.happenings {
            match happening {
                Happening::TakeoverBegan => self.takeovers += 1,
                Happening::BadFrame { .. } => self.bad_frames += 1,
                Happening::TakeoverEnded { .. } | Happening::BrakingToStandstill => {}
            }
        }
        if let Some(latency) = latency {
            self.latency.saturating_record(latency.as_micros().try_into().unwrap_or(u64::MAX));
        }
    }

    pub fn kicked(&mut self, times: u32) {
        self.kicks += u64::from(times);
    }

    /// The account.
    pub fn summary(&self, simulator: String, dialect: Option<Dialect>, run: Option<Recorded>) -> Summary {
        let time_s = self.first.map_or(0.0, |first| self.last.saturating_sub(first).as_secs_f64());
        let driven_s = self.driven.as_secs_f64();
        let milliseconds = |quantile| self.latency.value_at_quantile(quantile) as f64 / 1e3;
        Summary {
            simulator,
            dialect,
            time_s,
            distance_m: self.distance_m,
            max_speed_mph: self.max_speed.get(),
            mean_speed_mph: if driven_s > 0.0 { self.distance_m / MPS_PER_MPH / driven_s } else { 0.0 },
            human_takeovers: self.takeovers,
            telemetries: self.telemetries,
            human_messages: self.human,
            frames_per_s: if time_s > 0.0 {
                (self.telemetries + self.human).saturating_sub(1) as f64 / time_s
            } else {
                0.0
            },
            latency_p50_ms: milliseconds(0.5),
            latency_p95_ms: milliseconds(0.95),
            latency_p99_ms: milliseconds(0.99),
            bad_frames: self.bad_frames,
            kicks: self.kicks,
            run,
        }
    }
}

/// Where the run lies and what of it.
#[derive(Debug, Clone, Serialize)]
pub struct Recorded {
    /// The file.
    pub path: PathBuf,
    /// Frames in it.
    pub frames: u64,
    /// Frames and other items that did not make it into the file.
    pub not_recorded: u64,
    /// What kept the file from being whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// The bridge's account of a drive.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// Address of the simulator or client.
    pub simulator: String,
    /// Which simulator it was.
    pub dialect: Option<Dialect>,
    /// First to last message, s.
    pub time_s: f64,
    /// Speed summed over time, m. Pauses of over a second count as one.
    pub distance_m: f64,
    /// Highest speed told, mph.
    pub max_speed_mph: f64,
    /// Distance over time driven, mph.
    pub mean_speed_mph: f64,
    /// Times that a human took over.
    pub human_takeovers: u64,
    /// Telemetries answered with a command.
    pub telemetries: u64,
    /// Messages that said that a human drives.
    pub human_messages: u64,
    /// Messages per second.
    pub frames_per_s: f64,
    /// Message in to answer out, median, ms.
    pub latency_p50_ms: f64,
    /// 95th percentile, ms.
    pub latency_p95_ms: f64,
    /// 99th percentile, ms.
    pub latency_p99_ms: f64,
    /// Frames that could not be used.
    pub bad_frames: u64,
    /// Commands sent unasked, to start or restart the simulator's loop.
    pub kicks: u64,
    /// Where the run lies.
    pub run: Option<Recorded>,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let dialect = self.dialect.map_or("unknown simulator".into(), |d| d.to_string());
        writeln!(f, "drive of {} ({dialect})", self.simulator)?;
        writeln!(f, "  time             {:9.1} s", self.time_s)?;
        writeln!(f, "  distance         {:9.1} m", self.distance_m)?;
        writeln!(f, "  speed            {:9.2} mph mean, {:.2} mph maximum", self.mean_speed_mph, self.max_speed_mph)?;
        writeln!(f, "  human takeovers  {:9}", self.human_takeovers)?;
        writeln!(f, "  frame rate       {:9.1} /s ({} telemetries)", self.frames_per_s, self.telemetries)?;
        writeln!(
            f,
            "  latency          {:9.2} ms p50, {:.2} ms p95, {:.2} ms p99",
            self.latency_p50_ms, self.latency_p95_ms, self.latency_p99_ms
        )?;
        writeln!(f, "  bad frames       {:9}", self.bad_frames)?;
        match &self.run {
            None => write!(f, "  run              not recorded"),
            Some(Recorded { path, frames, not_recorded, error }) => {
                write!(f, "  run              {} ({frames} frames)", path.display())?;
                if *not_recorded > 0 {
                    write!(f, "\n  not recorded     {not_recorded:9} frames and other items")?;
                }
                error.as_ref().map_or(Ok(()), |e| write!(f, "\n  recording error  {e}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(speeds_at_ms: &[(u64, f64)]) -> Summary {
        let mut statistics = Statistics::new();
        for (at, speed) in speeds_at_ms {
            let speed = Some(Mph::new(*speed).unwrap());
            statistics.count(Duration::from_millis(*at), speed, &Trace::default(), Some(Duration::from_millis(2)));
        }
        statistics.summary("test".into(), None, None)
    }

    #[test]
    fn ten_seconds_at_ten_mph_are_44_7_metres() {
        let summary = drive(&(0..=100).map(|i| (i * 100, 10.0)).collect::<Vec<_>>());
        assert!((summary.distance_m - 44.704).abs() < 1e-9);
        assert!((summary.mean_speed_mph - 10.0).abs() < 1e-9);
        assert!((summary.frames_per_s - 10.0).abs() < 1e-9);
        assert!((summary.latency_p99_ms - 2.0).abs() < 0.01);
    }

    #[test]
    fn a_pause_counts_as_one_second_of_driving() {
        let summary = drive(&[(0, 10.0), (60_000, 10.0)]);
        assert!((summary.distance_m - 4.4704).abs() < 1e-9);
        assert_eq!(summary.time_s, 60.0);
        assert!((summary.mean_speed_mph - 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_drive_of_nothing_has_no_speed_and_no_rate() {
        let summary = drive(&[]);
        assert_eq!((summary.mean_speed_mph, summary.frames_per_s, summary.latency_p50_ms), (0.0, 0.0, 0.0));
        assert!(summary.to_string().contains("not recorded"));
    }
}
