//! The headless simulator in closed loop: what drives, what ends a run, what is the same and what is told.

use std::{
    path::Path,
    process::Command as Process,
    sync::{Arc, OnceLock},
    time::{Duration, Instant},
};

use lapwing::known::Roads;
use lapwing_core::{
    config::{ControlSettings, OnCrash, Takeover},
    drive::{DriveDigest, Eventful},
    driver::Driver,
    perception::Frame,
    pilot::{ConstantPilot, Pilot, PilotError, Prediction, PurePursuit, View},
    protocol::{Answer, Command, Sight, World},
    recording::{EventRecord, Recorder, RecorderOptions, Recording, RecordingReport, RunHeader, RunKind, RunReader},
    units::{Mph, Steering, Throttle},
};
use lapwing_score::judged::{self, Judged};
use lapwing_score::score::{self, Figure, Measure, Scorer};
use lapwing_sim::{
    camera::Scenery,
    conditions::Conditions,
    scenario::Scenario,
    track::{Place, Track},
    vehicle::Car,
    world::{Ending, Eyes, Human, Setup, Simulation},
};

/// The lake and what stands along it, built once for all tests.
fn lake() -> (Arc<Track>, Arc<Scenery>) {
    static LAKE: OnceLock<(Arc<Track>, Arc<Scenery>)> = OnceLock::new();
    LAKE.get_or_init(|| open("lake")).clone()
}

fn open(name: &str) -> (Arc<Track>, Arc<Scenery>) {
    let track = Track::open(name).unwrap();
    let scenery = Arc::new(Scenery::new(&track));
    (Arc::new(track), scenery)
}

fn setup((track, scenery): (Arc<Track>, Arc<Scenery>)) -> Setup {
    Setup::new(track, scenery)
}

fn driver(pilot: impl Pilot + 'static, mph: f64) -> Driver {
    let control =
        ControlSettings { speed_mph: Mph::new(mph).unwrap(), takeover: Takeover::Resume, ..ControlSettings::default() };
    Driver::new(Box::new(pilot), &control, Instant::now)
}

/// Eyes that see next to nothing: where nobody looks, nothing need be drawn.
#[derive(Debug)]
struct Blind;

impl Eyes for Blind {
    fn see(&mut self, _: &Car, _: &Place, frame: &mut Frame) -> bool {
        frame.resize(16, 16);
        true
    }
}

/// A drive by a pilot that does not look.
fn driven(setup: Setup, pilot: impl Pilot + 'static, mph: f64) -> (Simulation, Judged) {
    played(Simulation::new(setup).unwrap().seen_by(Blind), pilot, mph)
}

fn played(mut world: Simulation, pilot: impl Pilot + 'static, mph: f64) -> (Simulation, Judged) {
    let drive = judged::run(&mut world, &mut driver(pilot, mph), &mut []).unwrap();
    (world, drive)
}

fn straight_on() -> ConstantPilot {
    ConstantPilot::new(Steering::ZERO)
}

#[test]
fn the_expert_drives_every_kind_of_road_without_leaving_it() {
    // Track, set speed in mph, largest mean |cte| in metres.
    for (name, mph, mean_cte) in [("lake", 30.0, 0.2), ("jungle", 20.0, 0.4), ("random:7", 30.0, 0.4)] {
        let (_, Judged { card, .. }) = driven(setup(open(name)), PurePursuit::default(), mph);
        assert_eq!(card.value(Figure::Completion), Some(1.0), "{name}: {card}");
        assert_eq!(
            (card.value(Figure::Collisions), card.value(Figure::OffRoads)),
            (Some(0.0), Some(0.0)),
            "{name}: {card}"
        );
        assert!(card.value(Figure::MeanCte).unwrap() < mean_cte, "{name}: {card}");
    }
}

