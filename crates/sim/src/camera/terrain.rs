//! Open ground: a height for every place, below every road, and the mesh of it.
//!
//! Cells are small beside roads and larger away from them. The camera stays on the road, so large cells are always far
//! away, and nothing pops up. A large cell includes the corners of its smaller neighbours, so there are no cracks.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    look::ThemeLook,
    noise::{Fractal, mix, step},
    raster::{Cluster, Paint},
};
use crate::track::{Edge, Side, Theme, Track};

/// Side of the smallest cell, in metres.
const CELL_M: f32 = 3.0;
/// Smallest cells along a side of the largest.
const LARGEST: usize = 16;
/// How far the ground reaches beyond the road, in metres.
const MARGIN_M: f32 = 330.0;
/// How far below the road the ground beside it lies, in metres.
const DROP_M: f32 = 0.18;
/// How far beyond the road's edge the road's own strip stays level, in metres: the ground does not rise above it before
/// that.
pub(super) const SHOULDER_M: f32 = 3.2;

/// The ground of a whole country.
#[derive(Debug)]
pub(super) struct Terrain {
    pub(super) x0: f32,
    pub(super) z0: f32,
    /// Cells along a side.
    n: usize,
    heights: Vec<f32>,
    /// Metres to the nearest road's edge, and that road's station.
    near: Vec<(f32, u32)>,
    pub(super) water: Option<f32>,
}

struct RoadPoint {
    x: f32,
    z: f32,
    y: f32,
    ahead: (f32, f32),
    station: u32,
}

impl Terrain {
    /// Shapes the ground around a road.
    pub(super) fn new(track: &Track, look: &ThemeLook) -> Self {
        let stations = track.stations();
        let samples: Vec<RoadPoint> = (0..stations.len())
            .step_by(4)
            .map(|i| {
                let p = stations[i].position.as_vec3();
                let ahead = stations[i].ahead().as_vec3();
                RoadPoint { x: p.x, z: p.z, y: p.y, ahead: (ahead.x, ahead.z), station: i as u32 }
            })
            .collect();
        let low = samples.iter().fold([f32::MAX; 3], |m, p| [m[0].min(p.x), m[1].min(p.y), m[2].min(p.z)]);
        let high = samples.iter().fold([f32::MIN; 2], |m, p| [m[0].max(p.x), m[1].max(p.z)]);
        let extent = (high[0] - low[0]).max(high[1] - low[2]) + 2.0 * MARGIN_M;
        let n = (extent / CELL_M / LARGEST as f32).ceil() as usize * LARGEST;
        let side = n as f32 * CELL_M;
        let (x0, z0) = ((low[0] + high[0] - side) / 2.0, (low[2] + high[1] - side) / 2.0);
        let water = look.water.map(|_| low[1] - 1.3);
        let half = track.half_width() as f32;
        // No corner of a cell that reaches under the strip may stand higher than it.
        let corridor = half + SHOULDER_M.min(shoulder(track.file().theme)) + CELL_M * 1.45;
        let row = |j: usize| {
            let (z, mut open) = (z0 + j as f32 * CELL_M, OpenCountry::new(track));
            let mut row = Vec::with_capacity(n + 1);
            for i in (0..=n).step_by(ABREAST) {
                let xs: [f32; ABREAST] = std::array::from_fn(|k| x0 + (i + k) as f32 * CELL_M);
                let beside = beside(&samples, xs, z, corridor, look.steepest);
                row.extend(xs.into_iter().zip(beside).take(n + 1 - i).map(|(x, beside)| {
                    let from_edge = (beside.nearest.sqrt() - half).max(0.0);
                    let natural = open.height(x, z, beside.level, from_edge, beside.station as usize);
                    (natural.min(beside.ceiling), (from_edge, beside.station))
                }));
            }
            row
        };
        let rows: Vec<_> = (0..=n).into_par_iter().flat_map_iter(row).collect();
        let (heights, near) = rows.into_iter().unzip();
        Self { x0, z0, n, heights, near, water }
    }

    fn at(&self, i: usize, j: usize) -> f32 {
        self.heights[j * (self.n + 1) + i]
    }

    fn cell(&self, x: f32, z: f32) -> (usize, usize, f32, f32) {
        let most = self.n as f32 - 0.01;
        let (u, v) = (((x - self.x0) / CELL_M).clamp(0.0, most), ((z - self.z0) / CELL_M).clamp(0.0, most));
        let (i, j) = (u as u32, v as u32);
        (i as usize, j as usize, u - i as f32, v - j as f32)
    }

