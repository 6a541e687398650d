//! The report of an open-loop replay.

use std::{fmt, time::Duration};

use serde::Serialize;

use super::{Answered, Response};
use crate::{drive::too_many_bad_frames, stats::Agreement, words};

/// Bad frames that are listed one by one.
const NAMED: usize = 3;

const NO_STEERING: &str = "the recording has no steering";
const NOTHING_SEEN: &str = "no network saw a frame";

/// Quantiles of a time, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReplayLatency {
    /// Median.
    pub p50_ms: f64,
    /// 95th percentile.
    pub p95_ms: f64,
    /// 99th percentile.
    pub p99_ms: f64,
}

impl ReplayLatency {
    /// Quantiles of measured times; `None` if there are none.
    pub fn of(mut times: Vec<Duration>) -> Option<Self> {
        times.sort_unstable();
        let last = times.len().checked_sub(1)?;
        let quantile = |q: f64| times[(q * last as f64).round() as usize].as_secs_f64() * 1e3;
        Some(Self { p50_ms: quantile(0.5), p95_ms: quantile(0.95), p99_ms: quantile(0.99) })
    }
}

/// A frame that no network saw.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BadFrame {
    /// Its number, from 0.
    pub frame: u64,
    /// What is wrong with it.
    pub why: String,
}

/// What an open-loop replay says about a driver.
#[derive(Debug, Clone, Serialize)]
pub struct ReplayReport {
    /// What was replayed.
    pub source: String,
    /// What answered: a model, or a bridge.
    pub driver: String,
    /// Moments replayed.
    pub moments: u64,
    /// Those at which a human took over: however long a human drives, it is one.
    pub human: u64,
    /// Those at which the pilot waited to be armed.
    pub pilot_off: u64,
    /// Those whose frame no network saw; steering and latency are those of the others.
    pub bad_frames: u64,
    /// The first of them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub first_bad_frames: Vec<BadFrame>,
    /// Telemetries in the recording without a picture, skipped: it was broken, or the disk was too slow for it.
    pub skipped: u64,
    /// Steering compared with the recorded one; absent if there is nothing to compare, see [`ReplayReport::agreement`].
    pub steering: Option<Agreement>,
    /// Time of a pilot's answer: the driver's alone in process, the round trip over a connection.
    pub latency: Option<ReplayLatency>,
    /// Moments a second, of all kinds.
    pub frames_per_s: f64,
    /// Where and why the recording is cut off, if it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cut_off: Option<String>,
}

impl ReplayReport {
    /// Made from a replay's answers and the time of each.
    pub fn new(
        (source, driver): (String, String),
        answers: &[Answered],
        (skipped, cut_off): (u64, Option<String>),
        (times, wall): (&[Duration], Duration),
    ) -> Self {
        let count = |is: fn(&Response) -> bool| answers.iter().filter(|a| is(&a.response)).count() as u64;
        let steered = answers.iter().zip(times).filter(|(a, _)| matches!(a.response, Response::Steer(_)));
        let pairs = answers.iter().filter_map(|a| match a.response {
            Response::Steer(command) => Some((command.steering.get(), a.recorded?.get())),
            Response::Human | Response::Off(_) | Response::Bad { .. } => None,
        });
        let bad = answers.iter().filter_map(|a| match &a.response {
            Response::Bad { why } => Some(BadFrame { frame: a.frame, why: why.clone() }),
            Response::Steer(_) | Response::Human | Response::Off(_) => None,
        });
        Self {
            source,
            driver,
            moments: answers.len() as u64,
            human: count(|r| matches!(r, Response::Human)),
            pilot_off: count(|r| matches!(r, Response::Off(_))),
            bad_frames: count(|r| matches!(r, Response::Bad { .. })),
            first_bad_frames: bad.take(NAMED).collect(),
            skipped,
            steering: Agreement::of(pairs),
            latency: ReplayLatency::of(steered.map(|(_, time)| *time).collect()),
            frames_per_s: answers.len() as f64 / wall.as_secs_f64().max(1e-9),
            cut_off,
        }
    }

    /// Frames that were for the pilot to answer.
    pub fn for_the_pilot(&self) -> u64 {
        self.moments - self.human - self.pilot_off
    }

    /// What is wrong, if so many frames are bad that the figures say too little about the driver.
    pub fn too_many_bad_frames(&self) -> Option<String> {
        too_many_bad_frames(self.bad_frames, self.for_the_pilot())
    }

    /// Steering compared with the recorded one, or why that is not possible.
    ///
    /// # Errors
    /// The reason.
    pub fn agreement(&self) -> Result<&Agreement, &'static str> {
        let nothing_seen = self.bad_frames > 0 && self.bad_frames == self.for_the_pilot();
        self.steering.as_ref().ok_or(if nothing_seen { NOTHING_SEEN } else { NO_STEERING })
    }
}

