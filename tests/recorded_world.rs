//! Worlds made from recordings: a car that drives by itself, and sees what was recorded where it is.

use std::{fs, path::Path, sync::Arc, time::Instant};

use lapwing_core::{
    config::ControlSettings,
    driver::Driver,
    perception::{Frame, decode_jpeg},
    pilot::{ConstantPilot, Pilot, PurePursuit},
    protocol::{Answer, CameraImage, Observation, Sight, World},
    recording::Recording,
    units::{MPS_PER_MPH, Mph, Steering},
};
use lapwing_learn::models;
use lapwing_score::{
    judged,
    score::{Figure, Scorecard},
};
use lapwing_sim::{
    along::{Beside, Glimpse, PILOTNET_ROWS, Views, Warp, read_stock},
    camera::{Camera, Renderer, Scenery},
    locate::table,
    world::{Setup, Simulation},
};

use crate::{lane_loop::Weaving, program, support::shared};

/// A simulated world whose pilot sees a weaving drive's pictures.
fn seen_by(weaving: &Weaving, seconds: f64) -> (Simulation, Views) {
    let track = weaving.located.track.clone();
    let drives = [(weaving.dir.path().join("drive"), weaving.located.clone())];
    let views = Views::open(&track, false, &drives).unwrap();
    let scenery = Arc::new(Scenery::new(&track));
    let setup = Setup { laps: None, longest_s: Some(seconds), ..Setup::new(track, scenery) };
    (Simulation::new(setup).unwrap(), views)
}

fn driven(world: &mut Simulation, pilot: Box<dyn Pilot>, mph: f64) -> Scorecard {
    let control = ControlSettings { speed_mph: Mph::constant(mph), ..ControlSettings::default() };
    judged::run(world, &mut Driver::new(pilot, &control, Instant::now), &mut []).unwrap().card
}

/// How far two pictures are apart where PilotNet looks, in grey levels.
fn apart(a: &Frame, b: &Frame) -> f64 {
    let rows = PILOTNET_ROWS.start * a.width() * 3..PILOTNET_ROWS.end * a.width() * 3;
    let sum: f64 =
        a.rgb()[rows.clone()].iter().zip(&b.rgb()[rows.clone()]).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / rows.len() as f64
}

#[test]
fn what_is_seen_is_what_a_camera_there_would_have_taken() {
    let weaving = Weaving::drive(20.0);
    let (world, views) = seen_by(&weaving, 12.0);
    let sights = views.sights();
    let mut world = world.seen_by(views);
    let mut renderer = Renderer::new(world.setup().scenery.clone());
    let (mut shown, mut drawn, mut before, mut here_there) = (Frame::default(), Frame::default(), None, vec![]);
    // The expert stays in the middle of the road, on which the recorded drive weaved.
    while let Some(Observation { sight: Sight::Telemetry(telemetry), .. }) = world.observe().unwrap() {
        let CameraImage::Jpeg(jpeg) = &telemetry.image else { panic!("{telemetry:?}") };
        decode_jpeg(jpeg, &mut shown).unwrap();
        world.draw(&mut renderer, &Camera::CENTER, &mut drawn);
        let there = before.replace(drawn.clone()).map(|before| apart(&shown, &before));
        here_there.extend(there.map(|there| (apart(&shown, &drawn), there)));
        let command = world.expert(Mph::constant(15.0));
        world.apply(Answer::Steer(command));
    }
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| here_there.iter().map(of).sum::<f64>() / here_there.len() as f64;
    let (here, before) = (mean(&|x| x.0), mean(&|x| x.1));
    println!("{here:.2} levels from what is drawn there, {before:.2} from a moment before; {:?}", sights.lock());
    assert!(here < 16.0 && here < 0.75 * before, "{here:.2}, {before:.2}");
    let sights = sights.lock().unwrap().clone();
    assert_eq!((sights.drawn, sights.unusable.0), (0, 0), "{sights:?}");
    assert!(sights.apart_m / f64::from(sights.recorded) < 1.5, "{sights:?}");
}

#[test]
fn a_pilot_that_sees_the_road_keeps_to_it_and_one_that_does_not_leaves_it() {
    let weaving = Weaving::drive(45.0);
    let (world, views) = seen_by(&weaving, 30.0);
    let mut world = world.seen_by(views);
    let good = driven(&mut world, models::built_in(Instant::now).unwrap().pilot(), 15.0);
    println!("{good}");
    assert!(good.value(Figure::MeanCte).unwrap() < 0.35, "{good}");
    assert_eq!(good.value(Figure::Collisions), Some(0.0), "{good}");
    let mph = good.value(Figure::DistanceM).unwrap() / good.value(Figure::TimeS).unwrap() / MPS_PER_MPH;
    assert!((12.0..16.0).contains(&mph), "its own speed, not the recorded 20: {good}");
    let (world, views) = seen_by(&weaving, 30.0);
    let blind = Box::new(ConstantPilot::new(Steering::ZERO));
    let bad = driven(&mut world.seen_by(views), blind, 15.0);
    assert!(bad.value(Figure::MeanCte).unwrap() > 1.0, "{bad}");
}

