//! The driver with pilots that say what a test wants.

use std::{
    sync::LazyLock,
    time::{Duration, Instant},
};

use lapwing_core::{
    config::{ControlSettings, SpeedLaw, Takeover},
    driver::Driver,
    pilot::{ConstantPilot, Pilot, PilotError, Prediction, PurePursuit, View},
    protocol::{Answer, CameraImage, Observation, Sight, Telemetry, TelemetryError, Truth},
    turn::{By, EventRecord},
    units::{Degrees, Mph, PathPoint, Steering, Throttle},
};
use lapwing_sim::{
    expert::path_ahead,
    track::Track,
    vehicle::{Car, Ground, STEP_S},
};

use crate::support::jpeg;

/// A clock that stands: what is measured with it is zero, whatever the machine does.
fn frozen() -> Instant {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    *START
}

fn driver(control: ControlSettings) -> Driver {
    Driver::new(Box::new(ConstantPilot::new(Steering::new(0.25).unwrap())), &control, frozen)
}

fn seen(at_ms: u64, mph: f64, image: CameraImage) -> Observation {
    let telemetry = Telemetry {
        steering: Degrees::ZERO,
        throttle: Throttle::ZERO,
        speed: Mph::new(mph).unwrap(),
        image,
        truth: Truth::default(),
    };
    Observation { at: Duration::from_millis(at_ms), sight: Sight::Telemetry(telemetry) }
}

fn good(at_ms: u64, mph: f64) -> Observation {
    seen(at_ms, mph, CameraImage::Jpeg(jpeg(80).into()))
}

fn bad(at_ms: u64, mph: f64) -> Observation {
    seen(at_ms, mph, CameraImage::Base64("no".into()))
}

fn human(at_ms: u64) -> Observation {
    Observation { at: Duration::from_millis(at_ms), sight: Sight::HumanDrives }
}

fn command(answer: Answer) -> (f64, f64) {
    match answer {
        Answer::Steer(command) => (command.steering.get(), command.throttle.get()),
        Answer::Manual => panic!("manual"),
    }
}

#[test]
fn a_good_frame_becomes_the_pilots_steering_and_the_controllers_throttle() {
    let (answer, trace) = driver(ControlSettings::default()).drive(&good(0, 0.0));
    assert_eq!(command(answer), (0.25, 0.918));
    assert_eq!((trace.by, trace.prediction), (By::Pilot, Some(0.25)));
    let throttle = trace.throttle.unwrap();
    assert_eq!((throttle.p, throttle.i, throttle.saturated), (0.1 * 9.0, 0.002 * 9.0, false));
    assert_eq!(trace.total, Duration::ZERO, "the driver has no clock of its own");
}

#[test]
fn the_quadratic_law_sees_the_steering_about_to_be_commanded() {
    let control = ControlSettings {
        speed_law: SpeedLaw::Quadratic,
        speed_mph: Mph::new(20.0).unwrap(),
        ..ControlSettings::default()
    };
    assert_eq!(command(driver(control).drive(&good(0, 10.0)).0), (0.25, 1.0 - 0.0625 - 0.25));
}

#[test]
fn the_same_observations_give_the_same_answers() {
    let answers = || {
        let mut driver = driver(ControlSettings::default());
        (0..50).map(|i| driver.drive(&good(i * 66, i as f64 / 4.0)).0).collect::<Vec<_>>()
    };
    assert_eq!(answers(), answers());
}

#[test]
fn a_reset_driver_answers_like_a_new_one() {
    let mut driver = driver(ControlSettings::default());
    for i in 0..20 {
        driver.drive(&good(i * 66, 3.0));
    }
    driver.reset();
    assert_eq!(command(driver.drive(&good(0, 0.0)).0), (0.25, 0.918));
}

#[test]
fn a_reset_driver_has_forgotten_the_human_too() {
    let mut driver = driver(ControlSettings { takeover: Takeover::Latch, ..ControlSettings::default() });
    driver.drive(&human(0));
    driver.reset();
    assert!(!driver.human_drives());
    let (answer, trace) = driver.drive(&good(0, 0.0));
    assert_eq!((command(answer), trace.by, trace.events), ((0.25, 0.918), By::Pilot, vec![]));
}

