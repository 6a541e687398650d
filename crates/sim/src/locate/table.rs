//! Where a car was in each picture of a recording, as a table in a file: written by whoever knows it, such as `lapwing
//! locate`, and read to label the recording or to drive along it.

use std::{
    cmp::Reverse,
    fs, io,
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use super::{InLane, Located, LocatedDrive, Pose};
use crate::track::{Track, TrackError};
use lapwing_core::recording::{Recording, RecordingError};

/// The first columns, which are those that are read; more may follow.
pub const COLUMNS: [&str; 7] = ["moment", "at_s", "track", "reversed", "place_m", "offset_m", "heading_deg"];

/// Times since the first row may differ by so many seconds, which is less than there is between two pictures.
const SAME_TIME_S: f64 = 0.05;

/// What to do about a table of another recording.
const MAKE_AGAIN: &str = "make it again with `lapwing locate --csv`";
/// The same, if it is to be the truth, which `lapwing locate` only estimates.
const FIND_TRUTH: &str = "give the lane.csv that `lapwing record` wrote beside this recording";

/// A table that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LaneTableError {
    /// The file.
    #[error("{}: expected the table that `lapwing locate --csv` writes, got an error: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A heading without one of the columns.
    #[error("{}: expected the column {column:?}, as `lapwing locate --csv` writes it, got {got:?}", path.display())]
    Column {
        /// The file.
        path: PathBuf,
        /// The column.
        column: &'static str,
        /// The heading.
        got: String,
    },
    /// A field that is not what its column says.
    #[error("{}: line {line}: {column}: expected {expected}, got {got:?}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The column.
        column: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
    /// No place at all.
    #[error("{}: expected places in a lane, got {rows} rows without one", path.display())]
    NoPlace {
        /// The file.
        path: PathBuf,
        /// Rows of the table.
        rows: usize,
    },
    /// The road that it names.
    #[error("{}: {source}{}", path.display(), own_road(source))]
    Track {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: Box<TrackError>,
    },
    /// The recording that it should be of.
    #[error("{0}")]
    Recording(Box<RecordingError>),
    /// A table that was made of another recording.
    #[error(
        "{}: expected the places of the {pictures} pictures of {}, got {rows} rows of other moments: {help}",
        path.display(), recording.display()
    )]
    OtherRecording {
        /// The file.
        path: PathBuf,
        /// The recording.
        recording: PathBuf,
        /// Moments of the recording with a picture.
        pictures: usize,
        /// Rows of the table.
        rows: usize,
        /// What to do.
        help: &'static str,
    },
}

/// What to do about a road that is not known.
fn own_road(error: &TrackError) -> &'static str {
    if matches!(error, TrackError::Unknown { .. }) {
        "; if it is a road of your own, name its file with --track, or track in a recipe"
    } else {
        ""
    }
}

impl LaneTableError {
    /// The same, of a table that was given as the truth.
    pub fn of_truth(mut self) -> Self {
        if let Self::OtherRecording { help, .. } = &mut self {
            *help = FIND_TRUTH;
        }
        self
    }
}

impl From<RecordingError> for LaneTableError {
    fn from(error: RecordingError) -> Self {
        Self::Recording(Box::new(error))
    }
}

/// A recording's places on the roads that its pictures show: several, if drives of several are joined in it.
#[derive(Debug, Clone)]
pub struct LaneTable {
    /// The road that most of its pictures show.
    pub track: Arc<Track>,
    /// The moment of each picture, counted from 0, and the pose in it; `None` where none on this road is known.
    pub rows: Vec<(usize, Option<Pose>)>,
    /// Pictures of roads that cannot be opened, whose poses are left out.
    pub elsewhere: usize,
    /// The other roads, that of most pictures first, and the pose on each in each picture.
    others: Vec<(Arc<Track>, Vec<Option<Pose>>)>,
    /// The time of each picture, in seconds.
    times_s: Vec<f64>,
}

/// A line of the table: moment, time, and road, whether it is driven against its direction, place, offset and heading.
type Line = (usize, f64, Option<(String, bool, [f64; 3])>);