#[test]
fn where_nothing_was_recorded_the_road_is_drawn() {
    let weaving = Weaving::drive(8.0);
    let (world, views) = seen_by(&weaving, 14.0);
    assert!((0.03..0.2).contains(&views.covered()), "{}", views.covered());
    let sights = views.sights();
    let card = driven(&mut world.seen_by(views), Box::new(PurePursuit::default()), 20.0);
    let sights = sights.lock().unwrap().clone();
    assert!(sights.recorded > 60 && sights.drawn > 40, "{sights:?}");
    assert_eq!(card.value(Figure::OffRoads), Some(0.0), "{card}");
}

#[test]
fn the_program_drives_where_a_data_set_was_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| program::lapwing_in(dir.path(), "", arguments);
    // Whoever sets a limit gets what was asked for.
    assert_eq!(run(&["record", "--out", "laps", "--max-time", "10"]).0, 0);
    let drive = ["drive", "--world", "laps", "--max-time", "6", "--no-recording"];
    let (code, out, err) = run(&[&drive[..], &["--json"]].concat());
    assert_eq!(code, 0, "{err}");
    let result: serde_json::Value = serde_json::from_str(&out).unwrap();
    let seen = &result["seen"];
    assert!(seen["recorded"].as_u64().unwrap() > 80, "{seen}");
    assert_eq!(seen["drawn"], 0, "{seen}");
    assert!(result["mean_abs_cte_m"].as_f64().is_none_or(|cte| cte < 0.5), "{result}");
    let (_, out, _) = run(&drive);
    assert!(out.contains("\n  recorded          ") && out.contains("% of the road shown"), "{out}");
    // What `record` or `locate` wrote of the places is used in place of locating them again.
    let (code, out, err) = run(&[&drive[..], &["--json", "--lane", "laps/lane.csv"]].concat());
    assert_eq!(code, 0, "{err}");
    let told: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(told["seen"]["drawn"], 0, "{told}");
    assert!(told["seen"]["apart_m"].as_f64().unwrap() < 0.6, "{told}");
    let table = std::fs::read_to_string(dir.path().join("laps/lane.csv")).unwrap();
    std::fs::write(dir.path().join("short.csv"), table.lines().take(9).collect::<Vec<_>>().join("\n")).unwrap();
    let (code, _, err) = run(&[&drive[..], &["--lane", "short.csv"]].concat());
    assert!(code == 1 && err.contains("expected the places of the 150 pictures of laps, got 8 rows"), "{code}: {err}");
    let (code, _, err) = run(&[&drive[..], &["--lane", "short.csv", "laps/lane.csv"]].concat());
    assert!(code == 2 && err.contains("--lane: expected one file for each of 1 recording, got 2"), "{code}: {err}");
    let (code, _, err) = run(&["train", "--data", "laps", "--lane", "short.csv", "laps/lane.csv", "--out", "trained"]);
    assert!(code == 2 && err.contains("--lane: expected one file for each of 1 data set, got 2"), "{code}: {err}");
    let along = ["replay", "laps", "--closed-loop", "--lane", "laps/lane.csv", "--json"];
    let (code, out, err) = run(&along);
    assert_eq!(code, 0, "{err}");
    let along: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&along["from_lane_share"], &along["of_another_lap"]), (&1.0.into(), &0.into()), "{along}");
    assert!((0.01..0.5).contains(&along["apart_m"].as_f64().unwrap()), "{along}");
    let (code, _, err) = run(&[&drive[..], &["--lane", "laps/lane.csv", "--track", "mountain"]].concat());
    let helps = "got some on lake: leave out --track to drive on lake, or name recordings of mountain";
    assert!(code == 1 && err.contains(helps), "{code}: {err}");
    let (code, _, err) = run(&[&drive[..], &["--conditions", "rain=1"]].concat());
    assert!(code == 2 && err.contains("latency_ms or dropped with --world, got rain=1.0: light"), "{code}: {err}");
    std::fs::write(dir.path().join("nothing.txt"), "").unwrap();
    let (code, _, err) = run(&["drive", "--world", "nowhere"]);
    assert!(code == 1 && err.contains("nowhere"), "{code}: {err}");
}

