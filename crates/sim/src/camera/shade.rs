//! From what each pixel shows to its colour.

use glam::{Vec3, Vec4};

use super::{
    Scenery,
    light::{Light, MAP},
    noise::{nearest, step},
    plants::Sprite,
    raster::{COLOURED, FaceSetup, Paint, Plane, Raster, SKY},
    scenery::Surface,
    section::{STRIPES_PER_M, Section},
    texture::Texel,
    viewpoint::Viewpoint,
};
use crate::conditions::Conditions;

/// Fog hides no more than this share, in 256ths.
const MOST_FOG: i32 = 205;

/// A road's texels span at least this many pixels of what is seen of it.
const COARSER: f32 = 1.5;

/// Where the grain is as crisp as it gets, the texture's copies are this many steps finer, and this much of its contrast
/// is left: as in `recordings/lake-autonomous`, the crispest of all.
const FINER: f32 = 1.2;
const CRISP_CONTRAST: f32 = 0.78;

/// How many times as bright road and bonnet are at the stock build's high graphics setting as at its low one, by colour:
/// medians of 20 places of `recordings/lake-high-graphics` and the same of `recordings/lake`.
const COLD_ROAD: [f32; 3] = [1.02, 1.05, 1.10];
const COLD_BONNET: [f32; 3] = [1.13, 1.27, 1.42];

/// Everything that colours depend on.
pub(super) struct Shader<'a> {
    pub(super) scenery: &'a Scenery,
    pub(super) light: &'a Light,
    pub(super) view: &'a Viewpoint,
    /// The road's cross-sections.
    pub(super) sections: &'a [Section],
    pub(super) graphics: Graphics,
}

/// What a build's graphics settings change on the road.
#[derive(Debug, Clone, Copy)]
pub(super) struct Graphics {
    /// How much of the surface's contrast shows, 0 to 1.
    grain: f32,
    /// How crisp it is: 0 as usual, 1 as crisp as it gets, below 0 coarser.
    crisp: f32,
    /// Factor of the road's colours.
    tint: Vec4,
    /// How much of the sunlight shadows take away, 0 to 1.
    shadows: f32,
}

impl Graphics {
    /// As some conditions ask for.
    pub(super) fn of(conditions: &Conditions) -> Self {
        let grain = conditions.grain as f32;
        Self {
            grain: if grain > 1.0 { 1.0 + (CRISP_CONTRAST - 1.0) * (grain - 1.0) } else { grain },
            crisp: grain - 1.0,
            tint: Vec3::from_array(tint(conditions.warmth, COLD_ROAD)).extend(0.0),
            shadows: conditions.shadows.unwrap_or(1.0) as f32,
        }
    }

    /// Factors of the bonnet's colours under some conditions.
    pub(super) fn bonnet_tint(conditions: &Conditions) -> [f32; 3] {
        tint(conditions.warmth, COLD_BONNET)
    }

    /// The share of the light that is left where `lit` of it would be left in the darkest shadow.
    #[inline]
    pub(super) fn lit(self, lit: f32) -> f32 {
        lit + (1.0 - lit) * (1.0 - self.shadows)
    }
}

/// Factors of colours where `cold` are those of the coldest real setting.
fn tint(warmth: f64, cold: [f32; 3]) -> [f32; 3] {
    cold.map(|cold| cold.powf(-warmth as f32))
}

/// A piece of a row that shows one triangle.
struct PixelRun<'a> {
    setup: &'a FaceSetup,
    y: usize,
    from: usize,
    to: usize,
}

