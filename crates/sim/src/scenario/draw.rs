//! Numbers of a scenario: checked, drawn from a seed, listed as cases.

use std::{fmt, ops::RangeInclusive};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{Scenario, ScenarioError, Script};

/// The largest number of actors: the judge looks at each in every step.
const MOST_ACTORS: usize = 64;
/// The largest number of cases of one scenario.
const MOST_CASES: usize = 10_000;

/// A number in a scenario file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number, [lowest, highest] or { one_of = [numbers] }")]
pub enum Draw {
    /// `3.0`: this number.
    Exactly(f64),
    /// `[2.0, 5.0]`: uniform between these two.
    Between([f64; 2]),
    /// `{ one_of = [12.0, 40.0] }`: one of these, equally likely.
    OneOf {
        /// The choices.
        one_of: Vec<f64>,
    },
}

impl Default for Draw {
    fn default() -> Self {
        Self::Exactly(0.0)
    }
}

impl fmt::Display for Draw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exactly(value) => write!(f, "{value}"),
            Self::Between([low, high]) => write!(f, "[{low}, {high}]"),
            Self::OneOf { one_of } => write!(f, "{{ one_of = {one_of:?} }}"),
        }
    }
}

impl Draw {
    /// The number; before it is settled, the lowest of a range or the first of the choices.
    pub fn value(&self) -> f64 {
        self.numbers().first().copied().unwrap_or(0.0)
    }

    fn numbers(&self) -> &[f64] {
        match self {
            Self::Exactly(value) => std::slice::from_ref(value),
            Self::Between(ends) => ends,
            Self::OneOf { one_of } => one_of,
        }
    }

    fn fits(&self, range: &RangeInclusive<f64>) -> bool {
        let ordered = !matches!(self, Self::Between([low, high]) if low > high);
        ordered && !self.numbers().is_empty() && self.numbers().iter().all(|number| range.contains(number))
    }

    fn drawn(&self, rng: &mut ChaCha8Rng) -> f64 {
        match self {
            Self::Exactly(value) => *value,
            Self::Between([low, high]) => low + (high - low) * rng.random::<f64>(),
            Self::OneOf { one_of } => {
                let i = (rng.random::<f64>() * one_of.len() as f64) as usize;
                one_of.get(i).copied().unwrap_or_default()
            }
        }
    }
}

/// The place of a number, its valid range, and the number.
type Visit<'a> = &'a mut dyn FnMut(&str, RangeInclusive<f64>, &mut Draw);

const SPEED_KMH: RangeInclusive<f64> = 0.0..=130.0;
const MOVING_KMH: RangeInclusive<f64> = 0.5..=130.0;
const OFFSET_M: RangeInclusive<f64> = -50.0..=50.0;
const AHEAD_M: RangeInclusive<f64> = -500.0..=1000.0;
const TIME_S: RangeInclusive<f64> = 0.0..=3600.0;

impl Scenario {
    /// Visits every number in the file's order: the one place that knows them all.
    fn visit(&mut self, visit: Visit<'_>) {
        let ego = &mut self.ego;
        // No track is longer; `Traffic::new` checks the track itself.
        optional(visit, "ego: s_m", 0.0..=1e5, &mut ego.s_m);
        optional(visit, "ego: offset_m", OFFSET_M, &mut ego.offset_m);
        visit("ego: speed_kmh", SPEED_KMH, &mut ego.speed_kmh);
        optional(visit, "ego: target_kmh", SPEED_KMH, &mut ego.target_kmh);
        for (i, script) in self.actors.iter_mut().enumerate() {
            script.visit(&mut |what, range, draw| visit(&format!("actor {i}: {what}"), range, draw));
        }
    }

