//! Selects rows and cameras, with their labels and weights.

use std::{
    collections::{BTreeSet, HashSet},
    fs,
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{
    Balance, Blocks, CameraPosition, DatasetError, Source,
    lane::LaneLabels,
    places,
    source::{Labelled, PictureCheck},
};
use lapwing_core::{hash::sha256, recording::udacity::LOG_NAME, units::Mph, words::count};

/// What to use of one data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Selection {
    /// A folder with `driving_log.csv` and `IMG`, or a run (`.mcap`).
    pub path: PathBuf,
    /// How often a row of it is drawn relative to a row of weight 1; default 1.
    #[serde(default = "one")]
    pub weight: f64,
    /// Steering added for the left camera and taken off for the right, default 0.25: 6.25 degrees, as Lu has it.
    #[serde(default = "side_offset")]
    pub side_offset: f64,
    /// Cameras to train on; default all.
    #[serde(default = "all_cameras")]
    pub cameras: Vec<CameraPosition>,
    /// First row and the one after the last, counted from 0; default all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<(usize, usize)>,
    /// The label is the mean steering of this many rows around its own, default 1: a keyboard steers in strokes. Rows
    /// outside the training set do not count, so that nothing that is held out leaks into a label.
    #[serde(default = "one_row")]
    pub smooth: usize,
    /// Whether its pictures may be mirrored, as the augmentation has it; default true. Not where cars keep to one side of the
    /// road: a network would learn to keep to the other one as well.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub flip: bool,
    /// Where in its lane the car was, as `lapwing locate --csv` writes it. The label of each picture, those of the side
    /// cameras included, is then what the simulator's expert steers from there back to the lane's middle, at the row's
    /// speed; `side_offset` does not count. Rows whose place is not known are left out. Default: labels as recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lane: Option<PathBuf>,
    /// The road of that table, or of the one that `record` writes beside the log, if it is a road of one's own: its file, as for
    /// `--track`. Other roads are known by their names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub track: Option<String>,
}

/// More than a minute of driving is unrelated to a picture.
const MOST_SMOOTH: usize = 999;

fn one() -> f64 {
    1.0
}

fn yes() -> bool {
    true
}

fn is_yes(flip: &bool) -> bool {
    *flip
}

fn side_offset() -> f64 {
    0.25
}

fn all_cameras() -> Vec<CameraPosition> {
    CameraPosition::ALL.to_vec()
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
            flip: yes(),
            lane: None,
            track: None,
        }
    }

    /// The identity of the data set, however its path is written; a copy elsewhere is a different one.
    pub fn place(&self) -> PathBuf {
        let folder = if self.path.ends_with(LOG_NAME) { self.path.parent() } else { None };
        let path = folder.unwrap_or(&self.path);
        fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
    }

    /// Checks what can be checked without the data.
    pub(crate) fn check(&self) -> Result<(), DatasetError> {
        let wrong =
            |name, expected, got: String| Err(DatasetError::Selected { path: self.path.clone(), name, expected, got });
        if !(1e-6..=1e6).contains(&self.weight) {
            return wrong("weight", "0.000001 to 1000000", self.weight.to_string());
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
        if self.smooth > 1 && self.lane.is_some() {
            return wrong("smooth", "1 with labels from the lane", self.smooth.to_string());
        }
        if self.smooth > MOST_SMOOTH {
            return wrong("smooth", "at most 999 rows", self.smooth.to_string());
        }
        if let Some((first, end)) = self.rows.filter(|(first, end)| first >= end) {
            return wrong("rows", "two row numbers, the second one larger", format!("{first}, {end}"));
        }
        Ok(())
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
    pub camera: CameraPosition,
    /// What to steer, positive to the right; beyond -1 and 1 where a side camera's offset leads there.
    pub steering: f64,
    /// -1 (full brake) to 1 (full throttle).
    pub acceleration: f64,
    /// How fast the car was.
    pub speed: Mph,
    /// Where in its lane the camera was, if the data set has labels from the lane.
    pub in_lane: Option<CameraInLane>,
    /// How often it is drawn, beside others.
    weight: f64,
}

/// Something that is known of a picture and learnt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Label {
    /// What to steer, normalised.
    Steering,
    /// Throttle, or brake below 0.
    Acceleration,
    /// Metres that the camera is to the right of the lane's middle.
    OffsetM,
    /// Degrees that it is turned clockwise from the lane's direction.
    HeadingDeg,
}

