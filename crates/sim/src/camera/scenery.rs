//! Everything that does not move, built once from a track.

use std::sync::{Arc, Mutex, PoisonError};

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::{
    light::{Light, Lit, MAP, Sun},
    look::{self, ThemeLook},
    noise::Fractal,
    plants::{self, Sprite},
    raster::{Cluster, Paint},
    road::Paver,
    section::Section,
    sprites,
    terrain::Terrain,
    texture::{self, Texture},
    wires::{self, Wire},
};
use crate::{
    conditions::Conditions,
    track::{Edge, Side, Theme, Track},
};

/// How many positions of the sun have their lights kept.
const LIGHTS_KEPT: usize = 8;

type KnownLight = (Sun, Arc<Light>);

/// What a road is covered with.
#[derive(Debug)]
pub(super) struct Surface {
    pub(super) texture: Texture,
    /// Repeats of the texture per metre, along the road and across it.
    pub(super) along_per_m: f32,
    pub(super) across_per_m: f32,
}

impl Surface {
    /// A texture of `side_m` metres, stretched along the road.
    fn new(texture: Texture, side_m: f32, stretched: f32) -> Self {
        Self { texture: texture.soft(), along_per_m: 1.0 / (side_m * stretched), across_per_m: 1.0 / side_m }
    }
}

/// A country as the camera sees it: mesh, plants, textures, light. Shared by all renderers.
#[derive(Debug)]
pub struct Scenery {
    pub(super) look: ThemeLook,
    pub(super) strip: Vec<Cluster>,
    pub(super) walls: Vec<Cluster>,
    pub(super) land: Vec<Cluster>,
    pub(super) sprites: Vec<Sprite>,
    pub(super) wires: Vec<Wire>,
    pub(super) pictures: Vec<Texture>,
    pub(super) sections: Vec<Section>,
    pub(super) surfaces: Vec<Surface>,
    pub(super) tiles: Vec<Texture>,
    pub(super) detail: Texture,
    /// Repeats of the ground's fine structure per metre.
    pub(super) detail_per_m: f32,
    pub(super) map_texels_per_m: f32,
    pub(super) sheen4: Vec4,
    pub(super) fog4: Vec4,
    pub(super) fog: [i32; 3],
    /// Fog per metre, in 256ths.
    pub(super) fog_per_m: f32,
    track: Track,
    ground: Terrain,
    albedo: Vec<[u8; 3]>,
    lights: Mutex<Vec<KnownLight>>,
}

impl Scenery {
    /// Builds the country around a road; takes about a second.
    pub fn new(track: &Track) -> Self {
        let theme = track.file().theme;
        let seed = track.file().scenery_seed as u32;
        let look = ThemeLook::of(theme);
        let ground = Terrain::new(track, &look);
        let paver = Paver { track, ground: &ground, look: &look };
        let (strip, walls) = (paver.strip(), paver.walls());
        let sprites = plants::plant(&paver);
        let mut land = ground.mesh();
        land.extend(ground.water.map(|level| water(&ground, level)));
        let (asphalt, side_m, stretched, rough, grain_m, cliff) = match theme {
            Theme::Lake => (0.76, 4.0, 2.4, 0.45, 7.0, 0.45),
            Theme::Jungle => (0.34, 4.0, 3.0, 0.95, 4.5, 0.95),
            Theme::Mountain => (0.9, 2.6, 2.0, 1.1, 5.0, 1.2),
        };
        Self {
            strip,
            walls,
            land,
            wires: wires::between(&sprites),
            sprites,
            pictures: sprites::all(),
            sections: look::sections(theme, track.half_width() as f32, 1.0),
            surfaces: vec![
                Surface::new(texture::asphalt(asphalt, seed + 1), side_m, stretched),
                Surface::new(texture::cobbles(seed + 2), 2.94, 1.6),
            ],
            tiles: vec![texture::rock(cliff, seed + 3), texture::striped_block(seed + 4)],
            detail: texture::ground(rough, seed + 5),
            detail_per_m: 1.0 / grain_m,
            map_texels_per_m: MAP as f32 / ground.side(),
            sheen4: Vec3::from_array(look.sheen).extend(0.0),
            fog4: Vec3::from_array(look.fog).extend(0.0),
            fog: look.fog.map(|c| c as i32),
            fog_per_m: look.fog_100m * 2.56,
            albedo: albedo(track, &ground, &look),
            track: track.clone(),
            ground,
            look,
            lights: Mutex::new(Vec::new()),
        }
    }

