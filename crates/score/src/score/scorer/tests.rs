mod humans;
mod steering_rate;

use super::{
    judgement::{NO_PILOT, NO_POSITION, NOTHING},
    *,
};
use crate::score::{Figure, Measure, Scorecard};
use lapwing_core::{
    protocol::Truth,
    units::{Degrees, Mph, Steering, Throttle},
};

fn at(s: f64) -> Duration {
    Duration::from_secs_f64(s)
}

fn told(mph: f64, cte: f64, lap: u32, waypoint: u32) -> Telemetry {
    Telemetry {
        steering: Default::default(),
        throttle: Default::default(),
        speed: Mph::new(mph).unwrap(),
        image: Default::default(),
        truth: Truth {
            cte: Some(Metres::new(cte).unwrap()),
            lap: Some(lap),
            waypoint: Some(waypoint),
            ..Default::default()
        },
    }
}

fn stock(mph: f64) -> Telemetry {
    Telemetry { truth: Truth::default(), ..told(mph, 0.0, 0, 0) }
}

fn turned(deg: f64) -> Telemetry {
    Telemetry { steering: Degrees::new(deg).unwrap(), ..told(10.0, 0.0, 0, 0) }
}

fn course(laps: u32) -> EventRecord {
    EventRecord::Course {
        track: "lake".into(),
        length_m: 1000.0,
        waypoints: 100,
        laps: Some(laps),
        edge_m: 3.35,
        scenario: None,
    }
}

fn collision(with: &str) -> EventRecord {
    EventRecord::Collision { with: with.into(), speed_mph: 10.0, own_mph: Some(10.0) }
}

#[test]
fn a_place_that_the_car_cannot_have_reached_is_no_progress() {
    let driven = |wrong: &dyn Fn(u32) -> Option<(u32, u32)>| {
        let mut scorer = Scorer::default();
        scorer.event(at(0.0), &course(1));
        for second in 0..=60 {
            let (lap, waypoint) = wrong(second).unwrap_or((0, second * 50 / 60));
            scorer.telemetry(at(f64::from(second)), &told(10.0, 0.0, lap, waypoint));
        }
        scorer.finish()
    };
    close(&driven(&|_| None), Figure::Completion, 0.5);
    for wrong in [(1, 0), (7, 3), (0, 99), (0, 1_000_000_000), (u32::MAX, 5)] {
        for at in [0, 30] {
            let card = driven(&|second| (second == at).then_some(wrong));
            close(&card, Figure::Completion, 0.5);
            let told = "1 message with a place that the car cannot have reached, which completion ignores";
            assert_eq!(card.notes, [told], "{wrong:?} at {at} s");
        }
    }
    let lap = EventRecord::Lap { number: 9, time_s: 30.0 };
    close(&minute(&[(30.0, lap)]), Figure::Completion, 0.5);
    // It may be put at the next waypoint.
    let reset = minute(&[(30.0, EventRecord::Reset { waypoint: 26 })]);
    assert!(reset.notes.is_empty(), "{:?}", reset.notes);
}

#[test]
fn who_reverses_drives_some_way_too() {
    let mut scorer = Scorer::default();
    for second in 0..=10 {
        scorer.telemetry(at(f64::from(second)), &stock(-10.0));
    }
    let card = scorer.finish();
    assert!((card.value(Figure::DistanceM).unwrap() - 100.0 * MPS_PER_MPH).abs() < 0.01, "{card}");
}

#[test]
fn a_run_that_a_person_changed_says_so() {
    let card = minute(&[(9.0, EventRecord::SpeedSet { mph: 12.0 })]);
    assert_eq!(card.notes.len(), 1, "{:?}", card.notes);
    assert!(
        card.notes[0].starts_with("a person changed the set speed, the speed law or the pilot"),
        "{:?}",
        card.notes
    );
}

