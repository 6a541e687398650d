//! The car's own bonnet at the bottom of the picture, as the stock cameras see it.
//!
//! Outlines were read off the medians over all frames of `recordings/lake`,
//! for each of the three cameras, at 320x160.
//!
//! The real bonnet is in no shadow, and its every pixel is a linear function of where the sun stands from the car: on the
//! lake 99.7 % of how its middle varies is explained so, on the mountain 97 %, in the jungle 88 %. So each of its surfaces
//! has a colour, and a share of it that the sun adds from ahead and from the right, fitted by least squares to 475, 375
//! and 245 frames of the three recordings.

use glam::{Vec2, Vec3};

use super::{
    Camera,
    noise::mix3,
    paintwork::{Paintwork, Sheet},
};
use crate::vehicle::Car;

/// Corners of an outline: column and row at 320x160.
type BonnetOutline = &'static [(f32, f32)];

const CENTER: BonnetOutline = &[
    (35.0, 160.0),
    (46.0, 155.5),
    (72.0, 150.0),
    (106.0, 144.0),
    (112.0, 141.5),
    (120.0, 139.5),
    (134.0, 137.3),
    (150.0, 136.6),
    (168.0, 136.8),
    (182.0, 138.3),
    (194.0, 140.8),
    (206.0, 144.2),
    (226.0, 149.0),
    (246.0, 154.0),
    (265.0, 160.0),
];
/// Where it bends down: the hood above, its front below.
const FOLD: BonnetOutline = &[
    (67.0, 160.0),
    (78.0, 157.0),
    (90.0, 154.0),
    (102.0, 150.8),
    (114.0, 148.0),
    (126.0, 145.8),
    (138.0, 144.9),
    (168.0, 144.9),
    (180.0, 146.0),
    (192.0, 147.9),
    (204.0, 150.4),
    (216.0, 154.0),
    (228.0, 157.4),
    (238.0, 160.0),
];
/// Where it ends towards the windscreen: the upper one of two gaps.
const GAP: BonnetOutline = &[
    (90.0, 160.0),
    (96.0, 158.0),
    (102.0, 156.2),
    (108.0, 154.8),
    (114.0, 153.2),
    (120.0, 152.0),
    (126.0, 151.2),
    (142.0, 150.0),
    (162.0, 150.0),
    (180.0, 151.0),
    (192.0, 153.0),
    (198.0, 154.2),
    (204.0, 155.6),
    (217.0, 160.0),
];
const LEFT: BonnetOutline = &[
    (185.0, 160.0),
    (187.0, 155.5),
    (192.0, 150.6),
    (199.0, 146.6),
    (208.0, 143.8),
    (222.0, 142.8),
    (234.0, 141.2),
    (248.0, 139.6),
    (262.0, 138.2),
    (276.0, 137.2),
    (296.0, 137.2),
    (320.0, 139.4),
];
const RIGHT: BonnetOutline = &[
    (0.0, 135.2),
    (34.0, 135.4),
    (48.0, 137.2),
    (64.0, 139.4),
    (80.0, 141.6),
    (94.0, 143.2),
    (108.0, 146.6),
    (116.0, 150.4),
    (121.0, 155.0),
    (123.5, 160.0),
];

/// A camera further from the car's middle than this, in metres, is one of the side cameras.
const ASIDE_M: f64 = 0.4;

/// The row of an outline at a column; below the picture beyond its ends.
fn row(outline: BonnetOutline, column: f32) -> f32 {
    for pair in outline.windows(2) {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        if (x0..x1).contains(&column) {
            return y0 + (y1 - y0) * (column - x0) / (x1 - x0);
        }
    }
    200.0
}

/// The first row that the bonnet covers at a column of a stock camera's picture, both counted from the picture's
/// corner at 320x160; beyond the picture where it covers none.
pub fn bonnet_row(camera: &Camera, column: f32) -> f32 {
    let side = camera.mount.position.x;
    let outline = match () {
        () if side.abs() < ASIDE_M => CENTER,
        () if side < 0.0 => LEFT,
        () => RIGHT,
    };
    row(outline, column)
}

