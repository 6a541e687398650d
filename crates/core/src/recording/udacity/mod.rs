//! Udacity's own data sets: a folder with `driving_log.csv` and the pictures in `IMG`.
//!
//! The simulator writes the log without a header, with absolute paths of the
//! machine it ran on and in the number format of the player's locale; people
//! then move, join and edit it. All of that is read, each line for itself, so
//! that logs joined from several sources read too:
//!
//! - with or without a header, whose names then say the order of the columns
//!   (`center`, `left`, `right`, `steering`, `throttle`, `brake`, `speed`;
//!   others are passed over);
//! - `,` or `, ` between the fields, with or without quotes; LF or CRLF; with
//!   or without a byte order mark and a final newline;
//! - any path of Windows, macOS or Linux, or none: only the file name counts,
//!   and it is looked up in `IMG` beside the log, or beside the log itself
//!   where there is no `IMG`. Only where no such file is there and the log has
//!   an absolute path of one that is, that one counts: so a log can speak of
//!   pictures that lie elsewhere;
//! - decimal points and decimal commas, also where they are mixed up with the commas between fields.
//!
//! Pictures are opened when they are asked for ([`Row::jpeg`]), and need not exist.
//!
//! [`DrivingLogWriter`] writes such folders, exactly as the simulator's recorder does.

mod line;
mod writer;

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use bytes::Bytes;
use jiff::{
    Timestamp,
    civil::{Date, DateTime, Time},
    tz::TimeZone,
};

use self::line::{Bad, Column, Layout};
pub use self::writer::{DrivingLogWriter, Sample};
use super::{CommandRecord, Item, RecordingError, RunHeader, RunKind, read_file, read_picture};
use crate::{
    protocol::{CameraImage, Telemetry, Truth},
    units::{Mph, Steering, Throttle},
};

/// Time between two rows whose picture names hold no time: the simulator records 15 times a second at most.
pub const FALLBACK_INTERVAL: Duration = Duration::from_nanos(1_000_000_000 / 15);

/// A longer time between two rows is two drives joined, or a pause.
pub const LONGEST_INTERVAL: Duration = Duration::from_secs(10);

/// The longest log that is read, in bytes: a week's driving.
const MOST_LOG: u64 = 1 << 30;

/// A driving log, read whole.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivingLog {
    /// The CSV file.
    pub path: PathBuf,
    /// Its rows, in its order; at least one.
    pub rows: Vec<Row>,
}

/// One moment of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Line in the CSV file, counted from 1.
    pub line: usize,
    /// Time since the first row, by the pictures' names. Where a name holds no
    /// time, or one that belongs to another drive, [`FALLBACK_INTERVAL`] passes.
    pub at: Duration,
    /// Another drive begins here: the picture's name holds a time before the
    /// previous row's, or more than [`LONGEST_INTERVAL`] after it.
    pub joined: bool,
    /// Picture of the centre camera.
    pub center: PathBuf,
    /// Picture of the left camera.
    pub left: Option<PathBuf>,
    /// Picture of the right camera.
    pub right: Option<PathBuf>,
    /// Steering in effect.
    pub steering: Steering,
    /// Throttle in effect.
    pub throttle: Throttle,
    /// Brake in effect, 0 to 1.
    pub brake: f64,
    /// Speed.
    pub speed: Mph,
    /// Local time of the picture, to the millisecond, from its name: `center_2018_07_16_17_11_43_382.jpg`.
    pub taken_at: Option<DateTime>,
}

impl DrivingLog {
    /// Reads a log: a CSV file, or the `driving_log.csv` of a folder.
    ///
    /// # Errors
    /// [`RecordingError::NoSource`], [`RecordingError::Io`], [`RecordingError::Log`]
    /// with the line and field that cannot be read, [`RecordingError::NoRows`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let none = |got| RecordingError::NoSource { path: path.to_owned(), got };
        let is_there = |path: &Path| path.try_exists().map_err(RecordingError::io("read the driving log", path));
        let path = match path.is_dir().then(|| path.join("driving_log.csv")) {
            Some(log) if !is_there(&log)? => return Err(none("a folder without it")),
            Some(log) => log,
            None if !is_there(path)? => return Err(none("nothing: no such file or folder")),
            None => path.to_owned(),
        };
        let bytes =
            read_file(&path, "a driving log", MOST_LOG).map_err(RecordingError::io("read the driving log", &path))?;
        let beside = path.parent().unwrap_or(Path::new(""));
        let img = beside.join("IMG");
        let images = if img.is_dir() { &img } else { beside };
        // Names in other encodings than UTF-8 stand in folders, which do not count.
        let rows = read(&String::from_utf8_lossy(&bytes), images).map_err(|(line, bad)| RecordingError::Log {
            path: path.clone(),
            line,
            field: bad.field,
            expected: bad.expected.chars().take(200).collect(), // a header may name any number of columns
            got: bad.got.chars().take(120).collect(),
            help: bad.help,
        })?;
        if rows.is_empty() { Err(RecordingError::NoRows { path }) } else { Ok(Self { path, rows }) }
    }
}

