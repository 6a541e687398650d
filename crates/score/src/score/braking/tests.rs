use super::*;
use lapwing_core::units::{Steering, Throttle};

const SCENARIO: Known = Known { time_s: 60.0, judged: true, counted: false, scenario: true };

/// A telemetry: its time, speed and reported time to collision.
fn told(braking: &mut Braking, at_s: f64, mph: f64, until_s: f64) {
    let truth = Truth { time_to_collision_s: Some(until_s), ..Truth::default() };
    braking.telemetry(at_s, Mph::new(mph).unwrap(), &truth);
}

fn answered(braking: &mut Braking, by: By, throttle: f64) {
    let human = CommandRecord::of_human(Steering::ZERO, Throttle::new(throttle).unwrap());
    braking.command(&CommandRecord { by, ..human });
}

fn told_so(braking: Braking, known: Known) -> [Measure; 5] {
    braking.figures(known).map(|(_, measure)| measure)
}

use Measure::{Told, Unknown};

#[test]
fn a_car_that_stops_short_has_avoided_it_and_lost_all_its_speed() {
    let mut braking = Braking::default();
    let told_at = [(0.0, 30.0, 12.0), (1.0, 30.0, 6.0), (2.0, 20.0, 4.5), (3.0, 6.0, 2.5), (4.0, 0.0, 60.0)];
    told_at.into_iter().for_each(|(at, mph, until)| told(&mut braking, at, mph, until));
    assert_eq!(told_so(braking, SCENARIO), [Told(1.0), Unknown(NOT_HIT), Told(30.0), Told(2.5), Told(0.0)]);
}

#[test]
fn a_car_that_brakes_too_late_hits_with_what_is_left() {
    let mut braking = Braking::default();
    told(&mut braking, 0.0, 30.0, 5.0);
    told(&mut braking, 4.0, 28.0, 1.0);
    braking.collision(12.0, Some(16.0));
    // It stands there and is touched again, which is not a second hit.
    told(&mut braking, 4.1, 0.0, 0.0);
    braking.collision(12.0, Some(16.0));
    told(&mut braking, 9.0, 0.0, 60.0);
    assert_eq!(told_so(braking, SCENARIO), [Told(0.0), Told(12.0), Told(14.0), Told(0.0), Told(0.0)]);
}

#[test]
fn who_speeds_up_into_it_has_taken_off_nothing() {
    let mut braking = Braking::default();
    told(&mut braking, 0.0, 20.0, 5.0);
    braking.collision(22.0, Some(22.0));
    assert_eq!(told_so(braking, SCENARIO)[1..3], [Told(22.0), Told(0.0)]);
}

#[test]
fn situations_are_apart_by_a_second_and_their_figures_are_means() {
    let mut braking = Braking::default();
    // Half a second without a collision course comes from a turn of the wheel and does not begin another situation.
    for (at, mph, until) in [(0.0, 30.0, 5.0), (0.5, 25.0, 60.0), (1.0, 20.0, 5.0), (2.0, 20.0, 60.0)] {
        told(&mut braking, at, mph, until);
    }
    told(&mut braking, 10.0, 20.0, 3.0);
    braking.collision(18.0, None);
    assert_eq!(told_so(braking, SCENARIO), [Told(0.5), Told(18.0), Told((10.0 + 0.0) / 2.0), Told(0.0), Told(0.0)]);
}

/// A car that slides past what it brakes for: the situation is over at 2 s, and avoided so far.
fn slid_past() -> Braking {
    let mut braking = Braking::default();
    for (at, mph, until) in [(0.0, 30.0, 5.0), (1.0, 25.0, 2.0), (2.0, 15.0, 60.0), (2.5, 12.0, 60.0)] {
        told(&mut braking, at, mph, until);
    }
    assert_eq!(told_so(braking.clone(), SCENARIO)[..3], [Told(1.0), Unknown(NOT_HIT), Told(15.0)]);
    braking
}

#[test]
fn what_is_hit_before_the_car_drives_on_was_not_avoided() {
    let mut braking = slid_past();
    told(&mut braking, 2.6, 10.0, 60.0);
    braking.collision(9.0, Some(9.5));
    // It is touched again.
    told(&mut braking, 2.7, 0.0, 60.0);
    braking.collision(1.0, Some(0.0));
    assert_eq!(told_so(braking, SCENARIO), [Told(0.0), Told(9.0), Told(20.5), Told(0.0), Told(0.0)]);
    // A world that counts collisions and does not measure them.
    let mut braking = slid_past();
    braking.hit();
    assert_eq!(told_so(braking, SCENARIO)[..3], [Told(0.0), Unknown(NOT_MEASURED), Told(18.0)]);
}

#[test]
fn a_car_that_passes_at_its_speed_or_long_ago_did_not_hit_what_it_passed() {
    for (mph, later_s) in [(30.0, 3.0), (12.0, 8.0)] {
        let mut braking = Braking::default();
        for (at, mph, until) in [(0.0, 30.0, 5.0), (1.0, mph, 2.0), (2.0, mph, 60.0), (later_s, mph, 60.0)] {
            told(&mut braking, at, mph, until);
        }
        braking.collision(mph, Some(mph));
        assert_eq!(told_so(braking, SCENARIO)[..2], [Told(1.0), Unknown(NOT_ON_COURSE)], "{mph} mph");
    }
}

