//! The known track laid over one picture.

use std::sync::Arc;

use glam::{DMat3, DVec3};

use super::{Pose, field::Field};
use crate::{
    camera::{Camera, Lens, RIDE_M, Renderer, Scenery, contour::Contour, viewpoint::Viewpoint},
    track::Track,
    vehicle::Car,
};
use lapwing_core::perception::Frame;

/// The share of a picture, from its top, that may show road; below it is the bonnet.
const ABOVE_BONNET: f32 = 0.825;
/// How many contours the coarse search compares.
const FEW: usize = 500;
/// Steps of the coarse search: metres along the road, metres across, radians.
const COARSE: DVec3 = DVec3::new(5.0, 0.25, 0.02);
/// Standard deviations of pitch around the expected one, in radians, and of the offset, in metres; and what such a deviation
/// costs in agreement: a picture of a straight road does not show the pitch.
const PITCH_RAD: f64 = 0.02;
const BESIDE_M: f64 = 4.0;
const COST: f64 = 0.01;
/// What a metre along the road costs: a picture of a straight road does not show the place either, and if it wanders, the
/// heading goes with it where the road bends.
const COST_PER_M: f64 = 0.02;
/// The coarse search compares pictures blurred by this many pixels; then come ever sharper ones.
const COARSE_BLUR: usize = 6;
const BLURS: [usize; 3] = [4, 2, 1];
/// Which of them each further round of the search compares, in steps of this share of [`FINE`].
const ROUNDS: [(usize, f64); 4] = [(0, 1.0), (1, 0.5), (2, 0.3), (2, 0.15)];
/// A picture shows best how far from the middle the car will be this many metres ahead. Turning about that point leaves
/// the near part of the road where it is.
const PIVOT_M: f64 = 5.0;
/// The first steps: of place, offset and heading as in [`COARSE`], and of pitch in radians.
const FINE: [f64; 4] = [1.2, 0.12, 0.012, 0.008];
/// Tries in a round; a try that finds nothing better halves the steps.
const TRIES: usize = 10;
/// Steps in place, offset and heading over which the curvature of the agreement is measured.
const AROUND: DVec3 = DVec3::new(4.0, 0.12, 0.012);
/// Contours with a smaller sum of clearness than this say little.
const FEWEST: f64 = 20.0;

/// The pose that agrees best with a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Where the camera was.
    pub pose: Pose,
    /// How well the drawn edges lie on the picture's, -1 to 1: about 0.5 on real pictures where the road is known well,
    /// 0.1 where nothing fits.
    pub agreement: f64,
    /// How fast the agreement falls with place, offset and heading: minus its second derivatives. Zero in a direction in
    /// which the picture says nothing.
    pub sharpness: DMat3,
}

/// A track, ready to be laid over pictures of the stock simulator's camera.
#[derive(Debug)]
pub struct Overlay {
    pub(super) track: Arc<Track>,
    renderer: Renderer,
    camera: Camera,
}

impl Overlay {
    /// For pictures of this many pixels, of the stock camera.
    pub fn new(track: Arc<Track>, scenery: Arc<Scenery>, (width, height): (usize, usize)) -> Self {
        let camera = Camera { lens: Lens { width, height, ..Lens::STOCK }, ..Camera::CENTER };
        Self { track, renderer: Renderer::new(scenery), camera }
    }

    pub(super) fn view(&self, pose: Pose) -> Viewpoint {
        let Car { position, yaw, pitch, .. } = pose.car(&self.track);
        Viewpoint::new(&self.camera.lens, &self.camera.mount, position + DVec3::Y * RIDE_M, yaw, pitch)
    }

    /// The best pose within `reach` of another: metres along the road, metres across it, radians. A picture of another
    /// size says nothing.
    pub fn lay(&mut self, picture: &Frame, from: Pose, reach: DVec3) -> Fit {
        if (picture.width(), picture.height()) != (self.camera.lens.width, self.camera.lens.height) {
            return Fit { pose: from, agreement: 0.0, sharpness: DMat3::ZERO };
        }
        let field = Field::new(picture);
        let blurred = BLURS.map(|reach| field.blurred(reach));
        let mut best = self.search(&field.blurred(COARSE_BLUR), from, reach);
        for (blur, scale) in ROUNDS {
            best = self.refine(&blurred[blur], from, best, FINE.map(|step| step * scale));
        }
        let contours = self.visible(&blurred[2], best);
        let agreement = self.agreement(&contours, &blurred[2], best);
        Fit { pose: best, agreement, sharpness: self.sharpness(&contours, &blurred[1], best) }
    }