/// A run of 60 s at 10 mph, reported each second, on a course of one lap, half of which is driven, with these events.
fn minute(events: &[(f64, EventRecord)]) -> Scorecard {
    let mut scorer = Scorer::default();
    scorer.event(at(0.0), &course(1));
    let mut events = events.iter().peekable();
    for second in 0..=60 {
        let now = f64::from(second);
        while let Some((when, event)) = events.next_if(|(when, _)| *when <= now) {
            scorer.event(at(*when), event);
        }
        scorer.telemetry(at(now), &told(10.0, 0.0, 0, second * 50 / 60));
    }
    events.for_each(|(when, event)| scorer.event(at(*when), event));
    scorer.finish()
}

fn close(card: &Scorecard, figure: Figure, expected: f64) {
    let got = card.value(figure);
    assert!(got.is_some_and(|got| (got - expected).abs() < 1e-9), "{}: {expected}, got {got:?}", figure.key());
}

#[test]
fn half_of_the_second_lap_of_two_is_three_quarters() {
    let mut scorer = Scorer::default();
    scorer.event(at(0.0), &course(2));
    scorer.telemetry(at(0.0), &told(10.0, 0.0, 0, 0));
    scorer.event(at(60.0), &EventRecord::Lap { number: 1, time_s: 60.0 });
    scorer.telemetry(at(90.0), &told(10.0, 0.0, 1, 50));
    let card = scorer.finish();
    assert_eq!(card.get(Figure::Completion), Measure::Told(0.75));
    assert_eq!((card.value(Figure::Laps), card.lap_times_s), (Some(1.0), vec![60.0]));
}

#[test]
fn distance_is_speed_over_time_and_offsets_are_ranked() {
    let mut scorer = Scorer::default();
    scorer.event(at(0.0), &course(1));
    for i in 0..=100 {
        scorer.telemetry(at(f64::from(i) / 10.0), &told(20.0, -f64::from(i) / 100.0, 0, 0));
    }
    let card = scorer.finish();
    let way = 10.0 * 20.0 * MPS_PER_MPH;
    let Measure::Estimate { value, uncertainty, .. } = card.get(Figure::DistanceM) else { panic!("{card}") };
    assert!((value - way).abs() < 1e-9 && (uncertainty - 0.01 * way).abs() < 1e-9);
    close(&card, Figure::MeanCte, 0.5);
    close(&card, Figure::RmsCte, (0.01 * (1.0 + 200.0) / 6.0f64).sqrt());
    assert_eq!((card.value(Figure::P95Cte), card.value(Figure::MaxCte)), (Some(0.95), Some(1.0)));
}

#[test]
fn a_run_that_tells_nothing_is_not_said_to_be_free_of_collisions() {
    let mut scorer = Scorer::default();
    scorer.telemetry(at(0.0), &stock(10.0));
    scorer.telemetry(at(1.0), &stock(10.0));
    let card = scorer.finish();
    for figure in [
        Figure::Collisions,
        Figure::Laps,
        Figure::MeanCte,
        Figure::Completion,
        Figure::DrivingScore,
        Figure::Autonomy,
        Figure::SurvivalS,
    ] {
        assert!(matches!(card.get(figure), Measure::Unknown(_)), "{}", figure.key());
    }
    let json = serde_json::to_value(&card).unwrap();
    assert_eq!(json["collisions"], serde_json::Value::Null);
    assert!(json["not_measurable"]["collisions"].as_str().unwrap().contains("the stock build sends neither"), "{json}");
    assert!(json["estimates"]["distance_m"]["uncertainty"].as_f64().unwrap() > 0.0, "{json}");
}

#[test]
fn what_a_fork_counts_itself_counts_where_nobody_else_judges() {
    let mut scorer = Scorer::default();
    let fork = |lap, crashes, out_of_bounds| {
        let truth =
            Truth { crashes: Some(crashes), out_of_bounds: Some(out_of_bounds), ..told(0.0, 0.0, lap, 0).truth };
        Telemetry { truth, ..told(10.0, 0.0, lap, 0) }
    };
    // The counts continue from before this run, and begin again when the fork reloads its track.
    for (i, (lap, crashes, out)) in [(1, 2, 0), (1, 3, 1), (2, 3, 1), (1, 0, 0), (2, 1, 2)].into_iter().enumerate() {
        scorer.telemetry(at(i as f64), &fork(lap, crashes, out));
    }
    let card = scorer.finish();
    let counts = [Figure::Laps, Figure::Collisions, Figure::OffRoads].map(|figure| card.value(figure));
    assert_eq!(counts, [Some(2.0), Some(2.0), Some(3.0)]);
    assert_eq!(card.value(Figure::SurvivalS), Some(1.0));
}