/// What one pixel shows: a sheet, and the share of its colour that a sun at the horizon on the right adds.
#[derive(Debug, Clone, Copy)]
struct Facet {
    sheet: Sheet,
    right: f32,
}

/// The pixels that the bonnet covers, worked out once.
#[derive(Debug)]
pub(super) struct Bonnet {
    spans: Vec<(usize, Vec<Facet>)>,
    turned_deg: f32,
}

impl Bonnet {
    /// The bonnet as a camera sees it.
    pub(super) fn new(camera: &Camera, paintwork: &Paintwork) -> Self {
        let (width, height) = (camera.lens.width, camera.lens.height);
        let side = camera.mount.position.x;
        let mut spans = Vec::new();
        for y in height / 2..height {
            let mut span: Option<(usize, Vec<Facet>)> = None;
            for x in 0..width {
                let at = ((x as f32 + 0.5) * 320.0 / width as f32, (y as f32 + 0.5) * 160.0 / height as f32);
                let facet = if side.abs() < ASIDE_M { center(at, paintwork) } else { aside(at, side < 0.0, paintwork) };
                match facet {
                    Some(facet) => span.get_or_insert_with(|| ((y * width + x) * 3, Vec::new())).1.push(facet),
                    None => spans.extend(span.take()),
                }
            }
            spans.extend(span);
        }
        Self { spans, turned_deg: paintwork.turned_deg }
    }

    /// Lays it over a picture, and its nearness over the depths, in the light of a sun and with factors of its colours.
    pub(super) fn draw(&self, (rgb, depth): (&mut [u8], &mut [f32]), car: &Car, sun: Vec3, tint: [f32; 3]) {
        let sun = from_the_car(car, sun, self.turned_deg);
        for (start, facets) in &self.spans {
            if let Some(depth) = depth.get_mut(start / 3..start / 3 + facets.len()) {
                depth.fill(1.0);
            }
            let out = rgb.get_mut(*start..*start + facets.len() * 3).unwrap_or_default();
            for (pixel, facet) in out.as_chunks_mut::<3>().0.iter_mut().zip(facets) {
                let light = (1.0 + facet.sheet.ahead * sun.x + facet.right * sun.y).max(0.08);
                *pixel = [0, 1, 2].map(|c| (facet.sheet.colour[c] * light * tint[c]).min(255.0) as u8);
            }
        }
    }
}

/// How much of the direction to the sun points straight ahead of the car, and how much to its right.
fn from_the_car(car: &Car, sun: Vec3, turned_deg: f32) -> Vec2 {
    let (sin, cos) = turned_deg.to_radians().sin_cos();
    let sun = Vec3::new(sun.x * cos + sun.z * sin, sun.y, sun.z * cos - sun.x * sin);
    let ((sin, cos), (climb, level)) = (car.yaw.sin_cos(), car.pitch.sin_cos());
    let ahead = Vec3::new((sin * level) as f32, climb as f32, (cos * level) as f32);
    Vec2::new(sun.dot(ahead), sun.x * cos as f32 - sun.z * sin as f32)
}

