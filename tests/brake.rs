//! `lapwing brake`, from recordings to labels.

use std::fs;

use lapwing_score::emergency::{LabelRule, Labelled};
use tempfile::tempdir;

use crate::{program::lapwing_in, support::shared};

#[test]
fn a_foot_that_goes_down_on_a_real_drive_is_an_emergency_and_a_touch_of_the_pedal_is_none() {
    let Some(lake) = shared("recordings/lake") else { return };
    // Pressed to a third at 113 s, and all the way at 146 s, before the car stops.
    let found = Labelled::open(&lake, LabelRule::default()).unwrap().found();
    let [at_s] = found.emergencies_s[..] else { panic!("{found:?}") };
    assert!((145.5..147.0).contains(&at_s), "{found:?}");
    let eager = LabelRule { threshold_per_s: 0.5, ..LabelRule::default() };
    assert!(Labelled::open(&lake, eager).unwrap().found().emergencies_s.len() >= 2);
}

#[test]
fn recordings_are_labelled_into_a_folder_and_one_without_a_brake_stops_it_before_anything_is_written() {
    let folder = tempdir().unwrap();
    let row = |i: u32| format!("{:.3},30,{}\n", f64::from(i) / 15.0, if i < 30 { 0 } else { 100 });
    let table = "time_s,speed_kmh,brake_percent\n".to_owned() + &(0..60).map(row).collect::<String>();
    fs::write(folder.path().join("drive.csv"), table).unwrap();
    let run = |arguments: &[&str]| lapwing_in(folder.path(), "", arguments);
    let (status, out, err) = run(&["brake", "label", "drive.csv", "--out", "labels", "--plot", "pedal.svg"]);
    assert_eq!((status, err.as_str()), (0, ""));
    assert_eq!(
        out,
        "drive.csv: 1 drive, 60 moments\n  emergencies  1, at 1.9 s\n  labelled     16.7 % of the moments (10)\n"
    );
    assert_eq!(fs::read_to_string(folder.path().join("labels/drive.csv")).unwrap().lines().count(), 61);
    assert!(fs::read_to_string(folder.path().join("pedal.svg")).unwrap().contains("pedals per second"));
    // The stock simulator reports no brake.
    let drive = ["drive", "--stock", "--pilot", "expert", "--max-time", "2", "--recordings", "runs"];
    let (status, _, err) = run(&drive);
    assert_eq!(status, 0, "{err}");
    let made = fs::read_dir(folder.path().join("runs")).unwrap().next().unwrap().unwrap();
    let name = format!("runs/{}", made.file_name().to_string_lossy());
    let (status, out, err) = run(&["brake", "label", "drive.csv", &name, "--out", "others"]);
    assert_eq!((status, out.as_str()), (1, ""));
    assert!(err.contains("expected a brake, got none in"), "{err}");
    assert!(!folder.path().join("others").exists());
    let (status, _, err) = run(&["brake", "label", "drive.csv", "drive.csv", "--out", "labels"]);
    assert_eq!(status, 1);
    assert!(err.contains("expected names that differ, got \"drive\" twice"), "{err}");
}
