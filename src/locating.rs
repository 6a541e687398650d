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
//! A recording is read twice: first for how the car moved and turned, by numbers and pictures, then for where its pictures
//! were taken. Drives that are joined in one recording are parts of their own. Each part is followed in stretches of bounded
//! length, so that a drive that is lost is found again, several processors share the work, and memory stays bounded.

pub mod again;
mod car;
pub mod drawn;
pub mod network;
mod pictures;
mod rows;
mod stretch;
mod summary;
mod table;
#[cfg(test)]
mod tests;

use std::{
    cmp::Reverse,
    collections::HashMap,
    ops::Range,
    path::Path,
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
    pictures::{Job, Pictures, decoded},
    rows::Rows,
    stretch::{OnRoad, Stretch, continuous, cut, parts_of},
};
use crate::known::Roads;
use lapwing_core::{
    perception::Frame,
    recording::{CameraPosition, RecordingError},
};
use lapwing_score::{
    odometry::{self, BENDS_M, Leg, Road, is_nearly},
    score::Turned,
};
use lapwing_sim::{
    along::SIZE,
    camera::Scenery,
    locate::{FOUND, LaneTable, LaneTableError, Located, LocatedDrive, Overlay, Pose, seen},
    track::{Track, TrackError},
};

/// Rows of each road that are looked at if several explain a drive about as well.
const SAMPLE: usize = 80;

/// Of parts of no more rows than this, all are.
const WHOLE: usize = 320;

/// By how much pictures must agree better with a road than with the next. The right one and the wrong one of 142 m of the real lake: 0.504
/// and 0.496.
const AGREES_BETTER: f64 = 0.02;

/// A road is not believed if the car would have gone more or less than this many times as far there as its speed says. Real recordings
/// that are found by their bends went 0.99 to 1.01; 656 m of a road that nobody knew, on the lake, 2.01.
const PLAUSIBLE_WAY: std::ops::RangeInclusive<f64> = 0.92..=1.08;

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
        path: std::path::PathBuf,
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
    let Rows { rows, looks, unreadable: lost, moments, released_at_once } = Rows::read(path)?;
    if rows.is_empty() {
        return Err(LocateError::NoPictures { path: path.to_owned(), moments });
    }
    let mut stretches = vec![];
    let mut parts = vec![];
    let mut scenes = Scenes { roads, tracks: HashMap::new() };
    for part in parts_of(&rows) {
        // The sum of nothing is -0.
        let way_m = rows[part.clone()].iter().skip(1).fold(0.0, |way_m, row| way_m + row.motion.way_m);
        let look = looks.get(&part.start);
        let legs: Vec<Leg> = rows[part.clone()].iter().skip(1).map(Row::leg).collect();
        let likely = odometry::find(&legs, look, &roads.both_ways()?);
        let (by_start, is_sure) = (likely.by_start, likely.sure().is_some());
        let is_lost = lost.range(part.clone()).count() == part.len();
        let why = unknown(&likely, way_m, is_lost);
        let found = shown(path, &rows, &part, (likely, &legs), &mut scenes)?;
        if let Some(found) = &found {
            let scene = scenes.of(&found.road.name)?;
            for run in continuous(&rows, part.clone()) {
                let cut = cut(&run, &part, &rows, found, &scene.0);
                stretches.extend(cut.into_iter().map(|stretch| (stretch, scene.clone())));
            }
        }
        let not_there =
            |found: &OnRoad| if is_lost { UNREAD.to_owned() } else { nowhere(&found.road, way_m, by_start) };
        let why = found.as_ref().map(not_there).or(why);
        parts.push(Sought { rows: part, way_m, found, why, is_sure });
    }
    let unreadable = Mutex::new((0, None));
    let pictures = Pictures::open(path, camera, stretches)?;
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
    let mut unreadable = unreadable.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    let wanted: usize = parts.iter().filter(|part| part.found.is_some()).map(|part| part.rows.len()).sum();
    let none_is_read = unreadable.0 == wanted;
    // Where no road was found, only the centre camera's pictures were looked at.
    let unfound = parts.iter().filter(|part| part.found.is_none() && camera == CameraPosition::Center);
    for Sought { rows, .. } in unfound {
        let mut whys = lost.range(rows.clone()).map(|(_, why)| why);
        unreadable.1 = unreadable.1.or(whys.next().cloned());
        unreadable.0 += lost.range(rows.clone()).count();
    }
    let parts = parts
        .into_iter()
        .map(|Sought { rows: of, way_m, found, why, is_sure }| {
            let unread = (found.is_some() && none_is_read).then(|| UNREAD.to_owned());
            let on = found
                .map(|found| {
                    let track = scenes.of(&found.road.name)?.0;
                    let drive = LocatedDrive { track, places: places[of.clone()].to_vec() };
                    Ok::<_, TrackError>(On { reversed: found.road.reversed, drive })
                })
                .transpose()?;
            let doubt =
                on.as_ref().and_then(|on| implausible(on, is_sure, &rows[of.clone()], lost.range(of.clone()).count()));
            let on = on.filter(|_| doubt.is_none());
            let is_located = on.iter().flat_map(|on| &on.drive.places).any(Option::is_some);
            Ok(Part { rows: of, way_m, on, unknown: unread.or(doubt).or(why).filter(|_| !is_located) })
        })
        .collect::<Result<_, TrackError>>()?;
    Ok(LocatedRecording { parts, rows, released_at_once, network: None, laps: None, unreadable })
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

