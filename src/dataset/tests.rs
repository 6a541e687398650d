//! From a folder to batches.

use std::{fs, path::Path, sync::Arc};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::perception::{Colour, Crop, Filter, Frame, Layout, Preprocess, Resize, Scale};

/// A folder of `rows` rows of three cameras, 32x16 pixels, whose brightness is the row's number.
fn folder(dir: &Path, steering: impl Fn(usize) -> f64, rows: usize) {
    fs::create_dir(dir.join("IMG")).unwrap();
    let mut log = String::new();
    for row in 0..rows {
        for camera in ["center", "left", "right"] {
            let name = format!("{camera}_{row}.jpg");
            let pixels = vec![row as u8; 32 * 16 * 3];
            let mut jpeg = vec![];
            image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 95)
                .encode(&pixels, 32, 16, image::ExtendedColorType::Rgb8)
                .unwrap();
            fs::write(dir.join("IMG").join(&name), jpeg).unwrap();
            log += &format!("{name},");
        }
        log += &format!("{},0.5,0,15\n", steering(row));
    }
    fs::write(dir.join("driving_log.csv"), log).unwrap();
}

fn inputs(frames: usize) -> Inputs {
    let resize = Resize { height: 4, width: 8, filter: Filter::BilinearAntialiased };
    let crop = Some(Crop { top: 4, bottom: 12 });
    let preprocess = Preprocess { crop, resize, colour: Colour::Grey, scale: Scale::Unit, layout: Layout::Nchw };
    Inputs { preprocess, frames }
}

fn open(dir: &Path, set: Set, balance: Balance) -> Samples {
    Samples::open(&[Selection::of(dir)], set, Some(Blocks { size: 2, every: 5 }), &balance).unwrap()
}

fn batches(
    samples: &Arc<Samples>,
    frames: usize,
    augmentation: &Augmentation,
    threads: usize,
    bytes: usize,
) -> Vec<Batch> {
    let order = samples.draw(samples.samples.len(), 3, 0);
    let cache = Cache::new(samples, bytes);
    Loader::start(Arc::clone(samples), cache, inputs(frames), augmentation.clone(), order, 4, (3, 0, 0), threads)
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap()
}

#[test]
fn training_has_the_side_cameras_with_their_offset_and_validation_the_held_out_centre() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |row| row as f64 / 100.0, 20);
    let training = open(dir.path(), Set::Training, Balance::default());
    assert_eq!(training.samples.len(), 16 * 3);
    let of_row_2: Vec<_> = training.samples.iter().filter(|s| s.row == 2).map(|s| (s.camera, s.steering)).collect();
    assert_eq!(of_row_2, [(Camera::Center, 0.02), (Camera::Left, 0.27), (Camera::Right, -0.23)]);
    let validation = open(dir.path(), Set::Validation, Balance::default());
    assert_eq!(validation.samples.iter().map(|s| s.row).collect::<Vec<_>>(), [0, 1, 10, 11]);
    assert!(validation.samples.iter().all(|s| s.camera == Camera::Center));
}

#[test]
fn an_epoch_without_balance_has_each_sample_once() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 20);
    let samples = open(dir.path(), Set::Training, Balance::default());
    let mut drawn = samples.draw(48, 1, 0);
    assert_ne!(drawn, (0..48).collect::<Vec<_>>());
    assert_ne!(drawn, samples.draw(48, 1, 1));
    assert_eq!(drawn, samples.draw(48, 1, 0));
    drawn.sort_unstable();
    assert_eq!(drawn, (0..48).collect::<Vec<_>>());
}

