use std::{f64::consts::TAU, time::Duration};

use super::*;
use crate::score::{Scorecard, Scorer};
use lapwing_core::{
    protocol::{Telemetry, Truth},
    recording::{By, CommandRecord, EventRecord},
    units::{Degrees, MPS_PER_MPH, Mph, Steering, Throttle},
};

const LENGTH_M: f64 = 1000.0;
const MPS: f64 = 9.0;

/// Heading along a road that is a circle with a few bends of its own.
fn heading(s: f64) -> f64 {
    let share = s / LENGTH_M;
    TAU * share + 0.8 * (3.0 * TAU * share).sin() + 0.3 * (7.0 * TAU * share).sin()
}

fn road() -> Arc<Road> {
    Arc::new(Road::new("bends".into(), 0.0, LENGTH_M, None, (0..=500).map(|i| heading(f64::from(i) * 2.0)).collect()))
}

fn telemetry(steering_deg: f64, mps: f64) -> Telemetry {
    Telemetry {
        steering: Degrees::saturating(steering_deg),
        throttle: Throttle::saturating(0.3),
        speed: Mph::saturating(mps / MPS_PER_MPH),
        image: Default::default(),
        truth: Truth::default(),
    }
}

/// A drive of this many metres that ends with a standstill from one telemetry to the next.
fn crashed_after(metres: f64, roads: &[Arc<Road>], heading: impl Fn(f64) -> f64) -> Scorecard {
    crashed_and_told(metres, roads, heading, |_| Truth::default())
}

/// The same, with the truth reported at each distance.
fn crashed_and_told(
    metres: f64,
    roads: &[Arc<Road>],
    heading: impl Fn(f64) -> f64,
    told: impl Fn(f64) -> Truth,
) -> Scorecard {
    let mut scorer = Scorer::on(roads, Some(2));
    let way = MPS / 15.0;
    let steps = (metres / way) as u32;
    for i in 0..=steps {
        let s = way * f64::from(i);
        let curvature = (heading(s + way) - heading(s)) / way;
        let steering = motion::steering_deg(curvature);
        let telemetry = Telemetry { truth: told(s), ..telemetry(steering, MPS) };
        scorer.telemetry(Duration::from_secs_f64(f64::from(i) / 15.0), &telemetry);
    }
    for i in 1..10 {
        scorer.telemetry(Duration::from_secs_f64(f64::from(steps + i) / 15.0), &telemetry(0.0, 0.0));
    }
    scorer.finish()
}

#[test]
fn a_run_that_tells_nothing_has_its_road_its_way_and_its_collision_estimated() {
    let card = crashed_after(1500.0, &[road()], heading);
    assert_eq!(card.track.as_deref(), Some("bends"));
    let Measure::Estimate { value, uncertainty, .. } = card.get(Figure::Completion) else { panic!("{card}") };
    assert!((value - 0.75).abs() < 0.02 && (0.001..0.05).contains(&uncertainty), "{card}");
    for (figure, expected) in [(Figure::Laps, 1.0), (Figure::Collisions, 1.0), (Figure::Stuck, 0.0)] {
        assert!(matches!(card.get(figure), Measure::Estimate { value, .. } if value == expected), "{figure:?}: {card}");
    }
    let ([lap_s], Some(off_s)) = (&card.lap_times_s[..], card.lap_times_off_s) else { panic!("{card}") };
    assert!((lap_s - LENGTH_M / MPS).abs() < off_s && (0.1..3.0).contains(&off_s), "{card}");
    let (at, s) = card.whereabouts[card.whereabouts.len() / 2];
    assert!(((at * MPS) % LENGTH_M - s).abs() < 10.0, "{at} s, {s} m");
    assert!((card.value(Figure::SurvivalS).unwrap() - 1500.0 / MPS).abs() < 0.2, "{card}");
    assert!((card.value(Figure::SurvivalM).unwrap() - 1500.0).abs() < 2.0, "{card}");
}