/// A part of a recording whose pictures are still to be laid over its road.
struct Sought {
    rows: Range<usize>,
    way_m: f64,
    /// Where it seems to have been.
    found: Option<OnRoad>,
    /// Why its places are unknown, if no picture tells them.
    why: Option<String>,
    /// Whether the bends alone tell the road.
    is_sure: bool,
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
        let track = self.roads.track(road).map_or_else(|| Track::open(road), Ok)?;
        let scenery = Arc::new(Scenery::new(&track));
        let scene = (Arc::new(track), scenery);
        self.tracks.insert(road.to_owned(), scene.clone());
        Ok(scene)
    }
}

/// Why a road is not believed on which a drive was located: the car would have gone too far or not far enough there or, if only the
/// pictures chose it among several (not `is_sure`), too few of those that could be read show it. Of 196 m of the lake with a crash
/// in them, 55 % seem to show the lake the other way round.
fn implausible(on: &On, is_sure: bool, rows: &[Row], unread: usize) -> Option<String> {
    let places = &on.drive.places;
    let share = places.iter().flatten().count() as f64 / (places.len() - unread).max(1) as f64;
    let way = Car::of(&on.drive, rows).map(|car| car.way).filter(|way| !PLAUSIBLE_WAY.contains(way));
    let but = match way {
        Some(way) => format!("there the car would have gone {way:.2} times as far as its speed says"),
        None if !is_sure && share < FOUND && share > 0.0 => format!("only {:.1} % of them show it", 100.0 * share),
        None => return None,
    };
    let road = odometry::words(&on.drive.track.file().name, on.reversed);
    Some(if is_sure {
        format!("its bends fit {road}, but {but}: {ANOTHER_ROAD}; if not, a longer recording may tell")
    } else {
        let known = "several roads explain it about as well, and its pictures are most like";
        format!("{known} {road}, but {but}: a longer recording may tell")
    })
}

/// Why the road of a drive is unknown, if its pictures do not show it either (`is_lost`: none could be read), and what helps.
fn unknown(likely: &odometry::Found, way_m: f64, is_lost: bool) -> Option<String> {
    let why = likely.road().err()?;
    Some(match &likely.likely[..] {
        _ if is_lost => format!("{why}, and {UNREAD}"),
        [] if likely.tried.first().is_some_and(|nearest| is_nearly(way_m, nearest.fit)) => {
            format!("{why}: {ANOTHER_ROAD}; if not, a longer recording may tell")
        }
        [] => format!("{why}: {ANOTHER_ROAD}"),
        _ => format!("{why}, and its pictures do not show which it was: a longer recording may tell"),
    })
}

