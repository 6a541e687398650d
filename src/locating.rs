//! Where a recording was driven: on which road, which way round, and where each of its pictures was taken.
//!
//! ```text
//! speed, steering ─▶ motions ─▶ Matcher, on every road and both ways round ─▶ road, places every 20 m
//!                       │                                                         │
//! pictures ─────────────┴─▶ Overlay::follow, stretch by stretch ◀── surest place ─┘
//!                                     └─▶ LocatedDrive
//! ```
//! A recording is read twice, first its numbers, then its pictures. Drives that are joined in one recording are parts of
//! their own. Each part is followed in stretches of bounded length, so that a drive that is lost is found again, several
//! processors share the work, and memory stays bounded.

pub mod drawn;
mod pictures;
mod rows;
mod summary;
mod table;

use std::{
    collections::HashMap,
    ops::Range,
    path::Path,
    sync::{Arc, Mutex},
};

use rayon::prelude::*;

use self::{
    pictures::{Job, Pictures, SIZE, decoded},
    rows::rows,
};
pub use self::{
    rows::{Row, RowTruth},
    summary::{AgainstTruth, Errors, PartSummary, Placed, Sides, Spread, Summary},
};
use crate::known::Roads;
use lapwing_core::{
    motion::{Motion, around},
    perception::Frame,
    recording::{Break, RecordingError},
};
use lapwing_score::odometry::{Look, Match, Matcher, Milestone, Road};
use lapwing_sim::{
    camera::Scenery,
    locate::{Known, Located, LocatedDrive, Overlay, Pose, seen},
    track::{Track, TrackError},
};

/// The seed of the particles: the same recording is always located alike.
const SEED: u64 = 0;
/// A road counts as found if it explains the drive better than every other by this much, as a log likelihood: 150 to 1.
const SURE: f64 = 5.0;
/// Roads that explain a drive worse than the best by less than this are looked at, if the best is not sure; so many rows of
/// each.
const LIKELY: f64 = 15.0;
const SAMPLE: usize = 80;
/// Rows of a stretch, and how many more on either side are looked at to locate its ends as surely as its middle.
const STRETCH: usize = 500;
const BESIDE: usize = 40;
/// How far the mean of the speeds before and after a gap may be from the mean speed in it, in m/s.
const UNSEEN_MPS: f64 = 2.5;
/// A longer gap, in seconds, says nothing about where the car went on.
const FORGOTTEN_S: f64 = 20.0;
/// Places that the bends tell are this sure at best, in metres, and as they err alike, less sure than each by itself.
const NEAR_M: f64 = 5.0;
const ALIKE: f64 = 2.0;
/// How wrong the distance driven may be, as a share.
const ASTRAY: f64 = 0.1;
/// Places told from before and behind are compared within so many metres driven, and contradict one another if they are this
/// many standard deviations apart.
const ALONGSIDE_M: f64 = 40.0;
const CONTRADICTS: f64 = 3.0;
/// How far a car that is put back may be from where it was, as a standard deviation in metres.
const PUT_BACK_M: f64 = 20.0;

/// A recording that cannot be located.
#[derive(Debug, thiserror::Error)]
pub enum LocateError {
    /// The run or the driving log.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A road that is asked for.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// None of its moments has a picture.
    #[error("{}: expected a recording with pictures, got {moments} moments without one", path.display())]
    NoPictures {
        /// The recording.
        path: std::path::PathBuf,
        /// How many moments it has.
        moments: usize,
    },
}

/// Which of a moment's three pictures is located.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Which {
    /// The centre camera's.
    Center = 0,
    /// The left one's.
    Left = 1,
    /// The right one's.
    Right = 2,
}

/// A drive of a recording: all of it, unless several were joined.
#[derive(Debug)]
pub struct Part {
    /// Which moments with a picture it has, counted over the recording.
    pub rows: Range<usize>,
    /// Metres driven, by speed and time.
    pub way_m: f64,
    /// Where it was; `None` if no known road explains it, or several do.
    pub on: Option<On>,
}

/// A drive on a road.
#[derive(Debug)]
pub struct On {
    /// The road's name.
    pub road: String,
    /// Whether it was driven against the track's direction.
    pub reversed: bool,
    /// Where the car was in each of the part's rows.
    pub drive: LocatedDrive,
}