#[test]
fn a_picture_that_cannot_be_used_is_a_bad_frame_and_without_any_there_is_no_world() {
    let dir = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| program::lapwing_in(dir.path(), "", arguments);
    run(&["record", "--out", "laps", "--max-time", "6"]);
    let log = std::fs::read_to_string(dir.path().join("laps/driving_log.csv")).unwrap();
    let center = |row: usize| {
        let path = log.lines().nth(row).unwrap().split(',').next().unwrap();
        dir.path().join("laps").join("IMG").join(path.rsplit('/').next().unwrap())
    };
    let pointer = "version https://git-lfs.github.com/spec/v1\n";
    std::fs::write(center(30), pointer).unwrap();
    std::fs::remove_file(center(40)).unwrap();
    let along = ["replay", "laps", "--json"];
    for more in [&[][..], &["--closed-loop", "--lane", "laps/lane.csv"]] {
        let (code, out, err) = run(&[&along[..], more].concat());
        assert!(code == 1 && err.contains("at most 1 % bad frames") && err.contains("got 2 of "), "{code}: {err}");
        let (code, again, err) = run(&[&along[..], more, &["--allow-bad-frames"]].concat());
        assert_eq!(code, 0, "{err}");
        let bad = |out: &str| serde_json::from_str::<serde_json::Value>(out).unwrap()["bad_frames"].clone();
        assert_eq!([bad(&out), bad(&again)], [2, 2]);
    }
    for row in 0..log.lines().count() {
        std::fs::write(center(row), pointer).unwrap();
    }
    let world = ["drive", "--world", "laps", "--lane", "laps/lane.csv", "--max-time", "2", "--no-recording"];
    let (code, _, err) = run(&world);
    let expected = "--world: expected usable pictures of lake, got none; the first cannot be used: ";
    assert!(code == 1 && err.contains(expected) && err.contains("expected a JPEG"), "{err}");
    let (code, _, err) =
        run(&[&along[..], &["--closed-loop", "--lane", "laps/lane.csv", "--allow-bad-frames"]].concat());
    assert!(code == 1 && err.contains("expected a JPEG"), "{err}");
    let (_, out, _) = run(&["locate", "laps", "--json"]);
    assert_eq!(serde_json::from_str::<serde_json::Value>(&out).unwrap()["unreadable"], 90, "{out}");
}

#[test]
fn of_two_recordings_the_one_of_another_road_is_named_and_its_run_says_that_pictures_were_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| program::lapwing_in(dir.path(), "", arguments);
    for track in ["lake", "jungle"] {
        let (_, out, err) = run(&["record", "--track", track, "--out", track, "--max-time", "3"]);
        assert!(out.starts_with("45 rows, "), "{out}{err}");
    }
    let world = ["--world", "lake", "jungle", "--lane", "lake/lane.csv", "jungle/lane.csv", "--track", "jungle"];
    let drive = ["--laps", "2", "--max-time", "2", "--recordings", "runs"];
    let (code, out, err) = run(&[&["drive"][..], &world, &drive].concat());
    assert_eq!(code, 0, "{err}");
    let left_out = "--world: lake: leaving out all 45 located pictures, taken on lake: the road is jungle\n";
    assert!(err.contains(left_out) && !err.contains("jungle: leaving out"), "{err}");
    assert!(out.contains(" on jungle, in recorded pictures, seed 0\n"), "{out}");
    let (code, out, err) = run(&["score", "runs", "--json"]);
    assert_eq!(code, 0, "{err}");
    let score: serde_json::Value = serde_json::from_str(&out).unwrap();
    let of_run = &score["runs"][0];
    assert_eq!(of_run["laps_asked"], 2, "{of_run}");
    assert!(of_run["setting"].as_str().unwrap().starts_with("jungle, in recorded pictures, "), "{of_run}");
}

/// Rows of which no part was driven in the track's direction: the road is driven as they were.
#[test]
fn the_real_lake_is_driven_clockwise_where_it_was_recorded_clockwise() {
    let Some(shared) = shared("recordings/lake-clockwise") else { return };
    let rows = crate::locate::rows(&shared, 0, 260);
    let path = rows.path().to_str().unwrap();
    let drive = ["drive", "--world", path, "--max-time", "20", "--speed", "15", "--no-recording", "--json"];
    let (code, out, err) = program::lapwing_in(rows.path(), "", &drive);
    assert_eq!(code, 0, "{err}");
    let result: serde_json::Value = serde_json::from_str(&out).unwrap();
    println!("{result:#}");
    assert!(result["seen"]["recorded"].as_u64().unwrap() > 200, "{result}");
    // A good driver is good in it, too.
    assert_eq!((&result["collisions"], &result["off_roads"]), (&0.into(), &0.into()), "{result}");
    assert!(result["p95_cte_m"].as_f64().unwrap() < 1.0, "{result}");
}

