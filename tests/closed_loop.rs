//! Driving along a recording.

use std::{fs, path::Path, sync::Arc, time::Instant};

use bytes::Bytes;
use lapwing_core::{
    config::{ControlSettings, Thresholds},
    drive::Eventful,
    driver::Driver,
    pilot::{ConstantPilot, Pilot, PurePursuit},
    protocol::{Answer, CameraImage, Command, Dialect, Observation, Sight, World},
    recording::udacity::DrivingLogWriter,
    recording::{EventRecord, Recorder, RecorderOptions, Recording, RunHeader, RunKind},
    units::{Mph, Steering, Throttle},
};
use lapwing_learn::models;
use lapwing_score::judged::{self, Judged};
use lapwing_score::score::{self, Figure, Scorer};
use lapwing_sim::{
    along::{Beside, Limit, RecordedWorld, Yaw},
    camera::Scenery,
    locate::{Pose, table},
    record::{self, RecordOptions},
    track::Track,
    world::{Setup, Simulation},
};
use tempfile::{TempDir, tempdir};

use crate::{program, support::jpeg};

/// NVIDIA's limit.
const METRE: Limit = Limit::Metres(1.0);

fn simulation(seconds: f64) -> Simulation {
    let track = Track::named("lake").unwrap();
    let scenery = Arc::new(Scenery::new(&track));
    let setup = Setup { laps: None, longest_s: Some(seconds), ..Setup::new(Arc::new(track), scenery) };
    Simulation::new(setup).unwrap()
}

/// What the stock recorder leaves of the expert's and the heading at each row, in radians.
fn recorded(seconds: f64) -> (TempDir, Vec<f64>) {
    let dir = tempdir().unwrap();
    let folder = dir.path().join("lake");
    let mut world = simulation(seconds);
    let log = DrivingLogWriter::create(&folder, jiff::civil::date(2026, 11, 22).at(8, 0, 0, 0)).unwrap();
    let mut yaws = vec![world.car().yaw];
    let options = RecordOptions::at(Mph::constant(20.0));
    record::record(&mut world, &mut expert(), log, options, |world| yaws.push(world.car().yaw)).unwrap();
    yaws.pop();
    (dir, yaws)
}

fn open(dir: &TempDir, yaw: Yaw) -> RecordedWorld {
    RecordedWorld::open(&dir.path().join("lake"), Some(METRE), yaw, None).unwrap()
}

/// Nobody whose answers count: the expert in the simulation drives.
fn expert() -> Driver {
    Driver::new(Box::new(PurePursuit::default()), &ControlSettings::default(), Instant::now)
}

fn driven(world: &mut RecordedWorld, pilot: Box<dyn Pilot>) -> Judged {
    let mut driver = Driver::new(pilot, &ControlSettings::default(), Instant::now);
    judged::run(world, &mut driver, &mut []).unwrap()
}

/// The steering of each row of a folder's log.
fn steering(folder: &Path) -> Vec<Steering> {
    let log = lapwing_core::recording::udacity::DrivingLog::open(folder).unwrap();
    log.rows.iter().filter(|row| row.speed.get() >= 1.0).map(|row| row.steering).collect()
}

/// Steers as recorded and says how far beside it came, and what happened.
fn as_recorded(dir: &TempDir, yaw: Yaw) -> (Vec<Beside>, Vec<EventRecord>) {
    let mut world = open(dir, yaw);
    let (mut besides, mut events) = (vec![], vec![]);
    for steering in steering(&dir.path().join("lake")) {
        assert!(world.observe().unwrap().is_some());
        besides.push(world.beside());
        world.apply(Answer::Steer(Command { steering, throttle: Throttle::ZERO }));
        events.extend(world.take_events().into_iter().map(|(_, event)| event));
    }
    (besides, events)
}

#[test]
fn steering_as_recorded_leads_along_the_path() {
    let (dir, _) = recorded(20.0);
    let (besides, _) = as_recorded(&dir, Yaw::Steering);
    assert!(besides.len() > 200 && besides.iter().all(|beside| *beside == Beside::default()), "{besides:?}");
}