    /// Height of the ground, in metres.
    pub(super) fn height(&self, x: f32, z: f32) -> f32 {
        let (i, j, u, v) = self.cell(x, z);
        mix(mix(self.at(i, j), self.at(i + 1, j), u), mix(self.at(i, j + 1), self.at(i + 1, j + 1), u), v)
    }

    /// The place on it, there.
    pub(super) fn place(&self, x: f32, z: f32) -> Vec3 {
        Vec3::new(x, self.height(x, z), z)
    }

    /// Metres to the nearest road's edge, and its station.
    pub(super) fn near(&self, x: f32, z: f32) -> (f32, usize) {
        let (i, j, u, v) = self.cell(x, z);
        let (i, j) = (i + usize::from(u > 0.5), j + usize::from(v > 0.5));
        let (d, station) = self.near[j * (self.n + 1) + i];
        (d, station as usize)
    }

    /// Which way the ground faces.
    pub(super) fn normal(&self, x: f32, z: f32) -> Vec3 {
        let e = CELL_M * 0.7;
        let (dx, dz) = (self.height(x + e, z) - self.height(x - e, z), self.height(x, z + e) - self.height(x, z - e));
        Vec3::new(-dx, 2.0 * e, -dz).normalize()
    }

    /// Side of the square that it covers, in metres.
    pub(super) fn side(&self) -> f32 {
        self.n as f32 * CELL_M
    }

    /// Whether no hill hides the sun.
    pub(super) fn sunlit(&self, from: Vec3, sun: Vec3) -> bool {
        let mut along = 1.5;
        for _ in 0..26 {
            let p = from + sun * along;
            if self.height(p.x, p.z) > p.y + 0.3 {
                return false;
            }
            along *= 1.16;
            along += 0.8;
        }
        true
    }

    /// The mesh, in chunks.
    pub(super) fn mesh(&self) -> Vec<Cluster> {
        let mut leaves = Vec::new();
        for j in (0..self.n).step_by(LARGEST) {
            for i in (0..self.n).step_by(LARGEST) {
                let start = leaves.len();
                self.split(i, j, LARGEST, &mut leaves);
                leaves[start..].sort_unstable();
            }
        }
        let mut corners = vec![false; (self.n + 1) * (self.n + 1)];
        for &(i, j, size) in &leaves {
            for (i, j) in [(i, j), (i + size, j), (i, j + size), (i + size, j + size)] {
                corners[j * (self.n + 1) + i] = true;
            }
        }
        let mut chunks = Vec::new();
        let mut chunk = Cluster::default();
        let mut block = None;
        let mut known: Vec<(usize, u16)> = Vec::new();
        for &(i, j, size) in &leaves {
            let here = (i / LARGEST, j / LARGEST);
            if block != Some(here) && !chunk.faces.is_empty() {
                chunks.push(std::mem::take(&mut chunk).bound());
                known.clear();
            }
            block = Some(here);
            self.leaf(&mut chunk, &mut known, &corners, (i, j, size));
        }
        chunks.push(chunk.bound());
        chunks
    }

    fn split(&self, i: usize, j: usize, size: usize, leaves: &mut Vec<(usize, usize, usize)>) {
        let half = size / 2;
        let (d, _) = self.near[(j + half) * (self.n + 1) + i + half];
        let nearest = d - size as f32 * CELL_M * 0.71;
        let finest = match nearest {
            d if d < 9.0 => 1,
            d if d < 26.0 => 2,
            d if d < 70.0 => 4,
            d if d < 150.0 => 8,
            _ => LARGEST,
        };
        if size <= finest {
            leaves.push((i, j, size));
            return;
        }
        for (di, dj) in [(0, 0), (half, 0), (0, half), (half, half)] {
            self.split(i + di, j + dj, half, leaves);
        }
    }

