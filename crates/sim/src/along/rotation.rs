//! How the car turned between two pictures, from the flow of distant scenery.
//!
//! Forward motion moves every patch along the line from the point the car drives to, by an amount that depends on how
//! far away it is. Only rotation moves a patch across that line, so no distance has to be known.

use glam::{DMat3, DVec3};

use super::flow::Pyramid;

/// Focal length of the stock camera, in pixels.
const FOCAL_PX: f64 = 138.56;
/// The centre camera's pitch, nose down, and roll, in degrees.
const PITCH_DEG: f64 = 9.5;
const ROLL_DEG: f64 = 1.2;
/// From the rear axle, which moves where it points, to the camera, in metres.
const REAR_TO_CAMERA_M: f64 = 2.6;
/// Fewer patches are not enough to measure.
const PATCHES: usize = 20;
/// Errors beyond this, in pixels, count little.
const OUTLIER_PX: f64 = 0.5;

/// A turn of the car between two pictures.
#[derive(Debug, Clone, Copy)]
pub struct Rotation {
    /// Nose up, in radians.
    pub pitch: f64,
    /// Clockwise, in radians.
    pub yaw: f64,
    /// Left side up, in radians.
    pub roll: f64,
}

/// How the car turned between two pictures of the centre camera while it rolled `rolled_m` metres; `None` if there is
/// too little to see.
pub fn turn(before: &Pyramid, next: &Pyramid, rolled_m: f64) -> Option<Rotation> {
    let shift = before.shift(next);
    solve(&before.track(next, shift), f64::from(shift), rolled_m)
}

/// Where a pixel lies in the car's frame: right, up, forward.
fn ray(pixel: [f32; 2]) -> DVec3 {
    let (x, y) = ((f64::from(pixel[0]) - 159.5) / FOCAL_PX, (79.5 - f64::from(pixel[1])) / FOCAL_PX);
    let (sin, cos) = PITCH_DEG.to_radians().sin_cos();
    DVec3::new(x, y * cos - sin, cos + y * sin).normalize()
}

fn solve(patches: &[([f32; 2], [f32; 2])], shift: f64, rolled: f64) -> Option<Rotation> {
    if patches.len() < PATCHES {
        return None;
    }
    let rays: Vec<(DVec3, DVec3)> = patches.iter().map(|&(from, to)| (ray(from), ray(to))).collect();
    let mut yaw = -(shift / FOCAL_PX).atan();
    let mut rest = DVec3::ZERO;
    for _ in 0..4 {
        // The camera moves ahead of the rear axle, so outward in a bend.
        let outward = (REAR_TO_CAMERA_M * yaw / rolled.abs().max(0.02)).clamp(-0.5, 0.5) + yaw / 2.0;
        let heading = DVec3::new(outward.sin(), 0.0, outward.cos());
        let (sin, cos) = yaw.sin_cos();
        let equations: Vec<(f64, DVec3)> = rays
            .iter()
            .map(|&(a, b)| {
                let b = DVec3::new(b.x * cos + b.z * sin, b.y, b.z * cos - b.x * sin);
                let (pitch, yaw, roll) =
                    (DVec3::new(0.0, b.z, -b.y), DVec3::new(b.z, 0.0, -b.x), DVec3::new(b.y, -b.x, 0.0));
                let across = |b: DVec3| a.cross(b).dot(heading);
                let scale = a.cross(heading).length() + 0.05;
                (across(b) / scale, DVec3::new(across(pitch), across(yaw), across(roll)) / scale)
            })
            .collect();
        rest = DVec3::ZERO;
        for _ in 0..8 {
            let mut matrix = DMat3::from_diagonal(DVec3::new(1e-3, 1e-6, 1e-3));
            let mut vector = DVec3::ZERO;
            for &(error, gradient) in &equations {
                let miss = (error + gradient.dot(rest)) * FOCAL_PX / OUTLIER_PX;
                let weight = 1.0 / (1.0 + miss * miss);
                matrix +=
                    DMat3::from_cols(gradient * gradient.x, gradient * gradient.y, gradient * gradient.z) * weight;
                vector += gradient * (error * weight);
            }
            rest = -(matrix.inverse() * vector);
        }
        yaw += rest.y;
    }
    // The camera is rolled a little: part of what it sees as pitch is yaw.
    let tilt = ROLL_DEG.to_radians();
    Some(Rotation { pitch: rest.x + tilt * yaw, yaw: yaw - tilt * rest.x, roll: rest.z })
}