/// What was found.
#[derive(Debug)]
pub struct Whereabouts {
    /// The drives, in the recording's order.
    pub parts: Vec<Part>,
    /// The moments with a picture.
    pub rows: Vec<Row>,
    /// Pictures that could not be looked at, and why not, of the first one.
    pub unreadable: (usize, Option<String>),
}

impl Whereabouts {
    /// All drives on the track that most of the pictures show; where another one was driven, no place is known.
    pub fn drive(&self) -> Option<LocatedDrive> {
        let known = |track: &Track| {
            let on = self.parts.iter().filter_map(|part| part.on.as_ref());
            let here = on.filter(|on| on.drive.track.file().name == track.file().name);
            here.map(|on| on.drive.places.iter().flatten().count()).sum::<usize>()
        };
        let tracks = self.parts.iter().filter_map(|part| Some(&part.on.as_ref()?.drive.track));
        let track = tracks.filter(|track| known(track) > 0).max_by_key(|track| known(track))?.clone();
        let places = self.parts.iter().flat_map(|part| {
            let on = part.on.as_ref().filter(|on| on.drive.track.file().name == track.file().name);
            part.rows.clone().map(move |i| on.and_then(|on| on.drive.places[i - part.rows.start]))
        });
        Some(LocatedDrive { places: places.collect(), track })
    }
}

/// Locates the pictures of one of the cameras. `looked_at` is called for each picture that was.
///
/// # Errors
/// [`LocateError`]: what cannot be read. A single picture that cannot is counted.
pub fn locate(
    path: &Path,
    which: Which,
    roads: &Roads,
    looked_at: impl Fn() + Sync,
) -> Result<Whereabouts, LocateError> {
    let (rows, moments) = rows(path)?;
    if rows.is_empty() {
        return Err(LocateError::NoPictures { path: path.to_owned(), moments });
    }
    let parts_found = parts_of(&rows);
    let starts = parts_found.iter().map(|part| part.start).collect();
    let looks = pictures::looks(path, &starts)?;
    let mut stretches = vec![];
    let mut parts = vec![];
    let mut scenes = Scenes { roads, tracks: HashMap::new() };
    for part in parts_found {
        let way_m = rows[part.clone()].iter().skip(1).map(|row| row.motion.way_m).sum();
        let look = looks.get(&part.start);
        let likely = found(&rows[part.clone()], look, roads)?;
        let found = shown(path, &rows, &part, likely, &mut scenes)?;
        if let Some(found) = &found {
            let scene = scenes.of(&found.road.name)?;
            for run in continuous(&rows, part.clone()) {
                let cut = cut(&run, &part, &rows, found, &scene.0);
                stretches.extend(cut.into_iter().map(|stretch| (stretch, scene.clone())));
            }
        }
        parts.push((part, way_m, found));
    }
    let unreadable = Mutex::new((0, None));
    let pictures = Pictures::open(path, which, stretches)?;
    let located: Vec<(Range<usize>, Vec<Option<Located>>)> = pictures
        .par_bridge()
        .map(|job| {
            let job = job?;
            let tell = |why: String| {
                let mut unreadable = unreadable.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                unreadable.0 += 1;
                unreadable.1.get_or_insert(why);
            };
            Ok(follow(&rows, job, tell, &looked_at))
        })
        .collect::<Result<_, RecordingError>>()?;
    let mut places: Vec<Option<Located>> = vec![None; rows.len()];
    for (of, located) in located {
        places[of].iter_mut().zip(located).for_each(|(place, located)| *place = located);
    }
    let parts = parts
        .into_iter()
        .map(|(part, way_m, found)| {
            let on = found
                .map(|found| {
                    let track = scenes.of(&found.road.name)?.0;
                    let drive = LocatedDrive { track, places: places[part.clone()].to_vec() };
                    Ok::<_, TrackError>(On { road: found.road.name.clone(), reversed: found.road.reversed, drive })
                })
                .transpose()?;
            Ok(Part { rows: part, way_m, on })
        })
        .collect::<Result<_, TrackError>>()?;
    let unreadable = unreadable.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    Ok(Whereabouts { parts, rows, unreadable })
}

