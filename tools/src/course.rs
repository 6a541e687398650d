//! A road by its control points, and where its points are seen from a car on it.

use std::fmt;

use glam::{DMat3, DVec2, DVec3};
use lapwing_sim::{
    camera::{Camera, Lens, RIDE_M},
    track::Track,
};

/// A closed uniform cubic B-spline through the road's middle, as in a track's file. Places on it are given by the
/// spline's parameter, one for each control point, counted on from lap to lap: moving a control point then moves the
/// road nearby and nothing else.
#[derive(Debug, Clone)]
pub struct Course {
    /// The control points: x, y (up), z in metres.
    pub points: Vec<DVec3>,
}

/// The road at a place.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    /// Its middle.
    pub position: DVec3,
    /// The way it goes on the ground plane, x and z, as a unit vector.
    pub ahead: DVec2,
    /// Metres of its ground plane for each step of the parameter.
    pub pace_m: f64,
    /// Metres climbed per metre.
    pub grade: f64,
    /// 1/m, positive to the right.
    pub curvature: f64,
}

impl Spot {
    /// The unit vector to the right.
    pub fn right(&self) -> DVec3 {
        DVec3::new(self.ahead.y, 0.0, -self.ahead.x)
    }

    /// Radians clockwise from +z.
    pub fn yaw(&self) -> f64 {
        self.ahead.x.atan2(self.ahead.y)
    }
}

impl Course {
    /// That of a track.
    pub fn of(track: &Track) -> Self {
        Self { points: track.file().control_points.iter().copied().map(DVec3::from_array).collect() }
    }

    /// The control points that shape the road at a place: the first of four neighbours.
    pub fn first_of(&self, t: f64) -> usize {
        (t.floor() as i64 - 1).rem_euclid(self.points.len() as i64) as usize
    }

    /// The road at a place.
    pub fn at(&self, t: f64) -> Spot {
        let (n, at) = (self.points.len(), self.first_of(t));
        let blend = |w: [f64; 4]| (0..4).map(|k| self.points[(at + k) % n] * w[k]).sum::<DVec3>();
        let [position, first, second] = weights(t).map(blend);
        let pace_m = first.x.hypot(first.z).max(1e-3);
        Spot {
            position,
            ahead: DVec2::new(first.x, first.z) / pace_m,
            pace_m,
            grade: first.y / pace_m,
            curvature: (first.z * second.x - first.x * second.z) / pace_m.powi(3),
        }
    }

    /// How a place's height follows from those of the control points: which, and how much of each.
    pub fn height_by(&self, t: f64) -> [(usize, f64); 4] {
        let [heights, ..] = weights(t);
        self.of_points(t, heights)
    }

    /// The sine of a place's slope, and by how much it grows for each metre that a control point is lifted.
    pub fn climb_by(&self, t: f64) -> (f64, [(usize, f64); 4]) {
        let (Spot { grade, pace_m, .. }, [_, slopes, _]) = (self.at(t), weights(t));
        let cos = grade.atan().cos();
        (grade * cos, self.of_points(t, slopes.map(|slope| slope / pace_m * cos.powi(3))))
    }

    fn of_points(&self, t: f64, weights: [f64; 4]) -> [(usize, f64); 4] {
        let (n, first) = (self.points.len(), self.first_of(t));
        std::array::from_fn(|k| ((first + k) % n, weights[k]))
    }

    /// The point beside a place.
    pub fn point(&self, t: f64, offset_m: f64) -> DVec3 {
        let spot = self.at(t);
        spot.position + spot.right() * offset_m
    }

    /// The same course by twice as many control points (Chaikin and Riesenfeld's subdivision of cubic B-splines); a
    /// place's parameter is then twice as large.
    pub fn finer(&self) -> Self {
        let n = self.points.len();
        let point = |i: usize| {
            let (before, here, after) = (self.points[(i + n - 1) % n], self.points[i], self.points[(i + 1) % n]);
            [(before + here * 6.0 + after) / 8.0, (here + after) / 2.0]
        };
        Self { points: (0..n).flat_map(point).collect() }
    }

    /// Metres between control points, on average.
    pub fn knot_m(&self) -> f64 {
        let n = self.points.len();
        (0..n).map(|i| self.points[i].distance(self.points[(i + 1) % n])).sum::<f64>() / n as f64
    }

    /// The place beside a point, searched for everywhere.
    pub fn beside(&self, point: DVec3) -> f64 {
        let off = |t: f64| (self.at(t).position - point).length_squared();
        let places = (0..self.points.len() * 10).map(|i| i as f64 / 10.0);
        let mut t = places.min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(0.0);
        for _ in 0..4 {
            let spot = self.at(t);
            let away = point - spot.position;
            t += (away.x * spot.ahead.x + away.z * spot.ahead.y) / spot.pace_m;
        }
        t
    }
}

