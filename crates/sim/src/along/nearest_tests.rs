use super::*;

const ALL: [bool; 3] = [true; 3];

/// A moment of this row, beside which the car is so far aside, ahead and turned.
fn taken(row: usize, offset_m: f64, ahead_m: f64, heading_rad: f64) -> (usize, Taken) {
    let beside = Beside { offset_m, ahead_m, heading_rad };
    (row, Taken { when: When { drive: 0, row }, beside, cameras: ALL })
}

/// The rows that are shown, if they are as light as `light` says.
fn shown(last: &mut Last, around: &[(usize, Taken)], light: impl Fn(usize) -> Option<f64>) -> Vec<usize> {
    last.next(around, |_| true, light).into_iter().map(|(row, _)| row).collect()
}

fn first(around: &[(usize, Taken)]) -> usize {
    shown(&mut Last::default(), around, |_| Some(90.0))[0]
}

#[test]
fn of_pictures_close_together_one_is_enough_and_none_is_taken_from_afar() {
    let ahead = [0.5, -1.0, 2.5, -2.2, 3.0, -5.0, 11.0, 12.5, -30.0];
    let moments = ahead.into_iter().map(|ahead_m| (ahead_m, taken(0, 0.0, ahead_m, 0.0).1));
    let first = When { drive: 0, row: 0 };
    let taken: Vec<f64> = completing(moments, first).into_iter().map(|(ahead_m, _)| ahead_m).collect();
    assert_eq!(taken, [-2.2, 2.5, -5.0, 11.0]);
}

#[test]
fn the_nearest_camera_of_any_lap_is_first() {
    assert_eq!(first(&[taken(10, 0.4, 0.0, 0.0), taken(500, 0.1, 0.0, 0.0)]), 500);
    assert_eq!(first(&[taken(10, 0.82, 0.0, 0.0), taken(500, 0.3, 0.0, 0.0)]), 10, "its right camera is there");
    assert_eq!(first(&[taken(10, 0.0, -0.8, 0.0), taken(500, 0.0, 1.2, 0.0)]), 500, "what is behind counts double");
    assert_eq!(first(&[taken(10, 0.0, 0.0, 0.2), taken(500, 0.0, 0.9, 0.0)]), 500, "a turned one shows less");
    assert_eq!(first(&[taken(10, 0.0, 0.0, 3.1), taken(500, 1.9, 2.0, 0.3)]), 500, "the other way round");
}

#[test]
fn a_lap_is_left_only_for_one_that_is_nearer_by_more_than_the_error_of_their_places() {
    let after = |other_m: f64| {
        let mut last = Last::of(When { drive: 0, row: 9 });
        shown(&mut last, &[taken(10, 0.4, 0.0, 0.0), taken(500, other_m, 0.0, 0.0)], |_| Some(90.0))[0]
    };
    assert_eq!((after(0.1), after(0.0)), (10, 500));
    // Once there, it is stayed in as long.
    let mut last = Last::of(When { drive: 0, row: 499 });
    assert_eq!(shown(&mut last, &[taken(10, 0.1, 0.0, 0.0), taken(500, 0.4, 0.0, 0.0)], |_| Some(90.0))[0], 500);
}

#[test]
fn a_lap_in_another_light_is_not_taken_unless_there_is_no_other() {
    let around = [taken(10, 0.4, 0.0, 0.0), taken(500, 0.0, 0.0, 0.0), taken(501, 0.0, 4.0, 0.0)];
    let night = |row: usize| Some(if row >= 500 { 40.0 } else { 90.0 });
    let lit = || Last(Some((When { drive: 0, row: 9 }, Some(92.0))));
    assert_eq!(shown(&mut lit(), &around, night), [10], "nor does it complete");
    assert_eq!(shown(&mut lit(), &around, |_| Some(90.0)), [500, 501]);
    assert_eq!(shown(&mut lit(), &around[1..], night)[0], 500);
    let unreadable = |row: usize| night(row).filter(|_| row >= 500);
    assert_eq!(shown(&mut lit(), &around, unreadable)[0], 500);
    assert!(shown(&mut lit(), &around, |_| None).is_empty());
}

#[test]
fn the_light_of_a_picture_is_that_of_the_rows_that_a_pilot_looks_at() {
    let mut picture = Frame::new(SIZE.0, SIZE.1, vec![200; SIZE.0 * SIZE.1 * 3]).unwrap();
    picture.rgb_mut()[PILOTNET_ROWS.start * SIZE.0 * 3..PILOTNET_ROWS.end * SIZE.0 * 3].fill(80);
    assert!((light(&picture) - 80.0).abs() < 1e-3);
    assert_eq!(light(&Frame::default()), 0.0);
}
