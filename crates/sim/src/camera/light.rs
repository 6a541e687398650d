//! The sun's light on a country: on the ground's map, along the road, in the sky.
//!
//! All of it is computed once for each position of the sun and then only looked up.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    look::ThemeLook,
    noise::{mix, mix3, nearest, step},
    plants::Sprite,
    terrain::Terrain,
    texture::Texture,
};
use crate::track::Track;

/// Texels along a side of the ground's map.
pub(super) const MAP: usize = 1024;
/// Patches of road light a metre, along and across.
const PATCHES_PER_M: f32 = 4.0;
/// Patches across the road.
const ACROSS: usize = 64;
/// Steps of the sky's colours between the horizon and the highest place looked up.
const SKY_STEPS: usize = 256;
/// The highest place in the sky that is looked up: metres up per metre forward.
const SKY_TOP: f32 = 0.9;

/// Everything that the sun's position determines.
#[derive(Debug)]
pub(super) struct Light {
    /// Towards the sun.
    pub(super) sun: Vec3,
    /// By colour: what is left in the shade, and what the sun adds on flat ground.
    pub(super) shade: [f32; 3],
    pub(super) direct: [f32; 3],
    /// The same, padded for four at a time.
    pub(super) shade4: [f32; 4],
    pub(super) direct4: [f32; 4],
    pub(super) map: Texture,
    patches: Vec<u8>,
    along: usize,
    /// By station, whether any of the road there lies in a shadow.
    pub(super) shaded: Vec<bool>,
    sky: Vec<[u8; 3]>,
}

/// The sun's place in degrees, and whether trees and hills throw its shadows on the road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sun {
    pub(super) height_deg: f64,
    pub(super) azimuth_deg: f64,
    pub(super) casts: bool,
}

/// What light falls on.
pub(super) struct Lit<'a> {
    pub(super) track: &'a Track,
    pub(super) look: &'a ThemeLook,
    pub(super) ground: &'a Terrain,
    pub(super) albedo: &'a [[u8; 3]],
    pub(super) sprites: &'a [Sprite],
    pub(super) pictures: &'a [Texture],
}

impl Light {
    /// Lights a country.
    pub(super) fn new(lit: &Lit<'_>, Sun { height_deg, azimuth_deg, casts }: Sun) -> Self {
        let (height, azimuth) = (height_deg.to_radians(), azimuth_deg.to_radians());
        let sun = glam::DVec3::new(azimuth.sin() * height.cos(), height.sin(), azimuth.cos() * height.cos()).as_vec3();
        // A low sun is warm and weak.
        let low = step(24.0, 4.0, height_deg as f32);
        let warm = mix3([1.0; 3], [0.92, 0.70, 0.48], low);
        let direct = [0, 1, 2].map(|c| (1.0 - lit.look.shade[c]) * warm[c]);
        let mut light = Self {
            sun,
            shade: lit.look.shade,
            direct,
            shade4: [lit.look.shade[0], lit.look.shade[1], lit.look.shade[2], 0.0],
            direct4: [direct[0], direct[1], direct[2], 0.0],
            map: Texture::paint(1, 1, |_, _| [0.0; 4]),
            patches: Vec::new(),
            along: 0,
            shaded: vec![false; lit.track.stations().len()],
            sky: sky(lit.look, low),
        };
        light.map = light.light_ground(lit);
        light.light_road(lit, casts);
        light
    }

    /// How much sun a surface gets, 1 being flat ground.
    pub(super) fn on(&self, normal: Vec3) -> f32 {
        (normal.dot(self.sun) / self.sun.y.max(0.25)).clamp(0.0, 1.9)
    }

    /// What colours are multiplied by, in 256ths, under a share of the sun's light.
    #[inline]
    pub(super) fn multiply(&self, share: f32) -> [i32; 3] {
        let at = |c: usize| (256.0 * (self.shade[c] + self.direct[c] * share)) as i32;
        [at(0), at(1), at(2)]
    }

    /// The sky's colour at `up` metres per metre forward.
    #[inline]
    pub(super) fn sky(&self, up: f32) -> [u8; 3] {
        let i = nearest((up * (SKY_STEPS as f32 / SKY_TOP)).clamp(0.0, SKY_STEPS as f32));
        self.sky[i.min(SKY_STEPS - 1)]
    }

