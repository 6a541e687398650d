//! The figures of a scorecard, each with its unit, formula and source.
//!
//! The text after each is its documentation here and in `lapwing score --explain`; [`SOURCES`] are cited in it.

use serde::Serialize;
use serde_json::Value;

/// The sources that figures cite, by their short names.
pub const SOURCES: [(&str, &str); 10] = [
    (
        "Lu",
        "End to End Learning for Self-Driving Cars, which judged by collision rate, maximum speed and completion rate.",
    ),
    ("Bojarski", "End to End Learning for Self-Driving Cars, arXiv 1604.07316 (2016), section 7.1."),
    ("Tampuu", "Lidar-as-Camera for End-to-End Driving, arXiv 2206.15170 (2022): the Rally Estonia study."),
    ("CARLA", "the leaderboard's evaluation criteria, versions 1.0 and 2.1 (leaderboard.carla.org)."),
    ("nuPlan", "ego_is_comfortable of the nuPlan benchmark (Caesar et al., arXiv 2106.11810) and its development kit."),
    ("Hayward", "Near miss determination through use of a scale of danger, Highway Research Record 384 (1972)."),
    (
        "Euro NCAP",
        "the test protocols AEB Car-to-Car v4 and AEB/LSS VRU v4 (2023), after which the scenarios are made.",
    ),
    ("Codevilla", "On Offline Evaluation of Vision-based Driving Models, arXiv 1809.04843 (2018)."),
    ("J2944", "SAE J2944, Operational Definitions of Driving Performance Measures and Statistics (2015)."),
    ("SelfOracle", "the simulator of Stocco et al., Misbehaviour Prediction for Autonomous Driving Systems (2020)."),
];

/// The unit of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// 0 to 1; people are shown percent.
    Share,
    /// A whole number.
    Count,
    /// 0 to 100.
    Points,
    /// Per kilometre.
    PerKm,
    /// Per minute.
    PerMinute,
    /// Per second.
    PerSecond,
    /// Per hour.
    PerHour,
    /// Metres.
    Metres,
    /// Seconds.
    Seconds,
    /// Miles an hour.
    Mph,
    /// Degrees a second.
    DegreesPerSecond,
    /// Times the acceleration of gravity.
    Gravities,
    /// Metres a second cubed.
    Jerk,
    /// Normalised steering: 1 is full lock.
    Lock,
    /// Its square.
    LockSquared,
    /// -1 to 1.
    Correlation,
}

