//! The contact sheet: real pictures on the left, rendered ones on the right.

use std::{error::Error, path::Path};

use image::{Rgb, RgbImage};
use lapwing_core::perception::Frame;
use lapwing_tools::survey::Edges;

use crate::compare::ROWS;

/// One place, seen twice.
pub struct Tile {
    /// Where it is.
    pub text: String,
    /// Real and rendered.
    pub frames: [Frame; 2],
    /// The edges found in them, by row.
    pub edges: [Vec<Edges>; 2],
}

/// Pairs in a row of the sheet.
const ACROSS: u32 = 2;
/// Pixels between pictures.
const GAP: u32 = 4;

/// Writes the sheet as a PNG and prints to stdout what is where.
pub fn write(places: &[Tile], path: &Path) -> Result<(), Box<dyn Error>> {
    let (wide, high) = (320 + GAP, 160 + GAP);
    let down = (places.len() as u32).div_ceil(ACROSS);
    let mut sheet = RgbImage::from_pixel(wide * 2 * ACROSS, high * down, Rgb([255, 255, 255]));
    for (i, place) in places.iter().enumerate() {
        let i = i as u32;
        println!("sheet, line {}, pair {}: {}", i / ACROSS + 1, i % ACROSS + 1, place.text);
        for (which, (frame, edges)) in place.frames.iter().zip(&place.edges).enumerate() {
            let left = ((i % ACROSS) * 2 + which as u32) * wide;
            let top = (i / ACROSS) * high;
            let found: Vec<(usize, usize)> = ROWS
                .iter()
                .zip(edges)
                .flat_map(|(&row, edges)| edges.iter().flatten().map(move |&column| (column as usize, row)))
                .collect();
            for (y, x) in (0..frame.height()).flat_map(|y| (0..frame.width()).map(move |x| (y, x))) {
                let marked = found.iter().any(|&(column, row)| x == column && y.abs_diff(row) <= 4);
                let pixel = if marked { [255, 0, 255] } else { frame.pixel(x, y).unwrap_or_default() };
                sheet.put_pixel(left + x as u32, top + y as u32, Rgb(pixel));
            }
        }
    }
    sheet.save(path)?;
    Ok(())
}
