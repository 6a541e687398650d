//! Where a road's edges lie in a picture, by geometry alone.

use glam::{DMat3, DVec3};

use lapwing_sim::track::Track;

/// Where a car is on a road.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// Metres along the road.
    pub s: f64,
    /// Metres from its middle, positive to the right.
    pub offset: f64,
    /// Radians from the road's direction, positive clockwise.
    pub yaw: f64,
}

/// The stock simulator's centre camera as it stands above the road, in 320 x 160 pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurveyLens {
    /// From the camera's axes to the car's.
    turned: DMat3,
    /// Metres from the point of the ground below the car's origin.
    position: DVec3,
}

impl SurveyLens {
    /// Pixels: 60 degrees of vertical field over 160 rows.
    pub const FOCAL_PX: f64 = 138.564;

    /// Pictures are seen from here at speed.
    ///
    /// Measured over the straight half of a real lake recording from the yellow lines of 80 pictures, whose spacing and
    /// slope give height, pitch and roll: 7.2 degrees down instead of the scene file's 9.5, as the body stands nose up
    /// on its springs. The height is the one in `tracks/README.md`; yaw is the scene's, as only its sum with the car's
    /// own is visible.
    pub fn stock() -> Self {
        Self::new(7.2, 0.72, 1.4, DVec3::new(0.0, 1.25, 1.0))
    }

    /// A camera at `position` in the car's axes, turned by Unity's Euler angles in degrees:
    /// pitch positive downward, yaw positive to the right, roll positive where its right rises.
    pub fn new(pitch_deg: f64, yaw_deg: f64, roll_deg: f64, position: DVec3) -> Self {
        let turned = DMat3::from_rotation_y(yaw_deg.to_radians())
            * DMat3::from_rotation_x(pitch_deg.to_radians())
            * DMat3::from_rotation_z(roll_deg.to_radians());
        Self { turned, position }
    }

    /// Column and row at which a point in the car's axes is seen; `None` behind the camera.
    pub fn project(&self, point: DVec3) -> Option<[f64; 2]> {
        let seen = self.turned.transpose() * (point - self.position);
        (seen.z > 0.3).then(|| [160.0 + Self::FOCAL_PX * seen.x / seen.z, 80.0 - Self::FOCAL_PX * seen.y / seen.z])
    }

    /// Column and row at which the road beside `s` at an offset is seen from a pose.
    pub fn project_road(&self, track: &Track, pose: Pose, s: f64, offset: f64) -> Option<[f64; 2]> {
        let here = track.at(pose.s);
        let base = track.point(pose.s, pose.offset);
        let (sin, cos) = (here.yaw + pose.yaw).sin_cos();
        let away = track.point(s, offset) - base;
        let ahead = away.x * sin + away.z * cos;
        // The car stands on the slope of the road below it.
        self.project(DVec3::new(away.x * cos - away.z * sin, away.y - here.grade * ahead, ahead))
    }

    /// The columns at which a line along the road, `offset` from its middle, crosses the middles of `rows` for the
    /// first time, looking away from the car; `None` if it does not, or beyond the picture's sides.
    pub fn line(&self, track: &Track, pose: Pose, offset: f64, rows: &[usize]) -> Vec<Option<f64>> {
        let mut columns = vec![None; rows.len()];
        let mut last: Option<[f64; 2]> = None;
        let mut highest = f64::INFINITY; // the row last reached: anything lower and further is hidden or behind
        for ahead in steps() {
            let Some(now) = self.project_road(track, pose, pose.s + ahead, offset) else { continue };
            if let Some(before) = last.filter(|_| now[1] < highest) {
                for (column, &row) in columns.iter_mut().zip(rows) {
                    let row = row as f64 + 0.5;
                    if column.is_none() && now[1] <= row && row < before[1] {
                        let t = (row - before[1]) / (now[1] - before[1]);
                        *column = Some(before[0] + t * (now[0] - before[0]));
                    }
                }
            }
            if now[1] < highest {
                highest = now[1];
                last = Some(now);
            }
        }
        columns
    }
}

/// Metres ahead, close together near the car, where a row is a short piece of road.
fn steps() -> impl Iterator<Item = f64> {
    let near = (0..28).map(|i| f64::from(i) * 0.5 - 2.0);
    let middle = (0..12).map(|i| 12.0 + f64::from(i) * 1.5);
    let far = (0..13).map(|i| 30.0 + f64::from(i) * 4.0);
    near.chain(middle).chain(far)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_camera_sees_a_point_ahead_of_it_in_the_middle() {
        let lens = SurveyLens::new(0.0, 0.0, 0.0, DVec3::new(0.0, 1.0, 0.0));
        assert_eq!(lens.project(DVec3::new(0.0, 1.0, 10.0)), Some([160.0, 80.0]));
        assert_eq!(lens.project(DVec3::new(0.0, 1.0, -1.0)), None);
        let [column, row] = lens.project(DVec3::new(1.0, 0.0, 2.0)).unwrap();
        assert!((column - 229.282).abs() < 1e-9 && (row - 149.282).abs() < 1e-9, "{column} {row}");
    }

    #[test]
    fn signs_are_unitys() {
        let far = DVec3::new(0.0, 0.0, 1e6);
        let at = |pitch, yaw, roll, point| SurveyLens::new(pitch, yaw, roll, DVec3::ZERO).project(point).unwrap();
        assert!(at(5.0, 0.0, 0.0, far)[1] < 80.0, "looking down lifts the horizon");
        assert!(at(0.0, 5.0, 0.0, far)[0] < 160.0, "looking right moves things left");
        let right = DVec3::new(1e6, 0.0, 1e6);
        assert!(at(0.0, 0.0, 5.0, right)[1] > 80.0, "its right side up, the world's right goes down");
    }

    #[test]
    fn the_middle_of_a_straight_road_runs_to_the_vanishing_point() {
        let track = Track::named("lake").unwrap();
        let lens = SurveyLens::new(7.2, 0.0, 0.0, DVec3::new(0.0, 1.25, 1.0));
        let pose = Pose { s: 330.0, ..Pose::default() };
        let columns = lens.line(&track, pose, 0.0, &[70, 90, 110, 130]);
        for (column, limit) in columns.into_iter().zip([12.0, 4.0, 2.0, 2.0]) {
            assert!((column.unwrap() - 160.0).abs() < limit, "{column:?}");
        }
        assert_eq!(lens.line(&track, pose, 0.0, &[40]), [None]);
    }
}
