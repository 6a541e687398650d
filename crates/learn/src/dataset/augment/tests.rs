use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::dataset::strip::StripCut;
use lapwing_core::perception::{ColourSpace, Crop, Frame, PixelScale, Preprocess, Preprocessor, Resize, ResizeFilter};

/// A picture whose red channel is the column and whose green one is the row.
fn map() -> Frame {
    let pixels = (0..20u8).flat_map(|y| (0..40u8).flat_map(move |x| [x, y, 100])).collect();
    Frame::new(40, 20, pixels).unwrap()
}

/// Rows 5 to 14 of it at their own size, with those that a shift of 8 pixels needs.
fn changed(change: &AugmentationDraw) -> Frame {
    let resize = Resize { height: 10, width: 40, filter: ResizeFilter::BilinearAntialiased };
    let crop = Some(Crop::rows(5, 15));
    let preprocess = Preprocess::of(crop, resize, ColourSpace::Rgb, PixelScale::Unit);
    let mut preprocessor = Preprocessor::new(preprocess.clone()).unwrap();
    let strip = Strip::cut(&StripCut { preprocess, reach_px: 8 }, &mut preprocessor, &map()).unwrap();
    let mut rgb = vec![0; 40 * 10 * 3];
    change.apply(&strip, &mut Default::default(), |y, channels| {
        for (x, pixel) in rgb[y * 120..(y + 1) * 120].chunks_exact_mut(3).enumerate() {
            pixel.copy_from_slice(&channels.map(|channel| channel[x].round() as u8));
        }
    });
    Frame::new(40, 10, rgb).unwrap()
}

#[test]
fn a_mirrored_picture_is_steered_the_other_way() {
    let change = AugmentationDraw { flip: true, ..AugmentationDraw::none() };
    assert_eq!(changed(&change).pixel(0, 0), Some([39, 5, 100]));
    assert_eq!(change.steering(0.25, 1.0), -0.25);
}

#[test]
fn a_shifted_picture_repeats_its_border_and_never_wraps() {
    let change = AugmentationDraw { shift: (10, -8), steering_per_px: 0.003, ..AugmentationDraw::none() };
    let out = changed(&change);
    assert_eq!(out.pixel(15, 0), Some([5, 13, 100]));
    assert_eq!(out.pixel(3, 1), Some([0, 14, 100]));
    assert_eq!(out.pixel(39, 9), Some([29, 19, 100]), "rows from below the crop, then the last again");
    assert!((change.steering(0.1, 1.0) - 0.13).abs() < 1e-12);
    // With pixels 8 recorded ones wide it moves by one: the label follows the visible shift.
    assert!((change.steering(0.1, 8.0) - 0.124).abs() < 1e-12);
    for (right, flip, expected) in [(-3, false, [3, 39]), (3, true, [39, 3]), (-3, true, [36, 0]), (90, false, [0, 0])]
    {
        let out = changed(&AugmentationDraw { flip, shift: (right, 0), ..AugmentationDraw::none() });
        assert_eq!([0, 39].map(|x| out.pixel(x, 0).unwrap()[0]), expected, "{right} {flip}");
    }
}

#[test]
fn brightness_and_shadow_are_factors_that_end_at_white() {
    let shadow = Shadow { top: [0.0, 0.5], bottom: [0.0, 0.5], factor: 0.6 };
    let out = changed(&AugmentationDraw { brightness: 1.5, shadow: Some(shadow), ..AugmentationDraw::none() });
    assert_eq!(out.pixel(30, 0), Some([45, 8, 150]));
    assert_eq!(out.pixel(10, 0), Some([9, 5, 90]));
    let white = changed(&AugmentationDraw { brightness: 3.0, ..AugmentationDraw::none() });
    assert_eq!(white.pixel(39, 0), Some([117, 15, 255]));
}

#[test]
fn an_erased_rectangle_has_its_share_of_what_the_network_sees() {
    let gone = Rectangle { area: 0.25, ratio: 0.5, at: (1.0, 0.0), value: 7 };
    let out = changed(&AugmentationDraw { erase: Some(gone), ..AugmentationDraw::none() });
    let erased = out.rgb().chunks(3).filter(|pixel| **pixel == [7, 7, 7]).count();
    assert!((95..=105).contains(&erased), "{erased}");
    assert_eq!(out.pixel(39, 0), Some([7, 7, 7]));
}

#[test]
fn draws_stay_in_their_ranges_and_come_as_often_as_asked() {
    let augmentation = Augmentation::default();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let draws: Vec<AugmentationDraw> = (0..4000).map(|_| augmentation.draw(&mut random)).collect();
    let share = |f: &dyn Fn(&AugmentationDraw) -> bool| draws.iter().filter(|c| f(c)).count() as f64 / 4000.0;
    for (name, share) in [
        ("flip", share(&|c| c.flip)),
        ("shift", share(&|c| c.shift != (0, 0))),
        ("brightness", share(&|c| c.brightness != 1.0)),
        ("shadow", share(&|c| c.shadow.is_some())),
        ("erase", share(&|c| c.erase.is_some())),
    ] {
        assert!((share - 0.5).abs() < 0.04, "{name}: {share}");
    }
    assert!(draws.iter().all(|c| c.shift.0.abs() <= 60 && c.shift.1.abs() <= 20));
    assert!(draws.iter().any(|c| c.shift.0 < -55) && draws.iter().any(|c| c.shift.0 > 55));
    assert!(draws.iter().all(|c| (0.3..=1.6).contains(&c.brightness)));
    let areas = || draws.iter().filter_map(|c| c.erase);
    assert!(areas().all(|e| (0.02..=0.4).contains(&e.area) && (0.5..=2.5).contains(&e.ratio)));
    assert!(draws.iter().filter_map(|c| c.shadow).all(|s| (0.6..=0.85).contains(&s.factor)));
    let off = Augmentation { flip: 0.0, ..Augmentation::default() };
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for draw in draws {
        assert_eq!(off.draw(&mut random), AugmentationDraw { flip: false, ..draw }, "the others are as they were");
    }
}
