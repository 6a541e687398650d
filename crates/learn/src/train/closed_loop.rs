//! Training in closed loop: the network drives, what it saw is labelled by the expert and learnt from, round after round.
//!
//! DAgger (Ross, Gordon and Bagnell, AISTATS 2011), with noise on the expert's steering as large as the network's own
//! errors (DART, Laskey et al., CoRL 2017). Here stands what a round is; who drives is the caller's.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Recipe, Schedule, TrainError};
use crate::dataset::Selection;
use lapwing_sim::record::LANE_NAME;

/// What follows the training that a recipe describes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClosedLoop {
    /// How many times the network drives and then learns; default 3.
    pub rounds: usize,
    /// Passes over the data in each round; default 2.
    pub epochs: usize,
    /// Samples in a pass; default as before.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples_per_epoch: Option<usize>,
    /// Step width at the beginning of a round, from which it falls to zero by half a cosine; default 3e-4.
    pub learning_rate: f64,
    /// Share of the time in which the expert drives in the first round; half as much in each later one. Default 0.5.
    pub expert: f64,
    /// How often a row of these drives is drawn relative to a row of weight 1; default 1.
    pub weight: f64,
    /// Whether pictures of these drives may be mirrored, as those of a data set; default true.
    pub flip: bool,
    /// Drives along simulated roads.
    pub drive: Vec<PracticeDrive>,
    /// Drives along located recordings.
    pub along: Vec<PracticeAlong>,
}

impl Default for ClosedLoop {
    fn default() -> Self {
        Self {
            rounds: 3,
            epochs: 2,
            samples_per_epoch: None,
            learning_rate: 3e-4,
            expert: 0.5,
            weight: 1.0,
            flip: true,
            drive: vec![],
            along: vec![],
        }
    }
}

/// A drive in each round along a simulated road, from a place that the round and the seed decide.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PracticeDrive {
    /// Track, as for `--track`.
    pub track: String,
    /// How long; default 60 simulated seconds.
    #[serde(default = "a_minute")]
    pub seconds: f64,
    /// mph; default 20.
    #[serde(default = "twenty")]
    pub speed: f64,
    /// Seed; default 0.
    #[serde(default)]
    pub seed: u64,
    /// As for `--conditions`, latency included; default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<String>,
}

fn a_minute() -> f64 {
    60.0
}

fn twenty() -> f64 {
    20.0
}

/// A drive in each round along a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PracticeAlong {
    /// The recording.
    pub path: PathBuf,
    /// Where in its lane the recorded car was, as `lapwing locate --csv` writes it.
    pub lane: PathBuf,
    /// Its road, if that is one's own: its file, as for `--track`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub track: Option<String>,
    /// First row and the one after the last, counted from 0; default all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<(usize, usize)>,
    /// How far from the lane's middle the car may be before it is put back, in metres; default 1.5.
    #[serde(default = "one_and_a_half")]
    pub limit_m: f64,
}

fn one_and_a_half() -> f64 {
    1.5
}

/// A drive of the network, from which it learns.
#[derive(Debug, Clone, PartialEq)]
pub struct Lesson {
    /// Its folder, in which its table of places is.
    pub path: PathBuf,
    /// Its road, if that is one's own.
    pub track: Option<String>,
}

impl ClosedLoop {
    /// The same; if it names no drives, with those that a recipe gives: over the roads, at the speeds and in the
    /// conditions of its own recordings, or, if it makes none, along its data sets that have a lane.
    pub fn with_drives_of(mut self, recipe: &Recipe) -> Self {
        if !self.drive.is_empty() || !self.along.is_empty() {
            return self;
        }
        let drive = |data: &super::SimulatedData| PracticeDrive {
            track: data.track.clone(),
            seconds: a_minute(),
            speed: data.speed,
            seed: data.seed,
            conditions: data.conditions.clone(),
        };
        self.drive = recipe.record.iter().map(drive).collect();
        if self.drive.is_empty() {
            let along = |Selection { path, lane, track, rows, .. }: &Selection| {
                let (path, lane, track, limit_m) = (path.clone(), lane.clone()?, track.clone(), one_and_a_half());
                Some(PracticeAlong { path, lane, track, rows: *rows, limit_m })
            };
            self.along = recipe.data.iter().filter_map(along).collect();
        }
        self
    }

    /// Checks what can be checked without data.
    ///
    /// # Errors
    /// [`TrainError::Setting`].
    pub fn check(&self) -> Result<(), TrainError> {
        let wrong = |name, expected, got: String| Err(TrainError::Setting { name, expected, got });
        if self.rounds > 1000 {
            return wrong("closed_loop.rounds", "0 to 1000", self.rounds.to_string());
        }
        if !(1..=100_000).contains(&self.epochs) {
            return wrong("closed_loop.epochs", "1 to 100000", self.epochs.to_string());
        }
        if !(self.learning_rate > 0.0 && self.learning_rate <= 100.0) {
            let got = self.learning_rate.to_string();
            return wrong("closed_loop.learning_rate", "a number above 0, at most 100", got);
        }
        // With the expert alone there is nothing to find out about the network.
        if !(0.0..1.0).contains(&self.expert) {
            return wrong("closed_loop.expert", "0 to below 1", self.expert.to_string());
        }
        if self.rounds > 0 && self.drive.is_empty() && self.along.is_empty() {
            let got = "none; give --lane with --data, or a recipe with [[closed_loop.drive]], [[closed_loop.along]] or \
                       [[record]]";
            return wrong("closed_loop", "at least one drive or recording to drive along", got.into());
        }
        for drive in &self.drive {
            if !(drive.seconds > 0.0 && drive.seconds <= 36_000.0) {
                let got = drive.seconds.to_string();
                return wrong("closed_loop.drive.seconds", "a number above 0, at most 36000", got);
            }
            if !(drive.speed > 0.0 && drive.speed <= 200.0) {
                let got = drive.speed.to_string();
                return wrong("closed_loop.drive.speed", "a number of mph above 0, at most 200", got);
            }
        }
        if let Some(along) = self.along.iter().find(|along| !(along.limit_m > 0.0 && along.limit_m <= 10.0)) {
            return wrong("closed_loop.along.limit_m", "a number above 0, at most 10", along.limit_m.to_string());
        }
        for PracticeAlong { path, rows, .. } in &self.along {
            if let Some((first, end)) = rows.filter(|(first, end)| first >= end) {
                let got = format!("{first}, {end} for {}", path.display());
                return wrong("closed_loop.along.rows", "two row numbers, the second one larger", got);
            }
        }
        Ok(())
    }