impl fmt::Display for ReplayReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "replay of {} to {}", self.source, self.driver)?;
        write!(f, "  frames           {:9}", self.moments)?;
        let human = (self.human > 0).then(|| format!("{} by a human", words::count(self.human, "drive")));
        let off = (self.pilot_off > 0).then(|| format!("{} with the pilot off", self.pilot_off));
        let skipped = (self.skipped > 0).then(|| format!("{} more are without a picture", self.skipped));
        let besides: Vec<_> = [human, off, skipped].into_iter().flatten().collect();
        if !besides.is_empty() {
            write!(f, " ({})", besides.join("; "))?;
        }
        if self.bad_frames > 0 {
            let percent = 100.0 * self.bad_frames as f64 / self.for_the_pilot() as f64;
            write!(f, "\n  bad frames       {:9} ({percent:.1} %): no network saw them", self.bad_frames)?;
            for BadFrame { frame, why } in &self.first_bad_frames {
                write!(f, "\n    frame {frame}: {why}")?;
            }
            if self.bad_frames > self.first_bad_frames.len() as u64 {
                write!(f, "\n    and {} more", self.bad_frames - self.first_bad_frames.len() as u64)?;
            }
        }
        match self.agreement() {
            Ok(Agreement { frames, mae, mse, r }) => {
                let r = r.map_or("not measurable: the steering does not vary".into(), |r| format!("{r:.3}"));
                let over = words::count(*frames, "frame");
                write!(f, "\n  steering error   {mae:9.4} MAE, {mse:.5} MSE, r {r} (over {over})")?;
            }
            Err(why) => write!(f, "\n  steering error   not measurable: {why}")?,
        }
        if let Some(ReplayLatency { p50_ms, p95_ms, p99_ms }) = self.latency {
            write!(f, "\n  latency          {p50_ms:9.2} ms p50, {p95_ms:.2} ms p95, {p99_ms:.2} ms p99")?;
        }
        write!(f, "\n  frame rate       {:9.1} /s", self.frames_per_s)?;
        self.cut_off.as_ref().map_or(Ok(()), |why| write!(f, "\n  cut off          {why}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        protocol::Command,
        units::{Steering, Throttle},
    };

    #[test]
    fn latency_is_quantiles_in_milliseconds() {
        let times: Vec<Duration> = (0..=100).map(Duration::from_millis).collect();
        assert_eq!(ReplayLatency::of(times), Some(ReplayLatency { p50_ms: 50.0, p95_ms: 95.0, p99_ms: 99.0 }));
        assert_eq!(ReplayLatency::of(vec![]), None);
    }

    fn steer(steering: f64) -> Response {
        Response::Steer(Command { steering: Steering::new(steering).unwrap(), throttle: Throttle::ZERO })
    }

    fn bad() -> Response {
        Response::Bad { why: "image: expected a JPEG".into() }
    }

    /// Each recorded straight on, answered in as many milliseconds as its number says.
    fn report(responses: Vec<Response>) -> ReplayReport {
        let times: Vec<Duration> = (0..responses.len() as u64).map(Duration::from_millis).collect();
        let answers: Vec<Answered> = responses
            .into_iter()
            .enumerate()
            .map(|(i, response)| {
                let recorded = Some(Steering::ZERO);
                Answered { frame: i as u64, at: Duration::ZERO, recorded, response }
            })
            .collect();
        ReplayReport::new(("run".into(), "model".into()), &answers, (0, None), (&times, Duration::from_secs(1)))
    }

    #[test]
    fn steering_and_latency_are_of_the_frames_that_the_pilot_saw_and_of_no_others() {
        let off = Response::Off(Command::default());
        let report = report(vec![bad(), steer(0.1), bad(), steer(0.3), Response::Human, off]);
        let agreement = report.agreement().unwrap();
        assert_eq!((agreement.frames, agreement.mae), (2, 0.2));
        assert_eq!(report.latency.unwrap().p50_ms, 3.0);
        assert_eq!((report.moments, report.human, report.pilot_off, report.bad_frames), (6, 1, 1, 2));
        let text = report.to_string();
        assert!(text.contains("bad frames               2 (50.0 %): no network saw them"), "{text}");
        assert!(text.contains("\n    frame 0: image: expected a JPEG\n"), "{text}");
        assert!(text.contains("(over 2 frames)"), "{text}");
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!((&json["bad_frames"], &json["first_bad_frames"][1]["frame"]), (&2.into(), &2.into()));
    }

    #[test]
    fn one_frame_is_not_frames() {
        let text = report(vec![steer(0.1)]).to_string();
        assert!(text.contains("(over 1 frame)"), "{text}");
    }

    #[test]
    fn of_nothing_but_bad_frames_nothing_is_measured_and_the_reason_is_theirs() {
        let report = report(vec![bad(), bad(), bad(), bad()]);
        assert_eq!(report.agreement(), Err(NOTHING_SEEN));
        assert!(report.latency.is_none());
        let text = report.to_string();
        assert!(text.contains("steering error   not measurable: no network saw a frame"), "{text}");
        assert!(text.contains("and 1 more"), "{text}");
    }

    #[test]
    fn more_than_one_bad_frame_in_a_hundred_is_too_many() {
        let with = |frames: usize, bad_ones: usize| {
            let mut responses = vec![steer(0.1); frames - bad_ones];
            responses.extend(vec![bad(); bad_ones]);
            report(responses).too_many_bad_frames().is_some()
        };
        assert!(!with(100, 0) && !with(100, 1) && !with(200, 2));
        assert!(with(100, 2) && with(99, 1) && with(1, 1));
    }
}
