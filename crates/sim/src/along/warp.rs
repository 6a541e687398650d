//! The view from beside the recorded car: recorded pictures, warped.
//!
//! The stock simulator's cameras are known, so each pixel of the new picture has a known ray. Below the horizon the ray
//! ends on the ground, assumed to be a plane, and the pixel is looked up where a recorded camera saw that place; above
//! it, and where the ground is farther away than that, it ends [80 m away](FAR_M). Upright things beside the road are
//! therefore distorted as if they lay on the ground as far as the horizon, and lean above it; hills are taken to be level.
//! The car's own bonnet moves with the car and is left as it is.
//!
//! What the cameras of one moment do not show from there, pictures of the same road from some metres further back or
//! ahead may: on the way into a bend one saw the verge that is beside the car now. They are asked in the order in which they are
//! given. What none of them shows is filled with the nearest pixel that the nearest camera shows, so that no border is ever
//! black. Of one moment's pictures alone, this much of rows 60 to 134, which PilotNet sees, is filled in, at most, counted
//! over all of their pixels:
//!
//! | cameras | within | filled in |
//! |---|---|---|
//! | three | 0.75 m, facing along the recorded car's heading | nothing |
//! | three | 0.5 m and 1 degree | 0.5 % |
//! | three | 0.5 m and 2 degrees | 1.4 % |
//! | three | 1 m and 2 degrees | 6 % |
//! | one | the recorded place itself | nothing |
//! | one | 0.25 m and 1 degree | 4.5 % |
//! | one | 1 m and 2 degrees | 13 % |
//!
//! A turned camera sees past the recorded picture's edge, and the side cameras face the same way, so that headings cost
//! more than offsets. A car that faces back to where the recorded one is needs least: at 1 m and 5 degrees 0.9 %.

mod again;

use std::{cmp::Ordering, ops::Range};

use glam::{DMat3, DVec3, Mat3, Vec3};

use crate::camera::{Camera, Lens, Mount, RIDE_M, bonnet_row};
use lapwing_core::{motion::turn, perception::Frame};

pub use again::Again;

/// Width and height of the pictures.
pub const SIZE: (usize, usize) = (Lens::STOCK.width, Lens::STOCK.height);

/// The rows that PilotNet sees.
pub const PILOTNET_ROWS: Range<usize> = 60..135;

/// Rows above the edge of the bonnet that JPEG has mixed with it: blocks of colour are 16 pixels wide, but fade fast.
const BONNET_MARGIN: f32 = 2.0;

/// What is seen above the horizon is taken to stand so far away, in metres. The centre camera's pictures, warped to where the
/// side cameras stand, differ above the horizon by 12.3, 13.5 and 11.7 grey levels from theirs on the real lake, jungle and
/// mountain (`tests/recorded_world.rs`); by 15.3, 16.1 and 14.0 if it is taken to be infinitely far away, and by 18.6, 13.5
/// and 11.0 at 40 m (2026-11-26).
const FAR_M: f32 = 80.0;

/// The cameras in the order in which a [`Glimpse`] has their pictures.
pub(super) const CAMERAS: [Camera; 3] = [Camera::CENTER, Camera::LEFT, Camera::RIGHT];

/// The stock cameras, ready to render views from an offset.
#[derive(Debug, Clone)]
pub struct Warp {
    pub(super) cameras: [WarpCamera; 3],
    /// What each pixel of the centre camera's picture shows, in the car's axes: the vector from the camera to it, in metres;
    /// nothing for the car's own bonnet.
    pub(super) points: Vec<Option<Vec3>>,
}

#[derive(Debug, Clone)]
pub(super) struct WarpCamera {
    /// In the car's axes, in metres from the ground below the origin.
    pub(super) position: Vec3,
    /// From the car's axes to the camera's.
    turned: Mat3,
    /// For each column, the first row that the bonnet has touched.
    bonnet: Vec<f32>,
}

/// Where a car is beside the recorded one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Beside {
    /// Metres to its right.
    pub offset_m: f64,
    /// Metres ahead of it.
    pub ahead_m: f64,
    /// How far it faces to the right of it, in radians.
    pub heading_rad: f64,
}

impl Beside {
    /// Where `here` is beside `there`: each a place in the world, whose height does not count, and a yaw.
    pub fn between(here: (DVec3, f64), there: (DVec3, f64)) -> Self {
        let (away, (sin, cos)) = (here.0 - there.0, there.1.sin_cos());
        Self {
            offset_m: away.x * cos - away.z * sin,
            ahead_m: away.x * sin + away.z * cos,
            heading_rad: turn(here.1 - there.1),
        }
    }

