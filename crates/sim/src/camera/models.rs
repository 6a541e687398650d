//! Cars, people, bicycles, cones, barriers and steel plates: a few boxes each.

use glam::Vec3;

use super::{
    raster::{Cluster, Paint},
    wardrobe::{Colour, Wardrobe},
};
use crate::{
    scene::{Actor, ActorKind, Looks},
    vehicle::BODY,
};

/// What someone has on, and is.
#[derive(Clone, Copy)]
struct Dress {
    clothes: Colour,
    trousers: Colour,
    skin: Colour,
    hair: Colour,
}
const GLASS: [u8; 3] = [36, 44, 54];
const TYRE: [u8; 3] = [24, 24, 26];

/// A box in the axes of its owner: its width below and above, and its extent upwards and forwards.
#[derive(Clone, Copy)]
struct Part {
    x: f32,
    wide: (f32, f32),
    up: (f32, f32),
    /// Rear and front ends, below and above.
    low: (f32, f32),
    high: (f32, f32),
    colour: [u8; 3],
}

impl Part {
    fn straight(x: f32, wide: f32, up: (f32, f32), along: (f32, f32), colour: [u8; 3]) -> Self {
        Self { x, wide: (wide, wide), up, low: along, high: along, colour }
    }
}

/// An actor as triangles in the world.
pub(super) fn actor(actor: &Actor, time_s: f64) -> Cluster {
    let size = actor.size().as_vec3();
    let (wardrobe, look) = (Wardrobe::of(actor.look), actor.look as usize);
    let pick = |colours: &[Colour], of: usize| colours[of % colours.len()];
    let dress = Dress {
        clothes: pick(wardrobe.clothes, look),
        trousers: pick(wardrobe.trousers, look / 5),
        skin: pick(wardrobe.skin, look / 7),
        hair: pick(wardrobe.hair, look / 11),
    };
    // Legs swing with the walking speed: about 1.4 m per double step.
    let swing = if actor.speed.abs() > 0.05 { (time_s * actor.speed * 4.5).sin() as f32 } else { 0.0 };
    let parts = match actor.kind {
        ActorKind::Car if Looks::of(actor.look) == Looks::Plain => car(size, pick(wardrobe.cars, look), CABINS[0]),
        ActorKind::Car => car(size, pick(wardrobe.cars, look), CABINS[Looks::shape(actor.look)]),
        ActorKind::Pedestrian | ActorKind::Child => person(size, swing, dress),
        ActorKind::Bicycle => bicycle(size, swing, dress, pick(wardrobe.cars, look / 3)),
        ActorKind::Cone => cone(size),
        ActorKind::Barrier => barrier(size),
        ActorKind::SteelPlate => {
            vec![Part::straight(0.0, size.x, (0.0, size.y), (-size.z / 2.0, size.z / 2.0), [104, 98, 92])]
        }
    };
    place(&parts, actor.position.as_vec3(), actor.yaw as f32, 0.0)
}

/// The car that is driven, as others see it: its body, and its wheels, of which those in front are turned by `steering`
/// radians to the right.
pub(super) fn own_car(position: Vec3, yaw: f32, nose_up: f32, steering: f32) -> [Cluster; 5] {
    let size = BODY.as_vec3();
    // Others' wheels are part of them and hidden below the body; these are round and stand free.
    let mut parts = car(size, [150, 142, 116], CABINS[0]).split_off(4);
    (parts[0].up.0, parts[0].wide.0) = (0.36 * size.y, 0.86 * size.x);
    if let Some(plate) = parts.last_mut() {
        plate.up = (0.40 * size.y, 0.48 * size.y);
    }
    let ((s, c), (ps, pc)) = (yaw.sin_cos(), nose_up.sin_cos());
    let put = |side: f32, end: f32| {
        let (x, y, z) = (side * (size.x / 2.0 - 0.06), WHEEL_M, end * 0.33 * size.z);
        let (y, z) = (y * pc + z * ps, z * pc - y * ps);
        let middle = position + Vec3::new(x * c + z * s, y, z * c - x * s);
        place(&wheel(side), middle, yaw + if end > 0.0 { steering } else { 0.0 }, nose_up)
    };
    let [a, b, c, d] = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(side, end)| put(side, end));
    [place(&parts, position, yaw, nose_up), a, b, c, d]
}

