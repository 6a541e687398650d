//! Where a recording was driven: on which road, which way round, and where each of its pictures was taken.
//!
//! ```text
//! speed, steering ─▶ motions ─▶ odometry::find, on every road and both ways round ─▶ road, places every 20 m
//!                       │                                                         │
//! pictures ─────────────┴─▶ Overlay::follow, stretch by stretch ◀── surest place ─┘
//!                                     └─▶ LocatedDrive
//! pictures ─▶ network::look ─▶ ByNetwork: what a network sees in each, on any road
//! pictures of one place in different laps ─▶ again::look ─▶ Laps: whether they say the same of one another
//! ```
//! Where the bends of a short drive fit several roads, or several places on one, `shown` looks at a few of its pictures from each of
//! those places, and follows it from the few that are left; of a longer one whose bends fit several roads, it looks at a sample.
//!
//! A recording is read twice: first for how the car moved and turned, by numbers and pictures, then for where its pictures
//! were taken; and again for drives that `shown` looks for. Drives that are joined in one recording are parts of their own. Each part is
//! followed in stretches of bounded length, so that a drive that is lost is found again, several processors share the work, and memory
//! stays bounded.

pub mod again;
mod car;
pub mod drawn;
pub mod network;
mod pictures;
mod rows;
mod shown;
mod stretch;
mod summary;
mod table;
#[cfg(test)]
mod tests;

