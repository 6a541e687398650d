use std::{fs, path::Path};

use super::*;
use crate::dataset::fixture;
use lapwing_core::{
    recording::CommandRecord,
    units::{Steering, Throttle},
};

/// A folder of this many rows, 67 ms apart by the names of its pictures, all alike; `log` writes the rest of each row.
fn folder(dir: &Path, rows: usize, steering: impl Fn(usize) -> f64) {
    folder_at(dir, (0..rows).map(|row| row * 67), steering);
}

/// The same with rows at these milliseconds of a day's hour.
fn folder_at(dir: &Path, times_ms: impl Iterator<Item = usize>, steering: impl Fn(usize) -> f64) {
    fs::create_dir_all(dir.join("IMG")).unwrap();
    let (mut log, jpeg) = (String::new(), fixture::jpeg(0));
    for (row, ms) in times_ms.enumerate() {
        let time = format!("2024_05_17_12_{:02}_{:02}_{:03}.jpg", ms / 60_000, ms / 1000 % 60, ms % 1000);
        for camera in ["center", "left", "right"] {
            fs::write(dir.join(format!("IMG/{camera}_{time}")), &jpeg).unwrap();
            log += &format!("{camera}_{time},");
        }
        log += &format!("{},0.5,0,15\n", steering(row));
    }
    fs::write(dir.join("driving_log.csv"), log).unwrap();
}

const BLOCKS: Blocks = Blocks { size: 5, every: 2 };

fn open(selection: Selection, set: Set) -> Result<Samples, DatasetError> {
    Samples::open(&[selection], set, Some(BLOCKS), &Balance::default())
}

fn sequence(samples: &Samples, row: usize) -> Vec<usize> {
    samples.sources[0].sequence(row, 5).collect()
}

#[test]
fn neither_labels_nor_sequences_of_training_reach_into_what_is_held_out() {
    let dir = tempfile::tempdir().unwrap();
    // Rows 0 to 4 and 10 to 14 are held out; 5 to 9 are learnt from.
    folder(dir.path(), 20, |row| if (5..10).contains(&row) { 0.5 } else { -1.0 });
    let smooth = |set| open(Selection { smooth: 9, ..Selection::of(dir.path()) }, set).unwrap();
    let training = smooth(Set::Training);
    let center = training.samples.iter().filter(|sample| sample.camera == CameraPosition::Center && sample.row < 10);
    assert!(center.clone().all(|sample| sample.steering == 0.5), "{center:?}");
    assert_eq!(sequence(&training, 6), [5, 5, 5, 5, 6]);
    // Validation sees what a pilot would have seen, and is measured as the reference was.
    let validation = smooth(Set::Validation);
    assert_eq!(sequence(&validation, 11), [7, 8, 9, 10, 11]);
    let first = validation.samples.iter().find(|sample| sample.row == 10).unwrap();
    assert_eq!(first.steering, -1.0);
    assert!((validation.mean_steering(first, 9) - (4.0 * 0.5 - 5.0) / 9.0).abs() < 1e-12);
}

#[test]
fn labels_stay_within_the_rows_that_are_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 20, |row| if row < 8 { 0.5 } else { -1.0 });
    let selection = Selection { smooth: 9, rows: Some((5, 8)), ..Selection::of(dir.path()) };
    let samples = open(selection, Set::Training).unwrap();
    assert!(samples.samples.iter().all(|s| s.camera != CameraPosition::Center || s.steering == 0.5));
}

#[test]
fn where_time_is_missing_or_goes_back_another_drive_begins() {
    let dir = tempfile::tempdir().unwrap();
    // A pause of just over a second; a jump back; one of a minute, during which the log's own time continues as if
    // there were none.
    folder_at(dir.path(), [1000, 1067, 2068, 2135, 500, 567, 60_567, 60_634].into_iter(), |_| 0.0);
    let source = Source::open(dir.path()).unwrap();
    assert_eq!(source.rows.iter().map(|row| row.drive).collect::<Vec<_>>(), [0, 0, 1, 1, 2, 2, 3, 3]);
    assert_eq!(source.sequence(3, 3).collect::<Vec<_>>(), [2, 2, 3]);
}

#[test]
fn a_picture_that_is_not_there_is_no_sample_and_sequences_begin_anew_behind_it() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 20, |_| 0.1);
    let log = Source::open(dir.path()).unwrap();
    let Some(lapwing_core::recording::Picture::File(gone)) = &log.rows[7].pictures[0] else { panic!() };
    fs::remove_file(gone).unwrap();
    let samples = open(Selection::of(dir.path()), Set::Training).unwrap();
    let of_row = |row| samples.samples.iter().filter(|s| s.row == row).map(|s| s.camera).collect::<Vec<_>>();
    assert_eq!(of_row(7), [CameraPosition::Left, CameraPosition::Right]);
    assert_eq!(sequence(&samples, 9), [8, 8, 8, 8, 9]);
    assert_eq!(sequence(&samples, 6), [5, 5, 5, 5, 6]);
    for row in 5..10 {
        for camera in of_row(row) {
            let pictures = |k: usize| &samples.sources[0].rows[k].pictures[camera as usize];
            assert!(sequence(&samples, row as usize).into_iter().all(|k| pictures(k).is_some()), "row {row}");
        }
    }
}