impl Unit {
    /// Its symbol after a number; nothing for counts, points and correlations. Shares are shown as percent.
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::Share => "%",
            Self::Count | Self::Points | Self::Correlation => "",
            Self::PerKm => "/km",
            Self::PerMinute => "/min",
            Self::PerSecond => "/s",
            Self::PerHour => "/h",
            Self::Metres => "m",
            Self::Seconds => "s",
            Self::Mph => "mph",
            Self::DegreesPerSecond => "deg/s",
            Self::Gravities => "g",
            Self::Jerk => "m/s3",
            Self::Lock => "lock",
            Self::LockSquared => "lock2",
        }
    }

    /// A value as people read it.
    pub fn show(self, value: f64) -> String {
        match self {
            Self::Share => format!("{:.1} %", value * 100.0),
            Self::Count => format!("{value:.0}"),
            Self::Points => format!("{value:.1}"),
            Self::PerKm => format!("{value:.2} a km"),
            Self::PerMinute => format!("{value:.1} times a minute"),
            Self::PerSecond => format!("{value:.1} a second"),
            Self::PerHour => format!("{value:.1} an hour"),
            Self::Metres => format!("{value:.2} m"),
            Self::Seconds => format!("{value:.1} s"),
            Self::Mph => format!("{value:.2} mph"),
            Self::DegreesPerSecond => format!("{value:.1} deg/s"),
            Self::Gravities => format!("{value:.2} g"),
            Self::Jerk => format!("{value:.2} m/s3"),
            Self::Lock => format!("{value:.4} of full lock"),
            Self::LockSquared => format!("{value:.5} of full lock squared"),
            Self::Correlation => format!("{value:.3}"),
        }
    }

    /// A value that somebody gave, as people read it: with more digits than usual if it has them.
    pub fn show_given(self, value: f64) -> String {
        let (usual, exact) = (self.show(value), self.shown(value));
        let (number, unit) = usual.split_at(usual.find(' ').unwrap_or(usual.len()));
        let is_all = number.parse::<f64>().is_ok_and(|number| (number - exact).abs() <= 1e-9 * exact.abs());
        if is_all { usual } else { significant(exact, 12) + unit }
    }

    /// A mean over runs as people read it: to four significant digits, whatever its size.
    pub fn show_mean(self, mean: f64) -> String {
        self.with_symbol(&significant(self.shown(mean), 4))
    }

    fn shown(self, value: f64) -> f64 {
        if self == Self::Share { 100.0 * value } else { value }
    }

    fn with_symbol(self, number: &str) -> String {
        let symbol = self.symbol();
        if symbol.is_empty() { number.to_owned() } else { format!("{number} {symbol}") }
    }

    /// The range of possible values.
    pub const fn range(self) -> (f64, f64) {
        match self {
            Self::Share => (0.0, 1.0),
            Self::Points => (0.0, 100.0),
            Self::Correlation => (-1.0, 1.0),
            _ => (0.0, f64::INFINITY),
        }
    }

    /// The interval of a mean, to be written after it: `± 1.5 %`, or `[0, 6.85]` if one side is cut off by the possible
    /// range, or wider.
    pub fn show_interval(self, mean: f64, [low, high]: [f64; 2]) -> String {
        let (below, above) = (mean - low, high - mean);
        if (below - above).abs() <= 1e-9 * high.abs() {
            return format!("± {}", self.with_symbol(&significant(self.shown(above), 3)));
        }
        format!("[{}, {}]", significant(self.shown(low), 3), significant(self.shown(high), 3))
    }

    /// How far off an estimate may be: `± 0.04 %`, or `0 to 5` if it is a count or would reach beyond the possible
    /// range. None if it is not known to be off at all.
    pub fn show_off(self, value: f64, uncertainty: f64) -> Option<String> {
        let (least, most) = self.range();
        let (low, high) = (value - uncertainty, value + uncertainty);
        if uncertainty <= 0.0 {
            return None;
        }
        Some(if self == Self::Count {
            format!("{:.0} to {:.0}", low.max(least).floor(), high.ceil())
        } else if low < least || high > most {
            let ends = [low.max(least), high.min(most)].map(|end| significant(self.shown(end), 3));
            self.with_symbol(&format!("{} to {}", ends[0], ends[1]))
        } else {
            format!("± {}", self.with_symbol(&significant(self.shown(uncertainty), 2)))
        })
    }
}

/// A number to this many significant digits, without trailing zeros; all digits before the point stay.
fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.abs().to_string();
    }
    // A number that is rounded up to the next power of ten has one more digit.
    let magnitude = format!("{value:.*e}", digits as usize - 1);
    let exponent = magnitude.rsplit_once('e').and_then(|(_, exponent)| exponent.parse::<i32>().ok()).unwrap_or(0);
    let decimals = (digits - 1 - exponent).clamp(0, 15) as usize;
    let text = format!("{value:.decimals$}");
    if decimals == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

/// Which way a figure gets better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// More is better.
    Higher,
    /// Less is better.
    Lower,
    /// It describes what was driven, not how well.
    Neither,
}

/// A figure's description for pages.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Described {
    key: &'static str,
    label: &'static str,
    unit: &'static str,
    better: Better,
    meaning: &'static str,
}

