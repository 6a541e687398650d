//! What each reader of outside bytes is held to, whatever the bytes are.
//!
//! One function a target, used by the fuzzers in `fuzz_targets/` and by the program's own tests, which replay the
//! corpus without a fuzzer (`tests/corpus.rs`). That a reader neither panics, hangs nor takes memory without end is
//! the least; each function adds what must be true of that which was accepted: values finite and in range, and the
//! same again after being written.

use std::{cell::RefCell, fs, path::PathBuf, time::Duration};

use base64::{Engine, engine::general_purpose::STANDARD};
use bytes::Bytes;
use lapwing_core::{
    config::{Layers, Settings},
    perception::{Frame, MAX_SIDE, decode_base64, decode_jpeg},
    protocol::number::{self, Culture},
    protocol::{CameraImage, Command, Packet, Payload, Telemetry, Truth, encode_superset, encode_telemetry},
    recording::udacity::DrivingLog,
    recording::{Entry, Item, RunReader},
    units::SpeedUnit,
};
use lapwing_learn::nn::Checkpoint;
use lapwing_live::page::{Abilities, Control, FASTEST_MPH, Offered, WeatherRange, WorldChoice};
use lapwing_sim::{
    scenario::Scenario,
    track::{Track, TrackFile},
    traffic::Traffic,
};

/// A function that takes any bytes and panics where its reader does something that it must not.
pub type Target = fn(&[u8]);

/// All of them, by the name of their corpus.
pub const TARGETS: [(&str, Target); 11] = [
    ("packets", packets),
    ("numbers", numbers),
    ("telemetry", telemetry),
    ("jpeg", jpeg),
    ("runs", runs),
    ("driving_logs", driving_logs),
    ("checkpoints", checkpoints),
    ("tracks", tracks),
    ("scenarios", scenarios),
    ("settings", settings),
    ("controls", controls),
];

/// Half of the last decimal that the wire carries, and what doubles add to it.
fn is_near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 0.5e-4 + 1e-9 * a.abs().max(b.abs())
}

/// A file with these bytes, for readers that take a path; each thread has one, in memory where the system offers that.
fn with_file(name: &str, data: &[u8], read: impl FnOnce(PathBuf)) {
    thread_local! {
        static FOLDER: RefCell<Option<tempfile::TempDir>> = const { RefCell::new(None) };
    }
    let folder = FOLDER.with_borrow_mut(|folder| {
        let new = || tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a folder to write to");
        folder.get_or_insert_with(new).path().to_owned()
    });
    let path = folder.join(name);
    fs::write(&path, data).expect("a file can be written");
    read(path);
}

/// A simulator's text: told apart, and an event is the same when it is written again.
pub fn packets(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let packet = match Packet::parse(text) {
        Ok(packet) => packet,
        Err(error) => return assert!(error.to_string().len() < 1000, "an error quotes the beginning only"),
    };
    let Packet::Event(event) = packet else { return };
    let name = serde_json::to_string(&event.name).expect("text is JSON");
    let payload = event.payload.map(|p| format!(",{}", p.get())).unwrap_or_default();
    let again = format!("42[{name}{payload}]");
    let Ok(Packet::Event(read)) = Packet::parse(&again) else { panic!("no event: {again}") };
    assert_eq!((&read.name, read.payload.map(|p| p.get())), (&event.name, event.payload.map(|p| p.get())));
    for culture in Culture::ALL {
        if let Ok(command) = Command::parse_as_simulator(event.payload, culture) {
            assert!((-1.0..=1.0).contains(&command.steering.get()) && (-1.0..=1.0).contains(&command.throttle.get()));
        }
    }
    payload_of(text, &event.name, event.payload);
}

/// Text as a number: finite, and the same after a way through the wire in every culture.
pub fn numbers(data: &[u8]) {
    if let Some(bits) = data.first_chunk() {
        number_through_the_wire(f64::from_le_bytes(*bits));
    }
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(value) = number::parse(text) {
        assert!(value.is_finite(), "{text:?} is {value}");
        number_through_the_wire(value);
    }
    for culture in Culture::ALL {
        assert!(culture.float_parse(text).is_ok_and(f64::is_finite) || culture.float_parse(text).is_err());
    }
}

