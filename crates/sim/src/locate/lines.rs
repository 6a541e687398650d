//! Lines along the road, as a located picture shows them.

use super::{Overlay, Pose};
use crate::camera::viewpoint::NEAR;

/// Where lines begin and end, in metres ahead, and their pieces.
const FROM_M: f64 = 1.0;
const TO_M: f64 = 60.0;
const PIECE_M: f64 = 0.5;

impl Overlay {
    /// The line that runs so many metres to the right of the road's middle, as seen from a pose: columns and rows, in
    /// pixels, from near to far, some outside the picture. Hills do not hide it.
    pub fn line(&self, pose: Pose, offset_m: f64) -> Vec<(f64, f64)> {
        let view = self.view(pose);
        let sign = pose.direction();
        let point = |i: u32| {
            let ahead = FROM_M + PIECE_M * f64::from(i);
            let at = view.turn(self.track.point(pose.s_m + sign * ahead, offset_m).as_vec3());
            let (x, y) = view.project(at);
            (at.z > NEAR).then_some((f64::from(x), f64::from(y)))
        };
        (0..((TO_M - FROM_M) / PIECE_M) as u32).filter_map(point).collect()
    }
}