    /// The place and yaw of a car that is here beside one that is `there`.
    pub fn from(self, there: (DVec3, f64)) -> (DVec3, f64) {
        let (sin, cos) = there.1.sin_cos();
        let Self { offset_m, ahead_m, heading_rad } = self;
        let away = DVec3::new(offset_m * cos + ahead_m * sin, 0.0, ahead_m * cos - offset_m * sin);
        (there.0 + away, there.1 + heading_rad)
    }
}

/// What one moment's cameras recorded, and where the car is that is to see it.
#[derive(Debug, Clone, Copy)]
pub struct Glimpse<'a> {
    /// The centre camera's picture, the left one's and the right one's, 320x160 each.
    pub pictures: [Option<&'a Frame>; 3],
    /// Where the seeing car is beside the one that recorded them.
    pub beside: Beside,
}

impl Default for Warp {
    fn default() -> Self {
        Self::new()
    }
}

fn focal_px() -> f32 {
    let half = (Lens::STOCK.vertical_fov_deg / 2.0).to_radians();
    (SIZE.1 as f64 / 2.0 / half.tan()) as f32
}

impl WarpCamera {
    fn of(camera: &Camera) -> Self {
        let Mount { position, pitch_deg, yaw_deg, roll_deg } = camera.mount;
        // Unity's order: about z, then x, then y.
        let turned = DMat3::from_rotation_y(yaw_deg.to_radians())
            * DMat3::from_rotation_x(pitch_deg.to_radians())
            * DMat3::from_rotation_z(roll_deg.to_radians());
        Self {
            position: (position + DVec3::Y * RIDE_M).as_vec3(),
            turned: turned.transpose().as_mat3(),
            bonnet: (0..SIZE.0).map(|x| bonnet_row(camera, x as f32 + 0.5) - BONNET_MARGIN).collect(),
        }
    }
}

impl Warp {
    /// A warp for 320x160 pictures of the stock cameras.
    pub fn new() -> Self {
        let cameras = CAMERAS.map(|camera| WarpCamera::of(&camera));
        let [centre, ..] = &cameras;
        let back = centre.turned.transpose();
        let focal = focal_px();
        let (width, height) = (SIZE.0 as f32, SIZE.1 as f32);
        let point = |i: usize| {
            let (x, y) = ((i % SIZE.0) as f32 + 0.5, (i / SIZE.0) as f32 + 0.5);
            if y > centre.bonnet[i % SIZE.0] {
                return None;
            }
            let ray = back * Vec3::new((x - width / 2.0) / focal, (height / 2.0 - y) / focal, 1.0);
            let far = FAR_M / ray.x.hypot(ray.z);
            let ground = if ray.y < 0.0 { centre.position.y / -ray.y } else { f32::INFINITY };
            Some(ray * far.min(ground))
        };
        let points = (0..SIZE.0 * SIZE.1).map(point).collect();
        Self { cameras, points }
    }

