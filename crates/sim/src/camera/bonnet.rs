//! The car's own bonnet at the bottom of the picture, as the stock cameras see it.
//!
//! Outlines were read off the medians over all frames of `recordings/lake`,
//! for each of the three cameras, at 320x160.

use super::{Camera, look::ThemeLook, noise::mix3};

/// Corners of an outline: column and row at 320x160.
type BonnetOutline = &'static [(f32, f32)];

const CENTER: BonnetOutline = &[
    (35.0, 160.0),
    (46.0, 155.5),
    (72.0, 150.0),
    (106.0, 144.0),
    (112.0, 141.5),
    (120.0, 139.5),
    (134.0, 137.3),
    (150.0, 136.6),
    (168.0, 136.8),
    (182.0, 138.3),
    (194.0, 140.8),
    (206.0, 144.2),
    (226.0, 149.0),
    (246.0, 154.0),
    (265.0, 160.0),
];
/// Where the bonnet ends towards the windscreen.
const GLASS: BonnetOutline = &[
    (90.0, 160.0),
    (104.0, 156.6),
    (120.0, 153.4),
    (138.0, 151.2),
    (156.0, 150.8),
    (176.0, 151.6),
    (194.0, 154.0),
    (206.0, 157.0),
    (217.0, 160.0),
];
const LEFT: BonnetOutline = &[
    (185.0, 160.0),
    (187.0, 155.5),
    (192.0, 150.6),
    (199.0, 146.6),
    (208.0, 143.8),
    (222.0, 142.8),
    (234.0, 141.2),
    (248.0, 139.6),
    (262.0, 138.2),
    (276.0, 137.2),
    (296.0, 137.2),
    (320.0, 139.4),
];
const RIGHT: BonnetOutline = &[
    (0.0, 135.2),
    (34.0, 135.4),
    (48.0, 137.2),
    (64.0, 139.4),
    (80.0, 141.6),
    (94.0, 143.2),
    (108.0, 146.6),
    (116.0, 150.4),
    (121.0, 155.0),
    (123.5, 160.0),
];

/// A camera further from the car's middle than this, in metres, is one of the side cameras.
const ASIDE_M: f64 = 0.4;

/// The row of an outline at a column; below the picture beyond its ends.
fn row(outline: BonnetOutline, column: f32) -> f32 {
    for pair in outline.windows(2) {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        if (x0..x1).contains(&column) {
            return y0 + (y1 - y0) * (column - x0) / (x1 - x0);
        }
    }
    200.0
}

/// The first row that the bonnet covers at a column of a stock camera's picture, both counted from the picture's
/// corner at 320x160; beyond the picture where it covers none.
pub fn bonnet_row(camera: &Camera, column: f32) -> f32 {
    let side = camera.mount.position.x;
    let outline = match () {
        () if side.abs() < ASIDE_M => CENTER,
        () if side < 0.0 => LEFT,
        () => RIGHT,
    };
    row(outline, column)
}

/// The pixels that the bonnet covers, painted once.
#[derive(Debug, Default)]
pub(super) struct Bonnet {
    spans: Vec<(usize, Vec<u8>)>,
}

impl Bonnet {
    /// The bonnet as a camera sees it.
    pub(super) fn new(camera: &Camera, look: &ThemeLook) -> Self {
        let (width, height) = (camera.lens.width, camera.lens.height);
        let side = camera.mount.position.x;
        let mut spans = Vec::new();
        for y in height / 2..height {
            let mut span: Option<(usize, Vec<u8>)> = None;
            for x in 0..width {
                let at = ((x as f32 + 0.5) * 320.0 / width as f32, (y as f32 + 0.5) * 160.0 / height as f32);
                let colour = if side.abs() < ASIDE_M { center(at, look) } else { aside(at, side < 0.0, look) };
                match colour {
                    Some(colour) => {
                        let (_, pixels) = span.get_or_insert_with(|| ((y * width + x) * 3, Vec::new()));
                        pixels.extend(colour.map(|c| c.clamp(0.0, 255.0) as u8));
                    }
                    None => spans.extend(span.take()),
                }
            }
            spans.extend(span);
        }
        Self { spans }
    }

    /// Lays it over a picture, and its nearness over the depths.
    pub(super) fn draw(&self, rgb: &mut [u8], depth: &mut [f32]) {
        for (start, pixels) in &self.spans {
            if let Some(depth) = depth.get_mut(start / 3..(start + pixels.len()) / 3) {
                depth.fill(1.0);
            }
            if let Some(out) = rgb.get_mut(*start..*start + pixels.len()) {
                out.copy_from_slice(pixels);
            }
        }
    }
}

fn center((x, y): (f32, f32), look: &ThemeLook) -> Option<[f32; 3]> {
    let (edge, glass) = (row(CENTER, x), row(GLASS, x));
    if y < edge {
        return None;
    }
    let [bright, dark, gap, pale] = look.bonnet;
    if y < glass - 1.0 {
        let t = ((y - edge) / (glass.min(161.0) - edge).max(1.0)).clamp(0.0, 1.0);
        let spot = (x as i32) % 3 == 0;
        return Some(match () {
            // The edge of its right flank is dark, and gleams elsewhere, in spots.
            () if y - edge < 1.0 && x > 222.0 => dark.map(|c| c * if spot { 1.0 } else { 0.2 }),
            () if y - edge < 1.0 && spot => bright.map(|c| c * 1.25),
            () => mix3(bright, dark, t),
        });
    }
    let wiper = (x - 122.0).abs() < 2.0 && y > 156.5;
    Some(match () {
        () if y - glass < 1.6 => gap,
        () if wiper => dark.map(|c| c * 0.4),
        () => pale.map(|c| c + (y - 155.0)),
    })
}

fn aside((x, y): (f32, f32), left: bool, look: &ThemeLook) -> Option<[f32; 3]> {
    let edge = row(if left { LEFT } else { RIGHT }, x);
    if y < edge {
        return None;
    }
    let [bright, dark, _, pale] = look.bonnet;
    // From the car's flank, with the headlight, to its middle.
    let inward = if left { x - 186.0 } else { 123.0 - x };
    let lamp = (inward - 26.0).powi(2) / 210.0 + (y - edge - 4.0).powi(2) / 22.0 < 1.0;
    let seam = (inward - (42.0 + (y - 142.0) * 1.9)).abs() < 0.9;
    Some(match () {
        () if lamp && y - edge > 6.0 => pale.map(|c| c * 0.7),
        () if lamp => [246.0, 246.0, 240.0],
        () if seam => dark.map(|c| c * 0.35),
        () if inward < 14.0 => mix3(pale, dark, inward / 22.0),
        () => mix3(dark, bright, (inward / 110.0).clamp(0.0, 1.0) * (1.0 - (y - edge) / 34.0)),
    })
}