impl Shader<'_> {
    /// Colours all pixels.
    pub(super) fn shade(&self, raster: &Raster, rgb: &mut [u8]) {
        let width = self.view.width;
        for (y, row) in rgb.chunks_exact_mut(width * 3).enumerate() {
            let ids = &raster.ids[y * width..][..width];
            let mut from = 0;
            while from < width {
                let id = ids[from];
                let mut to = from + 1;
                while to < width && ids[to] == id {
                    to += 1;
                }
                let out = &mut row[from * 3..to * 3];
                if id == SKY {
                    self.sky(y, from, out);
                } else if id & COLOURED != 0 {
                    fill(out, [(id >> 16) as u8, (id >> 8) as u8, id as u8]);
                } else {
                    let setup = &raster.setups[id as usize - 1];
                    let run = PixelRun { setup, y, from, to };
                    match setup.paint {
                        Paint::Ground => self.ground(&run, out),
                        Paint::Road { section, station } => self.road(&run, section, station, out),
                        Paint::Tile { texture, tint } => self.tile(&run, texture, tint, out),
                        Paint::Flat(colour) => self.flat(&run, colour, out),
                        Paint::Water => self.water(&run, out),
                    }
                }
                from = to;
            }
        }
    }

    /// The factor of a sprite's colours and what is added to them, by distance and position of the sun.
    pub(super) fn tint(&self, sprite: &Sprite, depth: f32) -> ([i32; 3], [i32; 3]) {
        let towards = (sprite.at - self.view.eye).with_y(0.0).normalize_or_zero();
        let sun = self.light.sun.with_y(0.0).normalize_or_zero();
        // Looking towards the sun shows the dark side.
        let share = 1.05 - 0.95 * step(-0.5, 0.8, towards.dot(sun));
        let fog = self.fog(depth);
        let multiply = self.light.multiply(share * 1.1).map(|m| (m as f32 * sprite.tone) as i32 * (256 - fog) / 256);
        let add = self.scenery.look.fog.map(|c| c as i32 * fog / 256);
        (multiply, add)
    }

    #[inline]
    fn fog(&self, depth: f32) -> i32 {
        ((depth * self.scenery.fog_per_m) as i32).min(MOST_FOG)
    }

    fn sky(&self, y: usize, from: usize, out: &mut [u8]) {
        let view = self.view;
        let down = (y as f32 + 0.5 - view.cy) / view.focal;
        let ray = view.forward - view.up * down;
        let sun = self.light.sun;
        for (i, pixel) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let aside = ((from + i) as f32 + 0.5 - view.cx) / view.focal;
            let [r, g, b] = self.light.sky(ray.y + view.right.y * aside);
            // A little brighter towards the sun.
            let towards = (ray.x + view.right.x * aside) * sun.x + (ray.z + view.right.z * aside) * sun.z;
            let k = 256 + (towards * 26.0) as i32;
            *pixel = [lit(r, k, 0), lit(g, k, 0), lit(b, k, 0)];
        }
    }

    fn flat(&self, run: &PixelRun<'_>, colour: [u8; 3], out: &mut [u8]) {
        let w = run.setup.w.row(run.y) + run.setup.w.x * ((run.from + run.to) / 2) as f32;
        let m = self.light.multiply(run.setup.light.min(1.15));
        fill(out, self.finish(colour, m, self.fog(1.0 / w)));
    }

    fn water(&self, run: &PixelRun<'_>, out: &mut [u8]) {
        let colour = self.scenery.look.water.unwrap_or([128.0; 3]).map(|c| c as u8);
        let mirrored = self.light.sky(0.03);
        let w = run.setup.w;
        let row = w.row(run.y);
        for (i, pixel) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let depth = 1.0 / (row + w.x * (run.from + i) as f32).max(1e-6);
            let glare = ((depth * 0.45) as i32).min(190);
            let at = |c: usize| blend(i32::from(colour[c]), i32::from(mirrored[c]), glare);
            *pixel = [at(0), at(1), at(2)];
        }
    }

    #[inline]
    fn finish(&self, colour: [u8; 3], multiply: [i32; 3], fog: i32) -> [u8; 3] {
        let to = self.scenery.fog;
        let at = |c: usize| blend((i32::from(colour[c]) * multiply[c]) >> 8, to[c], fog);
        [at(0), at(1), at(2)]
    }

    fn tile(&self, run: &PixelRun<'_>, texture: u8, tint: [u8; 3], out: &mut [u8]) {
        let texture = &self.scenery.tiles[texture as usize];
        // Grey 128 is the tint itself; a picture in its own colours has a white tint.
        let own = if tint == [255; 3] { 1 } else { 2 };
        let light = self.light.multiply(run.setup.light);
        let size = (texture.width() * texture.height()) as f32;
        for (piece, out) in run.pieces(out) {
            let level = texture.level(log2(piece.across.max(1e-5) * piece.along.max(1e-5) * size) / 2);
            let (keep, add) = self.veil(piece.depth);
            let m = |c: usize| (((light[c] * (i32::from(tint[c]) + 1) * own) >> 8) * keep) >> 8;
            let m = [m(0), m(1), m(2)];
            let (mut u, mut v) = (piece.u + 64.0, piece.v + 64.0);
            for pixel in out.as_chunks_mut::<3>().0 {
                let texel = level.wrapped(u, v);
                *pixel = [lit(texel[0], m[0], add[0]), lit(texel[1], m[1], add[1]), lit(texel[2], m[2], add[2])];
                u += piece.du;
                v += piece.dv;
            }
        }
    }

    fn ground(&self, run: &PixelRun<'_>, out: &mut [u8]) {
        let scale = self.scenery.map_texels_per_m;
        let detail = self.scenery.detail_per_m;
        for (piece, out) in run.pieces(out) {
            let area = piece.across.max(1e-4) * piece.along.max(1e-4);
            let (keep, add) = self.veil(piece.depth);
            let map = self.light.map.level(log2(area * scale * scale) / 2);
            let fine = self.scenery.detail.level(log2(area * (detail * 256.0).powi(2)) / 2);
            let near = area * scale * scale < 0.25;
            let (mut u, mut v) = (piece.u, piece.v);
            for pixel in out.as_chunks_mut::<3>().0 {
                let m = (i32::from(fine.wrapped(u * detail, v * detail)[0]) * keep) >> 7;
                let colour = if near {
                    smooth(map.texels, map.width, u * scale - 0.5, v * scale - 0.5)
                } else {
                    map.wrapped(u * (scale / MAP as f32), v * (scale / MAP as f32))
                };
                *pixel = [lit(colour[0], m, add[0]), lit(colour[1], m, add[1]), lit(colour[2], m, add[2])];
                u += piece.du;
                v += piece.dv;
            }
        }
    }

    fn road(&self, run: &PixelRun<'_>, section: u8, station: u16, out: &mut [u8]) {
        let section = &self.sections[section as usize];
        let graphics = self.graphics;
        let Surface { texture, along_per_m, across_per_m } = &self.scenery.surfaces[section.texture as usize];
        let texels = texture.width() as f32;
        let coarser = COARSER * (-FINER * graphics.crisp).exp2();
        let shaded = self.light.shaded[station as usize];
        let light = run.setup.light;
        let tinted = |light: [f32; 4]| Vec4::from_array(light) * graphics.tint;
        let (shade, direct) = (tinted(self.light.shade4), tinted(self.light.direct4));
        let (sheen, fog) = (self.scenery.sheen4, self.scenery.fog4);
        for (piece, out) in run.pieces(out) {
            // As coarse as the longer side of what a pixel spans, which at a flat angle is the one along the road: real
            // roads are smeared like this.
            let longer = (piece.across * across_per_m).max(piece.along * along_per_m) * texels;
            let surface = texture.level(log2(longer * coarser));
            let stripes = section.level(log2(piece.across * (STRIPES_PER_M * 0.7)));
            let veiled = (piece.depth * self.scenery.fog_per_m * (1.0 / 256.0)).min(0.8);
            let add = fog * veiled;
            let shine = piece.depth / (piece.depth + 14.0);
            let mut multiply = (shade + direct * light) * (1.0 - veiled);
            let (mut s, mut offset) = (piece.u + run.setup.base, piece.v);
            for pixel in out.as_chunks_mut::<3>().0 {
                let stripe = stripes.at(offset.abs());
                let texel = surface.wrapped(s * along_per_m, (offset + 64.0) * across_per_m);
                let mut colour = stripe.plain;
                if stripe.pattern > 0.0 {
                    colour += (stripe.other - colour) * section.pattern.share(s, piece.along, texel[3]);
                }
                colour += (sheen - colour) * (shine * stripe.rough);
                if shaded {
                    let sun = graphics.lit(self.light.on_road(s, offset));
                    multiply = (shade + direct * (light * sun)) * (1.0 - veiled);
                }
                let grey = 1.0 + (f32::from(texel[0]) * (1.0 / 128.0) - 1.0) * (stripe.rough * graphics.grain);
                *pixel = bytes(colour * multiply * grey + add);
                s += piece.du;
                offset += piece.dv;
            }
        }
    }

    /// How much of a colour remains at a distance, in 256ths, and what fog adds.
    #[inline]
    fn veil(&self, depth: f32) -> (i32, [i32; 3]) {
        let fog = self.fog(depth);
        let to = self.scenery.fog;
        (256 - fog, [(to[0] * fog) >> 8, (to[1] * fog) >> 8, (to[2] * fog) >> 8])
    }
}

