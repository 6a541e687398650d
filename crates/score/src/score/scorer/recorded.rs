//! Figures that a drive along a recording cannot give: it has a path to follow and nothing else.

use crate::{score::Figure, score::card::Figures};

const NO_LAPS: &str = "a recording has no laps";
const NO_OBSTACLES: &str = "a recording has no obstacles to hit";
const NO_EDGE: &str = "a recording does not report where the road ends";
const PUT_BACK: &str = "the car is put back before it can stay off the road: see interventions";
/// For the figure that only such a drive has.
pub(super) const NOT_ALONG: &str = "offsets are from the line to drive: no recording was driven along";
const RECORDED_SPEED: &str = "the car goes at the recorded speed";

/// For the figures that remain.
pub(super) const NOTE: &str = "speed, time and distance are the recording's: the pilot only steers";

/// For the interventions, if some were where the lane is not known.
pub(super) fn put_by_path(times: u32, all: u32) -> String {
    format!("in {times} of {all} interventions the car was too far from the recorded path, for want of a known lane")
}

/// Removes the figures that only a course with a judge can give.
pub(super) fn untell(figures: &mut Figures) {
    use Figure as F;
    let from_lane = figures.get(F::FromLane).value().is_some_and(|share| share > 0.0);
    let off_road = if from_lane { PUT_BACK } else { NO_EDGE };
    for (figure, why) in [
        (F::Completion, NO_LAPS),
        (F::Laps, NO_LAPS),
        (F::Collisions, NO_OBSTACLES),
        (F::CollisionsPerKm, NO_OBSTACLES),
        (F::CollisionRate, NO_OBSTACLES),
        (F::DrivingScore, NO_OBSTACLES),
        (F::DrivingScoreProduct, NO_OBSTACLES),
        (F::OffRoads, off_road),
        (F::OffRoadS, off_road),
        (F::OffRoadShare, off_road),
        (F::Stuck, RECORDED_SPEED),
        (F::RmsJerk, RECORDED_SPEED),
        (F::Comfort, RECORDED_SPEED),
    ] {
        figures.told(figure, None, why);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::score::{
        Scorecard, Scorer, missed,
        report::{JudgedRun, Report},
    };
    use lapwing_core::{
        config::Thresholds,
        protocol::{Telemetry, Truth},
        recording::{EventRecord, RunHeader, RunKind},
        turn::{LimitEdge, MeasuredLine},
        units::{Metres, Mph},
    };

    /// A minute along a recording, reported each second, in which the car is put back three times from these offsets.
    fn minute(offsets_m: [f64; 3]) -> Scorecard {
        minute_from(offsets_m, None)
    }

    /// The same, from this second on measured from the lane.
    fn minute_from(offsets_m: [f64; 3], lane_from_s: Option<u64>) -> Scorecard {
        let mut scorer = Scorer::default().of_kind(RunKind::RecordedPath);
        scorer.event(Duration::ZERO, &EventRecord::recorded_path("data", 268.0, 14, 1.0));
        for second in 0..=60 {
            let at = Duration::from_secs(second);
            if lane_from_s == Some(second) {
                let (line, edge) = (MeasuredLine::Lane, LimitEdge::Road);
                scorer.event(at, &EventRecord::MeasuredFrom { line, edge, left_m: -3.0, right_m: 3.0 });
            }
            if let Some(offset_m) = [20, 40, 60].iter().position(|put| *put == second).map(|i| offsets_m[i]) {
                scorer.event(at, &EventRecord::OffRoad { offset_m });
                scorer.event(at, &EventRecord::Reset { waypoint: 0 });
            }
            let truth = Truth { cte: Some(Metres::constant(0.5)), waypoint: Some(0), ..Truth::default() };
            scorer.telemetry(
                at,
                &Telemetry {
                    steering: Default::default(),
                    throttle: Default::default(),
                    speed: Mph::constant(10.0),
                    image: Default::default(),
                    truth,
                },
            );
        }
        scorer.event(Duration::from_secs(60), &EventRecord::RunEnded { why: "the recording ends".into() });
        scorer.finish()
    }

    #[test]
    fn what_a_recording_does_not_have_is_not_measurable_and_no_threshold_passes_for_it() {
        let card = minute([1.1, -1.2, 1.3]);
        for (figure, why) in [
            (Figure::Collisions, "not measurable: a recording has no obstacles to hit"),
            (Figure::CollisionRate, "not measurable: a recording has no obstacles to hit"),
            (Figure::DrivingScore, "not measurable: a recording has no obstacles to hit"),
            (Figure::Completion, "not measurable: a recording has no laps"),
            (Figure::Laps, "not measurable: a recording has no laps"),
            (Figure::OffRoads, "not measurable: a recording does not report where the road ends"),
            (Figure::OffRoadShare, "not measurable: a recording does not report where the road ends"),
            (Figure::Stuck, "not measurable: the car goes at the recorded speed"),
            (Figure::RmsJerk, "not measurable: the car goes at the recorded speed"),
            (Figure::Comfort, "not measurable: the car goes at the recorded speed"),
        ] {
            assert_eq!(card.words(figure), why, "{}", figure.key());
        }
        assert_eq!(card.notes, [NOTE]);
        let limits = Thresholds { max_collisions: Some(0), max_off_road: Some(9), ..Default::default() };
        assert_eq!(missed(&limits, &card).len(), 2);
    }

    #[test]
    fn a_table_of_runs_has_interventions_and_large_offsets_if_one_went_along_a_recording() {
        let run = |card: Scorecard| {
            let header =
                RunHeader::new(RunKind::Driven, serde_json::json!({}), "2026-11-26T12:00:00Z".parse().unwrap());
            JudgedRun { path: "run.mcap".into(), header, card, checks: vec![] }
        };
        let cells = |runs: [JudgedRun; 2]| {
            let runs: Vec<_> = runs.iter().collect();
            Report::new(&runs, &[], None)
                .rows()
                .0
                .into_iter()
                .map(|row| row[row.len() - 3..].to_vec())
                .collect::<Vec<_>>()
        };
        let driven = || Scorer::default().finish();
        let told = cells([run(driven()), run(minute([1.1, -1.2, 2.3]))]);
        assert_eq!(told[0], ["interventions", "beyond 1 m", "beyond 2 m"]);
        assert_eq!(
            (&told[1][1..], &told[2][..]),
            (&["-".to_owned(), "-".to_owned()][..], &["3", "2.5 %", "0.8 %"].map(str::to_owned)[..])
        );
        assert!(!cells([run(driven()), run(driven())])[0].contains(&"beyond 1 m".to_owned()));
    }

    #[test]
    fn what_is_known_along_a_recording_stays() {
        let card = minute([1.1, -1.2, 1.3]);
        let counts = [Figure::Interventions, Figure::Resets, Figure::Episodes].map(|figure| card.value(figure));
        assert_eq!(counts, [Some(3.0), Some(3.0), Some(4.0)]);
        assert!((card.value(Figure::Autonomy).unwrap() - 0.7).abs() < 1e-9, "{card}");
        assert_eq!((card.value(Figure::TimeS), card.value(Figure::SteeringRate)), (Some(60.0), Some(0.0)));
        assert!((card.value(Figure::MeanMph).unwrap() - 10.0).abs() < 1e-9, "{card}");
    }

    #[test]
    fn the_card_says_what_offsets_are_measured_from_and_for_how_much_of_the_time_they_were_large() {
        let path = minute([1.1, -1.2, 2.3]);
        assert_eq!(path.value(Figure::FromLane), Some(0.0));
        let all = "the lane's middle along 0.0 % of the way, the recorded path along 100.0 %";
        assert!(path.known_rows().contains(&("measured from", all.into())), "{path}");
        assert!(path.words(Figure::OffRoads).ends_with("a recording does not report where the road ends"));
        // Half a second before each of the three; one of them was beyond 2 m.
        assert_eq!(path.value(Figure::Beyond1m), Some(1.5 / 60.0));
        assert_eq!(path.value(Figure::Beyond2m), Some(0.5 / 60.0));
        // 10 mph for a minute.
        assert!((path.value(Figure::InterventionsPerKm).unwrap() - 3.0 / 0.26822).abs() < 0.01, "{path}");
        let lane = minute_from([1.1, -1.2, 2.3], Some(15));
        assert!((lane.value(Figure::FromLane).unwrap() - 46.0 / 60.0).abs() < 1e-9, "{lane}");
        assert!(lane.words(Figure::OffRoads).contains("see interventions"), "{lane}");
        assert_eq!(lane.notes, [NOTE]);
        assert_eq!(path.notes, [NOTE]);
        let mixed = minute_from([1.1, -1.2, 2.3], Some(30));
        assert_eq!(mixed.notes, [NOTE.to_owned(), put_by_path(1, 3)]);
        let driven = Scorer::default().finish();
        assert_eq!(driven.value(Figure::FromLane), None);
    }

    #[test]
    fn where_no_lane_is_known_the_card_says_so_if_the_limit_is_the_road() {
        let notes = |edge_m: f64| {
            let mut scorer = Scorer::default().of_kind(RunKind::RecordedPath);
            scorer.event(Duration::ZERO, &EventRecord::recorded_path("data", 268.0, 14, edge_m));
            let (line, edge) = (MeasuredLine::RecordedPath, LimitEdge::Metres);
            scorer.event(Duration::ZERO, &EventRecord::MeasuredFrom { line, edge, left_m: -1.0, right_m: 1.0 });
            scorer.event(Duration::from_secs(1), &EventRecord::OffRoad { offset_m: 1.1 });
            scorer.finish().notes
        };
        assert!(notes(3.35).contains(&put_by_path(1, 1)), "{:?}", notes(3.35));
        assert!(!notes(1.0).contains(&put_by_path(1, 1)), "the metres that were asked for");
    }

    #[test]
    fn an_offset_at_which_the_car_was_put_back_counts_with_those_of_the_telemetries() {
        // 61 telemetries at 0.5 m, and three that no telemetry shows.
        let card = minute([1.0, -1.5, 2.0]);
        let close = |figure: Figure, expected: f64| {
            assert!((card.value(figure).unwrap() - expected).abs() < 1e-9, "{}: {card}", figure.key());
        };
        close(Figure::MaxCte, 2.0);
        close(Figure::MeanCte, (61.0 * 0.5 + 4.5) / 64.0);
        close(Figure::RmsCte, ((61.0 * 0.25 + 1.0 + 2.25 + 4.0) / 64.0f64).sqrt());
        close(Figure::P95Cte, 0.5);
        // A damaged file says anything.
        let card = minute([f64::NAN, 1e308, 1.0]);
        assert!(serde_json::to_string(&card).is_ok(), "{card}");
    }
}
