use std::time::{Duration, Instant};

use bytes::Bytes;

use super::*;
use lapwing_core::{
    config::{ControlSettings, SpeedLaw},
    driver::{Driver, Hands},
    pilot::ConstantPilot,
    protocol::{Answer, CameraImage, Command, Dialect, Observation, Sight, Telemetry, Truth},
    turn::{EventRecord, Trace, Turn},
    units::{Degrees, Mph, Steering, Throttle},
};
use lapwing_score::score::Scorer;

fn pilot(steering: f64) -> Box<dyn Pilot> {
    Box::new(ConstantPilot::new(Steering::saturating(steering)))
}

fn driver() -> Driver {
    Driver::new(pilot(0.0), &ControlSettings::default(), Instant::now)
}

fn page() -> Arc<Page> {
    let page = Page::new();
    let choice = |name: &str, steering| PilotChoice {
        name: name.into(),
        sha256: None,
        make: Box::new(move || pilot(steering)),
        explaining: Explaining::not("it always steers alike"),
    };
    page.has_pilots(vec![choice("left", -0.5), choice("right", 0.5)]);
    page
}

fn turn(second: u64, jpeg: &'static [u8]) -> Turn {
    let telemetry = Telemetry {
        steering: Degrees::ZERO,
        throttle: Throttle::ZERO,
        speed: Mph::constant(9.0),
        image: CameraImage::Jpeg(Bytes::from_static(jpeg)),
        truth: Truth::default(),
    };
    Turn {
        observation: Observation { at: Duration::from_secs(second), sight: Sight::Telemetry(telemetry) },
        answer: Answer::Steer(Command::default()),
        trace: Trace { jpeg: Some(Bytes::from_static(jpeg)), ..Trace::default() },
        latency: Some(Duration::from_micros(800)),
    }
}

fn ask(page: &Page, drive: u64, json: &str) -> Result<(), Refused> {
    page.drive(drive)?.ask(page, Control::read(json.as_bytes())?)
}

#[tokio::test]
async fn a_drive_is_on_the_page_for_as_long_as_it_is_shown_and_its_counts_stay() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    showing.run_begins(Some(Dialect::Term1), &ControlSettings::default());
    for second in 0..5 {
        showing.turn(&turn(second, b"jpeg"), Hands::Pilot, Instant::now());
    }
    let now = page.drive(1).unwrap().now();
    assert_eq!((now.turn.unwrap().n, now.counts.messages), (5, 5));
    assert!(metrics::text(&page).await.unwrap().contains("lapwing_messages_total 5\n"));
    drop(showing);
    assert_eq!(page.drive(1).err(), Some(Refused::Gone(1)));
    let text = metrics::text(&page).await.unwrap();
    assert!(text.contains("lapwing_messages_total 5\n") && text.contains("lapwing_drives 0\n"), "{text}");
    assert!(text.contains("lapwing_latency_seconds_bucket{le=\"0.001\",stage=\"answer\"} 5\n"), "{text}");
    assert!(text.contains("lapwing_latency_seconds_bucket{le=\"+Inf\",stage=\"answer\"} 5\n"), "{text}");
}

#[tokio::test]
async fn what_several_runs_of_a_drive_lost_adds_up() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    let file = |not_recorded| Some(RunFileStatus { name: Some("run.mcap".into()), not_recorded, trouble: None });
    let now = Instant::now();
    for (lost, lost_at_the_end) in [(3, 5), (0, 2)] {
        showing.run_begins(Some(Dialect::Term1), &ControlSettings::default());
        showing.is_written(now, || file(lost));
        showing.is_written(now, || panic!("it is asked for once a second"));
        showing.turn(&turn(0, b"jpeg"), Hands::Pilot, now);
        showing.has_lost(lost_at_the_end);
        assert!(metrics::text(&page).await.unwrap().contains("lapwing_run_being_written{drive=\"1\"} 1.0\n"));
    }
    showing.run_ended();
    assert!(!metrics::text(&page).await.unwrap().contains("lapwing_run_being_written"), "there is no run");
    drop(showing);
    let text = metrics::text(&page).await.unwrap();
    assert!(text.contains("lapwing_not_recorded_total 7\n"), "{text}");
}

