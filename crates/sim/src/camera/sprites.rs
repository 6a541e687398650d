//! Pictures of what stands along roads: trees, bushes, boulders, posts, pylons. Painted once, procedurally.

use super::{
    noise::{fractal, mix, mix3, step, unit, value},
    texture::Texture,
};

/// Numbers of the pictures that [`all`] makes.
pub(super) mod picture {
    pub(in super::super) const CONIFER: u8 = 0;
    pub(in super::super) const CONIFER_SPARSE: u8 = 1;
    pub(in super::super) const BUSH: u8 = 2;
    pub(in super::super) const REEDS: u8 = 3;
    pub(in super::super) const BOULDER: u8 = 4;
    pub(in super::super) const PYLON: u8 = 5;
    pub(in super::super) const PALM: u8 = 6;
    pub(in super::super) const PALM_LOW: u8 = 7;
    pub(in super::super) const SPIRE: u8 = 8;
    pub(in super::super) const POST: u8 = 9;
    pub(in super::super) const AUTUMN: u8 = 10;
    pub(in super::super) const AUTUMN_DARK: u8 = 11;
    pub(in super::super) const LAMP: u8 = 12;
    pub(in super::super) const CHEVRON: u8 = 13;
    pub(in super::super) const SIGN: u8 = 14;
}

/// All pictures, in the order of [`picture`].
pub(super) fn all() -> Vec<Texture> {
    let green = ([36.0, 44.0, 24.0], [150.0, 146.0, 74.0]);
    vec![
        tree(
            11,
            Crown { from: 0.02, to: 0.66, wide: 0.40, tip: 0.5, gaps: 0.44, grain: 9.0 },
            green,
            [62.0, 46.0, 36.0],
        ),
        tree(
            12,
            Crown { from: 0.02, to: 0.55, wide: 0.36, tip: 0.8, gaps: 0.50, grain: 7.0 },
            green,
            [58.0, 44.0, 36.0],
        ),
        bush(13, ([38.0, 44.0, 16.0], [104.0, 104.0, 44.0]), 0.55),
        reeds(14),
        boulder(15),
        pylon(),
        palm(16, 0.56, ([28.0, 34.0, 18.0], [98.0, 104.0, 54.0])),
        palm(17, 0.9, ([28.0, 36.0, 18.0], [92.0, 102.0, 50.0])),
        spire(18),
        post(),
        tree(
            19,
            Crown { from: 0.02, to: 0.82, wide: 0.48, tip: 0.3, gaps: 0.47, grain: 11.0 },
            ([26.0, 17.0, 8.0], [104.0, 64.0, 24.0]),
            [92.0, 84.0, 72.0],
        ),
        tree(
            20,
            Crown { from: 0.05, to: 0.9, wide: 0.48, tip: 0.4, gaps: 0.42, grain: 10.0 },
            ([22.0, 24.0, 12.0], [78.0, 70.0, 28.0]),
            [60.0, 54.0, 46.0],
        ),
        lamp(),
        chevron(),
        sign(),
    ]
}

type Shades = ([f32; 3], [f32; 3]);

/// A crown: where it begins and ends from the top, its width, how pointed it is, its share of gaps, its coarseness.
struct Crown {
    from: f32,
    to: f32,
    wide: f32,
    tip: f32,
    gaps: f32,
    grain: f32,
}

const NONE: [f32; 4] = [0.0; 4];

fn solid(colour: [f32; 3]) -> [f32; 4] {
    [colour[0], colour[1], colour[2], 255.0]
}

fn tree(seed: u32, crown: Crown, (dark, bright): Shades, bark: [f32; 3]) -> Texture {
    Texture::paint(64, 128, |px, py| {
        let (x, y) = ((px as f32 + 0.5) / 64.0 - 0.5, (py as f32 + 0.5) / 128.0);
        let t = (y - crown.from) / (crown.to - crown.from);
        if (0.0..1.0).contains(&t) {
            let lobes = fractal(x * crown.grain + 20.0, y * crown.grain * 1.6, 3, 0, seed);
            let outline = crown.wide * (t / crown.tip.max(0.05)).min(1.0).powf(0.7) * (1.0 - t.powi(4) * 0.75);
            let inside = 1.0 - x.abs() / outline.max(0.01);
            if lobes + 0.35 * inside.min(0.6) > crown.gaps + 0.06 && inside > 0.25 * (1.0 - lobes) - 0.05 {
                let leaf = value(x * 46.0, y * 74.0, 0, seed + 5);
                let lit = 0.5 - 0.8 * x + 1.2 * (lobes - 0.5) + 0.5 * (leaf - 0.5) - 0.3 * (t - 0.4);
                return solid(mix3(dark, bright, lit.clamp(0.0, 1.0)));
            }
        }
        let bend = 0.03 * (y * 7.0 + seed as f32).sin();
        if y > crown.from + 0.12 && (x - bend * (1.0 - y)).abs() < 0.016 + 0.022 * y {
            return solid(bark.map(|c| c * (1.0 - 6.0 * x)));
        }
        NONE
    })
}