#[test]
fn time_off_the_road_counts_to_the_end_of_a_run_that_ends_there() {
    let mut scorer = Scorer::default();
    scorer.event(at(0.0), &course(1));
    scorer.telemetry(at(0.0), &told(10.0, 0.0, 0, 0));
    scorer.event(at(2.0), &EventRecord::OffRoad { offset_m: 3.4 });
    scorer.event(at(3.0), &EventRecord::BackOnRoad { after_s: 1.0 });
    scorer.event(at(5.0), &EventRecord::OffRoad { offset_m: 3.4 });
    scorer.telemetry(at(7.5), &told(10.0, 9.0, 0, 1));
    let card = scorer.finish();
    assert_eq!((card.value(Figure::OffRoads), card.value(Figure::OffRoadS)), (Some(2.0), Some(3.5)));
    assert_eq!(card.value(Figure::Interventions), Some(1.0));
}

#[test]
fn autonomy_counts_takeovers_and_interventions_apart() {
    let card = minute(&[
        (10.0, EventRecord::TakeoverBegan),
        (19.0, EventRecord::TakeoverEnded { duration_s: 9.0 }),
        (30.0, EventRecord::OffRoad { offset_m: 3.4 }),
        (31.0, EventRecord::Reset { waypoint: 3 }),
        // The simulator's judge sees the car on the road again after it was put there.
        (31.02, EventRecord::BackOnRoad { after_s: 1.02 }),
    ]);
    close(&card, Figure::OffRoadS, 1.0);
    let counts = [Figure::Takeovers, Figure::HumanS, Figure::Interventions].map(|figure| card.value(figure));
    assert_eq!(counts, [Some(1.0), Some(9.0), Some(1.0)]);
    close(&card, Figure::Autonomy, 1.0 - 12.0 / 60.0);
    close(&card, Figure::AutonomyMeasured, 1.0 - 15.0 / 60.0);
    assert_eq!((card.value(Figure::SurvivalS), card.value(Figure::Episodes)), (Some(10.0), Some(2.0)));
}

#[test]
fn a_waypoint_at_which_the_car_was_put_is_not_one_that_it_reached() {
    let crashes = [(30.0, EventRecord::Reset { waypoint: 3 }), (40.0, EventRecord::Reset { waypoint: 4 })];
    for n in 0..3 {
        let card = minute(&crashes[..n]);
        close(&card, Figure::Completion, 0.5 - n as f64 / 100.0);
        close(&card, Figure::DrivingScore, 50.0 - n as f64);
    }
}

#[test]
fn nor_is_it_one_where_nobody_judges_unless_the_laps_asked_for_were_done() {
    let driven = |puts: &[u32]| {
        let mut scorer = Scorer::on(&[], Some(1));
        // 50 waypoints, one a second; at some it stands, as it was put there.
        for second in 0..=60 {
            let mph = if second == 0 || puts.contains(&second) { 0.0 } else { 45.0 };
            scorer.telemetry(at(f64::from(second)), &told(mph, 0.0, second / 50, second % 50));
        }
        scorer.finish()
    };
    for (puts, expected) in [(&[][..], 1.0), (&[20], 0.98), (&[20, 30], 0.96), (&[55], 1.0), (&[20, 55], 0.98)] {
        close(&driven(puts), Figure::Completion, expected);
    }
}

