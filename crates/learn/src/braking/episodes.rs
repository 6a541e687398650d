//! The data set that `lapwing brake record` writes, read back.
//!
//! Labels are not stored: they follow from the pedal ([`labels`]), so that the same runs serve another rule.

use std::{
    collections::BTreeSet,
    fs, io,
    path::{Path, PathBuf},
};

use bytes::Bytes;
use rayon::prelude::*;

use super::Part;
use crate::nn::braking::{BrakingArchitecture, HZ};
use lapwing_core::{
    hash::sha256,
    perception::{self, Frame, ImageError, Preprocess, PreprocessError, Preprocessor},
    protocol::Truth,
    recording::{Break, EventRecord, Picture, Recording, RecordingError},
    units::{MPS_PER_KMH, Metres},
};
use lapwing_score::emergency::{LabelRule, Pressed, labels, pedal::brake};
use lapwing_sim::braking::{DataError, EPISODES_NAME, Episode, Picture as Shown, Places, retell};

/// The columns that are needed; others may stand beside them, in any order.
const COLUMNS: [&str; 6] = ["name", "part", "scenario", "kind", "layer", "reaction_s"];
/// One of those that may.
const FRAMES: &str = "frames";
const TRACK: &str = "track";

/// No episode is driven faster than this, in mph.
const FASTEST_MPH: f64 = 60.0;

/// A network with more numbers in a frame than this decodes pictures when it needs them: all of them would fill the memory.
const MOST_PIXELS: usize = 30_000;

/// Numbers of a run and of the same episode as it is driven again may differ by this much: telemetry rounds them.
const SAME: f64 = 0.02;

/// What the table says about an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Story {
    /// Its name, and that of its run without the ending.
    pub name: String,
    /// What it is for.
    pub part: Part,
    /// What happens.
    pub scenario: String,
    /// Whether something is hit unless the car brakes.
    pub hazard: bool,
    /// Weather, light, or what hides the danger.
    pub layer: String,
    /// From noticing to the foot, in seconds.
    pub reaction_s: f64,
    /// Its road, if the table tells.
    pub track: Option<String>,
    /// How many frames its run has, if the table tells.
    pub frames: Option<usize>,
}

/// An episode with its frames.
#[derive(Debug)]
pub struct Drive {
    /// What the table says.
    pub story: Story,
    /// Time of each frame, in seconds.
    pub at_s: Vec<f64>,
    /// Speed at it, in km/h.
    pub speed_kmh: Vec<f32>,
    /// The driver's pedal, 0 to 1.
    pub pedal: Vec<f64>,
    /// Time to collision, in seconds, as the telemetry tells it; long where it does not.
    pub until_s: Vec<f64>,
    /// The way to what is ahead, in metres, likewise.
    pub gap_m: Vec<f64>,
    /// Whether an emergency brake is due.
    pub due: Vec<bool>,
    /// At which frames the driver's foot goes down.
    pub onsets: Vec<usize>,
    /// When the car hit something, in seconds.
    pub impact_s: Option<f64>,
    /// What each frame shows, as the simulator knows it; none if it was not asked.
    pub(super) shown: Vec<Shown>,
    /// The settings in its run's header.
    config: serde_json::Value,
    pictures: Pictures,
}

#[derive(Debug)]
enum Pictures {
    /// As the network takes them, one after the other.
    Grey(Vec<u8>),
    /// As they were recorded.
    Jpeg(Vec<Bytes>),
}