#[test]
fn a_takeover_has_a_beginning_an_end_and_a_duration() {
    let mut driver = driver(ControlSettings::default());
    driver.drive(&good(0, 4.0));
    let (answer, trace) = driver.drive(&human(1000));
    assert_eq!((answer, trace.events), (Answer::Manual, vec![EventRecord::TakeoverBegan]));
    assert_eq!(driver.drive(&human(2000)).1.events, []);
    let (answer, trace) = driver.drive(&good(3500, 4.0));
    let ended = EventRecord::TakeoverEnded { duration_s: 2.5 };
    assert_eq!((command(answer).1, trace.events), (0.52, vec![ended]));
}

#[test]
fn latched_the_driver_answers_nothing_but_coasting_until_armed() {
    let mut driver = driver(ControlSettings { takeover: Takeover::Latch, ..ControlSettings::default() });
    driver.drive(&human(0));
    let (answer, trace) = driver.drive(&good(1000, 4.0));
    assert_eq!((command(answer), trace.by), ((0.0, 0.0), By::Off));
    let why = "a human drove; the pilot waits to be armed".to_owned();
    assert_eq!(trace.events, [EventRecord::TakeoverEnded { duration_s: 1.0 }, EventRecord::PilotOff { why }]);
    assert!(trace.jpeg.is_some(), "what is seen is still recorded");
    assert!(driver.arm());
    assert_eq!(command(driver.drive(&good(1066, 4.0)).0), (0.25, 0.51));
    assert!(!driver.arm(), "it is armed already");
}

#[test]
fn four_bad_frames_coast_and_the_fifth_brakes() {
    let mut driver = driver(ControlSettings::default());
    driver.drive(&good(0, 12.0));
    let mut throttles = vec![];
    for i in 1..=6 {
        let (answer, trace) = driver.drive(&bad(i * 66, 12.0));
        assert_eq!((command(answer).0, trace.by), (0.25, By::Safe), "steering stays");
        assert!(
            matches!(&trace.events[0], EventRecord::BadFrame { count_in_row, .. } if u64::from(*count_in_row) == i)
        );
        throttles.push(command(answer).1);
    }
    assert_eq!(throttles, [0.0, 0.0, 0.0, 0.0, -1.0, -1.0]);
    assert!(command(driver.drive(&good(500, 4.0)).0).1 > 0.0);
    assert_eq!(command(driver.drive(&bad(566, 12.0)).0).1, 0.0, "and the count begins anew");
}

#[test]
fn telemetry_without_a_speed_is_braked_by_the_last_speed_known() {
    let unreadable = |at_ms| Observation {
        at: Duration::from_millis(at_ms),
        sight: Sight::Unreadable(TelemetryError::Missing("speed")),
    };
    let throttles = |mph: f64| -> Vec<f64> {
        let mut driver = driver(ControlSettings::default());
        driver.drive(&good(0, mph));
        (1..=20).map(|i| command(driver.drive(&unreadable(i * 100)).0).1).collect()
    };
    // From the fifth on, at 500 ms: 25 mph at 1 g, 21.9 mph a second, take 1.14 s.
    let fast = throttles(30.0);
    assert_eq!((&fast[..4], &fast[4..16], &fast[16..]), (&[0.0; 4][..], &[-1.0; 12][..], &[0.0; 4][..]));
    assert_eq!(throttles(4.0), [0.0; 20], "braking would reverse it");
}

/// A pilot that fails.
struct Failing;

impl Pilot for Failing {
    fn steer(&mut self, _: &View<'_>) -> Result<Prediction, PilotError> {
        Err(PilotError::NotFinite { output: "steering".into(), got: f64::NAN })
    }
    fn reset(&mut self) {}
}