#[test]
fn a_run_that_ends_in_a_collision_would_have_needed_somebody() {
    let end = |when: f64| {
        minute(&[(when, collision("a barrier")), (60.0, EventRecord::RunEnded { why: "collision".into() })])
    };
    assert_eq!(end(59.0).value(Figure::Interventions), Some(1.0));
    assert_eq!(end(30.0).value(Figure::Interventions), Some(0.0));
    let off = [(59.5, EventRecord::OffRoad { offset_m: 4.0 }), (60.0, EventRecord::RunEnded { why: "lost".into() })];
    assert_eq!(minute(&off).value(Figure::Interventions), Some(1.0));
}

#[test]
fn the_driving_score_weighs_what_was_hit_and_takes_off_the_way_beside_the_road() {
    let card = minute(&[
        (6.0, EventRecord::OffRoad { offset_m: 3.4 }),
        (12.0, EventRecord::BackOnRoad { after_s: 6.0 }),
        (20.0, collision("a car")),
        (40.0, collision("a pedestrian")),
    ]);
    close(&card, Figure::OffRoadShare, 0.1);
    close(&card, Figure::DrivingScore, 100.0 * 0.5 * 0.9 / 2.7);
    close(&card, Figure::DrivingScoreProduct, 100.0 * 0.5 * 0.9 * 0.5 * 0.6);
    assert_eq!((card.value(Figure::Collisions), card.value(Figure::CollisionRate)), (Some(2.0), Some(1.0)));
}

#[test]
fn laps_alone_do_not_say_how_far_the_last_one_went() {
    let mut scorer = Scorer::default();
    scorer.event(at(0.0), &course(2));
    scorer.telemetry(at(0.0), &stock(10.0));
    scorer.event(at(60.0), &EventRecord::Lap { number: 1, time_s: 60.0 });
    scorer.telemetry(at(90.0), &stock(10.0));
    assert_eq!(scorer.clone().finish().get(Figure::Completion), Measure::Unknown(NO_POSITION));
    scorer.event(at(120.0), &EventRecord::Lap { number: 2, time_s: 60.0 });
    assert_eq!(scorer.finish().get(Figure::Completion), Measure::Told(1.0));
}

#[test]
fn an_odometer_counts_from_where_the_run_began_and_on_when_it_is_set_back() {
    let mut scorer = Scorer::default();
    for (second, metres) in [(0.0, 500.0), (1.0, 510.0), (2.0, 0.0), (3.0, 7.0)] {
        let truth = Truth { distance: Some(Metres::new(metres).unwrap()), ..Truth::default() };
        scorer.telemetry(at(second), &Telemetry { truth, ..stock(10.0) });
    }
    assert_eq!(scorer.finish().get(Figure::DistanceM), Measure::Told(17.0));
}

#[test]
fn what_a_damaged_file_says_makes_no_impossible_figure() {
    let card = minute(&[
        (10.0, EventRecord::TakeoverEnded { duration_s: -1e308 }),
        (11.0, EventRecord::TakeoverEnded { duration_s: 1e308 }),
        (12.0, EventRecord::Lap { number: 0, time_s: f64::NAN }),
    ]);
    assert_eq!(card.value(Figure::HumanS), Some(11.0));
    assert!(serde_json::to_string(&card).is_ok());
    let mut scorer = Scorer::default();
    for second in [5.0, 6.0, 2.0, 7.0] {
        scorer.telemetry(at(second), &stock(10.0));
    }
    let card = scorer.finish();
    assert_eq!((card.value(Figure::TimeS), card.value(Figure::SteeringRate)), (Some(2.0), Some(0.0)));
}

#[test]
fn what_is_left_of_a_damaged_run_reaches_no_threshold() {
    use lapwing_core::config::Thresholds;
    let mut scorer = Scorer::default();
    scorer.event(at(0.0), &course(1));
    scorer.telemetry(at(0.0), &told(10.0, 0.0, 0, 0));
    scorer.telemetry(at(1.0), &told(10.0, 0.0, 0, 1));
    scorer.damaged("cut off".into());
    let card = scorer.finish();
    let limits = Thresholds { max_collisions: Some(0), ..Default::default() };
    assert_eq!(super::super::missed(&limits, &card).len(), 1, "{card}");
    assert_eq!(super::super::missed(&Thresholds::default(), &card).len(), 0);
    assert_eq!(card.notes, ["cut off"]);
}

