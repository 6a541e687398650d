//! Thresholds that a run must reach: each is a figure and a bound, defined once. The settings, the flags, the checks of
//! a scorecard and the names of JUnit's test cases are derived from this list.

use serde::{Deserialize, Serialize};

/// How much of a limit rounding may cost: as a percentage it is not always the share that it was made of. Messages show 12 digits.
const ROUNDING: f64 = 1e-9;

/// The side of its limit on which a figure must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bound {
    /// The limit, or more.
    AtLeast,
    /// The limit, or less.
    AtMost,
}

impl Bound {
    /// Whether a figure's value is on the right side, as far as rounding lets it be known.
    pub fn holds(self, value: f64, limit: f64) -> bool {
        let margin = ROUNDING * limit.abs();
        match self {
            Self::AtLeast => value >= limit - margin,
            Self::AtMost => value <= limit + margin,
        }
    }

    /// `at least`, `at most`.
    pub fn words(self) -> &'static str {
        match self {
            Self::AtLeast => "at least",
            Self::AtMost => "at most",
        }
    }
}

/// The unit of a threshold's limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimitUnit {
    /// 0 to 100, for a figure that is a share from 0 to 1.
    Percent,
    /// 0 to 100.
    Points,
    /// A whole number from 0.
    Count,
    /// Metres, from 0.
    Metres,
}

impl LimitUnit {
    /// Its placeholder in a usage line.
    pub fn placeholder(self) -> &'static str {
        match self {
            Self::Percent => "PERCENT",
            Self::Points => "POINTS",
            Self::Count => "N",
            Self::Metres => "METRES",
        }
    }

    /// The largest limit that makes sense; the least is 0.
    fn most(self) -> f64 {
        match self {
            Self::Percent | Self::Points => 100.0,
            Self::Count | Self::Metres => f64::MAX,
        }
    }
}

/// The definition of a threshold, whether it is set or not.
#[derive(Debug, Clone, Copy)]
pub struct Threshold {
    /// The key in `[thresholds]`; with dashes, the flag.
    pub key: &'static str,
    /// The key of the figure that it bounds.
    pub figure: &'static str,
    /// The side of the limit on which the figure must be.
    pub bound: Bound,
    /// The limit's unit.
    pub unit: LimitUnit,
    /// Its description, for people.
    pub help: &'static str,
    limit: fn(&Thresholds) -> Option<f64>,
}

impl Threshold {
    /// The flag that sets it, without the leading dashes.
    pub fn flag(&self) -> String {
        self.key.replace('_', "-")
    }

    /// The limit, if set, in the figure's own unit: a share is 0 to 1.
    pub fn limit(&self, thresholds: &Thresholds) -> Option<f64> {
        let limit = (self.limit)(thresholds)?;
        Some(if self.unit == LimitUnit::Percent { limit / 100.0 } else { limit })
    }
}

/// The value of a field, whatever its type.
trait ThresholdNumber: Copy {
    fn number(self) -> f64;
}

impl ThresholdNumber for f64 {
    fn number(self) -> f64 {
        self
    }
}

impl ThresholdNumber for u32 {
    fn number(self) -> f64 {
        self.into()
    }
}

macro_rules! thresholds {
    ($($key:ident: $number:ty, $bound:ident, $figure:literal, $unit:ident, $help:literal;)+) => {
        /// `[thresholds]`: what a run must reach, or the exit status is 3. None is set by default.
        #[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct Thresholds {
            $(
                #[doc = $help]
                #[serde(skip_serializing_if = "Option::is_none")]
                pub $key: Option<$number>,
            )+
        }

        impl Thresholds {
            /// All thresholds, in the order in which they are reported.
            pub const ALL: [Threshold; [$($help),+].len()] = [$(Threshold {
                key: stringify!($key),
                figure: $figure,
                bound: Bound::$bound,
                unit: LimitUnit::$unit,
                help: $help,
                limit: |thresholds| thresholds.$key.map(ThresholdNumber::number),
            }),+];
        }
    };
}

thresholds! {
    min_completion: f64, AtLeast, "completion", Percent, "Threshold: lowest completion, in percent of the laps asked for; exit status 3 if the run misses it";
    min_autonomy: f64, AtLeast, "autonomy", Percent, "Threshold: lowest autonomy, in percent";
    min_driving_score: f64, AtLeast, "driving_score", Points, "Threshold: lowest driving score, 0 to 100";
    max_collisions: u32, AtMost, "collisions", Count, "Threshold: most collisions";
    max_off_road: u32, AtMost, "off_roads", Count, "Threshold: most times off the road";
    max_cte: f64, AtMost, "max_cte_m", Metres, "Threshold: largest distance from the line to drive (|cte|), in metres";
    max_mean_cte: f64, AtMost, "mean_cte_m", Metres, "Threshold: largest mean distance from the line to drive, in metres";
}

impl Thresholds {
    /// Checks the limits; the error says what was expected and what it got.
    pub(super) fn check(&self) -> Result<(), String> {
        for Threshold { key, unit, limit, .. } in Self::ALL {
            let most = unit.most();
            if let Some(limit) = limit(self).filter(|limit| !(0.0..=most).contains(limit)) {
                let expected = if most > 100.0 { "0 or more".into() } else { format!("0 to {most}") };
                return Err(format!("thresholds.{key}: expected {expected}, got {limit}"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_threshold_is_a_setting_whose_name_says_its_side() {
        for threshold in Thresholds::ALL {
            let side = if threshold.key.starts_with("min_") { Bound::AtLeast } else { Bound::AtMost };
            assert_eq!(threshold.bound, side, "{}", threshold.key);
            let set: Thresholds = toml::from_str(&format!("{} = 50", threshold.key)).unwrap();
            let expected = if threshold.unit == LimitUnit::Percent { 0.5 } else { 50.0 };
            assert_eq!(threshold.limit(&set), Some(expected), "{}", threshold.key);
            assert_eq!(Thresholds::ALL.iter().filter(|other| other.limit(&set).is_some()).count(), 1);
        }
    }

    #[test]
    fn a_figure_exactly_at_its_limit_holds_and_one_a_little_beyond_does_not() {
        let completion = 0.089_887_640_449_438_2;
        let limit =
            |percent| Thresholds::ALL[0].limit(&Thresholds { min_completion: percent, ..Thresholds::default() });
        for (value, percent) in
            [(completion, 8.988_764_044_943_82), (1.0 - 6.0 / 1000.0, 99.4), (0.0, 0.0), (1.0, 100.0)]
        {
            let limit = limit(Some(percent)).unwrap();
            assert!(Bound::AtLeast.holds(value, limit) && Bound::AtMost.holds(value, limit), "{percent} %");
            assert!(
                !Bound::AtLeast.holds(value - 1e-8, limit) && !Bound::AtMost.holds(value + 1e-8, limit),
                "{percent} %"
            );
        }
        for bound in [Bound::AtLeast, Bound::AtMost] {
            assert!(!bound.holds(f64::NAN, 1.0));
        }
    }

    #[test]
    fn a_limit_that_no_figure_can_have_is_refused() {
        let wrong = |text: &str| toml::from_str::<Thresholds>(text).unwrap().check().unwrap_err();
        assert_eq!(wrong("min_completion = 101"), "thresholds.min_completion: expected 0 to 100, got 101");
        assert_eq!(wrong("max_cte = nan"), "thresholds.max_cte: expected 0 or more, got NaN");
        assert!(toml::from_str::<Thresholds>("max_collisions = 1.5").is_err());
    }
}