#[test]
fn balancing_draws_the_straight_rows_less_and_the_bends_more() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |row| if row % 10 == 5 { 0.5 } else { 0.0 }, 100);
    let share_of_bends = |balance| {
        let samples = open(dir.path(), Set::Training, balance);
        let drawn = samples.draw(10_000, 1, 0);
        let bends = drawn.iter().filter(|i| samples.samples[**i as usize].row % 10 == 5).count();
        bends as f64 / 10_000.0
    };
    let plain = share_of_bends(Balance::default());
    assert!((plain - 0.125).abs() < 0.01, "{plain}");
    // 7 straight rows of weight 0.1 to each bend.
    let kept = share_of_bends(Balance { keep_zero: 0.1, ..Balance::default() });
    assert!((kept - 1.0 / 1.7).abs() < 0.01, "{kept}");
    let flat = share_of_bends(Balance { flatten: 1.0, ..Balance::default() });
    assert!((flat - 0.5).abs() < 0.01, "{flat}");
    let large = share_of_bends(Balance { large_angles: 4.0, ..Balance::default() });
    assert!((large - 3.0 / 10.0).abs() < 0.01, "{large}");
}

#[test]
fn batches_are_the_same_for_any_number_of_threads_and_with_or_without_a_cache() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |row| row as f64 / 100.0, 20);
    let samples = Arc::new(open(dir.path(), Set::Training, Balance::default()));
    let all = |threads, bytes| -> Vec<(Vec<f32>, Vec<f32>)> {
        let batches = batches(&samples, 1, &Augmentation::default(), threads, bytes);
        batches.into_iter().map(|batch| (batch.frames, batch.steering)).collect()
    };
    let one = all(1, 0);
    assert_eq!((one.len(), one[0].0.len()), (12, 4 * 4 * 8));
    assert!(one == all(3, 0));
    assert!(one == all(2, 1 << 20));
    assert!(one == all(2, 32 * 16 * 3 * 5), "room for five pictures");
}

#[test]
fn a_sequence_ends_with_its_row_and_begins_anew_with_each_drive() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 20);
    let samples = Arc::new(open(dir.path(), Set::Validation, Balance::default()));
    let batch = &batches(&samples, 3, &Augmentation::none(), 1, 0)[0];
    for (i, sample) in batch.samples.iter().enumerate() {
        let row = f32::from(samples.samples[*sample as usize].row as u16);
        let grey: Vec<f32> = batch.frames[i * 96..(i + 1) * 96].chunks(32).map(|frame| frame[0] * 255.0).collect();
        let expected = [(row - 2.0).max(0.0), (row - 1.0).max(0.0), row];
        assert!(grey.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1.5), "{grey:?} {expected:?}");
    }
    let mut source = Source::open(dir.path()).unwrap();
    source.rows[8..].iter_mut().for_each(|row| row.drive = 1);
    assert_eq!(source.sequence(9, 5).collect::<Vec<_>>(), [8, 8, 8, 8, 9]);
    assert_eq!(source.sequence(7, 3).collect::<Vec<_>>(), [5, 6, 7]);
}

#[test]
fn a_broken_picture_is_named() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 20);
    fs::write(dir.path().join("IMG/center_3.jpg"), b"no picture").unwrap();
    let samples = Arc::new(open(dir.path(), Set::Training, Balance::default()));
    let order = (0..48).collect();
    let cache = Cache::new(&samples, 0);
    let loader = Loader::start(samples, cache, inputs(1), Augmentation::none(), order, 48, (0, 0, 0), 2).unwrap();
    let error = loader.collect::<Result<Vec<_>, _>>().unwrap_err().to_string();
    assert!(error.contains("center_3.jpg") && error.contains("dataset inspect"), "{error}");
}

#[test]
fn labels_may_be_means_over_neighbours_of_the_same_drive() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |row| if row == 6 { 0.9 } else { 0.0 }, 20);
    let source = Source::open(dir.path()).unwrap();
    assert!((source.mean_steering(8, 9) - 0.1).abs() < 1e-9);
    assert_eq!(source.mean_steering(11, 9), 0.0);
    assert!((source.mean_steering(2, 9) - 0.9 / 7.0).abs() < 1e-9, "cut at the beginning");
}

/// A picture whose red channel is the column and whose green one is the row.
fn map() -> Frame {
    let pixels = (0..20u8).flat_map(|y| (0..40u8).flat_map(move |x| [x, y, 100])).collect();
    Frame::new(40, 20, pixels).unwrap()
}