impl DrivingLog {
    /// The header of a run made of it.
    pub fn header(&self) -> RunHeader {
        let config = serde_json::json!({ "converted_from": "driving_log.csv" });
        RunHeader::new(RunKind::DrivingLog, config, self.started())
    }

    /// When the first picture was taken, by its name in this place's time; else when the log was written last.
    fn started(&self) -> Timestamp {
        let named = self.rows.first().and_then(|row| row.taken_at);
        let named = named.and_then(|taken| taken.to_zoned(TimeZone::system()).ok()).map(|taken| taken.timestamp());
        let written = || fs::metadata(&self.path).and_then(|m| m.modified()).ok().and_then(|t| t.try_into().ok());
        named.or_else(written).unwrap_or(Timestamp::UNIX_EPOCH)
    }
}

impl Row {
    /// The bytes of the centre camera's picture.
    ///
    /// # Errors
    /// [`RecordingError::Picture`] where it cannot be read, or is no JPEG.
    pub fn jpeg(&self) -> Result<Bytes, RecordingError> {
        let wrong = |why: String| RecordingError::Picture { path: self.center.clone(), why };
        let bytes = read_picture(&self.center).map_err(|e| wrong(e.to_string()))?;
        if bytes.starts_with(b"\xff\xd8") { Ok(bytes) } else { Err(wrong("expected a JPEG, got another kind".into())) }
    }

    /// The row as items of a run, all at its time: a human drove.
    pub fn items(&self, jpeg: Option<Bytes>) -> impl Iterator<Item = Item> {
        let telemetry = Telemetry {
            steering: self.steering.degrees(),
            throttle: self.throttle,
            speed: self.speed,
            image: CameraImage::default(),
            truth: Truth { brake: Some(self.brake), ..Truth::default() },
        };
        let command = CommandRecord::of_human(self.steering, Throttle::saturating(self.throttle.get() - self.brake));
        let told = [Some(Item::Telemetry(telemetry)), jpeg.map(Item::Frame), Some(Item::Command(command))];
        told.into_iter().flatten()
    }
}

/// The rows of a log's text; an error comes with its line.
fn read(text: &str, images: &Path) -> Result<Vec<Row>, (usize, Bad)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text.lines().enumerate().map(|(i, line)| (i + 1, line)).filter(|(_, l)| !l.trim().is_empty());
    let Some(first) = lines.clone().next() else { return Ok(Vec::new()) };
    let layout = match Layout::from_header(first.1).map_err(|bad| (first.0, bad))? {
        Some(layout) => {
            lines.next();
            layout
        }
        None => Layout::default(),
    };
    let mut rows: Vec<Row> = Vec::new();
    for (number, line) in lines {
        let mut row = row(&layout, line, images).map_err(|bad| (number, bad))?;
        row.line = number;
        if let Some(previous) = rows.last() {
            let passed = interval(previous.taken_at, row.taken_at);
            row.at = previous.at + passed.unwrap_or(FALLBACK_INTERVAL);
            row.joined = passed.is_none() && previous.taken_at.is_some() && row.taken_at.is_some();
        }
        rows.push(row);
    }
    Ok(rows)
}

