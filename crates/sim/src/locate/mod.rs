//! Where a car was in each picture of a recording: its place along a known track, its offset from the road's middle and
//! its heading against the road.
//!
//! ```text
//! pose ─▶ the track, drawn ─▶ contours, in the world ─┐
//! picture ─▶ directions of its edges ─────────────────┴─▶ Overlay ─▶ Fit: the pose that agrees best, and how surely
//!                                                                       │
//! how far the car went and turned ─▶ follow ◀───────────────────────────┘
//!                                      └─▶ Located: where it was, by all pictures and by how it moved
//! ```
//! One picture tells well how far beside the road's middle the car will be some metres ahead, and less well how much of
//! that is offset and how much is heading; on a straight road it does not tell the place at all. How the car moved tells
//! the rest: a car goes where it heads. A Kalman filter puts both together, and Rauch, Tung and Striebel's smoother lets
//! later pictures speak about earlier places (Särkkä, Bayesian Filtering and Smoothing, 2013, chapters 5 and 8).
//!
//! How good that is on real pictures says docs/how-to/locate.md: side cameras, each located by itself, are held against where
//! they sit on the car (`lapwing locate DIR --sides`; `tests/locate.rs` looks at pieces of all three roads). The place along the
//! road is known only to some metres: a picture of a straight road does not tell it.
//!
//! Only the road's own edges count: its lines, kerbs and verges, and the walls of a bridge. What grows and stands beside
//! a drawn road is elsewhere than beside the real one.
//!
//! | file | holds |
//! |---|---|
//! | `field` | the directions of a picture's edges |
//! | `overlay` | [`Overlay`]: the track laid over one picture |
//! | `follow` | [`Overlay::follow`]: over those of a drive |
//! | `lane` | [`LocatedDrive`], [`InLane`]: the car in its lane, whichever way round it drives |
//! | `table` | [`LaneTable`]: places of pictures, in a file |
//! | `lines` | [`Overlay::line`]: along the road, as a located picture shows it |

mod field;
mod follow;
mod lane;
mod lines;
mod overlay;
pub mod table;

use glam::DVec3;

pub use follow::{Deviation, FOUND, Known, Located, seen};
pub use lane::{InLane, LocatedDrive};
pub use overlay::{Fit, Glimpse, Overlay};
pub use table::{LaneTable, LaneTableError};

/// Where a car is on a road, and how it stands there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// Metres along the road's middle, counted on from lap to lap.
    pub s_m: f64,
    /// Metres to the right of it.
    pub offset_m: f64,
    /// Radians clockwise from the road's direction; about half a turn if the car drives against it.
    pub heading_rad: f64,
    /// Radians nose up from the road's slope.
    pub pitch_rad: f64,
}

impl Pose {
    /// Place, offset and heading.
    fn vector(self) -> DVec3 {
        DVec3::new(self.s_m, self.offset_m, self.heading_rad)
    }

    /// The pose of the same pitch at this place, offset and heading.
    fn at(self, vector: DVec3) -> Self {
        let [s_m, offset_m, heading_rad] = vector.to_array();
        Self { s_m, offset_m, heading_rad, ..self }
    }

    /// A pose so far along, across and turned from this one.
    fn moved(self, by: DVec3) -> Self {
        self.at(self.vector() + by)
    }
}

#[cfg(test)]
mod tests;