/// Tracks, and what stands beside them, made on first use.
struct Scenes<'a> {
    roads: &'a Roads,
    tracks: HashMap<String, (Arc<Track>, Arc<Scenery>)>,
}

impl Scenes<'_> {
    fn of(&mut self, road: &str) -> Result<(Arc<Track>, Arc<Scenery>), TrackError> {
        if let Some(scene) = self.tracks.get(road) {
            return Ok(scene.clone());
        }
        let track = match self.roads.track(road) {
            Some(track) => track,
            None => Track::open(road)?,
        };
        let scenery = Arc::new(Scenery::new(&track));
        let scene = (Arc::new(track), scenery);
        self.tracks.insert(road.to_owned(), scene.clone());
        Ok(scene)
    }
}

/// The drives of a recording: where one is joined to another, nothing that is known of one says anything of the other.
fn parts_of(rows: &[Row]) -> Vec<Range<usize>> {
    let joined = |row: &Row| match row.broken {
        Some(Break::Joined | Break::Back(_)) => true,
        Some(Break::Gap(apart)) => apart.as_secs_f64() > FORGOTTEN_S,
        _ => false,
    };
    split(rows, 0..rows.len(), joined)
}

/// The runs of rows within a part in which each continues from the one before.
fn continuous(rows: &[Row], part: Range<usize>) -> Vec<Range<usize>> {
    split(rows, part, |row| row.broken.is_some())
}

fn split(rows: &[Row], within: Range<usize>, begins: impl Fn(&Row) -> bool) -> Vec<Range<usize>> {
    let first = within.start;
    let starts = within.clone().filter(|&i| i == first || begins(&rows[i])).collect::<Vec<_>>();
    let ends = starts.iter().skip(1).copied().chain([within.end]);
    starts.iter().zip(ends).map(|(&start, end)| start..end).collect()
}

/// The road that a drive was on.
struct Found {
    road: Arc<Road>,
    /// How well its bends explain the drive, as a log likelihood.
    evidence: f64,
    /// Where the car was on the way, by the bends before and behind.
    stones: Vec<Milestone>,
}

/// The roads that a drive may have been on, by its bends or by what its start looks like; the likeliest first.
fn found(rows: &[Row], first: Option<&Look>, roads: &Roads) -> Result<Vec<Found>, TrackError> {
    let agrees = |road: &&Arc<Road>| road.start.as_ref().zip(first).map_or(0.0, |(start, look)| start.agrees(look));
    let known = roads.both_ways()?;
    let start = known.iter().max_by(|a, b| agrees(a).total_cmp(&agrees(b))).filter(|road| agrees(road) >= Look::SAME);
    let matcher =
        start.map_or_else(|| Matcher::new(known.iter().cloned(), SEED), |road| Matcher::at_start(road.clone(), SEED));
    let matches = followed(matcher, rows.iter().skip(1).map(|row| (row, false)));
    let most = matches.first().map_or(0.0, |best| best.evidence);
    let likely = matches.into_iter().filter(|on| on.explains && on.evidence > most - LIKELY);
    Ok(likely.map(|on| both_ways(on, rows)).collect())
}

/// The bends behind a place tell it as well as those before it: the same drive, from its end to its beginning.
fn both_ways(on: Match, rows: &[Row]) -> Found {
    let (length_m, way_m) = (on.road.length_m, rows.iter().skip(1).map(|row| row.motion.way_m).sum::<f64>());
    let back = Matcher::new([Arc::new(on.road.reversed())], SEED);
    let back = followed(back, rows.windows(2).rev().map(|pair| (&pair[1], true))).into_iter().next();
    let turned = |stone: &Milestone| Milestone { way_m: way_m - stone.way_m, s_m: length_m - stone.s_m, ..*stone };
    let behind =
        back.filter(|back| back.explains).map_or_else(Vec::new, |back| back.trail.iter().map(turned).collect());
    let stones = surest(&on.trail, &behind, length_m);
    Found { road: on.road, evidence: on.evidence, stones }
}

