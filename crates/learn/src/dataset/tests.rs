//! From a folder to batches.

use std::{fs, path::Path, sync::Arc};

use super::{
    strip::{Strip, StripCut},
    *,
};
use lapwing_core::{
    perception::{ColourSpace, Crop, Frame, PixelScale, Preprocess, Preprocessor, Resize, ResizeFilter, decode_jpeg},
    recording::Picture,
};

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
    let resize = Resize { height: 4, width: 8, filter: ResizeFilter::BilinearAntialiased };
    let crop = Some(Crop::rows(4, 12));
    Inputs::plain(Preprocess::of(crop, resize, ColourSpace::Grey, PixelScale::Unit), frames)
}

fn open(dir: &Path, set: Set, balance: Balance) -> Samples {
    Samples::open(&[Selection::of(dir)], set, Some(Blocks { size: 2, every: 5 }), &balance).unwrap()
}

fn batches(
    samples: &Arc<Samples>,
    frames: usize,
    augmentation: &Augmentation,
    workers: Workers,
    bytes: usize,
) -> Vec<Batch> {
    let order = samples.draw(samples.samples.len(), 3, 0);
    let cache = Cache::new(samples, bytes);
    Loader::start(Arc::clone(samples), cache, inputs(frames), augmentation.clone(), order, 4, (3, 0, 0), workers)
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap()
}

fn numbers(batch: &Batch) -> Vec<f32> {
    match &*batch.frames {
        Numbers::F32(all) => all.clone(),
        Numbers::Bf16(all) => all.iter().map(|x| x.to_f32()).collect(),
    }
}

#[test]
fn training_has_the_side_cameras_with_their_offset_and_validation_the_held_out_centre() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |row| row as f64 / 100.0, 20);
    let training = open(dir.path(), Set::Training, Balance::default());
    assert_eq!(training.samples.len(), 16 * 3);
    let of_row_2: Vec<_> = training.samples.iter().filter(|s| s.row == 2).map(|s| (s.camera, s.steering)).collect();
    assert_eq!(
        of_row_2,
        [(CameraPosition::Center, 0.02), (CameraPosition::Left, 0.27), (CameraPosition::Right, -0.23)]
    );
    let validation = open(dir.path(), Set::Validation, Balance::default());
    assert_eq!(validation.samples.iter().map(|s| s.row).collect::<Vec<_>>(), [0, 1, 10, 11]);
    assert!(validation.samples.iter().all(|s| s.camera == CameraPosition::Center));
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
fn pictures_of_a_road_with_lanes_are_not_mirrored() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.5, 10);
    let always = Augmentation { flip: 1.0, ..Augmentation::none() };
    for (flip, expected) in [(true, -0.5), (false, 0.5)] {
        let selection = Selection { flip, cameras: vec![CameraPosition::Center], ..Selection::of(dir.path()) };
        let samples = Arc::new(Samples::open(&[selection], Set::Training, None, &Balance::default()).unwrap());
        let steering =
            batches(&samples, 1, &always, Workers::all(true), 0).into_iter().flat_map(|batch| batch.steering);
        assert!(steering.into_iter().all(|steering| steering == expected), "{flip}");
    }
}

#[test]
fn batches_are_the_same_for_any_number_of_threads_and_with_or_without_a_cache() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |row| row as f64 / 100.0, 20);
    let samples = Arc::new(open(dir.path(), Set::Training, Balance::default()));
    let all = |threads, bytes| -> Vec<(Vec<f32>, Vec<f32>)> {
        let workers = Workers { threads, beside: bytes > 1000 };
        let batches = batches(&samples, 1, &Augmentation::default(), workers, bytes);
        batches.into_iter().map(|batch| (numbers(&batch), batch.steering)).collect()
    };
    let one = all(1, 0);
    assert_eq!((one.len(), one[0].0.len()), (12, 4 * 4 * 8));
    assert!(one == all(3, 0));
    assert!(one == all(2, 1 << 20));
    assert!(one == all(2, 16 * 8 * 3 * 5), "room for some pictures");
}

