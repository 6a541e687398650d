//! Which drives a suite is made of.

use std::{fmt, path::PathBuf, str::FromStr};

use serde::{Deserialize, Serialize};

use lapwing_core::{hash::sha256, words::suggesting};

/// Cells of a suite at most: a hundred a minute take most of a day.
const MOST_CELLS: usize = 100_000;

/// What the file of a suite says.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// As `--track`.
    pub tracks: Vec<String>,
    /// As `--conditions`; `fair` is none. Default: `fair` alone.
    #[serde(default = "fair")]
    pub conditions: Vec<String>,
    /// Set speeds in mph. Default: 20.
    #[serde(default = "twenty")]
    pub speeds_mph: Vec<f64>,
    /// Seeds. Default: 0 alone.
    #[serde(default)]
    pub seeds: Seeds,
    /// Laps of a drive. Default: 1.
    #[serde(default = "one")]
    pub laps: u32,
    /// Longest time of a drive in simulated seconds. Default: 600.
    #[serde(default = "ten_minutes")]
    pub longest_s: f64,
    /// Who drives.
    #[serde(rename = "pilot")]
    pub pilots: Vec<Contestant>,
}

fn fair() -> Vec<String> {
    vec!["fair".into()]
}

fn twenty() -> Vec<f64> {
    vec![20.0]
}

fn one() -> u32 {
    1
}

fn ten_minutes() -> f64 {
    600.0
}

/// Seeds of a suite.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged, expecting = "expected a number of seeds, or a list of seeds from 0")]
pub enum Seeds {
    /// This many, from 0.
    Count(u64),
    /// These.
    List(Vec<u64>),
}

impl Default for Seeds {
    fn default() -> Self {
        Self::Count(1)
    }
}

/// A pilot in a suite.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contestant {
    /// Its name in the results.
    pub name: String,
    /// Its model; the built-in one if absent.
    #[serde(default)]
    pub model: Option<PathBuf>,
    /// Whether the expert, who knows the road, drives instead of a model.
    #[serde(default)]
    pub expert: bool,
}

/// A suite that cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum SuiteError {
    /// Not the TOML of a suite.
    #[error("suite: {}", suggesting(&.0.to_string()))]
    Toml(#[from] toml::de::Error),
    /// More than a suite may have.
    #[error("suite: {what}: expected at most {MOST_CELLS}, got {got}")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many.
        got: String,
    },
    /// A value that is not valid.
    #[error("suite: {what}: expected {expected}, got {got}")]
    Value {
        /// Which one.
        what: String,
        /// What it should be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
}

/// One drive, with all that it depends on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Who drives.
    pub pilot: String,
    /// SHA-256 of its model; none for the expert.
    pub model_sha256: Option<String>,
    /// The track.
    pub track: String,
    /// The conditions.
    pub conditions: String,
    /// The set speed in mph.
    pub speed_mph: f64,
    /// The seed.
    pub seed: u64,
    /// Laps asked for.
    pub laps: u32,
    /// Longest time in seconds.
    pub longest_s: f64,
    /// The settings in force, and the version of the program.
    pub settings: serde_json::Value,
    /// What the names of track and conditions stand for with this seed.
    pub world: serde_json::Value,
}

impl Cell {
    /// A name that no other drive has: 16 hexadecimal digits of the SHA-256 of all that it depends on.
    pub fn id(&self) -> String {
        // Keys are in the order of the fields, so the same cell has the same text.
        let text = serde_json::to_string(self).unwrap_or_default();
        sha256(text)[..16].to_owned()
    }
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { pilot, track, conditions, speed_mph, seed, .. } = self;
        write!(f, "{pilot} on {track}, {conditions}, {speed_mph} mph, seed {seed}")
    }
}

