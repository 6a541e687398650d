use std::time::Duration;

use super::{
    super::{
        Source,
        fixture::{converted, folder, jpeg, looked_over, record, steps},
    },
    *,
};
use lapwing_core::{
    protocol::{CameraImage, Telemetry},
    recording::{By, CommandRecord, EventRecord, Item, RunHeader},
    units::Mph,
};

fn error(source: &Path, target: &Path) -> String {
    convert(source, target, &mut |_, _| ControlFlow::Continue(())).unwrap_err().to_string()
}

#[test]
fn a_run_made_a_folder_and_a_run_again_keeps_bytes_numbers_and_times() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    converted(&folder(&at("first"), 12, false), &at("first.mcap"));
    let back = converted(&at("first.mcap"), &at("second"));
    assert_eq!((back.rows, back.without_picture, &back.truncated), (12, 0, &None));
    converted(&at("second"), &at("second.mcap"));
    let (first, second) = (steps(&at("first.mcap")), steps(&at("second.mcap")));
    assert_eq!((first.len(), second.len()), (12, 12));
    for (i, (a, b)) in first.iter().zip(&second).enumerate() {
        let jpeg = CameraImage::Jpeg(jpeg(i).into());
        assert!(a.telemetry.image == jpeg && b.telemetry.image == jpeg, "row {i}");
        assert!((a.telemetry.steering.get() - b.telemetry.steering.get()).abs() < 1e-5);
        assert_eq!((a.telemetry.speed, a.telemetry.throttle), (b.telemetry.speed, b.telemetry.throttle));
        assert_eq!(a.telemetry.truth.brake, b.telemetry.truth.brake);
        assert_eq!(a.at.as_millis(), b.at.as_millis());
    }
    let log = DrivingLog::open(at("second")).unwrap();
    let names = |log: &DrivingLog| log.rows.iter().map(|row| row.taken_at).collect::<Vec<_>>();
    assert_eq!(names(&log), names(&DrivingLog::open(at("first")).unwrap()));
    assert_eq!((log.rows[2].steering.get(), log.rows[2].brake), (-0.25, 0.25));
    assert_eq!((&log.rows[2].left, &log.rows[2].right), (&None, &None));
}

#[test]
fn a_conversion_that_is_broken_off_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let (data, run) = (folder(&dir.path().join("data"), 12, false), dir.path().join("a.mcap"));
    converted(&data, &run);
    let (new_run, new_folder) = (dir.path().join("b.mcap"), dir.path().join("b"));
    let third = |done, _| if done == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    for (source, target) in [(&data, &new_run), (&run, &new_folder)] {
        let error = convert(source, target, &mut { third }).unwrap_err().to_string();
        assert_eq!(error, format!("{}: interrupted; nothing was kept", target.display()));
        assert!(!target.exists());
    }
}

#[test]
fn what_a_folder_says_was_steered_is_a_humans_command_in_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("new/folder/a.mcap");
    let drive = folder(&dir.path().join("drive"), 4, true);
    let log = DrivingLog::open(&drive).unwrap();
    fs::remove_file(log.rows[2].left.as_ref().unwrap()).unwrap();
    let counts = converted(&drive, &run);
    assert_eq!((counts.rows, counts.side_pictures), (4, 7), "only those that are there");
    let command = steps(&run)[3].command.clone().unwrap();
    assert_eq!(command.by, By::Human);
    assert_eq!((command.steering.get(), command.throttle.get()), (0.5, 0.25));
}