#[test]
fn a_pilot_that_fails_is_a_bad_frame_and_not_the_end() {
    let mut driver = Driver::new(Box::new(Failing), &ControlSettings::default(), frozen);
    let (answer, trace) = driver.drive(&good(0, 5.0));
    assert_eq!((command(answer), trace.by), ((0.0, 0.0), By::Safe));
    assert!(matches!(&trace.events[0], EventRecord::BadFrame { why, .. } if why.starts_with("pilot: ")));
}

/// A straight line, its points a metre apart, that bends at the end.
fn path() -> Vec<PathPoint> {
    let point =
        |i: u32| PathPoint { ahead_m: i.into(), right_m: 0.0, curvature_per_m: if i == 40 { 0.1 } else { 0.0 } };
    (0..=40).map(point).collect()
}

#[test]
fn a_pilot_that_knows_the_line_needs_no_picture_and_holds_the_speed_below_its_limit() {
    let control = ControlSettings { speed_mph: Mph::new(60.0).unwrap(), ..ControlSettings::default() };
    let mut driver = Driver::new(Box::new(PurePursuit::default()), &control, frozen);
    let mut observation = seen(0, 35.0, CameraImage::Jpeg("no picture".into()));
    let Sight::Telemetry(telemetry) = &mut observation.sight else { unreachable!() };
    telemetry.truth.path = path();
    // 4 m/s² sideways in a bend of 10 m, 3 m/s² over the 40 m before it: v² = 40 + 240 (m/s)².
    let limit = 280f64.sqrt() / 0.447_04;
    let (answer, trace) = driver.drive(&observation);
    assert_eq!((command(answer).0, trace.by), (0.0, By::Pilot));
    assert!((command(answer).1 - 0.1 * (limit - 35.0)).abs() < 1e-9, "{answer:?}, expected {limit} mph to be held");

    let (_, trace) = driver.drive(&good(66, 20.0));
    let EventRecord::BadFrame { why, .. } = &trace.events[0] else { panic!("{trace:?}") };
    assert!(why.contains("lapwing drive"), "a world without a path: {why}");
}

#[test]
fn the_path_is_neither_recorded_nor_something_told() {
    let truth = Truth { path: path(), ..Truth::default() };
    assert!(truth.is_empty());
    assert_eq!(serde_json::to_string(&truth).unwrap(), "{}");
}

#[test]
fn the_driver_laps_every_track_by_the_line_it_is_told() {
    for (name, mph) in [("lake", 30.0), ("jungle", 20.0), ("mountain", 30.0), ("random:1", 30.0)] {
        let track = Track::open(name).unwrap();
        let control = ControlSettings { speed_mph: Mph::new(mph).unwrap(), ..ControlSettings::default() };
        let mut driver = Driver::new(Box::new(PurePursuit::default()), &control, frozen);
        let start = track.driving_line()[0];
        let mut car = Car { position: start.position, yaw: start.yaw, ..Car::default() };
        let mut place = track.locate(car.position, None);
        let (mut gone, mut steps, mut answer) = (0.0, 0u32, Answer::Steer(lapwing_core::protocol::Command::default()));
        while gone < track.length() {
            let Answer::Steer(command) = answer else { panic!("{answer:?}") };
            // Each 60 ms a telemetry, whose answer takes effect with the next one.
            let mut observation = seen(u64::from(steps) * 20, car.speed / 0.447_04, CameraImage::default());
            let Sight::Telemetry(telemetry) = &mut observation.sight else { unreachable!() };
            path_ahead(&track, &place, &car, &mut telemetry.truth.path);
            answer = driver.drive(&observation).0;
            for _ in 0..3 {
                let station = place.station;
                car.step(command, Ground { height: station.position.y, grade: station.grade, grip: 1.0 });
                let next = track.locate(car.position, Some(station.s));
                let moved = track.ahead(station.s, next.station.s);
                gone += if moved > track.length() / 2.0 { moved - track.length() } else { moved };
                place = next;
                steps += 1;
            }
            let beyond = place.offset.abs() - track.half_width();
            assert!(beyond < -1.2, "{name} at {:.0} m: {beyond:.2} m beyond the edge", place.station.s);
            assert!(f64::from(steps) * STEP_S < 240.0, "{name}: too slow, {gone:.0} m in 4 minutes");
        }
    }
}
