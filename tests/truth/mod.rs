//! What the bridge records of a drive is judged as the world itself judges it: every dialect, at the pace of the clock on the
//! wall and as fast as it is answered, finished, crashed and taken over; its summary and `score` alike.

mod drive;
mod summary;

use std::{collections::BTreeMap, time::Duration};

use drive::{Case, How, Played, Speaks, loop_road, play};
use futures_util::future::join_all;
use lapwing_core::recording::Recording;
use lapwing_score::score::{self, Figure as F, Measure, Scorecard, Scorer};
use tempfile::tempdir;

use crate::support::{Running, settings};

/// Plays all of these at once; each drive with the scorecard of its run's file.
async fn played(cases: &[Case]) -> Vec<(Played, Scorecard)> {
    let dir = tempdir().unwrap();
    let (track, road) = loop_road(dir.path());
    let running = Running::start(settings(dir.path())).await;
    running.bridge.roads_are_known(vec![road.clone()]);
    let drives = join_all(cases.iter().map(|case| play(running.address, track.clone(), *case))).await;
    let summaries: BTreeMap<_, _> =
        running.stop().await.into_iter().map(|summary| (summary.simulator.clone(), summary)).collect();
    let judged = |mut drive: Played| {
        let summary = summaries[&drive.peer].clone();
        let path = summary.run.as_ref().unwrap().path.clone();
        assert_eq!(summary.run.as_ref().unwrap().not_recorded, 0);
        let mut run = Recording::open(&path).unwrap();
        assert_eq!(run.header().dialect, summary.dialect, "{:?}", drive.case);
        let card = score::of_recording(&mut run, Scorer::on(std::slice::from_ref(&road), Some(1)), |_, _| ()).unwrap();
        drive.summary = Some(summary);
        (drive, card)
    };
    drives.into_iter().map(judged).collect()
}

/// The same in real time. What a machine that is too busy for it plays, says nothing: it plays again.
async fn punctually(cases: &[Case]) -> Vec<(Played, Scorecard)> {
    for _ in 0..5 {
        let all = played(cases).await;
        if all.iter().all(|(drive, _)| drive.late < PUNCTUAL) {
            return all;
        }
    }
    panic!("the machine is too busy: five times a message was sent {PUNCTUAL:?} too late");
}

/// How late a message may be sent.
const PUNCTUAL: Duration = Duration::from_millis(120);

/// How far off a figure of a run may be from the world's own: a share of it, and so much besides.
const HELD: [(F, f64, f64); 14] = [
    (F::TimeS, 0.01, 0.25),
    (F::DistanceM, 0.02, 1.0),
    (F::MeanMph, 0.02, 0.1),
    (F::MaxMph, 0.01, 0.1),
    (F::Laps, 0.0, 0.0),
    (F::Completion, 0.0, 0.12), // a waypoint of nine
    (F::Collisions, 0.0, 0.0),
    (F::OffRoads, 0.0, 0.0),
    (F::Takeovers, 0.0, 0.0),
    (F::HumanS, 0.0, 0.25),
    (F::MeanCte, 0.02, 0.01),
    (F::MaxCte, 0.01, 0.01),
    (F::SteeringRate, 0.1, 0.3),
    (F::SurvivalS, 0.01, 1.0),
];

fn hold(drive: &Played, card: &Scorecard, figures: impl Fn(F) -> bool) {
    let truth = &drive.truth;
    let told = |figure: F, share: f64, off: f64, card: &Scorecard, whose: &str| {
        let (Some(expected), Some(got)) = (truth.value(figure), card.value(figure)) else { return };
        let off = off + share * expected.abs();
        assert!(
            (got - expected).abs() <= off + 1e-9,
            "{:?}: {whose}: {}: expected {expected}, got {got}\nthe world:\n{truth}\nthe run:\n{card}",
            drive.case,
            figure.key(),
        );
    };
    for (figure, share, off) in HELD.into_iter().filter(|(figure, ..)| figures(*figure)) {
        told(figure, share, off, card, "score");
        told(figure, share, off, &drive.summary.as_ref().unwrap().card, "summary");
    }
}

/// Figures that the stock build's run has, at least.
const STOCK: [F; 12] = [
    F::Completion,
    F::Laps,
    F::Collisions,
    F::TimeS,
    F::DistanceM,
    F::MeanMph,
    F::MaxMph,
    F::Takeovers,
    F::HumanS,
    F::SteeringRate,
    F::Stuck,
    F::SurvivalS,
];

fn has(drive: &Played, card: &Scorecard, figures: &[F]) {
    for figure in figures {
        assert!(card.value(*figure).is_some(), "{:?}: {}: {card}", drive.case, card.words(*figure));
    }
}

