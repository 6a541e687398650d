//! Whose drive it was.

use super::*;

#[test]
fn a_human_who_drives_all_the_way_is_no_autonomy() {
    let mut scorer = Scorer::default();
    for i in 0..10 {
        scorer.telemetry(at(f64::from(i)), &stock(10.0));
        scorer.command(&CommandRecord::of_human(Steering::ZERO, Throttle::ZERO));
    }
    let card = scorer.finish();
    assert_eq!(card.get(Figure::Autonomy), Measure::Unknown(NO_PILOT));
    assert_eq!((card.value(Figure::HumanS), card.value(Figure::Takeovers)), (Some(9.0), None));
}

/// A run of telemetries from 10 to 20 s with these events, whose last says when it ended.
fn between_humans(events: &[(f64, EventRecord)], roads: Option<&[Arc<Road>]>) -> Scorecard {
    let mut scorer = roads.map_or_else(Scorer::default, |roads| Scorer::on(roads, Some(1)));
    let (before, after): (Vec<_>, Vec<_>) = events.iter().partition(|(when, _)| *when <= 10.0);
    before.into_iter().for_each(|(when, event)| scorer.event(at(*when), event));
    for second in 10..=20 {
        scorer.telemetry(at(f64::from(second)), &stock(10.0));
        scorer.command(&CommandRecord { by: By::Pilot, ..CommandRecord::of_human(Steering::ZERO, Throttle::ZERO) });
    }
    after.into_iter().for_each(|(when, event)| scorer.event(at(*when), event));
    scorer.finish()
}

#[test]
fn a_human_at_a_runs_ends_counts_by_the_clock_and_no_figure_is_negative() {
    let run = [
        (2.0, EventRecord::TakeoverBegan),
        (10.0, EventRecord::TakeoverEnded { duration_s: 8.0 }),
        (20.5, EventRecord::TakeoverBegan),
        (32.5, EventRecord::RunEnded { why: "the simulator hung up".into() }),
    ];
    for roads in [None, Some(&[][..])] {
        let card = between_humans(&run, roads);
        let figures = [Figure::Takeovers, Figure::HumanS, Figure::TimeS].map(|figure| card.value(figure));
        assert_eq!(figures, [Some(2.0), Some(20.0), Some(30.5)], "{card}");
        assert!((card.value(Figure::MeanMph).unwrap() - 10.0).abs() < 1e-9, "of what is told: {card}");
        assert!(Figure::ALL.iter().all(|figure| card.value(*figure).is_none_or(|value| value >= 0.0)), "{card}");
    }
    let survived = between_humans(&run, Some(&[])).value(Figure::SurvivalS);
    assert_eq!(survived, Some(0.0), "a human drove from the start");
}

#[test]
fn a_human_until_a_file_is_cut_off_counts_up_to_the_last_item() {
    let card = between_humans(&[(21.0, EventRecord::TakeoverBegan), (24.0, EventRecord::Kick)], None);
    assert_eq!((card.value(Figure::HumanS), card.value(Figure::Kicks)), (Some(3.0), Some(1.0)), "{card}");
    assert!(card.to_string().contains("human takeovers   1, 3.0 s"), "{card}");
    assert!(card.to_string().contains("kicks             1"), "{card}");
}

#[test]
fn how_long_a_human_drove_is_not_made_up_where_the_simulators_clock_goes_faster() {
    let mut scorer = Scorer::default();
    for i in 0..100 {
        let truth = Truth { sim_time_s: Some(f64::from(i) / 10.0), ..told(10.0, 0.0, 0, 0).truth };
        scorer.telemetry(at(f64::from(i) / 100.0), &Telemetry { truth, ..stock(10.0) });
    }
    scorer.event(at(1.0), &EventRecord::TakeoverBegan);
    scorer.event(at(3.0), &EventRecord::RunEnded { why: "the simulator hung up".into() });
    let card = scorer.finish();
    assert!(card.words(Figure::HumanS).contains("the simulator's clock, which runs faster"), "{card}");
    assert_eq!((card.value(Figure::Autonomy), card.value(Figure::Takeovers)), (None, Some(1.0)), "{card}");
    assert!((card.value(Figure::TimeS).unwrap() - 9.9).abs() < 1e-9, "{card}");
}

#[test]
fn answers_to_bad_frames_alone_are_no_human() {
    let mut scorer = Scorer::default();
    for second in 0..10 {
        scorer.telemetry(at(f64::from(second)), &stock(10.0));
        scorer.command(&CommandRecord { by: By::Safe, ..CommandRecord::of_human(Steering::ZERO, Throttle::ZERO) });
        scorer.event(at(f64::from(second)), &EventRecord::BadFrame { why: "no JPEG".into(), count_in_row: 1 });
    }
    let card = scorer.finish();
    assert_eq!((card.value(Figure::HumanS), card.value(Figure::BadFrames)), (Some(0.0), Some(10.0)), "{card}");
    assert_eq!(card.get(Figure::Autonomy), Measure::Unknown(NO_PILOT));
}