fn center((x, y): (f32, f32), paint: &Paintwork) -> Option<Facet> {
    let edge = row(CENTER, x);
    if y < edge {
        return None;
    }
    // Surfaces are curved: those on the right face right.
    let from_middle = x - 157.0;
    let facet = |sheet, right: f32| Some(Facet { sheet, right });
    let (hood, column) = (paint.hood, x as i32);
    if y - edge < 1.0 {
        let spot = Sheet { colour: hood.colour.map(|c| (c * 1.4).min(240.0)), ahead: 0.1 };
        let dash = Sheet { colour: hood.colour.map(|c| c * 0.5), ahead: 0.3 };
        return match x {
            _ if !(48.0..260.0).contains(&x) => facet(hood, 0.0),
            _ if !(108.0..214.0).contains(&x) && column % 5 == 1 => facet(spot, 0.0),
            _ if x < 112.0 => facet(hood, 0.42),
            _ if x > 224.0 && column % 5 < 3 => facet(dash, 0.9),
            _ if x > 200.0 => facet(Sheet { ahead: 0.15, ..hood }, -0.55),
            _ => facet(paint.lip, if from_middle.abs() < 18.0 { 0.0 } else { -0.006 * from_middle }),
        };
    }
    let below = y - row(GAP, x);
    if below < -1.0 {
        let far = ((y - edge) / (row(FOLD, x).min(161.0) - edge).max(1.0)).clamp(0.0, 1.0);
        let colour = [0.0, -6.0, -10.0].map(|least: f32| least * far);
        let top = Sheet { colour: [0, 1, 2].map(|c| hood.colour[c] + colour[c]), ..hood };
        let front = Sheet { ahead: paint.front.ahead * (1.0 - 0.006 * from_middle.abs()), ..paint.front };
        // The fold is rounded.
        let t = (y - row(FOLD, x) + 0.5).clamp(0.0, 1.0);
        let mix = |a: f32, b: f32| a + (b - a) * t;
        let sheet = Sheet { colour: mix3(top.colour, front.colour, t), ahead: mix(top.ahead, front.ahead) };
        return facet(sheet, mix(0.0023, -0.0058) * from_middle);
    }
    let wiper = [121.5, 192.5].into_iter().any(|at| (x - at).abs() < 2.5) && y > 157.5;
    match below {
        b if b < 0.0 => facet(paint.brink, -0.003 * from_middle),
        b if b < 1.3 => facet(paint.gap, -0.014 * from_middle),
        b if b < 2.0 => facet(paint.rim, 0.0),
        b if b < 2.9 => facet(paint.sill, -0.004 * from_middle),
        b if b < 3.9 => facet(paint.lower_gap, -0.0075 * from_middle),
        _ if wiper => facet(Sheet { ahead: -0.3, ..paint.lower_gap }, -0.02 * from_middle),
        _ => facet(paint.glass, 0.001 * from_middle),
    }
}