fn bush(seed: u32, (dark, bright): Shades, height: f32) -> Texture {
    Texture::paint(64, 64, |px, py| {
        let (x, y) = ((px as f32 + 0.5) / 32.0 - 1.0, 1.0 - (py as f32 + 0.5) / 64.0);
        let lobes = fractal(x * 5.0 + 9.0, y * 5.0, 3, 0, seed);
        let top = (1.0 - x * x).max(0.0).sqrt() * (height + 0.75 * (lobes - 0.3));
        if y >= top {
            return NONE;
        }
        let lit = y / top.max(0.1) * 0.7 + 0.8 * (value(x * 22.0, y * 22.0, 0, seed + 2) - 0.5);
        solid(mix3(dark, bright, lit.clamp(0.0, 1.0)))
    })
}

fn reeds(seed: u32) -> Texture {
    Texture::paint(128, 64, |px, py| {
        let (x, y) = (px as f32, 1.0 - (py as f32 + 0.5) / 64.0);
        let blade = |shift: f32, y: f32| {
            let at = x / 2.6 + shift + (y * 3.0 + shift).sin() * 0.6;
            let (number, within) = (at.floor(), at.fract());
            let tall = 0.55 + 0.45 * unit(number as i32, shift as i32, seed);
            let edge = (1.0 - (2.0 * px as f32 / 127.0 - 1.0).powi(6)) * tall;
            (y < edge && (within - 0.5).abs() < 0.48 * (1.0 - y / edge.max(0.01)) + 0.14, unit(number as i32, 3, seed))
        };
        for shift in [0.0, 7.0, 13.0] {
            let (on, tone) = blade(shift, y);
            if on {
                let lit = 0.25 + 0.55 * y + 0.3 * (tone - 0.5);
                return solid(mix3([32.0, 40.0, 10.0], [112.0, 122.0, 44.0], lit));
            }
        }
        NONE
    })
}

fn boulder(seed: u32) -> Texture {
    Texture::paint(128, 64, |px, py| {
        let (x, y) = ((px as f32 + 0.5) / 64.0 - 1.0, 1.0 - (py as f32 + 0.5) / 64.0);
        let wobble = fractal(x * 2.2 + 5.0, 1.0, 3, 0, seed);
        let top = (1.0 - x.abs().powf(2.6)).max(0.0).sqrt() * (0.62 + 0.7 * (wobble - 0.25));
        if y >= top {
            return NONE;
        }
        let rough = fractal(x * 7.0, y * 10.0, 4, 0, seed + 3);
        let lit = 0.15 + 0.75 * (y / top.max(0.1)).powf(0.8) + 0.9 * (rough - 0.5);
        solid(mix3([62.0, 66.0, 64.0], [198.0, 190.0, 162.0], lit.clamp(0.0, 1.0)))
    })
}

fn spire(seed: u32) -> Texture {
    Texture::paint(64, 128, |px, py| {
        let (x, y) = ((px as f32 + 0.5) / 32.0 - 1.0, 1.0 - (py as f32 + 0.5) / 128.0);
        let top = 1.0 - 0.9 * x.abs().powf(0.8) - 0.25 * fractal(x * 4.0 + 3.0, 0.3, 3, 0, seed);
        if y >= top {
            return NONE;
        }
        let streaks = fractal(x * 9.0, y * 3.0, 4, 0, seed + 1);
        let lit = 0.35 + 0.3 * y - 0.35 * x + 1.2 * (streaks - 0.5);
        solid(mix3([40.0, 48.0, 40.0], [128.0, 130.0, 92.0], lit.clamp(0.0, 1.0)))
    })
}

