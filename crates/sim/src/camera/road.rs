//! The road's own mesh: the strip that carries its cross-section, and what stands at its edges.

use glam::Vec3;

use super::{
    look::{self, ThemeLook, kind},
    noise::{fractal, unit},
    raster::{Cluster, Paint},
    terrain::{SHOULDER_M, Terrain},
};
use crate::track::{Edge, Side, Station, Theme, Track};

/// Texture numbers of [`Paint::Tile`].
pub(super) mod tile {
    pub(in super::super) const ROCK: u8 = 0;
    pub(in super::super) const BLOCK: u8 = 1;
}

/// Longest chunk, in metres.
const CHUNK_M: f64 = 24.0;
/// Height of the bridge's walls, in metres.
const WALL_M: f32 = 0.68;
/// Thickness of a road that crosses over another, in metres.
const DECK_M: f32 = 0.9;

const BLACK: Paint = Paint::Flat([13, 13, 15]);
const BLACK_TOP: Paint = Paint::Flat([24, 24, 26]);
const DECK: Paint = Paint::Flat([120, 118, 112]);
/// Whether a surface belongs to the road: not what stands beside it, which stands elsewhere beside a real one.
pub(super) fn is_of_the_road(paint: Paint) -> bool {
    matches!(paint, Paint::Road { .. }) || [BLACK, BLACK_TOP, DECK, DECK_BELOW].contains(&paint)
}

const DECK_BELOW: Paint = Paint::Flat([52, 52, 54]);

/// Lays meshes along a road.
pub(super) struct Paver<'a> {
    pub(super) track: &'a Track,
    pub(super) ground: &'a Terrain,
    pub(super) look: &'a ThemeLook,
}

/// A place across the road: metres from the middle, always positive, and above it.
type Corner = (f32, f32);