/// Where in its lane a camera was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraInLane {
    /// Metres to the right of the lane's middle.
    pub offset_m: f64,
    /// Degrees clockwise from the lane's direction.
    pub heading_deg: f64,
}

impl Sample {
    /// What is to be learnt of it; not a number where that is not known.
    pub fn label(&self, label: Label) -> f64 {
        match label {
            Label::Steering => self.steering,
            Label::Acceleration => self.acceleration,
            Label::OffsetM => self.in_lane.map_or(f64::NAN, |at| at.offset_m),
            Label::HeadingDeg => self.in_lane.map_or(f64::NAN, |at| at.heading_deg),
        }
    }
}

/// A hash of each sample's source, row, camera, labels, speed and weight, in order; of no pictures. Resume states hold it, so another
/// layout would refuse them all.
pub(crate) fn samples_hash(sets: [&[Sample]; 2]) -> String {
    let bytes = |sample: &Sample| {
        let Sample { source, row, camera, steering, acceleration, speed, in_lane, weight } = *sample;
        let CameraInLane { offset_m, heading_deg } =
            in_lane.unwrap_or(CameraInLane { offset_m: f64::NAN, heading_deg: f64::NAN });
        let whole = [u64::from(source), u64::from(row), camera as u64].map(u64::to_le_bytes);
        let numbers = [steering, acceleration, speed.get(), offset_m, heading_deg, weight].map(f64::to_le_bytes);
        [whole.as_flattened(), numbers.as_flattened()].concat()
    };
    sha256(sets.into_iter().flatten().flat_map(bytes).collect::<Vec<u8>>())
}

/// Which part of the data.
///
/// Rows that are held out never enter the training: neither labels ([`Selection::smooth`]) nor sequences of pictures of
/// [`Set::Training`] reach beyond the end of a block or of [`Selection::rows`]. The reverse is allowed: sequences of
/// [`Set::Validation`] begin with the drive's pictures before the block, as a pilot would have seen them, and its means
/// over nine rows include the labels there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Set {
    /// To learn from: all selected cameras, blocks that are not held out.
    Training,
    /// To measure by: the centre camera in the blocks held out, labels as recorded.
    Validation,
    /// The centre camera everywhere, labels as recorded.
    All,
}

impl Set {
    /// What its rows are for.
    fn aim(self) -> &'static str {
        match self {
            Self::Training => "to learn from",
            Self::Validation | Self::All => "to measure by",
        }
    }
}

/// Removes the pictures that cannot be used, and logs how many, once for each data set: training and validation rows are
/// usually of the same.
fn usable(source: &mut Source, selection: &Selection, set: Set) -> PictureCheck {
    static TOLD: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    let (first, end) = selection.rows.unwrap_or((0, usize::MAX));
    let cameras = if set == Set::Training { &selection.cameras[..] } else { &[CameraPosition::Center] };
    let used =
        |row: usize, camera: usize| (first..end).contains(&row) && cameras.iter().any(|of| *of as usize == camera);
    let found = source.forget_unusable(used);
    if !TOLD.lock().unwrap_or_else(PoisonError::into_inner).insert(source.path.clone()) {
        return found;
    }
    let path = source.path.display();
    let are = |number: usize, what: &str| format!("{} {what}", count(number, "picture"));
    if found.missing > 0 {
        let are = are(found.missing, if found.missing == 1 { "is" } else { "are" });
        tracing::warn!("{path}: {are} missing and left out; see `lapwing dataset inspect`");
    }
    if let Some((picture, why)) = &found.example {
        let are = are(found.broken, if found.broken == 1 { "is" } else { "are" });
        tracing::warn!("{path}: {are} broken and left out, such as {picture}: {why}; see `lapwing dataset inspect`");
    }
    found
}