#[test]
fn a_run_its_folder_and_the_run_made_of_that_have_the_labels_that_answer_the_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let [run, target, back] = ["a.mcap", "drive", "b.mcap"].map(|name| dir.path().join(name));
    let human = CommandRecord::of_human(Steering::new(0.5).unwrap(), Throttle::new(-0.75).unwrap());
    let pilot = CommandRecord { by: By::Pilot, ..human };
    record(&run, &[Some(jpeg(0)), Some(jpeg(1))], Some(&pilot));
    converted(&run, &target);
    converted(&target, &back);
    for path in [&run, &target, &back] {
        let rows = Source::open(path).unwrap().rows;
        let labels: Vec<_> = rows.iter().map(|row| (row.steering.get(), row.acceleration)).collect();
        assert_eq!(labels, [(0.5, -0.75); 2], "{}", path.display());
    }
    let row = &DrivingLog::open(&target).unwrap().rows[1];
    assert_eq!((row.throttle.get(), row.brake), (0.0, 0.75));
}

#[test]
fn a_safe_answer_is_what_was_driven_and_that_of_a_pilot_that_is_off_is_not() {
    let dir = tempfile::tempdir().unwrap();
    for (by, expected) in [(By::Safe, (0.5, 0.0, 0.75)), (By::Off, (-0.2, 0.25, 0.0))] {
        let [run, target] = ["mcap", "drive"].map(|ending| dir.path().join(format!("{by:?}.{ending}")));
        let human = CommandRecord::of_human(Steering::new(0.5).unwrap(), Throttle::new(-0.75).unwrap());
        record(&run, &[Some(jpeg(0))], Some(&CommandRecord { by, ..human }));
        converted(&run, &target);
        let row = &DrivingLog::open(&target).unwrap().rows[0];
        assert_eq!((row.steering.get(), row.throttle.get(), row.brake), expected, "{by:?}");
    }
}

#[test]
fn along_a_recording_only_the_steering_is_the_pilots() {
    let human = CommandRecord::of_human(Steering::new(0.5).unwrap(), Throttle::new(-0.75).unwrap());
    let steering = human.steering;
    let moment = Moment {
        row: 0,
        line: None,
        at: Duration::ZERO,
        taken_at: None,
        pictures: [None, None, None],
        telemetry: serde_json::from_str(r#"{"steering_deg":-5,"throttle":0.25,"speed_mph":9}"#).unwrap(),
        command: Some(human),
        before: vec![],
        broken: None,
    };
    let driven = |kind| driven(&moment, kind);
    let throttle = |value| Throttle::new(value).unwrap();
    assert_eq!(driven(RunKind::RecordedPath), (steering, throttle(0.25), 0.0));
    assert_eq!(driven(RunKind::Driven), (steering, throttle(-0.75), 0.75));
}

#[test]
fn where_a_human_took_over_or_the_car_was_put_back_the_folder_has_a_seam_that_is_counted() {
    let dir = tempfile::tempdir().unwrap();
    let (run, target) = (dir.path().join("a.mcap"), dir.path().join("drive"));
    let header = RunHeader::new(RunKind::Driven, serde_json::Value::Null, jiff::Timestamp::UNIX_EPOCH);
    let recorder = Recorder::create_file(&run, header, RecorderOptions::default()).unwrap();
    let events = [None, Some(EventRecord::TakeoverBegan), None, Some(EventRecord::Reset { waypoint: 0 })];
    for (i, event) in events.into_iter().enumerate() {
        let at = Duration::from_millis(100 * i as u64);
        let telemetry: Telemetry =
            serde_json::from_str(r#"{"steering_deg":-5,"throttle":0.25,"speed_mph":9}"#).unwrap();
        let rest = [Item::Telemetry(telemetry), Item::Frame(jpeg(i).into())];
        event.map(Item::Event).into_iter().chain(rest).for_each(|item| recorder.record(at, item));
    }
    assert!(recorder.finish().error.is_none());
    let counts = converted(&run, &target);
    assert_eq!((counts.rows, counts.without_picture, counts.seams), (4, 0, 2));
    let rows = DrivingLog::open(&target).unwrap().rows;
    let gaps: Vec<_> = rows.iter().map(|row| row.broken.is_some()).collect();
    assert_eq!(gaps, [false, true, false, true]);
}

#[test]
fn where_nobody_answered_labels_are_what_was_in_effect_and_rows_without_picture_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let (run, target) = (dir.path().join("a.mcap"), dir.path().join("drive"));
    record(&run, &[Some(jpeg(0)), None, Some(jpeg(2))], None);
    let counts = converted(&run, &target);
    assert_eq!((counts.rows, counts.without_picture), (2, 1));
    let rows = DrivingLog::open(&target).unwrap().rows;
    assert_eq!((rows[1].steering.get(), rows[1].throttle.get(), rows[1].brake), (-0.2, 0.25, 0.0));
    assert_eq!((fs::read(&rows[1].center).unwrap(), rows[1].at), (jpeg(2), Duration::from_millis(200)));
}

#[test]
fn nothing_is_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder(&dir.path().join("drive"), 3, false);
    let run = dir.path().join("a.mcap");
    fs::write(&run, "somebody's").unwrap();
    assert_eq!(
        error(&source, &run),
        format!(
            "{}: expected nothing there yet, got a file: nothing is overwritten, choose another name",
            run.display()
        )
    );
    assert_eq!(fs::read_to_string(&run).unwrap(), "somebody's");
    fs::remove_file(&run).unwrap();
    converted(&source, &run);
    assert!(error(&run, &source).contains("got a folder with something in it"));
}

