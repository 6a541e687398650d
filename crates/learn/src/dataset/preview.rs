//! A preview: what augmentation does to pictures and labels.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{
    Augmentation, AugmentationDraw, DatasetError, Source,
    sheet::{ACROSS, GAP, PICTURE, arrow, fitted},
    strip::Strip,
};
use lapwing_core::perception::{Frame, decode_jpeg};
use lapwing_score::drawing::{LINE_PX, MARGIN, Shape, Sheet};

/// A sheet with a line for the pictures as recorded, one for each of the five changes alone, and one for all together,
/// each drawn anew with its probability. The arrow shows the label as corrected by the change. Here the whole picture
/// is changed; in training, only the network's input. Older pictures ([`Augmentation::late`]) are not shown.
///
/// # Errors
/// [`DatasetError::Picture`], [`DatasetError::Image`] if one of the pictures shown is missing or broken.
pub fn preview(source: &Source, augmentation: &Augmentation, seed: u64) -> Result<Sheet, DatasetError> {
    let pictures = pictures(source)?;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut shapes = Vec::new();
    let mut y = MARGIN;
    let lines = std::iter::once("as recorded").chain(Augmentation::NAMES).chain(["all together"]);
    for line in lines {
        let only = match line {
            "as recorded" => Augmentation::none(),
            "all together" => augmentation.clone(),
            name => alone(augmentation, name),
        };
        shapes.push(Shape::Text { at: (MARGIN, y + LINE_PX / 2.0), text: line.into() });
        y += 1.2 * LINE_PX;
        for (i, (frame, steering)) in pictures.iter().enumerate() {
            let change = only.draw(&mut random);
            let changed = changed(frame, &change);
            let steering = change.steering(*steering, 1.0);
            let left = MARGIN + (PICTURE.0 as f64 + GAP) * i as f64;
            let (wide, high) = (PICTURE.0 as f64, PICTURE.1 as f64);
            shapes.push(Shape::Picture { at: (left, y), frame: fitted(changed) });
            arrow((left + wide / 2.0, y + high - 10.0), steering, &mut shapes);
            shapes.push(Shape::Text { at: (left, y + high + LINE_PX / 2.0), text: format!("steering {steering:+.3}") });
        }
        y += PICTURE.1 as f64 + LINE_PX + GAP;
    }
    let width = 2.0 * MARGIN + (PICTURE.0 as f64 + GAP) * ACROSS as f64 - GAP;
    Ok(Sheet { width, height: (y + MARGIN - GAP).ceil(), title: "Augmentation".into(), shapes })
}

/// The whole picture, changed as it was recorded.
pub(super) fn changed(frame: &Frame, change: &AugmentationDraw) -> Frame {
    let strip = Strip::whole(frame);
    let mut out = frame.clone();
    let width = frame.width() * 3;
    change.apply(&strip, &mut Default::default(), |y, rgb| {
        for (channel, row) in rgb.into_iter().enumerate() {
            let to = out.rgb_mut()[y * width..][..width].iter_mut().skip(channel).step_by(3);
            to.zip(row).for_each(|(to, from)| *to = from.round() as u8);
        }
    });
    out
}

/// Only this change, always applied.
fn alone(augmentation: &Augmentation, name: &str) -> Augmentation {
    let none = Augmentation::none();
    let mut only = Augmentation {
        flip: none.flip,
        translate: none.translate,
        brightness: none.brightness,
        shadow: none.shadow,
        erase: none.erase,
        ..augmentation.clone()
    };
    if let Some(probability) = only.probability(name) {
        *probability = 1.0;
    }
    only
}

/// Pictures of the centre camera at equal distances, with their labels.
fn pictures(source: &Source) -> Result<Vec<(Frame, f64)>, DatasetError> {
    let count = ACROSS.min(source.rows.len());
    let row = |i: usize| (2 * i + 1) * source.rows.len() / (2 * count);
    let mut all = Vec::new();
    for row in (0..count).map(row).map(|row| &source.rows[row]) {
        let Some(picture) = &row.pictures[0] else { continue };
        let mut frame = Frame::default();
        decode_jpeg(&super::read(picture)?, &mut frame)
            .map_err(|why| DatasetError::Image { picture: picture.to_string(), why })?;
        all.push((frame, row.steering.get()));
    }
    Ok(all)
}