/// Samples to learn from, or to measure by.
#[derive(Debug)]
pub struct Samples {
    /// The data sets.
    pub sources: Vec<Source>,
    /// The samples taken from them; at least one.
    pub samples: Vec<Sample>,
}

impl Samples {
    /// Opens the data sets and picks the set's rows from each. Pictures that are missing, or no whole JPEG, are left out
    /// with a warning; sequences start again after them.
    ///
    /// # Errors
    /// [`DatasetError`]; [`DatasetError::NoneLeft`] also where one of several data sets has nothing to train on.
    pub fn open(
        selections: &[Selection],
        set: Set,
        blocks: Option<Blocks>,
        balance: &Balance,
    ) -> Result<Self, DatasetError> {
        balance.check()?;
        blocks.map_or(Ok(()), |blocks| blocks.check(["blocks.size", "blocks.every"]))?;
        selections.iter().try_for_each(Selection::check)?;
        let mut all = Self { sources: vec![], samples: vec![] };
        let mut sizes = PictureCheck::default();
        // For each sample, the steering of its row.
        let mut steered = vec![];
        for selection in selections {
            let (flip, track) = (selection.flip, selection.track.clone());
            let mut source = Source { flip, track, ..Source::open(&selection.path)? };
            let lane = selection.lane.as_deref().map(|path| LaneLabels::open(path, &mut source)).transpose()?;
            let rows = source.rows.len();
            let before = all.samples.len();
            if let Some(lane) = lane.as_ref().filter(|_| set == Set::Training) {
                lane.tell(&source, selection.rows.unwrap_or((0, usize::MAX)));
            }
            sizes = sizes.and(usable(&mut source, selection, set));
            all.take(source, selection, lane.as_ref(), set, blocks, &mut steered);
            if set == Set::Training && all.samples.len() == before {
                return Err(DatasetError::NoneLeft { path: selection.path.clone(), rows, aim: set.aim(), blocks });
            }
        }
        if all.samples.is_empty() {
            let path = selections.first().map(|s| s.path.clone()).unwrap_or_default();
            let rows = all.sources.iter().map(|source| source.rows.len()).sum();
            return Err(DatasetError::NoneLeft { path, rows, aim: set.aim(), blocks });
        }
        if sizes.sizes.len() > 1 {
            let told = |((width, height), (pictures, example)): (&(usize, usize), &(usize, String))| {
                format!("{} of {width}x{height} such as {example}", count(*pictures, "picture"))
            };
            let got = sizes.sizes.iter().map(told).collect::<Vec<_>>().join(", ");
            return Err(DatasetError::Sizes { got });
        }
        if set == Set::Training {
            let drawn: Vec<_> = steered.into_iter().zip(&all.samples).map(|(x, sample)| (x, sample.weight)).collect();
            for (sample, weight) in all.samples.iter_mut().zip(balance.weights(&drawn)?) {
                sample.weight = weight;
            }
        }
        Ok(all)
    }

    fn take(
        &mut self,
        mut source: Source,
        selection: &Selection,
        lane: Option<&LaneLabels>,
        set: Set,
        blocks: Option<Blocks>,
        steered: &mut Vec<f64>,
    ) {
        let sides = [CameraPosition::Left, CameraPosition::Right];
        let wants_sides = set == Set::Training && sides.iter().any(|side| selection.cameras.contains(side));
        if wants_sides && !source.rows.iter().any(|row| sides.iter().any(|side| row.pictures[*side as usize].is_some()))
        {
            let path = source.path.display();
            tracing::info!(
                "{path}: no side cameras, so nothing is learnt from beside the path, and side_offset has no effect"
            );
        }
        let (first, end) = selection.rows.unwrap_or((0, usize::MAX));
        let held_out = |row: usize| blocks.is_some_and(|blocks| blocks.is_validation(row));
        let wanted = |row: usize| {
            (first..end).contains(&row)
                && lane.is_none_or(|lane| lane.knows(row))
                && match set {
                    Set::Training => !held_out(row),
                    Set::Validation => held_out(row),
                    Set::All => true,
                }
        };
        let learning = set == Set::Training;
        if learning {
            source.end_stretches_where(|i, _| wanted(i));
        }
        let smooth = if learning { selection.smooth } else { 1 };
        let cameras = if learning { &selection.cameras[..] } else { &[CameraPosition::Center] };
        for row in (0..source.rows.len()).filter(|row| wanted(*row)) {
            let moment = &source.rows[row];
            let steering = source.mean_of_stretch(row, smooth);
            for camera in cameras.iter().filter(|c| moment.pictures[**c as usize].is_some()) {
                steered.push(steering);
                let beside = || steering + camera.sign() * selection.side_offset;
                self.samples.push(Sample {
                    source: self.sources.len() as u32,
                    row: row as u32,
                    camera: *camera,
                    steering: lane.and_then(|lane| lane.steering(row, *camera)).unwrap_or_else(beside),
                    acceleration: moment.acceleration,
                    speed: moment.speed,
                    in_lane: lane.and_then(|lane| lane.in_lane(row, *camera)),
                    weight: selection.weight,
                });
            }
        }
        self.sources.push(source);
    }

