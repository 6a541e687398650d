//! Wires of a power line: lines a pixel wide, with gaps, as thin things are seen.

use glam::Vec3;

use super::{
    plants::Sprite,
    raster::{COLOURED, Raster},
    sprites::picture,
    viewpoint::Viewpoint,
};

/// Where wires hang on a pylon: shares of its height, and of its width from its middle.
const ARMS: [(f32, f32); 4] = [(0.88, -0.44), (0.88, 0.44), (0.76, -0.34), (0.76, 0.34)];
/// How deep a wire hangs in its middle, as a share of its length.
const SAG: f32 = 0.02;
/// Straight pieces that a wire is drawn of.
const PIECES: usize = 24;
/// Share of a pixel's height that a wire is as thick as: this share of its pixels is seen.
const THICK: f32 = 0.25;
const COLOUR: u32 = 60 << 16 | 76 << 8 | 106;
/// Nearer than this to the camera, in metres, nothing is drawn.
const NEAR_M: f32 = 2.0;

/// A wire between two pylons.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wire {
    from: Vec3,
    to: Vec3,
}

/// The wires from each pylon to the next.
pub(super) fn between(sprites: &[Sprite]) -> Vec<Wire> {
    let pylons: Vec<&Sprite> = sprites.iter().filter(|sprite| sprite.picture == picture::PYLON).collect();
    let mut wires = Vec::new();
    for pair in pylons.windows(2) {
        let along = (pair[1].at - pair[0].at).with_y(0.0).normalize_or_zero();
        let across = Vec3::new(along.z, 0.0, -along.x);
        wires.extend(ARMS.iter().map(|(up, out)| {
            let at = |pylon: &Sprite| pylon.at + Vec3::Y * (up * pylon.height) + across * (out * pylon.width);
            Wire { from: at(pair[0]), to: at(pair[1]) }
        }));
    }
    wires
}

impl Wire {
    /// Draws it over what is behind it.
    pub(super) fn draw(&self, raster: &mut Raster, view: &Viewpoint) {
        let sag = SAG * self.from.distance(self.to);
        let at = |i: usize| {
            let t = i as f32 / PIECES as f32;
            view.turn(self.from.lerp(self.to, t) - Vec3::Y * (4.0 * sag * t * (1.0 - t)))
        };
        let mut last = at(0);
        for i in 1..=PIECES {
            let next = at(i);
            if last.z > NEAR_M && next.z > NEAR_M {
                piece(raster, view, last, next);
            }
            last = next;
        }
    }
}

/// A straight piece between two points in the camera's axes.
fn piece(raster: &mut Raster, view: &Viewpoint, a: Vec3, b: Vec3) {
    let ((xa, ya), (xb, yb)) = (view.project(a), view.project(b));
    let steep = (yb - ya).abs() > (xb - xa).abs();
    let ((ua, va), (ub, vb), along, across) = if steep {
        ((ya, xa), (yb, xb), view.height, view.width)
    } else {
        ((xa, ya), (xb, yb), view.width, view.height)
    };
    let (from, to) = (ua.min(ub).max(0.0), ua.max(ub).min(along as f32));
    if from >= to {
        return;
    }
    for u in from.ceil() as usize..to.ceil() as usize {
        let t = (u as f32 - ua) / (ub - ua);
        let v = va + (vb - va) * t;
        if v < 0.0 || v >= across as f32 || v.fract() > THICK {
            continue;
        }
        let (x, y) = if steep { (v as usize, u) } else { (u, v as usize) };
        let (w, i) = (1.0 / (a.z + (b.z - a.z) * t), y * view.width + x);
        if w > raster.depth[i] {
            raster.depth[i] = w;
            raster.ids[i] = COLOURED | COLOUR;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{
        tests::{car, picture, scenery},
        *,
    };

    #[test]
    fn wires_cross_the_sky_before_the_lakes_bridge() {
        let (track, scenery) = scenery("lake");
        assert_eq!(scenery.wires.len(), 2 * super::ARMS.len());
        let mut renderer = Renderer::new(scenery);
        let car = car(&track, 620.0, 0.0);
        picture(&mut renderer, &Camera::CENTER, &car, &[], &Conditions::default());
        let wire = super::COLOURED | super::COLOUR;
        let columns =
            |from: usize| (from..from + 80).filter(|x| (0..40).any(|y| renderer.raster.ids[y * 320 + x] == wire));
        for from in [0, 80, 160, 240] {
            assert!(columns(from).count() > 12, "columns {from} to {}: {}", from + 80, columns(from).count());
        }
        assert!((62 * 320..320 * 160).all(|i| renderer.raster.ids[i] != wire), "none hangs on the ground");
    }

    #[test]
    fn a_country_without_pylons_has_no_wires() {
        assert!(scenery("mountain").1.wires.is_empty());
    }
}