#[test]
fn who_steers_straight_on_ends_beside_the_road() {
    let (world, Judged { card, .. }) = driven(setup(lake()), straight_on(), 15.0);
    assert!(matches!(world.ending(), Some(Ending::Lost | Ending::Collision(_))), "{:?}", world.ending());
    assert!(card.value(Figure::Completion).unwrap() < 0.2, "{card}");
    assert_eq!(card.value(Figure::OffRoads), Some(1.0), "{card}");
}

#[test]
fn after_a_crash_the_car_may_go_on_from_the_next_waypoint() {
    let setup = Setup { on_crash: OnCrash::Reset, longest_s: Some(120.0), ..setup(lake()) };
    let (world, Judged { card, .. }) = driven(setup, straight_on(), 20.0);
    assert_eq!(world.ending(), Some(&Ending::TimeOver));
    assert!(card.value(Figure::Resets).unwrap() >= 3.0, "{card}");
    assert_eq!(card.value(Figure::OffRoads), card.value(Figure::Resets), "{card}");
    assert!(card.value(Figure::Completion).unwrap() > 0.2, "{card}");
}

#[test]
fn a_car_that_is_told_to_stand_waits_for_as_long_as_the_world_allows() {
    // Why the run ended, and how often the car was stuck.
    let stood = |setup: Setup| {
        let mut world = Simulation::new(setup).unwrap().seen_by(Blind);
        let mut stuck = 0;
        loop {
            let seen = world.observe().unwrap();
            stuck += world.take_events().iter().filter(|(_, event)| *event == EventRecord::Stuck).count();
            if seen.is_none() {
                break (world.ending().cloned(), stuck);
            }
            world.apply(Answer::Steer(Command::default()));
        }
    };
    let at_most_a_minute = || Setup { longest_s: Some(60.0), ..setup(lake()) };
    assert_eq!(stood(Setup { idle_s: None, ..at_most_a_minute() }), (Some(Ending::TimeOver), 0));
    assert_eq!(stood(setup(lake())), (Some(Ending::Idle(20.0)), 1));
    assert_eq!(Ending::Idle(20.0).to_string(), "stationary for 20 s without steady throttle");
    let put_back = Setup { on_crash: OnCrash::Reset, ..at_most_a_minute() };
    assert_eq!(stood(put_back), (Some(Ending::TimeOver), 2));
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_other_noise() {
    let noisy = |seed| Setup {
        seed,
        longest_s: Some(6.0),
        conditions: Conditions { noise: 6.0, rain: 0.5, dropped: 0.2, latency_ms: 70.0, ..Conditions::default() },
        ..setup(lake())
    };
    let fingerprint = |seed| {
        let world = Simulation::new(noisy(seed)).unwrap();
        played(world, PurePursuit::default(), 20.0).1.driven.fingerprint
    };
    let first = fingerprint(1);
    assert_eq!(first, fingerprint(1));
    assert_ne!(first, fingerprint(2));
}

#[test]
fn the_same_seed_gives_the_same_run_in_another_process_with_other_threads() {
    let run = |threads: &str| {
        let arguments = ["drive", "--max-time", "8", "--speed", "12", "--no-recording", "--json"];
        let output = Process::new(env!("CARGO_BIN_EXE_lapwing"))
            .args(arguments)
            .envs(["OMP_NUM_THREADS", "MKL_NUM_THREADS", "LAPWING_MODEL__THREADS"].map(|name| (name, threads)))
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let result: serde_json::Value = serde_json::from_str(&text).expect(&text);
        assert_eq!(result["frames"], 120);
        result["fingerprint"].as_str().unwrap().to_owned()
    };
    let one = run("1");
    assert_eq!(one, run("1"));
    assert_eq!(one, run("2"));
}

#[test]
fn a_command_takes_effect_late() {
    let in_effect = |latency_ms| {
        let conditions = Conditions { latency_ms, ..Conditions::default() };
        let mut world = Simulation::new(Setup { conditions, ..setup(lake()) }).unwrap();
        (0..12)
            .map(|i| {
                let Sight::Telemetry(telemetry) = world.observe().unwrap().unwrap().sight else {
                    panic!("no telemetry")
                };
                let steering = Steering::new(f64::from(i + 1) / 100.0).unwrap();
                world.apply(Answer::Steer(Command { steering, throttle: Throttle::constant(0.5) }));
                (telemetry.steering.steering().get() * 100.0).round()
            })
            .collect::<Vec<_>>()
    };
    // Each telemetry tells the command before; 200 ms are three telemetries more, until which the wheels are straight.
    assert_eq!(in_effect(0.0), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0]);
    assert_eq!(in_effect(200.0), [0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
}

#[test]
fn a_network_allows_for_commands_that_take_effect_late() {
    // In the jungle, 24 s at 25 mph.
    let off_road = |compensate: &str| {
        let arguments =
            ["drive", "--track", "jungle", "--speed", "25", "--conditions", "latency_ms=200", "--max-time", "24"];
        let output = Process::new(env!("CARGO_BIN_EXE_lapwing"))
            .args(arguments)
            .args(["--no-recording", "--json"])
            .env("LAPWING_CONTROL__COMPENSATE_LATENCY", compensate)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let result: serde_json::Value = serde_json::from_str(&text).expect(&text);
        result["off_roads"].as_u64().unwrap()
    };
    assert_eq!(off_road("true"), 0);
    assert!(off_road("false") > 0, "it drives as well without");
}

#[test]
fn a_human_takes_the_wheel_when_the_script_says() {
    let human = Human { from_s: 4.0, for_s: 3.0, speed: Mph::constant(15.0) };
    let setup = Setup { human: Some(human), longest_s: Some(10.0), ..setup(lake()) };
    let mut world = Simulation::new(setup).unwrap().seen_by(Blind);
    let mut driver = driver(PurePursuit::default(), 10.0);
    let mut by_human = vec![];
    while let Some(seen) = world.observe().unwrap() {
        if seen.sight == Sight::HumanDrives {
            by_human.push(seen.at.as_secs_f64());
        }
        let (answer, _) = driver.drive(&seen);
        assert_eq!(answer == Answer::Manual, seen.sight == Sight::HumanDrives);
        world.apply(answer);
    }
    assert_eq!(by_human.len(), 45);
    assert!((by_human[0] - 4.0).abs() < 0.07 && (by_human[44] - 7.0).abs() < 0.07, "{by_human:?}");
    assert!(world.place().offset.abs() < 0.5, "the human drives well: {}", world.place().offset);
}

#[test]
fn a_stock_world_tells_a_pilot_nothing_but_what_the_stock_build_tells() {
    let mut world = Simulation::new(Setup { stock: true, ..standing_car() }).unwrap();
    let Sight::Telemetry(telemetry) = world.observe().unwrap().unwrap().sight else { panic!("no telemetry") };
    assert!(telemetry.truth.is_empty(), "{:?}", telemetry.truth);
}

#[test]
fn an_unbraked_car_hits_the_standing_one_at_the_speed_it_had() {
    let scenario = Scenario::named("ccrs").unwrap();
    let setup = Setup { scenario: Some(scenario), laps: None, ..setup(lake()) };
    let mut world = Simulation::new(setup).unwrap().seen_by(Blind);
    let began_mph = world.car().speed / lapwing_core::units::MPS_PER_MPH;
    let mut driver = driver(PurePursuit::default(), began_mph);
    let mut hit = None;
    while let Some(seen) = world.observe().unwrap() {
        hit = hit.or(world.take_events().into_iter().find_map(|(_, event)| match event {
            EventRecord::Collision { with, speed_mph, .. } => Some((with, speed_mph)),
            _ => None,
        }));
        let (answer, _) = driver.drive(&seen);
        world.apply(answer);
    }
    let (with, mph) = hit.expect("it stands in the way");
    assert_eq!(with, "a car");
    assert!((mph - began_mph).abs() < 1.5, "hit at {mph} mph, began at {began_mph}");
    assert_eq!(world.ending(), Some(&Ending::Collision("a car".into())));
}

/// Follows the line, and after so many moments stops.
struct Stops {
    line: PurePursuit,
    after: u32,
}

impl Stops {
    fn after(moments: u32) -> Self {
        Self { line: PurePursuit::default(), after: moments }
    }
}

impl Pilot for Stops {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        let prediction = self.line.steer(view)?;
        self.after = self.after.saturating_sub(1);
        Ok(if self.after > 0 { prediction } else { Prediction { speed_limit: Some(Mph::ZERO), ..prediction } })
    }

    fn needs_picture(&self) -> bool {
        self.line.needs_picture()
    }

    fn reset(&mut self) {}
}

/// A car stands 80 m ahead of ours, which goes 48.2 km/h.
fn standing_car() -> Setup {
    let scenario = Scenario::named("ccrs").unwrap().cases().pop();
    Setup { scenario, laps: None, longest_s: Some(12.0), ..setup(lake()) }
}

#[test]
fn braking_tells_who_hits_the_standing_car_and_who_stops_short_of_it() {
    let mph = standing_car().scenario.unwrap().ego.speed_mph();
    let (_, Judged { card, .. }) = driven(standing_car(), PurePursuit::default(), mph);
    let [avoided, impact, taken_off, until] =
        [Figure::BrakingAvoided, Figure::Impact, Figure::SpeedReduction, Figure::MinTimeToCollision]
            .map(|figure| card.value(figure).unwrap_or_else(|| panic!("{figure:?} in {card}")));
    assert_eq!((avoided, until), (0.0, 0.0), "{card}");
    assert!((impact - mph).abs() < 1.5 && taken_off.abs() < 1.5, "{card}");
    assert!((impact + taken_off - mph).abs() < 0.1, "what was not taken off was met: {card}");

    let (_, Judged { card, .. }) = driven(standing_car(), Stops::after(30), mph);
    assert_eq!(card.get(Figure::BrakingAvoided), Measure::Told(1.0), "{card}");
    assert_eq!(card.words(Figure::Impact), "not measurable: nothing was hit");
    assert_eq!(card.get(Figure::FalseAlarms), Measure::Told(0.0), "{card}");
    assert!(card.value(Figure::SpeedReduction).unwrap() > 20.0, "{card}");
    assert!((0.5..5.0).contains(&card.value(Figure::MinTimeToCollision).unwrap()), "{card}");

    // The same with nobody in the way is no avoidance and no alarm that a scenario asked for.
    let (_, Judged { card, .. }) = driven(Setup { scenario: None, ..standing_car() }, Stops::after(30), mph);
    assert_eq!(card.words(Figure::BrakingAvoided), "not measurable: no scenario asked for braking");
}

#[test]
fn who_stops_for_a_child_that_waits_raises_a_false_alarm() {
    let text = r#"name = "waits"
        description = "A child beside the road"
        duration_s = 10.0
        ego = { speed_kmh = 40.0 }
        [[actor]]
        script = "parked"
        kind = "child"
        ahead_m = 60.0
        offset_m = 4.0"#;
    let scenario = Some(Scenario::parse(text).unwrap());
    let setup = Setup { scenario, laps: None, longest_s: Some(10.0), ..setup(lake()) };
    let (_, Judged { card, .. }) = driven(setup, Stops::after(30), 24.9);
    let time_s = card.value(Figure::TimeS).unwrap();
    assert_eq!(card.value(Figure::FalseAlarms), Some(3600.0 / time_s), "{card}");
    assert!(card.value(Figure::MinTimeToCollision).is_none(), "{card}");
}

/// Drives at 20 mph and records it.
fn recorded(dir: &Path, setup: Setup, pilot: Box<dyn Pilot>) -> (Judged, RecordingReport) {
    let header = RunHeader {
        kind: RunKind::Driven,
        name_hint: Some("lake".into()),
        dialect: None,
        decimal_separator: None,
        model: None,
        seed: Some(3),
        config: serde_json::json!({}),
        lapwing: "test".into(),
        started: jiff::Timestamp::UNIX_EPOCH,
    };
    // A queue of few items: the world stands still for a slow disk, and nothing is dropped.
    let recorder = Recorder::create(dir, header, RecorderOptions { queue: 16, ..RecorderOptions::default() }).unwrap();
    let mut world = Simulation::new(setup).unwrap();
    let control = ControlSettings { speed_mph: Mph::new(20.0).unwrap(), ..ControlSettings::default() };
    let mut driver = Driver::new(pilot, &control, Instant::now);
    let driven = judged::run(&mut world, &mut driver, &mut [&mut &recorder]).unwrap();
    (driven, recorder.finish())
}

#[test]
fn a_recorded_run_is_judged_as_its_drive_was() {
    let short = || Setup { longest_s: Some(20.0), ..setup(lake()) };
    let human = Human { from_s: 5.0, for_s: 4.0, speed: Mph::new(20.0).unwrap() };
    let drives: [(&str, Setup, Box<dyn Pilot>); 5] = [
        ("well", short(), Box::new(PurePursuit::default())),
        ("off the road, again and again", Setup { on_crash: OnCrash::Reset, ..short() }, Box::new(straight_on())),
        ("with a human", Setup { human: Some(human), ..short() }, Box::new(PurePursuit::default())),
        ("into a standing car", standing_car(), Box::new(PurePursuit::default())),
        ("up to a standing car", standing_car(), Box::new(Stops::after(30))),
    ];
    for (how, setup, pilot) in drives {
        let dir = tempfile::tempdir().unwrap();
        let (Judged { card, .. }, report) = recorded(dir.path(), setup, pilot);
        let again =
            score::of_recording(&mut Recording::open(&report.path).unwrap(), Scorer::default(), |_, _| ()).unwrap();
        assert_eq!(again, card, "{how}");
        let counts = [Figure::Takeovers, Figure::Collisions].map(|figure| card.value(figure));
        let expected = ["with a human", "into a standing car"].map(|one| Some(f64::from(how == one)));
        assert_eq!(counts, expected, "{how}: {card}");
        let avoided = [("into a standing car", 0.0), ("up to a standing car", 1.0)].into_iter();
        let avoided = avoided.filter_map(|(one, share)| (one == how).then_some(share)).next();
        assert_eq!(card.value(Figure::BrakingAvoided), avoided, "{how}: {card}");
    }
}

#[test]
fn laps_of_a_road_that_nobody_knows_are_seen_and_it_is_taken_for_none_that_is_known() {
    let dir = tempfile::tempdir().unwrap();
    let setup = Setup { laps: Some(2), longest_s: Some(300.0), stock: true, ..setup(open("random:14")) };
    let (Judged { card: truth, .. }, report) = recorded(dir.path(), setup, Box::new(PurePursuit::default()));
    let roads = Roads::default().known().unwrap();
    let scorer = Scorer::on(&roads, Some(2));
    let card = score::of_recording(&mut Recording::open(&report.path).unwrap(), scorer, |_, _| ()).unwrap();
    assert_eq!((card.track.as_deref(), card.value(Figure::Laps)), (None, Some(2.0)), "{card}");
    let times = truth.lap_times_s.iter().zip(&card.lap_times_s);
    assert!(times.map(|(told, seen)| (told - seen).abs()).fold(0.0, f64::max) < 1.0, "{truth}\n{card}");
}

#[test]
fn a_drive_is_recorded_whole_with_its_course_its_laps_and_its_end() {
    let dir = tempfile::tempdir().unwrap();
    let setup = Setup { longest_s: Some(20.0), ..setup(lake()) };
    let (Judged { driven: DriveDigest { frames, .. }, .. }, report) =
        recorded(dir.path(), setup, Box::new(PurePursuit::default()));
    assert_eq!((report.frames, report.frames_not_recorded, report.items_not_recorded), (frames, 0, 0));
    let mut events = vec![];
    let mut telemetries = 0u32;
    for item in RunReader::open(&report.path).unwrap() {
        match item.unwrap() {
            (_, lapwing_core::recording::Item::Event(event)) => events.push(event),
            (at, lapwing_core::recording::Item::Telemetry(telemetry)) => {
                assert_eq!(at, Duration::from_secs_f64(f64::from(telemetries) / 15.0));
                assert!(telemetry.truth.cte.is_some());
                telemetries += 1;
            }
            _ => {}
        }
    }
    assert_eq!(telemetries as u64, frames);
    assert!(matches!(&events[0], EventRecord::Course { track, laps: Some(1), .. } if track == "lake"), "{events:?}");
    assert!(matches!(events.last(), Some(EventRecord::RunEnded { why }) if why == "time limit reached"), "{events:?}");
}

#[test]
fn a_run_below_a_threshold_ends_with_3_and_says_which() {
    let lapwing = |arguments: &[&str]| {
        let output = Process::new(env!("CARGO_BIN_EXE_lapwing"))
            .args(["drive", "--pilot", "expert", "--max-time", "5", "--no-recording"])
            .args(arguments)
            .output()
            .unwrap();
        (output.status.code().unwrap(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    assert_eq!(lapwing(&["--max-collisions", "0"]).0, 0);
    let (code, said) = lapwing(&["--min-completion", "50"]);
    assert_eq!(code, 3);
    assert!(said.contains("missed: completion: expected at least 50.0 %, got"), "{said}");
}

#[test]
fn conditions_of_a_file_are_checked_like_those_of_a_flag() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("wet.toml");
    let said = |text: &str| {
        std::fs::write(&file, text).unwrap();
        let output = Process::new(env!("CARGO_BIN_EXE_lapwing"))
            .args(["drive", "--pilot", "expert", "--max-time", "1", "--no-recording", "--conditions"])
            .arg(&file)
            .output()
            .unwrap();
        (output.status.code().unwrap(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    assert_eq!(said("rain = 0.5").0, 0);
    for (wrong, named) in [("rain = 5.0", "rain"), ("rian = 0.5", "rian"), ("rain = \"much\"", "rain")] {
        let (code, text) = said(wrong);
        assert!(code == 2 && text.contains("wet.toml") && text.contains(named), "{code}: {text}");
    }
}

#[test]
fn a_recovery_drive_steers_back_and_reads_as_the_stock_recorders() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("with space");
    let output = Process::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(["record", "--track", "mountain", "--max-time", "30", "--recovery", "--seed", "4", "--out"])
        .arg(&out)
        .output()
        .unwrap();
    // The time was all that was asked for.
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(out.join("driving_log.csv")).unwrap();
    assert_eq!(text.lines().count(), 450);
    for name in text.lines().next().unwrap().split(',').take(3) {
        assert!(Path::new(name).is_absolute() && Path::new(name).exists(), "{name}");
    }
    let steering: Vec<f64> = text.lines().map(|l| l.split(',').nth(3).unwrap().parse().unwrap()).collect();
    let hard = steering.iter().filter(|s| s.abs() > 0.15).count();
    assert!(hard > 30, "only {hard} corrections");
    // A second recording does not write over the first.
    let again = Process::new(env!("CARGO_BIN_EXE_lapwing"))
        .args(["record", "--max-time", "1", "--out"])
        .arg(&out)
        .output()
        .unwrap();
    assert_eq!(again.status.code(), Some(1));
    assert_eq!(std::fs::read_to_string(out.join("driving_log.csv")).unwrap(), text);
}