use std::{
    cmp::Reverse,
    collections::{BTreeMap, HashMap},
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use rayon::prelude::*;

pub use self::{
    again::Laps,
    car::{Car, gearing},
    rows::{Row, RowTruth},
    summary::{AgainstTruth, Errors, PartSummary, Placed, Sides, Spread, Summary},
};
use self::{
    network::ByNetwork,
    pictures::{Job, Pictures, Scene, decoded},
    rows::Rows,
    shown::{Drive, Shown, Sight, is_short},
    stretch::{OnRoad, Stretch, cuts, parts_of},
};
use crate::known::Roads;
use lapwing_core::{
    motion::Motion,
    perception::Frame,
    recording::{CameraPosition, RecordingError},
};
use lapwing_score::{
    odometry::{self, BENDS_M, Leg, Look, PLAUSIBLE_WAY, Road, is_nearly},
    score::Turned,
};
use lapwing_sim::{
    along::SIZE,
    camera::Scenery,
    locate::{FOUND, LaneTable, LaneTableError, Located, LocatedDrive, Overlay, Pose, seen},
    track::{Track, TrackError},
};

/// What to do about a road that is not known.
const ANOTHER_ROAD: &str = "if it was on another road, name that with --track FILE.toml";

/// Why nothing is located of a recording whose pictures are lost.
const UNREAD: &str = "none of its pictures could be read";

/// A recording that cannot be located.
#[derive(Debug, thiserror::Error)]
pub enum LocateError {
    /// The run or the driving log.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A road that is asked for.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// A table of places.
    #[error(transparent)]
    Table(#[from] LaneTableError),
    /// A network that does not answer.
    #[cfg(feature = "networks")]
    #[error(transparent)]
    Network(#[from] lapwing_learn::models::LaneError),
    /// None of its moments has a picture.
    #[error("{}: expected a recording with pictures, got {moments} moments without one", path.display())]
    NoPictures {
        /// The recording.
        path: PathBuf,
        /// How many moments it has.
        moments: usize,
    },
}

/// The table of places that [`LocatedRecording::csv`] made of this recording.
///
/// # Errors
/// [`LocateError`]: what cannot be read, and a table of another recording.
pub fn table_of(path: &Path, table: &Path, roads: &Roads) -> Result<LaneTable, LocateError> {
    Ok(LaneTable::of(path, table, by_name(roads))?)
}

/// A table of places to hold against what is found ([`LocatedRecording::tell`]).
///
/// # Errors
/// [`LocateError`]: what cannot be read, and a table of another recording.
pub fn truth_of(path: &Path, table: &Path, roads: &Roads) -> Result<LaneTable, LocateError> {
    Ok(LaneTable::of(path, table, by_name(roads)).map_err(LaneTableError::of_truth)?)
}

fn by_name(roads: &Roads) -> impl Fn(&str) -> Result<Track, TrackError> {
    |name| roads.track(name).ok_or_else(|| TrackError::Unknown { got: name.to_owned() })
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
    /// Why its road is unknown, or why none of its pictures was located on it.
    pub unknown: Option<String>,
}

/// A drive on a road.
#[derive(Debug)]
pub struct On {
    /// Whether it was driven against the track's direction.
    pub reversed: bool,
    /// Where the car was in each of the part's rows.
    pub drive: LocatedDrive,
}

impl On {
    /// The road's name.
    pub fn road(&self) -> &str {
        &self.drive.track.file().name
    }
}

/// What was found.
#[derive(Debug)]
pub struct LocatedRecording {
    /// The drives, in the recording's order.
    pub parts: Vec<Part>,
    /// The moments with a picture.
    pub rows: Vec<Row>,
    /// The moments of the drives that a keyboard steered whose release is at once.
    pub released_at_once: Vec<Range<usize>>,
    /// What a network sees in the pictures, if one was asked.
    pub network: Option<ByNetwork>,
    /// What its laps say of one another, if they were asked.
    pub laps: Option<Laps>,
    /// Pictures that could not be looked at, and why not, of the first one.
    pub unreadable: (usize, Option<String>),
}

impl LocatedRecording {
    /// All drives on the track that most of the pictures show; where another one was driven, no place is known.
    pub fn drive(&self) -> Option<LocatedDrive> {
        self.drives().into_iter().next()
    }

    /// On each track all drives, as one: where another one was driven, no place is known. The track that most of the pictures
    /// show comes first.
    pub fn drives(&self) -> Vec<LocatedDrive> {
        let known = |drive: &LocatedDrive| drive.places.iter().flatten().count();
        let mut drives: Vec<LocatedDrive> = vec![];
        for part in &self.parts {
            let Some(on) = &part.on else { continue };
            let begun = drives.iter().position(|drive| drive.track.file().name == on.road());
            let i = begun.unwrap_or(drives.len());
            if begun.is_none() {
                drives.push(LocatedDrive { track: on.drive.track.clone(), places: vec![None; self.rows.len()] });
            }
            drives[i].places[part.rows.clone()].copy_from_slice(&on.drive.places);
        }
        drives.retain(|drive| known(drive) > 0);
        drives.sort_by_key(|drive| Reverse(known(drive)));
        drives
    }

    /// Why drives are unknown, each reason once.
    pub fn unknown(&self) -> Vec<&str> {
        let mut whys: Vec<&str> = vec![];
        for why in self.parts.iter().filter_map(|part| part.unknown.as_deref()) {
            if !whys.contains(&why) {
                whys.push(why);
            }
        }
        whys
    }
}

impl LocatedRecording {
    /// Takes a table of places as the truth, before what the recording itself tells. Returns how many moments it puts on
    /// another road than the one found: those cannot be compared, and are left out.
    pub fn tell(&mut self, truth: &LaneTable) -> usize {
        let told: HashMap<usize, (&Arc<Track>, Pose)> = truth.known().collect();
        let mut elsewhere = 0;
        for part in &self.parts {
            let road = part.on.as_ref().map(On::road);
            for row in &mut self.rows[part.rows.clone()] {
                let Some((track, pose)) = told.get(&row.moment) else { continue };
                let is_here = road.is_none_or(|road| road == track.file().name);
                row.truth = is_here.then(|| RowTruth::of_pose(*pose, track));
                elsewhere += usize::from(!is_here);
            }
        }
        elsewhere
    }
}

/// Locates the pictures of one of the cameras. `looked_at` is called for each picture that was.
///
/// # Errors
/// [`LocateError`]: what cannot be read. A single picture that cannot is counted.
pub fn locate(
    path: &Path,
    camera: CameraPosition,
    roads: &Roads,
    looked_at: impl Fn() + Sync,
) -> Result<LocatedRecording, LocateError> {
    Driven::find(path, roads, &looked_at)?.locate(camera, looked_at)
}

/// A recording of which it is known on which roads it was driven, and where, up to some metres: enough to locate the pictures of each
/// of its cameras.
pub struct Driven {
    path: PathBuf,
    rows: Vec<Row>,
    parts: Vec<Sought>,
    released_at_once: Vec<Range<usize>>,
    /// The rows whose picture of the centre camera could not be looked at, and why not.
    lost: BTreeMap<usize, String>,
}

impl Driven {
    /// Looks where a recording was driven, on these roads: by how the car moved and, where that does not tell, by what its centre camera
    /// shows. `looked_at` is called for each picture that is located on the way.
    ///
    /// # Errors
    /// [`LocateError`]: what cannot be read.
    pub fn find(path: &Path, roads: &Roads, looked_at: impl Fn() + Sync) -> Result<Self, LocateError> {
        let Rows { rows, looks, unreadable: lost, moments, released_at_once } = Rows::read(path)?;
        if rows.is_empty() {
            return Err(LocateError::NoPictures { path: path.to_owned(), moments });
        }
        let mut scenes = Scenes { roads, tracks: HashMap::new() };
        let both_ways = roads.both_ways()?;
        let mut drives = vec![];
        // Of short drives on roads that are known, so that all are looked at in one go.
        let mut stretches = vec![];
        for part in parts_of(&rows) {
            let (legs, likely, told) = by_bends(&rows[part.clone()], looks.get(&part.start), &both_ways);
            let sure = likely.sure().map(|on| OnRoad::new(on, &legs));
            if let Some(on) = sure.as_ref().filter(|_| is_short(&rows, &part)) {
                let scene = scenes.of(&on.road.name)?;
                stretches.extend(cuts(&part, &rows, on, &scene.0).into_iter().map(|it| (it, scene.clone())));
            }
            drives.push((part, legs, likely, told, sure));
        }
        let laid = followed(path, &rows, CameraPosition::Center, stretches, |_, _| (), &looked_at)?;
        let mut laid = laid.into_iter().peekable();
        let mut parts = vec![];
        for (part, legs, likely, told, sure) in drives {
            // The sum of nothing is -0.
            let way_m = legs.iter().fold(0.0, |way_m, leg| way_m + leg.motion.way_m);
            let is_lost = lost.range(part.clone()).count() == part.len();
            let drive = Drive { path, rows: &rows, part: part.clone(), legs: &legs, lost: &lost };
            let told = if sure.is_some() { told } else { Told::Pictures };
            let Sight { shown, is_vague } = match sure {
                Some(on) => {
                    let here = std::iter::from_fn(|| laid.next_if(|(of, _)| of.start < part.end)).collect();
                    drive.on(on, here, &mut scenes)?
                }
                None => drive.among(&likely.likely, &mut scenes)?,
            };
            let likeliest = likely.likely.first().filter(|_| !likely.by_start && !is_lost);
            let mirrored = match (&shown, likeliest) {
                (Some(shown), Some(likeliest)) => drive.mirrored_on(shown, likeliest, &both_ways, &mut scenes)?,
                _ => None,
            };
            let shown = shown.filter(|_| mirrored.is_none());
            let why = match &shown {
                _ if let Some(road) = &mirrored => Some(mirrored_pictures(road)),
                Some(_) if is_lost => Some(UNREAD.to_owned()),
                Some(Shown { on, .. }) => Some(nowhere(&on.road, way_m, likely.by_start, is_vague)),
                None => unknown(&likely, way_m, is_lost, is_vague),
            };
            parts.push(Sought { rows: part, way_m, found: shown, why, told });
        }
        Ok(Self { path: path.to_owned(), rows, parts, released_at_once, lost })
    }

    /// Locates the pictures of one of the cameras. `looked_at` is called for each picture that was.
    ///
    /// # Errors
    /// [`LocateError`]: what cannot be read. A single picture that cannot is counted.
    pub fn locate(&self, camera: CameraPosition, looked_at: impl Fn() + Sync) -> Result<LocatedRecording, LocateError> {
        let Self { path, rows, parts, lost, .. } = self;
        let is_centre = camera == CameraPosition::Center;
        let mut stretches = vec![];
        let mut located: Laid = vec![];
        // The rows whose pictures of the centre camera were looked at before, in search of their road and place.
        let mut seen_before = vec![];
        for part in parts {
            let Some(Shown { on, scene, laid }) = &part.found else {
                seen_before.extend(is_centre.then(|| part.rows.clone()));
                continue;
            };
            if let Some(laid) = laid.as_ref().filter(|_| is_centre) {
                located.extend_from_slice(laid);
                seen_before.push(part.rows.clone());
                continue;
            }
            stretches.extend(cuts(&part.rows, rows, on, &scene.0).into_iter().map(|it| (it, scene.clone())));
        }
        let unreadable = Mutex::new(BTreeMap::new());
        let tell = |row: usize, why: String| {
            unreadable.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).insert(row, why);
        };
        located.extend(followed(path, rows, camera, stretches, tell, &looked_at)?);
        let mut unreadable = unreadable.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        for rows in seen_before {
            unreadable.extend(lost.range(rows).map(|(row, why)| (*row, why.clone())));
        }
        let mut places: Vec<Option<Located>> = vec![None; rows.len()];
        for (of, located) in located {
            places[of].iter_mut().zip(located).for_each(|(place, located)| *place = located);
        }
        let of = |part: &Sought| {
            let Sought { rows: of, way_m, found, why, told } = part;
            let unread = unreadable.range(of.clone()).count();
            let on = found.as_ref().map(|Shown { on, scene, .. }| {
                let drive = LocatedDrive { track: scene.0.clone(), places: places[of.clone()].to_vec() };
                On { reversed: on.road.reversed, drive }
            });
            let is_unread = on.is_some() && unread == of.len();
            let doubt = on.as_ref().and_then(|on| implausible(on, *told, &rows[of.clone()], unread));
            let on = on.filter(|_| doubt.is_none());
            let is_located = on.iter().flat_map(|on| &on.drive.places).any(Option::is_some);
            let unknown = is_unread.then(|| UNREAD.to_owned()).or(doubt).or_else(|| why.clone());
            Part { rows: of.clone(), way_m: *way_m, on, unknown: unknown.filter(|_| !is_located) }
        };
        let parts = parts.iter().map(of).collect();
        let unreadable = (unreadable.len(), unreadable.into_values().next());
        let released_at_once = self.released_at_once.clone();
        Ok(LocatedRecording { parts, rows: rows.clone(), released_at_once, network: None, laps: None, unreadable })
    }
}

/// How the car turned from each picture of a recording to the next, by what they show; where they show nothing, and across a
/// break, as it was steered.
///
/// # Errors
/// What cannot be read of the run or the driving log.
pub fn turns(path: &Path) -> Result<Vec<Turned>, RecordingError> {
    let Rows { rows, .. } = Rows::read(path)?;
    let turned = |pair: &[Row]| {
        let [before, row] = pair else { return None };
        let turn_rad = row.motion.turn_rad;
        row.broken.is_none().then_some(Turned { after: before.moment, to: row.moment, turn_rad })
    };
    Ok(rows.windows(2).filter_map(turned).collect())
}

/// Where the pictures of some stretches were taken.
type Laid = Vec<(Range<usize>, Vec<Option<Located>>)>;

/// A part of a recording whose pictures are still to be laid over its road.
struct Sought {
    rows: Range<usize>,
    way_m: f64,
    /// Where it seems to have been.
    found: Option<Shown>,
    /// Why its places are unknown, if no picture tells them.
    why: Option<String>,
    told: Told,
}

/// What tells the road of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Told {
    /// Its bends, by how its pictures show it to have turned.
    Bends,
    /// Its bends, by how it was steered: by how its pictures show it to have turned, the same road explains it nearly.
    Steering,
    /// Its pictures, as its bends fit several.
    Pictures,
}

/// How the car moved from row to row, which roads explain that, and by what: [`Told::Bends`], or the steering. It is used if no road explains the
/// turning seen in the pictures, but the nearest one almost does and is the only one that explains the steering. In pictures that are
/// darker by a tenth, turning is measured less well.
fn by_bends(rows: &[Row], first: Option<&Look>, roads: &[Arc<Road>]) -> (Vec<Leg>, odometry::Found, Told) {
    let legs: Vec<Leg> = rows.iter().skip(1).map(Row::leg).collect();
    let found = odometry::find(&legs, first, roads);
    let nearest =
        found.tried.first().filter(|nearest| found.likely.is_empty() && odometry::nearly_explains(nearest.fit));
    if let Some(nearest) = nearest {
        let steered: Vec<Leg> = rows.iter().skip(1).map(Row::leg_as_steered).collect();
        let by_steering = odometry::find(&steered, None, roads);
        if by_steering.sure().is_some_and(|on| Arc::ptr_eq(&on.road, &nearest.road)) {
            return (steered, by_steering, Told::Steering);
        }
    }
    (legs, found, Told::Bends)
}

/// Tracks, and what stands beside them, made on first use.
struct Scenes<'a> {
    roads: &'a Roads,
    tracks: HashMap<String, Scene>,
}

