//! Converts Udacity folders to runs, and runs to Udacity folders.
//!
//! | in a folder | in a run |
//! |---|---|
//! | picture of the centre camera | frame, the same bytes |
//! | pictures of the sides | nothing: a run has the centre camera only |
//! | steering, throttle, speed | telemetry |
//! | brake | the telemetry's ground truth |
//! | steering, throttle less brake | the command that answers the picture, by a human |
//! | time in the picture's name | time of the item, to the millisecond |
//! | a jump in that time | the event `break`; from run to folder any break of the run ([`Break`]) becomes a jump |
//!
//! From run to folder, steering, throttle and brake are those of the command: what telemetry reports was decided one
//! picture earlier. They are the telemetry's where nobody answered, and in a run made of a folder, whose rows it holds.

use std::{fs, io, ops::ControlFlow, path::Path, time::Duration};

use jiff::tz::TimeZone;

use super::DatasetError;
use lapwing_core::{
    recording::udacity::{DrivingLog, DrivingLogWriter, IMAGES, LOG_NAME, NewRow},
    recording::{
        Break, LONGEST_GAP, Moment, Picture, Recorder, RecorderOptions, Recording, RecordingError, RunKind, is_run_name,
    },
    units::{Steering, Throttle},
    words::count,
};

/// How much later another drive begins in a log than the one before it ends: more than the 20 s after which a drive counts as another.
const JOINED: Duration = Duration::from_secs(60);
/// A longer gap is written as one of this length: the years of a picture's name have four digits.
const LONGEST: Duration = Duration::from_secs(86_400);

/// Is told how many rows are done, and of how many; returns whether to continue.
type OnRow<'a> = &'a mut dyn FnMut(u64, Option<u64>) -> ControlFlow<()>;

/// The result of a conversion.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct Converted {
    /// Rows, or telemetries, written.
    pub rows: u64,
    /// Telemetries whose picture was not recorded, which a folder leaves out; rows whose picture cannot be used, which a run holds
    /// without one.
    pub without_picture: u64,
    /// Why the first of those rows' pictures cannot be used.
    pub unusable: Option<String>,
    /// Pictures of the side cameras that are there and are left out.
    pub side_pictures: u64,
    /// Where a human took over or the car was put back in the run: the folder has a gap in time there.
    pub seams: u64,
    /// Where the run is cut off; nothing after that is converted.
    pub truncated: Option<String>,
}

/// Converts a Udacity folder to a run, or a run to a Udacity folder, depending on `source`. `target` is a file that
/// ends in `.mcap`, or a folder, and must not exist (except as an empty folder). Pictures are copied byte for byte.
///
/// The labels of a folder made from a run are those of the run: what each picture was answered with, as `lapwing
/// record` writes it, whoever steered. A run has no label where a safe command answered, or nobody: in the folder these
/// rows hold that command, or what was in effect, as the simulator reported it.
/// `progress` is told after each row how many are done, and of how many if that is known, and may stop the conversion.
///
/// # Errors
/// [`DatasetError`] if the conversion was stopped, the target exists or is of the wrong kind, no picture can be used,
/// the source cannot be read, or the target cannot be written. Anything written until then is removed.
pub fn convert(source: &Path, target: &Path, progress: OnRow<'_>) -> Result<Converted, DatasetError> {
    let recording = Recording::open(source)?;
    let (folder, run) = ("a folder", "a run");
    let wrong = |expected, got| Err(DatasetError::Target { path: target.to_owned(), expected, got });
    match (recording.log(), is_run_name(target)) {
        (None, true) => wrong(folder, run),
        (Some(_), false) => wrong(run, folder),
        (Some(log), true) => check_free(target).and_then(|()| to_run(log, target, progress)),
        (None, false) => check_free(target).and_then(|()| to_folder(recording, target, progress)),
    }
}

/// Checks that nothing is there, except perhaps an empty folder if a folder is to be made.
fn check_free(target: &Path) -> Result<(), DatasetError> {
    let got = match fs::symlink_metadata(target) {
        Err(why) if why.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(why) => return Err(DatasetError::Io { doing: "look at", path: target.to_owned(), why }),
        Ok(there) if !there.is_dir() => "a file",
        Ok(_) => {
            let mut entries = fs::read_dir(target).map_err(|why| io_error("look into", target, why))?;
            if entries.next().is_none() {
                return Ok(());
            }
            "a folder with something in it"
        }
    };
    Err(DatasetError::Exists { path: target.to_owned(), got })
}

fn io_error(doing: &'static str, path: &Path, why: io::Error) -> DatasetError {
    DatasetError::Io { doing, path: path.to_owned(), why }
}

