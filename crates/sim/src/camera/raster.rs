//! From triangles to pixels: which triangle each pixel shows, and how deep.
//!
//! Nothing is coloured here. Every triangle leaves a [`FaceSetup`], the planes of
//! its attributes over the picture; every pixel keeps the number of the
//! nearest one. So a pixel is shaded once, however many triangles lie behind.

use glam::Vec3;

use super::{
    noise::nearest,
    viewpoint::{NEAR, Viewpoint},
};

/// What a surface is covered with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Paint {
    /// Open ground; u and v are metres on the ground's map.
    Ground,
    /// The road's strip; u is metres along it from the chunk's base, v the offset.
    Road { section: u8, station: u16 },
    /// A texture of its own, tinted; u and v are units of its size.
    Tile { texture: u8, tint: [u8; 3] },
    /// One colour.
    Flat([u8; 3]),
    /// Still water.
    Water,
}

/// A corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    pub(super) at: Vec3,
    pub(super) u: f32,
    pub(super) v: f32,
}

/// A triangle of a [`Cluster`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Face {
    pub(super) corners: [u16; 3],
    pub(super) paint: Paint,
    pub(super) normal: Vec3,
}

/// Triangles that are seen or not seen together.
#[derive(Debug, Clone, Default)]
pub(super) struct Cluster {
    pub(super) points: Vec<Vertex>,
    pub(super) faces: Vec<Face>,
    /// Added to u, where it says how far along the road.
    pub(super) base: f32,
    pub(super) centre: Vec3,
    pub(super) radius: f32,
}

impl Cluster {
    /// Adds a corner and returns its number.
    pub(super) fn point(&mut self, at: Vec3, u: f32, v: f32) -> u16 {
        self.points.push(Vertex { at, u, v });
        (self.points.len() - 1) as u16
    }

    /// Adds a triangle, whose normal points up or, if it stands upright, towards `towards`.
    pub(super) fn face(&mut self, corners: [u16; 3], paint: Paint, towards: Option<Vec3>) {
        let [a, b, c] = corners.map(|i| self.points[i as usize].at);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let away = match towards {
            Some(towards) => normal.dot(towards - a) < 0.0,
            None => normal.y < 0.0,
        };
        self.faces.push(Face { corners, paint, normal: if away { -normal } else { normal } });
    }

    /// Adds two triangles for corners given around the quadrilateral.
    pub(super) fn quad(&mut self, [a, b, c, d]: [u16; 4], paint: Paint, towards: Option<Vec3>) {
        self.face([a, b, c], paint, towards);
        self.face([a, c, d], paint, towards);
    }

    /// Computes its bounds, after the last corner.
    pub(super) fn bound(mut self) -> Self {
        let low = self.points.iter().fold(Vec3::MAX, |m, p| m.min(p.at));
        let high = self.points.iter().fold(Vec3::MIN, |m, p| m.max(p.at));
        self.centre = (low + high) / 2.0;
        self.radius = self.points.iter().map(|p| p.at.distance(self.centre)).fold(0.0, f32::max);
        self
    }
}

/// A linear function of a pixel's column and row, counted at its middle.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Plane {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) at: f32,
}

impl Plane {
    #[inline]
    pub(super) fn row(&self, y: usize) -> f32 {
        self.at + self.y * y as f32
    }
}

/// What shading needs to know of a triangle in the picture: 1/depth, u/depth and v/depth.
#[derive(Debug, Clone, Copy)]
pub(super) struct FaceSetup {
    pub(super) w: Plane,
    pub(super) u: Plane,
    pub(super) v: Plane,
    pub(super) base: f32,
    pub(super) light: f32,
    pub(super) paint: Paint,
}

/// A pixel that shows the sky.
pub(super) const SKY: u32 = 0;
/// Set if a pixel's colour is known: the low 24 bits are the colour.
pub(super) const COLOURED: u32 = 1 << 31;

/// What the pixels show.
#[derive(Debug, Default)]
pub(super) struct Raster {
    /// 1/depth of each pixel, 0 for the sky.
    pub(super) depth: Vec<f32>,
    /// 1 + the number of a setup, or [`SKY`], or a colour with [`COLOURED`].
    pub(super) ids: Vec<u32>,
    pub(super) setups: Vec<FaceSetup>,
    turned: Vec<Vec3>,
    width: usize,
    height: usize,
}