    /// The share of the time in which the expert drives in this round, counted from 1.
    pub fn expert_share(&self, round: usize) -> f64 {
        self.expert * 0.5f64.powi(i32::try_from(round).unwrap_or(i32::MAX).saturating_sub(1))
    }
}

impl Recipe {
    /// The training of one round: from these weights, on all data so far, with the lessons of this round and of those before.
    pub fn of_round(&self, closed_loop: &ClosedLoop, weights: &Path, lessons: &[Lesson]) -> Self {
        let mut recipe = Self {
            pretrained: Some(weights.to_owned()),
            epochs: closed_loop.epochs,
            samples_per_epoch: closed_loop.samples_per_epoch.or(self.samples_per_epoch),
            record: vec![],
            closed_loop: None,
            ..self.clone()
        };
        recipe.optimiser.learning_rate = closed_loop.learning_rate;
        recipe.optimiser.schedule = Schedule::Cosine;
        recipe.data.extend(lessons.iter().map(|Lesson { path, track }| Selection {
            weight: closed_loop.weight,
            flip: closed_loop.flip,
            lane: Some(path.join(LANE_NAME)),
            track: track.clone(),
            ..Selection::of(path)
        }));
        recipe
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "[[data]]\npath = \"x\"\n[closed_loop]\nrounds = 4\n[[closed_loop.drive]]\ntrack = \"lake\"\n\
                        conditions = \"latency_ms=100\"\n[[closed_loop.along]]\npath = \"y\"\nlane = \"y.csv\"\n";

    #[test]
    fn a_round_goes_on_from_the_weights_with_what_was_seen_so_far() {
        let recipe = Recipe::parse(TEXT).unwrap();
        recipe.check().unwrap();
        assert_eq!(Recipe::parse(&toml::to_string(&recipe).unwrap()).unwrap(), recipe);
        let closed_loop = recipe.closed_loop.clone().unwrap();
        assert_eq!((closed_loop.expert_share(1), closed_loop.expert_share(3)), (0.5, 0.125));
        let round = recipe.of_round(&closed_loop, Path::new("w"), &[Lesson { path: "d".into(), track: None }]);
        round.check().unwrap();
        assert_eq!((round.data.len(), round.epochs, round.pretrained.as_deref()), (2, 2, Some(Path::new("w"))));
        assert_eq!(round.data[1].lane.as_deref(), Some(Path::new("d/lane.csv")));
        assert_eq!((round.closed_loop, round.optimiser.learning_rate), (None, 3e-4));
    }

    #[test]
    fn without_drives_of_its_own_it_drives_on_the_recorded_roads_or_else_along_data_whose_lane_is_known() {
        let data = "[[data]]\npath = \"x\"\n[[data]]\npath = \"y\"\nlane = \"y.csv\"\nrows = [0, 90]\n";
        let filled = |text: &str| ClosedLoop::default().with_drives_of(&Recipe::parse(text).unwrap());
        let along = PracticeAlong {
            path: "y".into(),
            lane: "y.csv".into(),
            track: None,
            rows: Some((0, 90)),
            limit_m: one_and_a_half(),
        };
        let along = ClosedLoop { along: vec![along], ..ClosedLoop::default() };
        along.check().unwrap();
        assert_eq!(filled(data), along);
        let roads = filled(&(data.to_owned() + "[[record]]\nout = \"z\"\ntrack = \"lake\"\n"));
        assert_eq!((roads.drive.len(), roads.drive[0].track.as_str(), roads.along.len()), (1, "lake", 0));
        let named = Recipe::parse(TEXT).unwrap().closed_loop.unwrap();
        assert_eq!(named.clone().with_drives_of(&Recipe::parse(data).unwrap()), named);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let error = |text: &str| Recipe::parse(text).unwrap().check().unwrap_err().to_string();
        let none = error("[[data]]\npath = \"x\"\n[closed_loop]\nrounds = 1\n");
        assert_eq!(
            none,
            "closed_loop: expected at least one drive or recording to drive along, got none; \
             give --lane with --data, or a recipe with [[closed_loop.drive]], [[closed_loop.along]] or [[record]]"
        );
        let expert = error(&TEXT.replace("rounds = 4", "expert = 1.0"));
        assert_eq!(expert, "closed_loop.expert: expected 0 to below 1, got 1");
        assert!(error(&(TEXT.to_owned() + "limit_m = 0.0\n")).starts_with("closed_loop.along.limit_m: expected"));
        assert!(error(&(TEXT.to_owned() + "rows = [9, 9]\n")).starts_with("closed_loop.along.rows: expected"));
    }
}
