//! The road and the car as viewers draw them in 3D, and where the car is.
//!
//! The telemetry's axes are Unity's: x right, y up, z forward. Viewers want x and y on the ground and z up, and of a car
//! x ahead and y to its left. The frame `world` has Unity's x, z and y, in this order; in the frame `car` the car stands
//! still.

use foxglove::messages::{
    Color, CubePrimitive, FrameTransform, LinePrimitive, Point3, Pose, Quaternion, SceneEntity, SceneUpdate, Timestamp,
    TriangleListPrimitive, Vector3, line_primitive,
};

use crate::{car, units::Metres};

/// The car's direction is told from ways of at least this length, in metres: reported positions are rounded.
const MOVED_M: f64 = 0.25;
/// The line to drive lies this far above the road, in metres, so that it is seen.
const LINE_ABOVE_M: f64 = 0.05;
/// Its width, in metres.
const LINE_WIDTH_M: f64 = 0.15;

const ROAD: Color = Color { r: 0.38, g: 0.39, b: 0.41, a: 1.0 };
const LINE: Color = Color { r: 0.95, g: 0.75, b: 0.2, a: 1.0 };
const BODY: Color = Color { r: 0.13, g: 0.45, b: 0.85, a: 1.0 };
const CABIN: Color = Color { r: 0.1, g: 0.12, b: 0.15, a: 1.0 };

/// A road for drawing, in the telemetry's axes, in metres.
#[derive(Debug, Clone, PartialEq)]
pub struct Roadway {
    /// The track's name, as telemetry and events tell it.
    pub name: String,
    /// The left edge, closed.
    pub left: Vec<[f64; 3]>,
    /// The right edge, closed, with a point beside each of the left one's.
    pub right: Vec<[f64; 3]>,
    /// The line to drive, closed.
    pub line: Vec<[f64; 3]>,
}

/// The names of the coordinate frames.
#[derive(Debug, Clone)]
pub(super) struct Frames {
    pub world: String,
    pub car: String,
    pub camera: String,
}

impl Frames {
    /// Frames whose names begin so.
    pub fn of(prefix: &str) -> Self {
        let [world, car, camera] = ["world", "car", "camera_center"].map(|name| format!("{prefix}{name}"));
        Self { world, car, camera }
    }
}

/// Which way the car points. It is not told, so this is the way in which it moves.
#[derive(Debug, Clone, Default)]
pub(super) struct Pointing {
    from: Option<[f64; 3]>,
    rotation: Option<Quaternion>,
}

impl Pointing {
    /// The transform of a car that is here now; none before it has moved.
    pub fn moved_to(&mut self, position: [Metres; 3], timestamp: Timestamp, frames: &Frames) -> Option<FrameTransform> {
        let [x, y, z] = in_world(position.map(Metres::get));
        match self.from {
            None => self.from = Some([x, y, z]),
            Some(from) => {
                let [dx, dy, dz] = [x - from[0], y - from[1], z - from[2]];
                let way = dx.hypot(dy).hypot(dz);
                if way >= MOVED_M {
                    self.from = Some([x, y, z]);
                    if way <= car::PUT_M {
                        self.rotation = Some(towards(dx, dy, dz));
                    }
                }
            }
        }
        Some(FrameTransform {
            timestamp: Some(timestamp),
            parent_frame_id: frames.world.clone(),
            child_frame_id: frames.car.clone(),
            translation: Some(Vector3 { x, y, z }),
            rotation: Some(self.rotation?),
        })
    }

    /// The car is put elsewhere: the way there says nothing.
    pub fn put_back(&mut self) {
        self.from = None;
    }
}

/// From x, y and z of the telemetry.
fn in_world([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, z, y]
}

/// The rotation that turns x into this direction, without a roll.
fn towards(dx: f64, dy: f64, dz: f64) -> Quaternion {
    let (half_yaw, half_rise) = (dy.atan2(dx) / 2.0, dz.atan2(dx.hypot(dy)) / 2.0);
    let ((sin_yaw, cos_yaw), (sin_rise, cos_rise)) = (half_yaw.sin_cos(), half_rise.sin_cos());
    Quaternion { x: sin_yaw * sin_rise, y: -cos_yaw * sin_rise, z: sin_yaw * cos_rise, w: cos_yaw * cos_rise }
}

/// The car, on its road if that is known.
pub(super) fn scene(road: Option<&Roadway>, timestamp: Timestamp, frames: &Frames) -> SceneUpdate {
    let entity = |id: &str, frame_id: &str| SceneEntity {
        timestamp: Some(timestamp),
        frame_id: frame_id.to_owned(),
        id: id.to_owned(),
        frame_locked: true,
        ..SceneEntity::default()
    };
    let car = SceneEntity { cubes: car(), ..entity("car", &frames.car) };
    let road = road.map(|road| SceneEntity {
        triangles: vec![surface(road)],
        lines: vec![line(road)],
        ..entity("road", &frames.world)
    });
    SceneUpdate { deletions: vec![], entities: road.into_iter().chain([car]).collect() }
}

/// A body, and a cabin by which one sees where its rear is.
fn car() -> Vec<CubePrimitive> {
    let middle = (car::FRONT_AXLE_M - car::REAR_AXLE_M) / 2.0;
    let half = car::HEIGHT_M / 2.0;
    let cube = |ahead, above, length, width, color| CubePrimitive {
        pose: Some(pose(ahead, above)),
        size: Some(Vector3 { x: length, y: width, z: half }),
        color: Some(color),
    };
    vec![
        cube(middle, half / 2.0, car::LENGTH_M, car::WIDTH_M, BODY),
        cube(middle - 0.1 * car::LENGTH_M, 1.5 * half, 0.5 * car::LENGTH_M, 0.8 * car::WIDTH_M, CABIN),
    ]
}