fn changed(change: &Change) -> Frame {
    let mut out = Frame::default();
    change.apply(&map(), Crop { top: 5, bottom: 15 }, &mut out);
    out
}

#[test]
fn a_mirrored_picture_is_steered_the_other_way() {
    let change = Change { flip: true, ..Change::none() };
    assert_eq!(changed(&change).pixel(0, 0), Some([39, 5, 100]));
    assert_eq!(change.steering(0.25), -0.25);
}

#[test]
fn a_shifted_picture_repeats_its_border_and_never_wraps() {
    let change = Change { shift: (10, -8), steering_per_px: 0.003, ..Change::none() };
    let out = changed(&change);
    assert_eq!(out.pixel(15, 0), Some([5, 13, 100]));
    assert_eq!(out.pixel(3, 1), Some([0, 14, 100]));
    assert_eq!(out.pixel(39, 9), Some([29, 19, 100]), "rows from below the crop, then the last again");
    assert!((change.steering(0.1) - 0.13).abs() < 1e-12);
}

#[test]
fn brightness_and_shadow_are_factors_that_end_at_white() {
    let shadow = Shadow { top: [0.0, 0.5], bottom: [0.0, 0.5], factor: 0.6 };
    let out = changed(&Change { brightness: 1.5, shadow: Some(shadow), ..Change::none() });
    assert_eq!(out.pixel(30, 0), Some([45, 8, 150]));
    assert_eq!(out.pixel(10, 0), Some([9, 5, 90]));
    let white = changed(&Change { brightness: 3.0, ..Change::none() });
    assert_eq!(white.pixel(39, 0), Some([117, 15, 255]));
}

#[test]
fn an_erased_rectangle_has_its_share_of_what_the_network_sees() {
    let gone = Rectangle { area: 0.25, ratio: 0.5, at: (1.0, 0.0), value: 7 };
    let out = changed(&Change { erase: Some(gone), ..Change::none() });
    let erased = out.rgb().chunks(3).filter(|pixel| **pixel == [7, 7, 7]).count();
    assert!((95..=105).contains(&erased), "{erased}");
    assert_eq!(out.pixel(39, 0), Some([7, 7, 7]));
}

#[test]
fn draws_stay_in_their_ranges_and_come_as_often_as_asked() {
    let augmentation = Augmentation::default();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let draws: Vec<Change> = (0..4000).map(|_| augmentation.draw(&mut random)).collect();
    let share = |f: &dyn Fn(&Change) -> bool| draws.iter().filter(|c| f(c)).count() as f64 / 4000.0;
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
        assert_eq!(off.draw(&mut random), Change { flip: false, ..draw }, "the others are as they were");
    }
}

#[test]
fn what_cannot_be_is_named_with_expected_and_got() {
    let error = |augmentation: Augmentation| augmentation.check().unwrap_err().to_string();
    assert_eq!(
        error(Augmentation { flip: 1.5, ..Augmentation::default() }),
        "flip: expected a probability from 0 to 1, got 1.5"
    );
    assert!(error(Augmentation { shadow_range: (0.9, 0.6), ..Augmentation::default() }).contains("got 0.9, 0.6"));
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 5);
    let even = Selection { smooth: 4, ..Selection::of(dir.path()) };
    let error = Samples::open(&[even], Set::All, None, &Balance::default()).unwrap_err();
    assert_eq!(error.to_string(), "smooth: expected an odd number of rows, got 4");
}

#[test]
fn a_preview_has_a_line_for_each_change_with_its_corrected_labels() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.25, 20);
    let svg = preview(&Source::open(dir.path()).unwrap(), &Augmentation::default(), 1).unwrap().svg().unwrap();
    for name in Augmentation::NAMES {
        assert!(svg.contains(&format!(">{name}<")), "{name}");
    }
    assert!(svg.matches("steering +0.250").count() >= 16, "recorded, brighter, in shadow, erased");
    assert!(svg.matches("steering -0.250").count() >= 4, "the mirrored line");
}