/// Why a data set of braking cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BrakingDataError {
    /// The table cannot be read.
    #[error(
        "{}: expected the table of a data set of lapwing brake record, got an error: {source}{}",
        path.display(),
        help(path, source)
    )]
    Table {
        /// The table.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A heading without a column.
    #[error("{}: line 1: expected the columns {}, got {got:?}", path.display(), COLUMNS.join(", "))]
    Heading {
        /// The table.
        path: PathBuf,
        /// The heading.
        got: String,
    },
    /// A field that is not what its column says.
    #[error("{}: line {line}: {column}: expected {expected}, got {got:?}", path.display())]
    Field {
        /// The table.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// Which column.
        column: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
    /// No episode of a part.
    #[error("{}: expected episodes of the part {part}, got none", path.display())]
    NoEpisodes {
        /// The table.
        path: PathBuf,
        /// The part that is wanted.
        part: Part,
    },
    /// A run.
    #[error(transparent)]
    Run(#[from] RecordingError),
    /// A moment of a run.
    #[error("{}: moment {moment}: {why}", path.display())]
    Moment {
        /// The run.
        path: PathBuf,
        /// Which, from 0.
        moment: usize,
        /// What was expected, and what is there.
        why: String,
    },
    /// A run at another rate.
    #[error("{}: expected about {HZ} frames a second, got {got:.1}", path.display())]
    Rate {
        /// The run.
        path: PathBuf,
        /// Its own.
        got: f64,
    },
    /// A run that cannot be driven again.
    #[error("{}: {source}", path.display())]
    Again {
        /// The run.
        path: PathBuf,
        /// Why.
        source: Box<DataError>,
    },
    /// A run that is driven otherwise today.
    #[error("{}: frame {frame}: expected {what}: another version of Lapwing wrote it; record the data set anew", path.display())]
    Otherwise {
        /// The run.
        path: PathBuf,
        /// The frame that differs, from 0.
        frame: usize,
        /// What was expected, and what is there.
        what: String,
    },
    /// A run whose header is not of `lapwing brake record`.
    #[error("{}: brake in the header: expected an episode of lapwing brake record, got an error: {why}", path.display())]
    Header {
        /// The run.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// A run that is not of the episode in the table.
    #[error(
        "{}: expected {expected} frames, as in {EPISODES_NAME}, got {got}: the run and the table belong to different data sets; \
         record into an empty folder",
        path.display()
    )]
    Frames {
        /// The run.
        path: PathBuf,
        /// The table's.
        expected: usize,
        /// Its own.
        got: usize,
    },
}

/// What to do about a table that cannot be read.
fn help(path: &Path, source: &io::Error) -> String {
    match path.parent() {
        Some(folder) if source.kind() == io::ErrorKind::NotFound => {
            format!(": record one (lapwing brake record --out {})", folder.display())
        }
        _ => String::new(),
    }
}

/// SHA-256 of the rows of a data set's table that a training reads: held-out episodes may be added and removed.
pub(super) fn digest(folder: &Path) -> Result<String, BrakingDataError> {
    let read = rows(folder)?.into_iter().filter(|(story, _)| story.part != Part::HeldOut);
    Ok(sha256(read.map(|(_, row)| row).collect::<Vec<_>>().join("\n").as_bytes()))
}

/// Reads the table of a data set's folder.
///
/// # Errors
/// [`BrakingDataError::Table`], [`BrakingDataError::Heading`], [`BrakingDataError::Field`].
pub fn stories(folder: &Path) -> Result<Vec<Story>, BrakingDataError> {
    Ok(rows(folder)?.into_iter().map(|(story, _)| story).collect())
}

/// The same, each with its row as it stands in the table.
fn rows(folder: &Path) -> Result<Vec<(Story, String)>, BrakingDataError> {
    let path = folder.join(EPISODES_NAME);
    let text = fs::read_to_string(&path).map_err(|source| BrakingDataError::Table { path: path.clone(), source })?;
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let heading = lines.next().map_or("", |(_, line)| line);
    let names: Vec<&str> = heading.split(',').map(str::trim).collect();
    let column = |name: &str| names.iter().position(|n| *n == name);
    let [frames, track] = [FRAMES, TRACK].map(column);
    let found: Option<Vec<usize>> = COLUMNS.iter().map(|name| column(name)).collect();
    let found = found.ok_or_else(|| BrakingDataError::Heading { path: path.clone(), got: heading.to_owned() })?;
    let story = |(i, line): (usize, &str)| {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let at = |column: usize| fields.get(column).copied().unwrap_or_default();
        let field = |column: usize| at(found[column]);
        let no = |column, expected, got: &str| BrakingDataError::Field {
            path: path.clone(),
            line: i + 1,
            column,
            expected,
            got: got.to_owned(),
        };
        let wrong = |column: usize, expected| no(COLUMNS[column], expected, field(column));
        let name = field(0);
        if name.is_empty() || name.contains(['/', '\\']) || name.starts_with('.') {
            return Err(wrong(0, "the name of a run in this folder, without .mcap"));
        }
        let reaction_s = field(5).parse::<f64>().ok().filter(|s| (0.0..=10.0).contains(s));
        let count = |column| at(column).parse::<usize>().map_err(|_| no(FRAMES, "a whole number", at(column)));
        let story = Story {
            name: name.to_owned(),
            part: Part::named(field(1)).ok_or_else(|| wrong(1, "train, validation or held-out"))?,
            scenario: field(2).to_owned(),
            hazard: match field(3) {
                "hazard" => true,
                "negative" => false,
                _ => return Err(wrong(3, "hazard or negative")),
            },
            layer: field(4).to_owned(),
            reaction_s: reaction_s.ok_or_else(|| wrong(5, "seconds, 0 to 10"))?,
            track: track.map(|column| at(column).to_owned()),
            frames: frames.map(count).transpose()?,
        };
        Ok((story, line.to_owned()))
    };
    lines.map(story).collect()
}

/// Reads the episodes of a part, several at a time, at most so many, spread over all of them.
///
/// # Errors
/// [`BrakingDataError`].
pub fn load(
    folder: &Path,
    part: Part,
    most: usize,
    architecture: BrakingArchitecture,
) -> Result<Vec<Drive>, BrakingDataError> {
    let stories: Vec<Story> = stories(folder)?.into_iter().filter(|story| story.part == part).collect();
    if stories.is_empty() {
        return Err(BrakingDataError::NoEpisodes { path: folder.join(EPISODES_NAME), part });
    }
    let every = stories.len() as f64 / most.clamp(1, stories.len()) as f64;
    let taken: Vec<Story> =
        (0..most.clamp(1, stories.len())).map(|i| stories[(i as f64 * every) as usize].clone()).collect();
    let open = |story: Story| {
        let drive = Drive::open(folder, story, &architecture.preprocess())?;
        match (drive.story.frames, drive.frames()) {
            (Some(expected), got) if expected != got => {
                let path = folder.join(format!("{}.mcap", drive.story.name));
                Err(BrakingDataError::Frames { path, expected, got })
            }
            _ => Ok(drive),
        }
    };
    taken.into_par_iter().map(open).collect()
}

/// Asks the simulator what each frame of the drives of this folder shows.
pub(super) fn retell_all(folder: &Path, drives: &mut [Drive]) -> Result<(), BrakingDataError> {
    let path = |drive: &Drive| folder.join(format!("{}.mcap", drive.story.name));
    let all = drives
        .iter()
        .map(|drive| drawn(&drive.config).map_err(|why| BrakingDataError::Header { path: path(drive), why }))
        .collect::<Result<Vec<_>, _>>()?;
    let roads: BTreeSet<&str> = all.iter().flatten().map(|(episode, _)| &*episode.track).collect();
    let mut places = Places::default();
    let again = |path: PathBuf, source: DataError| BrakingDataError::Again { path, source: Box::new(source) };
    places.open(roads).map_err(|why| again(folder.to_owned(), why.into()))?;
    drives.par_iter_mut().zip(&all).try_for_each(|(drive, drawn)| {
        let Some((episode, hz)) = drawn else { return Ok(()) };
        let path = path(drive);
        drive.shown = retell(&places, episode, *hz).map_err(|source| again(path.clone(), source))?;
        drive.check_shown(&path)
    })
}

impl Drive {
    /// Reads an episode's run.
    pub(super) fn open(folder: &Path, story: Story, preprocess: &Preprocess) -> Result<Self, BrakingDataError> {
        let path = folder.join(format!("{}.mcap", story.name));
        let [channels, height, width] = preprocess.shape();
        let mut reader = Reader::new(preprocess.clone()).map_err(|why| wrong(&path, 0, why.to_string()))?;
        let keeps_grey = channels * height * width <= MOST_PIXELS;
        let mut drive = Self {
            story,
            at_s: vec![],
            speed_kmh: vec![],
            pedal: vec![],
            until_s: vec![],
            gap_m: vec![],
            due: vec![],
            onsets: vec![],
            impact_s: None,
            shown: vec![],
            config: serde_json::Value::Null,
            pictures: if keeps_grey { Pictures::Grey(vec![]) } else { Pictures::Jpeg(vec![]) },
        };
        let recording = Recording::open(&path)?;
        let kind = recording.header().kind;
        drive.config = recording.header().config.clone();
        for (i, moment) in recording.enumerate() {
            let moment = moment?;
            let hit = moment.before.iter().find(|(_, event)| matches!(event, EventRecord::Collision { .. }));
            if let (None, Some((at, _))) = (drive.impact_s, hit) {
                drive.impact_s = Some(at.as_secs_f64());
            }
            // Only the first of several drives: what comes after a break is another one.
            if i > 0 && !matches!(moment.broken, None | Some(Break::Unseen(_))) {
                break;
            }
            let Some(Picture::Jpeg(jpeg)) = &moment.pictures[0] else {
                return Err(wrong(&path, i, "expected a picture, got none".into()));
            };
            match &mut drive.pictures {
                Pictures::Grey(bytes) => {
                    reader.read(jpeg, bytes).map_err(|why| wrong(&path, i, why.to_string()))?;
                }
                Pictures::Jpeg(kept) => kept.push(jpeg.clone()),
            }
            drive.at_s.push(moment.at.as_secs_f64());
            drive.speed_kmh.push((moment.telemetry.speed.metres_per_second().get() / MPS_PER_KMH) as f32);
            drive.pedal.push(brake(&moment, kind).unwrap_or(0.0));
            let truth = &moment.telemetry.truth;
            drive.until_s.push(truth.time_to_collision_s.unwrap_or(Truth::CLEAR_S));
            drive.gap_m.push(truth.gap.map_or(Truth::CLEAR_M, Metres::get));
        }
        drive.check_rate(&path)?;
        drive.label(LabelRule::default());
        Ok(drive)
    }

    fn check_rate(&self, path: &Path) -> Result<(), BrakingDataError> {
        let (Some(first), Some(last)) = (self.at_s.first(), self.at_s.last()) else { return Ok(()) };
        let got = (self.at_s.len() - 1) as f64 / (last - first);
        if self.at_s.len() > 1 && !(0.9 * HZ..=1.1 * HZ).contains(&got) {
            return Err(BrakingDataError::Rate { path: path.to_owned(), got });
        }
        Ok(())
    }

    /// Checks that the drive that was driven again is the recorded one.
    fn check_shown(&self, path: &Path) -> Result<(), BrakingDataError> {
        let differs = |frame, expected: String, got: String| {
            let what = format!("{expected}, as it is driven today, got {got}");
            Err(BrakingDataError::Otherwise { path: path.to_owned(), frame, what })
        };
        for (frame, shown) in self.shown.iter().enumerate().take(self.frames()) {
            let speed_mps = f64::from(self.speed_kmh[frame]) * MPS_PER_KMH;
            for (what, told, recorded) in [
                ("a speed in m/s of", shown.speed_mps, speed_mps),
                ("a time to collision in s of", shown.until_s, self.until_s[frame]),
                ("a gap in m of", shown.gap_m, self.gap_m[frame]),
            ] {
                if (recorded - told).abs() > SAME {
                    return differs(frame, format!("{what} {told:.2}"), format!("{recorded:.2}"));
                }
            }
        }
        let (told, recorded) = (self.shown.len(), self.frames());
        if told == recorded {
            Ok(())
        } else {
            differs(told.min(recorded), format!("{told} frames in all"), recorded.to_string())
        }
    }

    fn label(&mut self, rule: LabelRule) {
        let pressed =
            |i: usize| Pressed { at_s: self.at_s[i], speed_kmh: f64::from(self.speed_kmh[i]), pedal: self.pedal[i] };
        let pressed: Vec<Pressed> = (0..self.frames()).map(pressed).collect();
        let braked = labels(&pressed, rule);
        self.due = braked.labels.iter().map(|label| label.due).collect();
        self.onsets = braked.events;
    }

    /// How many frames it has.
    pub fn frames(&self) -> usize {
        self.at_s.len()
    }

    /// Adds frames, as the network takes them, to `out`: each of the network's rows and columns, one byte a pixel.
    ///
    /// # Errors
    /// [`BrakingDataError::Moment`] if a picture cannot be decoded.
    pub fn pictures(
        &self,
        from: usize,
        count: usize,
        reader: &mut Reader,
        out: &mut Vec<u8>,
    ) -> Result<(), BrakingDataError> {
        match &self.pictures {
            Pictures::Grey(bytes) => {
                let pixels = bytes.len() / self.frames().max(1);
                out.extend_from_slice(&bytes[from * pixels..(from + count) * pixels]);
            }
            Pictures::Jpeg(kept) => {
                for (i, jpeg) in kept.iter().enumerate().skip(from).take(count) {
                    let name = PathBuf::from(&self.story.name);
                    reader.read(jpeg, out).map_err(|why| wrong(&name, i, why.to_string()))?;
                }
            }
        }
        Ok(())
    }

    /// A drive of these speeds and labels whose pictures are of noise around one shade, for tests.
    #[cfg(test)]
    pub(super) fn made(story: Story, speed_kmh: Vec<f32>, pedal: Vec<f64>, pixels: usize, shade: u8) -> Self {
        let frames = pedal.len();
        let mut drive = Self {
            story,
            at_s: (0..frames).map(|i| i as f64 / HZ).collect(),
            speed_kmh,
            pedal,
            until_s: vec![Truth::CLEAR_S; frames],
            gap_m: vec![Truth::CLEAR_M; frames],
            due: vec![],
            onsets: vec![],
            impact_s: None,
            shown: vec![],
            config: serde_json::Value::Null,
            pictures: Pictures::Grey((0..frames * pixels).map(|i| shade ^ noise(i)).collect()),
        };
        drive.label(LabelRule::default());
        drive
    }
}

/// Any byte, always the same of a number.
#[cfg(test)]
fn noise(i: usize) -> u8 {
    let mixed = (i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (mixed >> 56) as u8 & 0x3F
}

/// What `lapwing brake record` leaves in a run's header; none in a run of another command.
fn drawn(config: &serde_json::Value) -> Result<Option<(Episode, f64)>, String> {
    let Some(episode) = config.get("brake").filter(|brake| brake.is_object()) else { return Ok(None) };
    let episode: Episode = serde_json::from_value(episode.clone()).map_err(|why| why.to_string())?;
    let speed_mph = episode.speed_mph;
    if !(speed_mph > 0.0 && speed_mph <= FASTEST_MPH) {
        return Err(format!("speed_mph: expected a number above 0, up to {FASTEST_MPH}, got {speed_mph}"));
    }
    let hz = config.get("hz").and_then(serde_json::Value::as_f64).unwrap_or(HZ);
    if !(0.9 * HZ..=1.1 * HZ).contains(&hz) {
        return Err(format!("hz: expected about {HZ}, got {hz}"));
    }
    Ok(Some((episode, hz)))
}

fn wrong(path: &Path, moment: usize, why: String) -> BrakingDataError {
    BrakingDataError::Moment { path: path.to_owned(), moment, why }
}

/// Turns pictures into what a braking network takes, with its scratch memory.
#[derive(Debug, Clone)]
pub struct Reader {
    preprocessor: Preprocessor,
    frame: Frame,
    scaled: Vec<f32>,
}

/// Why a picture cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum Unreadable {
    #[error("{0}")]
    Image(#[from] ImageError),
    #[error("{0}")]
    Preprocess(#[from] PreprocessError),
}

impl Reader {
    /// A reader for this preprocessing, whose pixels go from 0 to 1.
    ///
    /// # Errors
    /// That of an invalid preprocessing.
    pub fn new(preprocess: Preprocess) -> Result<Self, PreprocessError> {
        Ok(Self { preprocessor: Preprocessor::new(preprocess)?, frame: Frame::default(), scaled: vec![] })
    }

    /// Adds a picture's pixels, rounded to bytes, so that learning and driving see the same.
    pub(super) fn read(&mut self, jpeg: &[u8], out: &mut Vec<u8>) -> Result<(), Unreadable> {
        perception::decode_jpeg(jpeg, &mut self.frame)?;
        self.preprocessor.apply(&self.frame, &mut self.scaled)?;
        out.extend(self.scaled.iter().map(|x| (x * 255.0).round() as u8));
        Ok(())
    }

    /// A decoded frame's pixels, whole numbers from 0 to 255.
    pub(super) fn see(&mut self, frame: &Frame) -> Result<&[f32], PreprocessError> {
        self.preprocessor.apply(frame, &mut self.scaled)?;
        self.scaled.iter_mut().for_each(|x| *x = (*x * 255.0).round());
        Ok(&self.scaled)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Where the run lies that comes with the program.
    pub(in crate::braking) fn shipped_runs() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../recordings")
    }

    /// That run, for the live network.
    pub(in crate::braking) fn shipped_run() -> Drive {
        let story = Story {
            name: "lake".into(),
            part: Part::Train,
            scenario: String::new(),
            hazard: false,
            layer: String::new(),
            reaction_s: 1.0,
            track: None,
            frames: None,
        };
        Drive::open(&shipped_runs(), story, &BrakingArchitecture::Live.preprocess()).unwrap()
    }

    fn read(table: &str) -> Result<Vec<Story>, String> {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join(EPISODES_NAME), table).unwrap();
        stories(dir.path()).map_err(|e| e.to_string().replace(&dir.path().display().to_string(), "DIR"))
    }

    #[test]
    fn the_table_is_read_whatever_the_order_of_its_columns() {
        let stories = read(
            "name,part,scenario,kind,layer,seed,track,speed_mph,reaction_s,frames,hit\n\
             a,train,ccrs,hazard,plain,1,lake,20,0.9,300,0\nb,held-out,bend,negative,night,2,lake,20,1.1,300,0\n",
        )
        .unwrap();
        assert_eq!((stories[0].part, stories[0].hazard, stories[0].reaction_s), (Part::Train, true, 0.9));
        assert_eq!((stories[0].frames, stories[0].track.as_deref()), (Some(300), Some("lake")));
        assert_eq!((stories[1].part, stories[1].hazard, stories[1].layer.as_str()), (Part::HeldOut, false, "night"));
    }

    #[test]
    fn what_is_wrong_with_the_table_is_named() {
        let error = read("name,part\na,train\n").unwrap_err();
        assert!(error.contains("expected the columns name, part, scenario, kind, layer, reaction_s"), "{error}");
        let heading = "name,part,scenario,kind,layer,reaction_s\n";
        for (line, expected) in [
            ("a,test,x,hazard,plain,1", "line 2: part: expected train, validation or held-out, got \"test\""),
            ("a,train,x,danger,plain,1", "line 2: kind: expected hazard or negative, got \"danger\""),
            ("../a,train,x,hazard,plain,1", "line 2: name: expected the name of a run in this folder"),
            ("a,train,x,hazard,plain,soon", "line 2: reaction_s: expected seconds, 0 to 10, got \"soon\""),
        ] {
            let error = read(&format!("{heading}{line}\n")).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        let error = read("frames,name,part,scenario,kind,layer,reaction_s\nall,a,train,x,hazard,plain,1").unwrap_err();
        assert!(error.contains("line 2: frames: expected a whole number, got \"all\""), "{error}");
    }

    #[test]
    fn episodes_to_judge_by_may_be_added_to_a_data_set_that_is_learnt_from() {
        let dir = tempfile::tempdir().unwrap();
        let of = |rows: &[&str]| {
            let table = format!("name,part,scenario,kind,layer,reaction_s\n{}\n", rows.join("\n"));
            fs::write(dir.path().join(EPISODES_NAME), table).unwrap();
            digest(dir.path()).unwrap()
        };
        let [train, validation] = ["a,train,ccrs,hazard,plain,1", "c,validation,ccrs,hazard,plain,1"];
        let alone = of(&[train, validation]);
        assert_eq!(of(&[train, "b,held-out,ccrs,hazard,plain,1", validation]), alone);
        assert_ne!(of(&[train]), alone);
        assert_ne!(of(&[train, validation, "d,train,lap,negative,plain,1"]), alone);
    }

    #[test]
    fn a_part_without_episodes_is_called_as_in_the_table() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join(EPISODES_NAME), "name,part,scenario,kind,layer,reaction_s\n").unwrap();
        for part in ["train", "validation", "held-out"] {
            let wanted = Part::named(part).unwrap();
            let error = load(dir.path(), wanted, 1, BrakingArchitecture::Live).unwrap_err().to_string();
            assert!(error.ends_with(&format!("expected episodes of the part {part}, got none")), "{error}");
        }
    }

    #[test]
    fn a_run_that_is_longer_or_shorter_than_the_table_says_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        fs::copy(shipped_runs().join("lake.mcap"), dir.path().join("lake.mcap")).unwrap();
        let load = |frames: &str| {
            let table =
                format!("name,part,scenario,kind,layer,reaction_s,frames\nlake,train,lap,negative,plain,1,{frames}\n");
            fs::write(dir.path().join(EPISODES_NAME), table).unwrap();
            load(dir.path(), Part::Train, 1, BrakingArchitecture::Live)
        };
        assert_eq!(load("225").unwrap()[0].frames(), 225);
        let error = load("207").unwrap_err().to_string();
        assert!(error.contains("lake.mcap: expected 207 frames, as in episodes.csv, got 225"), "{error}");
    }

    #[test]
    fn a_run_is_read_with_its_frames_and_labels() {
        let (drive, preprocess) = (shipped_run(), BrakingArchitecture::Live.preprocess());
        assert_eq!((drive.frames(), drive.due.iter().any(|due| *due)), (225, false));
        let mut pixels = vec![];
        drive.pictures(3, 2, &mut Reader::new(preprocess).unwrap(), &mut pixels).unwrap();
        assert_eq!(pixels.len(), 2 * 80 * 320);
        assert!(pixels.iter().any(|pixel| *pixel != pixels[0]), "a picture of the road");
    }

    #[test]
    fn a_drive_that_goes_otherwise_today_or_has_an_impossible_header_is_refused() {
        let mut drive = crate::braking::windows::tests::drive();
        let told = |speed_kmh: &f32| Shown {
            outlines: vec![],
            course: [0.0; 3],
            speed_mps: f64::from(*speed_kmh) * MPS_PER_KMH,
            until_s: Truth::CLEAR_S,
            gap_m: Truth::CLEAR_M,
        };
        drive.shown = drive.speed_kmh.iter().map(told).collect();
        drive.check_shown(Path::new("a.mcap")).unwrap();
        drive.shown[7].gap_m = 12.0;
        let error = drive.check_shown(Path::new("a.mcap")).unwrap_err().to_string();
        assert!(
            error.starts_with("a.mcap: frame 7: expected a gap in m of 12.00, as it is driven today, got"),
            "{error}"
        );
        drive.shown.truncate(5);
        let error = drive.check_shown(Path::new("a.mcap")).unwrap_err().to_string();
        assert!(
            error.starts_with("a.mcap: frame 5: expected 5 frames in all, as it is driven today, got 300"),
            "{error}"
        );

        let header = |brake: &str| drawn(&serde_json::from_str(&format!("{{\"brake\": {brake}, \"hz\": 0}}")).unwrap());
        assert_eq!(header("null"), Ok(None));
        assert!(header("{}").unwrap_err().contains("missing field"));
        let episode = lapwing_sim::braking::episodes(0).next().unwrap();
        let text = serde_json::to_string(&episode).unwrap();
        assert_eq!(header(&text).unwrap_err(), "hz: expected about 15, got 0");
    }
}