/// Why none of a drive's pictures is located, although its road is known by its bends, and what helps.
fn nowhere(road: &Road, way_m: f64, by_start: bool) -> String {
    let helps = if by_start || way_m > BENDS_M { ANOTHER_ROAD } else { "a longer recording may tell" };
    format!("its bends fit {}, but its pictures do not show it there: {helps}", road.words())
}

/// Of roads that explain a drive about as well, the one that its pictures show.
fn shown(
    path: &Path,
    rows: &[Row],
    part: &Range<usize>,
    (likely, legs): (odometry::Found, &[Leg]),
    scenes: &mut Scenes,
) -> Result<Option<OnRoad>, LocateError> {
    if let Some(on) = likely.sure() {
        return Ok(Some(OnRoad::new(on, legs)));
    }
    let mut laid: Vec<(OnRoad, Option<f64>)> = vec![];
    for on in &likely.likely {
        let found = OnRoad::new(on, legs);
        let scene = scenes.of(&found.road.name)?;
        let runs = continuous(rows, part.clone());
        let cuts = runs.iter().flat_map(|run| cut(run, part, rows, &found, &scene.0));
        let surest = |stretch: &Stretch| {
            stretch.known.iter().flatten().map(|known| known.deviation_m).fold(f64::INFINITY, f64::min)
        };
        let looked_at: Vec<Stretch> = match part.len() <= WHOLE {
            true => cuts.collect(),
            false => {
                let best = cuts.min_by(|a, b| surest(a).total_cmp(&surest(b)));
                best.map(|stretch| stretch.around_surest(SAMPLE)).into_iter().collect()
            }
        };
        let most: usize = looked_at.iter().map(|stretch| stretch.kept.len()).sum();
        let jobs = looked_at.into_iter().map(|stretch| (stretch, scene.clone()));
        let agreements = Pictures::open(path, CameraPosition::Center, jobs)?.par_bridge().map(|job| {
            let (of, places) = follow(rows, job?, |_| (), &|| ());
            Ok((of.start, places.iter().flatten().map(|located| located.fit.agreement).collect::<Vec<_>>()))
        });
        let mut agreements = agreements.collect::<Result<Vec<_>, RecordingError>>()?;
        // In their order, so that their sum is the same each time.
        agreements.sort_by_key(|(start, _)| *start);
        let agreements: Vec<f64> = agreements.into_iter().flat_map(|(_, agreements)| agreements).collect();
        let agreement = agreements.iter().sum::<f64>() / most.max(1) as f64;
        tracing::debug!(
            "{}: evidence {:.2}, {} of {most} agree by {agreement:.4}",
            found.road.words(),
            on.evidence,
            agreements.len()
        );
        laid.push((found, (agreements.len() * 2 > most).then_some(agreement)));
    }
    let agreements: Vec<_> = laid.iter().map(|(_, agreement)| *agreement).collect();
    Ok(chosen(&agreements).map(|i| laid.swap_remove(i).0))
}

/// Of roads, the likeliest by the bends first, the one that the pictures show, by how well each agrees with them: not if another
/// agrees about as well, or if a likelier one could not be seen in them. Where the bends do not tell the place, the right road is
/// searched in the wrong place, and another one may agree by chance.
fn chosen(agreements: &[Option<f64>]) -> Option<usize> {
    let seen = |i: &usize| agreements[*i].unwrap_or(f64::NEG_INFINITY);
    let best = (0..agreements.len()).max_by(|a, b| seen(a).total_cmp(&seen(b)))?;
    let others = (0..agreements.len()).filter(|i| *i != best);
    let next = others.map(|i| seen(&i)).fold(f64::NEG_INFINITY, f64::max);
    (agreements[..=best].iter().all(Option::is_some) && seen(&best) - next >= AGREES_BETTER).then_some(best)
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
    let mut show = |i: usize, frame: &mut Frame| {
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
        located.deviation.s_m = located.deviation.s_m.hypot(odometry::NEAR_M);
    }
    (kept, places)
}
