//! Driving along recordings that are located: what is measured from the lane.

use std::{
    collections::BTreeMap,
    fs,
    sync::{Mutex, OnceLock},
    time::Instant,
};

use lapwing::locating;
use lapwing_core::recording::CameraPosition;
use lapwing_core::{
    config::ControlSettings,
    drive::Eventful,
    driver::Driver,
    pilot::{ConstantPilot, Pilot},
    protocol::{Answer, Command, Observation, Sight, World},
    recording::EventRecord,
    turn::{LimitEdge, MeasuredLine},
    units::{Mph, Steering, Throttle},
};
use lapwing_learn::models;
use lapwing_score::{
    judged,
    score::{Figure, Scorecard},
};
use lapwing_sim::{
    along::{Limit, Protocol, RecordedWorld, Sources, Yaw},
    locate::LocatedDrive,
    record::RecordOptions,
    track::Track,
};
use tempfile::{TempDir, tempdir};

use crate::{controls::worlds::Road, locate, support::shared};

/// How far to each side the recorded car weaves, in metres.
const WEAVES_M: f64 = 1.6;
/// How fast it drives.
pub const SPEED: Mph = Mph::constant(20.0);

/// A drive on a simulated road that weaves, as the stock recorder leaves it, and where the car was in truth.
pub struct Weaving {
    pub dir: TempDir,
    pub located: LocatedDrive,
    pub road: Road,
}

impl Weaving {
    /// On the lake.
    pub fn drive(seconds: f64) -> Self {
        Self::on("lake", seconds)
    }

    pub fn on(road: &str, seconds: f64) -> Self {
        let dir = tempdir().unwrap();
        let options = RecordOptions { weave_m: WEAVES_M, ..RecordOptions::at(SPEED) };
        let road = Road::new(Track::named(road).unwrap());
        let located = road.record(Some(seconds), options, &dir.path().join("drive")).unwrap();
        let lane_m = road.track.file().driving_line_m;
        let weaved =
            located.places.iter().flatten().map(|place| (place.pose.offset_m - lane_m).abs()).fold(0.0, f64::max);
        assert!((1.2..2.5).contains(&weaved), "it weaves: {weaved:.2} m");
        Self { dir, located, road }
    }

    pub fn open(&self, limit: Option<Limit>, located: Option<LocatedDrive>) -> RecordedWorld {
        RecordedWorld::open(&self.dir.path().join("drive"), limit, Yaw::Pictures, located).unwrap()
    }
}

fn driven(world: &mut RecordedWorld, pilot: Box<dyn Pilot>) -> Scorecard {
    let mut driver = Driver::new(pilot, &ControlSettings::default(), Instant::now);
    judged::run(world, &mut driver, &mut []).unwrap().card
}

fn built_in() -> Box<dyn Pilot> {
    models::built_in(Instant::now).unwrap().pilot()
}

/// The offset in each telemetry of a drive without steering, and all events, each with its seconds.
fn straight_on(world: &mut RecordedWorld) -> (Vec<f64>, Vec<(f64, EventRecord)>) {
    let (mut offsets_m, mut events) = (vec![], vec![]);
    while let Some(Observation { sight: Sight::Telemetry(telemetry), .. }) = world.observe().unwrap() {
        offsets_m.push(telemetry.truth.cte.unwrap().get());
        world.apply(Answer::Steer(Command { steering: Steering::ZERO, throttle: Throttle::ZERO }));
        events.extend(world.take_events().into_iter().map(|(at, event)| (at.as_secs_f64(), event)));
    }
    (offsets_m, events)
}

/// The offsets at which the car was put back.
fn put_back(events: &[(f64, EventRecord)]) -> Vec<f64> {
    let offset = |(_, event): &(f64, EventRecord)| match event {
        EventRecord::OffRoad { offset_m } => Some(*offset_m),
        _ => None,
    };
    events.iter().filter_map(offset).collect()
}

#[test]
fn a_pilot_in_the_middle_of_the_lane_is_measured_there_however_the_recorded_driver_weaved() {
    let weaving = Weaving::drive(45.0);
    let metre = Some(Limit::Metres(1.0));
    let mut world = weaving.open(metre, Some(weaving.located.clone()));
    let from_lane = driven(&mut world, built_in());
    println!("from the lane\n{from_lane}");
    assert_eq!(from_lane.value(Figure::Interventions), Some(0.0), "{from_lane}");
    assert_eq!(from_lane.value(Figure::FromLane), Some(1.0), "{from_lane}");
    assert!(from_lane.value(Figure::MeanCte).unwrap() < 0.25, "{from_lane}");
    assert_eq!(from_lane.value(Figure::Beyond1m), Some(0.0), "{from_lane}");
    assert_eq!((world.sources().pictures, world.sources().steering), (0, 0));
    assert!(world.knows_the_lane());
    // The same pilot, which drives the same way, is off the path of a driver who weaves.
    let from_path = driven(&mut weaving.open(metre, None), built_in());
    println!("from the path\n{from_path}");
    assert!(from_path.value(Figure::Interventions).unwrap() >= 3.0, "{from_path}");
    assert_eq!(from_path.value(Figure::FromLane), Some(0.0), "{from_path}");
}