#[test]
fn telemetries_of_which_each_is_a_drive_of_its_own_tell_no_distance_and_no_mean_speed() {
    let mut scorer = Scorer::default();
    for second in 0..4 {
        scorer.event(at(f64::from(second)), &EventRecord::Break { seconds: None });
        scorer.telemetry(at(f64::from(second)), &stock(10.0));
    }
    let card = scorer.finish();
    for figure in [Figure::DistanceM, Figure::MeanMph] {
        assert_eq!(card.get(figure), Measure::Unknown("there is a break between every two telemetries of the run"));
    }
    assert_eq!(card.value(Figure::MaxMph), Some(10.0));

    let mut scorer = Scorer::default();
    scorer.event(at(0.0), &course(1));
    for second in 0..4 {
        scorer.event(at(f64::from(second)), &EventRecord::Break { seconds: None });
        scorer.telemetry(at(f64::from(second)), &told(10.0, 0.0, 0, 0));
    }
    let apart = Measure::Unknown("there is a break between every two telemetries of the run");
    assert_eq!(scorer.finish().get(Figure::InterventionsPerKm), apart);
}

#[test]
fn a_run_without_a_telemetry_tells_no_distance() {
    let card = Scorer::default().finish();
    assert_eq!(card.get(Figure::DistanceM), Measure::Unknown(NOTHING));
    assert_eq!(card.get(Figure::DrivingScore), Measure::Unknown(NOTHING));
    assert!(card.to_string().contains("distance          not measurable: the run has no telemetry"), "{card}");
}

#[test]
fn telemetries_without_an_answer_are_missed_but_not_the_last_one() {
    let mut scorer = Scorer::default();
    let answer = CommandRecord {
        by: By::Pilot,
        forward_ns: 2_000_000,
        ..CommandRecord::of_human(Steering::ZERO, Throttle::ZERO)
    };
    for i in 0..10 {
        scorer.telemetry(at(f64::from(i) / 10.0), &stock(10.0));
        if i % 3 == 0 && i < 9 {
            scorer.command(&answer);
        }
    }
    let card = scorer.finish();
    assert_eq!(card.value(Figure::MissedFrames), Some(6.0));
    close(&card, Figure::FramesPerS, 10.0);
    let forward = card.latency[2].unwrap();
    assert!((forward.p50 - 2.0).abs() < 0.01 && card.latency[4].is_none(), "{forward:?}");
}

#[test]
fn a_threshold_that_the_run_does_not_tell_is_missed() {
    use lapwing_core::config::Thresholds;
    let limits = Thresholds { min_completion: Some(50.0), max_collisions: Some(0), ..Default::default() };
    assert_eq!(super::super::missed(&limits, &minute(&[])), Vec::<String>::new());
    let mut scorer = Scorer::default();
    scorer.telemetry(at(0.0), &stock(10.0));
    let missed = super::super::missed(&limits, &scorer.finish());
    assert_eq!(missed.len(), 2);
    assert!(missed[1].starts_with("collisions: expected at most 0, got not measurable"), "{missed:?}");
}