/// A picture of 32x16 pixels with some content.
fn gradient(dir: &Path) -> Frame {
    let pixels: Vec<u8> =
        (0..16u8).flat_map(|y| (0..32u8).flat_map(move |x| [x * 8, y * 15, 128 + x * y / 8])).collect();
    let mut jpeg = vec![];
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 95)
        .encode(&pixels, 32, 16, image::ExtendedColorType::Rgb8)
        .unwrap();
    fs::write(dir.join("IMG/center_3.jpg"), &jpeg).unwrap();
    let mut frame = Frame::default();
    decode_jpeg(&jpeg, &mut frame).unwrap();
    frame
}

/// The numbers of row 3 alone.
fn row_3(dir: &Path, inputs: &Inputs, augmentation: &Augmentation) -> Batch {
    let samples = Arc::new(open(dir, Set::All, Balance::default()));
    let cache = Cache::new(&samples, 1 << 20);
    Loader::start(samples, cache, inputs.clone(), augmentation.clone(), vec![3], 1, (0, 0, 0), Workers::all(false))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
}

#[test]
fn unchanged_pictures_are_to_the_bit_what_a_pilot_sees_in_every_layout() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 20);
    let frame = gradient(dir.path());
    let unmoved = Augmentation { translate: 1.0, translate_x_px: 0, translate_y_px: 0, ..Augmentation::none() };
    for (colour, channels) in [(ColourSpace::Yuv, 3), (ColourSpace::Grey, 1)] {
        let mut plain = inputs(1);
        plain.preprocess.colour = colour;
        let mut seen = vec![];
        Preprocessor::new(plain.preprocess.clone()).unwrap().apply(&frame, &mut seen).unwrap();
        for augmentation in [Augmentation::none(), unmoved.clone()] {
            assert_eq!(numbers(&row_3(dir.path(), &plain, &augmentation)), seen);
        }
        let last = Inputs { channels_last: true, ..plain.clone() };
        let by_pixel: Vec<f32> =
            (0..32).flat_map(|i| (0..channels).map(move |c| (c, i))).map(|(c, i)| seen[c * 32 + i]).collect();
        assert_eq!(numbers(&row_3(dir.path(), &last, &Augmentation::none())), by_pixel);
        let short = Inputs { bf16: true, ..plain };
        let rounded: Vec<f32> = seen.iter().map(|x| half::bf16::from_f32(*x).to_f32()).collect();
        assert_eq!(numbers(&row_3(dir.path(), &short, &Augmentation::none())), rounded);
    }
}

#[test]
fn the_memory_of_a_batch_that_is_used_up_is_the_next_ones() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |row| row as f64 / 100.0, 20);
    let samples = Arc::new(open(dir.path(), Set::All, Balance::default()));
    let cache = Cache::new(&samples, 0);
    let place = |batch: &Batch| match &*batch.frames {
        Numbers::F32(all) => all.as_ptr() as usize,
        Numbers::Bf16(_) => unreachable!(),
    };
    let alone = Workers { threads: 1, beside: false };
    let start = |order: Vec<u32>| {
        let (samples, cache) = (Arc::clone(&samples), Arc::clone(&cache));
        Loader::start(samples, cache, inputs(1), Augmentation::none(), order, 4, (0, 0, 0), alone).unwrap()
    };
    let first = start(vec![1, 2, 3, 4]).next().unwrap().unwrap();
    let (at, numbers_of_first) = (place(&first), numbers(&first));
    drop(first);
    let second = start(vec![5, 6]).next().unwrap().unwrap();
    assert_eq!((place(&second), numbers(&second).len()), (at, 2 * 32), "smaller, in the same place");
    drop(second);
    let again = start(vec![1, 2, 3, 4]).next().unwrap().unwrap();
    assert_eq!(numbers(&again), numbers_of_first, "nothing is left of what was there");
}

#[test]
fn rows_beyond_the_crop_come_in_at_the_networks_scale() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 20);
    let frame = gradient(dir.path());
    // Rows 4 to 11 become four: half as high. Two more above them, two below.
    let preprocess = inputs(1).preprocess;
    let mut preprocessor = Preprocessor::new(preprocess.clone()).unwrap();
    let strip = Strip::cut(&StripCut { preprocess, reach_px: 20 }, &mut preprocessor, &frame).unwrap();
    assert_eq!((strip.height(), strip.scale(), strip.bytes()), (4, (4.0, 2.0), 8 * 8 * 3));
    let green = |row| i32::from(strip.row(1, row)[4]);
    for row in -2..6 {
        let expected = 15 * (4 + 2 * row) + 7; // between two recorded rows
        assert!((green(row) - expected as i32).abs() <= 6, "row {row}: {} {expected}", green(row));
    }
    assert_eq!((green(-3), green(9)), (green(-2), green(5)));
}

