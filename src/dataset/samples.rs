//! Which rows and cameras count, with which label, and how much.

use std::path::PathBuf;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{Blocks, Camera, DatasetError, Source};
use crate::units::Mph;

/// What is taken of one data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Selection {
    /// A folder with `driving_log.csv` and `IMG`, or a run (`.mcap`).
    pub path: PathBuf,
    /// How often a row of it is drawn beside a row of weight 1; default 1.
    #[serde(default = "one")]
    pub weight: f64,
    /// Steering added for the left camera and taken off for the right, default 0.25: 6.25 degrees, as Lu has it.
    #[serde(default = "side_offset")]
    pub side_offset: f64,
    /// Cameras to learn from; default all that there are.
    #[serde(default = "all_cameras")]
    pub cameras: Vec<Camera>,
    /// First row and the one after the last, counted from 0; default all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<(usize, usize)>,
    /// The label is the mean steering of so many rows around its own, default 1: a keyboard steers in strokes.
    #[serde(default = "one_row")]
    pub smooth: usize,
}

fn one() -> f64 {
    1.0
}

fn side_offset() -> f64 {
    0.25
}

fn all_cameras() -> Vec<Camera> {
    Camera::ALL.to_vec()
}

fn one_row() -> usize {
    1
}

impl Selection {
    /// All of a data set, with the defaults.
    pub fn of(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            weight: one(),
            side_offset: side_offset(),
            cameras: all_cameras(),
            rows: None,
            smooth: one_row(),
        }
    }

    fn check(&self) -> Result<(), DatasetError> {
        let wrong = |name, expected, got: String| Err(DatasetError::Setting { name, expected, got });
        if !(self.weight.is_finite() && self.weight > 0.0) {
            return wrong("weight", "a number above 0", self.weight.to_string());
        }
        if !(0.0..=1.0).contains(&self.side_offset) {
            return wrong("side_offset", "0 to 1", self.side_offset.to_string());
        }
        if self.cameras.is_empty() {
            return wrong("cameras", "at least one of center, left, right", "none".into());
        }
        if self.smooth.is_multiple_of(2) {
            return wrong("smooth", "an odd number of rows", self.smooth.to_string());
        }
        Ok(())
    }
}

/// What is done against the many rows in which nobody steers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Balance {
    /// Share of the rows with a steering of (nearly) zero that is kept; default 1.
    pub keep_zero: f64,
    /// How far the histogram of steering is flattened: 0, the default, not at all; 1, each of 25 bins counts alike.
    pub flatten: f64,
    /// A row at full lock is drawn so many times more often than one straight on, those between in proportion; default 0.
    pub large_angles: f64,
}

impl Default for Balance {
    fn default() -> Self {
        Self { keep_zero: 1.0, flatten: 0.0, large_angles: 0.0 }
    }
}

/// Steering below this counts as none.
const ZERO: f64 = 0.01;
/// Bins of the histogram that is flattened, from -1 to 1.
const BINS: usize = 25;

impl Balance {
    fn check(&self) -> Result<(), DatasetError> {
        let wrong = |name, expected, got: f64| Err(DatasetError::Setting { name, expected, got: got.to_string() });
        if !(0.0..=1.0).contains(&self.keep_zero) {
            return wrong("keep_zero", "0 to 1", self.keep_zero);
        }
        if !(0.0..=1.0).contains(&self.flatten) {
            return wrong("flatten", "0 to 1", self.flatten);
        }
        if !(0.0..=1000.0).contains(&self.large_angles) {
            return wrong("large_angles", "0 to 1000", self.large_angles);
        }
        Ok(())
    }

    /// How often each row is drawn, by its steering.
    fn weights(&self, steering: &[f64]) -> Vec<f64> {
        let bin = |x: f64| (((x.clamp(-1.0, 1.0) + 1.0) / 2.0 * BINS as f64) as usize).min(BINS - 1);
        let mut counts = [0usize; BINS];
        steering.iter().for_each(|x| counts[bin(*x)] += 1);
        let largest = counts.iter().max().copied().unwrap_or(1).max(1) as f64;
        let weight = |x: &f64| {
            let kept = if x.abs() < ZERO { self.keep_zero } else { 1.0 };
            let rare = (counts[bin(*x)] as f64 / largest).powf(-self.flatten);
            kept * rare * (1.0 + self.large_angles * x.abs())
        };
        steering.iter().map(weight).collect()
    }
}

