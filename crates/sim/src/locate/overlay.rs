//! The known track laid over one picture.

use std::sync::Arc;

use glam::{DMat3, DVec3, Vec3};

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

/// A picture, blurred, for a first look.
#[derive(Debug)]
pub struct Glimpse(Field);

impl Glimpse {
    /// Of a picture of as many pixels as the overlay's camera takes.
    pub fn new(picture: &Frame) -> Self {
        Self(Field::new(picture).blurred(COARSE_BLUR))
    }
}

/// A track, ready to be laid over pictures of the stock simulator's camera.
#[derive(Debug)]
pub struct Overlay {
    pub(super) track: Arc<Track>,
    renderer: Renderer,
    camera: Camera,
    /// What was drawn last, and from where.
    drawn: (Pose, Vec<Contour>),
}

impl Overlay {
    /// For pictures of this many pixels, of the stock camera.
    pub fn new(track: Arc<Track>, scenery: Arc<Scenery>, (width, height): (usize, usize)) -> Self {
        let camera = Camera { lens: Lens { width, height, ..Lens::STOCK }, ..Camera::CENTER };
        Self { track, renderer: Renderer::new(scenery), camera, drawn: (Pose::default(), vec![]) }
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

    /// How well a picture agrees with the best pose within `reach` of another, by a coarse search: many times as fast as
    /// [`Overlay::lay`], and enough to tell the few places along a road that a picture may show from all others.
    pub fn glance(&mut self, Glimpse(field): &Glimpse, from: Pose, reach: DVec3) -> f64 {
        let best = self.search(field, from, reach);
        self.redrawn(field, best)
    }

    /// How well the track as it is seen from a pose agrees with a picture.
    fn redrawn(&mut self, field: &Field, pose: Pose) -> f64 {
        let contours = self.visible(field, pose);
        self.agreement(&contours, field, pose)
    }

    /// How fast the agreement falls from a pose on, from which these contours are seen.
    fn sharpness(&mut self, contours: &Seen, field: &Field, pose: Pose) -> DMat3 {
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
        let few = Seen::of(all.of.iter().step_by(all.of.len().div_ceil(FEW).max(1)).copied());
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
    fn visible(&mut self, field: &Field, pose: Pose) -> Seen {
        let view = self.view(pose);
        let right = view.width as f32 - 1.0;
        if self.drawn.0 != pose || self.drawn.1.is_empty() {
            let rows = (view.height as f32 * ABOVE_BONNET).ceil() as usize;
            self.drawn = (pose, self.renderer.contours(&view, rows));
        }
        let all = Seen::of(self.drawn.1.iter().map(|contour| (*contour, 0.0)));
        let mut seen = vec![];
        for (contours, points) in all.of.chunks(TOGETHER).zip(&all.points) {
            let edges = Edges::of(points, &view);
            for (i, (contour, _)) in
                contours.iter().enumerate().filter(|(i, _)| edges.x[*i] > 1.0 && edges.x[*i] < right)
            {
                seen.extend(edges.agrees(i, field, &view).map(|agrees| (*contour, agrees)));
            }
        }
        Seen::of(seen.into_iter())
    }

    /// How well contours lie along the edges of a picture, seen from a pose.
    fn agreement(&self, contours: &Seen, field: &Field, pose: Pose) -> f64 {
        let view = self.view(pose);
        let (mut sum, mut weight) = (0.0, 0.0);
        for (contours, points) in contours.of.chunks(TOGETHER).zip(&contours.points) {
            let edges = Edges::of(points, &view);
            for (i, (contour, agrees)) in contours.iter().enumerate() {
                weight += contour.clearness;
                sum += contour.clearness * edges.agrees(i, field, &view).unwrap_or(*agrees);
            }
        }
        f64::from(sum) / f64::from(weight).max(FEWEST)
    }
}

/// So many contours are projected together, so that the compiler computes with several of them at once.
const TOGETHER: usize = 8;

/// The coordinates of both points of several contours: first x of each, then y, then z.
type Points = [[[f32; TOGETHER]; 3]; 2];

/// Contours.
#[derive(Debug)]
struct Seen {
    /// Each with how well it agrees with a picture, -1 to 1, where it was first laid over it: that counts where it has left the
    /// picture. Else the contours alone that are seen from a pose would hold it there.
    of: Vec<(Contour, f32)>,
    points: Vec<Points>,
}

impl Seen {
    fn of(contours: impl Iterator<Item = (Contour, f32)>) -> Self {
        let of: Vec<_> = contours.collect();
        let mut points = vec![Points::default(); of.len().div_ceil(TOGETHER)];
        for (several, points) in of.chunks(TOGETHER).zip(&mut points) {
            for (i, (contour, _)) in several.iter().enumerate() {
                for (coordinates, point) in points.iter_mut().zip([contour.at, contour.on]) {
                    coordinates.iter_mut().zip(point.to_array()).for_each(|(of_all, own)| of_all[i] = own);
                }
            }
        }
        Self { of, points }
    }
}

/// Where several contours are seen.
#[derive(Debug, Default)]
struct Edges {
    x: [f32; TOGETHER],
    y: [f32; TOGETHER],
    /// How far ahead the nearer point of each is, in metres.
    z: [f32; TOGETHER],
    /// Cosine and sine of twice the angle of the gradient across each.
    cos: [f32; TOGETHER],
    sin: [f32; TOGETHER],
}

impl Edges {
    #[inline]
    fn of([at, on]: &Points, view: &Viewpoint) -> Self {
        let mut edges = Self::default();
        for i in 0..TOGETHER {
            let at = view.turn(Vec3::new(at[0][i], at[1][i], at[2][i]));
            let on = view.turn(Vec3::new(on[0][i], on[1][i], on[2][i]));
            let ((x, y), (x_on, y_on)) = (view.project(at), view.project(on));
            let (right, down) = (x_on - x, y_on - y);
            let along = (right * right + down * down).max(1e-6);
            (edges.x[i], edges.y[i], edges.z[i]) = (x, y, at.z.min(on.z));
            (edges.cos[i], edges.sin[i]) = ((down * down - right * right) / along, -2.0 * right * down / along);
        }
        edges
    }

    /// How well one lies along the edges of a picture, -1 to 1; none outside of it.
    #[inline]
    fn agrees(&self, i: usize, field: &Field, view: &Viewpoint) -> Option<f32> {
        if self.z[i] < 0.5 || self.y[i] >= view.height as f32 * ABOVE_BONNET {
            return None;
        }
        let [cos, sin] = field.at(self.x[i], self.y[i])?;
        Some(cos * self.cos[i] + sin * self.sin[i])
    }
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
