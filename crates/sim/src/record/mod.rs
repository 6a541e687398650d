//! Training data: the stock recorder's files of a drive, with what the expert would do at each moment.
//!
//! ```text
//!               ┌──────────── answer ───────────────┐
//! Simulation ─▶ Lesson ─▶ telemetry ─▶ Driver ──────┤
//!               └─▶ what the expert would do ───────┴─▶ LessonLog ─▶ DrivingLogWriter, lane.csv
//! ```
//! [`drive::run`] pairs the driver with a [`Lesson`], which decides whose steering the car
//! obeys: the expert's, with noise, or the driver's, from which it is put back when it leaves the road. The log holds what
//! the expert would do in either case. So a network sees where its own errors lead to and what to do there: DAgger (Ross,
//! Gordon and Bagnell 2011); noise as large as the driver's own errors is DART (Laskey et al. 2017).
//!
//! Beside the log, [`LANE_NAME`] tells where in its lane the car was, in each row. [`along`] records the same of a drive
//! along a located recording.
//!
//! | file | holds |
//! |---|---|
//! | `lesson` | [`Lesson`]: who drives |
//! | `log` | what is written of each moment; [`Shots`] takes its pictures |
//! | `disturbance` | noise, and starts beside the line |
//! | `along` | lessons along recordings |
//! | `stances` | [`stances()`]: pictures from anywhere on the road, without a drive |

mod along;
mod disturbance;
mod lesson;
mod log;
mod stances;

use std::{io, path::PathBuf};

pub use along::along;
pub use lesson::Lesson;
pub use log::Shots;
pub use stances::{StanceOptions, stances};

use self::log::LessonLog;
use crate::world::{Ending, Simulation};
use lapwing_core::{
    drive::{self, ObserverError, TurnError},
    driver::Driver,
    recording::{RecordingError, udacity::DrivingLogWriter},
    units::{Mph, Steering},
};

/// The name of the table of places beside a log.
pub const LANE_NAME: &str = "lane.csv";

/// Standard deviation of the steering noise, normalised, while nothing is known of the driver's own errors.
pub const NOISE: f64 = 0.12;

/// Who drives how, and what is recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordOptions {
    /// How fast the expert drives, if bends allow it.
    pub speed: Mph,
    /// Whether the car is sometimes put beside the line and askew, and the expert's steering disturbed, so that a model
    /// learns to recover. Default no.
    pub recovery: bool,
    /// Standard deviation of that disturbance, normalised steering. Default [`NOISE`].
    pub noise: f64,
    /// Whether the left and right cameras are recorded, too. Default yes.
    pub side_cameras: bool,
    /// How far the car weaves to each side of the line, in metres, as people do; the log holds what was steered, not what
    /// the expert would. Default 0.
    pub weave_m: f64,
    /// Share of the time in which the expert drives, in stretches of a few seconds; in the rest the driver does. Default 1.
    pub expert: f64,
    /// Whether the drive begins somewhere along the lap, where the seed decides. Default: at the track's start.
    pub anywhere: bool,
}

impl RecordOptions {
    /// The three cameras of the expert's drive along the line.
    pub fn at(speed: Mph) -> Self {
        Self { speed, recovery: false, noise: NOISE, side_cameras: true, weave_m: 0.0, expert: 1.0, anywhere: false }
    }
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordReport {
    /// Rows of the log.
    pub rows: u64,
    /// Laps completed.
    pub laps: u32,
    /// Why the drive ended.
    pub ending: Ending,
    /// How often the car was put back on the road.
    pub put_back: u32,
    /// How far the driver's steering was from the expert's: the root of the mean square, normalised steering; `None` if
    /// the driver never drove.
    pub disagreement: Option<f64>,
}

/// How far a driver's steering is from the expert's.
#[derive(Debug, Clone, Copy, Default)]
struct Disagreement {
    squares: f64,
    count: u32,
}

impl Disagreement {
    fn add(&mut self, driver: Steering, expert: Steering) {
        self.squares += (driver.get() - expert.get()).powi(2);
        self.count += 1;
    }

    /// The root of the mean square; `None` without any.
    fn rms(self) -> Option<f64> {
        (self.count > 0).then(|| (self.squares / f64::from(self.count)).sqrt())
    }
}

/// A drive that cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The log or a picture.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The table of places.
    #[error("{}: cannot be written: {source}", path.display())]
    Lane {
        /// The table.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The recording that is driven along.
    #[error(transparent)]
    World(#[from] crate::along::ClosedLoopError),
    /// The road of the recording, driven the other way round.
    #[error(transparent)]
    Track(#[from] crate::track::TrackError),
    /// Anything else that watches the drive.
    #[error(transparent)]
    Observer(ObserverError),
}

impl RecordError {
    fn of<E: Into<Self>>(error: TurnError<E>) -> Self {
        match error {
            TurnError::World(error) => error.into(),
            TurnError::Observer(error) => error.downcast().map_or_else(Self::Observer, |error| *error),
        }
    }
}

impl From<std::convert::Infallible> for RecordError {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}

/// Drives a world to its end and logs each moment at which telemetry is sent. `watch` sees the world after each row and
/// may end it. While the expert drives, which by default it always does, the driver's answers do not count.
///
/// # Errors
/// [`RecordError`] where the log or a picture cannot be written.
pub fn record(
    simulation: &mut Simulation,
    driver: &mut Driver,
    log: DrivingLogWriter,
    options: RecordOptions,
    watch: impl FnMut(&mut Simulation),
) -> Result<RecordReport, RecordError> {
    let mut written = LessonLog::new(log, options.side_cameras);
    let mut lesson = Lesson::new(simulation, options, watch);
    drive::run(&mut lesson, driver, &mut [&mut written]).map_err(RecordError::of)?;
    let (put_back, disagreement) = (lesson.put_back(), lesson.disagreement());
    let rows = written.finish()?;
    let ending = simulation.ending().cloned().unwrap_or(Ending::Interrupted);
    Ok(RecordReport { rows, laps: simulation.laps(), ending, put_back, disagreement })
}