/// One thing to learn: a picture, or the last of a sequence, and what to steer there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Which source.
    pub source: u32,
    /// Which of its rows.
    pub row: u32,
    /// Which of its cameras.
    pub camera: Camera,
    /// What to steer, positive to the right; beyond -1 and 1 where a side camera's offset leads there.
    pub steering: f64,
    /// -1 (full brake) to 1 (full throttle).
    pub acceleration: f64,
    /// How fast the car was.
    pub speed: Mph,
    /// How often it is drawn, beside others.
    weight: f64,
}

/// Which part of the data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Set {
    /// To learn from: all cameras asked for, blocks that are not held out.
    Training,
    /// To measure by: the centre camera in the blocks held out, labels as recorded.
    Validation,
    /// The centre camera everywhere, labels as recorded.
    All,
}

/// What is learnt from, or measured by.
#[derive(Debug)]
pub struct Samples {
    /// The data sets.
    pub sources: Vec<Source>,
    /// What is taken of them; at least one.
    pub samples: Vec<Sample>,
}

impl Samples {
    /// Opens the data sets and picks the set's rows of each.
    ///
    /// # Errors
    /// [`DatasetError`].
    pub fn open(
        selections: &[Selection],
        set: Set,
        blocks: Option<Blocks>,
        balance: &Balance,
    ) -> Result<Self, DatasetError> {
        balance.check()?;
        let mut all = Self { sources: vec![], samples: vec![] };
        for selection in selections {
            selection.check()?;
            let source = Source::open(&selection.path)?;
            all.take(source, selection, set, blocks, balance);
        }
        if all.samples.is_empty() {
            let path = selections.first().map(|s| s.path.clone()).unwrap_or_default();
            return Err(DatasetError::Empty { path });
        }
        Ok(all)
    }

    fn take(&mut self, source: Source, selection: &Selection, set: Set, blocks: Option<Blocks>, balance: &Balance) {
        let (first, last) = selection.rows.unwrap_or((0, usize::MAX));
        let held_out = |row: usize| blocks.is_some_and(|blocks| blocks.is_validation(row));
        let wanted = |row: &usize| match set {
            Set::Training => !held_out(*row),
            Set::Validation => held_out(*row),
            Set::All => true,
        };
        let learning = set == Set::Training;
        let rows: Vec<usize> = (first..last.min(source.rows.len())).filter(wanted).collect();
        let smooth = if learning { selection.smooth } else { 1 };
        let steering: Vec<f64> = rows.iter().map(|row| source.mean_steering(*row, smooth)).collect();
        let weights = if learning { balance.weights(&steering) } else { vec![1.0; rows.len()] };
        let cameras = if learning { &selection.cameras[..] } else { &[Camera::Center] };
        for ((row, steering), weight) in rows.into_iter().zip(steering).zip(weights) {
            let moment = &source.rows[row];
            for camera in cameras.iter().filter(|c| moment.pictures[**c as usize].is_some()) {
                self.samples.push(Sample {
                    source: self.sources.len() as u32,
                    row: row as u32,
                    camera: *camera,
                    steering: steering + camera.sign() * selection.side_offset,
                    acceleration: moment.acceleration,
                    speed: moment.speed,
                    weight: weight * selection.weight,
                });
            }
        }
        self.sources.push(source);
    }

    /// The label averaged over `width` recorded rows, for measuring.
    pub fn mean_steering(&self, sample: &Sample, width: usize) -> f64 {
        self.sources[sample.source as usize].mean_steering(sample.row as usize, width)
    }

    /// `count` samples in random order, each as often as its weight says, within one: where all weigh alike and
    /// `count` is how many there are, each once. The seed and the epoch alone decide.
    pub fn draw(&self, count: usize, seed: u64, epoch: u64) -> Vec<u32> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(epoch + 1);
        let mut order: Vec<u32> = (0..self.samples.len() as u32).collect();
        shuffle(&mut order, &mut random);
        // Systematic sampling: a comb of equal steps over the cumulated weights, from a random start.
        let total: f64 = self.samples.iter().map(|sample| sample.weight).sum();
        let step = total / count as f64;
        let mut next = unit(&mut random) * step;
        let (mut drawn, mut cumulated) = (Vec::with_capacity(count), 0.0);
        for i in order {
            cumulated += self.samples[i as usize].weight;
            while next < cumulated && drawn.len() < count {
                drawn.push(i);
                next += step;
            }
        }
        shuffle(&mut drawn, &mut random);
        drawn
    }
}

/// From 0 to below 1.
pub(super) fn unit(random: &mut ChaCha8Rng) -> f64 {
    (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

fn shuffle(items: &mut [u32], random: &mut ChaCha8Rng) {
    for i in (1..items.len()).rev() {
        items.swap(i, (unit(random) * (i + 1) as f64) as usize);
    }
}
