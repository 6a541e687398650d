use super::*;

fn raw(rows: &[(f64, f64)]) -> Vec<Raw> {
    let row = |&(at_s, mph): &(f64, f64)| Raw {
        at_s,
        speed: Mph::saturating(mph),
        steering: Steering::ZERO,
        throttle: Throttle::ZERO,
        broken: None,
    };
    rows.iter().map(row).collect()
}

fn cuts(rows: &[PathRow]) -> Vec<Option<PathBreak>> {
    rows.iter().map(|row| row.cut).collect()
}

#[test]
fn a_car_that_stands_takes_no_time_and_a_new_stretch_begins_behind() {
    let rows =
        driven(&raw(&[(0.0, 0.0), (0.1, 9.0), (0.2, 9.0), (0.3, 0.2), (0.4, 0.0), (0.5, 9.0), (0.6, 9.0)]), &ALL_ROWS);
    assert_eq!(cuts(&rows), [Some(PathBreak::Begins), None, Some(PathBreak::Stood(2)), None]);
    let times: Vec<f64> = rows.iter().map(|row| row.at_s).collect();
    let between = FALLBACK_INTERVAL.as_secs_f64();
    for (time, expected) in times.iter().zip([0.0, 0.1, 0.1 + between, 0.2 + between]) {
        assert!((time - expected).abs() < 1e-9, "{times:?}");
    }
    assert_eq!(rows.iter().map(|row| row.index).collect::<Vec<_>>(), [1, 2, 5, 6]);
}

#[test]
fn of_some_rows_the_clock_begins_at_the_first() {
    let rows: Vec<(f64, f64)> = (0..10).map(|i| (f64::from(i) * 0.1, 9.0)).collect();
    let rows = driven(&raw(&rows), &(6..8));
    assert_eq!(
        rows.iter().map(|row| (row.index, row.cut)).collect::<Vec<_>>(),
        [(6, Some(PathBreak::Begins)), (7, None)]
    );
    assert!(rows[0].at_s == 0.0 && (rows[1].at_s - 0.1).abs() < 1e-9);
}

#[test]
fn missing_time_is_cut_out() {
    let rows = driven(&raw(&[(0.0, 9.0), (0.1, 9.0), (3.1, 9.0), (3.0, 9.0)]), &ALL_ROWS);
    assert_eq!(
        cuts(&rows),
        [Some(PathBreak::Begins), None, Some(PathBreak::Gap(Some(3.0))), Some(PathBreak::Gap(None))]
    );
}

#[test]
fn a_recording_that_says_that_it_is_broken_is_cut_there() {
    let mut rows = raw(&[(0.0, 9.0), (0.1, 9.0), (0.2, 9.0)]);
    rows[1].broken = Some(PathBreak::Put);
    assert_eq!(cuts(&driven(&rows, &ALL_ROWS)), [Some(PathBreak::Begins), Some(PathBreak::Put), None]);
}
