//! Real pictures with the fitted lines drawn into them.

use std::path::Path;

use anyhow::Result;
use image::{Rgb, RgbImage};

use crate::{
    fit::Fit,
    lines::{find, pieces},
    witness::SHOWN_PX,
};

/// Pictures side by side, and how much each is enlarged.
const ACROSS: u32 = 3;
const SCALE: u32 = 2;

/// Writes the pictures with these numbers as a PNG: where a line is expected in magenta, where it was found in green.
pub fn write(fit: &Fit<'_>, numbers: &[usize], path: &Path) -> Result<()> {
    let (wide, high) = (320 * SCALE, 160 * SCALE);
    let mut sheet = RgbImage::new(wide * ACROSS, high * (numbers.len() as u32).div_ceil(ACROSS));
    for (k, &i) in numbers.iter().enumerate() {
        let (left, top) = (k as u32 % ACROSS * wide, k as u32 / ACROSS * high);
        let frame = &fit.drive.frames[i];
        for (y, x) in (0..high).flat_map(|y| (0..wide).map(move |x| (y, x))) {
            let pixel = frame.pixel((x / SCALE) as usize, (y / SCALE) as usize).unwrap_or_default();
            sheet.put_pixel(left + x, top + y, Rgb(pixel));
        }
        let mut dot = |at: glam::DVec2, colour: [u8; 3]| {
            let (x, y) = ((at.x * f64::from(SCALE)) as i64, (at.y * f64::from(SCALE)) as i64);
            for (x, y) in [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)] {
                if (0..i64::from(wide)).contains(&x) && (0..i64::from(high)).contains(&y) {
                    sheet.put_pixel(left + x as u32, top + y as u32, Rgb(colour));
                }
            }
        };
        for piece in pieces(&fit.course, &fit.stands[i], &fit.lines, fit.far_m) {
            dot(piece.at, [255, 0, 255]);
            if let Some((d, _)) = find(frame, &piece, SHOWN_PX) {
                dot(piece.at + piece.across * d, [0, 255, 0]);
            }
        }
    }
    sheet.save(path)?;
    Ok(())
}
