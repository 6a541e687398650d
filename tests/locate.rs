//! Pictures, located: real ones, whose three cameras must come out where they sit on the car, and drawn ones whose place is
//! known.

use std::path::{Path, PathBuf};

use lapwing::{
    known::Roads,
    locating::{self, LocatedRecording, PartSummary, Placed, Summary},
};
use lapwing_core::recording::CameraPosition;
use tempfile::{TempDir, tempdir};

use crate::{program::lapwing, support::shared};

/// Some rows of a recording, as a folder of their own.
pub fn rows(of: &Path, first: usize, count: usize) -> TempDir {
    let dir = tempdir().unwrap();
    let log = std::fs::read_to_string(of.join("driving_log.csv")).unwrap();
    let lines: Vec<_> = log.lines().skip(first).take(count).collect();
    std::fs::write(dir.path().join("driving_log.csv"), lines.join("\n")).unwrap();
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
    // Of the lake the second half of a lap, with the bridge and the bend into the open. On the mountain, where leaves cover
    // the edges of the road, each picture says less: 95 % of the whole recording are within 0.294 m.
    let slices = [("lake", 600, 450, 0.25), ("jungle", 1150, 200, 0.25), ("mountain", 800, 120, 0.33)];
    for (road, first, count, p95_m) in slices {
        let dir = rows(&folder.join(road), first, count);
        let [center, left, right] = [CameraPosition::Center, CameraPosition::Left, CameraPosition::Right]
            .map(|which| located(dir.path(), which));
        let placed = placed(Summary::new(road.into(), &center, Some(&[left, right])));
        assert_eq!((placed.track.as_str(), placed.reversed), (road, false));
        assert!(placed.located > 0.85, "{road}");
        let errors = placed.sides.unwrap().errors_m;
        assert!(errors.median <= 0.10 && errors.p95 <= p95_m, "{road}: {errors:?}");
    }
}

/// The run of an expert's drive at 20 mph, in a folder of its own.
fn driven(more: &[&str]) -> (TempDir, PathBuf) {
    let dir = tempdir().unwrap();
    let runs = dir.path().join("runs");
    let drive = ["drive", "--pilot", "expert", "--speed", "20", "--recordings", runs.to_str().unwrap()];
    let out = lapwing(&[&drive[..], more].concat());
    let run = std::fs::read_dir(&runs).unwrap().next().unwrap_or_else(|| panic!("{out:?}")).unwrap().path();
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
fn simulated_drives_through_tight_bends_and_in_rain_are_located_where_they_were() {
    for (road, conditions) in [("lake", "rain=0.6,noise=3"), ("jungle", "rain=0.7"), ("mountain", "noise=3")] {
        let (_dir, run) = driven(&["--track", road, "--conditions", conditions, "--max-time", "12"]);
        let name = format!("{road} in {conditions}");
        let placed = placed(Summary::new(name.clone(), &located(&run, CameraPosition::Center), None));
        assert_eq!((placed.track.as_str(), placed.reversed), (road, false));
        assert!(placed.located > 0.95, "{name}");
        let errors = placed.against_truth.unwrap();
        assert!(errors.offset_m.median <= 0.10 && errors.offset_m.p95 <= 0.25, "{name}: {errors:?}");
        assert!(errors.heading_deg.unwrap().median <= 0.5, "{name}: {errors:?}");
    }
}
