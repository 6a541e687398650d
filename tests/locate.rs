//! Pictures, located: real ones, whose three cameras must come out where they sit on the car, and drawn ones whose place is
//! known.

use std::{
    fs,
    ops::ControlFlow,
    path::{Path, PathBuf},
};

use lapwing::{
    known::Roads,
    locating::{self, Driven, LocatedRecording, Part, PartSummary, Placed, Summary},
};
use lapwing_core::{
    motion::around,
    perception::{Frame, decode_jpeg},
    recording::{CameraPosition, Recording, ReleasedAtOnce, released_at_once},
};
use lapwing_learn::dataset;
use lapwing_score::odometry::joins;
use lapwing_sim::camera::encode_jpeg;
use tempfile::{TempDir, tempdir, tempdir_in};

use crate::{
    program::{lapwing, lapwing_in},
    support::shared,
};

/// Some rows of a recording, as a folder of their own. It lies where cargo cleans up: those that tests share are never dropped.
pub fn rows(of: &Path, first: usize, count: usize) -> TempDir {
    let dir = tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let log = fs::read_to_string(of.join("driving_log.csv")).unwrap();
    let lines: Vec<_> = log.lines().skip(first).take(count).collect();
    fs::write(dir.path().join("driving_log.csv"), lines.join("\n")).unwrap();
    std::os::unix::fs::symlink(of.join("IMG"), dir.path().join("IMG")).unwrap();
    dir
}

/// Where a camera's pictures were taken, as if it were the centre one.
pub fn located(recording: &Path, camera: CameraPosition) -> LocatedRecording {
    locating::locate(recording, camera, &Roads::default(), || {}).unwrap()
}

/// The one drive that was found.
fn placed(summary: Summary) -> Placed {
    println!("{summary}");
    let [PartSummary { on: Some(placed), .. }] = &summary.drives[..] else { panic!("{summary}") };
    placed.clone()
}

#[test]
fn on_the_real_roads_the_side_cameras_are_found_where_they_sit_on_the_car() {
    let Some(folder) = shared("recordings") else { return };
    // Of the lake 435 m, with the bridge and the bend into the open.
    for (road, first, count) in [("lake", 600, 450), ("jungle", 1150, 200), ("mountain", 800, 120)] {
        let dir = rows(&folder.join(road), first, count);
        let driven = Driven::find(dir.path(), &Roads::default(), || {}).unwrap();
        let [center, left, right] = [CameraPosition::Center, CameraPosition::Left, CameraPosition::Right]
            .map(|which| driven.locate(which, || {}).unwrap());
        let placed = placed(Summary::new(road.into(), &center, Some(&[left, right])));
        assert_eq!((placed.track.as_str(), placed.reversed), (road, false));
        assert!(placed.located > 0.85, "{road}");
        let errors = placed.sides.unwrap().errors_m;
        assert!(errors.median <= 0.10 && errors.p95 <= 0.25, "{road}: {errors:?}");
    }
}

/// The run of an expert's drive at 20 mph, in a folder of its own.
fn driven(more: &[&str]) -> (TempDir, PathBuf) {
    let dir = tempdir().unwrap();
    let runs = dir.path().join("runs");
    let drive = ["drive", "--pilot", "expert", "--speed", "20", "--recordings", runs.to_str().unwrap()];
    let out = lapwing(&[&drive[..], more].concat());
    let run = fs::read_dir(&runs).unwrap().next().unwrap_or_else(|| panic!("{out:?}")).unwrap().path();
    (dir, run)
}

#[test]
fn a_recording_without_side_cameras_says_in_one_line_that_there_are_none() {
    let (_dir, run) = driven(&["--max-time", "4"]);
    let [center, left, right] =
        [CameraPosition::Center, CameraPosition::Left, CameraPosition::Right].map(|which| located(&run, which));
    let line = "\nside cameras cannot be measured: the recording has none";
    let told = Summary::new("lake".into(), &center, Some(&[left, right])).to_string();
    assert_eq!(told.matches(line).count(), 1, "{told}");
    let told = Summary::new("lake".into(), &center, None).to_string();
    assert!(!told.contains("side cameras"), "nobody asked: {told}");
}

