//! Brake pedal and speed over time: of a run, a driving log, or a table.
//!
//! A run and a driving log tell the brake; where they do not, it is what a pilot's throttle asked for below 0. A table is a CSV
//! file with a heading whose names hold the units, in any order and beside other columns:
//!
//! | one of | is |
//! |---|---|
//! | `time_s`, `time_ms` | time, ascending, from any moment on; 2 to 1000 rows a second |
//! | `speed_kmh`, `speed_mps`, `speed_mph` | speed, 0 or more |
//! | `brake`, `brake_percent` | the pedal, 0 to 1 or 0 to 100 |
//!
//! A line has as many fields as the heading, or fewer if those that are missing are none of these. Texts that hold commas
//! stand in quotes.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use crate::score::RunClock;
use lapwing_core::{
    recording::{Break, EventRecord, LONGEST_GAP, Moment, Recording, RecordingError, RunKind, with_newlines},
    units::{MPS_PER_KMH, MPS_PER_MPH},
};

/// A moment of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pressed {
    /// Time since the recording began, in seconds: of a run by the simulator's clock, if it sends one, as for its
    /// scorecard; of a table its own time.
    pub at_s: f64,
    /// Speed, km/h.
    pub speed_kmh: f64,
    /// How far the brake pedal is down, 0 to 1.
    pub pedal: f64,
}

/// A recorded pedal.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Pedal {
    /// Its drives: between two of them, nothing is known. Each has a moment.
    pub drives: Vec<Vec<Pressed>>,
}

/// Why there is no pedal.
#[derive(Debug, thiserror::Error)]
pub enum PedalError {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The table's file.
    #[error("{}: expected a table of pedal and speed, got an error: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A heading without one of the columns, or with two of its kind.
    #[error(
        "{}: line 1: expected {expected}, got {got:?}: name the columns by what they hold and in which unit, separated by \
         commas, without quotes",
        path.display()
    )]
    Heading {
        /// The file.
        path: PathBuf,
        /// The columns of which there must be one.
        expected: String,
        /// The heading.
        got: String,
    },
    /// A field that is not what its column says.
    #[error("{}: line {line}: {column}: expected {expected}, got {got:?}{help}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The column.
        column: &'static str,
        /// What it may be.
        expected: String,
        /// What it is.
        got: String,
        /// What to do, if it is known.
        help: &'static str,
    },
    /// A line with more fields than the heading: it is not known which belong to which column.
    #[error(
        "{}: line {line}: expected {expected} fields, as in the heading, got {got}: write decimals with a point, and texts with \
         commas in quotes",
        path.display()
    )]
    Fields {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// How many the heading has.
        expected: usize,
        /// How many it has.
        got: usize,
    },
    /// Moments too far apart, or too close, to show how fast a pedal goes down.
    #[error("{}: {column}: expected 2 to 1000 rows a second, got one every {got}: {help}", path.display())]
    Rate {
        /// The file.
        path: PathBuf,
        /// The column of the time.
        column: &'static str,
        /// The time between two rows.
        got: String,
        /// What to do.
        help: String,
    },
    /// Nothing in it.
    #[error("{}: expected moments of a drive, got none", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A recording of nobody's brake.
    #[error(
        "{}: expected a brake, got none in {moments} moments: record with a simulator that reports it, or with a pilot whose \
         throttle goes below 0",
        path.display()
    )]
    NoBrake {
        /// The recording.
        path: PathBuf,
        /// How long it is.
        moments: usize,
    },
}

impl Pedal {
    /// Reads a run (`.mcap`), a folder with `driving_log.csv`, or a table (`.csv` with a heading that names a time).
    ///
    /// # Errors
    /// [`PedalError`].
    pub fn open(path: &Path) -> Result<Self, PedalError> {
        let pedal = match text_of_table(path)? {
            Some(text) => table(path, &text)?,
            None => recorded(path)?,
        };
        if pedal.drives.is_empty() {
            return Err(PedalError::Empty { path: path.to_owned() });
        }
        Ok(pedal)
    }

    /// Adds a moment; if it does not continue from the one before, to another drive.
    fn add(&mut self, pressed: Pressed, continues: bool) {
        match self.drives.last_mut().filter(|_| continues) {
            Some(drive) => drive.push(pressed),
            None => self.drives.push(vec![pressed]),
        }
    }
}