macro_rules! figures {
    ($($name:ident = $key:literal, $label:literal, $unit:ident, $better:ident, $meaning:literal;)+) => {
        /// A figure of a [`Scorecard`](super::Scorecard).
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Figure {
            $(#[doc = $meaning] $name,)+
        }

        impl Figure {
            /// All figures, in the order of the scorecard.
            pub const ALL: [Self; [$(Self::$name),+].len()] = [$(Self::$name),+];

            /// Its name in JSON, unit included.
            pub const fn key(self) -> &'static str {
                match self { $(Self::$name => $key,)+ }
            }

            /// The figure of this name in JSON.
            pub fn of_key(key: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|figure| figure.key() == key)
            }

            /// Its name for people.
            pub const fn label(self) -> &'static str {
                match self { $(Self::$name => $label,)+ }
            }

            /// Its unit.
            pub const fn unit(self) -> Unit {
                match self { $(Self::$name => Unit::$unit,)+ }
            }

            /// Which way it gets better.
            pub const fn better(self) -> Better {
                match self { $(Self::$name => Better::$better,)+ }
            }

            /// How it is computed, and its source.
            pub const fn meaning(self) -> &'static str {
                match self { $(Self::$name => $meaning,)+ }
            }

            /// All figures, described.
            pub fn described() -> Vec<Described> {
                let described = |figure: Self| Described {
                    key: figure.key(),
                    label: figure.label(),
                    unit: figure.unit().symbol(),
                    better: figure.better(),
                    meaning: figure.meaning(),
                };
                Self::ALL.map(described).into()
            }
        }
    };
}

