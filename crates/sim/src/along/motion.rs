//! How the recorded car moved from one row to the next: told from its lane, from its pictures, or from its steering.

use super::{
    flow::Pyramid,
    recorded::PathRow,
    rotation::{self, Rotation},
};
use crate::locate::LocatedDrive;
use lapwing_core::{car::FULL_STEERING_DEG, motion};

/// Where the recorded car's yaw rate comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Yaw {
    /// Its places in its lane where they are known; elsewhere the shift of the scenery from picture to picture if it
    /// can be seen, otherwise the steering.
    #[default]
    Pictures,
    /// Recorded steering and speed alone.
    Steering,
}

/// Where the recorded car's yaw rate came from, counted in intervals between two rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sources {
    /// Intervals measured from where the car was in its lane.
    pub lane: usize,
    /// Intervals measured from the pictures.
    pub pictures: usize,
    /// Intervals computed from the steering.
    pub steering: usize,
}

/// What the recorded car did between two rows; nothing of what only its steering tells.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moved {
    /// Radians a second, clockwise.
    pub yaw_rate: Option<f64>,
    /// Metres a second to its right.
    pub aside: Option<f64>,
}

/// From one row to another: their seconds, and how many of them are simulated, as physics goes step by step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Interval {
    pub from: PathRow,
    pub to: PathRow,
    pub simulated_s: f64,
}

impl Interval {
    pub(super) fn seconds(&self) -> f64 {
        self.to.at_s - self.from.at_s
    }

    /// The mean speed, in metres a second.
    pub(super) fn mps(&self) -> f64 {
        (self.from.mps() + self.to.mps()) / 2.0
    }

    /// The motion from one place in the lane to another. What is simulated leads exactly there, so that nothing adds up
    /// over a drive.
    pub(super) fn by_lane(&self, drive: &LocatedDrive) -> Option<Moved> {
        let (from, to) = (self.from.index, self.to.index);
        let (was, is) = (drive.in_lane(from)?, drive.in_lane(to)?);
        let yaw_rate = self.believed(drive.turned(from, to)?, self.simulated_s)?;
        // What it came aside in its lane, less what came of its heading there.
        let (sin, cos) = ((was.heading_rad + is.heading_rad) / 2.0).sin_cos();
        let aside = ((is.offset_m - was.offset_m) / self.simulated_s - self.mps() * sin) / cos.max(0.3);
        Some(Moved { yaw_rate: Some(yaw_rate), aside: Some(aside) })
    }

    /// The motion by the pictures of both rows.
    pub(super) fn by_pictures(&self, before: &Pyramid, next: &Pyramid) -> Option<Moved> {
        let Rotation { yaw, .. } = rotation::turn(before, next, self.mps() * self.seconds())?;
        Some(Moved { yaw_rate: Some(self.believed(yaw, self.seconds())?), aside: None })
    }

    /// A yaw rate that a car on its tyres can have: up to twice what full steering asks for, and a little more for
    /// contact with a wall.
    fn believed(&self, turned: f64, seconds: f64) -> Option<f64> {
        let most = 0.5 + motion::yaw_rate(2.0 * self.from.mps(), FULL_STEERING_DEG);
        Some(turned / seconds).filter(|rate| rate.abs() < most)
    }
}