/// How much of four neighbouring control points there is in a place, in its first and in its second derivative.
fn weights(t: f64) -> [[f64; 4]; 3] {
    let u = t - t.floor();
    let v = 1.0 - u;
    [
        [
            v.powi(3) / 6.0,
            (3.0 * u.powi(3) - 6.0 * u * u + 4.0) / 6.0,
            (-3.0 * u.powi(3) + 3.0 * u * u + 3.0 * u + 1.0) / 6.0,
            u.powi(3) / 6.0,
        ],
        [-v * v / 2.0, (3.0 * u * u - 4.0 * u) / 2.0, (-3.0 * u * u + 2.0 * u + 1.0) / 2.0, u * u / 2.0],
        [v, 3.0 * u - 2.0, 1.0 - 3.0 * u, u],
    ]
}

impl fmt::Display for Course {
    /// As a track's file has it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("control_points = [\n")?;
        for row in self.points.chunks(4) {
            let points: Vec<String> = row.iter().map(|p| format!("[{:.2}, {:.2}, {:.2}]", p.x, p.y, p.z)).collect();
            writeln!(f, "  {},", points.join(", "))?;
        }
        f.write_str("]\n")
    }
}

/// How many numbers a [`Stand`] has.
pub const STAND: usize = 5;

/// Where a car stands on the road, and how: place (the spline's parameter), metres to the right of the middle, radians
/// clockwise from the road's direction, radians nose up from its slope, and radians of roll.
pub type Stand = [f64; STAND];

/// Looks from a car's stock centre camera at the road.
#[derive(Debug, Clone, Copy)]
pub struct Eye {
    position: DVec3,
    /// From the world to the camera's axes.
    turned: DMat3,
}

impl Eye {
    /// Of a car that stands on this road.
    pub fn new(course: &Course, stand: &Stand) -> Self {
        let [t, offset_m, heading, pitch, roll] = *stand;
        let (spot, mount) = (course.at(t), Camera::CENTER.mount);
        let nose_up = spot.grade.atan() + pitch;
        let body = DMat3::from_rotation_y(spot.yaw() + heading) * DMat3::from_rotation_x(-nose_up);
        let camera = DMat3::from_rotation_y(mount.yaw_deg.to_radians())
            * DMat3::from_rotation_x(mount.pitch_deg.to_radians())
            * DMat3::from_rotation_z(mount.roll_deg.to_radians() + roll);
        let at = spot.position + spot.right() * offset_m + DVec3::Y * RIDE_M;
        Self { position: at + body * mount.position, turned: (body * camera).transpose() }
    }

    /// A point of the world in the camera's axes: right, up, ahead.
    pub fn turn(&self, point: DVec3) -> DVec3 {
        self.turned * (point - self.position)
    }

    /// Column and row of a point in the camera's axes.
    pub fn project(seen: DVec3) -> DVec2 {
        let lens = Lens::STOCK;
        let focal = lens.height as f64 / 2.0 / (lens.vertical_fov_deg.to_radians() / 2.0).tan();
        DVec2::new(
            lens.width as f64 / 2.0 + focal * seen.x / seen.z,
            lens.height as f64 / 2.0 - focal * seen.y / seen.z,
        )
    }

    /// Column and row of a point of the world that lies ahead.
    pub fn see(&self, point: DVec3) -> Option<DVec2> {
        let seen = self.turn(point);
        (seen.z > 0.5).then(|| Self::project(seen))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jungle() -> (Track, Course) {
        let track = Track::named("jungle").unwrap();
        let course = Course::of(&track);
        (track, course)
    }

    #[test]
    fn the_course_is_the_tracks() {
        let (track, course) = jungle();
        for station in track.stations().iter().step_by(200) {
            let spot = course.at(course.beside(station.position));
            assert!(spot.position.distance(station.position) < 0.01, "{spot:?}, {station:?}");
            assert!(
                (spot.ahead - DVec2::new(station.yaw.sin(), station.yaw.cos())).length() < 0.01,
                "{spot:?}, {station:?}"
            );
            assert!((spot.grade - station.grade).abs() < 0.01, "{spot:?}, {station:?}");
            assert!((spot.curvature - station.curvature).abs() < 0.003, "{spot:?}, {station:?}");
        }
    }

    #[test]
    fn a_slope_grows_as_a_control_point_is_lifted() {
        let (_, course) = jungle();
        for t in [0.3, 17.0, 100.9] {
            let (climb, by) = course.climb_by(t);
            for (point, by) in by {
                let mut lifted = course.clone();
                lifted.points[point].y += 1e-4;
                assert!((lifted.climb_by(t).0 - climb - 1e-4 * by).abs() < 1e-7, "{t}, {point}");
            }
        }
    }

    #[test]
    fn twice_the_control_points_make_the_same_course() {
        let (_, course) = jungle();
        let finer = course.finer();
        for i in 0..1000 {
            let t = f64::from(i) * 0.31;
            assert!(course.point(t, 2.0).distance(finer.point(2.0 * t, 2.0)) < 1e-9, "{t}");
        }
    }
}