/// Radius of the driven car's wheels, in metres.
const WHEEL_M: f32 = 0.36;

/// A wheel about its middle: three boards that make an octagon, and its cap on the outer side.
fn wheel(side: f32) -> Vec<Part> {
    let tyre = [(0.42, 1.0), (0.78, 0.78), (1.0, 0.42)].map(|(along, up)| {
        let (along, up) = (along * WHEEL_M, up * WHEEL_M);
        Part::straight(0.0, 0.26, (-up, up), (-along, along), TYRE)
    });
    let cap = 0.5 * WHEEL_M;
    let cap = Part::straight(side * 0.13, 0.02, (-cap, cap), (-cap, cap), [176, 178, 182]);
    tyre.into_iter().chain([cap]).collect()
}

fn place(parts: &[Part], position: Vec3, yaw: f32, nose_up: f32) -> Cluster {
    let ((s, c), (ps, pc)) = (yaw.sin_cos(), nose_up.sin_cos());
    let mut chunk = Cluster::default();
    for part in parts {
        let at = |chunk: &mut Cluster, x: f32, y: f32, z: f32| {
            let (y, z) = (y * pc + z * ps, z * pc - y * ps);
            chunk.point(position + Vec3::new(x * c + z * s, y, z * c - x * s), 0.0, 0.0)
        };
        let (l, h) = (part.wide.0 / 2.0, part.wide.1 / 2.0);
        let low = [(-l, part.low.0), (l, part.low.0), (l, part.low.1), (-l, part.low.1)];
        let high = [(-h, part.high.0), (h, part.high.0), (h, part.high.1), (-h, part.high.1)];
        let low = low.map(|(x, z)| at(&mut chunk, x + part.x, part.up.0, z));
        let high = high.map(|(x, z)| at(&mut chunk, x + part.x, part.up.1, z));
        let paint = Paint::Flat(part.colour);
        let first = low[0] as usize;
        let middle = chunk.points[first..first + 8].iter().map(|p| p.at).sum::<Vec3>() / 8.0;
        for k in 0..4 {
            let next = (k + 1) % 4;
            let (a, b) = (chunk.points[low[k] as usize].at, chunk.points[high[next] as usize].at);
            let beyond = middle + ((a + b) / 2.0 - middle) * 50.0;
            chunk.quad([low[k], low[next], high[next], high[k]], paint, Some(beyond));
        }
        chunk.quad(high, paint, None);
    }
    chunk.bound()
}

/// Where a car's cabin is, in halves of its length: its rear and front, below and above.
type Cabin = [(f32, f32); 2];

/// Of a saloon, a hatchback and a van.
const CABINS: [Cabin; 3] =
    [[(-0.82, 0.42), (-0.56, 0.08)], [(-0.97, 0.36), (-0.84, 0.06)], [(-0.98, 0.74), (-0.95, 0.44)]];

fn car(size: Vec3, colour: [u8; 3], [below, above]: Cabin) -> Vec<Part> {
    let (w, h, l) = (size.x, size.y, size.z / 2.0);
    let mut parts = Vec::new();
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let z = z * 0.62 * l;
        parts.push(Part::straight(x * (w / 2.0 - 0.12), 0.24, (0.0, 0.62), (z - 0.31, z + 0.31), TYRE));
    }
    parts.push(Part {
        x: 0.0,
        wide: (w, w * 0.96),
        up: (0.22 * h, 0.60 * h),
        low: (-l, l),
        high: (-0.98 * l, 0.96 * l),
        colour,
    });
    let cabin = |up: (f32, f32), inset: f32, colour| Part {
        x: 0.0,
        wide: (w * (0.92 - inset), w * 0.72),
        up,
        low: (below.0 * l, below.1 * l),
        high: (above.0 * l, above.1 * l),
        colour,
    };
    parts.push(cabin((0.60 * h, 0.96 * h), 0.0, GLASS));
    parts.push(Part::straight(0.0, w * 0.72, (0.94 * h, h), (above.0 * l, above.1 * l), colour));
    for x in [-1.0, 1.0] {
        let x = x * w * 0.37;
        parts.push(Part::straight(x, w * 0.18, (0.42 * h, 0.54 * h), (-1.01 * l, -0.99 * l), [170, 24, 22]));
        parts.push(Part::straight(x, w * 0.18, (0.40 * h, 0.52 * h), (0.97 * l, 1.005 * l), [236, 236, 220]));
    }
    parts.push(Part::straight(0.0, 0.5, (0.30 * h, 0.38 * h), (-1.01 * l, 1.0 * l), [226, 226, 220]));
    parts
}

