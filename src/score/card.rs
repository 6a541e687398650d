//! The judgement, for people and for scripts.

use std::fmt;

use serde::Serialize;

/// What a run was worth. `None` is what the run does not tell.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scorecard {
    /// The track.
    pub track: Option<String>,
    /// Why the run ended.
    pub ended: Option<String>,
    /// From the first telemetry to the last, in seconds of the world.
    pub time_s: f64,
    /// Metres driven: told by the world, else speed over time.
    pub distance_m: f64,
    /// Mean speed over time, in mph.
    pub mean_mph: Option<f64>,
    /// Highest speed told, in mph.
    pub max_mph: f64,
    /// Laps asked for.
    pub laps_asked: Option<u32>,
    /// Laps completed.
    pub laps: Option<u32>,
    /// How long each took, in seconds.
    pub lap_times_s: Vec<f64>,
    /// Completion rate (Lu): the way that the car got, as a share of the laps asked for, 0 to 1.
    pub completion: Option<f64>,
    /// Contacts with anything.
    pub collisions: Option<u32>,
    /// Contacts a kilometre.
    pub collisions_per_km: Option<f64>,
    /// Times that the car left the road.
    pub off_roads: Option<u32>,
    /// Seconds that it was off it.
    pub off_road_s: Option<f64>,
    /// Times that it was put back on the road.
    pub resets: Option<u32>,
    /// Times that it did not get away.
    pub stuck: Option<u32>,
    /// Mean of |cte|, in metres.
    pub mean_cte_m: Option<f64>,
    /// 95th percentile of |cte|, in metres.
    pub p95_cte_m: Option<f64>,
    /// Largest |cte|, in metres.
    pub max_cte_m: Option<f64>,
    /// Root mean square of the steering rate over time, in degrees a second: sqrt(∫(dδ/dt)² dt / ∫dt) with the steering
    /// angle δ told in telemetry, a straight line between two of them. Small is smooth. `None` where no two follow one
    /// another; what lies in a gap of more than a second or across a reset does not count.
    pub steering_rate_deg_s: Option<f64>,
    /// Times that a human took the wheel.
    pub takeovers: u32,
    /// Frames that could not be driven by.
    pub bad_frames: u32,
}

/// What a run must reach. `None` asks for nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Thresholds {
    /// Least completion, 0 to 1.
    pub min_completion: Option<f64>,
    /// Most collisions.
    pub max_collisions: Option<u32>,
    /// Most times off the road.
    pub max_off_roads: Option<u32>,
    /// Largest |cte| allowed anywhere, in metres.
    pub max_cte_m: Option<f64>,
}

impl Thresholds {
    /// Each threshold that a run misses, in words. What the run does not tell misses, too.
    pub fn missed(&self, card: &Scorecard) -> Vec<String> {
        let mut missed = vec![];
        let mut check = |what: &str, expected: Option<String>, got: Option<String>, ok: bool| {
            if let Some(expected) = expected
                && !ok
            {
                let got = got.unwrap_or_else(|| "nothing: the run does not tell it".into());
                missed.push(format!("{what}: expected {expected}, got {got}"));
            }
        };
        let percent = |share: f64| format!("{:.1} %", share * 100.0);
        check(
            "completion",
            self.min_completion.map(|min| format!("at least {}", percent(min))),
            card.completion.map(percent),
            self.min_completion.zip(card.completion).is_some_and(|(min, got)| got >= min),
        );
        check(
            "collisions",
            self.max_collisions.map(|max| format!("at most {max}")),
            card.collisions.map(|got| got.to_string()),
            self.max_collisions.zip(card.collisions).is_some_and(|(max, got)| got <= max),
        );
        check(
            "times off the road",
            self.max_off_roads.map(|max| format!("at most {max}")),
            card.off_roads.map(|got| got.to_string()),
            self.max_off_roads.zip(card.off_roads).is_some_and(|(max, got)| got <= max),
        );
        check(
            "largest |cte|",
            self.max_cte_m.map(|max| format!("at most {max} m")),
            card.max_cte_m.map(|got| format!("{got:.2} m")),
            self.max_cte_m.zip(card.max_cte_m).is_some_and(|(max, got)| got <= max),
        );
        missed
    }
}

impl fmt::Display for Scorecard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unknown = || "not measurable: the run does not tell it".to_owned();
        let told = |value: Option<String>| value.unwrap_or_else(unknown);
        let mut rows: Vec<(&str, String)> = vec![];
        if let Some(why) = &self.ended {
            rows.push(("ended", why.clone()));
        }
        rows.push((
            "completion",
            match (self.completion, self.laps, self.laps_asked) {
                (Some(share), Some(laps), Some(asked)) => {
                    format!("{:.1} %, {laps} of {asked} {}", share * 100.0, if asked == 1 { "lap" } else { "laps" })
                }
                (_, Some(laps), None) => format!("{laps} laps, none asked for"),
                _ => unknown(),
            },
        ));
        if !self.lap_times_s.is_empty() {
            let times = self.lap_times_s.iter().map(|t| format!("{t:.1}")).collect::<Vec<_>>().join(", ");
            rows.push(("lap times", format!("{times} s")));
        }
        rows.push((
            "collisions",
            told(self.collisions.map(|n| match self.collisions_per_km {
                Some(rate) if n > 0 => format!("{n} ({rate:.2} /km)"),
                _ => n.to_string(),
            })),
        ));
        rows.push((
            "off the road",
            told(self.off_roads.zip(self.off_road_s).map(|(n, s)| match n {
                0 => "never".into(),
                1 => format!("once, {s:.1} s"),
                _ => format!("{n} times, {s:.1} s"),
            })),
        ));
        for (name, count) in [("stuck", self.stuck), ("put back", self.resets)] {
            if let Some(n @ 1..) = count {
                rows.push((name, format!("{n} times")));
            }
        }
        rows.push((
            "|cte|",
            told(
                self.mean_cte_m.zip(self.p95_cte_m.zip(self.max_cte_m)).map(|(mean, (p95, max))| {
                    format!("{mean:.2} m mean, {p95:.2} m 95th percentile, {max:.2} m largest")
                }),
            ),
        ));
        rows.push(("steering rate", told(self.steering_rate_deg_s.map(|rate| format!("{rate:.1} deg/s RMS")))));
        rows.push(("distance", format!("{:.1} m in {:.1} s", self.distance_m, self.time_s)));
        rows.push((
            "speed",
            match self.mean_mph {
                Some(mean) => format!("{mean:.2} mph mean, {:.2} mph maximum", self.max_mph),
                None => format!("{:.2} mph maximum", self.max_mph),
            },
        ));
        if self.takeovers > 0 {
            rows.push(("human takeovers", self.takeovers.to_string()));
        }
        if self.bad_frames > 0 {
            rows.push(("bad frames", self.bad_frames.to_string()));
        }
        let rows: Vec<_> = rows.into_iter().map(|(name, value)| format!("  {name:<17} {value}")).collect();
        f.write_str(&rows.join("\n"))
    }
}