#[test]
fn a_real_drive_the_other_way_round_is_located_too() {
    let Some(folder) = shared("recordings/lake-clockwise") else { return };
    let dir = rows(&folder, 0, 220);
    let placed = placed(Summary::new("clockwise".into(), &located(dir.path(), CameraPosition::Center), None));
    assert_eq!((placed.track.as_str(), placed.reversed), ("lake", true));
    assert!(placed.located > 0.95 && placed.offset_m.unwrap().largest < 3.5);
}

/// The expert along the lane at 20 mph: its car's middle swings out in bends.
#[test]
fn simulated_drives_through_tight_bends_in_rain_in_haze_and_at_night_are_located_where_they_were() {
    for (road, conditions) in [("lake", "rain=0.6,noise=3"), ("jungle", "night=0.7"), ("mountain", "haze=0.6,noise=3")]
    {
        let (_dir, run) = driven(&["--track", road, "--conditions", conditions, "--max-time", "12"]);
        let name = format!("{road} in {conditions}");
        let placed = placed(Summary::new(name.clone(), &located(&run, CameraPosition::Center), None));
        assert_eq!((placed.track.as_str(), placed.reversed), (road, false));
        assert!(placed.located > 0.95, "{name}");
        let errors = placed.against_truth.unwrap();
        assert!(errors.offset_m.median <= 0.10 && errors.offset_m.p95 <= 0.25, "{name}: {errors:?}");
        let heading = errors.heading_deg.unwrap();
        assert!(heading.median <= 0.5, "{name}: {errors:?}");
        for stated in [errors.offset_m, heading, errors.place_m.unwrap()] {
            assert!(stated.within_two_sd.unwrap() >= 0.9, "{name}: {errors:?}");
        }
    }
}

/// Drives that are joined in one log, and the middle one of which goes back to the middle gradually when a key is released.
#[test]
fn how_a_keyboard_is_released_is_told_drive_by_drive_in_a_log_and_in_the_run_that_it_is_converted_to() {
    let dir = tempdir().unwrap();
    let (folder, run) = (dir.path().join("drives"), dir.path().join("drives.mcap"));
    fs::create_dir_all(folder.join("IMG")).unwrap();
    let at_once = ["0", "-0.25", "-0.5", "-0.75", "-1", "0"].repeat(12);
    let halfway = ["0", "-0.15", "-0.4", "-0.65", "-0.9", "0"].repeat(12);
    let gradually = ["0", "-0.2", "-0.45", "-0.35", "-0.1", "0"].repeat(12);
    let mut log = String::new();
    for (minute, drive) in [&at_once, &gradually, &halfway].into_iter().enumerate() {
        for (i, steering) in drive.iter().enumerate() {
            let (minute, second, ms) = (10 * minute, i / 10, i % 10 * 100);
            let name = format!("center_2026_11_27_08_{minute:02}_{second:02}_{ms:03}.jpg");
            fs::write(folder.join("IMG").join(&name), b"\xff\xd8").unwrap();
            log += &format!("{name},,,{steering},0.5,0,20\n");
        }
    }
    fs::write(folder.join("driving_log.csv"), log).unwrap();
    let converted = dataset::convert(&folder, &run, &mut |_, _| ControlFlow::Continue(())).unwrap();
    assert_eq!(converted.rows, 216);
    for path in [folder, run] {
        let drives = released_at_once(Recording::open(&path).unwrap(), joins).unwrap();
        let expected = [(0..72, false), (144..216, true)];
        let expected = expected.map(|(rows, two_frames_per_row)| ReleasedAtOnce { rows, two_frames_per_row });
        assert_eq!(drives, expected, "{}", path.display());
    }
}

