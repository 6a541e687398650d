//! A driving log written as the stock simulator's recorder writes it.
//!
//! No header, commas without spaces, absolute paths, numbers as C# prints a
//! `float`, LF; pictures in `IMG`, named by camera and by time to the
//! millisecond. The pictures of a moment are on disk before its line is, and
//! each line is written whole, so a log that is cut off names no picture that
//! is not there.

use std::{
    fs::{self, File, OpenOptions},
    io::Write,
    path::{self, Path, PathBuf},
    time::Duration,
};

use jiff::civil::DateTime;

use super::{
    super::{Break, LONGEST_GAP, RecordingError},
    FALLBACK_INTERVAL, IMAGES, LOG_NAME,
};
use crate::{
    protocol::number,
    units::{Mph, Steering, Throttle},
};

/// One moment of a drive, to be written.
#[derive(Debug, Clone, Copy)]
pub struct NewRow<'a> {
    /// Time since the recording began.
    pub at: Duration,
    /// JPEG of the centre camera.
    pub center: &'a [u8],
    /// JPEG of the left camera; its field stays empty if there is none.
    pub left: Option<&'a [u8]>,
    /// JPEG of the right camera, likewise.
    pub right: Option<&'a [u8]>,
    /// Steering in effect.
    pub steering: Steering,
    /// Throttle in effect. The log has a separate column for the brake, so a value below 0 is written as 0.
    pub throttle: Throttle,
    /// Brake in effect, clamped to 0 to 1.
    pub brake: f64,
    /// Speed.
    pub speed: Mph,
}

/// Writes a driving log and its pictures.
#[derive(Debug)]
pub struct DrivingLogWriter {
    path: PathBuf,
    images: PathBuf,
    images_text: String,
    log: File,
    began: DateTime,
    /// Time of the row written last, in milliseconds since `began`.
    last_ms: Option<u64>,
    /// The time that cuts add to those of the rows.
    cut: Duration,
    /// See [`DrivingLogWriter::at`].
    at: Duration,
    rows: u64,
    /// Whether pictures are numbered, as nobody knows their times.
    is_untimed: bool,
}

impl DrivingLogWriter {
    /// Begins a log in a folder, which is created if it does not exist. Pictures are named by `began` plus the row's
    /// time.
    ///
    /// # Errors
    /// [`RecordingError::LogExists`] if the folder has a driving log, [`RecordingError::LogFolder`],
    /// [`RecordingError::Io`].
    pub fn create(dir: impl AsRef<Path>, began: DateTime) -> Result<Self, RecordingError> {
        let (path, images, images_text) = Self::folder(dir.as_ref())?;
        let log =
            OpenOptions::new().write(true).create_new(true).open(&path).map_err(|source| match source.kind() {
                std::io::ErrorKind::AlreadyExists => RecordingError::LogExists { path: path.clone() },
                _ => RecordingError::Io { doing: "create the driving log", path: path.clone(), source },
            })?;
        Ok(Self {
            path,
            images,
            images_text,
            log,
            began,
            last_ms: None,
            cut: Duration::ZERO,
            at: Duration::ZERO,
            rows: 0,
            is_untimed: false,
        })
    }

    /// Numbers the pictures, so that nobody takes times for known that were assumed.
    pub fn without_times(self) -> Self {
        Self { is_untimed: true, ..self }
    }

    /// Makes the folder. Returns the paths of the log and of the pictures' folder, and the latter as the log writes it.
    fn folder(dir: &Path) -> Result<(PathBuf, PathBuf, String), RecordingError> {
        let dir = path::absolute(dir).map_err(RecordingError::io("find the folder", dir))?;
        let images = dir.join(IMAGES);
        // Quotes and line breaks mean something to readers of CSV, and the recorder does not escape them; a path that
        // is not Unicode would be another one when it is read back.
        let Some(text) = images.to_str().filter(|text| !text.contains(['"', '\n', '\r'])).map(str::to_owned) else {
            return Err(RecordingError::LogFolder { path: dir });
        };
        fs::create_dir_all(&images).map_err(RecordingError::io("create the folder", &images))?;
        Ok((dir.join(LOG_NAME), images, text))
    }

    /// The CSV file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Rows written by this writer.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// The time of the row written last, since the first, as whoever reads the log finds it: of a gap, a cut among them, only
    /// [`FALLBACK_INTERVAL`] counts.
    pub fn at(&self) -> Duration {
        self.at
    }