    /// Finds out where the car was in each row, for pictures of other moments ([`Augmentation::late`](super::Augmentation)).
    ///
    /// # Errors
    /// [`DatasetError::Lane`] if the table beside a log is not its own, [`DatasetError::Setting`] if a data set's first picture is
    /// not the stock camera's 320x160, [`DatasetError::Picture`] and [`DatasetError::Image`] if it cannot be read.
    pub fn place(&mut self) -> Result<(), DatasetError> {
        self.sources.iter_mut().try_for_each(places::place)
    }

    /// How many samples have a centre picture that is, byte for byte, also one of `others`, and one of these pictures.
    pub fn shared_with(&self, others: &Self) -> Option<(usize, String)> {
        fn rows(of: &Samples) -> impl Iterator<Item = &Labelled> {
            of.samples.iter().map(|sample| &of.sources[sample.source as usize].rows[sample.row as usize])
        }
        let known: HashSet<u64> = rows(others).map(|row| row.center_hash).collect();
        let mut shared = rows(self).filter(|row| known.contains(&row.center_hash)).peekable();
        let picture = shared.peek()?.pictures[CameraPosition::Center as usize].as_ref()?.to_string();
        Some((shared.count(), picture))
    }

    /// Keeps this many at equal distances, or all if there are no more.
    pub fn thin_out(&mut self, count: usize) {
        let all = self.samples.len();
        if count < all {
            self.samples = (0..count).map(|i| self.samples[i * all / count]).collect();
        }
    }

    /// The label averaged over `width` recorded rows, for measuring.
    pub fn mean_steering(&self, sample: &Sample, width: usize) -> f64 {
        self.sources[sample.source as usize].mean_steering(sample.row as usize, width)
    }

    /// `count` samples in random order, each as often as its weight says, to within one: with equal weights and `count`
    /// equal to their number, each once. The result depends only on the seed and the epoch.
    pub fn draw(&self, count: usize, seed: u64, epoch: u64) -> Vec<u32> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(epoch + 1);
        let mut order: Vec<u32> = (0..self.samples.len() as u32).collect();
        shuffle(&mut order, &mut random);
        // Systematic sampling: equal steps over the cumulative weights, from a random start.
        let total: f64 = self.samples.iter().map(|sample| sample.weight).sum();
        let step = total / count as f64;
        let mut next = random.random::<f64>() * step;
        let (mut drawn, mut cumulated) = (Vec::with_capacity(count), 0.0);
        for i in order {
            cumulated += self.samples[i as usize].weight;
            while next < cumulated && drawn.len() < count {
                drawn.push(i);
                next += step;
            }
        }
        // Rounding may put the last step beyond the end.
        if let Some(last) = drawn.last().copied() {
            drawn.resize(count, last);
        }
        shuffle(&mut drawn, &mut random);
        drawn
    }
}

fn shuffle(items: &mut [u32], random: &mut ChaCha8Rng) {
    for i in (1..items.len()).rev() {
        items.swap(i, (random.random::<f64>() * (i + 1) as f64) as usize);
    }
}

#[cfg(test)]
mod tests;
