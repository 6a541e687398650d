//! The expert's steering from a place in a lane, whichever way round the car drives: labels for located pictures.

use std::{f64::consts::PI, sync::Arc};

use super::path_ahead;
use crate::{
    locate::Pose,
    track::{Place, Track, TrackError},
    vehicle::Car,
};
use lapwing_core::{
    pilot::PurePursuit,
    units::{MPS_PER_MPH, MetresPerSecond, Mph, PathPoint, Steering},
};

/// Steers back to the lane's middle, as the [`Expert`](super::Expert) does in a simulation.
#[derive(Debug, Clone)]
pub struct LaneExpert {
    there: Arc<Track>,
    back: Track,
    pursuit: PurePursuit,
    path: Vec<PathPoint>,
}

impl LaneExpert {
    /// The expert for the lanes of this road.
    ///
    /// # Errors
    /// Those of [`Track::reversed`].
    pub fn new(track: Arc<Track>) -> Result<Self, TrackError> {
        Ok(Self { back: track.reversed()?, there: track, pursuit: PurePursuit::default(), path: vec![] })
    }

    /// What to steer in this pose at this speed.
    pub fn steering(&mut self, pose: Pose, speed: Mph) -> Steering {
        let (track, pose) = if pose.direction() < 0.0 {
            let s_m = self.there.length() - pose.s_m;
            let turned = Pose { s_m, offset_m: -pose.offset_m, heading_rad: pose.heading_rad + PI, ..pose };
            (&self.back, turned)
        } else {
            (&*self.there, pose)
        };
        let station = track.at(pose.s_m);
        let car = Car {
            position: track.point(pose.s_m, pose.offset_m),
            yaw: station.yaw + pose.heading_rad,
            speed: speed.get() * MPS_PER_MPH,
            ..Car::default()
        };
        path_ahead(track, &Place { station, offset: pose.offset_m }, &car, &mut self.path);
        let pursuit = self.pursuit.pursue(&self.path, MetresPerSecond::saturating(car.speed));
        pursuit.map_or(Steering::ZERO, |pursuit| Steering::saturating(pursuit.steering))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expert::Expert;

    #[test]
    fn it_steers_as_the_expert_that_sees_the_simulation() {
        for name in Track::NAMES {
            let track = Arc::new(Track::named(name).unwrap());
            let (mut lane, mut expert) = (LaneExpert::new(Arc::clone(&track)).unwrap(), Expert::default());
            for i in 0..300 {
                let s_m = track.length() * f64::from(i) / 300.0;
                let (aside, askew) = (f64::from(i % 7 - 3) * 0.4, f64::from(i % 5 - 2) * 0.06);
                let offset_m = track.file().driving_line_m + aside;
                let position = track.point(s_m, offset_m);
                let yaw = track.at(s_m).yaw + askew;
                let speed = Mph::constant(20.0);
                let car = Car { position, yaw, speed: speed.metres_per_second().get(), ..Car::default() };
                let expected = expert.drive(&track, &track.locate(position, Some(s_m)), &car, speed).steering.get();
                let pose = Pose { s_m, offset_m, heading_rad: askew, pitch_rad: 0.0 };
                let got = lane.steering(pose, speed).get();
                assert!((got - expected).abs() < 0.01, "{name} {s_m:.0} m: {got:.3}, expected {expected:.3}");
            }
        }
    }

    #[test]
    fn the_other_way_round_it_keeps_to_its_own_lane() {
        let track = Arc::new(Track::named("jungle").unwrap());
        let lane_m = track.file().driving_line_m;
        let mut expert = LaneExpert::new(Arc::clone(&track)).unwrap();
        // A straight stretch: there, a car on its lane's middle steers little, one to the right of it to the left.
        let straight = |i: &&crate::track::Station| track.at(i.s - 10.0).curvature.abs().max(i.curvature.abs()) < 1e-3;
        let s_m = track.stations().iter().find(straight).unwrap().s;
        let speed = Mph::constant(20.0);
        let mut at = |right_m: f64| {
            let pose = Pose { s_m, offset_m: -(lane_m + right_m), heading_rad: PI, pitch_rad: 0.0 };
            expert.steering(pose, speed).get()
        };
        assert!(at(0.0).abs() < 0.05 && at(1.0) < -0.1 && at(-1.0) > 0.1, "{} {} {}", at(0.0), at(1.0), at(-1.0));
    }
}