    /// Writes a moment: its pictures, byte for byte, and a line. One less than a millisecond after the last is named by
    /// the next millisecond: names are never used twice.
    ///
    /// # Errors
    /// [`RecordingError::Io`], also if there is a picture of that name already.
    pub fn row(&mut self, sample: &NewRow<'_>) -> Result<(), RecordingError> {
        let ms = u64::try_from(sample.at.saturating_add(self.cut).as_millis()).unwrap_or(u64::MAX);
        let ms = self.last_ms.map_or(ms, |last| ms.max(last.saturating_add(1)));
        let taken = self.began.saturating_add(Duration::from_millis(ms));
        let mut line = String::with_capacity(400);
        for (camera, jpeg) in [("center", Some(sample.center)), ("left", sample.left), ("right", sample.right)] {
            let Some(jpeg) = jpeg else {
                line.push(',');
                continue;
            };
            let name = match self.is_untimed {
                true => format!("{camera}_{:06}.jpg", self.rows),
                false => picture_name(camera, taken),
            };
            let path = self.images.join(&name);
            File::create_new(&path)
                .and_then(|mut file| file.write_all(jpeg))
                .map_err(RecordingError::io("write the picture", &path))?;
            line += &format!("{}{}{name},", self.images_text, path::MAIN_SEPARATOR);
        }
        let brake = Throttle::saturating(sample.brake).get().max(0.0);
        let numbers = [sample.steering.get(), sample.throttle.get().max(0.0), brake, sample.speed.get()];
        line += &numbers.map(number::single).join(",");
        line.push('\n');
        self.log.write_all(line.as_bytes()).map_err(RecordingError::io("write the driving log", &self.path))?;
        let passed = Duration::from_millis(self.last_ms.map_or(0, |last| ms - last));
        self.at += if Break::after(passed).is_some() { FALLBACK_INTERVAL } else { passed };
        self.last_ms = Some(ms);
        self.rows += 1;
        Ok(())
    }

    /// Marks that the next row does not continue from the last one: the car was put elsewhere. The log can show this
    /// only in the times of the pictures' names, so all rows from here on are named [`LONGEST_GAP`] later, and anyone
    /// who reads the log finds a gap.
    pub fn cut(&mut self) {
        self.cut_by(LONGEST_GAP);
    }

    /// The same with a gap that is so much longer than the time between the rows.
    pub fn cut_by(&mut self, later: Duration) {
        if self.rows > 0 {
            self.cut = self.cut.saturating_add(later);
        }
    }

    /// Ends the log, and returns how many rows were written.
    ///
    /// # Errors
    /// [`RecordingError::Io`] if the disk did not take what was written.
    pub fn finish(self) -> Result<u64, RecordingError> {
        self.log.sync_all().map_err(RecordingError::io("finish the driving log", &self.path))?;
        Ok(self.rows)
    }
}