#[test]
fn pictures_that_are_no_jpegs_are_left_out_and_those_of_several_sizes_refused() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 20, |_| 0.1);
    let log = Source::open(dir.path()).unwrap();
    let of_row = |row: usize| match &log.rows[row].pictures[0] {
        Some(lapwing_core::recording::Picture::File(path)) => path.clone(),
        other => panic!("{other:?}"),
    };
    fs::write(of_row(6), "").unwrap();
    fs::write(of_row(7), "\u{89}PNG").unwrap();
    fs::write(of_row(8), &fixture::jpeg(0)[..300]).unwrap();
    let samples = open(Selection::of(dir.path()), Set::Training).unwrap();
    let center = samples.samples.iter().filter(|s| s.camera == CameraPosition::Center && (5..10).contains(&s.row));
    assert_eq!(center.map(|s| s.row).collect::<Vec<_>>(), [5, 9]);
    let found = Source::open(dir.path()).unwrap().forget_unusable(|_, _| true);
    assert_eq!((found.missing, found.broken, found.sizes[&(64, 32)].0), (0, 3, 57));

    let mut other = vec![];
    image::codecs::jpeg::JpegEncoder::new(&mut other)
        .encode(&[0; 32 * 16 * 3], 32, 16, image::ExtendedColorType::Rgb8)
        .unwrap();
    fs::write(of_row(6), other).unwrap();
    let others = Selection { rows: Some((7, 20)), ..Selection::of(dir.path()) };
    assert!(open(others, Set::Training).is_ok(), "what is not selected may have any size");
    let error = open(Selection::of(dir.path()), Set::Training).unwrap_err().to_string();
    assert!(
        error.contains("got 1 picture of 32x16 such as ") && error.contains(", 57 pictures of 64x32 such as "),
        "{error}"
    );
}

#[test]
fn pictures_that_are_both_learnt_from_and_held_out_are_counted_wherever_they_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let (data, run) = (dir.path().join("data"), dir.path().join("run.mcap"));
    fixture::folder(&data, 20, false);
    fixture::converted(&data, &run);
    let shared = |learnt: &[Selection]| {
        let training = Samples::open(learnt, Set::Training, Some(BLOCKS), &Balance::default()).unwrap();
        open(Selection::of(&data), Set::Validation).unwrap().shared_with(&training).map(|(shared, _)| shared)
    };
    assert_eq!(shared(&[Selection::of(&data)]), None);
    // Of a copy that begins with the fourth row, other rows are held out.
    let path = data.join("driving_log.csv");
    let log = fs::read_to_string(&path).unwrap();
    let copy = dir.path().join("copy");
    fs::create_dir(&copy).unwrap();
    let later: String = log.split_inclusive('\n').skip(4).collect();
    fs::write(copy.join("driving_log.csv"), later).unwrap();
    assert_eq!(shared(&[Selection::of(&data), Selection::of(&copy)]), Some(4));
    assert_eq!(shared(&[Selection::of(&run)]), None, "the same rows are held out there");

    // What a log has twice is in another block the second time.
    fs::write(&path, log.clone() + &log).unwrap();
    assert_eq!(fixture::looked_over(&data).repeated, 20);
}

#[test]
fn moments_of_a_run_without_picture_or_label_part_it() {
    let dir = tempfile::tempdir().unwrap();
    let (data, run) = (dir.path().join("data"), dir.path().join("run.mcap"));
    fixture::folder(&data, 6, false);
    fixture::converted(&data, &run);
    assert_eq!(Source::open(&run).unwrap().rows.len(), 6);

    // As it is read: the third telemetry without its picture, the others answered by a person.
    let gone = dir.path().join("gone.mcap");
    record(&gone, 2);
    let rows = Source::open(&gone).unwrap().rows;
    assert_eq!(rows.iter().map(|row| row.drive).collect::<Vec<_>>(), [0, 0, 1, 1, 1]);
}

/// A run of six telemetries, all answered, of which one has no picture.
fn record(run: &Path, without_picture: usize) {
    let answer = CommandRecord::of_human(Steering::new(0.1).unwrap(), Throttle::new(0.2).unwrap());
    let pictures: Vec<_> = (0..6).map(|i| (i != without_picture).then(|| fixture::jpeg(i))).collect();
    fixture::record(run, &pictures, Some(&answer));
}