fn surface(road: &Roadway) -> TriangleListPrimitive {
    let pairs = road.left.len().min(road.right.len());
    let points = road.left.iter().zip(&road.right).flat_map(|(left, right)| [point(*left, 0.0), point(*right, 0.0)]);
    let corners = 2 * pairs as u32;
    let indices = (0..corners).step_by(2).flat_map(|left| {
        let (right, next_left, next_right) = (left + 1, (left + 2) % corners, (left + 3) % corners);
        [left, right, next_left, next_left, right, next_right]
    });
    TriangleListPrimitive {
        pose: Some(pose(0.0, 0.0)),
        points: points.collect(),
        color: Some(ROAD),
        colors: vec![],
        indices: indices.collect(),
    }
}

fn line(road: &Roadway) -> LinePrimitive {
    LinePrimitive {
        r#type: line_primitive::Type::LineLoop.into(),
        pose: Some(pose(0.0, 0.0)),
        thickness: LINE_WIDTH_M,
        points: road.line.iter().map(|at| point(*at, LINE_ABOVE_M)).collect(),
        color: Some(LINE),
        ..LinePrimitive::default()
    }
}

fn pose(x: f64, z: f64) -> Pose {
    Pose { position: Some(Vector3 { x, y: 0.0, z }), orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }) }
}

fn point(at: [f64; 3], above_m: f64) -> Point3 {
    let [x, y, z] = in_world(at);
    Point3 { x, y, z: z + above_m }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What this rotation makes of the vector, by the product of quaternions.
    fn turned(q: Quaternion, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let (axis, v) = ([q.x, q.y, q.z], [x, y, z]);
        let once = cross(axis, v).map(|part| 2.0 * part);
        let twice = cross(axis, once);
        [0, 1, 2].map(|i| v[i] + q.w * once[i] + twice[i])
    }

    fn at(x: f64, y: f64, z: f64) -> [Metres; 3] {
        [x, y, z].map(Metres::constant)
    }

    fn road() -> Roadway {
        let corner =
            |half: f64| [[-half, 1.0, -half], [half, 1.0, -half], [half, 1.0, half], [-half, 1.0, half]].to_vec();
        // Driven anticlockwise as seen from above, so the left edge is the inner one.
        Roadway { name: "square".into(), left: corner(10.0), right: corner(14.0), line: corner(12.0) }
    }

    #[test]
    fn a_car_points_where_it_moves_up_and_down_hill_with_its_wheels_on_the_ground() {
        for (step, ahead) in [
            ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]),
            ([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
            ([0.0, 0.0, -1.0], [0.0, -1.0, 0.0]),
            ([0.6, 0.8, 0.0], [0.6, 0.0, 0.8]),
            ([-0.48, -0.6, 0.64], [-0.48, 0.64, -0.6]),
        ] {
            let mut pointing = Pointing::default();
            let [x, y, z] = step;
            let frames = Frames::of("");
            assert_eq!(pointing.moved_to(at(0.0, 0.0, 0.0), Timestamp::new(1, 0), &frames), None);
            let transform = pointing.moved_to(at(x, y, z), Timestamp::new(2, 0), &frames).unwrap();
            let rotation = transform.rotation.unwrap();
            let close = |a: [f64; 3], b: [f64; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-12);
            assert!(close(turned(rotation, [1.0, 0.0, 0.0]), ahead), "{step:?}: {rotation:?}");
            let left = turned(rotation, [0.0, 1.0, 0.0]);
            assert!(left[2].abs() < 1e-12 && turned(rotation, [0.0, 0.0, 1.0])[2] > 0.0, "{step:?}: it rolls");
            let there = transform.translation.unwrap();
            assert!(close([there.x, there.y, there.z], ahead), "{there:?}");
        }
    }

    #[test]
    fn a_car_that_stands_or_is_put_elsewhere_keeps_its_direction() {
        let (mut pointing, frames) = (Pointing::default(), Frames::of(""));
        let mut rotation = |x: f64, z: f64| {
            let transform = pointing.moved_to(at(x, 0.0, z), Timestamp::new(1, 0), &frames);
            transform.and_then(|transform| transform.rotation)
        };
        assert_eq!((rotation(0.0, 0.0), rotation(0.0, 0.1)), (None, None));
        let north = rotation(0.0, 0.3).unwrap();
        assert_eq!(rotation(0.1, 0.3), Some(north), "too little to tell");
        assert_eq!(rotation(90.0, 0.0), Some(north), "nobody drives that far in a telemetry");
        assert_ne!(rotation(91.0, 0.0), Some(north));
        pointing.put_back();
        let east = pointing.rotation;
        let transform = pointing.moved_to(at(91.0, 0.0, 5.0), Timestamp::new(1, 0), &frames).unwrap();
        assert_eq!(transform.rotation, east);
    }

    #[test]
    fn a_road_is_a_closed_band_that_faces_up() {
        let surface = surface(&road());
        assert_eq!((surface.points.len(), surface.indices.len()), (8, 24));
        for corners in surface.indices.chunks(3) {
            let [a, b, c] = [0, 1, 2].map(|i| surface.points[corners[i] as usize]);
            let up = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
            assert!(up > 0.0 && a.z == 1.0, "{corners:?}");
        }
        let used: std::collections::BTreeSet<_> = surface.indices.iter().collect();
        assert_eq!(used.len(), 8);
    }
}