impl LaneTable {
    /// Reads the table that `lapwing locate --csv` writes. `road` is the track of a name, as [`Track::open`] has it.
    ///
    /// # Errors
    /// [`LaneTableError`].
    pub fn read(path: &Path, road: impl Fn(&str) -> Result<Track, TrackError>) -> Result<Self, LaneTableError> {
        let text = fs::read_to_string(path).map_err(|source| LaneTableError::Read { path: path.to_owned(), source })?;
        // A spreadsheet may have put a byte order mark before it.
        let lines = lines(path, text.trim_start_matches('\u{feff}'))?;
        let named = |name: &str| lines.iter().filter(|(.., at)| at.as_ref().is_some_and(|at| at.0 == name)).count();
        let names = lines.iter().filter_map(|(.., at)| at.as_ref().map(|at| at.0.as_str()));
        let mut roads: Vec<&str> = names.collect();
        roads.sort_unstable();
        roads.dedup();
        roads.sort_by_cached_key(|name| Reverse(named(name)));
        let Some((name, others)) = roads.split_first() else {
            return Err(LaneTableError::NoPlace { path: path.to_owned(), rows: lines.len() });
        };
        let wrong = |source| LaneTableError::Track { path: path.to_owned(), source: Box::new(source) };
        let track = Arc::new(road(name).map_err(wrong)?);
        let poses = |name: &str, track: &Track| -> Vec<Option<Pose>> {
            let on = |(.., at): &Line| {
                let (_, reversed, numbers) = at.as_ref().filter(|at| at.0 == name)?;
                Some(pose(track, *reversed, *numbers))
            };
            lines.iter().map(on).collect()
        };
        let rows = lines.iter().map(|(moment, ..)| *moment).zip(poses(name, &track)).collect();
        let others = others.iter().filter_map(|name| {
            let track = road(name).ok()?;
            let poses = poses(name, &track);
            Some((Arc::new(track), poses))
        });
        let others: Vec<(Arc<Track>, Vec<Option<Pose>>)> = others.collect();
        let known = others.iter().flat_map(|(_, poses)| poses).flatten().count();
        let elsewhere = lines.iter().filter(|(.., at)| at.is_some()).count() - named(name) - known;
        let times_s = lines.iter().map(|(_, at_s, _)| *at_s).collect();
        Ok(Self { track, rows, elsewhere, others, times_s })
    }

    /// The same, of this recording: a row for each moment with a picture, taken then.
    ///
    /// # Errors
    /// [`LaneTableError`], [`LaneTableError::OtherRecording`] among them.
    pub fn of(
        recording: &Path,
        path: &Path,
        road: impl Fn(&str) -> Result<Track, TrackError>,
    ) -> Result<Self, LaneTableError> {
        let table = Self::read(path, road)?;
        let seen = Recording::open(recording)?.seen();
        let pictures: Vec<(usize, f64)> =
            seen.map(|moment| moment.map(|m| (m.row, m.at.as_secs_f64()))).collect::<Result<_, _>>()?;
        let first = |times: Option<f64>| times.unwrap_or_default();
        let began_s = first(pictures.first().map(|(_, at_s)| *at_s)) - first(table.times_s.first().copied());
        let is_same = table.rows.len() == pictures.len()
            && pictures.iter().zip(table.rows.iter().zip(&table.times_s)).all(|(picture, ((moment, _), at_s))| {
                picture.0 == *moment && (picture.1 - at_s - began_s).abs() <= SAME_TIME_S
            });
        if is_same {
            return Ok(table);
        }
        let (path, recording, rows) = (path.to_owned(), recording.to_owned(), table.rows.len());
        Err(LaneTableError::OtherRecording { path, recording, pictures: pictures.len(), rows, help: MAKE_AGAIN })
    }

    /// The roads, that of most pictures first.
    pub fn tracks(&self) -> impl Iterator<Item = &Arc<Track>> {
        std::iter::once(&self.track).chain(self.others.iter().map(|(track, _)| track))
    }

    /// The moments in which a pose is known, each with its road and the pose there.
    pub fn known(&self) -> impl Iterator<Item = (usize, (&Arc<Track>, Pose))> {
        let here = self.rows.iter().filter_map(move |(moment, pose)| Some((*moment, (&self.track, (*pose)?))));
        let there = self.others.iter().flat_map(move |(track, poses)| {
            self.rows.iter().zip(poses).filter_map(move |((moment, _), pose)| Some((*moment, (track, (*pose)?))))
        });
        here.chain(there)
    }

    /// For each road all drives on it, as one: where another road was driven, no place is known. In the order of
    /// [`tracks`](Self::tracks).
    pub fn drives(&self) -> Vec<LocatedDrive> {
        let place = |pose: &Option<Pose>| pose.map(Located::known);
        let here = self.rows.iter().map(|(_, pose)| place(pose)).collect();
        let here = LocatedDrive { track: Arc::clone(&self.track), places: here };
        let there = self.others.iter().map(|(track, poses)| {
            let places = poses.iter().map(place).collect();
            LocatedDrive { track: Arc::clone(track), places }
        });
        std::iter::once(here).chain(there).collect()
    }