#[test]
fn what_is_hit_after_that_leaves_it_avoided_but_nobody_says_that_nothing_was_hit() {
    let mut braking = slid_past();
    told(&mut braking, 4.0, 14.0, 60.0);
    braking.collision(14.0, Some(14.0));
    assert_eq!(told_so(braking, SCENARIO)[..3], [Told(1.0), Unknown(NOT_ON_COURSE), Told(15.0)]);
}

#[test]
fn a_situation_that_the_runs_end_cuts_short_is_not_judged() {
    let mut braking = Braking::default();
    told(&mut braking, 0.0, 30.0, 5.0);
    told(&mut braking, 1.0, 25.0, 4.0);
    let unknown = Unknown(NOT_MET);
    assert_eq!(told_so(braking.clone(), SCENARIO), [unknown, unknown, unknown, Told(4.0), Told(0.0)]);
    // A car that was put elsewhere has avoided nothing either.
    braking.put();
    told(&mut braking, 5.0, 0.0, 60.0);
    assert_eq!(told_so(braking, SCENARIO)[0], unknown);
}

#[test]
fn braking_hard_with_nothing_ahead_is_a_false_alarm_and_going_on_with_it_is_none() {
    let mut braking = Braking::default();
    for (at, mph, until, by, throttle) in [
        (0.0, 30.0, 60.0, By::Pilot, -0.7),  // firmly, but no emergency
        (1.0, 30.0, 60.0, By::Safe, -1.0),   // no picture to drive by
        (2.0, 30.0, 60.0, By::Pilot, -1.0),  // the false alarm
        (2.5, 20.0, 60.0, By::Pilot, -0.9),  // still the same
        (3.0, 4.0, 60.0, By::Pilot, -1.0),   // reversing
        (10.0, 30.0, 9.0, By::Pilot, -1.0),  // for good reason
        (20.0, 30.0, 11.0, By::Pilot, -0.8), // another one
    ] {
        told(&mut braking, at, mph, until);
        answered(&mut braking, by, throttle);
    }
    assert_eq!(told_so(braking, SCENARIO)[4], Told(120.0));
}

#[test]
fn a_drive_that_begins_faster_than_it_is_to_go_brakes_without_an_alarm() {
    let mut braking = Braking::default();
    for (at, mph, throttle) in [(0.0, 30.0, -1.0), (0.5, 22.0, -0.85), (1.0, 17.0, -0.7), (4.0, 20.0, 0.1)] {
        told(&mut braking, at, mph, 60.0);
        answered(&mut braking, By::Pilot, throttle);
    }
    assert_eq!(told_so(braking.clone(), SCENARIO)[4], Told(0.0));
    told(&mut braking, 6.0, 20.0, 60.0);
    answered(&mut braking, By::Pilot, -1.0);
    assert_eq!(told_so(braking, SCENARIO)[4], Told(60.0));
    // One that goes on and on does not slow down, but stops.
    let mut braking = Braking::default();
    for (at, mph) in [(0.0, 30.0), (0.9, 15.7), (1.6, 9.0), (1.8, 7.0)] {
        told(&mut braking, at, mph, 60.0);
        answered(&mut braking, By::Pilot, -1.0);
    }
    assert_eq!(told_so(braking, SCENARIO)[4], Told(60.0));
}

#[test]
fn what_a_run_does_not_tell_is_not_measurable_and_says_why() {
    let without = told_so(Braking::default(), Known { scenario: false, ..SCENARIO });
    assert_eq!(without, [Unknown(NO_SCENARIO); 5]);
    assert_eq!(told_so(Braking::default(), SCENARIO), [Unknown(NOT_TOLD); 5]);
    let mut clear = Braking::default();
    told(&mut clear, 0.0, 30.0, 60.0);
    let unknown = Unknown(NOT_MET);
    assert_eq!(told_so(clear, SCENARIO), [unknown, unknown, unknown, Unknown(CLEAR), Told(0.0)]);
    // Over the wire there is a time to collision, but nobody reports what was hit.
    let mut live = Braking::default();
    told(&mut live, 0.0, 30.0, 3.0);
    told(&mut live, 5.0, 0.0, 60.0);
    let unknown = Unknown(NO_JUDGE);
    let known = Known { time_s: 0.0, judged: false, counted: false, scenario: false };
    assert_eq!(told_so(live, known), [unknown, unknown, unknown, Told(3.0), Unknown(NO_TIME)]);
}

#[test]
fn what_a_damaged_file_says_stays_within_what_cars_do() {
    let mut braking = Braking::default();
    told(&mut braking, 0.0, 30.0, f64::NAN);
    told(&mut braking, 1.0, 30.0, -1e308);
    braking.collision(-1e308, Some(f64::NAN));
    assert_eq!(told_so(braking, SCENARIO), [Told(0.0), Told(1000.0), Told(30.0), Told(0.0), Told(0.0)]);
}
