//! Where trees, bushes, boulders and posts stand, and how they are drawn: flat, always facing the camera.

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    noise::{fractal, nearest, step},
    raster::{COLOURED, Raster},
    road::Paver,
    sprites::picture,
    texture::Texture,
    viewpoint::Viewpoint,
};
use crate::track::{Edge, Landmark, LandmarkKind, Side, Theme};

/// Width and height of the lake's pylons and signs, in metres: as large as they are seen from 360 to 450 m, and from 8 m.
const PYLON_M: (f32, f32) = (44.0, 125.0);
const SIGN_M: (f32, f32) = (1.1, 2.5);

/// Something flat that faces the camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sprite {
    /// The middle of its foot.
    pub(super) at: Vec3,
    pub(super) width: f32,
    pub(super) height: f32,
    pub(super) picture: u8,
    pub(super) mirrored: bool,
    /// Brightness of its own.
    pub(super) tone: f32,
}

/// Numbers from 0 to 1 from a seed.
struct Dice(ChaCha8Rng);

impl Dice {
    fn unit(&mut self) -> f32 {
        self.0.random()
    }

    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }
}

/// Plants a country. Nothing stands nearer to a road than its own half width.
pub(super) fn plant(paver: &Paver<'_>) -> Vec<Sprite> {
    let seed = paver.track.file().scenery_seed;
    let mut dice = Dice(ChaCha8Rng::seed_from_u64(seed ^ 0x1A91_1A11));
    let mut sprites = Vec::new();
    let side = paver.ground.side();
    let theme = paver.track.file().theme;
    // Over the whole country, in woods.
    let (tries, steepest) = match theme {
        Theme::Lake => (15_000, 0.72),
        Theme::Jungle => (16_000, 0.4),
        Theme::Mountain => (10_000, 0.5),
    };
    for _ in 0..tries {
        let (x, z) = (paver.ground.x0 + side * dice.unit(), paver.ground.z0 + side * dice.unit());
        let (d, _) = paver.ground.near(x, z);
        let wood = fractal(x / 45.0, z / 45.0, 3, 0, seed as u32 + 200);
        let (chance, size, which) = (dice.unit(), dice.unit(), dice.unit());
        let near = step(70.0, 15.0, d);
        let (picture, width, height) = match theme {
            Theme::Lake => {
                let dense = step(0.40, 0.62, wood) * (1.0 - 0.55 * near) * step(320.0, 120.0, d).max(0.35);
                if chance > dense {
                    continue;
                }
                let tall = 8.0 + 8.0 * size;
                (if which < 0.6 { picture::CONIFER } else { picture::CONIFER_SPARSE }, tall * 0.46, tall)
            }
            Theme::Jungle => {
                if chance > step(0.42, 0.6, wood) * (0.9 - 0.4 * near) {
                    continue;
                }
                match which {
                    _ if d > 90.0 && which < 0.16 => (picture::SPIRE, 12.0 + 8.0 * size, 22.0 + 18.0 * size),
                    w if w < 0.45 => (picture::PALM, 5.0 + 2.0 * size, 5.5 + 3.0 * size),
                    _ => (picture::PALM_LOW, 3.0 + 2.0 * size, 2.4 + 1.6 * size),
                }
            }
            Theme::Mountain => {
                if chance > step(0.40, 0.6, wood) * 0.8 {
                    continue;
                }
                let tall = 5.0 + 5.0 * size;
                (if which < 0.62 { picture::AUTUMN } else { picture::AUTUMN_DARK }, tall * 0.72, tall)
            }
        };
        let slope = paver.ground.normal(x, z).y;
        if slope > steepest {
            add(&mut sprites, paver, &mut dice, paver.ground.place(x, z), picture, (width, height));
        }
    }
    beside(&mut sprites, paver, &mut dice);
    sprites
}