/// Distance from a point to a piece of a line.
fn off((x, y): (f32, f32), (ax, ay): (f32, f32), (bx, by): (f32, f32)) -> f32 {
    let (dx, dy) = (bx - ax, by - ay);
    let t = (((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
    (x - ax - t * dx).hypot(y - ay - t * dy)
}

fn palm(seed: u32, crown: f32, (dark, bright): Shades) -> Texture {
    let heart = (0.5, crown * 0.36);
    let fronds: Vec<Vec<(f32, f32)>> = (0..13)
        .map(|k| {
            let angle = k as f32 * std::f32::consts::TAU / 13.0 + 0.4 * unit(k, 1, seed);
            let long = 0.36 + 0.12 * unit(k, 2, seed);
            let rise = -0.10 - 0.12 * unit(k, 3, seed);
            (0..=6)
                .map(|i| {
                    let t = i as f32 / 6.0;
                    let droop =
                        rise * (1.0 - 1.0 * t) * t * 2.0 + 0.55 * crown * 0.6 * t * t * (0.5 + 0.5 * unit(k, 4, seed));
                    (heart.0 + angle.cos() * long * t, heart.1 + angle.sin() * 0.10 * t + droop)
                })
                .collect()
        })
        .collect();
    Texture::paint(128, 128, |px, py| {
        let p = ((px as f32 + 0.5) / 128.0, (py as f32 + 0.5) / 128.0);
        for (k, frond) in fronds.iter().enumerate() {
            for (i, pair) in frond.windows(2).enumerate() {
                let d = off(p, pair[0], pair[1]);
                let wide = 0.048 * (1.0 - (i as f32 / 6.0 - 0.35).abs());
                let leaf = value(p.0 * 60.0 + k as f32 * 5.0, p.1 * 30.0, 0, seed + 3);
                if d < wide * (0.35 + leaf) {
                    let lit = 0.35
                        + 0.5 * (1.0 - p.1 / (crown * 0.8))
                        + 0.7 * (leaf - 0.5)
                        + 0.3 * (unit(k as i32, 9, seed) - 0.5);
                    return solid(mix3(dark, bright, lit.clamp(0.0, 1.0)));
                }
            }
        }
        let lean = 0.5 + 0.05 * ((p.1 - heart.1) * 2.4).sin();
        if p.1 > heart.1 && (p.0 - lean).abs() < 0.014 + 0.012 * p.1 {
            let ring = if (py / 3) % 2 == 0 { 1.0 } else { 0.8 };
            return solid([96.0 * ring, 84.0 * ring, 64.0 * ring]);
        }
        NONE
    })
}

fn pylon() -> Texture {
    Texture::paint(64, 128, |px, py| {
        let p = ((px as f32 + 0.5) / 64.0, (py as f32 + 0.5) / 128.0);
        let half = |y: f32| mix(0.05, 0.22, step(0.15, 1.0, y) * y);
        let mut d = f32::MAX;
        for k in 0..8 {
            let (y0, y1) = (k as f32 / 8.0, (k + 1) as f32 / 8.0);
            let (a, b) = (half(y0), half(y1));
            for (q, r) in [(-a, -b), (a, b), (-a, b), (a, -b)] {
                d = d.min(off((p.0, p.1 * 2.0), (0.5 + q, y0 * 2.0), (0.5 + r, y1 * 2.0)));
            }
        }
        for (y, long) in [(0.12, 0.46), (0.24, 0.36)] {
            d = d.min(off((p.0, p.1 * 2.0), (0.5 - long, y * 2.0), (0.5 + long, y * 2.0)));
        }
        if d < 0.016 { solid([70.0, 88.0, 116.0]) } else { NONE }
    })
}

fn post() -> Texture {
    Texture::paint(16, 64, |px, py| {
        let board = py < 8;
        match (px, py) {
            _ if board && (3..5).contains(&py) => solid([204.0, 196.0, 190.0]),
            _ if board => solid([176.0, 78.0, 78.0]),
            (2..5, _) => solid([196.0, 194.0, 192.0]),
            (11..14, _) => solid([150.0, 150.0, 150.0]),
            _ => NONE,
        }
    })
}

fn lamp() -> Texture {
    Texture::paint(64, 128, |px, py| {
        let p = ((px as f32 + 0.5) / 64.0, (py as f32 + 0.5) / 128.0);
        if off((p.0, p.1 * 2.0), (0.62, 0.08), (0.16, 0.02)) < 0.022 {
            return solid([120.0, 126.0, 136.0]);
        }
        if (p.0 - 0.62).abs() < 0.028 && p.1 > 0.03 { solid([74.0, 78.0, 88.0]) } else { NONE }
    })
}

fn chevron() -> Texture {
    Texture::paint(32, 64, |px, py| {
        if py < 28 {
            let (x, y) = (px as f32, (py as f32 - 13.5).abs());
            let arrow = (9.0..15.0).contains(&(x - 18.0 + y + 12.0)) && (3..25).contains(&py);
            return solid(if arrow { [178.0, 160.0, 84.0] } else { [48.0, 50.0, 54.0] });
        }
        if (14..18).contains(&px) { solid([72.0, 74.0, 78.0]) } else { NONE }
    })
}

/// A sign from behind: a dark panel on two posts.
fn sign() -> Texture {
    Texture::paint(32, 64, |px, py| match (px, py) {
        (3..29, 4..7) => solid([96.0, 102.0, 112.0]),
        (_, 0..21) => solid([40.0, 45.0, 58.0]),
        (7..10 | 22..25, _) => solid([46.0, 52.0, 66.0]),
        _ => NONE,
    })
}