/// What the summary shows and the scorecard of the file shows, is the same.
fn alike(drive: &Played, card: &Scorecard) {
    let summary = &drive.summary.as_ref().unwrap().card;
    for figure in F::ALL {
        // Looked for in pictures, and on roads that it seems to be, by `score` alone.
        let is_estimate = |card: &Scorecard| matches!(card.get(figure), Measure::Estimate { .. });
        if summary.value(figure).is_some() && (is_estimate(summary) || !is_estimate(card)) {
            assert_eq!(summary.get(figure), card.get(figure), "{:?}: {}\n{card}", drive.case, figure.key());
        }
    }
    assert_eq!(summary.latency, card.latency);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_at_the_walls_clock_is_judged_as_the_world_judges_it_in_every_dialect() {
    let real = |speaks, how| Case { speaks, how, realtime: true };
    let mut cases = vec![];
    for speaks in [Speaks::SelfOracle, Speaks::WholeSeconds, Speaks::Stock] {
        cases.extend(
            [How::Finished, How::Crashed, How::TakenOver, How::TakenToTheEnd, How::HumanFirst]
                .map(|how| real(speaks, how)),
        );
    }
    cases.extend([Speaks::Term2Pid, Speaks::Positioned, Speaks::Gym].map(|speaks| real(speaks, How::Finished)));
    cases.extend([Speaks::Positioned, Speaks::Gym].map(|speaks| real(speaks, How::Crashed)));
    for (drive, card) in punctually(&cases).await {
        let Case { how, speaks, .. } = drive.case;
        // Who was put into the car at the start of the run, or who is driven to its end unseen, has come further than told.
        let unseen = matches!(how, How::TakenToTheEnd | How::HumanFirst);
        // When messages come is not when the wheel turned, least of all on a busy machine.
        let jitters = speaks != Speaks::SelfOracle;
        hold(&drive, &card, |figure| {
            let further = [F::Laps, F::Completion, F::DistanceM, F::MeanMph, F::MaxMph, F::MeanCte, F::SteeringRate];
            let is_left_out = (jitters && figure == F::SteeringRate) || (unseen && further.contains(&figure));
            !is_left_out
        });
        if !unseen {
            has(&drive, &card, &STOCK);
        }
        alike(&drive, &card);
        if speaks == Speaks::SelfOracle && !unseen {
            let richer = [
                F::MeanCte,
                F::P95Cte,
                F::OffRoads,
                F::OffRoadS,
                F::Resets,
                F::Interventions,
                F::Autonomy,
                F::DrivingScore,
            ];
            has(&drive, &card, &richer);
        }
        if how == How::Finished {
            let (told, truth) = (&card.lap_times_s, &drive.truth.lap_times_s);
            assert_eq!(told.len(), 1, "{:?}: {card}", drive.case);
            assert!((told[0] - truth[0]).abs() < 1.0, "{:?}: {told:?}, in truth {truth:?}", drive.case);
        }
        if unseen {
            let human_s = drive.truth.value(F::HumanS).unwrap();
            assert!(human_s > 2.0 && card.value(F::HumanS).is_some(), "{:?}: {card}", drive.case);
        }
        assert!(
            F::ALL.iter().all(|figure| card.value(*figure).is_none_or(|value| value >= 0.0)),
            "{:?}: {card}",
            drive.case
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_as_fast_as_it_is_answered_is_timed_by_the_simulators_clock() {
    let fast = |speaks, how| Case { speaks, how, realtime: false };
    let hows = [How::Finished, How::Crashed, How::TakenOver, How::TakenToTheEnd, How::HumanFirst];
    for (drive, card) in played(&hows.map(|how| fast(Speaks::SelfOracle, how))).await {
        let unseen = matches!(drive.case.how, How::TakenToTheEnd | How::HumanFirst);
        hold(&drive, &card, |figure| {
            let of_all = [
                F::Laps,
                F::Completion,
                F::TimeS,
                F::DistanceM,
                F::MeanMph,
                F::MaxMph,
                F::MeanCte,
                F::SteeringRate,
                F::SurvivalS,
            ];
            !(unseen && of_all.contains(&figure))
        });
        alike(&drive, &card);
        if unseen {
            // Nobody told what the clock was then.
            assert!(card.words(F::HumanS).contains("the simulator's clock"), "{:?}: {card}", drive.case);
        } else {
            has(&drive, &card, &STOCK);
        }
    }
    // Without a clock of its own nothing that takes the time is known; what is counted is.
    for (drive, card) in
        played(&[Speaks::Gym, Speaks::Positioned, Speaks::Term2Pid].map(|speaks| fast(speaks, How::TakenOver))).await
    {
        hold(&drive, &card, |figure| [F::Takeovers, F::MeanCte, F::MaxCte, F::MaxMph].contains(&figure));
        alike(&drive, &card);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_figure_that_is_not_told_says_why_and_does_not_speak_of_another_build() {
    let case = Case { speaks: Speaks::SelfOracle, how: How::Finished, realtime: false };
    let (_, card) = played(&[case]).await.remove(0);
    for figure in F::ALL {
        let words = card.words(figure);
        assert!(!words.contains("stock build") && !words.contains("no position"), "{}: {words}", figure.key());
    }
}