/// `center_2016_12_01_13_30_48_287.jpg`.
fn picture_name(camera: &str, t: DateTime) -> String {
    let (year, month, day, hour, minute, second) = (t.year(), t.month(), t.day(), t.hour(), t.minute(), t.second());
    let ms = t.millisecond();
    format!("{camera}_{year:04}_{month:02}_{day:02}_{hour:02}_{minute:02}_{second:02}_{ms:03}.jpg")
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::{
        super::{Break, DrivingLog},
        *,
    };

    fn began() -> DateTime {
        date(2016, 12, 1).at(13, 30, 48, 287_000_000)
    }

    fn sample(at_ms: u64, steering: f64, speed: f64) -> NewRow<'static> {
        NewRow {
            at: Duration::from_millis(at_ms),
            center: b"center's jpeg",
            left: Some(b"left's jpeg"),
            right: Some(b"right's jpeg"),
            steering: Steering::new(steering).unwrap(),
            throttle: Throttle::new(0.25).unwrap(),
            brake: 0.0,
            speed: Mph::new(speed).unwrap(),
        }
    }

    fn write(dir: &Path, samples: &[NewRow<'_>]) -> DrivingLog {
        let mut writer = DrivingLogWriter::create(dir, began()).unwrap();
        for sample in samples {
            writer.row(sample).unwrap();
        }
        assert_eq!(writer.finish().unwrap(), samples.len() as u64);
        DrivingLog::open(dir).unwrap()
    }

    #[test]
    fn a_log_is_the_recorders_literal_text() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), &[sample(0, 0.0, 0.649_786_4), sample(67, -0.05, 4.540_283e-5)]);
        let img = path::absolute(dir.path()).unwrap().join("IMG");
        let line = |time: &str, numbers: &str| {
            let path =
                |camera: &str| img.join(format!("{camera}_2016_12_01_13_30_48_{time}.jpg")).display().to_string();
            format!("{},{},{},{numbers}\n", path("center"), path("left"), path("right"))
        };
        assert_eq!(
            fs::read_to_string(dir.path().join("driving_log.csv")).unwrap(),
            line("287", "0,0.25,0,0.6497864") + &line("354", "-0.05,0.25,0,4.540283E-05")
        );
        assert_eq!(fs::read(img.join("left_2016_12_01_13_30_48_354.jpg")).unwrap(), b"left's jpeg");
    }

    #[test]
    fn what_is_written_is_read_again_from_any_folder() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["plain", "my drive/with spaces", "Doe, Jane", "日本語"] {
            let dir = dir.path().join(name);
            let samples: Vec<_> = (0..40u32)
                .map(|i| sample(u64::from(i) * 200 / 3, f64::from(i) / 39.0 - 0.5, 1e-6 * 3f64.powi(i as i32 / 3)))
                .collect();
            let log = write(&dir, &samples);
            assert_eq!(log.rows.len(), samples.len(), "{name}");
            for (row, sample) in log.rows.iter().zip(&samples) {
                assert_eq!(fs::read(&row.center).unwrap(), sample.center);
                assert_eq!(fs::read(row.left.as_ref().unwrap()).unwrap(), sample.left.unwrap());
                assert_eq!(fs::read(row.right.as_ref().unwrap()).unwrap(), sample.right.unwrap());
                assert_eq!(row.at, sample.at, "{name}");
                assert!((row.steering.get() - sample.steering.get()).abs() < 1e-6);
                assert!((row.speed.get() / sample.speed.get() - 1.0).abs() < 1e-6);
                assert_eq!((row.throttle.get(), row.brake), (0.25, 0.0));
            }
        }
    }

    #[test]
    fn a_camera_that_is_not_there_leaves_its_field_empty() {
        let dir = tempfile::tempdir().unwrap();
        let log = write(dir.path(), &[NewRow { left: None, right: None, ..sample(0, 0.5, 5.0) }]);
        let text = fs::read_to_string(&log.path).unwrap();
        assert!(text.ends_with("center_2016_12_01_13_30_48_287.jpg,,,0.5,0.25,0,5\n"), "{text}");
        assert_eq!((&log.rows[0].left, &log.rows[0].right), (&None, &None));
        assert_eq!(fs::read_dir(dir.path().join("IMG")).unwrap().count(), 1);
    }

    #[test]
    fn brake_and_throttle_keep_to_their_columns() {
        let dir = tempfile::tempdir().unwrap();
        let braking = NewRow { throttle: Throttle::new(-0.75).unwrap(), brake: 0.75, ..sample(0, 0.0, 5.0) };
        let beyond = NewRow { brake: f64::NAN, ..sample(67, 0.0, 5.0) };
        let log = write(dir.path(), &[braking, beyond]);
        assert_eq!((log.rows[0].throttle.get(), log.rows[0].brake), (0.0, 0.75));
        assert_eq!(log.rows[1].brake, 0.0);
    }

    #[test]
    fn no_two_rows_share_a_name() {
        let dir = tempfile::tempdir().unwrap();
        let log = write(dir.path(), &[sample(5, 0.0, 1.0), sample(5, 0.0, 1.0), sample(3, 0.0, 1.0)]);
        let at: Vec<_> = log.rows.iter().map(|row| row.at.as_millis()).collect();
        assert_eq!(at, [0, 1, 2]);
    }

    #[test]
    fn a_cut_is_a_gap_to_whoever_reads_the_log() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = DrivingLogWriter::create(dir.path(), began()).unwrap();
        writer.cut(); // there is nothing to cut before the first row
        for at_ms in [0, 67, 133, 200] {
            if at_ms == 133 {
                writer.cut();
            }
            writer.row(&sample(at_ms, 0.0, 1.0)).unwrap();
        }
        let log = DrivingLog::open(dir.path()).unwrap();
        let breaks: Vec<_> = log.rows.iter().map(|row| row.broken).collect();
        assert_eq!(breaks, [None, None, Some(Break::Gap(Duration::from_millis(1066))), None]);
    }

    #[test]
    fn time_runs_over_midnight_and_the_years_end() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = DrivingLogWriter::create(dir.path(), date(2020, 12, 31).at(23, 59, 59, 950_000_000)).unwrap();
        writer.row(&sample(70, 0.0, 1.0)).unwrap();
        assert!(dir.path().join("IMG/center_2021_01_01_00_00_00_020.jpg").exists());
    }

    #[test]
    fn a_log_that_is_there_is_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("driving_log.csv");
        fs::write(&path, "somebody's").unwrap();
        let error = DrivingLogWriter::create(dir.path(), began()).unwrap_err().to_string();
        assert!(error.starts_with(&format!("{}: there is a driving log already", path.display())), "{error}");
        assert_eq!(fs::read_to_string(path).unwrap(), "somebody's");
    }

    #[test]
    fn errors_name_the_path_and_what_is_wrong_with_it() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("file");
        fs::write(&file, "").unwrap();
        let error = DrivingLogWriter::create(&file, began()).unwrap_err().to_string();
        assert!(error.starts_with(&format!("cannot create the folder {}", file.join("IMG").display())), "{error}");
        let error = DrivingLogWriter::create(dir.path().join("a\"b"), began()).unwrap_err().to_string();
        assert!(error.contains("quotes or line breaks"), "{error}");

        let mut writer = DrivingLogWriter::create(dir.path(), began()).unwrap();
        let picture = dir.path().join("IMG/right_2016_12_01_13_30_48_287.jpg");
        fs::write(&picture, "somebody's").unwrap();
        let error = writer.row(&sample(0, 0.0, 1.0)).unwrap_err().to_string();
        assert!(error.starts_with(&format!("cannot write the picture {}", picture.display())), "{error}");
        assert_eq!(fs::read_to_string(&picture).unwrap(), "somebody's");
        assert_eq!(fs::read_to_string(dir.path().join("driving_log.csv")).unwrap(), "");
    }
}