    /// Checks a scenario that was built rather than parsed: every number is finite and in range, every crosser has a
    /// time and goes somewhere, and there are not too many actors or cases.
    ///
    /// # Errors
    /// [`ScenarioError::Value`] for the first violation.
    pub fn check(&self) -> Result<(), ScenarioError> {
        let wrong = |what: &str, expected: &str, got: String| {
            Err(ScenarioError::Value { name: self.name.clone(), what: what.into(), expected: expected.into(), got })
        };
        if self.name.is_empty() || !self.name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c)) {
            return wrong("name", "letters, digits and any of -_.", format!("{:?}", self.name));
        }
        if !(0.1..=3600.0).contains(&self.duration_s) {
            return wrong("duration_s", "0.1 to 3600", self.duration_s.to_string());
        }
        if self.actors.len() > MOST_ACTORS {
            return wrong("actor", &format!("at most {MOST_ACTORS}"), self.actors.len().to_string());
        }
        let mut first = None;
        let mut choices = 1_usize;
        self.clone().visit(&mut |what, range, draw| {
            choices = choices.saturating_mul(if let Draw::OneOf { one_of } = draw { one_of.len() } else { 1 });
            if !draw.fits(&range) && first.is_none() {
                first = Some((what.to_owned(), format!("{} to {}", range.start(), range.end()), draw.to_string()));
            }
        });
        if let Some((what, expected, got)) = first {
            return wrong(&what, &expected, got);
        }
        if choices > MOST_CASES {
            return wrong("one_of", &format!("at most {MOST_CASES} cases"), choices.to_string());
        }
        for (i, script) in self.actors.iter().enumerate() {
            let Script::Cross { from_m, to_m, at_s, share, .. } = script else { continue };
            if at_s.is_some() == share.is_some() {
                let got = if at_s.is_some() { "both" } else { "neither" };
                return wrong(&format!("actor {i}: at_s, share"), "either at_s or share", got.into());
            }
            let (from, to) = (from_m.numbers(), to_m.numbers());
            let apart = |a: &[f64], b: &[f64]| a.iter().all(|a| b.iter().all(|b| a < b));
            if !apart(from, to) && !apart(to, from) {
                let what = format!("actor {i}: to_m");
                return wrong(&what, &format!("the other side of from_m = {from_m}"), to_m.to_string());
            }
        }
        Ok(())
    }

    /// The same scenario with every number drawn: the same seeds give the same numbers. A settled scenario does not
    /// change.
    pub fn settle(&self, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(seed);
        let mut settled = self.clone();
        settled.visit(&mut |_, _, draw| *draw = Draw::Exactly(draw.drawn(&mut rng)));
        settled
    }

    /// All combinations of the `one_of` choices, the last one changing fastest. Ranges stay ranges.
    /// For a scenario that passes [`Scenario::check`].
    pub fn cases(&self) -> Vec<Self> {
        let mut counts = vec![];
        self.clone().visit(&mut |_, _, draw| {
            if let Draw::OneOf { one_of } = draw {
                counts.push(one_of.len());
            }
        });
        (0..counts.iter().product())
            .map(|case| {
                let mut settled = self.clone();
                let (mut place, mut below) = (0, counts.iter().product::<usize>());
                settled.visit(&mut |_, _, draw| {
                    if let Draw::OneOf { one_of } = draw {
                        below /= counts[place];
                        *draw = Draw::Exactly(one_of[case / below % counts[place]]);
                        place += 1;
                    }
                });
                settled
            })
            .collect()
    }
}

fn optional(visit: Visit<'_>, what: &str, range: RangeInclusive<f64>, draw: &mut Option<Draw>) {
    if let Some(draw) = draw {
        visit(what, range, draw);
    }
}

impl Script {
    fn visit(&mut self, visit: Visit<'_>) {
        match self {
            Self::Parked { kind: _, ahead_m, offset_m, yaw_deg } => {
                visit("ahead_m", AHEAD_M, ahead_m);
                visit("offset_m", OFFSET_M, offset_m);
                visit("yaw_deg", -360.0..=360.0, yaw_deg);
            }
            Self::Lead { kind: _, gap_m, offset_m, speed_kmh, onset_s, deceleration, build_up_s, final_kmh } => {
                visit("gap_m", 0.5..=500.0, gap_m);
                visit("offset_m", OFFSET_M, offset_m);
                optional(visit, "speed_kmh", SPEED_KMH, speed_kmh);
                visit("onset_s", TIME_S, onset_s);
                visit("deceleration", 0.1..=12.0, deceleration);
                visit("build_up_s", 0.0..=10.0, build_up_s);
                visit("final_kmh", SPEED_KMH, final_kmh);
            }
            Self::TurnOff { kind: _, gap_m, onset_s, deceleration, final_kmh, angle_deg, to_m } => {
                visit("gap_m", 0.5..=500.0, gap_m);
                visit("onset_s", TIME_S, onset_s);
                visit("deceleration", 0.1..=12.0, deceleration);
                visit("final_kmh", MOVING_KMH, final_kmh);
                visit("angle_deg", 1.0..=90.0, angle_deg);
                visit("to_m", OFFSET_M, to_m);
            }
            Self::Cruise { kind: _, ahead_m, offset_m, speed_kmh, oncoming: _ } => {
                visit("ahead_m", AHEAD_M, ahead_m);
                visit("offset_m", OFFSET_M, offset_m);
                visit("speed_kmh", SPEED_KMH, speed_kmh);
            }
            Self::Cross { kind: _, ahead_m, from_m, to_m, speed_kmh, run_up_m, at_s, share } => {
                visit("ahead_m", AHEAD_M, ahead_m);
                visit("from_m", OFFSET_M, from_m);
                visit("to_m", OFFSET_M, to_m);
                visit("speed_kmh", MOVING_KMH, speed_kmh);
                visit("run_up_m", 0.0..=10.0, run_up_m);
                optional(visit, "at_s", TIME_S, at_s);
                optional(visit, "share", -5.0..=6.0, share);
            }
        }
    }
}