fn recorded(path: &Path) -> Result<Pedal, PedalError> {
    let (mut pedal, mut moments, mut told, mut clock) = (Pedal::default(), 0, false, RunClock::default());
    let recording = Recording::open(path)?;
    let kind = recording.header().kind;
    for moment in recording {
        let moment = moment?;
        moments += 1;
        if moment.before.iter().any(|(_, event)| matches!(event, EventRecord::Course { .. })) {
            clock.is_the_worlds();
        }
        let brake = brake(&moment, kind);
        told |= brake.is_some();
        let pressed = Pressed {
            at_s: clock.telemetry(moment.at.as_secs_f64(), moment.telemetry.truth.sim_time_s),
            speed_kmh: moment.telemetry.speed.metres_per_second().get() / MPS_PER_KMH,
            pedal: brake.unwrap_or(0.0),
        };
        // A missing picture is no reason to cut.
        pedal.add(pressed, matches!(moment.broken, None | Some(Break::Unseen(_))));
    }
    if moments > 0 && !told {
        return Err(PedalError::NoBrake { path: path.to_owned(), moments });
    }
    Ok(pedal)
}

/// What is known of the brake at a moment of a run of this kind: what the simulator reports, else the throttle below 0 that was
/// asked for. A throttle of 0 or more says nothing of a brake: the stock simulator's driver has none. A pilot that is off, or along a
/// recording only steers, moves no pedal, whatever it asks for.
pub fn brake(moment: &Moment, kind: RunKind) -> Option<f64> {
    let has_pedals = kind != RunKind::RecordedPath;
    let command = moment.followed().filter(|_| has_pedals);
    moment.telemetry.truth.brake.or_else(|| command.map(|command| -command.throttle.get()).filter(|brake| *brake > 0.0))
}

/// A unit of a column: its name, and how many of the unit used here it is.
type Unit = (&'static str, f64);

/// The columns of a table.
struct Column {
    units: &'static [Unit],
    /// The least value that makes sense, in the unit used here.
    least: f64,
    /// The largest value that makes sense, in the unit used here.
    most: f64,
    /// What may be wrong if a value is larger.
    help: &'static str,
}

const TIME: Column = Column { units: &[("time_s", 1.0), ("time_ms", 1e-3)], least: f64::MIN, most: f64::MAX, help: "" };
const SPEED: Column = Column {
    units: &[("speed_kmh", 1.0), ("speed_mps", MPS_PER_KMH.recip()), ("speed_mph", MPS_PER_MPH / MPS_PER_KMH)],
    least: 0.0,
    most: 500.0,
    help: ": is the column's unit another one, or are columns swapped?",
};
const BRAKE: Column = Column {
    units: &[("brake", 1.0), ("brake_percent", 0.01)],
    least: 0.0,
    most: 1.0,
    help: ": name the column brake_percent if it is in percent; a pressure must be divided by its largest value",
};

/// The text of a table; `None` if that is not what it is.
fn text_of_table(path: &Path) -> Result<Option<String>, PedalError> {
    // Of other text, the error about its heading says what is expected.
    let is = |ending: &&str| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(ending));
    if !["csv", "tsv", "txt"].iter().any(is) || path.is_dir() {
        return Ok(None);
    }
    let bytes = fs::read(path).map_err(|source| PedalError::Read { path: path.to_owned(), source })?;
    let text = with_newlines(String::from_utf8_lossy(&bytes)).into_owned();
    let heading = heading(&text);
    // A driving log names its pictures, or begins with them, and then numbers.
    let is_number = |field: &&str| field.parse::<f64>().is_ok();
    let is_log = heading.iter().any(|name| name.eq_ignore_ascii_case("center"))
        || heading.iter().any(is_number) && !heading.first().is_some_and(is_number);
    Ok((!is_log).then_some(text))
}

/// The names of a table's columns.
fn heading(text: &str) -> Vec<&str> {
    fields(text.lines().next().unwrap_or_default().trim_start_matches('\u{feff}'))
}

/// The fields of a line; a comma within quotes, which begin where a field does, belongs to it.
fn fields(line: &str) -> Vec<&str> {
    let (mut fields, mut from, mut quoted) = (vec![], 0, false);
    for (i, letter) in line.char_indices() {
        match letter {
            '"' if quoted => quoted = false,
            // A second one is a quote in the text.
            '"' if line[from..].trim_start().starts_with('"') => {
                quoted = line[from..i].trim_start().is_empty() || line[..i].ends_with('"');
            }
            ',' if !quoted => {
                fields.push(line[from..i].trim());
                from = i + 1;
            }
            _ => {}
        }
    }
    fields.push(line[from..].trim());
    fields
}