#[tokio::test]
async fn the_stages_of_a_network_are_counted_where_a_network_drove() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    for (second, forward) in [(0, Duration::ZERO), (1, Duration::ZERO), (2, Duration::from_millis(2))] {
        let turn = turn(second, b"jpeg");
        let trace = Trace { prediction: Some(0.1), forward, ..turn.trace };
        showing.turn(&Turn { trace, ..turn }, Hands::Pilot, Instant::now());
    }
    let text = metrics::text(&page).await.unwrap();
    for (stage, times) in [("decode", 1), ("preprocess", 1), ("forward", 1), ("driver", 3), ("answer", 3)] {
        let line = format!("lapwing_latency_seconds_count{{stage=\"{stage}\"}} {times}\n");
        assert!(text.contains(&line), "{line}{text}");
    }
}

#[test]
fn who_looks_sees_the_newest_moment_and_none_of_those_before() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    let mut newest = page.drive(1).unwrap().newest.subscribe();
    for second in 0..100 {
        showing.turn(&turn(second, b"jpeg"), Hands::Pilot, Instant::now());
    }
    assert!(newest.has_changed().unwrap());
    assert_eq!(newest.borrow_and_update().turn.unwrap().n, 100);
    assert!(!newest.has_changed().unwrap());
}

#[test]
fn what_is_asked_for_acts_once_and_is_told_as_events() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    let (mut driver, now) = (driver(), Instant::now());
    assert_eq!(showing.direct(&mut driver, now), []);
    for json in [
        r#"{"control":"set-speed","mph":12.5}"#,
        r#"{"control":"set-speed","mph":12.5}"#,
        r#"{"control":"speed-law","law":"quadratic"}"#,
        r#"{"control":"pilot","index":1}"#,
        r#"{"control":"stop"}"#,
        r#"{"control":"end-run"}"#,
    ] {
        ask(&page, 1, json).unwrap();
    }
    let expected = [
        EventRecord::SpeedSet { mph: 12.5 },
        EventRecord::SpeedLawSet { law: "quadratic".into() },
        EventRecord::PilotSet { name: "right".into(), sha256: None },
        EventRecord::EmergencyStop,
    ];
    assert_eq!(showing.direct(&mut driver, now), expected);
    assert_eq!(showing.direct(&mut driver, now), []);
    assert_eq!((driver.hands(), driver.settings().speed_law), (Hands::Stopped, SpeedLaw::Quadratic));
    assert_eq!((showing.others(), showing.others()), (vec![Control::EndRun], vec![]));
    assert_eq!(showing.settings().unwrap().speed_mph, Mph::constant(12.5));
}

#[test]
fn a_run_that_has_ended_is_not_armed_and_the_refusal_says_what_begins_another() {
    let page = page();
    let arm = r#"{"control":"arm"}"#;
    let kinds = [(Abilities::of_the_simulator(true), "Reset"), (Abilities::of_a_connection(), "Start")];
    for (id, (can, how)) in (1..).zip(kinds) {
        let mut showing = page.show("a simulator", can);
        showing.run_begins(None, &ControlSettings::default());
        assert_eq!(ask(&page, id, arm), Ok(()));
        showing.run_ended();
        let refused = Refused::Cannot(format!("the run has ended: {how} begins another"));
        assert_eq!(ask(&page, id, arm), Err(refused));
        showing.run_begins(None, &ControlSettings::default());
        assert_eq!(ask(&page, id, arm), Ok(()));
    }
}

#[test]
fn a_box_that_a_page_holds_is_found_at_the_next_frame() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    ask(&page, 1, r#"{"control":"stop"}"#).unwrap();
    let drive = page.drive(1).unwrap();
    let (mut driver, began) = (driver(), Instant::now());
    drive.while_held(|| assert_eq!(showing.direct(&mut driver, began), []));
    assert!(began.elapsed() < Duration::from_secs(1), "it did not wait");
    assert_eq!(showing.direct(&mut driver, began), [EventRecord::EmergencyStop]);
}