impl Raster {
    /// Begins an empty picture.
    pub(super) fn clear(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.depth.clear();
        self.depth.resize(width * height, 0.0);
        self.ids.clear();
        self.ids.resize(width * height, SKY);
        self.setups.clear();
    }

    /// Draws a chunk. If `one_sided`, faces that look away are left out.
    pub(super) fn draw(&mut self, view: &Viewpoint, chunk: &Cluster, one_sided: bool, light: impl Fn(Vec3) -> f32) {
        let mut turned = std::mem::take(&mut self.turned);
        turned.clear();
        turned.extend(chunk.points.iter().map(|p| view.turn(p.at)));
        for face in &chunk.faces {
            let [a, b, c] = face.corners.map(|i| turned[i as usize]);
            if a.z.max(b.z).max(c.z) <= NEAR {
                continue;
            }
            if one_sided {
                let at = chunk.points[face.corners[0] as usize].at;
                if (view.eye - at).dot(face.normal) <= 0.0 {
                    continue;
                }
            }
            let points = face.corners.map(|i| &chunk.points[i as usize]);
            let (ab, bc, ca) = (a.cross(b), b.cross(c), c.cross(a));
            let volume = a.dot(bc);
            if volume.abs() < 1e-7 {
                continue; // seen from its edge
            }
            let over = 1.0 / volume;
            let (ga, gb, gc) = (bc * over, ca * over, ab * over);
            let w = view.plane(ga + gb + gc);
            let id = self.setups.len() as u32 + 1;
            let drawn = if a.z.min(b.z).min(c.z) >= NEAR {
                self.triangle([view.project(a), view.project(b), view.project(c)], &w, id)
            } else {
                self.clipped(view, [a, b, c], &w, id)
            };
            if drawn {
                self.setups.push(FaceSetup {
                    w,
                    u: view.plane(ga * points[0].u + gb * points[1].u + gc * points[2].u),
                    v: view.plane(ga * points[0].v + gb * points[1].v + gc * points[2].v),
                    base: chunk.base,
                    light: light(face.normal),
                    paint: face.paint,
                });
            }
        }
        self.turned = turned;
    }

    fn clipped(&mut self, view: &Viewpoint, corners: [Vec3; 3], w: &Plane, id: u32) -> bool {
        let mut kept = [(0.0, 0.0); 4];
        let mut n = 0;
        ahead(view, &corners, |point| {
            kept[n] = point;
            n += 1;
        });
        let mut drawn = false;
        for i in 1..n.saturating_sub(1) {
            drawn |= self.triangle([kept[0], kept[i], kept[i + 1]], w, id);
        }
        drawn
    }

    /// Fills a triangle where it is nearest; returns whether it won any pixel.
    #[inline]
    fn triangle(&mut self, p: [(f32, f32); 3], w: &Plane, id: u32) -> bool {
        let mut drawn = false;
        let (depths, ids) = (&mut self.depth, &mut self.ids);
        spans(p, self.width, self.height, |y, from, to| {
            drawn = true;
            let (start, end) = (y * self.width + from, y * self.width + to);
            let row = w.row(y);
            let (depth, ids) = (&mut depths[start..end], &mut ids[start..end]);
            // Without branches, so that the compiler takes several pixels at a time.
            for ((depth, shown), x) in depth.iter_mut().zip(ids).zip(from as i32..) {
                let here = row + w.x * x as f32;
                let nearer = u32::from(here > *depth).wrapping_neg();
                *depth = f32::from_bits(here.to_bits() & nearer | depth.to_bits() & !nearer);
                *shown = id & nearer | *shown & !nearer;
            }
        });
        drawn
    }