fn aside((x, y): (f32, f32), left: bool, paint: &Paintwork) -> Option<Facet> {
    let edge = row(if left { LEFT } else { RIGHT }, x);
    if y < edge {
        return None;
    }
    // From the car's flank, with the headlight, to its middle; a face on the left faces left.
    let (inward, hand) = if left { (x - 186.0, -1.0) } else { (123.0 - x, 1.0) };
    let facet = |sheet, outward: f32| Some(Facet { sheet, right: outward * hand });
    let (fender, hood) = (paint.fender, paint.hood);
    let darker = |times: f32| Sheet { colour: fender.colour.map(|c| c * times), ..fender };
    let lamp_to = 153.4 - 0.24 * (inward - 21.0).abs();
    let seam = (inward - (41.0 + (y - 143.0) * 1.91)).abs() < 0.9;
    let roof = if inward < 82.0 { 143.5 + (inward - 68.0) * 0.25 } else { 147.0 - (inward - 82.0).min(12.0) * 0.12 };
    match inward {
        u if (15.0..31.5).contains(&u) && y < lamp_to => {
            if y > lamp_to - 1.8 {
                facet(Sheet { colour: mix3(paint.lamp.colour, fender.colour, 0.6), ahead: 0.3 }, 0.2)
            } else {
                facet(paint.lamp, 0.0)
            }
        }
        u if u < 16.0 => {
            // The wing beside the lamp reflects the sky.
            let pale = mix3(paint.glass.colour, fender.colour, (u / 16.0).clamp(0.0, 1.0));
            facet(Sheet { colour: pale, ahead: 0.4 }, paint.fender_aside)
        }
        _ if seam => facet(darker(0.55), 0.8),
        u if u > 107.0 - (y - 153.0).max(0.0) * 1.4 && y > 146.0 => {
            let below = y - (154.8 - (u - 115.5) * 0.2);
            match below {
                _ if u < 115.5 => facet(paint.front, -0.15),
                b if b < -1.0 => facet(paint.front, -0.15),
                b if b < 0.0 => facet(paint.brink, 0.0),
                b if b < 1.3 => facet(paint.gap, 0.5),
                b if b < 2.6 => facet(paint.rim, 0.0),
                b if b < 3.6 => facet(paint.lower_gap, 0.4),
                _ => facet(paint.glass, 0.1),
            }
        }
        u if u > 68.0 && y < roof => facet(hood, 0.16),
        u => {
            let t = ((u - 68.0) / 30.0).clamp(0.0, 1.0);
            let ahead = fender.ahead + (hood.ahead + 0.06 - fender.ahead) * t;
            facet(
                Sheet { colour: mix3(fender.colour, hood.colour, 0.4 * t), ahead },
                paint.fender_aside + (0.2 - paint.fender_aside) * t,
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::paintwork::{JUNGLE, LAKE, MOUNTAIN};

    fn drawn(camera: &Camera, paintwork: &Paintwork, car: &Car, sun: Vec3, tint: [f32; 3]) -> Vec<[u8; 3]> {
        let (width, height) = (camera.lens.width, camera.lens.height);
        let (mut rgb, mut depth) = (vec![1; width * height * 3], vec![0.0; width * height]);
        Bonnet::new(camera, paintwork).draw((&mut rgb, &mut depth), car, sun, tint);
        let drawn: Vec<[u8; 3]> = rgb.as_chunks().0.to_vec();
        assert!(drawn.iter().zip(depth).all(|(pixel, depth)| (*pixel == [1; 3]) == (depth == 0.0)));
        drawn
    }

    #[test]
    fn its_hood_is_bright_and_its_front_dark_where_the_sun_is_ahead() {
        let sun = Vec3::new(0.8, 0.6, 0.0);
        for (paintwork, turned) in [(&LAKE, 9.5f64), (&JUNGLE, -3.0), (&MOUNTAIN, -22.0)] {
            let towards = std::f64::consts::FRAC_PI_2 + turned.to_radians();
            let at = |yaw: f64, y: usize| {
                let car = Car { yaw, ..Car::default() };
                drawn(&Camera::CENTER, paintwork, &car, sun, [1.0; 3])[y * 320 + 156]
            };
            for (y, hood) in [(140, true), (147, false)] {
                let (ahead, behind) = (at(towards, y), at(towards + std::f64::consts::PI, y));
                let differs = f64::from(ahead[1]) - f64::from(behind[1]);
                assert!(if hood { differs > 20.0 } else { differs < -10.0 }, "row {y}: {ahead:?} {behind:?}");
            }
        }
    }

    #[test]
    fn side_cameras_see_the_fender_that_faces_the_sun_brighter() {
        let (car, sun) = (Car::default(), Vec3::new(0.8, 0.6, 0.0));
        let fender = |camera: &Camera, x: usize| drawn(camera, &LAKE, &car, sun, [1.0; 3])[152 * 320 + x][1];
        assert!(fender(&Camera::RIGHT, 85) > fender(&Camera::LEFT, 224) + 40);
    }

    #[test]
    fn it_covers_what_the_outline_says_whatever_the_light() {
        for camera in [Camera::CENTER, Camera::LEFT, Camera::RIGHT] {
            for sun in [Vec3::Y, Vec3::new(0.0, 0.1, -0.99), Vec3::new(0.99, 0.1, 0.0)] {
                let all = drawn(&camera, &JUNGLE, &Car::default(), sun, [1.0; 3]);
                for (i, pixel) in all.iter().enumerate() {
                    let below = (i / 320) as f32 + 0.5 >= bonnet_row(&camera, (i % 320) as f32 + 0.5);
                    assert_eq!(*pixel != [1; 3], below, "{} {}: {pixel:?}", i % 320, i / 320);
                }
            }
        }
    }
}