figures! {
    Completion = "completion", "completion", Share, Higher,
        "Distance covered, as a share of the laps asked for (Lu's completion rate), in whole waypoints, which are about 20 m apart.";
    Laps = "laps", "laps", Count, Higher,
        "Times that waypoint 0 was reached in sequence (SelfOracle).";
    Collisions = "collisions", "collisions", Count, Lower,
        "Contacts with anything; a contact that continues is counted once (Lu).";
    CollisionsPerKm = "collisions_per_km", "collisions per km", PerKm, Lower,
        "Collisions over the distance driven (CARLA counts infractions a kilometre).";
    Episodes = "episodes", "episodes", Count, Neither,
        "Drives from one start to the next: one, and one more each time the car was put back.";
    CollisionRate = "collision_rate", "collision rate", Share, Lower,
        "Episodes with a collision as a share of all (Lu).";
    MeanMph = "mean_mph", "mean speed", Mph, Higher,
        "Integral of the reported speed (without its sign) over time, divided by the time, from the first telemetry to the last.";
    MaxMph = "max_mph", "maximum speed", Mph, Neither,
        "Highest reported speed (Lu).";
    Autonomy = "autonomy", "autonomy", Share, Higher,
        "1 - 6 s x (takeovers + interventions) / time, at least 0 (Bojarski, where an intervention costs 6 s).";
    AutonomyMeasured = "autonomy_measured", "autonomy, measured", Share, Higher,
        "1 - (seconds that humans drove + 6 s x interventions) / time, at least 0: Bojarski's formula with the actual length of the takeovers.";
    Takeovers = "takeovers", "human takeovers", Count, Lower,
        "Number of times that a human took over.";
    HumanS = "human_s", "driven by humans", Seconds, Lower,
        "Time for which humans drove.";
    Interventions = "interventions", "interventions", Count, Lower,
        "Virtual interventions: each time that the car was put back on the road, and once more if the run ended within 2 s of a collision, off the road or stuck.";
    InterventionsPerKm = "interventions_per_km", "interventions per km", PerKm, Lower,
        "Virtual interventions over the distance driven (Tampuu).";
    DrivingScore = "driving_score", "driving score", Points, Higher,
        "100 x completion x (1 - share of the way off the road) / (1 + sum of 1.0 for each person hit, 0.7 for each vehicle, 0.6 for anything else) (CARLA 2.1).";
    DrivingScoreProduct = "driving_score_product", "driving score 1.0", Points, Higher,
        "100 x completion x (1 - share of the way off the road) x 0.5 for each person hit x 0.6 for each vehicle x 0.65 for anything else (CARLA 1.0).";
    MeanCte = "mean_cte_m", "mean |cte|", Metres, Lower,
        "Mean distance from the line to drive (the middle of the road, or of the lane where the track has one), as the world reports it, over telemetries (the cross-track error of SelfOracle's telemetry); along a recording from the lane's middle where that is known, otherwise from the recorded path, and the offset at which the car was put back counts once, too.";
    RmsCte = "rms_cte_m", "RMS cte", Metres, Lower,
        "Root of the mean squared distance from the line to drive (as the mean).";
    P95Cte = "p95_cte_m", "95th percentile of |cte|", Metres, Lower,
        "Distance from the line to drive that 95 of 100 telemetries keep within (as the mean).";
    MaxCte = "max_cte_m", "largest |cte|", Metres, Lower,
        "Largest distance from the line to drive (as the mean).";
    Beyond1m = "beyond_1_m_share", "beyond 1 m", Share, Lower,
        "Share of the time with more than 1 m between the car and the line to drive (as the mean), each telemetry standing for half the time to its neighbours: interventions alone overstate how well a pilot drives that is put back late.";
    Beyond2m = "beyond_2_m_share", "beyond 2 m", Share, Lower,
        "Share of the time with more than 2 m between the car and the line to drive (as beyond 1 m).";
    FromLane = "from_lane_share", "measured from the lane", Share, Neither,
        "Along a recording: share of the way on which offsets are measured from the lane's middle, the rest from the recorded path.";
    OffRoads = "off_roads", "times off the road", Count, Lower,
        "Episodes out of bounds: times that the car left the road (SelfOracle's tot_obes).";
    OffRoadS = "off_road_s", "time off the road", Seconds, Lower,
        "Time off the road.";
    OffRoadShare = "off_road_share", "share off the road", Share, Lower,
        "Distance driven off the road, as a share of the whole distance.";
    SteeringRate = "steering_rate_deg_s", "steering rate", DegreesPerSecond, Lower,
        "Whiteness (Tampuu, there of the steering wheel, here of the front wheels): root mean square of the steering angle's rate over time, sqrt(integral of (d angle / dt)^2 dt / time), a straight line between two telemetries; gaps of more than a second and resets do not count.";
    SteeringReversals = "steering_reversals_per_min", "steering reversals", PerMinute, Lower,
        "Times a minute that the steering angle turns back by at least 1 degree of the front wheels (J2944, where the threshold applies to the steering wheel).";
    RmsJerk = "rms_jerk_m_s3", "jerk", Jerk, Lower,
        "Root mean square of the speed's second derivative, each from a parabola fitted to the telemetries within half a second.";
    Comfort = "comfort", "comfortable", Share, Higher,
        "Telemetries within nuPlan's bounds as a share of all: acceleration -4.05 to 2.40 m/s2 along and 4.89 across, jerk 4.13 m/s3 along and 8.37 in all, yaw rate 0.95 rad/s and its rate 1.93 rad/s2; derivatives as for jerk, the yaw rate that of a bicycle with the steering and speed told.";
    BrakingAvoided = "braking_avoided", "avoided by braking", Share, Higher,
        "Braking situations in which nothing was hit, as a share of all. One begins where the time to collision falls below 10 s (Euro NCAP's tests begin at 4 s) and ends when something is hit, or after 1 s without a collision course. What is hit after that, before the car drives on, counts as well. One that the run's end cuts short does not count.";
    Impact = "impact_mph", "impact speed", Mph, Lower,
        "Speed of the car relative to what it hit in a braking situation, mean over those situations (Euro NCAP's relative impact speed).";
    SpeedReduction = "speed_reduction_mph", "speed reduction", Mph, Higher,
        "The car's speed where a braking situation began less its speed at the impact, or where nothing was hit its lowest in the situation, at least 0; mean over situations (Euro NCAP: test speed less impact speed).";
    MinTimeToCollision = "min_time_to_collision_s", "least time to collision", Seconds, Higher,
        "Shortest time until the car would hit other traffic ahead, should both hold speed and path: gap / closing speed while they close (Hayward), of the true boxes, the road laid out straight; 0 where it was hit.";
    FalseAlarms = "false_alarms_per_h", "false alarms", PerHour, Lower,
        "Times an hour that the pilot began emergency braking (throttle -0.8 or less above 5 mph, none in the second before) outside braking situations, that is with no collision in the next 10 s.";
    GuardActivations = "guard_activations", "guard activations", Count, Neither,
        "Times that the guard began to brake in place of the pilot.";
    GuardBrakedS = "guard_braked_s", "braked by the guard", Seconds, Neither,
        "Time for which the guard braked.";
    GuardHardest = "guard_hardest_g", "hardest guard braking", Gravities, Neither,
        "Largest deceleration while the guard braked and before anything was hit, over stretches of at least 0.2 s: speed lost divided by the time it took (FMVSS 127 allows 0.25 g in its tests of false activation); 0 where it never did.";
    SteeringMae = "steering_mae", "steering MAE", Lock, Lower,
        "Open-loop replay: mean of |a - b| over frames, a the driver's normalised steering (-1 to 1, full lock) for a recorded picture, b the steering recorded with it (Codevilla).";
    SteeringMse = "steering_mse", "steering MSE", LockSquared, Lower,
        "Open-loop replay: mean of (a - b)^2 over frames, normalised steering as for MAE (Codevilla).";
    SteeringR = "steering_r", "steering r", Correlation, Higher,
        "Open-loop replay: Pearson's correlation of the driver's steering and the recorded one over frames (Codevilla).";
    TimeS = "time_s", "time", Seconds, Neither,
        "From the first telemetry to the last, in seconds of the world: of a drive in Lapwing's own simulator, its telemetries at equal distances; otherwise the world's own clock if it sends one (sim_time), or else the recording's. A human's drive before the first or after the last counts.";
    DistanceM = "distance_m", "distance", Metres, Neither,
        "Metres driven: as the world reports them, otherwise speed over time, without the gaps of a driving log.";
    SurvivalS = "survival_s", "survived", Seconds, Higher,
        "Time to the first infraction (collision, leaving the road, being stuck, takeover, being put back), or to the end.";
    SurvivalM = "survival_m", "distance survived", Metres, Higher,
        "Distance to the first infraction, or to the end.";
    Stuck = "stuck", "stuck", Count, Lower,
        "Number of times that the car was stuck: under 1 mph for 2 s (SelfOracle) under throttle, or for much longer without.";
    Resets = "resets", "put back", Count, Lower,
        "Number of times that the car was put back on the road.";
    FramesPerS = "frames_per_s", "frame rate", PerSecond, Neither,
        "Telemetries per second.";
    BadFrames = "bad_frames", "bad frames", Count, Lower,
        "Telemetries or pictures by which the pilot could not drive.";
    Kicks = "kicks", "kicks", Count, Lower,
        "Answers that the bridge sent unasked, to start or restart a simulator that was waiting for one.";
    MissedFrames = "missed_frames", "missed frames", Count, Lower,
        "Telemetries that were followed by another before they were answered.";
}