    /// The drive, to be driven along, as far as its moments are in `moments`: on the road that most of these show.
    pub fn drive(&self, moments: Range<usize>) -> LocatedDrive {
        let mut drives = self.drives();
        for drive in &mut drives {
            let beyond = self.rows.iter().zip(&mut drive.places).filter(|((moment, _), _)| !moments.contains(moment));
            beyond.for_each(|(_, place)| *place = None);
        }
        // `max_by_key` takes the last of several that are equal: reversed, that is the first road.
        let most = drives.into_iter().rev().max_by_key(|drive| drive.places.iter().flatten().count());
        most.unwrap_or_else(|| LocatedDrive { track: Arc::clone(&self.track), places: vec![] })
    }
}

fn pose(track: &Track, reversed: bool, [place_m, offset_m, heading_deg]: [f64; 3]) -> Pose {
    Pose::from_lane(track, place_m, reversed, offset_m, heading_deg.to_radians())
}

fn lines(path: &Path, text: &str) -> Result<Vec<Line>, LaneTableError> {
    let mut lines = text.lines().enumerate();
    let heading = lines.next().map_or("", |(_, heading)| heading);
    let columns = fields(heading);
    let column = |column: &'static str| {
        let missing = || LaneTableError::Column { path: path.to_owned(), column, got: heading.to_owned() };
        columns.iter().position(|name| name == column).ok_or_else(missing)
    };
    let [moment, at_s, track, reversed, place, offset, heading_deg] = {
        let mut at = [0; 7];
        for (at, name) in at.iter_mut().zip(COLUMNS) {
            *at = column(name)?;
        }
        at
    };
    lines
        .map(|(i, text)| {
            let fields = fields(text);
            let field = |at: usize| fields.get(at).map_or("", String::as_str);
            let wrong = |column: usize, expected: &'static str, got: &str| LaneTableError::Field {
                path: path.to_owned(),
                line: i + 1,
                column: COLUMNS[column],
                expected,
                got: got.to_owned(),
            };
            let count = field(moment).parse().map_err(|_| wrong(0, "a whole number", field(moment)))?;
            let number = |column: usize, at: usize| {
                let number = field(at).parse().ok().filter(|number: &f64| number.is_finite());
                number.ok_or_else(|| wrong(column, "a number", field(at)))
            };
            let at_s = number(1, at_s)?;
            if field(track).is_empty() {
                return Ok((count, at_s, None));
            }
            let against = field(reversed).parse().map_err(|_| wrong(3, "true or false", field(reversed)))?;
            let within = |column: usize, at: usize, most: f64, expected: &'static str| {
                let number = number(column, at)?;
                (number.abs() <= most).then_some(number).ok_or_else(|| wrong(column, expected, field(at)))
            };
            let numbers = [
                within(4, place, 1e5, "metres along the road")?,
                within(5, offset, 100.0, "at most 100 m to either side")?,
                within(6, heading_deg, 180.0, "at most 180 degrees to either side")?,
            ];
            Ok((count, at_s, Some((field(track).to_owned(), against, numbers))))
        })
        .collect()
}

/// The fields of a line; one in quotes may contain commas, and quotes written twice.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![];
    let mut field = String::new();
    let mut quoted = false;
    let mut chars = line.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '"' if quoted && chars.next_if_eq(&'"').is_some() => field.push('"'),
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(std::mem::take(&mut field)),
            c => field.push(c),
        }
    }
    fields.push(field);
    fields
}

/// The heading of a table of [`COLUMNS`] alone.
pub fn heading() -> String {
    COLUMNS.join(",") + "\n"
}

/// A line of such a table: the moment, its time, and where the car is on the track, if that is known.
pub fn line(moment: usize, at_s: f64, track: &Track, pose: Option<Pose>) -> String {
    cells(moment, at_s, track, pose) + "\n"
}