    /// How well the track as it is seen from a pose agrees with a picture.
    fn redrawn(&mut self, field: &Field, pose: Pose) -> f64 {
        let contours = self.visible(field, pose);
        self.agreement(&contours, field, pose)
    }

    /// How fast the agreement falls from a pose on, from which these contours are seen.
    fn sharpness(&mut self, contours: &[Seen], field: &Field, pose: Pose) -> DMat3 {
        let around = |offset: f64, heading: f64| {
            let d = DVec3::new(0.0, offset, heading) * AROUND;
            self.agreement(contours, field, pose.moved(d))
        };
        let top = around(0.0, 0.0);
        let mut falls = DMat3::ZERO;
        falls.y_axis.y = 2.0 * top - around(1.0, 0.0) - around(-1.0, 0.0);
        falls.z_axis.z = 2.0 * top - around(0.0, 1.0) - around(0.0, -1.0);
        falls.y_axis.z = (around(1.0, -1.0) + around(-1.0, 1.0) - around(1.0, 1.0) - around(-1.0, -1.0)) / 4.0;
        falls.z_axis.y = falls.y_axis.z;
        // Whatever place is assumed, most of what is seen from there is seen from a metre before, too: only a road drawn
        // anew tells them apart.
        let further = [-AROUND.x, AROUND.x].map(|way_m| self.redrawn(field, self.driven(pose, way_m)));
        falls.x_axis.x = 2.0 * top - further[0] - further[1];
        let per_step = DMat3::from_diagonal(AROUND.recip());
        per_step * never_negative(falls) * per_step
    }

    /// The best of a grid of poses.
    fn search(&mut self, field: &Field, from: Pose, reach: DVec3) -> Pose {
        let all = self.visible(field, from);
        let few: Vec<_> = all.iter().step_by(all.len().div_ceil(FEW).max(1)).copied().collect();
        let steps = |axis: usize| {
            let most = (reach[axis] / COARSE[axis]) as i32;
            (-most..=most).map(move |i| f64::from(i) * COARSE[axis])
        };
        let (mut best, mut most) = (from, f64::MIN);
        for along in steps(0) {
            for aside in steps(1) {
                for askew in steps(2) {
                    let pose = from.moved(DVec3::new(along, aside, askew));
                    let agreement = self.agreement(&few, field, pose) - unlikely(pose, from);
                    if agreement > most {
                        (best, most) = (pose, agreement);
                    }
                }
            }
        }
        best
    }

    /// The pose a little further straight on.
    fn driven(&self, pose: Pose, way_m: f64) -> Pose {
        let (sin, cos) = pose.heading_rad.sin_cos();
        pose.moved(DVec3::new(cos, sin, -self.track.at(pose.s_m).curvature * cos) * way_m)
    }

    /// A better pose, step by step: straight on, aside, turned about a point ahead, pitched.
    fn refine(&mut self, field: &Field, from: Pose, start: Pose, mut steps: [f64; 4]) -> Pose {
        let contours = self.visible(field, start);
        let ahead_m = PIVOT_M * start.heading_rad.cos();
        let worth = |pose: Pose| self.agreement(&contours, field, pose) - unlikely(pose, from);
        let (mut best, mut most) = (start, worth(start));
        for _ in 0..TRIES {
            let before = most;
            for (axis, size) in steps.into_iter().enumerate() {
                for step in [-size, size] {
                    let pose = match axis {
                        0 => self.driven(best, step),
                        1 => best.moved(DVec3::Y * step),
                        2 => best.moved(DVec3::new(0.0, -ahead_m * step, step)),
                        _ => Pose { pitch_rad: best.pitch_rad + step, ..best },
                    };
                    let agreement = worth(pose);
                    if agreement > most {
                        (best, most) = (pose, agreement);
                    }
                }
            }
            if most == before {
                steps = steps.map(|step| step / 2.0);
            }
        }
        best
    }