/// What stands in a row along the road.
fn beside(sprites: &mut Vec<Sprite>, paver: &Paver<'_>, dice: &mut Dice) {
    let track = paver.track;
    let half = track.half_width();
    let sides = [(Side::Left, -1.0), (Side::Right, 1.0)];
    let mut s = 0.0;
    while s < track.length() {
        let station = track.at(s);
        for (side, sign) in sides {
            let has = |edge| track.file().has(edge, side, s);
            let free = ![Edge::Bridge, Edge::Rock, Edge::Water].into_iter().any(has);
            let (chance, out, size) = (dice.unit(), f64::from(dice.unit()), dice.unit());
            let mut stand = |out: f64, picture, size| {
                let p = track.point(s, sign * (half + out));
                let mut at = paver.ground.place(p.x as f32, p.z as f32);
                if picture == picture::POST {
                    // They belong to the road, and may have nothing but air behind them.
                    at.y = at.y.max(p.y as f32);
                }
                add(sprites, paver, dice, at, picture, size);
            };
            let outside = station.curvature * sign < -0.012;
            let metre = s as i64;
            match track.file().theme {
                Theme::Lake if has(Edge::Dirt) || !free => {
                    if chance < 0.10 && !has(Edge::Dirt) && !has(Edge::Bridge) {
                        stand(4.5 + 3.0 * out, picture::REEDS, (3.0 + 2.0 * size, 1.1 + 0.9 * size));
                    }
                }
                Theme::Lake => match chance {
                    c if c < 0.10 => stand(6.0 + 9.0 * out, picture::BUSH, (1.2 + 1.8 * size, 0.6 + 0.7 * size)),
                    c if c < 0.125 => stand(6.0 + 5.0 * out, picture::REEDS, (3.5 + 3.0 * size, 1.6 + 1.2 * size)),
                    c if c < 0.155 => {
                        let tall = 8.0 + 8.0 * size;
                        stand(7.5 + 14.0 * out, picture::CONIFER_SPARSE, (tall * 0.5, tall));
                    }
                    c if c < 0.165 => stand(14.0 + 20.0 * out, picture::BOULDER, (7.0 + 8.0 * size, 2.6 + 3.0 * size)),
                    _ => {}
                },
                Theme::Jungle => {
                    if has(Edge::Posts) && metre % 4 < 2 {
                        stand(Edge::Posts.stands_off_m(), picture::POST, (0.9, 3.6));
                    } else if chance < 0.07 {
                        stand(3.2 + 6.0 * out, picture::PALM, (4.2 + 1.4 * size, 4.6 + 2.4 * size));
                    } else if chance < 0.16 {
                        stand(2.6 + 5.0 * out, picture::PALM_LOW, (1.6 + 1.4 * size, 1.1 + 0.9 * size));
                    }
                }
                Theme::Mountain => {
                    if sign > 0.0 && metre % 44 < 2 {
                        stand(2.6, picture::LAMP, (3.0, 7.5));
                    } else if outside && metre % 12 < 2 {
                        stand(2.8, picture::CHEVRON, (0.9, 1.9));
                    } else if chance < 0.12 && free {
                        let tall = 4.0 + 5.0 * size;
                        stand(5.0 + 10.0 * out, picture::AUTUMN, (tall * 0.74, tall));
                    } else if chance < 0.24 && free {
                        stand(3.6 + 5.0 * out, picture::AUTUMN_DARK, (1.4 + 1.6 * size, 1.0 + 1.1 * size));
                    }
                }
            }
        }
        s += 2.0;
    }
    landmarks(sprites, paver, dice);
}

/// Pylons and signs where the track's file has them; along a lake without any, a row of pylons.
fn landmarks(sprites: &mut Vec<Sprite>, paver: &Paver<'_>, dice: &mut Dice) {
    let (file, ground) = (paver.track.file(), paver.ground);
    if file.theme == Theme::Lake && file.landmarks.is_empty() {
        let side = ground.side();
        for k in 0..9 {
            let across = 0.08 + 0.84 * k as f32 / 8.0;
            let (x, z) = (ground.x0 + side * across, ground.z0 + side * (0.12 + 0.03 * (k % 3) as f32));
            add(sprites, paver, dice, ground.place(x, z), picture::PYLON, (17.0, 44.0));
        }
    }
    let mut stand = |(x, z): (f32, f32), picture, size: (f32, f32)| {
        let at = ground.place(x, z) - Vec3::Y * 0.12;
        let tone = dice.between(0.82, 1.12);
        if paver.clear(at, size.0 / 2.0 + 0.6) {
            sprites.push(Sprite { at, width: size.0, height: size.1, picture, mirrored: false, tone });
        }
    };
    for Landmark { kind, x, z } in &file.landmarks {
        let at = (*x as f32, *z as f32);
        match kind {
            LandmarkKind::Pylon => stand(at, picture::PYLON, PYLON_M),
            LandmarkKind::Sign => stand(at, picture::SIGN, SIGN_M),
        }
    }
}

