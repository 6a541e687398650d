//! A located car in its lane, seen as it drives: the lane is the line to drive, on the car's own side of the road.

use std::sync::Arc;

use glam::{DMat3, DVec3};

use super::{Deviation, Fit, Located, Pose};
use crate::{
    track::{Place, Track},
    vehicle::Car,
    world::Simulation,
};
use lapwing_core::motion::turn;

/// A recorded drive, located on a track.
#[derive(Debug, Clone)]
pub struct LocatedDrive {
    /// The track.
    pub track: Arc<Track>,
    /// Where the car was in each moment that has a picture, in order; `None` where that is not known.
    pub places: Vec<Option<Located>>,
}

impl LocatedDrive {
    /// Where in its lane the car was, in a moment that has a picture.
    pub fn in_lane(&self, i: usize) -> Option<InLane> {
        let located = self.places.get(i).copied().flatten()?;
        Some(located.pose.in_lane(&self.track))
    }

    /// How far the car turned from one moment to another less than half a turn later, in radians clockwise: with its
    /// lane and in it.
    pub fn turned(&self, from: usize, to: usize) -> Option<f64> {
        let pose = |i: usize| Some(self.places.get(i).copied().flatten()?.pose);
        let (from, to) = (pose(from)?, pose(to)?);
        let with_lane = self.track.at(to.s_m).yaw - self.track.at(from.s_m).yaw;
        Some(turn(with_lane + to.heading_rad - from.heading_rad))
    }
}

/// Where a car is in its lane, in its own direction, whichever way round it drives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InLane {
    /// Metres to the right of the lane's middle.
    pub offset_m: f64,
    /// Radians clockwise from the lane's direction.
    pub heading_rad: f64,
    /// How the lane bends, in 1/m, positive to the right.
    pub curvature: f64,
    /// The road's left and right edge, in metres to the right of the lane's middle.
    pub edges_m: (f64, f64),
}

impl Located {
    /// A place that is known, as it is in a simulation.
    pub fn known(pose: Pose) -> Self {
        let deviation = Deviation { s_m: 0.0, offset_m: 0.0, heading_rad: 0.0, per_metre: [0.0; 2] };
        Self { pose, deviation, fit: Fit { pose, agreement: 1.0, sharpness: DMat3::ZERO } }
    }
}

impl Pose {
    /// The pose of a simulation's car.
    pub fn of(world: &Simulation) -> Self {
        let Place { station, offset } = *world.place();
        let heading_rad = turn(world.car().yaw - station.yaw);
        Self { s_m: station.s, offset_m: offset, heading_rad, pitch_rad: 0.0 }
    }

    /// The car that stands there: against the road's direction, it looks down where the road climbs.
    pub fn car(self, track: &Track) -> Car {
        let station = track.at(self.s_m);
        Car {
            position: track.point(self.s_m, self.offset_m),
            yaw: station.yaw + self.heading_rad,
            pitch: self.direction() * station.grade.atan() + self.pitch_rad,
            ..Car::default()
        }
    }

    /// 1 if the car drives in the track's direction, -1 if it drives against it.
    pub fn direction(self) -> f64 {
        self.heading_rad.cos().signum()
    }

    /// The pose of a car with this offset from its lane's middle and this heading against its lane.
    pub fn from_lane(track: &Track, s_m: f64, reversed: bool, offset_m: f64, heading_rad: f64) -> Self {
        let (sign, turned) = if reversed { (-1.0, std::f64::consts::PI) } else { (1.0, 0.0) };
        let offset_m = sign * (offset_m + track.file().driving_line_m);
        Self { s_m, offset_m, heading_rad: heading_rad + turned, pitch_rad: 0.0 }
    }

    /// The place in the world, without its height, and the yaw.
    pub fn in_world(self, track: &Track) -> (DVec3, f64) {
        (track.point(self.s_m, self.offset_m).with_y(0.0), track.at(self.s_m).yaw + self.heading_rad)
    }

    /// Where in its lane the car is.
    pub fn in_lane(self, track: &Track) -> InLane {
        let (half, lane_m) = (track.half_width(), track.file().driving_line_m);
        let sign = self.direction();
        let against = if sign < 0.0 { std::f64::consts::PI } else { 0.0 };
        InLane {
            offset_m: sign * self.offset_m - lane_m,
            heading_rad: turn(self.heading_rad + against),
            curvature: sign * track.at(self.s_m).curvature,
            edges_m: (-half - lane_m, half - lane_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lane_is_on_the_cars_own_side_whichever_way_round_it_drives() {
        let track = Track::named("jungle").unwrap();
        let lane_m = track.file().driving_line_m;
        let there = Pose { s_m: 100.0, offset_m: lane_m + 0.2, heading_rad: 0.1, pitch_rad: 0.0 };
        let back = Pose { offset_m: -lane_m - 0.2, heading_rad: 0.1 + std::f64::consts::PI, ..there };
        let (there, back) = (there.in_lane(&track), back.in_lane(&track));
        assert!((there.offset_m - 0.2).abs() < 1e-9 && (back.offset_m - 0.2).abs() < 1e-9, "{there:?} {back:?}");
        assert!((there.heading_rad - 0.1).abs() < 1e-9 && (back.heading_rad - 0.1).abs() < 1e-9, "{there:?} {back:?}");
        assert_eq!(there.curvature, -back.curvature);
        // The road is 9.3 m wide: all of the other lane is to the left.
        assert!((there.edges_m.0 + 6.98).abs() < 0.01 && (there.edges_m.1 - 2.32).abs() < 0.01, "{there:?}");
        assert_eq!(there.edges_m, back.edges_m);
        for lane in [there, back] {
            let again = Pose::from_lane(&track, 100.0, lane == back, lane.offset_m, lane.heading_rad).in_lane(&track);
            assert!((again.offset_m - lane.offset_m).abs() < 1e-9, "{again:?} {lane:?}");
            assert!((again.heading_rad - lane.heading_rad).abs() < 1e-9, "{again:?} {lane:?}");
        }
    }
}
