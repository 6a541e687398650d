//! Records a data set for emergency braking: one run an episode, and a table of them.
//!
//! Each episode is driven without pictures first. That takes a hundredth of the time and shows whether its draw is of use: in a
//! hazard the driver's foot must be down for [`PRESSED_BEFORE_S`] before anything is hit, or the run would show a danger
//! without the label for it; in a negative nothing may be hit, nor braked for in an emergency. If it is not, it is
//! drawn anew. Then the episodes that have no file yet are driven with pictures. The same seed gives the same bytes.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write,
    fs, io,
    path::{Path, PathBuf},
};

use rayon::prelude::*;

use super::{
    case::{Kind, Part},
    human::Human,
    plan::{Episode, episodes},
    play::{Blind, Played, Shown, play},
    stage::Place,
};
use crate::{
    scenario::ScenarioError,
    track::TrackError,
    world::{Setup, Simulation},
};
use lapwing_core::{
    drive, files,
    protocol::Dialect,
    recording::{Item, RecordingError, RunFile, RunHeader, RunKind, RunReader},
};

/// The table of the episodes.
pub const EPISODES_NAME: &str = "episodes.csv";
/// Its heading.
pub const HEADING: &str = "name,part,scenario,kind,layer,seed,track,speed_mph,reaction_s,frames,hit";

/// So long before an impact the foot must be down, in seconds: a label is 0.67 s long and begins two samples before the pedal moves.
const PRESSED_BEFORE_S: f64 = 0.45;
/// Draws of one episode before it is given up.
const DRAWS: u64 = 24;
/// No episode is much shorter, in seconds: the target is reached later.
const SHORTEST_S: f64 = 5.0;
/// So many episodes for each processor are rehearsed, and recorded, before it is looked whether there are enough, and the table
/// is written: with fewer, most processors wait for the longest episode.
const AT_ONCE: usize = 16;

/// How much is recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DataOptions {
    /// Hours of driving in all parts together, at least.
    pub hours: f64,
    /// The seed of everything random.
    pub seed: u64,
    /// Telemetries a second. 15 by default.
    pub hz: f64,
    /// Record only this part; the hours still count all parts. All parts by default.
    pub part: Option<Part>,
}

impl DataOptions {
    fn wants(self, part: Part) -> bool {
        self.part.is_none_or(|only| only == part)
    }
}

impl Default for DataOptions {
    fn default() -> Self {
        Self { hours: 3.0, seed: 0, hz: 15.0, part: None }
    }
}

/// An episode of a data set.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// What was drawn.
    pub episode: Episode,
    /// Telemetries.
    pub frames: u64,
    /// Whether the car hit something.
    pub hit: bool,
}

/// What was recorded of the part that was asked for.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DataReport {
    /// All episodes, those that were there before included.
    pub episodes: Vec<Recorded>,
    /// How many of them were there before.
    pub kept: usize,
    /// How many more the table lists: those of a longer data set that was there before.
    pub more: usize,
    /// Episodes of which no draw was of use.
    pub given_up: usize,
    /// Whether it was interrupted before all were recorded.
    pub interrupted: bool,
}

/// A data set that cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// A road.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// A scenario that cannot be played on its road.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A run.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The folder or the table.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Nothing of the part.
    #[error("there is no {part} episode in the first {hours} hours: ask for more hours")]
    NoEpisode {
        /// The part.
        part: Part,
        /// So many were asked for.
        hours: f64,
    },
    /// Another data set is in the folder.
    #[error(
        "{}: line {line}: expected {expected:?}, as this seed gives, got {got:?}: the folder holds the data set of another \
         seed or version of Lapwing; name another folder",
        path.display()
    )]
    Other {
        /// Its table.
        path: PathBuf,
        /// The first line that differs, from 1.
        line: usize,
        /// What it would be for this data set.
        expected: String,
        /// What it is.
        got: String,
    },
    /// A run of another data set is in the folder, under the name of an episode.
    #[error(
        "{}: expected a run of {expected}, as this seed gives, got {got}: the folder holds runs of another seed or version of \
         Lapwing; name another folder",
        path.display()
    )]
    OtherRun {
        /// The run.
        path: PathBuf,
        /// The episode as it is drawn, and its rate, as JSON.
        expected: String,
        /// What the run's header says.
        got: String,
    },
}

impl From<std::convert::Infallible> for DataError {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}

/// Roads by name, opened once.
#[derive(Debug, Default)]
pub struct Places(BTreeMap<String, Place>);