fn person(size: Vec3, swing: f32, Dress { clothes, trousers, skin, hair }: Dress) -> Vec<Part> {
    let (w, h) = (size.x, size.y);
    let leg = |side: f32| {
        let step = side * swing * 0.16 * h;
        Part {
            x: side * w * 0.20,
            wide: (w * 0.26, w * 0.32),
            up: (0.0, 0.48 * h),
            low: (step - 0.08, step + 0.12),
            high: (-0.09, 0.09),
            colour: trousers,
        }
    };
    let arm = |side: f32| {
        let step = -side * swing * 0.10 * h;
        Part {
            x: side * w * 0.40,
            wide: (w * 0.16, w * 0.18),
            up: (0.46 * h, 0.80 * h),
            low: (step - 0.06, step + 0.06),
            high: (-0.07, 0.07),
            colour: clothes,
        }
    };
    let torso = Part {
        x: 0.0,
        wide: (w * 0.66, w * 0.84),
        up: (0.47 * h, 0.83 * h),
        low: (-0.11, 0.11),
        high: (-0.12, 0.12),
        colour: clothes,
    };
    let head = Part::straight(0.0, 0.09 * h, (0.85 * h, 0.97 * h), (-0.06 * h, 0.06 * h), skin);
    let hair = Part::straight(0.0, 0.10 * h, (0.95 * h, h), (-0.065 * h, 0.05 * h), hair);
    vec![leg(-1.0), leg(1.0), arm(-1.0), arm(1.0), torso, head, hair]
}

/// A rider on two wheels, each of three boards that make an octagon; the knees go up and down as the pedals turn.
fn bicycle(size: Vec3, swing: f32, Dress { clothes, trousers, skin, hair }: Dress, frame: Colour) -> Vec<Part> {
    let (w, h, l) = (size.x, size.y, size.z / 2.0);
    let mut parts = Vec::new();
    let radius = 0.18 * h;
    for middle in [radius - l, l - radius] {
        for (half, up) in [(0.42, (0.0, 2.0)), (0.78, (0.2, 1.8)), (1.0, (0.58, 1.42))] {
            let (half, up) = (half * radius, (up.0 * radius, up.1 * radius));
            parts.push(Part::straight(0.0, 0.05, up, (middle - half, middle + half), TYRE));
        }
    }
    parts.push(Part::straight(0.0, 0.05, (0.30 * h, 0.36 * h), (-0.5 * l, 0.45 * l), frame));
    parts.push(Part::straight(0.0, 0.05, (0.30 * h, 0.50 * h), (-0.30 * l, -0.22 * l), frame));
    parts.push(Part::straight(0.0, w * 0.9, (0.54 * h, 0.57 * h), (0.42 * l, 0.48 * l), [40, 40, 42]));
    for side in [-1.0, 1.0] {
        let knee = 0.40 * h + side * swing * 0.05 * h;
        let leg = |up: (f32, f32), low: (f32, f32), high: (f32, f32)| Part {
            x: side * w * 0.2,
            wide: (w * 0.22, w * 0.26),
            up,
            low,
            high,
            colour: trousers,
        };
        parts.push(leg((0.12 * h, knee), (-0.10 * l, 0.08 * l), (0.04 * l, 0.22 * l)));
        parts.push(leg((knee - 0.03 * h, 0.53 * h), (-0.02 * l, 0.22 * l), (-0.34 * l, -0.08 * l)));
        parts.push(Part {
            x: side * w * 0.38,
            wide: (w * 0.14, w * 0.16),
            up: (0.56 * h, 0.80 * h),
            low: (0.30 * l, 0.46 * l),
            high: (-0.10 * l, 0.06 * l),
            colour: clothes,
        });
    }
    parts.push(Part {
        x: 0.0,
        wide: (w * 0.6, w * 0.8),
        up: (0.50 * h, 0.84 * h),
        low: (-0.36 * l, -0.10 * l),
        high: (-0.14 * l, 0.12 * l),
        colour: clothes,
    });
    parts.push(Part::straight(0.0, 0.09 * h, (0.86 * h, 0.97 * h), (-0.04 * l, 0.16 * l), skin));
    parts.push(Part::straight(0.0, 0.10 * h, (0.95 * h, h), (-0.05 * l, 0.15 * l), hair));
    parts
}

