//! Poses that are known, found again in the pictures that the simulator draws from them.

use super::*;
use crate::{
    camera::{Camera, Renderer, Shot, encode_jpeg, tests::scenery},
    conditions::Conditions,
    vehicle::Car,
};
use lapwing_core::{
    car::REAR_AXLE_M,
    motion::Motion,
    perception::{Frame, decode_jpeg},
};

/// A weaving drive along the lake: a pose each metre from here on. The rear axle goes where the car heads.
fn weaving(from_m: f64, count: usize) -> Vec<Pose> {
    let (track, _) = scenery("lake");
    let pose = |i: usize| {
        let (s_m, phase) = (from_m + i as f64, i as f64 / 9.0);
        let (slope, bend) = (0.7 / 9.0 * phase.cos(), -0.7 / 81.0 * phase.sin());
        let heading_rad = slope.atan() - REAR_AXLE_M * (bend + track.at(s_m).curvature);
        Pose { s_m, offset_m: 0.7 * phase.sin(), heading_rad, pitch_rad: 0.0 }
    };
    (0..count).map(pose).collect()
}

/// How the car moved along these poses, and the pictures it took, as JPEGs.
fn recorded(poses: &[Pose], conditions: &Conditions) -> (Vec<Motion>, Vec<Vec<u8>>) {
    let (track, scenery) = scenery("lake");
    let mut renderer = Renderer::new(scenery);
    let cars: Vec<_> = poses
        .iter()
        .map(|pose| {
            let station = track.at(pose.s_m);
            let position = track.point(pose.s_m, pose.offset_m);
            Car { position, yaw: station.yaw + pose.heading_rad, pitch: station.grade.atan(), ..Car::default() }
        })
        .collect();
    let motion = |i: usize| {
        let (now, before) = (&cars[i], &cars[i.saturating_sub(1)]);
        Motion {
            way_m: now.position.distance(before.position),
            turn_rad: lapwing_core::motion::turn(now.yaw - before.yaw),
        }
    };
    let picture = |(i, car): (usize, &Car)| {
        let mut frame = Frame::default();
        let shot = Shot { car, actors: &[], conditions, seed: i as u64, time_s: i as f64 / 10.0 };
        renderer.render(&Camera::CENTER, &shot, &mut frame);
        encode_jpeg(&frame, 75)
    };
    ((0..cars.len()).map(motion).collect(), cars.iter().enumerate().map(picture).collect())
}

/// The median and the 95th percentile.
fn spread(mut errors: Vec<f64>) -> (f64, f64) {
    errors.sort_by(f64::total_cmp);
    (errors[errors.len() / 2], errors[errors.len() * 95 / 100])
}

#[test]
fn a_weaving_drive_is_located_in_the_pictures_it_took() {
    for (from_m, conditions) in [(300.0, ""), (690.0, "haze=0.4"), (820.0, "rain=0.6")] {
        let (track, scenery) = scenery("lake");
        let poses = weaving(from_m, 40);
        let (motions, pictures) = recorded(&poses, &Conditions::parse(conditions).unwrap());
        let mut overlay = Overlay::new(track.into(), scenery, (320, 160));
        // Beside where it is, in every respect.
        let start = poses[0].moved(DVec3::new(1.5, 0.5, 0.05));
        let read = |i: usize, frame: &mut Frame| decode_jpeg(&pictures[i], frame);
        let located = overlay.follow(&[Known { picture: 0, pose: start, deviation_m: 3.0 }], &motions, read).unwrap();
        let off = |of: fn(&Pose) -> f64| {
            spread(located.iter().zip(&poses).map(|(found, pose)| (of(&found.pose) - of(pose)).abs()).collect())
        };
        let (offset, heading) = (off(|pose| pose.offset_m), off(|pose| pose.heading_rad.to_degrees()));
        println!("{from_m} {conditions}: {offset:.3?} m, {heading:.2?} degrees, {:.2?} m along", off(|pose| pose.s_m));
        assert!(offset.0 < 0.10 && offset.1 < 0.25, "{from_m} {conditions}: {offset:.3?} m");
        assert!(heading.0 < 0.5, "{from_m} {conditions}: {heading:.2?} degrees");
    }
}

#[test]
fn a_road_is_seen_alike_as_itself_and_as_its_reverse() {
    let (track, scenery) = scenery("mountain");
    let back = track.reversed().unwrap();
    let stations = (0..track.length() as usize).map(|s| s as f64);
    let s_m = stations.max_by(|a, b| track.at(*a).grade.abs().total_cmp(&track.at(*b).grade.abs())).unwrap();
    assert!(track.at(s_m).grade.abs() > 0.1, "a slope");
    let against = Pose { s_m, offset_m: 0.3, heading_rad: std::f64::consts::PI + 0.05, pitch_rad: 0.0 };
    let along = Pose { s_m: back.length() - s_m, offset_m: -0.3, heading_rad: 0.05, pitch_rad: 0.0 };
    let seen =
        |track: crate::track::Track, pose| Overlay::new(track.into(), scenery.clone(), (320, 160)).line(pose, 0.0);
    let lines = seen(track, against).into_iter().zip(seen(back, along));
    for ((x, y), (column, row)) in lines.filter(|((x, y), _)| (0.0..320.0).contains(x) && (0.0..160.0).contains(y)) {
        assert!((x - column).abs() < 2.0 && (y - row).abs() < 2.0, "({x}, {y}) and ({column}, {row})");
    }
}

#[test]
fn a_few_doubtful_pictures_between_known_places_are_no_gap_unless_the_place_is_unsure() {
    let pose = Pose { s_m: 0.0, offset_m: 0.0, heading_rad: 0.0, pitch_rad: 0.0 };
    let mut located = vec![Located::known(pose); 140];
    for (i, place) in located.iter_mut().enumerate() {
        // Three that agree badly are in one window around 29 and 30 alone, and around 99 and 100; 60 to 80 all do.
        place.fit.agreement = if matches!(i, 20 | 38 | 39 | 60..80 | 90 | 108 | 109) { 0.05 } else { 0.2 };
    }
    located[100].deviation.offset_m = 0.5;
    let known = seen(&located).iter().map(Option::is_some).collect::<Vec<_>>();
    assert!(known[..48].iter().all(|known| *known), "{known:?}");
    assert!(known[60..80].iter().all(|known| !known), "{known:?}");
    assert!(known[99] && !known[100] && known[101], "{known:?}");
}
