use std::fs;

use super::{
    super::{
        Source,
        fixture::{converted, folder, jpeg, looked_over, record},
    },
    *,
};
use lapwing_core::{
    recording::{CommandRecord, udacity::DrivingLog},
    units::Throttle,
};

#[test]
fn rows_cameras_steering_speed_and_intervals_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let found = looked_over(&folder(dir.path(), 10, true));
    assert_eq!((found.kind, found.rows, found.picture_bytes > 1000), ("folder", 10, true));
    let cameras: Vec<_> = found.cameras.iter().map(|c| (c.camera, c.rows, c.missing, c.broken)).collect();
    assert_eq!(cameras, [("center", 10, 0, 0), ("left", 10, 0, 0), ("right", 10, 0, 0)]);
    assert_eq!((found.steering.min, found.steering.max, found.steering.mean), (-0.25, 0.5, 0.05));
    assert!((found.steering.std - (0.31f64 / 5.0 - 0.0025).sqrt()).abs() < 1e-2, "{}", found.steering.std);
    assert_eq!((found.zero_steering, found.speed_mph.min, found.speed_mph.max), (0.6, 10.0, 19.0));
    let intervals = found.intervals_ms.unwrap();
    assert_eq!((intervals.median.round(), intervals.max.round(), found.untimed), (67.0, 67.0, 0));
    assert_eq!(found.sizes, [Size { width: 64, height: 32, pictures: 30 }]);
    assert!(found.gaps.is_empty() && found.problems.is_empty() && found.answered.is_empty());
    assert!((found.duration_s - 0.603).abs() < 1e-9);
}

#[test]
fn zero_steering_lies_in_the_middle_of_the_histogram() {
    let counts = Histogram::of_steering(&[0.0, 0.02, -0.02, 1.0, -1.0, 0.06]).counts;
    assert_eq!((counts.len(), counts[20], counts[21], counts[0], counts[40]), (41, 3, 1, 1, 1));
}

#[test]
fn missing_and_broken_pictures_are_told_with_file_row_and_line() {
    let dir = tempfile::tempdir().unwrap();
    let path = folder(dir.path(), 8, true);
    let rows = DrivingLog::open(&path).unwrap().rows;
    let (gone, cut, text) = (rows[2].left.clone().unwrap(), rows[5].center.clone(), rows[5].right.clone().unwrap());
    fs::remove_file(&gone).unwrap();
    fs::write(&cut, &jpeg(5)[..300]).unwrap();
    fs::write(&text, "not a picture").unwrap();
    let found = looked_over(&path);
    let told: Vec<_> = found.problems.iter().map(|p| (p.row, p.line, p.camera, p.file.as_ref(), p.missing)).collect();
    assert_eq!(
        told,
        [
            (2, Some(3), Some("left"), Some(&gone), true),
            (5, Some(6), Some("center"), Some(&cut), false),
            (5, Some(6), Some("right"), Some(&text), false),
        ]
    );
    assert!(found.problems[2].why.starts_with("expected a JPEG"), "{}", found.problems[2].why);
    let counts: Vec<_> = found.cameras.iter().map(|c| (c.missing, c.broken)).collect();
    assert_eq!(counts, [(0, 1), (1, 0), (0, 1)]);
    assert_eq!(found.sizes[0].pictures, 21);
}

#[test]
fn jumps_in_time_are_gaps_and_rows_without_time_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["2024_01_01_00_00_00_000", "2024_01_01_00_00_00_100", "2024_01_01_00_00_02_100", "x", "y"];
    let names = names.iter().chain(&["2024_01_01_00_00_05_000", "2024_01_01_00_00_04_500"]);
    let log: String = names.map(|name| format!("center_{name}.jpg,,,0,0,0,1\n")).collect();
    fs::write(dir.path().join("driving_log.csv"), log).unwrap();
    let found = looked_over(dir.path());
    let gaps: Vec<_> = found.gaps.iter().map(|gap| (gap.row, gap.line, gap.seconds)).collect();
    assert_eq!(gaps, [(2, Some(3), 2.0), (6, Some(7), -0.5)]);
    assert_eq!((found.untimed, found.intervals_ms.unwrap().max, found.cameras.len()), (2, 100.0, 1));
}

#[test]
fn a_run_is_looked_over_like_a_folder_and_says_who_answered() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder(&dir.path().join("drive"), 10, false);
    let run = dir.path().join("drive.mcap");
    converted(&source, &run);
    let (of_run, of_folder) = (looked_over(&run), looked_over(&source));
    assert_eq!((of_run.kind, of_run.answered["human"]), ("run", 10));
    assert_eq!(of_run.steering_histogram, of_folder.steering_histogram);
    assert_eq!((of_run.rows, of_run.sizes, of_run.cameras), (10, of_folder.sizes, of_folder.cameras));
    assert_eq!(of_run.intervals_ms.unwrap().median.round(), 67.0);
}

#[test]
fn a_run_that_is_cut_off_says_so_and_a_frame_not_recorded_is_missing() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("a.mcap");
    record(&run, &[Some(jpeg(0)), None, Some(b"nothing".to_vec())], None);
    let found = looked_over(&run);
    let told: Vec<_> = found.problems.iter().map(|p| (p.row, p.missing, p.file.as_deref())).collect();
    assert_eq!(told, [(1, true, None), (2, false, None)]);
    assert_eq!((found.truncated, found.answered["nobody"]), (None, 3));
    let bytes = fs::read(&run).unwrap();
    fs::write(&run, &bytes[..bytes.len() - 200]).unwrap();
    assert!(looked_over(&run).truncated.is_some());
}

#[test]
fn the_steering_shown_of_a_run_is_the_one_that_is_learnt() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("a.mcap");
    let answer = CommandRecord::of_human(Steering::new(0.5).unwrap(), Throttle::ZERO);
    record(&run, &[Some(jpeg(0)), Some(jpeg(1))], Some(&answer));
    let learnt: Vec<_> = Source::open(&run).unwrap().rows.iter().map(|row| row.steering.get()).collect();
    assert_eq!((learnt, looked_over(&run).steering), (vec![0.5; 2], Distribution::of(&[0.5; 2])));
    let nobody = CommandRecord { by: By::Safe, ..answer };
    let run = dir.path().join("b.mcap");
    record(&run, &[Some(jpeg(0))], Some(&nobody));
    assert_eq!(looked_over(&run).steering, Distribution::default());
}

#[test]
fn progress_ends_with_all_rows() {
    let dir = tempfile::tempdir().unwrap();
    let path = folder(dir.path(), 7, false);
    let mut told = Vec::new();
    inspect(&path, &mut |done, total| told.push((done, total))).unwrap();
    assert_eq!((told.len(), told.last()), (7, Some(&(7, Some(7)))));
}

#[test]
fn the_json_has_the_units_in_its_names() {
    let dir = tempfile::tempdir().unwrap();
    let json = serde_json::to_value(looked_over(&folder(dir.path(), 3, false))).unwrap();
    for (pointer, value) in [("/rows", 3.0), ("/speed_mph/max", 12.0), ("/cameras/0/missing", 0.0)] {
        assert_eq!(json.pointer(pointer).unwrap().as_f64(), Some(value), "{pointer}");
    }
    assert_eq!(json["steering_histogram"]["counts"].as_array().unwrap().len(), 41);
    assert!(json.get("truncated").is_none());
}

#[test]
fn a_log_that_is_not_there_is_an_error_that_names_it() {
    let error = inspect(Path::new("/nowhere/drive"), &mut |_, _| {}).unwrap_err().to_string();
    assert!(error.contains("/nowhere/drive"), "{error}");
}
