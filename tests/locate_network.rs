//! The network that says where in its lane the car is: on simulated stances, whose places are told, on roads that it has not
//! seen, and on real pictures, whose three cameras must come out where they sit on the car.
//!
//! `LAPWING_LANE_ROWS` looks at more or fewer pictures of each, and `-- --nocapture` prints the figures of `models/README.md`.

use std::{env, path::Path, sync::Arc};

use lapwing::locating::{
    AgainstTruth, RowTruth, Sides,
    network::{ByNetwork, look},
};
use lapwing_core::recording::{CameraPosition, Recording, udacity::DrivingLogWriter};
use lapwing_learn::models::LaneModel;
use lapwing_sim::{
    camera::Scenery,
    locate::LaneTable,
    record::{StanceOptions, stances},
    track::Track,
    world::Setup,
};
use tempfile::tempdir;

use crate::{lane_loop, locate::rows, support::shared};

/// How many pictures are looked at.
fn pictures(default: usize) -> usize {
    env::var("LAPWING_LANE_ROWS").map_or(default, |n| n.parse().expect("LAPWING_LANE_ROWS is a number of pictures"))
}

fn seen(recording: &Path, camera: CameraPosition) -> ByNetwork {
    let model = LaneModel::load(concat!(env!("CARGO_MANIFEST_DIR"), "/models/lane.safetensors")).unwrap();
    look(recording, camera, &model, || {}).unwrap()
}

fn share_sure(seen: &ByNetwork) -> f64 {
    (0..seen.rows.len()).filter(|i| seen.sure(*i).is_some()).count() as f64 / seen.rows.len() as f64
}

/// The network's errors on stances with a seed of their own, in all weathers.
fn on_stances(road: &str) -> (f64, AgainstTruth) {
    let track = Arc::new(Track::open(road).unwrap());
    let setup = Setup { seed: 900, ..Setup::new(Arc::clone(&track), Arc::new(Scenery::new(&track))) };
    let dir = tempdir().unwrap();
    let log = DrivingLogWriter::create(dir.path(), jiff::civil::date(2026, 11, 23).at(8, 0, 0, 0)).unwrap();
    let count = pictures(300) as u64;
    stances(&setup, log, StanceOptions { count, every_weather: true }, || true).unwrap();
    let table = LaneTable::read(&dir.path().join("lane.csv"), Track::open).unwrap();
    let seen = seen(dir.path(), CameraPosition::Center);
    let truth = |i: usize| Some(RowTruth::of_pose(table.rows[i].1?, &table.track));
    let (share, errors) = (share_sure(&seen), seen.against(truth, 0..seen.rows.len()).unwrap());
    println!("{road}: sure of {:.1} %, {errors:?}", 100.0 * share);
    (share, errors)
}

/// Where the network sees the side cameras of a real recording.
fn on_real_pictures(recording: &str, from: usize) -> Option<(f64, Sides)> {
    let folder = shared(recording)?;
    let count = pictures(200);
    let dir = rows(&folder, if count > 200 { 0 } else { from }, count);
    let [center, left, right] =
        [CameraPosition::Center, CameraPosition::Left, CameraPosition::Right].map(|camera| seen(dir.path(), camera));
    let all = Recording::open(dir.path()).unwrap().seen().count();
    assert_eq!(center.rows.len(), all, "a row for each picture");
    let (share, sides) = (share_sure(&center), center.beside([&left, &right], 0..all).unwrap());
    println!("{recording}: sure of {:.1} %, {sides:?}", 100.0 * share);
    Some((share, sides))
}

#[test]
fn on_stances_in_all_weathers_the_network_sees_where_the_car_is_on_roads_that_it_has_never_seen_too() {
    for (road, least_sure, median_m, p95_m) in [
        ("lake", 0.95, 0.10, 0.40),
        ("jungle", 0.40, 0.35, 2.0),
        ("mountain", 0.90, 0.25, 0.90),
        ("random:201", 0.90, 0.30, 1.0),
        ("random:202", 0.65, 0.30, 1.0),
        ("random:203", 0.90, 0.20, 0.70),
    ] {
        let (share, AgainstTruth { offset_m, heading_deg, .. }) = on_stances(road);
        assert!(share >= least_sure, "{road}: sure of {share}");
        assert!(offset_m.median <= median_m && offset_m.p95 <= p95_m, "{road}: {offset_m:?}");
        assert!(heading_deg.unwrap().median <= 5.0, "{road}: {heading_deg:?}");
    }
}

#[test]
fn on_real_pictures_the_network_sees_the_side_cameras_about_where_they_sit_on_the_car() {
    let looked_at = [("recordings/lake", 600), ("recordings/jungle", 300), ("recordings/mountain", 300)]
        .map(|(recording, from)| on_real_pictures(recording, from));
    for (seen, (least_sure, median_m, p95_m)) in
        looked_at.into_iter().zip([(0.9, 0.15, 0.5), (0.4, 0.3, 1.0), (0.5, 0.4, 1.4)])
    {
        let Some((share, sides)) = seen else { continue };
        assert!(share > least_sure, "sure of {share}: {sides:?}");
        assert!(sides.errors_m.median <= median_m && sides.errors_m.p95 <= p95_m, "{sides:?}");
        assert!(sides.left_m < -0.5 && sides.right_m > 0.5, "{sides:?}");
    }
}

#[test]
fn on_the_real_lake_the_network_and_the_drawn_road_see_the_same_offset() {
    let Some((dir, drive)) = lane_loop::real_lake() else { return };
    let drive = drive.as_ref().expect("the lake is located");
    let seen = seen(dir.path(), CameraPosition::Center);
    let drawn = |row: usize| Some(RowTruth::of_pose(drive.places[row]?.pose, &drive.track));
    let offset_m = seen.against(drawn, 0..seen.rows.len()).unwrap().offset_m;
    println!("the real lake: {offset_m:?}");
    assert!(offset_m.rows > 250 && offset_m.median <= 0.15, "{offset_m:?}");
}