    /// The contours that are seen from a pose.
    fn visible(&mut self, field: &Field, pose: Pose) -> Vec<Seen> {
        let view = self.view(pose);
        let right = view.width as f32 - 1.0;
        let seen = |contour: Contour| {
            let (x, _) = view.project(view.turn(contour.at));
            let agrees = agrees_with(field, &view, &contour).filter(|_| x > 1.0 && x < right)?;
            Some(Seen { contour, agrees })
        };
        self.renderer.contours(&view).into_iter().filter_map(seen).collect()
    }

    /// How well contours lie along the edges of a picture, seen from a pose.
    fn agreement(&self, contours: &[Seen], field: &Field, pose: Pose) -> f64 {
        let view = self.view(pose);
        let (mut sum, mut weight) = (0.0, 0.0);
        for Seen { contour, agrees } in contours {
            weight += contour.clearness;
            sum += contour.clearness * agrees_with(field, &view, contour).unwrap_or(*agrees);
        }
        f64::from(sum) / f64::from(weight).max(FEWEST)
    }
}

/// A contour and how well it agrees with a picture, -1 to 1, where it was first laid over it: that counts where it has left
/// the picture. Else the contours alone that are seen from a pose would hold it there.
#[derive(Debug, Clone, Copy)]
struct Seen {
    contour: Contour,
    agrees: f32,
}

/// How well a contour lies along the edges of a picture, -1 to 1; none outside of it.
fn agrees_with(field: &Field, view: &Viewpoint, contour: &Contour) -> Option<f32> {
    let (at, on) = (view.turn(contour.at), view.turn(contour.on));
    if at.z.min(on.z) < 0.5 {
        return None;
    }
    let ((x, y), (x_on, y_on)) = (view.project(at), view.project(on));
    let [cos, sin] = field.at(x, y).filter(|_| y < view.height as f32 * ABOVE_BONNET)?;
    // Gradients stand across the edge.
    let (right, down) = (x_on - x, y_on - y);
    let along = (right * right + down * down).max(1e-6);
    let (cos_on, sin_on) = ((down * down - right * right) / along, -2.0 * right * down / along);
    Some(cos * cos_on + sin * sin_on)
}

/// What a pose costs that is not expected.
fn unlikely(pose: Pose, from: Pose) -> f64 {
    let (pitch, aside) = ((pose.pitch_rad - from.pitch_rad) / PITCH_RAD, pose.offset_m / BESIDE_M);
    COST * (pitch * pitch + aside * aside) + COST_PER_M * (pose.s_m - from.s_m).abs()
}

/// The nearest symmetric matrix that is negative in no direction, by Jacobi's rotations.
fn never_negative(mut m: DMat3) -> DMat3 {
    let mut turned = DMat3::IDENTITY;
    for _ in 0..8 {
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (sin, cos) = (0.5 * (2.0 * m.col(j)[i]).atan2(m.col(j)[j] - m.col(i)[i])).sin_cos();
            let mut turn = DMat3::IDENTITY;
            (turn.col_mut(i)[i], turn.col_mut(j)[j]) = (cos, cos);
            (turn.col_mut(j)[i], turn.col_mut(i)[j]) = (sin, -sin);
            m = turn.transpose() * m * turn;
            turned *= turn;
        }
    }
    let diagonal = DVec3::new(m.x_axis.x, m.y_axis.y, m.z_axis.z).max(DVec3::ZERO);
    turned * DMat3::from_diagonal(diagonal) * turned.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::scenery;

    #[test]
    fn a_picture_of_another_size_says_nothing() {
        let (track, scenery) = scenery("lake");
        let from = Pose { s_m: 300.0, ..Pose::default() };
        let fit = Overlay::new(track.into(), scenery, (320, 160)).lay(&Frame::default(), from, DVec3::ONE);
        assert_eq!(fit, Fit { pose: from, agreement: 0.0, sharpness: DMat3::ZERO });
    }

    #[test]
    fn what_falls_in_no_direction_is_left_out_and_the_rest_stays() {
        let kept = DMat3::from_cols(DVec3::new(2.0, 1.0, 0.0), DVec3::new(1.0, 2.0, 0.0), DVec3::new(0.0, 0.0, -3.0));
        let found = never_negative(kept);
        let expected = DMat3::from_cols(DVec3::new(2.0, 1.0, 0.0), DVec3::new(1.0, 2.0, 0.0), DVec3::ZERO);
        assert!(found.abs_diff_eq(expected, 1e-9), "{found}");
    }
}