impl Scenes<'_> {
    fn of(&mut self, road: &str) -> Result<Scene, TrackError> {
        if let Some(scene) = self.tracks.get(road) {
            return Ok(scene.clone());
        }
        let track = self.roads.track(road).map_or_else(|| Track::open(road), Ok)?;
        let scenery = Arc::new(Scenery::new(&track));
        let scene = (Arc::new(track), scenery);
        self.tracks.insert(road.to_owned(), scene.clone());
        Ok(scene)
    }
}

/// Why the place of a drive is unknown whose pictures show this road once they are mirrored.
fn mirrored_pictures(road: &Road) -> String {
    let road = road.words();
    format!("its pictures seem to be mirrored: flipped back, they show {road}; use the pictures as they were recorded")
}

/// Why a road is not believed on which a drive was located: the car would have gone too far or not far enough there or, if its bends
/// alone do not tell it, too few of those that could be read show it. Of 196 m of the lake with a crash in them, 55 % seem to show the
/// lake the other way round.
fn implausible(on: &On, told: Told, rows: &[Row], unread: usize) -> Option<String> {
    let places = &on.drive.places;
    let share = places.iter().flatten().count() as f64 / (places.len() - unread).max(1) as f64;
    let way = Car::of(&on.drive, rows).map(|car| car.way).filter(|way| !PLAUSIBLE_WAY.contains(way));
    let but = match way {
        Some(way) => format!("there the car would have gone {way:.2} times as far as its speed says"),
        None if told != Told::Bends && share < FOUND && share > 0.0 => {
            format!("only {:.1} % of them show it", 100.0 * share)
        }
        None => return None,
    };
    let road = odometry::words(&on.drive.track.file().name, on.reversed);
    Some(match told {
        Told::Bends => format!("its bends fit {road}, but {but}: {ANOTHER_ROAD}; if not, a longer recording may tell"),
        Told::Steering => {
            format!(
                "judging by its steering, it was on {road}, but {but}: {ANOTHER_ROAD}; if not, a longer recording may tell"
            )
        }
        Told::Pictures => {
            let known = "several roads explain it about as well, and its pictures are most like";
            format!("{known} {road}, but {but}: a longer recording may tell")
        }
    })
}