    fn leaf(
        &self,
        chunk: &mut Cluster,
        known: &mut Vec<(usize, u16)>,
        corners: &[bool],
        (i, j, size): (usize, usize, usize),
    ) {
        let side = self.n + 1;
        let mut point = |i: usize, j: usize| {
            let key = j * side + i;
            if let Some((_, p)) = known.iter().rev().find(|(k, _)| *k == key) {
                return *p;
            }
            let (dx, dz) = (i as f32 * CELL_M, j as f32 * CELL_M);
            let p = chunk.point(Vec3::new(self.x0 + dx, self.at(i, j), self.z0 + dz), dx, dz);
            known.push((key, p));
            p
        };
        let mut around = Vec::new();
        let edges = (0..size)
            .map(|k| (i + k, j))
            .chain((0..size).map(|k| (i + size, j + k)))
            .chain((0..size).map(|k| (i + size - k, j + size)))
            .chain((0..size).map(|k| (i, j + size - k)));
        for (i, j) in edges {
            if corners[j * side + i] {
                around.push(point(i, j));
            }
        }
        if let [a, b, c, d] = around[..] {
            chunk.quad([a, b, c, d], Paint::Ground, None);
            return;
        }
        let middle = point(i + size / 2, j + size / 2);
        for k in 0..around.len() {
            chunk.face([middle, around[k], around[(k + 1) % around.len()]], Paint::Ground, None);
        }
    }
}

/// So many places are held against the road at once, so that the compiler computes with several of them.
const ABREAST: usize = 8;

/// What a place has to do with the road.
#[derive(Clone, Copy)]
struct Beside {
    /// Squared metres to the middle of the nearest piece of it, and that piece's station.
    nearest: f32,
    station: u32,
    /// Height of the road, the nearer a piece the more it counts.
    level: f32,
    /// How high the ground may be.
    ceiling: f32,
}

/// Holds places of one row against all pieces of a road.
fn beside(road: &[RoadPoint], x: [f32; ABREAST], z: f32, corridor: f32, steepest: f32) -> [Beside; ABREAST] {
    let (mut nearest, mut station) = ([f32::MAX; ABREAST], [0; ABREAST]);
    let (mut weights, mut levels, mut ceiling) = ([0.0; ABREAST], [0.0; ABREAST], [f32::MAX; ABREAST]);
    for p in road {
        let squared = x.map(|x| (p.x - x) * (p.x - x) + (p.z - z) * (p.z - z));
        for (k, d2) in squared.into_iter().enumerate() {
            let nearer = d2 < nearest[k];
            nearest[k] = if nearer { d2 } else { nearest[k] };
            station[k] = if nearer { p.station } else { station[k] };
            let weight = 1.0 / ((d2 + 4.0) * (d2 + 4.0));
            weights[k] += weight;
            levels[k] += weight * p.y;
        }
        if squared.into_iter().fold(f32::MAX, f32::min) >= 900.0 {
            continue;
        }
        for (k, d2) in squared.into_iter().enumerate() {
            // Only from beside: on a slope, the road further down does not count here.
            let along = (x[k] - p.x) * p.ahead.0 + (z - p.z) * p.ahead.1;
            if d2 < 900.0 && along.abs() < 4.5 {
                let beyond = (d2.sqrt() - corridor).max(0.0);
                ceiling[k] = ceiling[k].min(p.y - DROP_M + beyond * steepest);
            }
        }
    }
    std::array::from_fn(|k| Beside {
        nearest: nearest[k],
        station: station[k],
        level: levels[k] / weights[k],
        ceiling: ceiling[k],
    })
}

/// Open ground without any road.
struct OpenCountry<'a> {
    track: &'a Track,
    hills: Fractal,
    wide: Fractal,
    rough: Fractal,
    /// Cliffs and crags.
    steep: Fractal,
}

impl<'a> OpenCountry<'a> {
    fn new(track: &'a Track) -> Self {
        let seed = track.file().scenery_seed as u32;
        let noise = |octaves, seed| Fractal::new(octaves, 0, seed);
        Self {
            track,
            hills: noise(4, seed),
            wide: noise(2, seed + 100),
            rough: noise(2, seed + 7),
            steep: noise(3, seed + 3),
        }
    }