#[test]
fn the_pictures_tell_how_the_recorded_car_turned() {
    let (dir, yaws) = recorded(40.0);
    let (besides, events) = as_recorded(&dir, Yaw::Pictures);
    // The same car with the same steering turns as the recorded one did: what is between them is the pictures' error.
    let resets = events.iter().filter(|event| matches!(event, EventRecord::Reset { .. })).count();
    let turned = yaws.iter().map(|yaw| (yaw - yaws[0]).abs()).fold(0.0, f64::max).to_degrees();
    let worst = besides.iter().map(|beside| beside.heading_rad.abs()).fold(0.0, f64::max).to_degrees();
    assert!(turned > 60.0, "the road bends: {turned:.0} degrees");
    assert!(worst < 4.0 && resets <= 4, "{worst:.1} degrees apart, put back {resets} times");
}

#[test]
fn a_pilot_that_knows_the_road_keeps_it_and_one_that_does_not_look_is_put_back() {
    let (dir, _) = recorded(40.0);
    let pilotnet = driven(&mut open(&dir, Yaw::Pictures), models::built_in(Instant::now).unwrap().pilot()).card;
    let straight = driven(&mut open(&dir, Yaw::Pictures), Box::new(ConstantPilot::new(Steering::ZERO))).card;
    assert_eq!(pilotnet.value(Figure::Autonomy), Some(1.0), "{pilotnet}");
    assert!(pilotnet.value(Figure::MeanCte).unwrap() < 0.3, "{pilotnet}");
    let interventions = straight.value(Figure::Interventions).unwrap();
    assert!(interventions >= 3.0, "{straight}");
    // Bojarski's: 6 s each.
    let expected = (1.0 - 6.0 * interventions / straight.value(Figure::TimeS).unwrap()).max(0.0);
    assert!((straight.value(Figure::Autonomy).unwrap() - expected).abs() < 1e-9, "{straight}");
    assert!(straight.value(Figure::MaxCte).unwrap() > 1.0, "so far off it was put back: {straight}");
}

#[test]
fn what_a_recording_cannot_tell_is_not_measurable_in_its_drive_and_in_the_run_of_it() {
    let (dir, _) = recorded(15.0);
    let header = RunHeader {
        kind: RunKind::RecordedPath,
        name_hint: None,
        dialect: Some(Dialect::SelfOracle),
        decimal_separator: None,
        model: None,
        seed: None,
        config: serde_json::Value::Null,
        lapwing: "test".into(),
        started: jiff::Timestamp::UNIX_EPOCH,
    };
    let recorder =
        Recorder::create(dir.path(), header, RecorderOptions { queue: 16, ..RecorderOptions::default() }).unwrap();
    let pilot = Box::new(ConstantPilot::new(Steering::constant(0.3)));
    let mut driver = Driver::new(pilot, &ControlSettings::default(), Instant::now);
    let mut world = open(&dir, Yaw::Pictures);
    let card = judged::run(&mut world, &mut driver, &mut [&mut &recorder]).unwrap().card;
    let run = recorder.finish().path;
    let again = score::of_recording(&mut Recording::open(&run).unwrap(), Scorer::default(), |_, _| ()).unwrap();
    assert_eq!(again, card);
    for figure in [Figure::Collisions, Figure::Laps, Figure::Completion, Figure::OffRoads, Figure::DrivingScore] {
        assert!(card.words(figure).starts_with("not measurable: a recording "), "{}: {card}", figure.key());
    }
    assert_eq!(card.value(Figure::Interventions), Some(world.interventions().into()), "{card}");
    assert!(card.value(Figure::MaxCte).unwrap() > 1.0 && card.value(Figure::SteeringRate).is_some(), "{card}");
    let limits = Thresholds { max_collisions: Some(0), ..Thresholds::default() };
    let expected = "collisions: expected at most 0, got not measurable: a recording has no obstacles to hit";
    assert_eq!(score::missed(&limits, &card), [expected]);
}