#[test]
fn whole_and_begun_laps_of_joined_drives_are_added_up() {
    let mut scorer = Scorer::on(&[road()], Some(4));
    let way = MPS / 15.0;
    let steps = (1500.0 / way) as u32;
    for drive in 0..2 {
        let at = |i: u32| Duration::from_secs_f64(f64::from(drive * (steps + 1) + i) / 15.0);
        if drive > 0 {
            scorer.event(at(0), &EventRecord::Break { seconds: None });
        }
        for i in 0..=steps {
            let s = way * f64::from(i);
            let steering = motion::steering_deg((heading(s + way) - heading(s)) / way);
            scorer.telemetry(at(i), &telemetry(steering, MPS));
        }
    }
    let card = scorer.finish();
    assert_eq!((card.drives.len(), card.value(Figure::Laps)), (2, Some(2.0)), "{card}");
    let Measure::Estimate { value, uncertainty, .. } = card.get(Figure::Completion) else { panic!("{card}") };
    assert!((value - 3.0 / 4.0).abs() < 0.02 && (0.001..0.05).contains(&uncertainty), "1.5 laps, twice: {card}");
}

#[test]
fn laps_that_are_told_without_a_time_leave_the_estimated_times_as_they_are() {
    // Laps counted from a line that is passed at 800 m, so that none is seen from beginning to end.
    let told = |s: f64| Truth {
        lap: Some(((s + 200.0) / LENGTH_M) as u32),
        waypoint: Some(((s + 200.0) % LENGTH_M / 20.0) as u32),
        ..Truth::default()
    };
    let card = crashed_and_told(1500.0, &[road()], heading, told);
    let ([lap_s], Some(off_s)) = (&card.lap_times_s[..], card.lap_times_off_s) else { panic!("{card}") };
    assert!((lap_s - LENGTH_M / MPS).abs() < off_s, "{card}");
    let json = serde_json::to_value(&card).unwrap();
    assert_eq!(json["estimates"]["lap_times_s"]["from"], "where laps seem to have ended");
}

#[test]
fn on_a_road_that_nobody_knows_neither_track_nor_completion_is_made_up() {
    let other = |s: f64| -s / 80.0 + 1.5 * (s / 30.0).sin();
    let card = crashed_after(900.0, &[road()], other);
    assert_eq!((card.track.as_deref(), card.value(Figure::Completion), card.value(Figure::Laps)), (None, None, None));
    assert_eq!(card.value(Figure::Collisions), Some(1.0));
    assert!(card.words(Figure::Completion).ends_with("matches no known road: add yours with --track"), "{card}");
}

#[test]
fn a_road_on_which_the_car_would_have_gone_too_far_is_not_believed() {
    let headings = (0..=500).map(|i| heading(f64::from(i) * 2.0)).collect();
    let wide = Road::new("wide".into(), 0.0, 1.15 * LENGTH_M, None, headings);
    let card = crashed_after(1500.0, &[Arc::new(wide)], heading);
    assert_eq!(card.track, None, "{card}");
    let told = card.to_string();
    assert!(told.contains("its bends fit wide") && told.contains("times as far as its speed says"), "{told}");
}

#[test]
fn a_drive_that_is_too_short_to_tell_its_road_is_not_told_to_match_none() {
    let twin = Road::new("twin".into(), 0.0, LENGTH_M, None, (0..=500).map(|i| heading(f64::from(i) * 2.0)).collect());
    for roads in [vec![road()], vec![road(), Arc::new(twin)]] {
        let card = crashed_after(240.0, &roads, heading);
        assert_eq!(card.track, None, "{card}");
        for figure in [Figure::Completion, Figure::Laps] {
            let words = card.words(figure);
            assert!(words.contains("is not sure") && !words.contains("--track"), "{words}");
        }
    }
}

#[test]
fn a_suspicion_is_said_once_and_not_of_a_run_that_tells_collisions() {
    let said = |mut scorer: Scorer, crashes: Option<u32>| -> usize {
        let watch = |i: u32| {
            let mut telemetry = telemetry(0.0, if i < 30 { MPS } else { 0.0 });
            telemetry.truth.crashes = crashes;
            scorer.telemetry(Duration::from_secs_f64(f64::from(i) / 15.0), &telemetry);
            scorer.suspicion()
        };
        (0..45).filter_map(watch).count()
    };
    assert_eq!(said(Scorer::on(&[], None), None), 1);
    assert_eq!(said(Scorer::on(&[], None), Some(0)), 0);
    assert_eq!(said(Scorer::default(), None), 0);
}