    /// The height there, beside a road of that level, so far from its edge.
    fn height(&mut self, x: f32, z: f32, level: f32, d: f32, station: usize) -> f32 {
        let track = self.track;
        let hills = self.hills.at(x / 64.0, z / 64.0);
        let wide = self.wide.at(x / 210.0, z / 210.0);
        let here = &track.stations()[station];
        let to = Vec3::new(x, 0.0, z) - here.position.as_vec3();
        let right = to.dot(here.right().as_vec3()) > 0.0;
        let side = if right { Side::Right } else { Side::Left };
        if track.file().has(Edge::Rock, side, here.s) {
            let least = if track.file().theme == Theme::Mountain { 13.0 } else { 7.0 };
            return level + step(2.5, 8.0, d) * (least + 9.0 * hills);
        }
        let rough = 0.5 * (self.rough.at(x / 7.0, z / 7.0) - 0.5) * step(4.0, 9.0, d);
        match track.file().theme {
            Theme::Lake => {
                let wet = track.file().has(Edge::Water, side, here.s);
                let far = step(130.0, 260.0, d) * (6.0 + 34.0 * wide * hills.max(0.3));
                if wet {
                    return level - 5.0 * step(4.0, 12.0, d) + far + 4.0 * step(150.0, 200.0, d);
                }
                let flat = track.file().has(Edge::Dirt, side, here.s);
                let beside = step(if flat { 24.0 } else { 6.0 }, if flat { 44.0 } else { 21.0 }, d);
                // The middle of the country, which the road goes around, is a lake.
                let bank = 15.0 * step(0.46, 0.70, hills) * if right { 1.0 } else { 0.35 };
                let basin = if right { 0.0 } else { 6.0 * step(34.0, 70.0, d) * step(0.58, 0.42, wide) };
                level - 0.15 + rough + beside * (bank + 1.5 * (hills - 0.4)) - basin + far
            }
            Theme::Jungle if track.file().has(Edge::Posts, side, here.s) => {
                // They warn of a valley, whose far side rises as everywhere.
                level - 0.1 + rough - 6.0 * step(4.0, 14.0, d) + step(30.0, 80.0, d) * (16.0 + 44.0 * wide)
            }
            Theme::Jungle => {
                let cliffs = step(0.44, 0.52, self.steep.at(x / 30.0, z / 30.0));
                let close = step(2.5, 8.0, d);
                let spires = 60.0 * step(50.0, 150.0, d) * (hills - 0.35).max(0.0);
                // The real road is cut into slopes that hide most of the sky.
                let slopes = step(6.0, 42.0, d) * (10.0 + 44.0 * wide);
                level - 0.1 + rough + close * (cliffs * (9.0 + 12.0 * wide) + 3.0 * (hills - 0.45)) + slopes + spires
            }
            Theme::Mountain => {
                let crag = step(0.48, 0.53, self.steep.at(x / 44.0, z / 44.0));
                let close = step(2.5, 16.0, d);
                let slope = close * (crag * 10.0 + 9.0 * (hills - 0.34));
                let heights = step(8.0, 60.0, d) * 34.0 * wide + step(40.0, 200.0, d) * 70.0 * (wide - 0.42).max(-0.1);
                level - 0.1 + rough + slope + heights
            }
        }
    }
}

/// How far beyond its edge a theme's road stays level, in metres.
pub(super) fn shoulder(theme: Theme) -> f32 {
    match theme {
        Theme::Lake => SHOULDER_M,
        Theme::Jungle => 1.0,
        Theme::Mountain => 2.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ground_lies_below_every_road() {
        for name in Track::NAMES {
            let track = Track::named(name).unwrap();
            let ground = Terrain::new(&track, &ThemeLook::of(track.file().theme));
            let reach = track.half_width() + f64::from(shoulder(track.file().theme)) - 0.1;
            for k in 0..track.length() as usize * 2 {
                for side in -8..=8 {
                    let p = track.point(k as f64 / 2.0, reach * f64::from(side) / 8.0).as_vec3();
                    let high = ground.height(p.x, p.z) - p.y;
                    assert!(high < -0.02, "{name} {} m, {side}: ground {high:.2} m above the road", k / 2);
                }
            }
        }
    }

    #[test]
    fn the_mesh_covers_its_square_once() {
        let track = Track::named("lake").unwrap();
        let ground = Terrain::new(&track, &ThemeLook::of(Theme::Lake));
        let area: f64 = ground
            .mesh()
            .iter()
            .flat_map(|chunk| chunk.faces.iter().map(|f| f.corners.map(|i| chunk.points[i as usize].at)))
            .map(|[a, b, c]| f64::from(((b.x - a.x) * (c.z - a.z) - (c.x - a.x) * (b.z - a.z)).abs()) / 2.0)
            .sum();
        let expected = f64::from(ground.side()).powi(2);
        assert!((area / expected - 1.0).abs() < 1e-6, "{area} of {expected}");
    }
}
