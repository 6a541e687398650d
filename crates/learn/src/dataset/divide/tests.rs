use tempfile::TempDir;

use super::{
    super::fixture::{converted, folder, looked_over},
    *,
};
use lapwing_core::recording::udacity::DrivingLog;

fn halves(dir: &TempDir) -> [PathBuf; 2] {
    ["train", "validation"].map(|name| dir.path().join("halves").join(name))
}

#[test]
fn the_halves_are_the_logs_rows_and_their_pictures_stay_where_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder(&dir.path().join("Doe, Jane's drive"), 23, true);
    let [train, validation] = halves(&dir);
    let divided = divide(&source, Blocks { size: 4, every: 3 }, &train, &validation).unwrap();
    assert_eq!((divided.train_rows, divided.validation_rows), (15, 8));
    let whole = DrivingLog::open(&source).unwrap().rows;
    let [of_train, of_validation] = [&train, &validation].map(|dir| DrivingLog::open(dir).unwrap().rows);
    let (mut train_rows, mut validation_rows) = (of_train.iter(), of_validation.iter());
    for (i, row) in whole.iter().enumerate() {
        let held_out = (i / 4) % 3 == 0;
        let copy = if held_out { validation_rows.next() } else { train_rows.next() }.unwrap();
        assert_eq!((&copy.center, &copy.left, &copy.right), (&row.center, &row.left, &row.right));
        assert_eq!((copy.steering, copy.throttle, copy.speed), (row.steering, row.throttle, row.speed));
        assert_eq!((copy.brake, copy.taken_at), (row.brake, row.taken_at));
    }
    assert!(train_rows.next().is_none() && validation_rows.next().is_none());
    assert!(looked_over(&train).problems.is_empty());
    assert_eq!(fs::read_dir(&train).unwrap().count(), 1, "only the log is written");
}

#[test]
fn a_log_that_is_there_is_left_alone_and_the_other_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder(&dir.path().join("drive"), 10, false);
    let [train, _] = halves(&dir);
    let error = divide(&source, Blocks { size: 1, every: 2 }, &train, &source).unwrap_err();
    assert!(matches!(error, DatasetError::Exists { .. }), "{error}");
    assert!(!train.exists());
}

#[test]
fn what_cannot_be_split_is_refused_with_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder(&dir.path().join("drive"), 10, false);
    let run = dir.path().join("a.mcap");
    converted(&source, &run);
    let [train, validation] = halves(&dir);
    let error = |source: &Path, size, every| {
        divide(source, Blocks { size, every }, &train, &validation).unwrap_err().to_string()
    };
    assert_eq!(error(&source, 0, 5), "--block: expected at least 1 row, got 0");
    assert_eq!(error(&source, 5, 1), "--every: expected at least 2 blocks, got 1");
    assert!(error(&source, 50, 5).contains("got 10 rows, all of them for validation: choose smaller blocks"));
    assert!(error(&run, 1, 2).contains("convert it with `lapwing dataset convert`"));
}

#[test]
fn both_halves_in_one_folder_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder(&dir.path().join("drive"), 10, false);
    let [train, _] = halves(&dir);
    let error = divide(&source, Blocks { size: 1, every: 2 }, &train, &train).unwrap_err().to_string();
    assert!(error.starts_with("--out-train and --out-validation: expected two folders, got "), "{error}");
    assert!(!train.exists());
}