fn to_run(log: &DrivingLog, target: &Path, progress: OnRow<'_>) -> Result<Converted, DatasetError> {
    if let Some(parent) = target.parent() {
        fs::create_dir_all(parent).map_err(|why| io_error("create the folder", parent, why))?;
    }
    let recorder = Recorder::create_file(target, log.header(), RecorderOptions::default())?;
    let mut converted = Converted::default();
    let mut first = None;
    let written = log.rows.iter().try_for_each(|row| {
        let jpeg = row.jpeg().map_err(|why| first.get_or_insert(why)).ok();
        converted.without_picture += u64::from(jpeg.is_none());
        // The disk of a conversion may be slow: nothing must be dropped.
        recorder.wait_for_room();
        row.items(jpeg).for_each(|item| recorder.record(row.at, item));
        converted.rows += 1;
        let sides = [&row.left, &row.right].into_iter().flatten();
        converted.side_pictures += sides.filter(|picture| picture.is_file()).count() as u64;
        go_on(progress(converted.rows, Some(log.rows.len() as u64)), target)
    });
    let report = recorder.finish();
    let lost = report.lost();
    let finished = written.and_then(|()| match report.error {
        Some(error) => Err(error.into()),
        None if lost > 0 => {
            let why = io::Error::other(format!(
                "{} could not be written: the disk was full or too slow",
                count(lost, "item")
            ));
            Err(io_error("write", target, why))
        }
        None => {
            let none_is_usable = converted.without_picture == converted.rows;
            converted.unusable = first.as_ref().map(ToString::to_string);
            first.filter(|_| none_is_usable).map_or(Ok(converted), |why| Err(why.into()))
        }
    });
    if finished.is_err() {
        // Half a run would look like a whole one. The first error is enough, so this one's failure is ignored.
        let _ = fs::remove_file(target);
    }
    finished
}

fn to_folder(mut run: Recording, target: &Path, progress: OnRow<'_>) -> Result<Converted, DatasetError> {
    let total = run.left();
    let kind = run.header().kind;
    let began = run.header().started.to_zoned(TimeZone::system()).datetime();
    let was_there = target.exists();
    let is_untimed = total.is_some_and(|total| total > 0 && run.untimed() as u64 >= total);
    let result = DrivingLogWriter::create(target, began).map_err(DatasetError::from).and_then(|log| {
        let mut log = if is_untimed { log.without_times() } else { log };
        let mut converted = Converted::default();
        let mut last = Duration::ZERO;
        for moment in run.by_ref() {
            let moment = moment?;
            let passed = moment.at.saturating_sub(last);
            last = moment.at;
            match moment.broken {
                // A missing picture is no reason to cut.
                None | Some(Break::Unseen(_)) => (),
                // The clock of a run that was made of a log leaves gaps out.
                Some(Break::Gap(gap)) if gap.max(passed) > LONGEST_GAP => {
                    log.cut_by(gap.min(LONGEST).saturating_sub(passed));
                }
                Some(Break::Back(_) | Break::Joined) => log.cut_by(JOINED.saturating_sub(passed)),
                // What is longer shows by itself.
                Some(Break::PutBack | Break::TakenOver) if passed > LONGEST_GAP => (),
                Some(Break::Gap(_) | Break::PutBack | Break::TakenOver) => log.cut(),
            }
            let is_seam = matches!(moment.broken, Some(Break::TakenOver | Break::PutBack));
            converted.seams += u64::from(is_seam && converted.rows > 0);
            if write(&moment, kind, &mut log)? {
                converted.rows += 1;
            } else {
                converted.without_picture += 1;
            }
            go_on(progress(converted.rows + converted.without_picture, total), target)?;
        }
        if log.finish()? == 0 {
            return Err(DatasetError::Empty { path: run.path().to_owned() });
        }
        converted.truncated = run.truncated().map(ToString::to_string);
        Ok(converted)
    });
    if result.is_err() {
        // Nothing was there before. As above, one error is enough.
        let _ = fs::remove_file(target.join(LOG_NAME));
        let _ = fs::remove_dir_all(target.join(IMAGES));
        if !was_there {
            let _ = fs::remove_dir(target);
        }
    }
    result
}

fn go_on(progress: ControlFlow<()>, target: &Path) -> Result<(), DatasetError> {
    match progress {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(DatasetError::BrokenOff { path: target.to_owned() }),
    }
}

/// Writes a moment of such a run if it has a picture, and returns whether it has.
fn write(moment: &Moment, kind: RunKind, log: &mut DrivingLogWriter) -> Result<bool, RecordingError> {
    let Moment { at, telemetry, pictures: [Some(Picture::Jpeg(center)), ..], .. } = moment else { return Ok(false) };
    let (steering, throttle, brake) = driven(moment, kind);
    let speed = telemetry.speed;
    log.row(&NewRow { at: *at, center, left: None, right: None, steering, throttle, brake, speed })?;
    Ok(true)
}

/// Steering, throttle and brake from a moment of such a run on.
fn driven(moment: &Moment, kind: RunKind) -> (Steering, Throttle, f64) {
    let telemetry = &moment.telemetry;
    // Builds that do not tell the brake apart report it as a throttle below 0.
    let (throttle, reversed) = (telemetry.throttle, -telemetry.throttle.get());
    let brake = telemetry.truth.brake.unwrap_or(0.0).max(reversed);
    match (moment.followed(), kind) {
        // In a run made of a log, telemetry and command are of the same row, and only the telemetry has the brake apart.
        (None, _) | (_, RunKind::DrivingLog) => (telemetry.steering.steering(), throttle, brake),
        // Along a recording the pilot only steers.
        (Some(command), RunKind::RecordedPath) => (command.steering, throttle, brake),
        (Some(command), _) => (command.steering, command.throttle, (-command.throttle.get()).max(0.0)),
    }
}

#[cfg(test)]
mod tests;