#[test]
fn the_car_comes_out_on_the_side_to_which_it_is_steered_and_is_put_back_there() {
    let (dir, _) = recorded(15.0);
    for (steering, sign) in [(0.3, 1.0), (-0.3, -1.0)] {
        let mut world = open(&dir, Yaw::Pictures);
        let mut offsets = vec![];
        while let Some(Observation { sight: Sight::Telemetry(telemetry), .. }) = world.observe().unwrap() {
            let command = Command { steering: Steering::constant(steering), throttle: Throttle::ZERO };
            assert_eq!(telemetry.truth.cte.unwrap().get(), world.beside().offset_m);
            world.apply(Answer::Steer(command));
            for (_, event) in world.take_events() {
                if let EventRecord::OffRoad { offset_m } = event {
                    offsets.push(offset_m);
                    assert_eq!(world.beside(), Beside::default());
                }
            }
        }
        assert!(!offsets.is_empty() && offsets.iter().all(|offset| offset * sign > 1.0), "{steering}: {offsets:?}");
    }
}

#[test]
fn the_shipped_run_is_driven_along_and_its_time_is_without_its_standing() {
    let run = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/lake.mcap");
    let mut world = RecordedWorld::open(&run, Some(METRE), Yaw::Pictures, None).unwrap();
    let (rows, read, stood) = world.rows();
    assert_eq!((rows + stood, read), (225, 225));
    let card = driven(&mut world, models::built_in(Instant::now).unwrap().pilot()).card;
    assert_eq!(card.value(Figure::Autonomy), Some(1.0), "{card}");
    assert!((card.value(Figure::TimeS).unwrap() - (rows - 1) as f64 / 15.0).abs() < 0.1, "{card}");
    assert_eq!(card.track.as_deref(), Some("lake (recorded)"));
}

#[test]
fn a_closed_loop_is_the_same_each_time() {
    let run = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/lake.mcap");
    let prints = [(); 2].map(|()| {
        let mut world = RecordedWorld::open(&run, Some(METRE), Yaw::Pictures, None).unwrap();
        driven(&mut world, Box::new(ConstantPilot::new(Steering::constant(0.02)))).driven.fingerprint
    });
    assert_eq!(prints[0], prints[1]);
}

/// A folder of three rows with this picture at this speed.
fn folder(picture: &[u8], mph: f64) -> TempDir {
    let dir = tempdir().unwrap();
    fs::create_dir(dir.path().join("IMG")).unwrap();
    let mut log = String::new();
    for i in 0..3 {
        let name = format!("center_2026_11_22_08_00_00_{i}00.jpg");
        fs::write(dir.path().join("IMG").join(&name), picture).unwrap();
        log += &format!("{name},,,0,0,0,{mph}\n");
    }
    fs::write(dir.path().join("driving_log.csv"), log).unwrap();
    dir
}