/// Joins a drive in the jungle, some pictures of which have no side cameras, to one on the lake; returns the table of
/// their places.
fn joined(dir: &Path) -> String {
    let (mut log, mut places) = (String::new(), vec![]);
    for (track, longest_s) in [("lake", "3"), ("jungle", "2")] {
        program::lapwing_in(dir, "", &["record", "--track", track, "--out", track, "--max-time", longest_s]);
        for (i, row) in fs::read_to_string(dir.join(track).join("driving_log.csv")).unwrap().lines().enumerate() {
            let mut fields: Vec<&str> = row.split(',').collect();
            if track == "jungle" && i < 10 {
                fields[1..3].fill("");
            }
            log += &(fields.join(",") + "\n");
        }
        let table = fs::read_to_string(dir.join(track).join("lane.csv")).unwrap();
        places.extend(table.lines().skip(1).map(|line| line.splitn(3, ',').nth(2).unwrap().to_owned()));
    }
    let folder = dir.join("joined");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("driving_log.csv"), log).unwrap();
    let moments = Recording::open(&folder).unwrap().seen().zip(places);
    moments.fold(table::heading(), |text, (moment, place)| {
        let moment = moment.unwrap();
        text + &format!("{},{:.3},{place}\n", moment.row, moment.at.as_secs_f64())
    })
}

#[test]
fn of_two_roads_in_one_log_each_drive_has_its_own_and_missing_side_cameras_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let table = joined(dir.path());
    fs::write(dir.path().join("lane.csv"), table).unwrap();
    let run = |arguments: &[&str]| program::lapwing_in(dir.path(), "", arguments);
    let drive = ["drive", "--world", "joined", "--lane", "lane.csv", "--max-time", "2", "--no-recording"];
    let (code, out, err) = run(&[&drive[..], &["--track", "jungle"]].concat());
    assert_eq!(code, 0, "{out}{err}");
    let left_out = "--world: joined: leaving out 45 of 75 located pictures, taken on lake: the road is jungle\n";
    assert!(err.contains(left_out), "{err}");
    let no_sides = "--world: joined: no side cameras in 10 of 30 pictures, so more is filled in";
    assert!(err.contains(no_sides), "{err}");
    let (code, out, err) = run(&drive);
    assert_eq!(code, 0, "{out}{err}");
    assert!(err.contains("leaving out 30 of 75 located pictures, taken on jungle: the road is lake\n"), "{err}");
    assert!(!err.contains("no side cameras"), "those of the lake have all: {err}");
    let along = ["replay", "joined", "--closed-loop", "--lane", "lane.csv", "--json"];
    let (code, out, err) = run(&[&along[..], &["--rows", "45..75"]].concat());
    assert_eq!(code, 0, "{err}");
    let result: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&result["from_lane_share"], err.contains("another road")), (&1.0.into(), false), "{result}{err}");
    let (code, _, err) = run(&along);
    assert_eq!(code, 0, "{err}");
    assert!(err.contains("30 located pictures taken on another road than lake"), "{err}");
}

/// How far the luminances of two pictures are apart above the horizon, in grey levels.
fn apart_above(a: &Frame, b: &Frame) -> f64 {
    let luminance = |[r, g, b]: [u8; 3]| 0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b);
    let [a, b] = [a, b].map(|frame| frame.rgb().as_chunks::<3>().0.iter().take(56 * frame.width()));
    let apart: Vec<f64> = a.zip(b).map(|(a, b)| (luminance(*a) - luminance(*b)).abs()).collect();
    apart.iter().sum::<f64>() / apart.len() as f64
}

/// The centre camera's picture, warped to where a side camera stands, is what that shows.
#[test]
fn real_side_cameras_show_nearly_what_the_centre_pictures_do_from_where_they_stand() {
    let warp = Warp::new();
    for (name, most) in [("lake", 14.0), ("jungle", 15.0), ("mountain", 13.0)] {
        let Some(path) = shared(&format!("recordings/{name}")) else { return };
        let moments = Recording::open(&path).unwrap().seen().skip(105).take(1896).step_by(35);
        let mut errors = vec![];
        for moment in moments {
            let frames = moment.unwrap().pictures.map(|picture| {
                let mut frame = Frame::default();
                read_stock(&picture.unwrap(), &mut frame).unwrap();
                frame
            });
            for (side, camera) in [(1, Camera::LEFT), (2, Camera::RIGHT)] {
                let beside = Beside { offset_m: camera.mount.position.x, ..Beside::default() };
                let (mut from_center, mut from_side) = (Frame::default(), Frame::default());
                let mut pictures = [Some(&frames[0]), None, None];
                warp.render(&[Glimpse { pictures, beside }], &mut from_center).unwrap();
                pictures[side] = Some(&frames[side]);
                warp.render(&[Glimpse { pictures, beside }], &mut from_side).unwrap();
                errors.push(apart_above(&from_center, &from_side));
            }
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        println!("{name}: {mean:.1} levels above the horizon in {} pictures", errors.len());
        assert!(mean < most, "{name}: {mean:.1}");
    }
}
