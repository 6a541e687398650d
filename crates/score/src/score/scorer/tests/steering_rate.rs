//! How fast the wheel turned.

use super::*;

/// The steering rate of a wheel reported at these times and angles.
fn steering_rate(told_at: &[(f64, f64)]) -> Option<f64> {
    let mut scorer = Scorer::default();
    for (s, deg) in told_at {
        scorer.telemetry(at(*s), &turned(*deg));
    }
    scorer.finish().value(Figure::SteeringRate)
}

#[test]
fn a_second_at_10_and_one_at_20_degrees_a_second_are_15_8_rms() {
    // sqrt((10² + 20²) / 2); three telemetries of the even second are as good as two.
    let rate = steering_rate(&[(0.0, 0.0), (0.25, 2.5), (1.0, 10.0), (2.0, -10.0)]).unwrap();
    assert!((rate - 250f64.sqrt()).abs() < 1e-9, "{rate}");
    assert_eq!(steering_rate(&[(0.0, 5.0), (0.5, 5.0)]), Some(0.0));
}

#[test]
fn one_telemetry_tells_no_steering_rate() {
    assert_eq!(steering_rate(&[]), None);
    assert_eq!(steering_rate(&[(0.0, 5.0)]), None);
    assert_eq!(steering_rate(&[(1.0, 0.0), (1.0, 5.0)]), None);
}

#[test]
fn the_wheel_does_not_turn_in_a_gap_or_across_a_reset() {
    assert_eq!(steering_rate(&[(0.0, 0.0), (1.5, 20.0)]), None);
    let rate = steering_rate(&[(0.0, 0.0), (0.5, 5.0), (9.0, -20.0), (9.5, -15.0)]).unwrap();
    assert!((rate - 10.0).abs() < 1e-9, "{rate}");

    let mut scorer = Scorer::default();
    scorer.telemetry(at(0.0), &turned(0.0));
    scorer.telemetry(at(0.5), &turned(5.0));
    scorer.event(at(0.5), &EventRecord::Reset { waypoint: 0 });
    scorer.telemetry(at(0.6), &turned(-20.0));
    scorer.telemetry(at(1.1), &turned(-15.0));
    close(&scorer.finish(), Figure::SteeringRate, 10.0);
}

#[test]
fn two_telemetries_at_one_time_make_no_infinite_rate() {
    assert_eq!(steering_rate(&[(0.0, 0.0), (0.0, 5.0), (0.5, 5.0)]), Some(10.0));
}