/// Of roads that explain a drive about as well, the one that its pictures show.
fn shown(
    path: &Path,
    rows: &[Row],
    part: &Range<usize>,
    likely: Vec<Found>,
    scenes: &mut Scenes,
) -> Result<Option<Found>, LocateError> {
    let sure = likely.get(1).is_none_or(|next| likely[0].evidence - next.evidence > SURE);
    if sure {
        return Ok(likely.into_iter().next());
    }
    let mut best: Option<(f64, Found)> = None;
    for found in likely {
        let scene = scenes.of(&found.road.name)?;
        let cuts = continuous(rows, part.clone()).into_iter().flat_map(|run| cut(&run, part, rows, &found, &scene.0));
        let surest =
            |stretch: &Stretch| stretch.known.iter().map(|known| known.deviation_m).fold(f64::INFINITY, f64::min);
        let Some(stretch) = cuts.min_by(|a, b| surest(a).total_cmp(&surest(b))) else { continue };
        let job = Pictures::open(path, Which::Center, [(stretch.around_surest(SAMPLE), scene)])?.next();
        let Some(job) = job.transpose()? else { continue };
        let places = follow(rows, job, |_| (), &|| ()).1;
        let agreements: Vec<f64> = places.iter().flatten().map(|located| located.fit.agreement).collect();
        let agreement = agreements.iter().sum::<f64>() / places.len().max(1) as f64;
        if agreements.len() * 2 > places.len() && best.as_ref().is_none_or(|(most, _)| agreement > *most) {
            best = Some((agreement, found));
        }
    }
    Ok(best.map(|(_, found)| found))
}

/// Follows rows, each forwards or backwards.
fn followed<'a>(mut matcher: Matcher, rows: impl Iterator<Item = (&'a Row, bool)>) -> Vec<Match> {
    for (row, backwards) in rows {
        let Motion { way_m, turn_rad } = row.motion;
        match row.broken {
            Some(Break::PutBack) => matcher.skip(0.0, PUT_BACK_M),
            Some(_) => matcher.skip(way_m, UNSEEN_MPS * row.apart_s),
            None => matcher.step(Motion { way_m, turn_rad: if backwards { -turn_rad } else { turn_rad } }),
        }
    }
    matcher.matches()
}

/// Of the places that the bends before and those behind tell, the surer one; none where they contradict one another.
fn surest(before: &[Milestone], behind: &[Milestone], length_m: f64) -> Vec<Milestone> {
    let nearest = |stone: &Milestone, of: &[Milestone]| {
        let off = |other: &Milestone| (other.way_m - stone.way_m).abs();
        of.iter().min_by(|a, b| off(a).total_cmp(&off(b))).copied().filter(|other| off(other) < ALONGSIDE_M)
    };
    let surer = |stone: &&Milestone, of: &[Milestone]| {
        nearest(stone, of).is_none_or(|other| {
            let off_m = around(stone.s_m - stone.way_m - other.s_m + other.way_m, length_m).abs();
            let unsure_m = NEAR_M + stone.deviation_m.hypot(other.deviation_m);
            off_m < CONTRADICTS * unsure_m && stone.deviation_m <= other.deviation_m
        })
    };
    let surest = before.iter().filter(|stone| surer(stone, behind));
    surest.chain(behind.iter().filter(|stone| surer(stone, before))).copied().collect()
}

/// Rows to follow in one go.
#[derive(Debug, Clone)]
struct Stretch {
    /// Those that are looked at.
    shown: Range<usize>,
    /// Those of them that are located; the others belong to the stretches beside it.
    kept: Range<usize>,
    /// Where the car was by its bends, now and then; pictures are counted from the first that is looked at.
    known: Vec<Known>,
}

impl Stretch {
    /// At most so many of its rows, around the one whose place is known best.
    fn around_surest(&self, most: usize) -> Self {
        let surest = self.known.iter().min_by(|a, b| a.deviation_m.total_cmp(&b.deviation_m));
        let middle = self.shown.start + surest.map_or(0, |known| known.picture);
        let start = middle.saturating_sub(most / 2).max(self.shown.start);
        let rows = start..(start + most).min(self.shown.end);
        let known = self.known.iter().filter_map(|known| {
            let picture = (self.shown.start + known.picture).checked_sub(start)?;
            Some(Known { picture, ..*known })
        });
        Self { known: known.collect(), kept: rows.clone(), shown: rows }
    }
}