#[test]
fn a_piece_whose_bends_fit_a_road_and_whose_pictures_are_not_found_there_says_why_wherever_it_is_used() {
    let Some(folder) = shared("recordings/lake") else { return };
    // Of the straight road.
    let dir = rows(&folder, 126, 120);
    let path = dir.path().to_str().unwrap();
    let why = "its bends fit lake, but its pictures do not show where: a longer recording may tell";
    let (code, out, err) = lapwing_in(dir.path(), "", &["locate", path, "--json"]);
    assert_eq!(code, 1, "{out}{err}");
    let told: serde_json::Value = serde_json::from_str(&out).unwrap();
    let drive = &told["drives"][0];
    assert_eq!((&drive["unknown"], &drive["unsure"]), (&why.into(), &serde_json::Value::Null), "{drive}");
    let (code, _, err) = lapwing_in(dir.path(), "", &["drive", "--world", path, "--no-recording"]);
    assert!(code == 1 && err.contains(&format!("expected a drive on a known road, got none: {why}")), "{code}: {err}");
}

/// Its bends fit nearly all places of several roads; after the crash its pictures look like the lake the other way round.
#[test]
fn a_short_piece_with_a_crash_is_not_taken_for_a_road_that_half_of_it_seems_to_show() {
    let Some(folder) = shared("recordings/lake") else { return };
    let dir = rows(&folder, 1900, 300);
    let found = located(dir.path(), CameraPosition::Center);
    assert!(found.drives().is_empty());
    let [why] = &found.unknown()[..] else { panic!("{:?}", found.unknown()) };
    assert!(why.ends_with("in too many places to look for it in its pictures: a longer recording may tell"), "{why}");
}

/// The bends of each leave several roads or several places, or tell the wrong one. On the straight road the pictures agree with many
/// places, and often better with the lake the wrong way round.
#[test]
fn of_a_short_piece_road_and_place_are_found_or_not_told() {
    let Some(folder) = shared("recordings") else { return };
    for (of, first, count, road, reversed, at_m) in [
        ("lake-high-graphics", 51, 90, "lake", false, None),
        ("lake-clockwise", 0, 90, "lake", true, None),
        ("jungle-rest", 1098, 100, "jungle", false, None),
        ("lake-clockwise", 201, 90, "lake", true, Some(706.0)),
        ("jungle", 777, 100, "jungle", false, Some(1399.0)),
    ] {
        let dir = rows(&folder.join(of), first, count);
        let found = located(dir.path(), CameraPosition::Center);
        let [Part { on, .. }] = &found.parts[..] else { panic!("{of} {first}") };
        let Some(at_m) = at_m else {
            assert!(on.is_none(), "{of} {first}: {}", on.as_ref().unwrap().road());
            continue;
        };
        let on = on.as_ref().unwrap_or_else(|| panic!("{of} {first}: {:?}", found.unknown()));
        assert_eq!((on.road(), on.reversed), (road, reversed), "{of} {first}");
        let last = on.drive.places.last().unwrap().unwrap_or_else(|| panic!("{of} {first}"));
        let off_m = around(last.pose.s_m - at_m, on.drive.track.length());
        assert!(off_m.abs() < 15.0, "{of} {first}: {off_m} m off");
    }
}

/// The same rows with their centre pictures changed, alone.
fn changed(of: &Path, first: usize, count: usize, steering: f64, change: impl Fn(&mut Frame)) -> TempDir {
    let dir = tempdir().unwrap();
    fs::create_dir(dir.path().join("IMG")).unwrap();
    let (mut log, mut frame) = (String::new(), Frame::default());
    for line in fs::read_to_string(of.join("driving_log.csv")).unwrap().lines().skip(first).take(count) {
        let mut fields: Vec<String> = line.split(',').map(|field| field.trim().to_owned()).collect();
        let name = fields[0].rsplit(['/', '\\']).next().unwrap().to_owned();
        decode_jpeg(&fs::read(of.join("IMG").join(&name)).unwrap(), &mut frame).unwrap();
        change(&mut frame);
        fs::write(dir.path().join("IMG").join(&name), encode_jpeg(&frame, 90)).unwrap();
        fields[3] = (steering * fields[3].parse::<f64>().unwrap()).to_string();
        log += &format!("{name},,,{}\n", fields[3..].join(","));
    }
    fs::write(dir.path().join("driving_log.csv"), log).unwrap();
    dir
}