    /// Calls `darken` for each pixel that shows ground in a model's shadow.
    pub(super) fn shadow(
        &self,
        view: &Viewpoint,
        model: &Cluster,
        sun: Vec3,
        is_ground: impl Fn(&FaceSetup) -> bool,
        mut darken: impl FnMut(usize),
    ) {
        if sun.y < 0.05 {
            return;
        }
        let foot = model.points.iter().map(|p| p.at.y).fold(f32::MAX, f32::min) + 0.02;
        let mut fallen: Vec<Vec3> = model.points.iter().map(|p| p.at - sun * ((p.at.y - foot) / sun.y)).collect();
        convex_hull(&mut fallen);
        let turned: Vec<Vec3> = fallen.into_iter().map(|p| view.turn(p)).collect();
        let mut outline = Vec::with_capacity(turned.len() + 1);
        ahead(view, &turned, |point| outline.push(point));
        for i in 1..outline.len().saturating_sub(1) {
            spans([outline[0], outline[i], outline[i + 1]], self.width, self.height, |y, from, to| {
                for at in y * self.width + from..y * self.width + to {
                    let id = self.ids[at];
                    if id != SKY && id & COLOURED == 0 && is_ground(&self.setups[id as usize - 1]) {
                        darken(at);
                    }
                }
            });
        }
    }
}

/// Calls `keep` for each corner of what is left of a convex outline, in the camera's axes, once it is cut off at the nearest
/// distance that is drawn: at most one more than it had.
#[inline]
fn ahead(view: &Viewpoint, corners: &[Vec3], mut keep: impl FnMut((f32, f32))) {
    for (i, a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % corners.len()];
        if a.z >= NEAR {
            keep(view.project(*a));
        }
        if (a.z >= NEAR) != (b.z >= NEAR) {
            // Always from the nearer to the farther point, so that neighbours cut their common edge at the same place.
            let (near, far) = if a.z < b.z { (*a, b) } else { (b, *a) };
            let cut = near + (far - near) * ((NEAR - near.z) / (far.z - near.z));
            keep(view.project(Vec3::new(cut.x, cut.y, NEAR)));
        }
    }
}

/// The corners of the outline of points on the ground, in order (Andrew's monotone chain).
fn convex_hull(points: &mut Vec<Vec3>) {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.z.total_cmp(&b.z)));
    let mut hull: Vec<Vec3> = Vec::with_capacity(points.len());
    for pass in 0..2 {
        let start = hull.len();
        let order: &mut dyn Iterator<Item = &Vec3> =
            if pass == 0 { &mut points.iter() } else { &mut points.iter().rev() };
        for p in order {
            while hull.len() >= start + 2 {
                let (a, b) = (hull[hull.len() - 2], hull[hull.len() - 1]);
                if (b.x - a.x) * (p.z - a.z) - (b.z - a.z) * (p.x - a.x) > 1e-9 {
                    break;
                }
                hull.pop();
            }
            hull.push(*p);
        }
        hull.pop();
    }
    *points = hull;
}

/// Calls `fill` with row, first column and end of each row of a triangle. Triangles with a common edge leave no pixel
/// between them and share none.
#[inline]
fn spans(mut p: [(f32, f32); 3], width: usize, height: usize, mut fill: impl FnMut(usize, usize, usize)) {
    if p[1].1 < p[0].1 {
        p.swap(0, 1);
    }
    if p[2].1 < p[1].1 {
        p.swap(1, 2);
    }
    if p[1].1 < p[0].1 {
        p.swap(0, 1);
    }
    let [a, b, c] = p;
    let (first, last) = (pixel(a.1, height), pixel(c.1, height));
    let outside = a.0.max(b.0).max(c.0) < 0.0 || a.0.min(b.0).min(c.0) > width as f32;
    if first >= last || outside {
        return;
    }
    let middle = pixel(b.1, height);
    // Always from the upper end down: neighbours find the same columns on their common edge.
    let slope = |p: (f32, f32), q: (f32, f32)| if q.1 > p.1 { (q.0 - p.0) / (q.1 - p.1) } else { 0.0 };
    let (long, upper, lower) = (slope(a, c), slope(a, b), slope(b, c));
    for y in first..last {
        let at = y as f32 + 0.5;
        let one = a.0 + (at - a.1) * long;
        let other = if y < middle { a.0 + (at - a.1) * upper } else { b.0 + (at - b.1) * lower };
        let (from, to) = (pixel(one.min(other), width), pixel(one.max(other), width));
        if from < to {
            fill(y, from, to);
        }
    }
}

/// The first pixel whose middle lies at or beyond `x`, within the picture.
#[inline]
fn pixel(x: f32, size: usize) -> usize {
    nearest(x.clamp(0.0, size as f32))
}
