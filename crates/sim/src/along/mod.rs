//! A recording as a world, closed loop: the way NVIDIA tested DAVE-2 before it drove (Bojarski et al. 2016, section 6).
//!
//! ```text
//! Run or Udacity folder ─▶ recorded pictures ─▶ warp ─▶ what the virtual car sees ─▶ Driver
//!          │                      └─▶ flow ─▶ rotation ─┐                              │
//!          ├─▶ steering, speed ───▶ recorded car ───────┼─▶ offset, heading ◀─ virtual car
//!          └─▶ where in its lane it was (`locate`) ─────┘
//! ```
//! A virtual car starts on the line. It drives as fast as the recorded one, abreast of it, and turns as it is steered;
//! its offset and heading relative to the recorded car follow from how both cars moved. The pilot sees the recorded
//! picture, warped to where the virtual car is; where places are known, that of whichever lap was nearest there. Beyond
//! its limit the car is put back on the line: an intervention.
//!
//! Where the recording is [located](crate::locate), the line is the lane's middle: the place of the virtual car is that of
//! the recorded one in its lane, and the offset between them. The recorded car moved as its places in the lane say, so
//! errors do not add up: the picture that is shown and the place that is judged are never further apart than an error of
//! locating. The limit is the road's edge, or metres.
//!
//! Elsewhere the line is the recorded path. The recorded car turned as its pictures show, or, where they show nothing, as
//! its steering says. A pilot that drives in the middle of the lane is then as far off as the recorded driver weaved.
//!
//! Both cars are the simulator's own ([`Car`](crate::vehicle::Car): a bicycle on slipping tyres, calibrated on real
//! recordings), so a pilot that steers as recorded stays on the recorded path unless the pictures say otherwise. The
//! real builds' cars turn a little more or less; a located recording tells how much ([`RecordedWorld::geared`]).
//!
//! What can be judged: interventions, and autonomy calculated from them; offsets from the line, including those at which
//! the car was put back; the steering. The speed is the recording's, and there are no laps and no obstacles: the
//! scorecard says so for every figure that depends on them, and a threshold for such a figure is not reached.
//!
//! | file | holds |
//! |---|---|
//! | `world` | [`RecordedWorld`], the above |
//! | `judging` | what a place is measured from, limits, where a car goes on after an intervention |
//! | `recorded` | rows and pictures of a recording, without standing and gaps |
//! | `abreast` | two cars side by side |
//! | `motion` | how the recorded car moved between two rows |
//! | `nearest` | which of the pictures around a place are shown there, of any lap; what that is chosen by |
//! | `reel`, `album` | pictures: of the rows around one, in order; of all that were taken along a road, by place |
//! | `screen` | what is shown to the virtual car of a [`RecordedWorld`] |
//! | `warp` | the picture as seen from elsewhere; from where a second one of the same place was taken |
//! | `views` | [`Views`]: what a car of the simulator sees along a road of which pictures were recorded |
//! | `flow`, `rotation` | how far the car turned between two pictures |

mod abreast;
mod album;
mod flow;
mod judging;
mod motion;
mod nearest;
mod recorded;
mod reel;
mod rotation;
mod screen;
#[cfg(test)]
mod truth_tests;
mod views;
mod warp;
mod world;

use std::{io, ops::Range, path::PathBuf};

pub use flow::Pyramid;
pub use judging::{DEFAULT_LIMIT_M, FURTHEST_HEADING_DEG, Limit, Measured, Protocol};
pub use motion::{Sources, Yaw};
pub use recorded::{GAP_S, STANDS_MPH, read_stock};
pub use rotation::{Rotation, turn};
pub use views::{Sights, Views};
pub use warp::{Again, Beside, Glimpse, PILOTNET_ROWS, SIZE, Warp};
pub use world::RecordedWorld;

use crate::track::TrackError;
use lapwing_core::{perception::ImageError, recording::RecordingError};

/// A recording that cannot be driven along.
#[derive(Debug, thiserror::Error)]
pub enum ClosedLoopError {
    /// The run or the driving log.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A road.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// A picture's file.
    #[error("{}: expected the picture of a driving log's row, got an error: {source}", path.display())]
    Read {
        /// The picture.
        path: PathBuf,
        /// Why it cannot be read.
        source: io::Error,
    },
    /// A picture that cannot be decoded.
    #[error("{}: {why}", place.display())]
    Picture {
        /// Which.
        place: PathBuf,
        /// Why it cannot be decoded.
        why: ImageError,
    },
    /// Pictures of another camera.
    #[error(
        "{}: expected a picture of {}x{} pixels, got {width}x{height}: a closed loop is possible only with the stock simulator's camera",
        place.display(), SIZE.0, SIZE.1
    )]
    Size {
        /// Which.
        place: PathBuf,
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A run of telemetry alone.
    #[error("{}: expected a run with pictures, got {telemetries} telemetries without one: record it again with pictures", path.display())]
    NoPictures {
        /// The run.
        path: PathBuf,
        /// How many telemetries it has.
        telemetries: usize,
    },
    /// A recording in which the car is stationary.
    #[error(
        "{}: expected a recorded drive{}, got {read} rows with a picture, {stood} of them with the car stationary (under {STANDS_MPH} mph)",
        path.display(), in_rows(within)
    )]
    NothingDriven {
        /// The recording.
        path: PathBuf,
        /// Which rows were to be driven along.
        within: Range<usize>,
        /// Rows with a picture among them.
        read: usize,
        /// Rows without motion.
        stood: usize,
    },
    /// Rows that the recording does not have.
    #[error("{}: expected rows of 0 to {rows}, got {got:?}", path.display())]
    Rows {
        /// The recording.
        path: PathBuf,
        /// How many rows with a picture it has.
        rows: usize,
        /// Which were asked for.
        got: Range<usize>,
    },
    /// The file has changed since it was opened.
    #[error("{}: expected as many pictures as when it was opened, got fewer: something has changed the recording", path.display())]
    Changed {
        /// The recording.
        path: PathBuf,
    },
}

/// Which part of a recording is meant, in words; nothing for all of it.
fn in_rows(within: &Range<usize>) -> String {
    if *within == recorded::ALL_ROWS { String::new() } else { format!(" in rows {within:?}") }
}