/// Cuts a run of rows into stretches.
fn cut(run: &Range<usize>, part: &Range<usize>, rows: &[Row], found: &Found, track: &Track) -> Vec<Stretch> {
    let count = run.len().div_ceil(STRETCH).max(1);
    let bound = |i: usize| run.start + run.len() * i / count;
    let mut way_m = 0.0;
    let driven = |(i, row): (usize, &Row)| {
        way_m += if i > 0 { row.motion.way_m } else { 0.0 };
        way_m
    };
    let ways: Vec<f64> = rows[part.clone()].iter().enumerate().map(driven).collect();
    let stretch = |i: usize| {
        let kept = bound(i)..bound(i + 1);
        let shown = kept.start.saturating_sub(BESIDE).max(run.start)..(kept.end + BESIDE).min(run.end);
        let ways = &ways[shown.start - part.start..shown.end - part.start];
        let known = |stone: &Milestone, deviation_m: f64| {
            let picture = ways.partition_point(|way_m| *way_m < stone.way_m).min(ways.len() - 1);
            let s_m = stone.s_m + ways[picture] - stone.way_m;
            Known { picture, pose: pose(track, s_m, found.road.reversed), deviation_m }
        };
        let within = |stone: &&Milestone| (ways[0]..=ways[ways.len() - 1]).contains(&stone.way_m);
        let told = |stone: &Milestone| known(stone, (stone.deviation_m * ALIKE).max(NEAR_M));
        let mut places: Vec<Known> = found.stones.iter().filter(within).map(told).collect();
        if places.is_empty() {
            let off = |stone: &&Milestone| (stone.way_m - ways[ways.len() / 2]).abs();
            let nearest = found.stones.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
            places.extend(
                nearest.map(|stone| known(stone, (stone.deviation_m * ALIKE).max(NEAR_M) + ASTRAY * off(&stone))),
            );
        }
        Stretch { shown, kept, known: places }
    };
    (0..count).map(stretch).collect()
}

/// The pose of a car on the line to drive, so many metres along the road that it drives.
fn pose(track: &Track, s_m: f64, reversed: bool) -> Pose {
    let travelled = if reversed { track.driving_line_length() - s_m } else { s_m };
    let point = track.on_driving_line(travelled);
    let s_m = track.locate(point.position, None).station.s;
    let (offset_m, heading_rad) = if reversed { (-point.offset, std::f64::consts::PI) } else { (point.offset, 0.0) };
    Pose { s_m, offset_m, heading_rad, pitch_rad: 0.0 }
}

/// Follows a stretch, and says where its own rows are.
fn follow(
    rows: &[Row],
    job: Job,
    unreadable: impl Fn(String),
    looked_at: &impl Fn(),
) -> (Range<usize>, Vec<Option<Located>>) {
    let Job { stretch: Stretch { shown: window, kept, known }, scene: (track, scenery), pictures } = job;
    let mut overlay = Overlay::new(track, scenery, SIZE);
    let motions: Vec<_> = rows[window.clone()].iter().map(|row| row.motion).collect();
    let mut shown = vec![false; motions.len()];
    let show = |i: usize, frame: &mut Frame| {
        let first = !std::mem::replace(&mut shown[i], true);
        if let Err(why) = decoded(pictures[i].as_ref(), frame) {
            *frame = Frame::default();
            if first && kept.contains(&(window.start + i)) {
                unreadable(why);
            }
        }
        if first {
            looked_at();
        }
        Ok::<_, std::convert::Infallible>(())
    };
    let Ok(located) = overlay.follow(&known, &motions, show);
    let own = kept.start - window.start..kept.end - window.start;
    let mut places = seen(&located).get(own).unwrap_or_default().to_vec();
    // A picture tells the place along a straight road no better than the bends before it do.
    for located in places.iter_mut().flatten() {
        located.deviation.s_m = located.deviation.s_m.hypot(NEAR_M);
    }
    (kept, places)
}