impl Column {
    /// Where it is in a heading, and its unit.
    fn find(&self, heading: &[&str]) -> Result<(usize, Unit), String> {
        let unit = |name: &str| self.units.iter().find(|unit| unit.0.eq_ignore_ascii_case(name)).copied();
        let found: Vec<_> =
            heading.iter().enumerate().filter_map(|(i, name)| unit(name).map(|unit| (i, unit))).collect();
        match found[..] {
            [one] => Ok(one),
            _ => {
                let names: Vec<_> = self.units.iter().map(|(name, _)| *name).collect();
                Err(format!("one column of {}", names.join(", ")))
            }
        }
    }

    /// A value in the unit used here.
    fn value(&self, text: &str, (name, times): Unit) -> Result<f64, (String, &'static str)> {
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
        let help = match text {
            "" => ": leave out rows without a value",
            text if text.contains(['"', ',']) => ": write numbers without quotes, and decimals with a point",
            _ => "",
        };
        let value = number.ok_or((format!("a number for {name}"), help))? * times;
        if value < self.least {
            return Err((format!("{} or more", self.least / times), ""));
        }
        if value > self.most {
            return Err((format!("at most {}", self.most / times), self.help));
        }
        Ok(value)
    }
}

fn table(path: &Path, text: &str) -> Result<Pedal, PedalError> {
    let heading = heading(text);
    let find = |column: &Column| {
        column.find(&heading).map_err(|expected| PedalError::Heading {
            path: path.to_owned(),
            expected,
            got: heading.join(","),
        })
    };
    let columns = [(&TIME, find(&TIME)?), (&SPEED, find(&SPEED)?), (&BRAKE, find(&BRAKE)?)];
    let mut pedal = Pedal::default();
    let (mut before, mut apart_s): (Option<f64>, _) = (None, vec![]);
    for (i, line) in text.lines().enumerate().skip(1).filter(|(_, line)| !line.trim().is_empty()) {
        let fields = fields(line);
        // A comma at the end of a line is no field.
        let got = fields.len() - usize::from(fields.len() > 1 && fields.last().is_some_and(|last| last.is_empty()));
        if got > heading.len() {
            return Err(PedalError::Fields { path: path.to_owned(), line: i + 1, expected: heading.len(), got });
        }
        let wrong = |column: &'static str, got: &str, (expected, help): (String, &'static str)| PedalError::Field {
            path: path.to_owned(),
            line: i + 1,
            column,
            expected,
            got: got.into(),
            help,
        };
        let field = |(column, (at, unit)): (&Column, (usize, Unit))| {
            let text = fields.get(at).copied().unwrap_or_default();
            column.value(text, unit).map_err(|why| wrong(unit.0, text, why)).map(|value| (value, text))
        };
        let [(at_s, text), (speed_kmh, _), (brake, _)] = [field(columns[0])?, field(columns[1])?, field(columns[2])?];
        if let Some(before) = before.filter(|before| at_s <= *before) {
            let after = format!("a time after {}", before / columns[0].1.1.1);
            return Err(wrong(columns[0].1.1.0, text, (after, ": are columns swapped?")));
        }
        apart_s.extend(before.map(|before| at_s - before));
        let continues = before.is_some_and(|before| at_s - before <= LONGEST_GAP.as_secs_f64());
        pedal.add(Pressed { at_s, speed_kmh, pedal: brake }, continues);
        before = Some(at_s);
    }
    check_rate(path, columns[0].1.1, apart_s)?;
    Ok(pedal)
}

/// Rows that lie within these times of each other, in seconds, tell how fast a pedal goes down.
const APART_S: [f64; 2] = [1e-3, 0.5];
/// Times are rounded.
const ROUNDED: f64 = 0.01;