/// The same, to be followed by more cells.
pub fn cells(moment: usize, at_s: f64, track: &Track, pose: Option<Pose>) -> String {
    let Some(pose) = pose else { return format!("{moment},{at_s:.3},,,,,") };
    let name = &track.file().name;
    let is_plain = !name.contains([',', '"', '\n', '\r']);
    let name = if is_plain { name.to_owned() } else { format!("\"{}\"", name.replace('"', "\"\"")) };
    let InLane { offset_m, heading_rad, .. } = pose.in_lane(track);
    let (place_m, heading_deg) = (pose.s_m.rem_euclid(track.length()), heading_rad.to_degrees());
    format!("{moment},{at_s:.3},{name},{},{place_m:.3},{offset_m:.4},{heading_deg:.3}", pose.direction() < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<LaneTable, LaneTableError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("lane.csv");
        fs::write(&path, text).unwrap();
        LaneTable::read(&path, Track::open)
    }

    #[test]
    fn poses_read_back_as_they_were_written_whichever_way_round() {
        let track = Track::named("jungle").unwrap();
        let there = Pose { s_m: 100.0, offset_m: 1.9, heading_rad: 0.1, pitch_rad: 0.0 };
        let back = Pose { s_m: 200.0, offset_m: -1.2, heading_rad: 3.0, pitch_rad: 0.0 };
        let lines = [Some(there), None, Some(back)].into_iter().enumerate();
        let text = lines.fold(heading(), |text, (i, pose)| text + &line(i, 0.1 * i as f64, &track, pose));
        let table = read(&text).unwrap();
        assert_eq!((table.track.file().name.as_str(), table.elsewhere), ("jungle", 0));
        assert_eq!(table.rows.iter().map(|(moment, _)| *moment).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(table.rows[1].1, None);
        assert_eq!(read(&format!("\u{feff}{text}")).unwrap().rows, table.rows);
        for ((_, got), expected) in [table.rows[0], table.rows[2]].into_iter().zip([there, back]) {
            let (got, expected) = (got.unwrap().in_lane(&track), expected.in_lane(&track));
            assert!((got.offset_m - expected.offset_m).abs() < 1e-3, "{got:?} {expected:?}");
            assert!((got.heading_rad - expected.heading_rad).abs() < 1e-3, "{got:?} {expected:?}");
        }
    }

    #[test]
    fn of_roads_that_are_joined_each_picture_has_its_own() {
        let [lake, jungle] = ["lake", "jungle"].map(|name| Track::named(name).unwrap());
        let on = |i: usize| if i < 5 { &lake } else { &jungle };
        let at = |i: usize| Pose { s_m: 10.0 + i as f64, offset_m: 0.5, ..Pose::default() };
        let text = (0..8).fold(heading(), |text, i| text + &line(i, 0.1 * i as f64, on(i), (i != 6).then(|| at(i))));
        let table = read(&text).unwrap();
        let roads: Vec<String> = table.drives().iter().map(|drive| drive.track.file().name.clone()).collect();
        assert_eq!((roads.join(", ").as_str(), table.elsewhere), ("lake, jungle", 0));
        let known: Vec<_> = table.known().collect();
        assert_eq!(known.iter().map(|(moment, _)| *moment).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 7]);
        for (moment, (track, pose)) in known {
            assert_eq!(track.file().name, on(moment).file().name, "{moment}");
            assert!((pose.s_m - at(moment).s_m).abs() < 1e-3 && (pose.offset_m - 0.5).abs() < 1e-3, "{pose:?}");
        }
        // Of some moments it is the road that these show.
        let part = table.drive(4..8);
        assert_eq!(part.track.file().name, "jungle");
        let places: Vec<bool> = part.places.iter().map(Option::is_some).collect();
        assert_eq!(places, [false, false, false, false, false, true, false, true]);
    }

    #[test]
    fn pictures_of_a_road_that_cannot_be_opened_are_left_out_and_counted() {
        let text = "moment,at_s,track,reversed,place_m,offset_m,heading_deg,agreement\n\
                    3,0.0,lake,false,10.0,0.1,1.0,0.5\n4,0.1,moon,false,1.0,0.0,0.0,0.5\n5,0.2,lake,true,20.0,0,0,1\n";
        let table = read(text).unwrap();
        assert_eq!((table.elsewhere, table.rows[1].1.is_none(), table.rows[2].0), (1, true, 5));
        assert!(table.rows[2].1.unwrap().direction() < 0.0);
        let places = table.drive(0..5).places;
        assert!(places[0].is_some() && places[2].is_none(), "only the moments asked for");
    }

    #[test]
    fn what_is_wrong_is_named() {
        let error = |text: &str| read(text).unwrap_err().to_string();
        assert!(error("").contains("expected the column \"moment\""));
        assert!(error("moment,at_s,track\n").contains("expected the column \"reversed\""));
        assert!(error(&(heading() + "x,,,,,,\n")).contains("line 2: moment: expected a whole number, got \"x\""));
        assert!(error(&(heading() + "1,0,lake,no,1,1,1\n")).contains("line 2: reversed: expected true or false"));
        assert!(error(&(heading() + "1,0,lake,true,1,nan,1\n")).contains("line 2: offset_m: expected a number"));
        let far = error(&(heading() + "1,0,lake,true,1,1e9,1\n"));
        assert!(far.contains("line 2: offset_m: expected at most 100 m to either side, got"), "{far}");
        let turned = error(&(heading() + "1,0,lake,true,1,1,400\n"));
        assert!(turned.contains("line 2: heading_deg: expected at most 180 degrees to either side"), "{turned}");
        assert!(error(&(heading() + "1,0,,,,,\n")).contains("expected places in a lane, got 1 rows without one"));
        assert!(error(&(heading() + "1,0,moon,true,1,1,1\n")).contains("moon"));
    }
}