/// Longest piece of a row over which texture coordinates are linear, in pixels.
const PIECE: usize = 16;

/// A piece of a run: its attributes at the first pixel, their steps, and what is constant.
struct RunPiece {
    u: f32,
    v: f32,
    du: f32,
    dv: f32,
    depth: f32,
    /// Units of v that a pixel spans.
    across: f32,
    /// Units of u that a pixel spans.
    along: f32,
}

impl PixelRun<'_> {
    /// Pieces of this run, each with its pixels. Perspective is exact at their ends.
    #[inline]
    fn pieces<'p>(&self, out: &'p mut [u8]) -> impl Iterator<Item = (RunPiece, &'p mut [u8])> {
        let setup = self.setup;
        let (w0, u0, v0) = (setup.w.row(self.y), setup.u.row(self.y), setup.v.row(self.y));
        let at = move |x: usize| {
            let x = x as f32;
            let z = 1.0 / (w0 + setup.w.x * x).max(1e-6);
            (z, (u0 + setup.u.x * x) * z, (v0 + setup.v.x * x) * z)
        };
        let mut x = self.from;
        let mut here = at(x);
        out.chunks_mut(PIECE * 3).map(move |out| {
            let n = out.len() / 3;
            let (z, u, v) = here;
            // The last pixel, not the one beyond it: that may lie past the horizon.
            let step = (n - 1).max(1);
            let end = if n > 1 { at(x + n - 1) } else { here };
            let (du, dv) = ((end.1 - u) / step as f32, (end.2 - v) / step as f32);
            x += n;
            if n == PIECE && x < self.to {
                here = at(x);
            }
            let span =
                |plane: &Plane, at: f32| ((plane.x - at * setup.w.x).abs() + (plane.y - at * setup.w.y).abs()) * z;
            let (along, across) = (span(&setup.u, u), span(&setup.v, v));
            (RunPiece { u, v, du, dv, depth: z, across, along }, out)
        })
    }
}