/// Why the road of a drive is unknown, if its pictures do not show it either (`is_lost`: none could be read; `is_vague`: they were not
/// looked at, as its bends fit too many places), and what helps.
fn unknown(likely: &odometry::Found, way_m: f64, is_lost: bool, is_vague: bool) -> Option<String> {
    let why = likely.road().err()?;
    Some(match &likely.likely[..] {
        _ if is_lost => format!("{why}, and {UNREAD}"),
        [] if likely.tried.first().is_some_and(|nearest| is_nearly(way_m, nearest.fit)) => {
            format!("{why}: {ANOTHER_ROAD}; if not, a longer recording may tell")
        }
        [] => format!("{why}: {ANOTHER_ROAD}"),
        _ if is_vague => {
            format!("{why}, in too many places to look for it in its pictures: a longer recording may tell")
        }
        _ => format!("{why}, and its pictures do not show which it was: a longer recording may tell"),
    })
}

/// Why none of a drive's pictures is located, although its road is known by its bends, and what helps.
fn nowhere(road: &Road, way_m: f64, by_start: bool, is_vague: bool) -> String {
    let (but, helps) = match by_start || way_m > BENDS_M {
        true => ("but its pictures do not show it there", ANOTHER_ROAD),
        false if is_vague => ("in too many places to look for it in its pictures", "a longer recording may tell"),
        false => ("but its pictures do not show where", "a longer recording may tell"),
    };
    format!("its bends fit {}, {but}: {helps}", road.words())
}