#[test]
fn junit_has_a_failure_for_each_threshold_that_is_missed() {
    use crate::score::checks;
    use lapwing_core::config::Thresholds;
    let limits = Thresholds { min_completion: Some(80.0), max_collisions: Some(0), ..Default::default() };
    let card = minute(&[]);
    let runs = [("runs/a.mcap".into(), &card, checks(&limits, &card))];
    let xml = crate::score::junit::report(&runs, &[], None).unwrap();
    assert!(xml.contains(r#"tests="2""#) && xml.contains(r#"failures="1""#), "{xml}");
    assert!(xml.contains("completion: expected at least 80.0 %, got 50.0 %"), "{xml}");
    let unread = [("runs/b.mcap".to_owned(), "no run".to_owned())];
    let xml = crate::score::junit::report(&runs, &unread, Some(&Default::default())).unwrap();
    assert!(xml.contains(r#"tests="3""#) && xml.contains(r#"errors="1""#) && xml.contains("no run"), "{xml}");
}

#[test]
fn a_run_that_tells_nothing_has_no_figure_and_misses_every_threshold() {
    use lapwing_core::config::Thresholds;
    let limits = Thresholds {
        min_completion: Some(0.0),
        min_autonomy: Some(0.0),
        min_driving_score: Some(0.0),
        max_collisions: Some(0),
        max_off_road: Some(9),
        max_cte: Some(9.0),
        max_mean_cte: Some(9.0),
    };
    let ended = || EventRecord::RunEnded { why: "the simulator hung up".into() };
    for begins_with in [None, Some(course(1))] {
        for mut scorer in [Scorer::default(), Scorer::on(&[], Some(1)), Scorer::live(&[])] {
            begins_with.iter().for_each(|event| scorer.event(at(0.0), event));
            scorer.event(at(5.0), &ended());
            let card = scorer.finish();
            let figures: Vec<_> = Figure::ALL.into_iter().filter(|figure| card.value(*figure).is_some()).collect();
            assert_eq!(figures, [], "{card}");
            assert_eq!(super::super::missed(&limits, &card).len(), 7, "{card}");
        }
    }
    // A single telemetry does not show that nothing was hit, either.
    let mut scorer = Scorer::on(&[], Some(1));
    scorer.telemetry(at(0.0), &stock(10.0));
    assert_eq!(scorer.finish().value(Figure::Collisions), None);
}

#[test]
fn a_live_scorer_keeps_nothing_of_a_telemetry() {
    let mut scorer = Scorer::live(&[]);
    for i in 0..10_000 {
        let telemetry = Telemetry { truth: told(10.0, 0.1, 0, i / 100).truth, ..turned(f64::from(i % 7)) };
        let now = at(f64::from(i) / 15.0);
        scorer.item(now, &Item::Telemetry(telemetry));
        scorer.item(now, &Item::Frame(vec![7; 1000].into()));
    }
    assert_eq!((scorer.samples.capacity(), scorer.offsets.all.capacity()), (0, 0));
    assert_eq!(scorer.blind.kept(), 0);
    let card = scorer.finish();
    assert!(card.value(Figure::SteeringRate).is_some() && card.value(Figure::MeanCte).is_some(), "{card}");
    assert!(card.words(Figure::Comfort).contains("use lapwing score"), "{card}");
}

#[test]
fn a_fork_that_tells_counts_and_offsets_tells_how_long_the_car_was_off_the_road_and_that_it_was_put_back() {
    let mut scorer = Scorer::on(&[], Some(1));
    // Out for a second and back by itself; out again, and put on the next waypoint a second later.
    for i in 0..=100 {
        let (out, cte, waypoint, mph) = match i {
            0..=29 => (0, 0.1, 1, 20.0),
            30..=39 => (1, 4.0, 1, 20.0),
            40..=69 => (1, 0.5, 2, 20.0),
            70..=79 => (2, -5.0, 2, 20.0),
            _ => (2, 0.0, 3, 0.0),
        };
        let truth = Truth { out_of_bounds: Some(out), crashes: Some(0), ..told(mph, cte, 0, waypoint).truth };
        scorer.telemetry(at(f64::from(i) / 10.0), &Telemetry { truth, ..stock(mph) });
        scorer.command(&CommandRecord { by: By::Pilot, ..CommandRecord::of_human(Steering::ZERO, Throttle::ZERO) });
    }
    let card = scorer.finish();
    let counts = [Figure::OffRoads, Figure::Resets, Figure::Interventions, Figure::Episodes];
    assert_eq!(counts.map(|figure| card.value(figure)), [2.0, 1.0, 1.0, 2.0].map(Some), "{card}");
    let Measure::Estimate { value, uncertainty, .. } = card.get(Figure::OffRoadS) else { panic!("{card}") };
    assert!((value - 2.0).abs() <= uncertainty && uncertainty < 0.5, "{card}");
    assert!(
        matches!(card.get(Figure::Autonomy), Measure::Estimate { value, .. } if (value - 0.4).abs() < 1e-9),
        "{card}"
    );
}
