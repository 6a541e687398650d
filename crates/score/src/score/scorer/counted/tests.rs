use std::time::Duration;

use super::*;
use crate::score::Scorecard;
use lapwing_core::{
    protocol::{Telemetry, Truth},
    recording::EventRecord,
    units::{MPS_PER_MPH, Mph},
};

const MPS: f64 = 10.0;
/// Distance between two telemetries, in metres.
const STEP_M: f64 = 4.0;

/// What is reported at each distance: laps of 50 waypoints 20 m apart, without collisions.
fn told(at_m: f64) -> Truth {
    Truth {
        lap: Some((at_m / 1000.0) as u32),
        waypoint: Some((at_m % 1000.0 / 20.0) as u32),
        crashes: Some(0),
        out_of_bounds: Some(0),
        ..Truth::default()
    }
}

/// Takes a drive from one place to another, and returns when it ended, in seconds.
fn drive(scorer: &mut Scorer, began_s: f64, (from_m, to_m): (f64, f64), told: impl Fn(f64) -> Truth) -> f64 {
    let steps = ((to_m - from_m) / STEP_M) as u32;
    for i in 0..=steps {
        let way_m = STEP_M * f64::from(i);
        let telemetry = Telemetry {
            steering: Default::default(),
            throttle: Default::default(),
            speed: Mph::saturating(MPS / MPS_PER_MPH),
            image: Default::default(),
            truth: told(from_m + way_m),
        };
        scorer.telemetry(Duration::from_secs_f64(began_s + way_m / MPS), &telemetry);
    }
    began_s + STEP_M * f64::from(steps) / MPS
}

fn driven(from_m: f64, to_m: f64, laps: u32, told: impl Fn(f64) -> Truth) -> Scorecard {
    let mut scorer = Scorer::on(&[], Some(laps));
    drive(&mut scorer, 0.0, (from_m, to_m), told);
    scorer.finish()
}

fn completes(card: &Scorecard, expected: f64) {
    let got = card.value(Figure::Completion).unwrap();
    assert!((got - expected).abs() < 1e-9, "{expected}, got {got}: {card}");
}

#[test]
fn a_run_that_begins_in_the_middle_of_a_lap_is_whole_once_it_has_come_around() {
    // From waypoint 40 of 50.
    completes(&driven(800.0, 1300.0, 1, told), 0.5);
    completes(&driven(800.0, 1796.0, 1, told), 0.98);
    completes(&driven(800.0, 1804.0, 1, told), 1.0);
    // The simulator leaves at the end of the lap.
    completes(&driven(800.0, 1996.0, 2, told), 0.6);
    assert_eq!(driven(800.0, 2804.0, 2, told).get(Figure::Completion), Measure::Told(1.0));
}

#[test]
fn a_run_that_begins_at_the_line_is_whole_whether_or_not_the_line_counts_at_its_beginning() {
    assert_eq!(driven(0.0, 1004.0, 1, told).get(Figure::Completion), Measure::Told(1.0));
    assert_eq!(driven(996.0, 2004.0, 1, told).get(Figure::Completion), Measure::Told(1.0));
    let later = |at_m: f64| Truth { lap: Some(((at_m - 1000.0).max(0.0) / 1000.0) as u32), ..told(at_m) };
    assert_eq!(driven(996.0, 2004.0, 1, later).get(Figure::Completion), Measure::Told(1.0));
    completes(&driven(996.0, 2500.0, 2, later), 0.75);
}

#[test]
fn what_a_human_drove_of_the_lap_before_the_first_telemetry_counts() {
    let mut scorer = Scorer::on(&[], Some(1));
    scorer.event(Duration::ZERO, &EventRecord::TakeoverBegan);
    scorer.event(Duration::from_secs(80), &EventRecord::TakeoverEnded { duration_s: 80.0 });
    drive(&mut scorer, 80.0, (800.0, 1004.0), told);
    assert_eq!(scorer.finish().get(Figure::Completion), Measure::Told(1.0));
}

#[test]
fn a_driving_score_is_as_unsure_as_the_completion_that_a_human_left_open() {
    let mut scorer = Scorer::on(&[], Some(2));
    let end_s = drive(&mut scorer, 0.0, (0.0, 1500.0), told);
    scorer.event(Duration::from_secs_f64(end_s), &EventRecord::TakeoverBegan);
    let hung_up = EventRecord::RunEnded { why: "the simulator hung up".into() };
    scorer.event(Duration::from_secs_f64(end_s + 20.0), &hung_up);
    let card = scorer.finish();
    let off = |figure| match card.get(figure) {
        Measure::Estimate { uncertainty, .. } => uncertainty,
        _ => panic!("{card}"),
    };
    assert!((off(Figure::Completion) - 0.1).abs() < 0.01, "{card}");
    assert!((off(Figure::DrivingScore) - 100.0 * off(Figure::Completion)).abs() < 1e-9, "{card}");
}

#[test]
fn what_was_hit_weighs_by_its_name_where_each_collision_has_one() {
    let hit = |names: [Option<&'static str>; 2]| {
        driven(0.0, 1004.0, 1, move |at_m| {
            let n = usize::from(at_m >= 300.0) + usize::from(at_m >= 600.0);
            let name = (n > 0 && at_m % 300.0 < 20.0).then(|| names[n - 1]).flatten();
            Truth { crashes: Some(n as u32), hit: name.map(str::to_owned), ..told(at_m) }
        })
    };
    let card = hit([Some("a pedestrian"), Some("a car")]);
    assert_eq!(card.get(Figure::DrivingScore), Measure::Told(100.0 / 2.7), "{card}");
    let card = hit([Some("a pedestrian"), None]);
    let Measure::Estimate { uncertainty, from, .. } = card.get(Figure::DrivingScore) else { panic!("{card}") };
    assert!(uncertainty > 1.0 && from == UNNAMED, "{card}");
}

#[test]
fn lap_times_that_are_told_say_that_telemetries_tell_them() {
    let json = serde_json::to_value(driven(0.0, 1500.0, 1, told)).unwrap();
    assert_eq!(json["lap_times_s"].as_array().unwrap().len(), 1, "{json}");
    assert_eq!(json["estimates"]["lap_times_s"]["from"], "the telemetries around the end of each lap");
}

#[test]
fn a_count_of_laps_as_high_as_can_be_is_no_overflow() {
    let card = driven(0.0, 100.0, 1, |at_m| Truth { lap: Some(if at_m > 50.0 { u32::MAX } else { 0 }), ..told(at_m) });
    assert_eq!(card.value(Figure::Laps), Some(f64::from(u32::MAX)));
}
