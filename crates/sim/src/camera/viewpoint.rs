//! Where a camera is, which way it faces, and where in its picture a point of the world falls.

use glam::{DVec3, Vec3};

use super::{Lens, Mount, raster::Plane};

/// Nearer than this nothing is seen, in metres; Unity's near plane.
pub(crate) const NEAR: f32 = 0.3;

/// The position and lens of a view.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Viewpoint {
    pub(crate) eye: Vec3,
    pub(crate) right: Vec3,
    pub(crate) up: Vec3,
    pub(crate) forward: Vec3,
    pub(crate) focal: f32,
    pub(crate) cx: f32,
    pub(crate) cy: f32,
    pub(crate) width: usize,
    pub(crate) height: usize,
    sides: [Vec3; 4],
}

impl Viewpoint {
    /// The view of a camera on a car. Unity turns about z, then x, then y.
    pub(crate) fn new(lens: &Lens, mount: &Mount, position: DVec3, yaw: f64, nose_up: f64) -> Self {
        let body = |v: DVec3| about_y(about_x(v, -nose_up), yaw);
        let turned = |v: DVec3| {
            let v = about_z(v, mount.roll_deg.to_radians());
            body(about_y(about_x(v, mount.pitch_deg.to_radians()), mount.yaw_deg.to_radians()))
        };
        let focal = (lens.height as f64 / 2.0 / (lens.vertical_fov_deg.to_radians() / 2.0).tan()) as f32;
        let (right, up, forward) = (turned(DVec3::X).as_vec3(), turned(DVec3::Y).as_vec3(), turned(DVec3::Z).as_vec3());
        let (cx, cy) = (lens.width as f32 / 2.0, lens.height as f32 / 2.0);
        let sides = [
            (forward * cx + right * focal).normalize(),
            (forward * cx - right * focal).normalize(),
            (forward * cy + up * focal).normalize(),
            (forward * cy - up * focal).normalize(),
        ];
        let eye = (position + body(mount.position)).as_vec3();
        Self { eye, right, up, forward, focal, cx, cy, width: lens.width, height: lens.height, sides }
    }

    /// The same, of which only so many rows are looked at, from the top.
    pub(crate) fn upper(self, rows: usize) -> Self {
        Self { height: self.height.min(rows), ..self }
    }

    /// From the world to the camera's axes.
    #[inline]
    pub(crate) fn turn(&self, at: Vec3) -> Vec3 {
        let d = at - self.eye;
        Vec3::new(d.dot(self.right), d.dot(self.up), d.dot(self.forward))
    }

    /// Column and row, in pixels, of a point in the camera's axes.
    #[inline]
    pub(crate) fn project(&self, p: Vec3) -> (f32, f32) {
        let k = self.focal / p.z;
        (self.cx + p.x * k, self.cy - p.y * k)
    }

    /// Whether a ball may be in the picture.
    #[inline]
    pub(crate) fn sees(&self, centre: Vec3, radius: f32) -> bool {
        let d = centre - self.eye;
        d.dot(self.forward) > NEAR - radius && self.sides.iter().all(|side| d.dot(*side) > -radius)
    }

    /// The plane over the picture that a linear function of the camera's axes, divided by depth, makes.
    #[inline]
    pub(super) fn plane(&self, g: Vec3) -> Plane {
        let (x, y) = (g.x / self.focal, -g.y / self.focal);
        Plane { x, y, at: g.z - x * (self.cx - 0.5) - y * (self.cy - 0.5) }
    }
}

fn about_x(v: DVec3, angle: f64) -> DVec3 {
    let (s, c) = angle.sin_cos();
    DVec3::new(v.x, c * v.y - s * v.z, s * v.y + c * v.z)
}

fn about_y(v: DVec3, angle: f64) -> DVec3 {
    let (s, c) = angle.sin_cos();
    DVec3::new(c * v.x + s * v.z, v.y, c * v.z - s * v.x)
}

fn about_z(v: DVec3, angle: f64) -> DVec3 {
    let (s, c) = angle.sin_cos();
    DVec3::new(c * v.x - s * v.y, s * v.x + c * v.y, v.z)
}