#[test]
fn balance_is_that_of_all_data_sets_together() {
    let dir = tempfile::tempdir().unwrap();
    let (straight, bends) = (dir.path().join("straight"), dir.path().join("bends"));
    folder(&straight, 90, |_| 0.0);
    folder(&bends, 10, |_| 0.5);
    let share = |weight| {
        let bends = Selection { weight, ..Selection::of(&bends) };
        let balance = Balance { flatten: 1.0, ..Balance::default() };
        let samples = Samples::open(&[Selection::of(&straight), bends], Set::Training, None, &balance).unwrap();
        let drawn = samples.draw(10_000, 1, 0);
        drawn.iter().filter(|i| samples.samples[**i as usize].source == 1).count() as f64 / 1e4
    };
    // Each alone is flat already, in one bin: nothing would change.
    for weight in [1.0, 3.0] {
        assert!((share(weight) - 0.5).abs() < 0.01, "{}", share(weight));
    }
}

#[test]
fn balance_that_leaves_nothing_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 10, |_| 0.0);
    let none = Balance { keep_zero: 0.0, ..Balance::default() };
    let error = Samples::open(&[Selection::of(dir.path())], Set::Training, None, &none).unwrap_err().to_string();
    assert_eq!(
        error,
        "keep_zero: expected a share that keeps something, got 0 and 30 samples that are all straight on"
    );
}

#[test]
fn a_draw_is_as_long_as_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 10, |row| row as f64 / 10.0);
    let odd = Balance { keep_zero: 0.3, flatten: 0.7, large_angles: 1.9 };
    let samples = Samples::open(&[Selection::of(dir.path())], Set::Training, None, &odd).unwrap();
    for count in [1, 7, 30, 31, 1000] {
        assert!((0..20).all(|epoch| samples.draw(count, 3, epoch).len() == count));
    }
}

#[test]
fn a_selection_or_blocks_that_cannot_be_are_named() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 20, |_| 0.1);
    let of = || Selection::of(dir.path());
    let path = format!("{}: ", dir.path().display());
    let error = |selection| open(selection, Set::Training).unwrap_err().to_string().replacen(&path, "", 1);
    assert!(open(Selection { smooth: 2, ..of() }, Set::Training).unwrap_err().to_string().starts_with(&path));
    assert_eq!(error(Selection { weight: f64::NAN, ..of() }), "weight: expected 0.000001 to 1000000, got NaN");
    assert_eq!(
        error(Selection { weight: 1e300, ..of() })[..42],
        "weight: expected 0.000001 to 1000000, got 1000"[..42]
    );
    let huge = usize::MAX; // odd
    assert_eq!(error(Selection { smooth: huge, ..of() }), format!("smooth: expected at most 999 rows, got {huge}"));
    let reversed = error(Selection { rows: Some((7, 7)), ..of() });
    assert_eq!(reversed, "rows: expected two row numbers, the second one larger, got 7, 7");
    assert_eq!(error(Selection { side_offset: f64::NAN, ..of() }), "side_offset: expected 0 to 1, got NaN");
    for (rows, what) in [((100, 200), "behind the end"), ((10, 15), "held out")] {
        let error = error(Selection { rows: Some(rows), ..of() });
        assert!(error.contains("expected rows with a picture to learn from, got none of 20"), "{what}: {error}");
        assert!(error.contains("the first 5 of every 10 rows are held out"), "{what}: {error}");
    }
    let none_held_out = open(Selection { rows: Some((5, 10)), ..of() }, Set::Validation).unwrap_err().to_string();
    assert!(none_held_out.contains("expected rows with a picture to measure by, got none of 20"), "{none_held_out}");
    for (blocks, expected) in [
        (Blocks { size: 0, every: 5 }, "blocks.size: expected at least 1 row, got 0"),
        (Blocks { size: 5, every: 0 }, "blocks.every: expected at least 2 blocks, got 0"),
        (Blocks { size: 5, every: 1 }, "blocks.every: expected at least 2 blocks, got 1"),
    ] {
        let error = Samples::open(&[of()], Set::Training, Some(blocks), &Balance::default()).unwrap_err();
        assert_eq!(error.to_string(), expected);
    }
}

#[test]
fn thinned_out_samples_lie_at_equal_distances_over_all() {
    let dir = tempfile::tempdir().unwrap();
    folder(dir.path(), 20, |_| 0.0);
    let mut samples = Samples::open(&[Selection::of(dir.path())], Set::All, None, &Balance::default()).unwrap();
    samples.thin_out(30);
    assert_eq!(samples.samples.len(), 20);
    samples.thin_out(4);
    assert_eq!(samples.samples.iter().map(|sample| sample.row).collect::<Vec<_>>(), [0, 5, 10, 15]);
}