    /// Paints what the centre camera of a car elsewhere would have seen: each pixel from the first of the moments that shows
    /// its place, and there from the nearest camera. The bonnet is the first moment's.
    ///
    /// Returns the share of [`PILOTNET_ROWS`] that none of the pictures shows, which is filled in; `None`, and nothing is
    /// painted, if the first moment has no picture of the centre camera, or if a picture is not 320x160.
    pub fn render(&self, moments: &[Glimpse<'_>], out: &mut Frame) -> Option<f64> {
        let mut pictures = moments.iter().flat_map(|moment| moment.pictures).flatten();
        if pictures.any(|picture| (picture.width(), picture.height()) != SIZE) {
            return None;
        }
        out.clone_from(moments.first()?.pictures[0]?);
        let views: Vec<(OtherView<'_>, &Frame)> = moments.iter().flat_map(|moment| self.views(moment)).collect();
        let nearest = views.first()?;
        let mut unseen = 0_usize;
        for (i, (point, pixel)) in self.points.iter().zip(out.rgb_mut().chunks_exact_mut(3)).enumerate() {
            let Some(to) = *point else { continue };
            let mut found = views.iter().map(|(view, picture)| (view, picture, view.find(to)));
            let shown = found.find(|(view, _, at)| view.shows(*at));
            unseen += usize::from(shown.is_none() && PILOTNET_ROWS.contains(&(i / SIZE.0)));
            let (picture, column_row) = match shown {
                Some((_, picture, column_row)) => (picture, column_row),
                None => (&nearest.1, nearest.0.rim(nearest.0.find(to))),
            };
            pixel.copy_from_slice(&colour(picture, column_row));
        }
        Some(unseen as f64 / (PILOTNET_ROWS.len() * SIZE.0) as f64)
    }

    /// The cameras of a moment, the nearest first, with their pictures.
    fn views<'a>(&'a self, moment: &Glimpse<'a>) -> Vec<(OtherView<'a>, &'a Frame)> {
        let pictures = self.cameras.iter().zip(moment.pictures);
        let mut views: Vec<_> =
            pictures.filter_map(|(camera, picture)| Some((self.view(camera, moment.beside), picture?))).collect();
        views.sort_by(|(a, _), (b, _)| a.aside_m.partial_cmp(&b.aside_m).unwrap_or(Ordering::Equal));
        views
    }

    /// What a camera of one car shows to another one beside it.
    fn view<'a>(&self, camera: &'a WarpCamera, beside: Beside) -> OtherView<'a> {
        let Beside { offset_m, ahead_m, heading_rad } = beside;
        let heading = Mat3::from_rotation_y(heading_rad as f32);
        let eye = heading * self.cameras[0].position + Vec3::new(offset_m as f32, 0.0, ahead_m as f32);
        let &WarpCamera { position, turned, .. } = camera;
        let aside_m = (position.x - eye.x).abs();
        OtherView { camera, aside_m, turn: turned * heading, shift: turned * (eye - position) }
    }
}

/// One recorded camera, used for a view from elsewhere.
struct OtherView<'a> {
    camera: &'a WarpCamera,
    /// How far it is to the side of the virtual car's camera, in metres.
    aside_m: f32,
    /// From the virtual car's axes to this camera's.
    turn: Mat3,
    /// From this camera to the virtual car's, in this camera's axes.
    shift: Vec3,
}

impl OtherView<'_> {
    /// Column and row, counted from the picture's corner.
    fn find(&self, to: Vec3) -> [f32; 2] {
        let seen = self.turn * to + self.shift;
        let focal = focal_px();
        let deep = seen.z.max(0.05); // a point behind the camera ends up far to the side
        [SIZE.0 as f32 / 2.0 + focal * seen.x / deep, SIZE.1 as f32 / 2.0 - focal * seen.y / deep]
    }

    /// Whether the picture shows the place, not hidden by the bonnet.
    fn shows(&self, [column, row]: [f32; 2]) -> bool {
        let inside = (0.0..SIZE.0 as f32).contains(&column) && (0.0..SIZE.1 as f32).contains(&row);
        inside && self.camera.bonnet.get(column as usize).is_some_and(|bonnet| row < *bonnet)
    }

    /// The nearest place that it shows, along column and row.
    fn rim(&self, [column, row]: [f32; 2]) -> [f32; 2] {
        let column = column.clamp(0.5, SIZE.0 as f32 - 0.5);
        let lowest = self.camera.bonnet.get(column as usize).copied().unwrap_or(0.0).min(SIZE.1 as f32 - 0.5);
        [column, row.clamp(0.5, lowest.max(0.5))]
    }
}

/// The colour of a picture there, interpolated between the four nearest pixels.
fn colour(picture: &Frame, [column, row]: [f32; 2]) -> [u8; 3] {
    let (x, y) = ((column - 0.5).clamp(0.0, SIZE.0 as f32 - 1.001), (row - 0.5).clamp(0.0, SIZE.1 as f32 - 1.001));
    let (i, j) = (x as usize, y as usize);
    let (s, t) = ((x - i as f32) * 256.0, (y - j as f32) * 256.0);
    let (s, t) = (s as u32, t as u32);
    let rgb = picture.rgb();
    let above = &rgb[(j * SIZE.0 + i) * 3..][..6];
    let below = &rgb[((j + 1) * SIZE.0 + i) * 3..][..6];
    let mixed = |c: usize| {
        let up = u32::from(above[c]) * (256 - s) + u32::from(above[c + 3]) * s;
        let down = u32::from(below[c]) * (256 - s) + u32::from(below[c + 3]) * s;
        ((up * (256 - t) + down * t + (1 << 15)) >> 16) as u8
    };
    [mixed(0), mixed(1), mixed(2)]
}

#[cfg(test)]
#[path = "warp_tests.rs"]
mod tests;