impl Places {
    /// Opens those that are not open yet.
    ///
    /// # Errors
    /// [`TrackError`].
    pub fn open<'a>(&mut self, names: impl IntoIterator<Item = &'a str>) -> Result<(), TrackError> {
        let missing: Vec<&str> = names.into_iter().filter(|name| !self.0.contains_key(*name)).collect();
        let opened = missing.into_par_iter().map(|name| Ok((name.to_owned(), Place::open(name)?)));
        self.0.extend(opened.collect::<Result<Vec<_>, TrackError>>()?);
        Ok(())
    }

    /// One of them.
    pub fn get(&self, name: &str) -> Result<&Place, TrackError> {
        self.0.get(name).ok_or_else(|| TrackError::Unknown { got: name.to_owned() })
    }
}

/// Records a data set into a folder, where episodes of the same data set that are whole are kept, and listed, even if they
/// are more than this call asks for; what a recording that was killed left half written is removed. `watch` is told how much is
/// done and of how much, and says whether to go on: first of the rehearsal, in telemetries, then of the episodes. If it ends
/// the rehearsal, the folder's table stays as it is.
///
/// # Errors
/// [`DataError`]. What was recorded before it is kept. [`DataError::Other`] and [`DataError::OtherRun`] before anything is
/// recorded.
pub fn record(
    folder: &Path,
    options: DataOptions,
    watch: impl Fn(usize, usize) -> bool + Sync,
) -> Result<DataReport, DataError> {
    let cannot = |source| DataError::Write { path: folder.to_owned(), source };
    fs::create_dir_all(folder).map_err(cannot)?;
    let held = files::lock(folder, false).map_err(cannot)?;
    let mut places = Places::default();
    let Some((mut report, drawn)) = rehearse(&mut places, options, &watch)? else {
        return Ok(DataReport { interrupted: true, ..DataReport::default() });
    };
    let wanted: Vec<Recorded> = drawn.iter().filter(|recorded| options.wants(recorded.episode.part)).cloned().collect();
    if let (Some(part), []) = (options.part, &wanted[..]) {
        return Err(DataError::NoEpisode { part, hours: options.hours });
    }
    let more = rows_beyond(folder, &drawn)?;
    let path = |recorded: &Recorded| run_of(folder, &recorded.episode.name);
    drawn.par_iter().try_for_each(|recorded| check_kept(&path(recorded), &recorded.episode, options))?;
    // Nobody else is writing them.
    if held.is_some() {
        remove_partial(folder).map_err(cannot)?;
    }
    let there = |of: &[Recorded]| of.iter().filter(|recorded| path(recorded).is_file()).cloned().collect::<Vec<_>>();
    (report.kept, report.more) = (there(&wanted).len(), more.len());
    let (total, mut done) = (wanted.len(), 0);
    for some in wanted.chunks(at_once()) {
        let record = |recorded: &Recorded| {
            let path = path(recorded);
            if path.is_file() {
                return Ok(Some(()));
            }
            watch(done, total).then(|| write(&places, &recorded.episode, options, &path)).transpose()
        };
        let whole = some.par_iter().map(record).collect::<Result<Option<()>, DataError>>()?;
        done += some.len();
        report.episodes = there(&wanted);
        let listed = there(&drawn);
        if !listed.is_empty() {
            let rows: String = more.iter().flat_map(|row| [row.as_str(), "\n"]).collect();
            let table = folder.join(EPISODES_NAME);
            files::write(&table, (csv(&listed) + &rows).as_bytes())
                .map_err(|source| DataError::Write { path: table, source })?;
        }
        if whole.is_none() || !watch(done, total) {
            report.interrupted = report.episodes.len() < total;
            break;
        }
    }
    Ok(report)
}

fn run_of(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.mcap"))
}

/// The rows of the table that is in the folder already, if there is one, that are of none of these episodes and whose run is
/// there. The other rows must be the same: the names of the runs do not tell whether they are of these episodes.
fn rows_beyond(folder: &Path, drawn: &[Recorded]) -> Result<Vec<String>, DataError> {
    let path = folder.join(EPISODES_NAME);
    let there = match fs::read(&path) {
        Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(vec![]),
        Err(source) => return Err(DataError::Write { path, source }),
    };
    let mut beyond = vec![];
    let ours = csv(drawn);
    let name = |row: &str| row.split(',').next().unwrap_or_default().to_owned();
    // Names begin with their number in the data set.
    let number = |name: &str| name.split('-').next().and_then(|number| number.parse::<u64>().ok());
    let rows: BTreeMap<String, &str> = ours.lines().map(|row| (name(row), row)).collect();
    let last = drawn.last().map_or("", |recorded| &*recorded.episode.name);
    for (i, got) in there.lines().enumerate() {
        // The heading is the first of both.
        let expected = if i == 0 { Some(HEADING) } else { rows.get(&name(got)).copied() };
        match expected {
            Some(expected) if expected != got => {
                return Err(DataError::Other { path, line: i + 1, expected: expected.to_owned(), got: got.to_owned() });
            }
            // A row between ours is of another data set.
            None if number(&name(got)).zip(number(last)).is_some_and(|(got, last)| got <= last) => {
                let expected = format!("an episode after {last}");
                return Err(DataError::Other { path, line: i + 1, expected, got: got.to_owned() });
            }
            None if run_of(folder, &name(got)).is_file() => beyond.push(got.to_owned()),
            _ => {}
        }
    }
    Ok(beyond)
}