impl Suite {
    /// Reads the TOML of a suite.
    ///
    /// # Errors
    /// [`SuiteError`], with what was expected and what came.
    pub fn parse(text: &str) -> Result<Self, SuiteError> {
        let mut suite: Self = toml::from_str(text)?;
        suite.conditions.iter_mut().for_each(|name| *name = name.trim().to_owned());
        let wrong = |what: &str, expected, got: String| SuiteError::Value { what: what.into(), expected, got };
        let seeds = match &suite.seeds {
            Seeds::Count(count) => usize::try_from(*count).unwrap_or(usize::MAX),
            Seeds::List(list) => list.len(),
        };
        let counts = [
            ("tracks", suite.tracks.len()),
            ("conditions", suite.conditions.len()),
            ("speeds_mph", suite.speeds_mph.len()),
            ("pilot", suite.pilots.len()),
            ("seeds", seeds),
        ];
        let mut cells = 1usize;
        for (what, count) in counts {
            match count {
                0 => return Err(wrong(what, "at least one", "none".into())),
                1..=MOST_CELLS => cells = cells.saturating_mul(count),
                _ => return Err(SuiteError::TooMany { what, got: count.to_string() }),
            }
        }
        if cells > MOST_CELLS {
            let product = counts.map(|(what, count)| format!("{count} ({what})")).join(" x ");
            return Err(SuiteError::TooMany { what: "cells", got: format!("{cells}: {product}") });
        }
        if let Some(speed) = suite.speeds_mph.iter().find(|speed| !(0.1..=1000.0).contains(*speed)) {
            return Err(wrong("speeds_mph", "speeds from 0.1 to 1000", speed.to_string()));
        }
        if suite.conditions.iter().any(String::is_empty) {
            return Err(wrong("conditions", "names or conditions, such as fair", "an empty text".into()));
        }
        if suite.laps == 0 {
            return Err(wrong("laps", "at least 1", "0".into()));
        }
        if !(1.0..=1e6).contains(&suite.longest_s) {
            return Err(wrong("longest_s", "1 to 1000000 seconds", suite.longest_s.to_string()));
        }
        for (i, pilot) in suite.pilots.iter().enumerate() {
            if pilot.name.is_empty() || pilot.name.trim() != pilot.name || pilot.name.contains(char::is_control) {
                let expected = "a name on one line, without spaces around it";
                return Err(wrong("pilot", expected, format!("{:?}", pilot.name)));
            }
            if suite.pilots[..i].iter().any(|other| other.name == pilot.name) {
                return Err(wrong("pilot", "distinct names", format!("{:?} twice", pilot.name)));
            }
            if pilot.expert && pilot.model.is_some() {
                return Err(wrong("pilot", "a model or the expert", format!("both for {:?}", pilot.name)));
            }
        }
        Ok(suite)
    }

    /// The seeds, each once.
    pub fn seeds(&self) -> Vec<u64> {
        match &self.seeds {
            Seeds::Count(count) => (0..*count).collect(),
            Seeds::List(list) => {
                let mut seeds = list.clone();
                seeds.sort_unstable();
                seeds.dedup();
                seeds
            }
        }
    }

    /// All drives; the seed changes slowest, so the first of them already cover every kind. `model_sha256` returns that
    /// of a pilot.
    ///
    /// The caller fills in settings and world.
    pub fn cells(&self, model_sha256: impl Fn(&Contestant) -> Option<String>) -> Vec<Cell> {
        let hashes: Vec<_> = self.pilots.iter().map(model_sha256).collect();
        let mut cells = vec![];
        for seed in self.seeds() {
            for track in &self.tracks {
                for conditions in &self.conditions {
                    for &speed_mph in &self.speeds_mph {
                        for (pilot, sha256) in self.pilots.iter().zip(&hashes) {
                            cells.push(Cell {
                                pilot: pilot.name.clone(),
                                model_sha256: sha256.clone(),
                                track: track.clone(),
                                conditions: conditions.clone(),
                                speed_mph,
                                seed,
                                laps: self.laps,
                                longest_s: self.longest_s,
                                settings: serde_json::Value::Null,
                                world: serde_json::Value::Null,
                            });
                        }
                    }
                }
            }
        }
        cells
    }
}

/// One part out of several: `2/8`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Which, from 1.
    pub part: usize,
    /// Of how many.
    pub of: usize,
}

impl Shard {
    /// Whether a cell is in it, by its place among all.
    pub fn has(self, index: usize) -> bool {
        index % self.of == self.part - 1
    }
}

/// A text that does not name a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected a part and how many there are, such as 2/8")]
pub struct ShardError;

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        let parts = text.split_once('/').and_then(|(part, of)| Some((part.parse().ok()?, of.parse().ok()?)));
        match parts {
            Some((part, of)) if (1..=of).contains(&part) => Ok(Self { part, of }),
            _ => Err(ShardError),
        }
    }
}