    /// The sun under some conditions.
    pub(super) fn sun(&self, conditions: &Conditions) -> Sun {
        Sun {
            height_deg: conditions.sun_height_deg.unwrap_or(self.look.sun_height_deg).clamp(3.0, 90.0),
            azimuth_deg: conditions.sun_azimuth_deg.unwrap_or(self.look.sun_azimuth_deg),
            casts: conditions.shadows.map_or(self.look.shadows, |dark| dark > 0.0),
        }
    }

    /// The road's cross-sections, with lines and verge that stand out so many times as much as usual.
    pub(super) fn sections(&self, standing_out: f32) -> Vec<Section> {
        look::sections(self.track.file().theme, self.track.half_width() as f32, standing_out)
    }

    /// The light of a sun: computed the first time, then kept.
    pub(super) fn light(&self, sun: Sun) -> Arc<Light> {
        let mut lights = self.lights.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, light)) = lights.iter().find(|(known, _)| *known == sun) {
            return Arc::clone(light);
        }
        let lit = Lit {
            track: &self.track,
            look: &self.look,
            ground: &self.ground,
            albedo: &self.albedo,
            sprites: &self.sprites,
            pictures: &self.pictures,
        };
        let light = Arc::new(Light::new(&lit, sun));
        if lights.len() == LIGHTS_KEPT {
            lights.remove(0);
        }
        lights.push((sun, Arc::clone(&light)));
        light
    }
}

/// Open water to the horizon.
fn water(ground: &Terrain, level: f32) -> Cluster {
    let mut chunk = Cluster::default();
    const PIECES: u16 = 8;
    let reach = ground.side() * 2.0;
    let low = Vec3::new(ground.x0, level, ground.z0) - Vec3::new(reach, 0.0, reach) * 0.25;
    for j in 0..=PIECES {
        for i in 0..=PIECES {
            let piece = reach * 1.5 / f32::from(PIECES) / 2.0;
            chunk.point(low + Vec3::new(f32::from(i) * piece, 0.0, f32::from(j) * piece), 0.0, 0.0);
        }
    }
    for j in 0..PIECES {
        for i in 0..PIECES {
            let a = j * (PIECES + 1) + i;
            chunk.quad([a, a + 1, a + PIECES + 2, a + PIECES + 1], Paint::Water, None);
        }
    }
    chunk.bound()
}

fn albedo(track: &Track, ground: &Terrain, look: &ThemeLook) -> Vec<[u8; 3]> {
    let metres = ground.side() / MAP as f32;
    let seed = track.file().scenery_seed as u32;
    let dirt: Vec<[bool; 2]> = track
        .stations()
        .iter()
        .map(|station| [Side::Left, Side::Right].map(|side| track.file().has(Edge::Dirt, side, station.s)))
        .collect();
    let row = |j: usize| {
        let z = ground.z0 + (j as f32 + 0.5) * metres;
        let (mut wide, mut fine) = (Fractal::new(3, 0, seed + 300), Fractal::new(3, 0, seed + 340));
        let dirt = &dirt;
        (0..MAP).map(move |i| {
            let x = ground.x0 + (i as f32 + 0.5) * metres;
            let (from_edge_m, number) = ground.near(x, z);
            let station = &track.stations()[number];
            let to = Vec3::new(x, 0.0, z) - station.position.as_vec3();
            let right = to.dot(station.right().as_vec3()) > 0.0;
            let height = ground.height(x, z);
            let normal = ground.normal(x, z);
            let place = look::Spot {
                wide: wide.at(x / 31.0, z / 31.0),
                fine: fine.at(x / 5.0, z / 5.0),
                above_m: height - station.position.y as f32,
                slope: normal.x.hypot(normal.z) / normal.y,
                from_edge_m,
                dirt: dirt[number][usize::from(right)],
                dry_m: ground.water.map_or(f32::MAX, |water| height - water),
            };
            look::ground(track.file().theme, look.rock, place).map(|c| c.clamp(0.0, 255.0) as u8)
        })
    };
    (0..MAP).into_par_iter().flat_map_iter(row).collect()
}