impl Paver<'_> {
    /// Road, shoulders, walls: the surfaces seen from above.
    pub(super) fn strip(&self) -> Vec<Cluster> {
        self.chunks(|chunk, from, to| {
            for side in [Side::Left, Side::Right] {
                self.strip_side(chunk, from, to, side);
            }
        })
    }

    /// Rock faces and blocks beside it.
    pub(super) fn walls(&self) -> Vec<Cluster> {
        let mut chunks = self.chunks(|chunk, from, to| {
            for side in [Side::Left, Side::Right] {
                if self.has(Edge::Rock, side, from) {
                    self.rock(chunk, from, to, side);
                }
            }
        });
        let pitch = 2.3;
        let count = (self.track.length() / pitch) as usize;
        for first in (0..count).step_by(10) {
            let mut chunk = Cluster::default();
            for i in first..(first + 10).min(count) {
                for side in [Side::Left, Side::Right] {
                    let s = i as f64 * self.track.length() / count as f64;
                    let station = self.track.at(s);
                    if self.has(Edge::Blocks, side, &station) {
                        self.block(&mut chunk, &station, side, i as i32);
                    }
                }
            }
            if !chunk.faces.is_empty() {
                chunks.push(chunk.bound());
            }
        }
        chunks
    }

    fn has(&self, edge: Edge, side: Side, station: &Station) -> bool {
        self.track.file().has(edge, side, station.s)
    }

    fn half(&self) -> f32 {
        self.track.half_width() as f32
    }

    /// Whether the place is more than `margin` metres from the edge of every road.
    pub(super) fn clear(&self, at: Vec3, margin: f32) -> bool {
        let least = (self.half() + margin).powi(2);
        self.track.stations().iter().all(|station| {
            let d = station.position.as_vec3() - at;
            d.x * d.x + d.z * d.z >= least
        })
    }

    /// Whether this place lies on a road of about the same height.
    fn beside_another(&self, at: Vec3) -> bool {
        let reach = (self.half() + 0.3).powi(2);
        self.track.stations().iter().any(|station| {
            let d = station.position.as_vec3() - at;
            d.y.abs() < 6.0 && d.x * d.x + d.z * d.z < reach
        })
    }

    /// Whether the ground falls away so far beside this place that the road is a bridge there.
    fn in_the_air(&self, station: &Station) -> bool {
        [Side::Left, Side::Right].into_iter().any(|side| {
            let foot = self.across(station, side, (self.half() + 2.6, 0.0));
            self.ground.height(foot.x, foot.z) < foot.y - 2.2
        })
    }

    fn chunks(&self, lay: impl Fn(&mut Cluster, &Station, &Station)) -> Vec<Cluster> {
        let stations = self.track.stations();
        let n = stations.len();
        let mut chunks = Vec::new();
        let mut chunk = Cluster::default();
        let (mut i, mut base) = (0, 0.0);
        while i < n {
            let bend = stations[i].curvature.abs().max(stations[(i + 8) % n].curvature.abs());
            let mut rows = match bend {
                b if b < 0.006 => 8,
                b if b < 0.03 => 4,
                _ => 2,
            };
            if !self.same(&stations[i], &stations[(i + rows) % n]) {
                rows = 1;
            }
            let next = (i + rows).min(n);
            let from = stations[i];
            let mut to = stations[next % n];
            if next == n {
                to.s = self.track.length();
            }
            if from.s - base > CHUNK_M {
                if !chunk.faces.is_empty() {
                    chunks.push(std::mem::take(&mut chunk).bound());
                }
                base = from.s;
            }
            chunk.base = base as f32;
            lay(&mut chunk, &from, &to);
            i = next;
        }
        if !chunk.faces.is_empty() {
            chunks.push(chunk.bound());
        }
        chunks
    }

    /// Whether the same things stand along both places.
    fn same(&self, a: &Station, b: &Station) -> bool {
        [Side::Left, Side::Right].into_iter().all(|side| {
            [Edge::Kerb, Edge::Dirt, Edge::Bridge, Edge::Rock]
                .into_iter()
                .all(|edge| self.has(edge, side, a) == self.has(edge, side, b))
        })
    }

    /// A point across the road. There is none beyond the centre of a bend, so it stays on this side of that.
    fn across(&self, station: &Station, side: Side, (out, up): Corner) -> Vec3 {
        let sign = if side == Side::Right { 1.0 } else { -1.0 };
        let towards = station.curvature as f32 * sign;
        let most = if towards > 0.0 { 0.85 / towards } else { f32::MAX };
        let right = station.right().as_vec3();
        station.position.as_vec3() + right * (sign * out.min(most)) + Vec3::Y * up
    }

    fn strip_side(&self, chunk: &mut Cluster, from: &Station, to: &Station, side: Side) {
        let half = self.half();
        let kind = match side {
            _ if self.has(Edge::Bridge, side, from) => kind::PAVED,
            _ if self.has(Edge::Dirt, side, from) => kind::DIRT,
            _ if self.has(Edge::Kerb, side, from) => kind::KERB,
            _ => kind::PLAIN,
        };
        let number = (from.s / self.track.length() * self.track.stations().len() as f64) as u16;
        let road = Paint::Road { section: look::section(kind, side), station: number };
        let mut lay = |a: Corner, b: Corner, paint: Paint, towards: Option<Vec3>| {
            self.quad(chunk, (from, to), side, (a, b), paint, towards);
        };
        let eye = from.position.as_vec3() + Vec3::Y * 1.5;
        if kind == kind::PAVED {
            let wall = half + Edge::Bridge.stands_off_m() as f32;
            lay((0.0, 0.0), (wall, 0.0), road, None);
            lay((wall, 0.0), (wall, WALL_M), BLACK, Some(eye));
            lay((wall, WALL_M), (wall + 0.3, WALL_M), BLACK_TOP, None);
            lay((wall + 0.3, WALL_M), (wall + 0.3, -5.0), BLACK, Some(self.across(from, side, (90.0, 0.0))));
            return;
        }
        let (level, foot) = match self.track.file().theme {
            Theme::Lake => (half + 1.65, (half + SHOULDER_M - 0.1, if kind == kind::DIRT { 0.0 } else { 0.24 })),
            Theme::Jungle => (half, (half + 1.0, 0.0)),
            Theme::Mountain => (half + 1.0, (half + 2.0, 0.0)),
        };
        lay((0.0, 0.0), (level, 0.0), road, None);
        let beside = if self.track.file().theme == Theme::Jungle { Paint::Ground } else { road };
        if self.in_the_air(from) && self.track.file().theme != Theme::Lake {
            lay((level, 0.0), foot, beside, None);
            lay(foot, (foot.0, -DECK_M), DECK, Some(self.across(from, side, (90.0, 0.0))));
            lay((0.0, -DECK_M), (foot.0, -DECK_M), DECK_BELOW, Some(eye - Vec3::Y * 20.0));
            if self.track.file().theme != Theme::Jungle {
                // Along the real jungle's road there are posts, no parapets: to a network that drives, these look like road.
                lay((foot.0 - 0.2, 0.0), (foot.0 - 0.2, 0.8), DECK, Some(eye));
            }
            return;
        }
        if [from, to].into_iter().any(|station| self.beside_another(self.across(station, side, (foot.0 + 1.6, 0.0)))) {
            // No room for a shoulder between two roads side by side: the higher one ends in a wall.
            let edge = level.min(half + 0.1);
            lay((level.min(edge), 0.0), (edge, 0.0), beside, None);
            // Grass, lit like the road: a grey or dark wall looks like road, and between the real ones there is none.
            lay((edge, 0.0), (edge, -2.6), Paint::Ground, Some(self.across(from, side, (90.0, 0.0))));
            let n = chunk.faces.len();
            for face in &mut chunk.faces[n - 2..] {
                face.normal = Vec3::Y;
            }
            return;
        }
        lay((level, 0.0), foot, beside, None);
        lay(foot, (foot.0 + 1.6, foot.1 - 2.4), Paint::Ground, None);
        if self.track.file().theme == Theme::Lake && kind != kind::DIRT {
            // The bank is lit more strongly or weakly than so low a rise would be: the look is what counts.
            let inwards = from.position.as_vec3() - self.across(from, side, (1.0, 0.0));
            let steep = (Vec3::Y + inwards.normalize_or_zero() * 0.55).normalize();
            let n = chunk.faces.len();
            for face in &mut chunk.faces[n - 4..n - 2] {
                face.normal = steep;
            }
        }
    }

    fn quad(
        &self,
        chunk: &mut Cluster,
        (from, to): (&Station, &Station),
        side: Side,
        (a, b): (Corner, Corner),
        paint: Paint,
        towards: Option<Vec3>,
    ) {
        let sign = if side == Side::Right { 1.0 } else { -1.0 };
        let corners = [(from, a), (to, a), (to, b), (from, b)].map(|(station, corner)| {
            let at = self.across(station, side, corner);
            let along = station.s as f32 - chunk.base;
            match paint {
                Paint::Ground => chunk.point(at, at.x - self.ground.x0, at.z - self.ground.z0),
                Paint::Tile { .. } => chunk.point(at, along / 8.0, (corner.0 + corner.1) / 8.0),
                _ => chunk.point(at, along, sign * corner.0),
            }
        });
        chunk.quad(corners, paint, towards);
    }

    fn rock(&self, chunk: &mut Cluster, from: &Station, to: &Station, side: Side) {
        let half = self.half();
        let tint = self.look.rock.map(|c| c as u8);
        let paint = Paint::Tile { texture: tile::ROCK, tint };
        let seed = self.track.file().scenery_seed as u32 + if side == Side::Right { 60 } else { 70 };
        let profile: [Corner; 5] = match self.track.file().theme {
            // Cliffs that shade the whole road.
            Theme::Mountain => [(3.0, -0.6), (3.1, 3.5), (3.4, 7.5), (4.2, 11.5), (7.5, 15.0)],
            Theme::Lake | Theme::Jungle => [(3.0, -0.6), (3.4, 2.0), (4.2, 4.6), (5.4, 7.2), (8.5, 9.0)],
        };
        let sign = if side == Side::Right { 1.0 } else { -1.0 };
        let corner = |station: &Station, i: usize| {
            let s = station.s as f32;
            let (out, up) = profile[i];
            let bulge = if i == 0 { 0.3 } else { 1.4 };
            let tall = 0.7 + 0.7 * fractal(s / 14.0, 0.5, 2, 0, seed + 1);
            (half + out + bulge * fractal(s / 4.0, i as f32 * 1.7, 2, 0, seed), if i == 0 { up } else { up * tall })
        };
        let middle = self.across(from, side, corner(from, 2));
        if !self.clear(middle, 2.0) || !self.clear(self.across(from, side, corner(from, 4)), 2.0) {
            return;
        }
        let eye = from.position.as_vec3() + Vec3::Y * 3.0;
        for i in 0..4 {
            let corners = [(from, i), (to, i), (to, i + 1), (from, i + 1)].map(|(station, i)| {
                let (out, up) = corner(station, i);
                let at = self.across(station, side, (out, up));
                chunk.point(at, (station.s as f32 - chunk.base) / 8.0 * sign, up / 8.0)
            });
            chunk.quad(corners, paint, Some(eye));
        }
    }

    fn block(&self, chunk: &mut Cluster, station: &Station, side: Side, number: i32) {
        let seed = self.track.file().scenery_seed as u32;
        let sign = if side == Side::Right { 1.0 } else { -1.0 };
        let askew = (unit(number, sign as i32, seed) - 0.5) * 0.14;
        let ahead = (station.ahead().as_vec3() + station.right().as_vec3() * askew).normalize();
        let out = Vec3::new(ahead.z, 0.0, -ahead.x) * sign;
        let foot = self.across(station, side, (self.half() + 1.2 + 0.3, 0.0));
        if !self.clear(foot, 1.0) {
            return;
        }
        let at = |x: f32, y: f32, z: f32| foot + out * x + Vec3::Y * y + ahead * z;
        // Narrower at the top; the texture spans one long side.
        let corner = |x: f32, y: f32, z: f32| {
            at(x * if y > 0.0 { 0.18 } else { 0.3 }, if y > 0.0 { 0.82 } else { -0.3 }, z * 0.86)
        };
        let paint = Paint::Tile { texture: tile::BLOCK, tint: [255, 255, 255] };
        let sides = [
            [(-1.0, -1.0), (-1.0, 1.0)],
            [(1.0, 1.0), (1.0, -1.0)],
            [(-1.0, 1.0), (1.0, 1.0)],
            [(1.0, -1.0), (-1.0, -1.0)],
        ];
        let middle = at(0.0, 0.3, 0.0);
        for (k, [(x0, z0), (x1, z1)]) in sides.into_iter().enumerate() {
            let wide = if k < 2 { 1.0 } else { 0.35 };
            let corners = [(x0, z0, 0.0, 0.0), (x1, z1, 0.0, wide), (x1, z1, 1.0, wide), (x0, z0, 1.0, 0.0)]
                .map(|(x, z, y, u)| chunk.point(corner(x, y, z), u, 0.98 - 0.96 * y));
            let beyond = middle + (at(x0 + x1, 0.3, z0 + z1) - middle) * 10.0;
            chunk.quad(corners, paint, Some(beyond));
        }
        let top =
            [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)].map(|(x, z)| chunk.point(corner(x, 1.0, z), 0.0, 0.0));
        chunk.quad(top, Paint::Flat([140, 140, 138]), None);
    }
}