/// Its bends fit the lake the other way round, and half of its pictures seem to show that.
#[test]
fn a_drive_whose_pictures_are_mirrored_is_located_nowhere_and_says_so() {
    let Some(folder) = shared("recordings/lake") else { return };
    let dir = changed(&folder, 1500, 400, -1.0, |frame| {
        let row = 3 * frame.width();
        frame.rgb_mut().chunks_exact_mut(row).for_each(|row| row.as_chunks_mut::<3>().0.reverse());
    });
    let found = located(dir.path(), CameraPosition::Center);
    assert!(found.drives().is_empty());
    let [why] = &found.unknown()[..] else { panic!("{:?}", found.unknown()) };
    assert!(why.starts_with("its pictures seem to be mirrored: flipped back, they show lake; "), "{why}");
}

/// In darker pictures less turning is seen, and by that no road explains the drive; the steering tells it, and the pictures show it.
#[test]
fn a_drive_in_darker_pictures_is_located_by_its_steering_as_it_is_in_brighter_ones() {
    let Some(folder) = shared("recordings/jungle") else { return };
    let dir = changed(&folder, 300, 300, 1.0, |frame| {
        frame.rgb_mut().iter_mut().for_each(|byte| *byte = (f32::from(*byte) * 0.9) as u8);
    });
    let [part] = &located(dir.path(), CameraPosition::Center).parts[..] else { panic!("one drive") };
    let on = part.on.as_ref().unwrap_or_else(|| panic!("{:?}", part.unknown));
    assert_eq!((on.road(), on.reversed), ("jungle", false));
    assert!(on.drive.places.iter().flatten().count() > 290);
}

#[test]
fn why_the_lane_is_not_known_is_told_of_a_drive_along_the_path_in_its_words_and_its_json() {
    let Some(folder) = shared("recordings/lake") else { return };
    // Of the straight road.
    let dir = rows(&folder, 126, 120);
    let path = dir.path().to_str().unwrap();
    let why = "the lane is not known in moments 0 to 119: its bends fit lake, but its pictures do not show where: a longer recording may tell; there, \
               offsets are from the recorded path";
    let (code, out, err) = lapwing_in(dir.path(), "", &["replay", path, "--closed-loop", "--json"]);
    assert!(code == 0 && err.contains(why), "{code}: {err}");
    let told: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&told["notes"][1], &told["limit"]), (&why.into(), &"metres".into()), "{told}");
    let (code, _, err) = lapwing_in(dir.path(), "", &["replay", path, "--closed-loop", "--limit", "road"]);
    assert!(code == 2 && err.contains(why), "{code}: {err}");
}

#[test]
fn pictures_whose_names_hold_no_time_are_warned_of() {
    let folder = crate::program::folder(20, |row| crate::support::jpeg(row as u8));
    let (_, _, err) = lapwing_in(folder.path(), "", &["locate", "."]);
    let warning = "warning: .: the names of 20 pictures hold no time, so 15 a second are assumed";
    assert!(err.contains(warning), "{err}");
    let (_, _, err) = lapwing_in(folder.path(), "", &["replay", ".", "--closed-loop", "--from-path"]);
    assert!(err.contains(warning), "{err}");
}

#[test]
fn a_truth_of_another_recording_is_refused() {
    let dir = tempdir().unwrap();
    let run = |arguments: &[&str]| lapwing_in(dir.path(), "", arguments);
    for (track, longest_s) in [("lake", "3"), ("jungle", "2")] {
        run(&["record", "--track", track, "--out", track, "--max-time", longest_s]);
    }
    let (code, out, err) = run(&["locate", "lake", "--truth", "jungle/lane.csv"]);
    let words = "expected the places of the 45 pictures of lake, got 30 rows of other moments: give the lane.csv that \
                 `lapwing record` wrote beside this recording";
    assert!(code == 1 && out.is_empty() && err.contains(words), "{code}: {out}{err}");
}