fn number_through_the_wire(value: f64) {
    let single = number::single(value);
    if (value as f32).is_finite() {
        let read: f64 = single.parse().expect("a float as C# writes it");
        assert!((read - f64::from(value as f32)).abs() <= 1e-6 * read.abs(), "{value:e} is written {single}");
    }
    // Beyond this a double has no four decimals any more.
    if value.is_nan() || value.abs() > 1e11 {
        return;
    }
    let mut universal = String::new();
    number::write_universal(&mut universal, value);
    for culture in Culture::ALL {
        for text in [culture.n4(value), culture.f4(value)] {
            let read = number::parse(&text).expect("a number as C# writes it");
            assert!(is_near(read, value), "{value} in {} is {text}, which reads {read}", culture.name);
        }
        let read = culture.float_parse(&universal).expect("a number in every culture");
        assert!(is_near(read, value), "{value} is {universal}, which {} reads {read}", culture.name);
    }
}

/// The payload of a telemetry: what is accepted is in range, and says the same after being written as either build
/// does, in every culture.
pub fn telemetry(data: &[u8]) {
    let Ok(payload) = std::str::from_utf8(data) else { return };
    let text = format!(r#"42["telemetry",{payload}]"#);
    let Ok(Packet::Event(event)) = Packet::parse(&text) else { return };
    payload_of(&text, &event.name, event.payload);
}

fn payload_of(text: &str, name: &str, payload: Option<&serde_json::value::RawValue>) {
    let Ok(Some(payload)) = Payload::read(payload) else { return };
    let known = payload.dialect(name).is_ok();
    let message = Bytes::copy_from_slice(text.as_bytes());
    for unit in [SpeedUnit::Mph, SpeedUnit::MetresPerSecond] {
        let Ok(telemetry) = payload.telemetry(&message, unit) else { continue };
        assert!(known || payload.dialect(name).is_err());
        check_truth(&telemetry.truth);
        for culture in Culture::ALL {
            written_again(&telemetry, culture);
        }
    }
}

fn check_truth(truth: &Truth) {
    let numbers = [truth.brake, truth.sim_time_s, truth.time_to_collision_s];
    assert!(numbers.into_iter().flatten().all(f64::is_finite), "{truth:?}");
    let json = serde_json::to_string(truth).expect("ground truth is JSON");
    assert_eq!(serde_json::from_str::<Truth>(&json).expect("a run reads what was recorded"), *truth);
}

fn written_again(telemetry: &Telemetry, culture: Culture) {
    let read = |text: &str| -> Telemetry {
        let Ok(Packet::Event(event)) = Packet::parse(text) else { panic!("no event: {text}") };
        let payload = Payload::read(event.payload).expect("a payload").expect("of a telemetry");
        payload.telemetry(&Bytes::copy_from_slice(text.as_bytes()), SpeedUnit::Mph).expect("a telemetry")
    };
    let stock = read(&encode_telemetry(telemetry, "AA", culture));
    assert!(is_near(stock.steering.get(), telemetry.steering.get()));
    assert!(is_near(stock.throttle.get(), telemetry.throttle.get()));
    assert!(is_near(stock.speed.get(), telemetry.speed.get()));
    assert_eq!(stock.image, CameraImage::Base64(Bytes::from_static(b"AA")));
    let text = encode_superset(telemetry, "AA", culture);
    let superset = read(&text);
    assert_eq!(encode_superset(&superset, "AA", culture), text, "written again it is the same text");
    if telemetry.truth.lap.is_some() {
        let (a, b) = (&superset.truth, &telemetry.truth);
        assert_eq!((a.lap, a.waypoint, a.crashed, a.crashes), (b.lap, b.waypoint, b.crashed, b.crashes));
        for (a, b) in [(a.sim_time_s, b.sim_time_s), (a.brake, b.brake)] {
            assert!(a.is_some() == b.is_some() && is_near(a.unwrap_or(0.0), b.unwrap_or(0.0)), "{a:?} for {b:?}");
        }
    }
}

/// A picture: decoded whole and no larger than allowed, or an error; base64 is the inverse of being encoded.
pub fn jpeg(data: &[u8]) {
    assert_eq!(decode_base64(STANDARD.encode(data).as_bytes()).as_deref(), Ok(data));
    if let Ok(bytes) = decode_base64(data) {
        assert!(bytes.len() <= data.len());
    }
    let mut frame = Frame::default();
    let decoded = decode_jpeg(data, &mut frame);
    assert_eq!(frame.rgb().len(), frame.width() * frame.height() * 3);
    if decoded.is_ok() {
        assert!((1..=MAX_SIDE).contains(&frame.width()) && (1..=MAX_SIDE).contains(&frame.height()));
    }
}

/// A run, maybe damaged: it is read to its end, moments are what its items are, and nothing is made up.
pub fn runs(data: &[u8]) {
    with_file("run.mcap", data, |path| {
        let Ok(mut run) = RunReader::open(&path) else { return };
        let (mut telemetries, mut bytes) = (0_u64, 0);
        for item in run.by_ref() {
            match item {
                Ok((_, Item::Telemetry(telemetry))) => {
                    telemetries += 1;
                    check_truth(&telemetry.truth);
                }
                Ok((_, Item::Frame(jpeg))) => bytes += jpeg.len(),
                Ok((_, Item::Command(_) | Item::Event(_))) => {}
                Err(error) => assert!(!error.to_string().is_empty()),
            }
        }
        assert!(run.next().is_none(), "the end is the end");
        if let Some(truncation) = run.truncated() {
            assert!(truncation.at + truncation.unread <= data.len() as u64);
        } else if let Some(told) = run.telemetries() {
            assert!(told >= telemetries || told < u64::MAX);
        }
        assert!(bytes <= 256 * data.len() + (64 << 20), "{bytes} bytes of pictures from {}", data.len());
        let steps = RunReader::open(&path).expect("it opened before").entries();
        let steps = steps.filter(|moment| matches!(moment, Ok(Entry::Step(_)))).count();
        assert_eq!(steps as u64, telemetries, "each telemetry is a step");
    });
}

/// A driving log: every row in range and in the order of time, and the same when it is written as the simulator does.
pub fn driving_logs(data: &[u8]) {
    with_file("driving_log.csv", data, |path| {
        let log = match DrivingLog::open(&path) {
            Ok(log) => log,
            Err(error) => return assert!(error.to_string().len() < 2000, "an error quotes the beginning only"),
        };
        let folder = path.parent().expect("the file is in a folder");
        let (mut at, mut text) = (Duration::ZERO, String::new());
        for row in &log.rows {
            assert!(row.at >= at, "time goes on");
            at = row.at;
            assert!((0.0..=1.0).contains(&row.brake));
            let number = |value: f64| number::single(value);
            let name = row.center.strip_prefix(folder).map_or(String::new(), |p| p.to_string_lossy().into_owned());
            if name.is_empty() || name.contains(['"', '\n', '\r', ',']) {
                return; // elsewhere on this machine, or no name that such a log can hold
            }
            let (steering, throttle) = (number(row.steering.get()), number(row.throttle.get()));
            let (brake, speed) = (number(row.brake), number(row.speed.get()));
            text += &format!("{name},,,{steering},{throttle},{brake},{speed}\n");
        }
        fs::write(&path, &text).expect("a file can be written");
        let again = DrivingLog::open(&path).unwrap_or_else(|error| panic!("{error} in {text}"));
        assert_eq!(again.rows.len(), log.rows.len());
        for (again, row) in again.rows.iter().zip(&log.rows) {
            assert_eq!((&again.center, again.at, again.taken_at), (&row.center, row.at, row.taken_at));
            let values = |row: &lapwing_core::recording::udacity::Row| {
                [row.steering.get(), row.throttle.get(), row.brake, row.speed.get()]
            };
            for (a, b) in values(again).into_iter().zip(values(row)) {
                assert!((a - b).abs() <= 1e-6 * b.abs() + 1e-40, "{a} for {b}");
            }
        }
    });
}

/// A checkpoint's header and what hangs on it: refused in words, or a network.
pub fn checkpoints(data: &[u8]) {
    match Checkpoint::from_bytes(data) {
        Ok(checkpoint) => assert_eq!(checkpoint.sha256.len(), 64),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// A track: the same when it is written again, and a road of finite places where it can be driven.
pub fn tracks(data: &[u8]) {
    let Ok(file) = std::str::from_utf8(data).map_err(drop).and_then(|text| TrackFile::parse(text).map_err(drop)) else {
        return;
    };
    let Ok(track) = Track::new(file.clone()) else { return };
    let again = TrackFile::parse(&toml::to_string(&file).expect("a track is TOML")).expect("what was written");
    assert_eq!(again, file);
    assert!(track.length().is_finite() && track.length() > 0.0 && track.driving_line_length().is_finite());
    for station in track.stations() {
        let numbers = [station.s, station.yaw, station.curvature, station.grade];
        assert!(station.position.is_finite() && numbers.iter().all(|x| x.is_finite()), "{station:?}");
    }
    for point in track.driving_line() {
        let numbers = [point.travelled, point.offset, point.yaw, point.curvature];
        assert!(point.position.is_finite() && numbers.iter().all(|x| x.is_finite()), "{point:?}");
    }
    let start = track.stations()[0];
    assert!(track.locate(start.position, None).offset.is_finite());
}

/// A scenario: the same when it is written again, drawn numbers are in their ranges, and traffic plays it or says why not.
pub fn scenarios(data: &[u8]) {
    thread_local! {
        static LAKE: Track = Track::named("lake").expect("a track that comes along");
    }
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(scenario) = Scenario::parse(text) else { return };
    let again = toml::to_string(&scenario).expect("a scenario is TOML");
    assert_eq!(Scenario::parse(&again).expect("what was written"), scenario);
    let settled = scenario.settle(7);
    assert!(settled.check().is_ok(), "{settled:?}");
    assert_eq!(settled.settle(8), settled, "what is settled stays");
    assert!(scenario.cases().iter().all(|case| case.check().is_ok()));
    LAKE.with(|lake| {
        if let Ok(traffic) = Traffic::new(&scenario, lake, 7) {
            assert!(traffic.actors().iter().all(|actor| actor.position.is_finite() && actor.yaw.is_finite()));
        }
    });
}

/// Settings, from a file and from the environment: refused with the layer's name, or the same when they are written again.
pub fn settings(data: &[u8]) {
    with_file("lapwing.toml", data, |path| match Layers::default().file(Some(&path)).and_then(Layers::resolve) {
        Ok(settings) => same_again(&settings),
        Err(error) => assert!(!error.to_string().is_empty()),
    });
    let Ok(text) = std::str::from_utf8(data) else { return };
    let variables = text.lines().filter_map(|line| line.split_once('='));
    let variables = variables.map(|(name, value)| (format!("LAPWING_{}", name.trim()).into(), value.trim().into()));
    match Layers::default().environment(variables.take(16)).and_then(Layers::resolve) {
        Ok(settings) => same_again(&settings),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

fn same_again(settings: &Settings) {
    let json = serde_json::to_value(settings).expect("settings are JSON: they stand in every run");
    assert_eq!(serde_json::from_value::<Settings>(json).expect("what was written"), *settings);
}

/// What a page may ask for: a speed that a car can hold, a pilot that there is, and a world by names that are offered, of
/// which none is a path.
pub fn controls(data: &[u8]) {
    let rain = WeatherRange { name: "rain".into(), min: 0.0, max: 1.0, fair: 0.0 };
    let offered = Offered { tracks: vec!["lake".into()], scenarios: vec!["ccrs".into()], weather: vec![rain] };
    let Ok(control) = Control::read(data) else { return };
    match (control.check(&Abilities::of_the_simulator(true), &offered, 2), control) {
        (Err(error), _) => assert!(!error.to_string().is_empty()),
        (Ok(()), Control::SetSpeed { mph }) => assert!(mph > 0.0 && mph <= FASTEST_MPH),
        (Ok(()), Control::Pilot { index }) => assert!(index < 2),
        (Ok(()), Control::World(WorldChoice { track, weather, scenario })) => {
            assert!(track.is_none_or(|track| track == "lake" || track.starts_with("random") && !track.contains('/')));
            assert!(scenario.is_none_or(|scenario| scenario.is_empty() || scenario == "ccrs"));
            assert!(weather.into_iter().flatten().all(|(name, value)| name == "rain" && (0.0..=1.0).contains(&value)));
        }
        (Ok(()), _) => {}
    }
}