fn cone(size: Vec3) -> Vec<Part> {
    let w = size.x;
    let ring = |up: (f32, f32), colour| {
        let wide = |y: f32| w * 0.72 * (1.0 - y / size.y * 0.86);
        let (a, b) = (wide(up.0), wide(up.1));
        Part { x: 0.0, wide: (a, b), up, low: (-a / 2.0, a / 2.0), high: (-b / 2.0, b / 2.0), colour }
    };
    let (orange, white) = ([226, 92, 34], [236, 236, 232]);
    vec![
        Part::straight(0.0, w, (0.0, 0.05), (-w / 2.0, w / 2.0), [58, 50, 46]),
        ring((0.05, 0.28), orange),
        ring((0.28, 0.42), white),
        ring((0.42, 0.56), orange),
        ring((0.56, size.y), white),
    ]
}

fn barrier(size: Vec3) -> Vec<Part> {
    let mut parts = Vec::new();
    for x in [-0.4, 0.4] {
        parts.push(Part::straight(x * size.x, 0.08, (0.0, size.y), (-size.z / 2.0, size.z / 2.0), [90, 90, 92]));
    }
    let n = 8;
    for (low, high) in [(0.30, 0.55), (0.70, 0.97)] {
        for k in 0..n {
            let wide = size.x / n as f32;
            let x = (k as f32 + 0.5) * wide - size.x / 2.0;
            let colour = if k % 2 == 0 { [206, 44, 38] } else { [232, 232, 228] };
            parts.push(Part::straight(x, wide, (low * size.y, high * size.y), (-0.04, 0.04), colour));
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn a_model_fills_its_box_and_no_more() {
        for (kind, random) in ActorKind::ALL.into_iter().flat_map(|kind| [0, 32, 64].map(|random| (kind, random))) {
            for looks in [Looks::Plain, Looks::Learnt, Looks::HeldOut] {
                let look = looks.look(random);
                let shown = Actor { kind, position: DVec3::ZERO, yaw: 0.0, speed: 0.0, look };
                let (chunk, size) = (actor(&shown, 0.0), shown.size().as_vec3());
                let most = chunk.points.iter().fold(Vec3::ZERO, |m, p| m.max(p.at.abs()));
                assert!(most.x <= size.x / 2.0 + 0.03 && most.z <= size.z / 2.0 + 0.06, "{kind:?}: {most} of {size}");
                assert!((most.y - size.y).abs() < 0.01 && most.x > size.x * 0.4, "{kind:?}: {most} of {size}");
            }
        }
    }

    #[test]
    fn the_driven_car_stands_on_wheels_of_which_those_in_front_turn_with_its_steering() {
        let corners = |steering: f32| {
            own_car(Vec3::ZERO, 0.0, 0.0, steering).map(|part| part.points.iter().map(|p| p.at).collect::<Vec<_>>())
        };
        let (straight, turned) = (corners(0.0), corners(0.3));
        let lowest = |points: &[Vec3]| points.iter().fold(f32::MAX, |low, p| low.min(p.y));
        assert!(lowest(&straight[0]) > 0.3, "the body leaves them free");
        for (wheel, points) in straight.iter().enumerate().skip(1) {
            assert!(lowest(points).abs() < 0.01, "wheel {wheel}");
            let in_front = points[0].z > 0.0;
            assert_eq!(points != &turned[wheel], in_front, "wheel {wheel}");
        }
    }
}