fn add(
    sprites: &mut Vec<Sprite>,
    paver: &Paver<'_>,
    dice: &mut Dice,
    at: Vec3,
    picture: u8,
    (width, height): (f32, f32),
) {
    let (mirrored, tone) = (dice.unit() < 0.5, dice.between(0.82, 1.12));
    let (foot, at) = (at.y, at - Vec3::Y * 0.12);
    let dry =
        paver.ground.water.is_none_or(|water| foot > water + 0.2 || picture == picture::REEDS && foot > water - 0.3);
    if dry && paver.clear(at, width / 2.0 + 0.6) {
        sprites.push(Sprite { at, width, height, picture, mirrored, tone });
    }
}

impl Sprite {
    /// Draws it. `tint` gives, for its distance and direction, the factor of its colours in 256ths and what is added to
    /// them.
    pub(super) fn draw(
        &self,
        raster: &mut Raster,
        view: &Viewpoint,
        pictures: &[Texture],
        tint: impl FnOnce(&Sprite, f32) -> ([i32; 3], [i32; 3]),
    ) {
        if (self.at - view.eye).dot(view.forward) < 0.8 {
            return;
        }
        let foot = view.turn(self.at);
        if foot.z < 0.8 || foot.x.abs() > foot.z * view.cx / view.focal + self.width + self.height * 0.1 {
            return;
        }
        let top = view.turn(self.at + Vec3::Y * self.height);
        // It stands upright at the depth of its foot: pitch only shortens it.
        let (fx, fy) = view.project(foot);
        let (tx, ty) = view.project(Vec3::new(top.x, top.y, foot.z));
        let tall = fy - ty;
        if tall < 1.5 || fy < 0.0 || ty > view.height as f32 {
            return;
        }
        let wide = self.width * view.focal / foot.z;
        let texture = &pictures[self.picture as usize];
        // The copy whose texels are about as large as pixels.
        let mut level = 0;
        let mut finer = (texture.height() as f32 / tall).min(texture.width() as f32 / wide.max(0.5));
        while finer > 1.4 {
            finer *= 0.5;
            level += 1;
        }
        let least = [120, 110, 92, 80, 66, 56][level.min(5)];
        let from = texture.level(level);
        let w = 1.0 / foot.z;
        let (multiply, add) = tint(self, foot.z);
        let first = nearest(ty.max(0.0));
        let last = nearest(fy.clamp(0.0, view.height as f32));
        let du = from.width as f32 / wide * if self.mirrored { -1.0 } else { 1.0 };
        for y in first..last {
            let t = (y as f32 + 0.5 - ty) / tall;
            let v = ((t * from.height as f32) as usize).min(from.height - 1);
            let middle = tx + (fx - tx) * t;
            let left = nearest((middle - wide / 2.0).clamp(0.0, view.width as f32));
            let right = nearest((middle + wide / 2.0).clamp(0.0, view.width as f32));
            if left >= right {
                continue;
            }
            let texels = &from.texels[v * from.width..][..from.width];
            // In 65,536ths of a texel.
            let mut u = (((left as f32 + 0.5 - middle) * du + from.width as f32 / 2.0) * 65_536.0) as i32;
            let step = (du * 65_536.0) as i32;
            let span = y * view.width + left..y * view.width + right;
            let (depths, ids) = (&mut raster.depth[span.clone()], &mut raster.ids[span]);
            for (depth, id) in depths.iter_mut().zip(ids) {
                let at = (u >> 16) as usize;
                u += step;
                if w <= *depth {
                    continue;
                }
                let texel = texels[at.min(texels.len() - 1)];
                if texel[3] >= least {
                    *depth = w;
                    let c = |k: usize| (((i32::from(texel[k]) * multiply[k]) >> 8) + add[k]).clamp(0, 255) as u32;
                    *id = COLOURED | c(0) << 16 | c(1) << 8 | c(2);
                }
            }
        }
    }

    /// Whether a point on the ground lies in its shadow; `away` points from the sun along the ground, `climb` is how
    /// far the sun's rays rise per metre.
    pub(super) fn shades(&self, p: Vec3, away: Vec3, climb: f32, picture: &Texture) -> bool {
        let d = p - self.at;
        let along = d.x * away.x + d.z * away.z;
        let high = along * climb + (p.y - self.at.y);
        let aside = (d.x * away.z - d.z * away.x) / self.width + 0.5;
        let v = 1.0 - high / self.height;
        if !(0.0..1.0).contains(&aside) || !(0.0..1.0).contains(&v) {
            return false;
        }
        let view = picture.level(1);
        let (x, y) = ((aside * view.width as f32) as usize, (v * view.height as f32) as usize);
        view.texels[y * view.width + x][3] > 100
    }
}