/// Follows stretches, in the order in which they are recorded, and says where their own rows are.
fn followed(
    path: &Path,
    rows: &[Row],
    camera: CameraPosition,
    stretches: impl IntoIterator<Item = (Stretch, Scene)>,
    unreadable: impl Fn(usize, String) + Sync,
    looked_at: &(impl Fn() + Sync),
) -> Result<Laid, RecordingError> {
    let pictures = Pictures::open(path, camera, stretches)?.par_bridge();
    let mut laid = pictures.map(|job| Ok(follow(rows, job?, &unreadable, looked_at))).collect::<Result<Laid, _>>()?;
    // In their order, so that sums are the same each time.
    laid.sort_by_key(|(of, _)| of.start);
    Ok(laid)
}

/// How a car moves that turns as far to the other side.
fn mirrored(motion: Motion) -> Motion {
    Motion { turn_rad: -motion.turn_rad, ..motion }
}

/// Mirrors a picture, left to right.
fn mirror(frame: &mut Frame) {
    let width = frame.width();
    for row in frame.rgb_mut().chunks_exact_mut(3 * width.max(1)) {
        row.as_chunks_mut::<3>().0.reverse();
    }
}

/// Follows a stretch, and says where its own rows are.
fn follow(
    rows: &[Row],
    job: Job,
    unreadable: impl Fn(usize, String),
    looked_at: &impl Fn(),
) -> (Range<usize>, Vec<Option<Located>>) {
    let Job { stretch: Stretch { shown: window, kept, known, is_mirrored }, scene: (track, scenery), pictures } = job;
    let mut overlay = Overlay::new(track, scenery, SIZE);
    let motion = |row: &Row| if is_mirrored { mirrored(row.motion) } else { row.motion };
    let motions: Vec<_> = rows[window.clone()].iter().map(motion).collect();
    let mut shown = vec![false; motions.len()];
    let mut show = |i: usize, frame: &mut Frame| {
        let first = !std::mem::replace(&mut shown[i], true);
        if let Err(why) = decoded(pictures[i].as_ref(), frame) {
            *frame = Frame::default();
            if first && kept.contains(&(window.start + i)) {
                unreadable(window.start + i, why);
            }
        }
        if is_mirrored {
            mirror(frame);
        }
        if first {
            looked_at();
        }
        Ok::<_, std::convert::Infallible>(())
    };
    let own = kept.start - window.start..kept.end - window.start;
    let mut places: Vec<Option<Located>> = vec![];
    let known_rows = |places: &[Option<Located>]| places.iter().flatten().count();
    for known in known.iter().filter(|known| !known.is_empty()) {
        let Ok(located) = overlay.follow(known, &motions, &mut show);
        let found = seen(&located).get(own.clone()).unwrap_or_default().to_vec();
        if known_rows(&found) > known_rows(&places) {
            places = found;
        }
        if known_rows(&places) as f64 >= FOUND * kept.len() as f64 {
            break;
        }
    }
    // A picture tells the place along a straight road no better than the bends before it do.
    for located in places.iter_mut().flatten() {
        located.deviation = located.deviation.with_place(odometry::NEAR_M);
    }
    (kept, places)
}