#[test]
fn a_pilot_that_does_not_look_is_put_back_at_the_roads_edge_on_the_middle_of_the_lane() {
    let weaving = Weaving::drive(25.0);
    let half_m = weaving.located.track.half_width();
    let mut world = weaving.open(None, Some(weaving.located.clone()));
    assert_eq!(world.limit(), Limit::Road, "the default where the lane is known");
    let (offsets_m, events) = straight_on(&mut world);
    let first =
        EventRecord::MeasuredFrom { line: MeasuredLine::Lane, edge: LimitEdge::Road, left_m: -half_m, right_m: half_m };
    assert!(events.iter().any(|(_, event)| *event == first), "{events:?}");
    let put_m = put_back(&events);
    assert!(put_m.len() >= 2, "{put_m:?}");
    assert!(put_m.iter().all(|put_m| (half_m..half_m + 0.7).contains(&put_m.abs())), "{put_m:?}");
    // It begins on the middle of the lane, and goes on from there.
    let begins = offsets_m.iter().filter(|offset_m| offset_m.abs() < 1e-9).count();
    assert_eq!((begins, offsets_m[0]), (put_m.len() + 1, 0.0), "{offsets_m:?}");

    let mut world = weaving.open(None, None);
    assert_eq!(world.limit(), Limit::Metres(1.0), "the default where it is not");
    let (_, events) = straight_on(&mut world);
    let line = MeasuredLine::RecordedPath;
    let first = EventRecord::MeasuredFrom { line, edge: LimitEdge::Metres, left_m: -1.0, right_m: 1.0 };
    assert!(events.iter().any(|(_, event)| *event == first), "{events:?}");
    assert!(put_back(&events).iter().all(|put_m| (1.0..1.5).contains(&put_m.abs())), "{events:?}");
}

#[test]
fn where_the_lane_is_not_known_the_recorded_path_is_the_line_and_the_card_says_for_how_much_of_the_way() {
    let mut weaving = Weaving::drive(20.0);
    let places = &mut weaving.located.places;
    let half = places.len() / 2;
    places.truncate(half);
    let mut world = weaving.open(Some(Limit::Road), Some(weaving.located.clone()));
    assert!(!world.knows_the_lane());
    let card = driven(&mut world, built_in());
    let share = card.value(Figure::FromLane).unwrap();
    assert!((0.35..0.6).contains(&share), "{card}");
    let (lane, others) = (world.sources().lane, world.sources().pictures + world.sources().steering);
    assert!(lane.abs_diff(others) <= 30, "{:?}", world.sources());
    let (_, events) = straight_on(&mut weaving.open(Some(Limit::Road), Some(weaving.located.clone())));
    let lines: Vec<_> = events.iter().filter(|(_, event)| matches!(event, EventRecord::MeasuredFrom { .. })).collect();
    assert_eq!(lines.len(), 2, "{lines:?}");
    let rest = weaving.located.track.half_width();
    for (at_s, event) in &events {
        if let EventRecord::OffRoad { offset_m } = event {
            let edge_m = if *at_s < lines[1].0 { rest } else { 1.0 };
            assert!((edge_m..edge_m + 0.7).contains(&offset_m.abs()), "{at_s}: {offset_m}, {edge_m}");
        }
    }
}

#[test]
fn by_steering_the_recorded_car_turns_as_it_was_steered_even_where_its_lane_is_known() {
    let weaving = Weaving::drive(8.0);
    let (path, located) = (weaving.dir.path().join("drive"), Some(weaving.located.clone()));
    let mut world = RecordedWorld::open(&path, None, Yaw::Steering, located).unwrap();
    straight_on(&mut world);
    let Sources { lane, pictures, steering } = world.sources();
    assert!((lane, pictures) == (0, 0) && steering > 60, "{:?}", world.sources());
}

#[test]
fn by_the_rally_estonia_protocol_the_drive_goes_on_two_seconds_further() {
    let weaving = Weaving::drive(25.0);
    let open = || weaving.open(Some(Limit::Metres(2.0)), Some(weaving.located.clone())).by(Protocol::RallyEstonia);
    let mut world = open();
    let (rows, hz) = (world.rows().0, world.hz());
    let (offsets_m, events) = straight_on(&mut world);
    let put_m = put_back(&events);
    assert!(put_m.len() >= 2 && put_m.iter().all(|put_m| (2.0..2.7).contains(&put_m.abs())), "{put_m:?}");
    let left_out = (rows - offsets_m.len()) as f64 / hz / put_m.len() as f64;
    assert!((left_out - 2.0).abs() < 0.15, "{left_out:.2} s are left out each time");
    let (ended_s, _) = events.last().unwrap();
    assert!((ended_s - (offsets_m.len() - 1) as f64 / hz).abs() < 0.3, "no time passes meanwhile: {ended_s:.2} s");
    let card = driven(&mut open(), Box::new(ConstantPilot::new(Steering::ZERO)));
    let km = card.value(Figure::DistanceM).unwrap() / 1000.0;
    assert_eq!(card.value(Figure::InterventionsPerKm), Some(put_m.len() as f64 / km), "{card}");
    assert_eq!(card.value(Figure::SteeringRate), Some(0.0), "{card}");
}