fn row(layout: &Layout, line: &str, images: &Path) -> Result<Row, Bad> {
    let fields = layout.fields(line)?;
    let image = |column: Column| match fields.get(column) {
        None | Some("") => Ok(None),
        Some(written) => line::file_name(written).map(|name| Some((name, written))).ok_or_else(|| Bad {
            field: column.to_string(),
            expected: "the name of a picture (.jpg, .jpeg or .png)".into(),
            got: written.into(),
            help: "columns are center, left, right, steering, throttle, brake, speed unless a header says otherwise",
        }),
    };
    let (name, written) = image(Column::Center)?.ok_or_else(|| Bad {
        field: Column::Center.to_string(),
        expected: "the name of a picture".into(),
        got: String::new(),
        help: "remove the line, it has no picture",
    })?;
    let resolve = |(name, written): (&str, &str)| {
        let beside = images.join(name);
        // A path of another system is not absolute here, so that most logs cost no look at the disk.
        let elsewhere = Path::new(written);
        if elsewhere.is_absolute() && !beside.is_file() && elsewhere.is_file() { elsewhere.to_owned() } else { beside }
    };
    Ok(Row {
        line: 0,
        at: Duration::ZERO,
        joined: false,
        taken_at: taken_at(name),
        center: resolve((name, written)),
        left: image(Column::Left)?.map(resolve),
        right: image(Column::Right)?.map(resolve),
        steering: fields.quantity(Column::Steering, Steering::new)?,
        throttle: fields.quantity(Column::Throttle, Throttle::new)?,
        // The brake has no type of its own; it is a throttle that cannot be negative.
        brake: fields.quantity(Column::Brake, line::brake)?,
        speed: fields.quantity(Column::Speed, Mph::new)?,
    })
}

/// What passed within one drive.
fn interval(from: Option<DateTime>, to: Option<DateTime>) -> Option<Duration> {
    Duration::try_from(to?.duration_since(from?)).ok().filter(|passed| *passed <= LONGEST_INTERVAL)
}