#[test]
fn a_target_of_the_same_kind_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder(&dir.path().join("drive"), 3, false);
    let run = dir.path().join("a.mcap");
    converted(&source, &run);
    assert!(error(&source, &dir.path().join("other")).contains("expected the name of a run, got that of a folder"));
    assert!(error(&run, &dir.path().join("b.mcap")).contains("expected the name of a folder, got that of a run"));
}

#[test]
fn a_row_whose_picture_is_missing_or_no_jpeg_stays_without_one_and_if_none_can_be_used_nothing_is_left_behind() {
    let dir = tempfile::tempdir().unwrap();
    let source = folder(&dir.path().join("drive"), 5, false);
    let pictures = DrivingLog::open(&source).unwrap().rows.into_iter().map(|row| row.center);
    let pictures: Vec<_> = pictures.collect();
    let run = dir.path().join("a.mcap");
    fs::write(&pictures[3], b"\x89PNG").unwrap();
    fs::remove_file(&pictures[1]).unwrap();
    let counts = converted(&source, &run);
    assert_eq!((counts.rows, counts.without_picture), (5, 2));
    assert!(counts.unusable.unwrap().starts_with(&pictures[1].display().to_string()));
    let shown = steps(&run).into_iter().map(|step| step.telemetry.image != CameraImage::default());
    assert_eq!(shown.collect::<Vec<_>>(), [true, false, true, false, true]);

    fs::remove_file(&run).unwrap();
    pictures.iter().for_each(|picture| fs::write(picture, b"\x89PNG").unwrap());
    assert!(error(&source, &run).contains("expected a JPEG"));
    assert!(!run.exists());
}

#[test]
fn a_run_without_pictures_leaves_no_folder_behind() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("a.mcap");
    record(&run, &[None, None], None);
    assert!(error(&run, &dir.path().join("drive")).contains("expected rows with pictures"));
    assert!(!dir.path().join("drive").exists());
}