    fn light_ground(&self, lit: &Lit<'_>) -> Texture {
        // Sunlight in steps of 3 m or so, blended between.
        const COARSE: usize = 4;
        let n = MAP / COARSE;
        let metres = lit.ground.side() / n as f32;
        let share: Vec<f32> = (0..(n + 1) * (n + 1))
            .into_par_iter()
            .map(|k| {
                let (x, z) =
                    (lit.ground.x0 + (k % (n + 1)) as f32 * metres, lit.ground.z0 + (k / (n + 1)) as f32 * metres);
                let at = Vec3::new(x, lit.ground.height(x, z) + 0.2, z);
                let facing = self.on(lit.ground.normal(x, z));
                if facing > 0.0 && lit.ground.sunlit(at, self.sun) { facing.min(1.5) } else { 0.0 }
            })
            .collect();
        Texture::paint(MAP, MAP, |x, y| {
            let (i, j) = (x / COARSE, y / COARSE);
            let (u, v) = ((x % COARSE) as f32 / COARSE as f32, (y % COARSE) as f32 / COARSE as f32);
            let at = |di: usize, dj: usize| share[(j + dj) * (n + 1) + i + di];
            let share = mix(mix(at(0, 0), at(1, 0), u), mix(at(0, 1), at(1, 1), u), v);
            let m = self.multiply(share);
            let c = lit.albedo[y * MAP + x];
            let lit = |k: usize| f32::from(c[k]) * m[k] as f32 / 256.0;
            [lit(0), lit(1), lit(2), 255.0]
        })
    }

    fn light_road(&mut self, lit: &Lit<'_>, casts: bool) {
        let length = lit.track.length();
        self.along = (length * f64::from(PATCHES_PER_M)) as usize;
        if !casts {
            self.patches = vec![255; self.along * ACROSS];
            return;
        }
        let stations = lit.track.stations().len();
        let away = Vec3::new(-self.sun.x, 0.0, -self.sun.z).normalize_or_zero();
        let flat = self.sun.x.hypot(self.sun.z).max(0.05);
        let climb = self.sun.y / flat;
        // Trees that can reach the road with their shadows, by the metre of road beside them.
        let mut casting: Vec<(f64, &Sprite)> = Vec::new();
        let reach = |sprite: &Sprite| (sprite.height / climb).min(40.0) + sprite.width;
        for sprite in lit.sprites {
            let (d, station) = lit.ground.near(sprite.at.x, sprite.at.z);
            if d < reach(sprite) {
                casting.push((lit.track.stations()[station].s, sprite));
            }
        }
        casting.sort_by(|a, b| a.0.total_cmp(&b.0));
        let sun = self.sun;
        let patches = |k: usize| -> [u8; ACROSS] {
            let s = k as f64 / f64::from(PATCHES_PER_M);
            let station = lit.track.at(s);
            let (middle, right) = (station.position.as_vec3(), station.right().as_vec3());
            let nearby: Vec<&Sprite> = casting
                .iter()
                .filter(|(at, _)| {
                    let apart = (at - s).rem_euclid(length);
                    apart.min(length - apart) < 34.0
                })
                .map(|(_, sprite)| *sprite)
                .collect();
            std::array::from_fn(|j| {
                let offset = (j as f32 + 0.5 - ACROSS as f32 / 2.0) / PATCHES_PER_M;
                let p = middle + right * offset + Vec3::Y * 0.05;
                let hidden = !lit.ground.sunlit(p, sun)
                    || nearby.iter().any(|s| s.shades(p, away, climb, &lit.pictures[s.picture as usize]));
                if hidden { 0 } else { 255 }
            })
        };
        let rows: Vec<_> = (0..self.along).into_par_iter().map(patches).collect();
        for (k, _) in rows.iter().enumerate().filter(|(_, row)| row.contains(&0)) {
            let s = k as f64 / f64::from(PATCHES_PER_M);
            let number = (s / length * stations as f64) as usize;
            self.shaded[number.saturating_sub(9)..(number + 9).min(stations)].fill(true);
        }
        self.patches = rows.into_flattened();
    }

    /// The sun's share on the road, 0 to 1, blended between patches.
    #[inline]
    pub(super) fn on_road(&self, s: f32, offset: f32) -> f32 {
        let x = (s * PATCHES_PER_M - 0.5).max(0.0);
        let y = (offset * PATCHES_PER_M + (ACROSS as f32 / 2.0 - 0.5)).clamp(0.0, ACROSS as f32 - 1.01);
        let (i, j) = ((x as usize).min(self.along - 1), y as usize);
        let next = if i + 1 < self.along { i + 1 } else { 0 };
        let (u, v) = (x - i as f32, y - j as f32);
        let at = |i: usize, j: usize| f32::from(self.patches[i * ACROSS + j]);
        mix(mix(at(i, j), at(next, j), u), mix(at(i, j + 1), at(next, j + 1), u), v) * (1.0 / 255.0)
    }
}

fn sky(look: &ThemeLook, low: f32) -> Vec<[u8; 3]> {
    (0..SKY_STEPS)
        .map(|i| {
            let up = i as f32 / SKY_STEPS as f32 * SKY_TOP;
            let colour = match up {
                u if u < 0.2 => mix3(look.sky[0], look.sky[1], (u / 0.2).powf(0.8)),
                u if u < 0.42 => mix3(look.sky[1], look.sky[2], (u - 0.2) / 0.22),
                u => mix3(look.sky[2], look.sky[2].map(|c| c * 0.8), (u - 0.42) / 0.48),
            };
            mix3(colour, mix3([236.0, 166.0, 104.0], [120.0, 116.0, 140.0], step(0.0, 0.4, up)), 0.6 * low)
                .map(|c| c as u8)
        })
        .collect()
}