/// Checks that most moments lie as far apart as they must: in another unit there would be no emergency, or one at each touch
/// of the pedal. Of fewer than three, nothing is known.
fn check_rate(path: &Path, (column, times): Unit, mut apart_s: Vec<f64>) -> Result<(), PedalError> {
    apart_s.sort_by(f64::total_cmp);
    let [lower, upper] = match apart_s.len() {
        0 | 1 => return Ok(()),
        count => [apart_s[(count - 1) / 2], apart_s[count / 2]],
    };
    let is_close = |apart_s: f64| apart_s < APART_S[0] * (1.0 - ROUNDED);
    let is_far = |apart_s: f64| apart_s > APART_S[1] * (1.0 + ROUNDED);
    let apart_s = match (is_close(upper), is_far(lower)) {
        (false, false) => return Ok(()),
        (true, _) => upper,
        (_, true) => lower,
    };
    let fits = |unit: &&Unit| !is_close(apart_s / times * unit.1) && !is_far(apart_s / times * unit.1);
    let help = match TIME.units.iter().find(fits) {
        Some((name, _)) if *name == "time_ms" => format!("is the time in milliseconds ({name})?"),
        Some((name, _)) => format!("is the time in seconds ({name})?"),
        None => "rows this far apart do not show how fast the pedal goes down".to_owned(),
    };
    let rounded = |number: f64| (number * 1000.0).round() / 1000.0;
    let got = if apart_s < 0.1 { format!("{} ms", rounded(apart_s * 1e3)) } else { format!("{} s", rounded(apart_s)) };
    Err(PedalError::Rate { path: path.to_owned(), column, got, help })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opened(text: &str) -> Result<Pedal, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.csv");
        fs::write(&path, text).unwrap();
        Pedal::open(&path).map_err(|error| error.to_string().replace(&path.display().to_string(), "drive.csv"))
    }

    #[test]
    fn a_table_is_read_whatever_its_units_and_the_order_of_its_columns() {
        let ours = opened("time_s,speed_kmh,brake\n0.0,36,0\n0.1,18,0.5\n2.5,0,1\n").unwrap();
        assert_eq!(ours.drives.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1], "a gap of two seconds");
        assert_eq!(ours.drives[0][1], Pressed { at_s: 0.1, speed_kmh: 18.0, pedal: 0.5 });
        let theirs =
            opened("\u{feff}Brake_percent, note,TIME_MS,speed_mps\r\n0,x,0,10\r\n50,,100,5\r\n\r\n100,,2500,0")
                .unwrap();
        let old = opened("time_s,speed_kmh,brake\r0.0,36,0\r0.1,18,0.5\r2.5,0,1\r").unwrap();
        assert_eq!(old, ours, "lines that end in carriage returns");
        let mixed = opened("time_s,speed_kmh,brake\n0.0,36,0\r0.1,18,0.5\r\n2.5,0,1\r").unwrap();
        assert_eq!(mixed, ours, "lines that end in one way and another");
        for (a, b) in ours.drives.iter().flatten().zip(theirs.drives.iter().flatten()) {
            let off = (a.at_s - b.at_s).abs() + (a.speed_kmh - b.speed_kmh).abs() + (a.pedal - b.pedal).abs();
            assert!(off < 1e-9, "{a:?} {b:?}");
        }
    }

    #[test]
    fn what_is_wrong_with_a_table_is_named() {
        let header = "time_s,speed_kmh,brake";
        for (text, expected) in [
            (
                "time_s,speed_kmh\n0,0\n".into(),
                "drive.csv: line 1: expected one column of brake, brake_percent, got \"time_s,speed_kmh\": name the columns by \
                 what they hold and in which unit, separated by commas, without quotes",
            ),
            (
                "Time,Speed,BrakePressure\n0,36,12\n".into(),
                "drive.csv: line 1: expected one column of time_s, time_ms, got \"Time,Speed,BrakePressure\": name the columns by \
                 what they hold and in which unit, separated by commas, without quotes",
            ),
            (
                "time_s;speed_kmh;brake\n0;36;0\n".into(),
                "drive.csv: line 1: expected one column of time_s, time_ms, got \"time_s;speed_kmh;brake\": name the columns by \
                 what they hold and in which unit, separated by commas, without quotes",
            ),
            (
                "0,36,0\n0.1,36,0\n".into(),
                "drive.csv: line 1: expected one column of time_s, time_ms, got \"0,36,0\": name the columns by what they hold \
                 and in which unit, separated by commas, without quotes",
            ),
            (
                "time_s,speed_kmh,brake,time_s\n0,36,0,0\n".into(),
                "drive.csv: line 1: expected one column of time_s, time_ms, got \"time_s,speed_kmh,brake,time_s\": name the \
                 columns by what they hold and in which unit, separated by commas, without quotes",
            ),
            (
                "time_s,speed_kmh,speed_mph,brake\n".into(),
                "drive.csv: line 1: expected one column of speed_kmh, speed_mps, speed_mph, got \
                 \"time_s,speed_kmh,speed_mph,brake\": name the columns by what they hold and in which unit, separated by commas, \
                 without quotes",
            ),
            (
                format!("{header}\n0,30,37.5\n"),
                "drive.csv: line 2: brake: expected at most 1, got \"37.5\": name the column brake_percent if it is in percent; \
                 a pressure must be divided by its largest value",
            ),
            (
                format!("{header}\n0,1500,0\n"),
                "drive.csv: line 2: speed_kmh: expected at most 500, got \"1500\": is the column's unit another one, or are \
                 columns swapped?",
            ),
            (format!("{header}\n0,30,-0.1\n"), "drive.csv: line 2: brake: expected 0 or more, got \"-0.1\""),
            (
                format!("{header}\n0,30\n"),
                "drive.csv: line 2: brake: expected a number for brake, got \"\": leave out rows without a value",
            ),
            (
                format!("{header}\n\"0,050\",30,0\n"),
                "drive.csv: line 2: time_s: expected a number for time_s, got \"\\\"0,050\\\"\": write numbers without quotes, \
                 and decimals with a point",
            ),
            (
                "time_ms,speed_kmh,brake_percent\n0,36,0\n50,36,25,0,0\n".into(),
                "drive.csv: line 3: expected 3 fields, as in the heading, got 5: write decimals with a point, and texts with \
                 commas in quotes",
            ),
            (
                format!("{header}\n0,36,0\n67,36,0\n134,36,1\n"),
                "drive.csv: time_s: expected 2 to 1000 rows a second, got one every 67 s: is the time in milliseconds (time_ms)?",
            ),
            (
                "time_ms,speed_kmh,brake\n0,36,0\n0.067,36,0\n0.134,36,1\n".into(),
                "drive.csv: time_ms: expected 2 to 1000 rows a second, got one every 0.067 ms: is the time in seconds (time_s)?",
            ),
            (
                format!("{header}\n0,36,0\n0.8,36,0\n1.6,36,1\n"),
                "drive.csv: time_s: expected 2 to 1000 rows a second, got one every 0.8 s: rows this far apart do not show how \
                 fast the pedal goes down",
            ),
            (
                format!("{header}\n30,1,0\n29,2,0\n"),
                "drive.csv: line 3: time_s: expected a time after 30, got \"29\": are columns swapped?",
            ),
            (format!("{header}\n"), "drive.csv: expected moments of a drive, got none"),
        ] {
            assert_eq!(opened(&text).unwrap_err(), expected);
        }
    }

    #[test]
    fn texts_with_commas_in_quotes_a_comma_at_the_end_and_missing_notes_are_no_other_columns() {
        let rows = |text: &str| opened(text).map(|pedal| pedal.drives.concat());
        let plain = rows("time_s,speed_kmh,brake\n-0.1,36,0\n0,18,0.5\n").unwrap();
        assert_eq!(plain[0].at_s, -0.1, "a time may be told from any moment on");
        for text in [
            "note,time_s,speed_kmh,brake\n\"wet, cold\",-0.1,36,0\n\"a \"\"b, c\"\"\",0,18,0.5\n",
            "time_s,speed_kmh,brake,note\n-0.1,36,0\n0,18,0.5,\"wet, cold\"\n",
            "time_s,speed_kmh,brake,note,place\n-0.1,36,0,5\"\" pipe,x\n0,18,0.5,,\"\"\n",
            "time_s,speed_kmh,brake\n-0.1,36,0,\n0,18,0.5,\n",
        ] {
            assert_eq!(rows(text), Ok(plain.clone()), "{text}");
        }
    }

    #[test]
    fn a_table_that_is_not_there_or_has_another_ending_is_still_called_a_table() {
        let folder = tempfile::tempdir().unwrap();
        let error = Pedal::open(&folder.path().join("none.csv")).unwrap_err().to_string();
        assert!(error.contains("none.csv: expected a table of pedal and speed, got an error"), "{error}");
        let path = folder.path().join("drive.tsv");
        fs::write(&path, "time_s\tspeed_kmh\tbrake\n0\t36\t0\n").unwrap();
        let error = Pedal::open(&path).unwrap_err().to_string();
        assert!(error.contains("separated by commas"), "{error}");
    }

    #[test]
    fn what_is_asked_of_the_pedals_by_whom_they_do_not_obey_is_no_brake() {
        use lapwing_core::{
            recording::{By, CommandRecord, Item, RunFile, RunHeader},
            units::{Steering, Throttle},
        };

        let folder = tempfile::tempdir().unwrap();
        for (kind, by, braked) in [
            (RunKind::Driven, By::Human, Some(0.75)),
            (RunKind::Driven, By::Pilot, Some(0.75)),
            (RunKind::Driven, By::Safe, Some(0.75)),
            (RunKind::Driven, By::Off, None),
            (RunKind::RecordedPath, By::Human, None),
            (RunKind::RecordedPath, By::Pilot, None),
        ] {
            let path = folder.path().join(format!("{kind:?}-{by:?}.mcap"));
            let started = "2026-11-27T12:00:00Z".parse().unwrap();
            let header = RunHeader::new(kind, serde_json::json!({}), started);
            let mut run = RunFile::create(&path, &header, Default::default()).unwrap();
            let at = std::time::Duration::ZERO;
            let telemetry = serde_json::from_str(r#"{"steering_deg":0,"throttle":0,"speed_mph":20}"#).unwrap();
            let human = CommandRecord::of_human(Steering::new(0.0).unwrap(), Throttle::new(-0.75).unwrap());
            let command = CommandRecord { by, ..human };
            for item in
                [Item::Telemetry(telemetry), Item::Frame(vec![0xff, 0xd8, 0xff, 0xd9].into()), Item::Command(command)]
            {
                run.write(at, item).unwrap();
            }
            run.finish().unwrap();
            let read = Pedal::open(&path).ok().map(|pedal| pedal.drives[0][0].pedal);
            assert_eq!(read, braked, "{kind:?} {by:?}");
        }
    }

    #[test]
    fn a_run_as_fast_as_it_was_answered_is_timed_by_the_simulators_clock() {
        use lapwing_core::{
            protocol::{Telemetry, Truth},
            recording::{Item, RunFile, RunHeader},
            units::{Degrees, Mph, Throttle},
        };
        use std::time::Duration;

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fast.mcap");
        let started = "2026-11-27T12:00:00Z".parse().unwrap();
        let header = RunHeader::new(RunKind::Driven, serde_json::json!({}), started);
        let mut run = RunFile::create(&path, &header, Default::default()).unwrap();
        // Ten times as fast as it was driven.
        for i in 0..30 {
            let (sim_time_s, brake) = (Some(f64::from(i) / 10.0), Some(0.5));
            let telemetry = Telemetry {
                steering: Degrees::ZERO,
                throttle: Throttle::ZERO,
                speed: Mph::ZERO,
                image: Default::default(),
                truth: Truth { sim_time_s, brake, ..Truth::default() },
            };
            let at = Duration::from_millis(10) * i;
            run.write(at, Item::Telemetry(telemetry)).unwrap();
            run.write(at, Item::Frame(vec![0xff, 0xd8, 0xff, 0xd9].into())).unwrap();
        }
        run.finish().unwrap();
        let pedal = Pedal::open(&path).unwrap();
        let [drive] = &pedal.drives[..] else { panic!("{} drives", pedal.drives.len()) };
        assert_eq!(drive.len(), 30);
        assert!((0..30).zip(drive).all(|(i, pressed)| (pressed.at_s - f64::from(i) / 10.0).abs() < 1e-9), "{drive:?}");
    }

    #[test]
    fn a_run_is_read_with_its_speeds_and_what_its_simulator_told_of_the_brake() {
        let run = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../recordings/lake.mcap");
        let pedal = Pedal::open(&run).unwrap();
        let [drive] = &pedal.drives[..] else { panic!("{} drives", pedal.drives.len()) };
        assert!((drive[100].at_s - 100.0 / 15.0).abs() < 1e-3 && (30.0..35.0).contains(&drive[100].speed_kmh));
        assert!(drive.iter().all(|pressed| pressed.pedal == 0.0));
    }
}