#[test]
fn two_drives_joined_in_a_log_stay_two_in_its_run_and_in_that_runs_folder() {
    let dir = tempfile::tempdir().unwrap();
    let [first, run, second] = ["first", "a.mcap", "second"].map(|name| dir.path().join(name));
    let mut log = DrivingLogWriter::create(&first, jiff::civil::date(2024, 5, 17).at(12, 0, 0, 0)).unwrap();
    for i in 0..6u64 {
        // Five minutes lie between the third row and the fourth.
        let at = Duration::from_millis(67 * i + if i < 3 { 0 } else { 300_000 });
        let jpeg = jpeg(i as usize);
        let (steering, throttle, speed) = (Steering::ZERO, Throttle::ZERO, Mph::constant(9.0));
        log.row(&NewRow { at, center: &jpeg, left: None, right: None, steering, throttle, brake: 0.0, speed }).unwrap();
    }
    log.finish().unwrap();
    converted(&first, &run);
    converted(&run, &second);
    for path in [&first, &run, &second] {
        let drives: Vec<_> = Source::open(path).unwrap().rows.iter().map(|row| row.drive).collect();
        assert_eq!(drives, [0, 0, 0, 1, 1, 1], "{}", path.display());
        let found = looked_over(path);
        assert_eq!(found.gaps.iter().map(|gap| gap.row).collect::<Vec<_>>(), [3], "{}", path.display());
        assert!(found.duration_s < 2.0, "what is not recorded does not count: {}", found.duration_s);
    }
    for path in [&run, &second] {
        assert_eq!(looked_over(path).gaps[0].seconds, looked_over(&first).gaps[0].seconds);
    }
}

#[test]
fn a_drive_whose_clock_was_set_back_is_another_one_in_the_runs_folder_too() {
    let dir = tempfile::tempdir().unwrap();
    let [first, run, second] = ["first", "a.mcap", "second"].map(|name| dir.path().join(name));
    folder(&first, 12, false);
    let log = fs::read_to_string(first.join("driving_log.csv")).unwrap();
    let (sooner, later) = log.split_at(log.match_indices('\n').nth(5).unwrap().0 + 1);
    fs::write(first.join("driving_log.csv"), [later, sooner].concat()).unwrap();
    converted(&first, &run);
    converted(&run, &second);
    let breaks = DrivingLog::open(&second).unwrap().rows.into_iter().map(|row| row.broken);
    let broken: Vec<_> = breaks.enumerate().filter_map(|(row, broken)| Some((row, broken?))).collect();
    assert!(matches!(broken[..], [(6, Break::Gap(gap))] if gap >= JOINED), "{broken:?}");
}

#[test]
fn whatever_a_run_says_of_its_gaps_its_folder_can_be_written_and_has_them() {
    let dir = tempfile::tempdir().unwrap();
    let (run, back) = (dir.path().join("a.mcap"), dir.path().join("back"));
    let header = RunHeader::new(RunKind::Driven, serde_json::Value::Null, jiff::Timestamp::UNIX_EPOCH);
    let recorder = Recorder::create_file(&run, header, RecorderOptions::default()).unwrap();
    for (i, seconds) in [0.0, 1e19, 1e19, 0.5, 0.0].into_iter().enumerate() {
        let at = Duration::from_millis(67 * i as u64);
        let telemetry: Telemetry =
            serde_json::from_str(r#"{"steering_deg":-5,"throttle":0.25,"speed_mph":9}"#).unwrap();
        recorder.record(at, Item::Event(EventRecord::Break { seconds: Some(seconds) }));
        recorder.record(at, Item::Telemetry(telemetry));
        recorder.record(at, Item::Frame(jpeg(i).into()));
    }
    assert!(recorder.finish().error.is_none());
    converted(&run, &back);
    let rows = DrivingLog::open(&back).unwrap().rows;
    assert!(rows.len() == 5 && rows[1..].iter().all(|row| matches!(row.broken, Some(Break::Gap(_)))), "{rows:?}");
}

#[test]
fn a_throttle_below_0_is_the_folders_brake() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("c.jpg"), jpeg(0)).unwrap();
    fs::write(dir.path().join("driving_log.csv"), "c.jpg,,,0,-0.5,0,9\n").unwrap();
    let [run, back] = ["a.mcap", "back"].map(|name| dir.path().join(name));
    converted(dir.path(), &run);
    converted(&run, &back);
    let row = &DrivingLog::open(&back).unwrap().rows[0];
    assert_eq!((row.throttle.get(), row.brake), (0.0, 0.5));
}