#[test]
fn cars_turn_as_far_for_what_they_are_steered_as_the_recorded_one_did() {
    let weaving = Weaving::drive(25.0);
    let folder = weaving.dir.path().join("drive");
    let told = || locating::gearing(&folder, &weaving.located).unwrap();
    let stock = told();
    assert!((stock - 1.0).abs() < 0.05, "{stock}");
    // The log of a build whose car turns a quarter further for what is written.
    let log = folder.join("driving_log.csv");
    let rows = fs::read_to_string(&log).unwrap();
    let turned_further = rows.lines().map(|row| {
        let mut fields: Vec<String> = row.split(',').map(str::to_owned).collect();
        fields[3] = (fields[3].trim().parse::<f64>().unwrap() / 1.25).to_string();
        fields.join(",") + "\n"
    });
    fs::write(&log, turned_further.collect::<String>()).unwrap();
    let gearing = told();
    assert!((gearing / stock - 1.25).abs() < 0.01, "{gearing} {stock}");
    // Degrees to the right of where a car faces that is not steered.
    let heading_deg = |gearing: f64, steering: f64| {
        let mut world = weaving.open(None, Some(weaving.located.clone())).geared(gearing);
        let steering = Steering::saturating(steering);
        (0..8).fold(0.0, |_, _| {
            let Some(Observation { sight: Sight::Telemetry(telemetry), .. }) = world.observe().unwrap() else {
                panic!()
            };
            world.apply(Answer::Steer(Command { steering, throttle: Throttle::ZERO }));
            telemetry.truth.heading_error.unwrap().get()
        })
    };
    let straight = heading_deg(1.0, 0.0);
    let [as_ours, as_recorded] = [1.0, 1.25].map(|gearing| heading_deg(gearing, 0.1) - straight);
    assert!(as_ours > 0.5 && (as_recorded / as_ours - 1.25).abs() < 0.02, "{as_ours} {as_recorded}");
}

/// Rows of a real recording, in a folder of their own, and where in its lane the car was.
pub type Piece = (TempDir, Option<LocatedDrive>);

/// These rows of a real recording, located once for all tests.
pub fn real(name: &'static str, first: usize, count: usize) -> Option<&'static Piece> {
    type Pieces = BTreeMap<(&'static str, usize, usize), &'static OnceLock<Option<Piece>>>;
    static PIECES: Mutex<Pieces> = Mutex::new(BTreeMap::new());
    let piece = *PIECES.lock().unwrap().entry((name, first, count)).or_insert_with(|| Box::leak(Box::default()));
    let locate = || {
        let dir = locate::rows(&shared(&format!("recordings/{name}"))?, first, count);
        let located = locate::located(dir.path(), CameraPosition::Center).drive();
        Some((dir, located))
    };
    piece.get_or_init(locate).as_ref()
}

/// The beginning of the real lake's recording.
pub fn real_lake() -> Option<&'static Piece> {
    real("lake", 0, 330)
}

#[test]
fn along_the_real_lake_the_built_in_pilot_is_near_the_middle_of_the_lane() {
    let Some((dir, located)) = real_lake() else { return };
    let mut world = RecordedWorld::open(dir.path(), None, Yaw::Pictures, located.clone()).unwrap();
    let card = driven(&mut world, built_in());
    println!("from the lane\n{card}");
    assert_eq!(card.value(Figure::Interventions), Some(0.0), "{card}");
    assert!(card.value(Figure::MeanCte).unwrap() < 0.25 && card.value(Figure::MaxCte).unwrap() < 1.0, "{card}");
}

#[test]
fn along_rows_of_each_real_recording_which_it_has_not_seen_the_built_in_pilot_keeps_to_its_lane() {
    for (name, first, count, most_m) in [
        ("lake", 1500, 200, 0.25),
        ("lake-clockwise", 466, 234, 0.25),
        ("lake-high-graphics", 466, 234, 0.25),
        ("jungle", 1150, 200, 0.4),
        ("jungle-rest", 1400, 200, 0.4),
        ("mountain", 800, 200, 0.6),
    ] {
        let Some((dir, located)) = real(name, first, count) else { continue };
        let mut world = RecordedWorld::open(dir.path(), None, Yaw::Pictures, located.clone()).unwrap();
        assert_eq!(world.limit(), Limit::Road, "{name}: the lane is known along most of the way");
        let card = driven(&mut world, built_in());
        println!("{name}\n{card}");
        assert_eq!(card.value(Figure::Interventions), Some(0.0), "{name}: {card}");
        assert!(card.value(Figure::FromLane).unwrap() > 0.9, "{name}: {card}");
        assert!(card.value(Figure::MeanCte).unwrap() <= most_m, "{name}: {card}");
    }
}
