//! Recordings as lists of rows with a label.

use std::{
    collections::{BTreeMap, HashSet},
    fmt,
    hash::{DefaultHasher, Hasher},
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use bytes::Bytes;
use rayon::prelude::*;

use super::{CameraPosition, DatasetError, places::CarPlace};
use lapwing_core::{
    perception::check_jpeg,
    recording::{Picture, Recording},
    units::{Mph, Steering},
};
use lapwing_sim::along::Beside;

/// The bytes of a picture.
///
/// # Errors
/// [`DatasetError::Picture`] if it cannot be read.
pub fn read(picture: &Picture) -> Result<Bytes, DatasetError> {
    picture.read().map_err(|why| DatasetError::Picture { picture: picture.to_string(), why: why.to_string() })
}

/// One moment of a drive, with its label.
#[derive(Debug, Clone)]
pub struct Labelled {
    /// Which moment of the recording it is, counted from 0.
    pub moment: usize,
    /// Time since the first row.
    pub at: Duration,
    /// Pictures in the order of [`CameraPosition::ALL`](super::CameraPosition::ALL).
    pub pictures: [Option<Picture>; 3],
    /// A hash of the bytes of the centre picture, once it has been checked.
    pub(super) center_hash: u64,
    /// What was steered: [`Moment::steering`](lapwing_core::recording::Moment::steering).
    pub steering: Steering,
    /// -1 (full brake) to 1 (full throttle).
    pub acceleration: f64,
    /// How fast the car was.
    pub speed: Mph,
    /// Number of the drive that it belongs to: between two drives the recording is broken
    /// ([`Moment::broken`](lapwing_core::recording::Moment::broken)), or moments without a picture or a label are left
    /// out.
    pub drive: u32,
    /// Number of the stretch within the drive: no sequence of pictures crosses its end. It ends where a camera's
    /// pictures begin or end, and, for rows of the training set, where rows outside it begin.
    pub stretch: u32,
}

/// A data set: the rows of a Udacity folder or of a run.
#[derive(Debug, Clone)]
pub struct Source {
    /// What it was read from.
    pub path: PathBuf,
    /// Its rows in order of time; at least one.
    pub rows: Vec<Labelled>,
    /// Whether its pictures may be mirrored ([`Selection::flip`](super::Selection::flip)).
    pub flip: bool,
    /// Its road, if that is one's own ([`Selection::track`](super::Selection::track)).
    pub(super) track: Option<String>,
    /// Where the car was in each row, as far as that is known; empty until labels from the lane or
    /// [`Samples::place`](super::Samples::place) tell.
    pub(super) places: Vec<Option<CarPlace>>,
}

/// What pictures are, judging by their files.
#[derive(Debug, Default)]
pub(super) struct PictureCheck {
    /// How many are not there.
    pub missing: usize,
    /// How many are no whole JPEG, and one of them with the reason.
    pub broken: usize,
    pub example: Option<(String, String)>,
    /// How many have each size, columns and rows, and one of them.
    pub sizes: BTreeMap<(usize, usize), (usize, String)>,
}

impl PictureCheck {
    /// And that of this picture, which is removed if it cannot be used; its hash otherwise.
    fn with(mut self, picture: &mut Option<Picture>, is_used: bool) -> (Self, u64) {
        let Some(found) = picture else { return (self, 0) };
        match found.read().map(|bytes| (check_jpeg(&bytes), hash(&bytes))) {
            Ok((Ok(size), hash)) => {
                if is_used {
                    self.sizes.entry(size).or_insert_with(|| (0, found.to_string())).0 += 1;
                }
                return (self, hash);
            }
            Err(why) if why.kind() == io::ErrorKind::NotFound => self.missing += 1,
            Ok((Err(why), _)) => self.break_at(found, &why),
            Err(why) => self.break_at(found, &why),
        }
        *picture = None;
        (self, 0)
    }

    fn break_at(&mut self, picture: &Picture, why: &dyn fmt::Display) {
        self.broken += 1;
        self.example.get_or_insert_with(|| (picture.to_string(), why.to_string()));
    }

    pub(super) fn and(mut self, other: Self) -> Self {
        self.missing += other.missing;
        self.broken += other.broken;
        self.example = self.example.or(other.example);
        for (size, (count, picture)) in other.sizes {
            self.sizes.entry(size).or_insert((0, picture)).0 += count;
        }
        self
    }
}

/// The same for the same bytes within a run of the program.
fn hash(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(bytes);
    hasher.finish()
}

/// How many of these paths are there already.
pub(super) fn repeated<'a>(pictures: impl Iterator<Item = &'a Path>) -> usize {
    let mut seen = HashSet::new();
    pictures.filter(|picture| !seen.insert(*picture)).count()
}

/// Checks that there is a data set, as far as possible without reading all of it.
///
/// # Errors
/// [`DatasetError::Recording`].
pub fn check(path: &Path) -> Result<(), DatasetError> {
    Recording::open(path)?;
    Ok(())
}