/// No figure of a drive is larger.
const MOST: f64 = 1e15;

/// What is wrong with the first wrong figure of a scorecard that was read from JSON, by key: it is no number, or no possible one.
pub(crate) fn wrong_figure<'a>(get: impl Fn(&str) -> Option<&'a Value>) -> Option<String> {
    Figure::ALL.into_iter().find_map(|figure| {
        let got = get(figure.key()).filter(|value| !value.is_null())?;
        let (least, most) = figure.unit().range();
        let (most, most_words) = if most < MOST { (most, most.to_string()) } else { (MOST, format!("{MOST:e}")) };
        // Rounded sums may be a little beyond.
        let can_be = |x: f64| (least - 1e-9..=most + 1e-9).contains(&x);
        let is_wrong = !got.as_f64().is_some_and(can_be);
        is_wrong
            .then(|| format!("{}: expected a number from {least} to {most_words}, or null, got {got}", figure.key()))
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn keys_are_told_apart_and_stand_in_their_order() {
        let keys: BTreeSet<_> = Figure::ALL.iter().map(|figure| figure.key()).collect();
        assert_eq!(keys.len(), Figure::ALL.len());
        for (i, figure) in Figure::ALL.into_iter().enumerate() {
            assert_eq!(figure as usize, i);
        }
    }

    #[test]
    fn a_figure_that_is_no_number_or_cannot_be_is_named() {
        let wrong = |json: serde_json::Value| wrong_figure(|key| json.get(key));
        let fine = serde_json::json!({"completion": 1.0, "collisions": 0, "steering_r": -0.2, "max_cte_m": null});
        assert_eq!(wrong(fine), None);
        for (json, expected) in [
            (
                serde_json::json!({"collisions": "zero"}),
                "collisions: expected a number from 0 to 1e15, or null, got \"zero\"",
            ),
            (serde_json::json!({"collisions": -5}), "collisions: expected a number from 0 to 1e15, or null, got -5"),
            (serde_json::json!({"completion": 300}), "completion: expected a number from 0 to 1, or null, got 300"),
            (
                serde_json::json!({"distance_m": 1e300}),
                "distance_m: expected a number from 0 to 1e15, or null, got 1e+300",
            ),
        ] {
            assert_eq!(wrong(json).as_deref(), Some(expected));
        }
    }

    #[test]
    fn a_mean_is_shown_to_four_significant_digits_whatever_its_size() {
        for (unit, mean, expected) in [
            (Unit::LockSquared, 0.000_512_34, "0.0005123 lock2"),
            (Unit::Metres, 0.213_449, "0.2134 m"),
            (Unit::Metres, 1_138.42, "1138 m"),
            (Unit::Count, 0.5, "0.5"),
            (Unit::Count, 0.0, "0"),
            (Unit::Share, 1.0, "100 %"),
            (Unit::Share, 0.999_62, "99.96 %"),
            (Unit::Share, 0.999_999, "100 %"),
            (Unit::Correlation, -0.123_456, "-0.1235"),
            (Unit::PerKm, 2.0, "2 /km"),
        ] {
            assert_eq!(unit.show_mean(mean), expected);
        }
    }

    #[test]
    fn a_given_value_is_shown_with_all_its_digits() {
        for (unit, given, expected) in [
            (Unit::Metres, 0.2148, "0.2148 m"),
            (Unit::Metres, 0.2, "0.20 m"),
            (Unit::Share, 0.1053, "10.53 %"),
            (Unit::Share, 0.8, "80.0 %"),
            (Unit::Points, 10.55, "10.55"),
            (Unit::Count, 0.0, "0"),
            (Unit::Seconds, 0.0, "0.0 s"),
            (Unit::Share, 0.799_999_96, "79.999996 %"),
            (Unit::PerKm, 0.125, "0.125 a km"),
        ] {
            assert_eq!(unit.show_given(given), expected);
        }
    }

    #[test]
    fn how_far_off_an_estimate_may_be_is_never_nought_and_reaches_nowhere_it_cannot() {
        for (unit, value, off, expected) in [
            (Unit::Share, 0.123, 0.0004, Some("± 0.04 %")),
            (Unit::Share, 0.99, 0.02, Some("97 to 100 %")),
            (Unit::Count, 2.0, 3.0, Some("0 to 5")),
            (Unit::Count, 2.0, 0.5, Some("1 to 3")),
            (Unit::Metres, 1.0, 2.0, Some("0 to 3 m")),
            (Unit::Share, 1.0, 0.0, None),
        ] {
            assert_eq!(unit.show_off(value, off).as_deref(), expected);
        }
    }

    #[test]
    fn shares_are_shown_in_percent() {
        assert_eq!(Figure::Completion.unit().show(0.125), "12.5 %");
        assert_eq!(Figure::Collisions.unit().show(2.0), "2");
    }
}