#[test]
fn a_page_that_falls_silent_has_let_go_of_the_wheel() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    let (mut driver, drive) = (driver(), page.drive(1).unwrap());
    let command = Command { steering: Steering::MAX, throttle: Throttle::MAX };
    let mut steers = |showing: &mut Showing, now| {
        showing.direct(&mut driver, now);
        driver.drive(&turn(1, include_bytes!("../../../sim/src/starts/lake.jpg")).observation).0
    };
    assert!(drive.by_hand(1, Some(command)));
    let now = Instant::now();
    assert_eq!(steers(&mut showing, now), Answer::Steer(command));
    assert_ne!(steers(&mut showing, now + Duration::from_secs(1)), Answer::Steer(command));
    assert!(drive.by_hand(1, Some(command)));
    assert_eq!(steers(&mut showing, Instant::now()), Answer::Steer(command));
    assert!(drive.by_hand(1, None));
    assert_ne!(steers(&mut showing, Instant::now()), Answer::Steer(command));
}

#[test]
fn who_took_the_wheel_first_keeps_it_until_they_let_go() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    let (mut driver, drive) = (driver(), page.drive(1).unwrap());
    let [left, right] = [Steering::MIN, Steering::MAX].map(|steering| Command { steering, throttle: Throttle::MAX });
    let mut steers = || {
        showing.direct(&mut driver, Instant::now());
        driver.drive(&turn(1, include_bytes!("../../../sim/src/starts/lake.jpg")).observation).0
    };
    assert!(drive.by_hand(1, Some(left)) && !drive.by_hand(2, Some(right)));
    assert_eq!(steers(), Answer::Steer(left));
    assert!(!drive.by_hand(2, None), "who has no wheel lets go of none");
    assert_eq!(steers(), Answer::Steer(left));
    assert!(drive.by_hand(1, None) && drive.by_hand(2, Some(right)));
    assert_eq!(steers(), Answer::Steer(right));
}

#[test]
fn a_driver_that_takes_nothing_is_not_asked_for_ever() {
    let page = page();
    let _showing = page.show("a simulator", Abilities::of_a_connection());
    let refused = (0..100).rev().find_map(|_| ask(&page, 1, r#"{"control":"stop"}"#).err());
    assert_eq!(refused, Some(Refused::Busy(32)));
}

#[tokio::test]
async fn the_score_is_shown_once_a_second_to_those_who_look_and_to_others_when_they_ask() {
    let page = page();
    let mut showing = page.show("a simulator", Abilities::of_a_connection());
    let (began, drive) = (Instant::now(), page.drive(1).unwrap());
    let mut tenth = 0;
    let mut two_seconds = |showing: &mut Showing| {
        // They are kept, so that no two of them have one address.
        let mut scores: Vec<Arc<Scorer>> = vec![];
        for _ in 0..20 {
            tenth += 1;
            let now = began + Duration::from_millis(100 * tenth);
            showing.score(&Scorer::live(&[]), now);
            showing.turn(&turn(tenth, b"jpeg"), Hands::Pilot, now);
            scores.extend(drive.now().scorer.clone());
            scores.dedup_by(|a, b| Arc::ptr_eq(a, b));
        }
        scores.len()
    };
    assert_eq!(two_seconds(&mut showing), 0, "nobody looks");
    let looks = drive.newest.subscribe();
    assert!((2..=3).contains(&two_seconds(&mut showing)));
    drop(looks);
    assert_eq!(two_seconds(&mut showing), 1, "nobody looks any more");
    let old = drive.now().scorer.clone().unwrap();
    let (asked, shown) = tokio::join!(drive.scorer(), async { two_seconds(&mut showing) });
    assert!((1..=3).contains(&shown), "who waits looks, too: {shown}");
    assert!(asked.is_some_and(|new| !Arc::ptr_eq(&new, &old)), "who asks gets a new one");
}
