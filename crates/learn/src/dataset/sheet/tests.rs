use std::fs;

use super::{
    super::{
        fixture::{converted, folder, looked_over},
        steering_chart,
    },
    *,
};
use lapwing_core::recording::udacity::DrivingLog;

#[test]
fn a_contact_sheet_has_pictures_from_the_first_row_to_the_last_with_their_steering() {
    let dir = tempfile::tempdir().unwrap();
    let path = folder(dir.path(), 101, false);
    fs::remove_file(&DrivingLog::open(&path).unwrap().rows[0].center).unwrap();
    let sheet = contact_sheet(&[looked_over(&path)]).unwrap();
    let pictures = sheet.shapes.iter().filter(|shape| matches!(shape, Shape::Picture { .. })).count();
    let texts: Vec<&str> = sheet
        .shapes
        .iter()
        .filter_map(|shape| if let Shape::Text { text, .. } = shape { Some(&**text) } else { None })
        .collect();
    assert_eq!(pictures, SHOWN - 1);
    assert!(texts.contains(&"missing or broken"));
    assert!(texts.contains(&"row 0  0.0 s  10.0 mph  +0.000") && texts.contains(&"row 100  6.7 s  110.0 mph  +0.000"));
    assert!(texts.contains(&"row 8  0.5 s  18.0 mph  +0.500"), "{texts:?}");
    let png = image::load_from_memory(&sheet.png().unwrap()).unwrap();
    assert_eq!(f64::from(png.width()), sheet.width);
}

#[test]
fn a_short_drive_and_a_run_have_contact_sheets_too() {
    let dir = tempfile::tempdir().unwrap();
    let one = folder(&dir.path().join("one"), 1, false);
    let run = dir.path().join("a.mcap");
    converted(&one, &run);
    let sheet = contact_sheet(&[looked_over(&one), looked_over(&run)]).unwrap();
    assert_eq!(sheet.shapes.iter().filter(|shape| matches!(shape, Shape::Picture { .. })).count(), 2);
}

#[test]
fn the_steering_chart_has_a_panel_for_each_data_set_and_says_the_share_of_zeros() {
    let dir = tempfile::tempdir().unwrap();
    let found = looked_over(&folder(&dir.path().join("drive"), 10, false));
    let svg = steering_chart(&[found.clone(), found]).svg().unwrap();
    assert_eq!(svg.matches("drive: 10 rows, 60.0 % exactly straight on").count(), 2);
}
