//! The pictures that are written: real and drawn side by side, and a map of what the network tells them apart by.

use std::path::Path;

use anyhow::Result;
use image::{Rgb, RgbImage};

use crate::{
    judge::{STRIDE, Verdict, WINDOWS},
    pairs::Pair,
};

/// Pairs on the sheet, and how many of them are in a row.
const SHOWN: usize = 16;
const ACROSS: u32 = 2;
/// Pixels between pictures.
const GAP: u32 = 4;

/// Writes pairs from all along the road, in its order, each real on the left and drawn on the right, and prints where they
/// are.
pub fn side_by_side(pairs: &[Pair], path: &Path) -> Result<()> {
    let mut along: Vec<&Pair> = pairs.iter().collect();
    along.sort_by(|a, b| a.place_m.total_cmp(&b.place_m));
    let every = (along.len() / SHOWN).max(1);
    let shown: Vec<&Pair> = along.into_iter().skip(every / 2).step_by(every).take(SHOWN).collect();
    let (wide, high) = (320 + GAP, 160 + GAP);
    let mut sheet =
        RgbImage::from_pixel(wide * 2 * ACROSS, high * (shown.len() as u32).div_ceil(ACROSS), Rgb([255, 255, 255]));
    for (i, pair) in (0..).zip(&shown) {
        for (kind, frame) in (0..).zip(&pair.frames) {
            let (left, top) = ((i % ACROSS * 2 + kind) * wide, i / ACROSS * high);
            for (x, y) in (0..160).flat_map(|y| (0..320).map(move |x| (x, y))) {
                let pixel = frame.pixel(x as usize, y as usize).unwrap_or_default();
                sheet.put_pixel(left + x, top + y, Rgb(pixel));
            }
        }
    }
    sheet.save(path)?;
    let places: Vec<String> = shown.iter().map(|pair| format!("{:.0} m (row {})", pair.place_m, pair.moment)).collect();
    println!("{}: real left, drawn right, line by line: {}", path.display(), places.join(", "));
    Ok(())
}

/// Draws how often each window was right, on held-out places: black for guessing, yellow for always.
pub fn tells(verdict: &Verdict, path: &Path) -> Result<()> {
    let stride = STRIDE as u32;
    let map = RgbImage::from_fn(WINDOWS.0 as u32 * stride, WINDOWS.1 as u32 * stride, |x, y| {
        let share = verdict.map[(y / stride) as usize * WINDOWS.0 + (x / stride) as usize];
        let t = ((share - 0.5) * 2.0).clamp(0.0, 1.0);
        Rgb([255.0 * t.min(0.5) * 2.0, 255.0 * (t - 0.5).max(0.0) * 2.0, 60.0 * (1.0 - t)].map(|c| c as u8))
    });
    map.save(path)?;
    println!("{}: how often each window is told, black for one in two, red for 3 in 4, yellow for all", path.display());
    Ok(())
}