#[test]
fn while_a_human_drives_unseen_the_car_goes_on_along_the_road_and_his_takeover_counts() {
    let mut scorer = Scorer::on(&[road()], Some(1));
    let pilot = CommandRecord { by: By::Pilot, ..CommandRecord::of_human(Steering::ZERO, Throttle::ZERO) };
    let way = MPS / 15.0;
    let mut taken = false;
    for i in 0..=(1010.0 / way) as u32 {
        let (s, at) = (way * f64::from(i), Duration::from_secs_f64(f64::from(i) / 15.0));
        if (40.0..50.0).contains(&at.as_secs_f64()) {
            if !std::mem::replace(&mut taken, true) {
                scorer.event(at, &EventRecord::TakeoverBegan);
            }
            continue;
        }
        let curvature = (heading(s + way) - heading(s)) / way;
        scorer.telemetry(at, &telemetry(motion::steering_deg(curvature), MPS));
        scorer.command(&pilot);
    }
    scorer.event(Duration::from_secs(50), &EventRecord::TakeoverEnded { duration_s: 10.0 });
    let card = scorer.finish();
    assert_eq!((card.value(Figure::Completion), card.value(Figure::Laps)), (Some(1.0), Some(1.0)), "{card}");
    assert!((card.value(Figure::SurvivalS).unwrap() - 40.0).abs() < 0.2, "{card}");
    assert!((card.value(Figure::SurvivalM).unwrap() - 40.0 * MPS).abs() < 2.0, "{card}");
    let autonomy = 1.0 - 6.0 / (1010.0 / MPS);
    assert!((card.value(Figure::Autonomy).unwrap() - autonomy).abs() < 0.001, "{card}");
    assert!(matches!(card.get(Figure::Autonomy), Measure::Estimate { .. }));
}

#[test]
fn of_a_run_that_did_not_drive_all_laps_nobody_knows_whether_it_left_the_road() {
    let card = crashed_after(400.0, &[road()], heading);
    assert_eq!(card.value(Figure::Autonomy), None, "{card}");
}

#[test]
fn a_lap_takes_the_time_that_a_log_leaves_out_and_a_gap_of_moments_joins_no_drive() {
    let (way, gap_s) = (MPS / 15.0, 5.0);
    // In the middle of a lap, and where it ends.
    for gap_from_m in [500.0, 980.0] {
        let mut scorer = Scorer::on(&[road()], Some(2));
        let (mut at_s, mut was_gap) = (0.0, false);
        for i in 0..=(1500.0 / way) as u32 {
            let s = way * f64::from(i);
            if (gap_from_m..gap_from_m + gap_s * MPS).contains(&s) {
                was_gap = true;
                continue;
            }
            let at = Duration::from_secs_f64(at_s);
            if std::mem::take(&mut was_gap) {
                scorer.event(at, &EventRecord::Break { seconds: Some(gap_s) });
            }
            let curvature = (heading(s + way) - heading(s)) / way;
            scorer.telemetry(at, &telemetry(motion::steering_deg(curvature), MPS));
            at_s += 1.0 / 15.0;
        }
        let card = scorer.finish();
        assert_eq!(card.drives.len(), 1, "{card}");
        let ([lap_s], Some(off_s)) = (&card.lap_times_s[..], card.lap_times_off_s) else { panic!("{card}") };
        let is_certain = gap_from_m + gap_s * MPS < LENGTH_M;
        assert!((lap_s - LENGTH_M / MPS).abs() < off_s && (off_s < 3.0) == is_certain, "{card}");
    }
}

#[test]
fn a_short_drive_that_no_road_explains_may_be_on_one_all_the_same() {
    let other = |s: f64| -s / 80.0 + 1.5 * (s / 30.0).sin();
    let card = crashed_after(400.0, &[road()], other);
    let both = "no known road explains it well enough: a longer recording may tell, or it was on another road: add that with --track";
    assert!(card.words(Figure::Completion).ends_with(both), "{card}");
    let unknown = card.drives[0].unknown.as_deref().unwrap();
    assert!(unknown.starts_with("the nearest, ") && unknown.contains("a longer recording may tell"), "{unknown}");
}

#[test]
fn of_a_drive_of_no_metres_it_is_said_that_they_are_too_few() {
    let twin = Road::new("twin".into(), 0.0, LENGTH_M, None, (0..=500).map(|i| heading(f64::from(i) * 2.0)).collect());
    let card = crashed_after(1.0, &[road(), Arc::new(twin)], heading);
    assert_eq!(card.drives[0].unknown.as_deref(), Some("1 m tell too little, 250 m are needed"), "{card}");
}