/// Checks that a run, if there is one, is of this episode: the table does not list those that a killed recording left.
fn check_kept(path: &Path, episode: &Episode, options: DataOptions) -> Result<(), DataError> {
    if !path.is_file() {
        return Ok(());
    }
    let header = RunReader::open(path)?.header().clone();
    // As it is read back from a run.
    let expected = config(episode, options).to_string();
    let is_same = serde_json::from_str::<serde_json::Value>(&expected).is_ok_and(|expected| expected == header.config);
    let got = || header.config.to_string();
    if is_same { Ok(()) } else { Err(DataError::OtherRun { path: path.to_owned(), expected, got: got() }) }
}

/// Removes what a recording that was killed left half written: runs and tables under temporary names of [`files::partial`].
fn remove_partial(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_name().to_str().is_some_and(is_partial) && entry.file_type()?.is_file() {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Whether a file of this name is such a one.
fn is_partial(name: &str) -> bool {
    let Some((whole, random)) = name.strip_suffix(".partial").and_then(|name| name.rsplit_once('.')) else {
        return false;
    };
    let is_run = whole.strip_suffix(".mcap").and_then(|name| name.split_once('-')).is_some_and(|(number, rest)| {
        let is_number = number.len() >= 4 && number.bytes().all(|byte| byte.is_ascii_digit());
        is_number && Part::ALL.iter().any(|part| rest.starts_with(part.name()))
    });
    let is_random = !random.is_empty() && random.bytes().all(|byte| byte.is_ascii_alphanumeric());
    is_random && (is_run || whole == EPISODES_NAME)
}

/// What a run's header holds of an episode.
fn config(episode: &Episode, options: DataOptions) -> serde_json::Value {
    serde_json::json!({ "brake": episode, "hz": options.hz })
}

fn at_once() -> usize {
    AT_ONCE * rayon::current_num_threads()
}

/// Draws episodes until they are long enough; none if `watch` ends it.
fn rehearse(
    places: &mut Places,
    options: DataOptions,
    watch: &(impl Fn(usize, usize) -> bool + Sync),
) -> Result<Option<(DataReport, Vec<Recorded>)>, DataError> {
    let (mut report, mut drawn, mut frames) = (DataReport::default(), vec![], 0_u64);
    let mut planned = episodes(options.seed);
    let wanted = options.hours * 3600.0 * options.hz;
    let goes_on = |frames: u64| watch(frames as usize, wanted.ceil() as usize);
    while (frames as f64) < wanted {
        // No more than may be needed: each road that is opened takes a second.
        let missing = (wanted - frames as f64) / (SHORTEST_S * options.hz);
        let some: Vec<Episode> = planned.by_ref().take((missing.ceil() as usize).clamp(1, at_once())).collect();
        let roads: BTreeSet<&str> = some.iter().map(|episode| &*episode.track).collect();
        for roads in Vec::from_iter(roads).chunks(rayon::current_num_threads()) {
            if !goes_on(frames) {
                return Ok(None);
            }
            places.open(roads.iter().copied())?;
        }
        let places = &*places;
        let one = |episode: &Episode| goes_on(frames).then(|| of_use(places, episode, options)).transpose();
        let rehearsed = some.par_iter().map(one).collect::<Result<Option<Vec<_>>, DataError>>()?;
        let Some(rehearsed) = rehearsed else { return Ok(None) };
        for (episode, recorded) in some.iter().zip(rehearsed) {
            match recorded {
                Some(recorded) if (frames as f64) < wanted => {
                    frames += recorded.frames;
                    drawn.push(recorded);
                }
                None if options.wants(episode.part) => report.given_up += 1,
                _ => {}
            }
        }
    }
    Ok(Some((report, drawn)))
}

/// The first draw of an episode that is of use.
fn of_use(places: &Places, episode: &Episode, options: DataOptions) -> Result<Option<Recorded>, DataError> {
    for times in 0..DRAWS {
        let drawn = if times == 0 { episode.clone() } else { episode.redrawn(times) };
        let played = drive(places, &drawn, options, false, |_| Ok(()))?;
        if is_of_use(drawn.case.kind(), &played) {
            return Ok(Some(Recorded { episode: drawn, frames: played.frames, hit: played.hit_s.is_some() }));
        }
    }
    Ok(None)
}

fn is_of_use(kind: Kind, played: &Played) -> bool {
    match (kind, played.pressed_s) {
        (Kind::Hazard, Some(pressed_s)) => played.hit_s.is_none_or(|hit_s| hit_s - pressed_s >= PRESSED_BEFORE_S),
        (Kind::Hazard, None) => false,
        (Kind::Negative, pressed_s) => pressed_s.is_none() && played.hit_s.is_none(),
    }
}

/// Drives an episode with pictures and records it.
fn write(places: &Places, episode: &Episode, options: DataOptions, path: &Path) -> Result<(), DataError> {
    // A fixed time, as the same seed gives the same bytes.
    let started = jiff::Timestamp::UNIX_EPOCH;
    let config = config(episode, options);
    let header = RunHeader {
        name_hint: Some(episode.name.clone()),
        dialect: Some(Dialect::SelfOracle),
        seed: Some(episode.seed),
        ..RunHeader::new(RunKind::Driven, config, started)
    };
    let road = places.get(&episode.track)?.track().roadway();
    let mut run = RunFile::create(path, &header, [road].into())?;
    drive(places, episode, options, true, |shown| match shown {
        Shown::Turn(turn, _) => drive::items(turn).try_for_each(|item| run.write(turn.at(), item)),
        Shown::Event(at, event) => run.write(at, Item::Event(event)),
    })?;
    Ok(run.finish()?)
}

fn drive(
    places: &Places,
    episode: &Episode,
    options: DataOptions,
    pictures: bool,
    show: impl FnMut(Shown<'_>) -> Result<(), RecordingError>,
) -> Result<Played, DataError> {
    let mut world = episode.world(places, options.hz, pictures)?;
    Ok(play(&mut world, &mut Human::new(episode.temper()), show)?)
}

impl Episode {
    /// Its world, at so many telemetries a second, with or without pictures.
    pub(super) fn world(&self, places: &Places, hz: f64, pictures: bool) -> Result<Simulation, DataError> {
        let setup = self.staging().setup(places.get(&self.track)?)?;
        let world = Simulation::new(Setup { hz, ..setup })?;
        Ok(if pictures { world } else { world.seen_by(Blind) })
    }
}

/// The table of episodes.
fn csv(episodes: &[Recorded]) -> String {
    let mut text = format!("{HEADING}\n");
    for Recorded { episode, frames, hit } in episodes {
        let Episode { name, part, case, layer, track, speed_mph, reaction_s, seed } = episode;
        let kind = match case.kind() {
            Kind::Hazard => "hazard",
            Kind::Negative => "negative",
        };
        let hit = u8::from(*hit);
        writeln!(text, "{name},{part},{case},{kind},{layer},{seed},{track},{speed_mph},{reaction_s},{frames},{hit}")
            .expect("writing to a String cannot fail");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hazard_is_of_use_if_the_foot_is_down_in_time_and_a_negative_if_nothing_happens() {
        let of_use = |kind, pressed_s: Option<f64>, hit_s: Option<f64>| {
            is_of_use(kind, &Played { pressed_s, hit_s, ..Played::default() })
        };
        assert!(of_use(Kind::Hazard, Some(5.0), None) && of_use(Kind::Hazard, Some(5.0), Some(5.46)));
        assert!(!of_use(Kind::Hazard, Some(5.0), Some(5.44)) && !of_use(Kind::Hazard, None, None));
        assert!(of_use(Kind::Negative, None, None));
        assert!(!of_use(Kind::Negative, Some(5.0), None) && !of_use(Kind::Negative, None, Some(5.0)));
    }

    #[test]
    fn what_a_killed_recording_left_half_written_is_known_by_its_name() {
        for ours in ["0007-held-out-cpla-low-sun.mcap.a8Xk2P.partial", "12345-train-lap-rain.mcap.0.partial"] {
            assert!(is_partial(ours), "{ours}");
        }
        assert!(is_partial("episodes.csv.a8Xk2P.partial"));
        for other in [
            "0007-held-out-cpla-low-sun.mcap",
            "0007-held-out-cpla-low-sun.mcap.partial",
            "holiday.mcap.a8Xk2P.partial",
            "2026-11-29-lake.mcap.a8Xk2P.partial",
            "notes.csv.a8Xk2P.partial",
            ".partial",
        ] {
            assert!(!is_partial(other), "{other}");
        }
    }
}