/// The whole part of the logarithm to base 2, 0 for anything below 2.
#[inline]
pub(super) fn log2(x: f32) -> usize {
    ((x.to_bits() >> 23) as i32 - 127).clamp(0, 30) as usize
}

#[inline]
fn blend(from: i32, to: i32, share: i32) -> u8 {
    (from + (((to - from) * share) >> 8)).clamp(0, 255) as u8
}

/// The texel interpolated between four, two channels at a time.
#[inline]
fn smooth(texels: &[Texel], width: usize, u: f32, v: f32) -> Texel {
    let most = (width * 16 - 17) as f32;
    let (u, v) = (nearest((u * 16.0).clamp(0.0, most)), nearest((v * 16.0).clamp(0.0, most)));
    let (x, y) = (u >> 4, v >> 4);
    let (a, b) = (u as u32 & 15, v as u32 & 15);
    let i = y * width + x;
    let weights = [(16 - a) * (16 - b), a * (16 - b), (16 - a) * b, a * b];
    let (mut even, mut odd) = (0, 0);
    for (texel, weight) in [texels[i], texels[i + 1], texels[i + width], texels[i + width + 1]].into_iter().zip(weights)
    {
        let t = u32::from_le_bytes(texel);
        even += (t & 0x00FF_00FF) * weight;
        odd += (t >> 8 & 0x00FF_00FF) * weight;
    }
    (even >> 8 & 0x00FF_00FF | odd & 0xFF00_FF00).to_le_bytes()
}

/// A colour in light and fog, both in 256ths.
#[inline]
fn lit(colour: u8, multiply: i32, add: i32) -> u8 {
    (((i32::from(colour) * multiply) >> 8) + add).min(255) as u8
}

/// Grey levels cut off at 255; adding 2^23 leaves the whole number in the low bits.
#[inline]
fn bytes(colour: Vec4) -> [u8; 3] {
    let [r, g, b, _] = (colour.min(Vec4::splat(255.0)) + Vec4::splat(8_388_608.0)).to_array();
    [r.to_bits() as u8, g.to_bits() as u8, b.to_bits() as u8]
}

fn fill(out: &mut [u8], colour: [u8; 3]) {
    out.as_chunks_mut::<3>().0.fill(colour);
}

/// The sun's share on a face of a model, which is never as bright as a slope can be.
pub(super) fn model_light(light: &Light, normal: Vec3) -> f32 {
    light.on(normal).min(1.25)
}