#[test]
fn a_sequence_ends_with_its_row_and_begins_anew_with_each_drive() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 20);
    let samples = Arc::new(open(dir.path(), Set::Validation, Balance::default()));
    let batch = &batches(&samples, 3, &Augmentation::none(), Workers { threads: 1, beside: true }, 0)[0];
    for (i, sample) in batch.samples.iter().enumerate() {
        let row = f32::from(samples.samples[*sample as usize].row as u16);
        let grey: Vec<f32> = numbers(batch)[i * 96..(i + 1) * 96].chunks(32).map(|frame| frame[0] * 255.0).collect();
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
    let samples = Arc::new(open(dir.path(), Set::Training, Balance::default()));
    fs::write(dir.path().join("IMG/center_3.jpg"), b"no picture").unwrap();
    let order = (0..48).collect();
    let cache = Cache::new(&samples, 0);
    let loader =
        Loader::start(samples, cache, inputs(1), Augmentation::none(), order, 48, (0, 0, 0), Workers::all(true))
            .unwrap();
    let error = loader.collect::<Result<Vec<_>, _>>().unwrap_err().to_string();
    assert!(error.contains("center_3.jpg") && error.contains("dataset inspect"), "{error}");
}

#[test]
fn a_thread_that_panics_is_an_error_and_a_loader_that_is_dropped_lets_go_of_all() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 20);
    for beside in [true, false] {
        let samples = Arc::new(open(dir.path(), Set::All, Balance::default()));
        let start = |order| {
            let (samples, cache) = (Arc::clone(&samples), Cache::new(&samples, 0));
            Loader::start(samples, cache, inputs(1), Augmentation::none(), order, 2, (0, 0, 0), Workers::all(beside))
                .unwrap()
        };
        let outcome: Vec<_> = start(vec![0, 1, 2, 9999, 4, 5]).collect();
        let failed: Vec<bool> = outcome.iter().map(|batch| matches!(batch, Err(DatasetError::Thread { .. }))).collect();
        assert_eq!(failed, [false, true, false], "no such sample");
        drop(start((0..20).collect()));
        let held = Arc::downgrade(&samples);
        drop(samples);
        // The threads end once they have finished their current batches.
        let ended = (0..500).any(|_| {
            std::thread::sleep(std::time::Duration::from_millis(10));
            held.upgrade().is_none()
        });
        assert!(ended);
    }
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
    assert_eq!(error.to_string(), format!("{}: smooth: expected an odd number of rows, got 4", dir.path().display()));
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

#[cfg(unix)]
#[test]
fn a_picture_that_is_a_pipe_a_device_a_folder_or_endless_is_a_problem_in_words_and_nobody_waits() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), |_| 0.0, 20);
    let mut names: Vec<_> = fs::read_dir(dir.path().join("IMG")).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.sort();
    let [pipe, device, directory, endless, ..] = &names[..] else { panic!("{names:?}") };
    for path in [pipe, device, directory, endless] {
        fs::remove_file(path).unwrap();
    }
    assert!(std::process::Command::new("mkfifo").arg(pipe).status().unwrap().success());
    std::os::unix::fs::symlink("/dev/zero", device).unwrap();
    fs::create_dir(directory).unwrap();
    fs::File::create(endless).unwrap().set_len(1 << 40).unwrap();
    let inspection = inspect(dir.path(), &mut |_, _| {}).unwrap();
    let words: Vec<_> = inspection.problems.iter().map(|problem| problem.why.as_str()).collect();
    assert_eq!(
        words,
        [
            "expected a picture, got a device or a pipe",
            "expected a picture, got a device or a pipe",
            "expected a picture, got a folder",
            "expected a picture of at most 16777216 bytes, got 1099511627776",
        ]
    );
    for path in [pipe, device, directory, endless] {
        let error = read(&Picture::File(path.clone())).unwrap_err().to_string();
        assert!(error.contains(" cannot be read: expected a picture"), "{error}");
    }
}