#[test]
fn a_recording_that_cannot_be_driven_along_says_why() {
    let error =
        |dir: &TempDir| RecordedWorld::open(dir.path(), Some(METRE), Yaw::Pictures, None).err().unwrap().to_string();
    assert!(error(&folder(&jpeg(90), 0.2)).contains("expected a recorded drive, got 3 rows with a picture, 3 of them"));
    assert!(error(&folder(b"no picture", 9.0)).contains("center_2026_11_22_08_00_00_000.jpg: expected a JPEG"));
    let part = |rows| {
        let dir = folder(&jpeg(90), 0.2);
        RecordedWorld::within(dir.path(), rows, Some(METRE), Yaw::Pictures, None).err().unwrap().to_string()
    };
    assert!(part(0..2).contains("expected a recorded drive in rows 0..2, got 2 rows with a picture, 2 of them"));
    assert!(part(1..4).ends_with("expected rows of 0 to 3, got 1..4"), "{}", part(1..4));
    let mut small = Vec::new();
    image::codecs::jpeg::JpegEncoder::new(&mut small).encode(&[90; 12], 2, 2, image::ExtendedColorType::Rgb8).unwrap();
    assert!(error(&folder(&small, 9.0)).contains("expected a picture of 320x160 pixels, got 2x2"));
    let missing = folder(&jpeg(90), 9.0);
    fs::remove_file(missing.path().join("IMG/center_2026_11_22_08_00_00_100.jpg")).unwrap();
    let mut world = RecordedWorld::open(missing.path(), Some(METRE), Yaw::Pictures, None).unwrap();
    world.observe().unwrap();
    world.apply(Answer::Manual);
    let Some(Observation { sight: Sight::Telemetry(telemetry), .. }) = world.observe().unwrap() else { panic!() };
    assert_eq!(telemetry.image, CameraImage::Jpeg(Bytes::new()), "a bad frame");
    let named = |event: &EventRecord| format!("{event:?}").contains("center_2026_11_22_08_00_00_100.jpg");
    assert!(world.take_events().iter().any(|(_, event)| named(event)));
}

#[test]
fn flags_that_do_not_suit_the_recording_are_wrong_usage() {
    let data = program::folder(20, |_| jpeg(90));
    let path = data.path().to_str().unwrap();
    for (flags, words) in [
        (&["--rows", "30..40"][..], "--rows: expected rows of 0 to 20, got 30..40"),
        (&["--rows", "10..40"], "--rows: expected rows of 0 to 20, got 10..40"),
        (&["--from-path", "--limit", "road"], "--limit: expected a number of metres with --from-path"),
        (&["--limit", "road"], "--limit: road needs a known lane, and the lane is not known in any row"),
        (&["--limit", "road", "--protocol", "rally-estonia"], "1 or 2 with --protocol rally-estonia, got road"),
        (&["--limit", "3", "--protocol", "rally-estonia"], "1 or 2 with --protocol rally-estonia, got 3"),
        (&["--limit", "-1"], "expected road, or a number of metres above 0"),
    ] {
        let closed_loop = [&["replay", path, "--closed-loop"][..], flags].concat();
        let (code, out, err) = program::lapwing_in(data.path(), "", &closed_loop);
        assert_eq!((code, out.as_str()), (2, ""), "{flags:?}: {err}");
        assert!(err.contains(words), "{flags:?}: {err}");
    }
}

#[test]
fn the_result_says_what_the_limit_is_without_a_lane_and_how_many_pictures_lack_side_cameras() {
    let data = program::folder(20, |_| jpeg(90));
    let log = data.path().join("driving_log.csv");
    let text = fs::read_to_string(&log).unwrap();
    fs::write(&log, text.replacen(".jpg,,,", ".jpg,IMG/0.jpg,IMG/0.jpg,", 5)).unwrap();
    let track = Track::named("lake").unwrap();
    let pose = Pose::from_lane(&track, 50.0, false, 0.0, 0.0);
    let moments = Recording::open(data.path()).unwrap().seen().map(Result::unwrap);
    let places = moments.fold(table::heading(), |text, moment| {
        let known = (moment.row == 0).then_some(pose);
        text + &table::line(moment.row, moment.at.as_secs_f64(), &track, known)
    });
    let lane = data.path().join("lane.csv");
    fs::write(&lane, places).unwrap();
    let (path, lane) = (data.path().to_str().unwrap(), lane.to_str().unwrap());
    let closed_loop = ["replay", path, "--closed-loop", "--limit", "road", "--lane", lane];
    let (code, out, err) = program::lapwing_in(data.path(), "", &closed_loop);
    assert_eq!(code, 0, "{out}{err}");
    let limit = "put back beyond the road's edge, or 1 m from the recorded path where the lane is not known\n";
    assert!(out.contains(limit), "{out}");
    assert!(out.contains("; no side cameras in 15 of 20 pictures, so more is filled in"), "{out}");
}