/// The time in a picture's name: its last seven numbers, year to millisecond.
fn taken_at(name: &str) -> Option<DateTime> {
    let (stem, _) = name.rsplit_once('.')?;
    let mut parts = stem.rsplit('_');
    let mut part = || parts.next()?.parse::<i16>().ok();
    let (ms, s, min, h, d, m, y) = (part()?, part()?, part()?, part()?, part()?, part()?, part()?);
    let small = |n: i16| i8::try_from(n).ok();
    let date = Date::new(y, small(m)?, small(d)?).ok()?;
    let nanosecond = i32::from(ms).checked_mul(1_000_000)?;
    Some(DateTime::from_parts(date, Time::new(small(h)?, small(min)?, small(s)?, nanosecond).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &str) -> Vec<Row> {
        read(text, Path::new("IMG")).unwrap_or_else(|(line, bad)| panic!("line {line}: {bad:?}"))
    }

    fn values(row: &Row) -> (f64, f64, f64, f64) {
        (row.steering.get(), row.throttle.get(), row.brake, row.speed.get())
    }

    /// Opens a file with this text and gives the error's words behind the path.
    fn error(text: &str) -> String {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("driving_log.csv");
        fs::write(&path, text).unwrap();
        let error = DrivingLog::open(dir.path()).unwrap_err().to_string();
        error.strip_prefix(path.to_str().unwrap()).unwrap().to_owned()
    }

    #[test]
    fn paths_of_every_system_lead_to_the_same_picture() {
        for path in [
            r"C:\Users\user\My drive\data\IMG\",
            "/Users/user/Desktop/car sim/IMG/",
            "/home/user/data/IMG/",
            "IMG/",
            "",
            r"C:\Users\Doe, Jane\IMG\",
        ] {
            for space in ["", " "] {
                let text = format!(
                    "{path}center_2018_07_16_17_11_43_382.jpg,{space}{path}left_2018_07_16_17_11_43_382.jpg,\
                     {space}{path}right_2018_07_16_17_11_43_382.jpg,{space}-0.05,{space}0.5,{space}0,{space}7.495027E-05\n"
                );
                let [row] = &rows(&text)[..] else { panic!("{text}") };
                assert_eq!(row.center, Path::new("IMG").join("center_2018_07_16_17_11_43_382.jpg"));
                assert_eq!(row.left, Some(Path::new("IMG").join("left_2018_07_16_17_11_43_382.jpg")));
                assert_eq!(row.right, Some(Path::new("IMG").join("right_2018_07_16_17_11_43_382.jpg")));
                assert_eq!(values(row), (-0.05, 0.5, 0.0, 7.495027e-5));
                assert_eq!(row.taken_at.unwrap().to_string(), "2018-07-16T17:11:43.382");
            }
        }
    }

    #[test]
    fn a_header_says_the_order_of_the_columns() {
        let official = rows(
            "center,left,right,steering,throttle,brake,speed\nIMG/c.jpg, IMG/l.jpg, IMG/r.jpg, 0, 0, 0, 22.14829\n",
        );
        assert_eq!((official[0].line, values(&official[0])), (2, (0.0, 0.0, 0.0, 22.14829)));
        let other = rows("\u{feff}\"\",Speed,steering,Throttle,brake,center,lap\r\n0,10,0.25,0.5,0,c.jpg,3\r\n");
        assert_eq!(values(&other[0]), (0.25, 0.5, 0.0, 10.0));
        assert_eq!((other[0].center.as_path(), &other[0].left), (Path::new("IMG/c.jpg"), &None));
    }

    #[test]
    fn crlf_blank_lines_no_final_newline_and_quotes_are_read() {
        let rows = rows("c.jpg,l.jpg,r.jpg,0,0,0,1\r\n\r\n\"a, b/c.jpg\",\"l.jpg\",\"r.jpg\",\"-0,5\",0,0,25.07162");
        assert_eq!((rows[1].line, values(&rows[1])), (3, (-0.5, 0.0, 0.0, 25.07162)));
        assert_eq!(rows[1].center, Path::new("IMG/c.jpg"));
    }

    #[test]
    fn decimal_commas_are_read_where_spaces_tell_the_fields_apart() {
        let line =
            "/home/user/IMG/c.jpg, /home/user/IMG/l.jpg, /home/user/IMG/r.jpg, -0,08581576, 0,1286689, 0, 12,1822\n";
        assert_eq!(values(&rows(line)[0]), (-0.08581576, 0.1286689, 0.0, 12.1822));
    }

    #[test]
    fn decimal_commas_without_spaces_are_read_where_only_one_reading_makes_sense() {
        for (numbers, expected) in [
            ("-0,08581576,0,1286689,0,12,1822", (-0.08581576, 0.1286689, 0.0, 12.1822)),
            ("0,0,1286689,0,12,1822", (0.0, 0.1286689, 0.0, 12.1822)),
            ("0,0,0,12,1822", (0.0, 0.0, 0.0, 12.1822)),
            ("-0,25,1,0,30,19029", (-0.25, 1.0, 0.0, 30.19029)),
            ("0,0,0,7,495027E-05", (0.0, 0.0, 0.0, 7.495027e-5)),
            ("0,5,0,25,0,125,12,5", (0.5, 0.25, 0.125, 12.5)),
        ] {
            assert_eq!(values(&rows(&format!("c.jpg,l.jpg,r.jpg,{numbers}"))[0]), expected, "{numbers}");
        }
        assert_eq!(
            error("c.jpg,l.jpg,r.jpg,0,1,0,0,12"),
            r#", line 1, numbers: expected one way to read 5 fields as steering, throttle, brake, speed, got "0,1,0,0,12": decimal commas and separating commas cannot be told apart here: write the log with decimal points"#
        );
    }

    #[test]
    fn a_field_that_cannot_be_read_is_named_with_what_to_do() {
        assert_eq!(
            error("c.jpg,l.jpg,r.jpg,0,0,0,1\nc.jpg,l.jpg,r.jpg,1.5,0,0,1\n"),
            r#", line 2, steering: expected a steering command from -1 to 1, got "1.5": correct or remove the line"#
        );
        assert_eq!(
            error("c.jpg,l.jpg,r.jpg,0,fast,0,1"),
            r#", line 1, throttle: expected a number, got "fast": correct or remove the line"#
        );
        assert_eq!(
            error("c.jpg,l.jpg,r.jpg,0,0,-0.5,1"),
            r#", line 1, brake: expected a brake from 0 to 1, got "-0.5": correct or remove the line"#
        );
        assert_eq!(
            error("c.jpg,l.jpg,r.jpg,0,0,0,NaN"),
            r#", line 1, speed: expected a speed from -1000 to 1000 mph, got "NaN": correct or remove the line"#
        );
        assert!(error("c.jpg,l.jpg,r.jpg,0.5").starts_with(
            r#", line 1, columns: expected 7 (center, left, right, steering, throttle, brake, speed), got "4""#
        ));
        assert!(error("center,steering\nc.jpg,0").starts_with(
            r#", line 1, header: expected the columns center, steering, throttle, brake, speed, got "center,steering""#
        ));
        assert_eq!(
            error("c.jpg,l.jpg,r.jpg,0.5,0.25,0,1.5,7"),
            r#", line 1, numbers: expected 4 numbers (steering, throttle, brake, speed), got "0.5,0.25,0,1.5,7": correct or remove the line; a log with further columns needs a header that names them"#
        );
        assert!(error("a;b;c").starts_with(r#", line 1, columns: expected 7"#));
        assert!(error("a,b,c,0,0,0,1").starts_with(r#", line 1, center: expected the name of a picture"#));
        assert!(error(r#""c.jpg,0"#).contains("expected a closing quote"));
        assert_eq!(error("\n \n"), ": expected rows of a driving log, got none");
        assert_eq!(
            error("center,left,right,steering,throttle,brake,speed\n"),
            ": expected rows of a driving log, got none"
        );
    }

    #[test]
    fn time_passes_by_the_names_and_by_a_fifteenth_second_without() {
        let at = |names: [&str; 3]| {
            let text: String = names.iter().map(|n| format!("{n},,,0,0,0,1\n")).collect();
            rows(&text).iter().map(|row| row.at).collect::<Vec<_>>()
        };
        let ms = Duration::from_millis;
        let days = ["center_2020_12_31_23_59_59_950.jpg", "center_2021_01_01_00_00_00_020.jpg", "x.jpg"];
        assert_eq!(at(days), [ms(0), ms(70), ms(70) + FALLBACK_INTERVAL]);
        let joined = ["2021_01_01_00_00_01_000.jpg", "2020_01_01_00_00_00_000.jpg", "2020_01_01_00_00_00_100.jpg"];
        assert_eq!(at(joined), [ms(0), FALLBACK_INTERVAL, FALLBACK_INTERVAL + ms(100)]);
        let joins: Vec<_> =
            rows(&joined.map(|n| format!("{n},,,0,0,0,1\n")).concat()).iter().map(|r| r.joined).collect();
        assert_eq!(joins, [false, true, false]);
        assert_eq!(at(["a_2020_13_01_00_00_00_000.jpg", "b.jpg", "c.jpg"])[2], FALLBACK_INTERVAL * 2);
    }

    #[cfg(unix)]
    #[test]
    fn a_log_that_is_a_device_is_an_error_at_once() {
        let dir = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/dev/zero", dir.path().join("driving_log.csv")).unwrap();
        let error = DrivingLog::open(dir.path()).unwrap_err().to_string();
        assert!(error.ends_with(": expected a driving log, got a device or a pipe"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn a_log_that_cannot_be_looked_for_is_not_said_to_be_missing() {
        let dir = tempfile::tempdir().unwrap();
        let log = dir.path().join("driving_log.csv");
        std::os::unix::fs::symlink(&log, &log).unwrap(); // leads to itself
        for path in [dir.path(), &log] {
            let error = DrivingLog::open(path).unwrap_err();
            assert!(matches!(error, RecordingError::Io { .. }), "{error}");
        }
    }

    #[test]
    fn an_error_is_short_however_many_columns_a_header_names() {
        let header = format!("center,steering,throttle,brake,speed{}", ",x".repeat(10_000));
        assert!(error(&format!("{header}\na.jpg,0,0,0\n")).len() < 600);
    }

    #[test]
    fn pictures_are_looked_up_in_img_or_beside_the_log() {
        let dir = tempfile::tempdir().unwrap();
        let log = dir.path().join("log.csv");
        fs::write(&log, "/elsewhere/IMG/c.jpg,,,0,0,0,1").unwrap();
        assert_eq!(DrivingLog::open(&log).unwrap().rows[0].center, dir.path().join("c.jpg"));
        fs::create_dir(dir.path().join("IMG")).unwrap();
        assert_eq!(DrivingLog::open(&log).unwrap().rows[0].center, dir.path().join("IMG").join("c.jpg"));
        assert!(matches!(DrivingLog::open(dir.path()), Err(RecordingError::NoSource { .. })));
    }

    #[test]
    fn a_picture_elsewhere_is_found_by_its_absolute_path_where_there_is_none_beside_the_log() {
        let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let elsewhere = other.path().join("Doe, Jane.jpg");
        let log = dir.path().join("driving_log.csv");
        fs::write(&log, format!("\"{}\",,,0,0,0,1", elsewhere.display())).unwrap();
        let center = || DrivingLog::open(&log).unwrap().rows[0].center.clone();
        assert_eq!(center(), dir.path().join("Doe, Jane.jpg"), "there is none at all");
        fs::write(&elsewhere, "").unwrap();
        assert_eq!(center(), elsewhere);
        fs::write(dir.path().join("Doe, Jane.jpg"), "").unwrap();
        assert_eq!(center(), dir.path().join("Doe, Jane.jpg"), "what is beside the log comes first");
    }
}