impl Source {
    /// Reads a folder with `driving_log.csv`, such a file, or a run (`.mcap`). Pictures of folders stay where they
    /// are; those of a run are kept in memory as JPEG.
    ///
    /// # Errors
    /// [`DatasetError::Recording`], [`DatasetError::Empty`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, DatasetError> {
        let path = path.as_ref();
        let rows = labelled(path)?;
        if rows.is_empty() {
            return Err(DatasetError::Empty { path: path.to_owned() });
        }
        let mut source = Self { path: path.to_owned(), rows, flip: true, track: None, places: vec![] };
        source.end_stretches_where(|_, row| row.pictures.each_ref().map(Option::is_some));
        Ok(source)
    }

    /// Removes the pictures that are missing, and those that are no whole JPEG; they are not decoded. Sizes are counted of
    /// those that are `used`, by row and camera.
    pub(super) fn forget_unusable(&mut self, used: impl Fn(usize, usize) -> bool + Sync) -> PictureCheck {
        let check = |checked: PictureCheck, (i, row): (usize, &mut Labelled)| {
            let Labelled { pictures, center_hash, .. } = row;
            pictures.iter_mut().enumerate().fold(checked, |checked, (camera, picture)| {
                let (checked, hash) = checked.with(picture, used(i, camera));
                if camera == CameraPosition::Center as usize {
                    *center_hash = hash;
                }
                checked
            })
        };
        let found = self.rows.par_iter_mut().enumerate().fold(PictureCheck::default, check);
        let found = found.reduce(PictureCheck::default, PictureCheck::and);
        self.end_stretches_where(|_, row| row.pictures.each_ref().map(Option::is_some));
        found
    }

    /// Gives its rows other labels; those without one are in no drive with those that have one.
    pub(super) fn relabel(&mut self, mut label: impl FnMut(&Labelled) -> Option<Steering>) {
        let mut drives = 0;
        let mut before = None;
        for row in &mut self.rows {
            let steering = label(row);
            let now = (row.drive, steering.is_some());
            drives += u32::from(before.is_some_and(|before| before != now));
            before = Some(now);
            row.drive = drives;
            row.steering = steering.unwrap_or(row.steering);
        }
    }

    /// Also ends each stretch where neighbours differ in this.
    pub(super) fn end_stretches_where<T: PartialEq>(&mut self, of: impl Fn(usize, &Labelled) -> T) {
        let mut stretch = 0;
        let mut before: Option<(T, u32, u32)> = None;
        for (i, row) in self.rows.iter_mut().enumerate() {
            let now = (of(i, row), row.drive, row.stretch);
            stretch += u32::from(before.is_some_and(|before| before != now));
            row.stretch = stretch;
            before = Some(now);
        }
    }

    pub(super) fn one_stretch(&self, i: usize, k: usize) -> bool {
        let (a, b) = (&self.rows[i], &self.rows[k]);
        (a.drive, a.stretch) == (b.drive, b.stretch)
    }

    /// Indices of `count` rows up to and including row `i`, oldest first; the first row of a stretch stands for those
    /// before it.
    pub fn sequence(&self, i: usize, count: usize) -> impl Iterator<Item = usize> + '_ {
        let first = (0..i).rev().take_while(|k| self.one_stretch(i, *k)).take(count.saturating_sub(1)).last();
        let first = first.unwrap_or(i);
        (0..count).rev().map(move |back| i.saturating_sub(back).max(first))
    }

    /// Which row of row `i`'s stretch was recorded nearest to this many seconds before it, and where the car of row `i` is beside
    /// that row's; `None` if that is row `i` itself, or where the car was is not known.
    pub(super) fn earlier(&self, i: usize, by_s: f64) -> Option<(usize, Beside)> {
        let ago_s = |k: usize| self.rows[i].at.as_secs_f64() - self.rows[k].at.as_secs_f64();
        let off_s = |k: &usize| (ago_s(*k) - by_s).abs();
        let rows = (0..=i).rev().take_while(|k| self.one_stretch(i, *k) && ago_s(*k) <= 2.0 * by_s);
        let then = rows.min_by(|a, b| off_s(a).total_cmp(&off_s(b))).filter(|k| *k != i)?;
        let place = |k: usize| self.places.get(k).copied().flatten();
        Some((then, Beside::between(place(i)?, place(then)?)))
    }

    /// Mean steering of the `width` rows around row `i` that belong to its drive; `width` is odd.
    pub fn mean_steering(&self, i: usize, width: usize) -> f64 {
        self.mean(i, width, |k| self.rows[k].drive == self.rows[i].drive)
    }

    /// The same over the rows of its stretch only, which contains nothing that is held out.
    pub(super) fn mean_of_stretch(&self, i: usize, width: usize) -> f64 {
        self.mean(i, width, |k| self.one_stretch(i, k))
    }

    fn mean(&self, i: usize, width: usize, counts: impl Fn(usize) -> bool) -> f64 {
        let reach = width / 2;
        // Stop at another drive: rows beyond it are not neighbours.
        let before = (i.saturating_sub(reach)..i).rev().take_while(|k| counts(*k));
        let after = (i..self.rows.len()).take(reach + 1).take_while(|k| counts(*k));
        let all = before.chain(after).map(|k| self.rows[k].steering.get());
        let (sum, count) = all.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0));
        sum / count
    }
}

fn labelled(path: &Path) -> Result<Vec<Labelled>, DatasetError> {
    let mut rows: Vec<Labelled> = Vec::new();
    let (mut drive, mut goes_on) = (0, true);
    for (i, moment) in Recording::open(path)?.enumerate() {
        let moment = moment?;
        goes_on &= moment.broken.is_none();
        let Some(command) = moment.decided().filter(|_| moment.is_seen()) else {
            goes_on = false;
            continue;
        };
        if !rows.is_empty() && !goes_on {
            drive += 1;
        }
        goes_on = true;
        rows.push(Labelled {
            moment: i,
            at: moment.at,
            steering: command.steering,
            acceleration: command.throttle.get(),
            speed: moment.telemetry.speed,
            drive,
            stretch: 0,
            center_hash: 0,
            pictures: moment.pictures,
        });
    }
    Ok(rows)
}
