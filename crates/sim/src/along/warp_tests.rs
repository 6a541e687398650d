use std::sync::Arc;

use super::*;
use crate::{
    camera::{
        Renderer,
        tests::{apart, scenery},
    },
    world::{Setup, Simulation},
};

/// The lake, and a car on it.
fn lake() -> (Simulation, Renderer) {
    let (track, scenery) = scenery("lake");
    let setup = Setup::new(Arc::new(track), scenery.clone());
    (Simulation::new(setup).unwrap(), Renderer::new(scenery))
}

/// What a camera sees from `offset_m` beside the road's middle, `heading_rad` askew.
fn seen(world: &mut (Simulation, Renderer), s: f64, at: Beside, camera: &Camera) -> Frame {
    let mut frame = Frame::default();
    world.0.put(s, at.offset_m, at.heading_rad, 9.0);
    world.0.draw(&mut world.1, camera, &mut frame);
    frame
}

/// Errors of the warped and of the recorded picture, each compared with what is really seen there, over four places.
fn error(beside: Beside, cameras: usize) -> (f64, f64) {
    let mut world = lake();
    let warp = Warp::new();
    let places = [120.0, 330.0, 560.0, 800.0];
    let (mut warped, mut unwarped) = (0.0, 0.0);
    for s in places {
        let pictures: Vec<Frame> =
            CAMERAS[..cameras].iter().map(|camera| seen(&mut world, s, Beside::default(), camera)).collect();
        let mut out = Frame::default();
        let pictures = [pictures.first(), pictures.get(1), pictures.get(2)];
        assert!(warp.render(&[Glimpse { pictures, beside }], &mut out).is_some());
        let really = seen(&mut world, s, beside, &Camera::CENTER);
        warped += apart(&out, &really) / places.len() as f64;
        unwarped += apart(pictures[0].unwrap(), &really) / places.len() as f64;
    }
    (warped, unwarped)
}

#[test]
fn on_the_path_a_picture_stays_as_it_is() {
    let mut world = lake();
    let recorded = seen(&mut world, 330.0, Beside::default(), &Camera::CENTER);
    let mut out = Frame::default();
    let glimpse = Glimpse { pictures: [Some(&recorded), None, None], beside: Beside::default() };
    assert_eq!(Warp::new().render(&[glimpse], &mut out), Some(0.0));
    assert!(apart(&out, &recorded) < 0.5, "{}", apart(&out, &recorded));
}

#[test]
fn a_car_that_faces_elsewhere_sees_what_the_warped_picture_shows() {
    for heading_rad in [-0.1, 0.1] {
        let (warped, unwarped) = error(Beside { offset_m: 0.0, heading_rad, ..Beside::default() }, 1);
        assert!(warped < 0.5 * unwarped, "{heading_rad}: {warped:.2} against {unwarped:.2}");
    }
}

#[test]
fn a_car_beside_sees_what_the_warped_picture_shows_with_one_camera_and_better_with_three() {
    for (offset_m, heading_rad) in [(-0.9, 0.0), (0.9, 0.0), (0.7, -0.08)] {
        let beside = Beside { offset_m, heading_rad, ..Beside::default() };
        let ((one, unwarped), (three, _)) = (error(beside, 1), error(beside, 3));
        assert!(one < 0.5 * unwarped, "{beside:?}: {one:.2} against {unwarped:.2}");
        assert!(three < one, "{beside:?}: {three:.2} with three, {one:.2} with one");
    }
}

#[test]
fn the_bonnet_goes_with_the_car() {
    let mut world = lake();
    let recorded = seen(&mut world, 330.0, Beside::default(), &Camera::CENTER);
    let mut out = Frame::default();
    let beside = Beside { offset_m: 0.8, heading_rad: 0.1, ..Beside::default() };
    assert!(Warp::new().render(&[Glimpse { pictures: [Some(&recorded), None, None], beside }], &mut out).is_some());
    for column in (120..180).step_by(10) {
        assert_eq!(out.pixel(column, 150), recorded.pixel(column, 150));
    }
    assert_ne!(out.pixel(20, 110), recorded.pixel(20, 110), "the road does not");
}

#[test]
fn a_picture_of_another_size_is_refused() {
    let small = Frame::new(2, 2, vec![0; 12]).unwrap();
    let mut out = Frame::default();
    for picture in [Some(&small), None] {
        let glimpse = Glimpse { pictures: [picture, None, None], beside: Beside::default() };
        assert_eq!(Warp::new().render(&[glimpse], &mut out), None);
    }
    assert_eq!(Warp::new().render(&[], &mut out), None);
}

/// A picture of one grey.
fn blank(light: u8) -> Frame {
    let (width, height) = SIZE;
    Frame::new(width, height, vec![light; width * height * 3]).unwrap()
}

/// The largest share of PilotNet's rows that is filled in, up to this offset and heading to either side.
fn filled(cameras: usize, offset_m: f64, heading_deg: f64) -> f64 {
    let (warp, picture, mut out) = (Warp::new(), blank(0), Frame::default());
    let steps = |most: f64| (-5..=5).map(move |i| most * f64::from(i) / 5.0);
    let pictures = std::array::from_fn(|camera| (camera < cameras).then_some(&picture));
    let mut unseen = |offset_m: f64, heading_deg: f64| {
        let beside = Beside { offset_m, heading_rad: heading_deg.to_radians(), ..Beside::default() };
        warp.render(&[Glimpse { pictures, beside }], &mut out).unwrap()
    };
    steps(offset_m)
        .flat_map(|m| steps(heading_deg).map(move |deg| (m, deg)))
        .fold(0.0, |most, (m, deg)| most.max(unseen(m, deg)))
}

#[test]
fn what_must_be_filled_in_stays_within_the_documented_bounds() {
    assert_eq!(filled(1, 0.0, 0.0), 0.0);
    assert_eq!(filled(3, 0.75, 0.0), 0.0);
    for (cameras, offset_m, heading_deg, most) in
        [(3, 0.5, 1.0, 0.005), (3, 0.5, 2.0, 0.014), (3, 1.0, 2.0, 0.06), (1, 0.25, 1.0, 0.045), (1, 1.0, 2.0, 0.13)]
    {
        let filled = filled(cameras, offset_m, heading_deg);
        assert!(filled <= most, "{cameras} cameras, {offset_m} m, {heading_deg} degrees: {filled:.4}");
        assert!(filled > 0.7 * most, "the documented bound is far off: {filled:.4} of {most}");
    }
}

#[test]
fn no_black_border_enters_a_picture_wherever_the_car_is() {
    let white = blank(255);
    let warp = Warp::new();
    for (offset_m, heading_rad) in [(0.0, 0.7), (-3.0, 0.3), (5.0, -0.7), (-20.0, 0.0)] {
        for pictures in [[Some(&white), None, None], [Some(&white); 3]] {
            let mut out = Frame::default();
            let beside = Beside { offset_m, heading_rad, ..Beside::default() };
            assert!(warp.render(&[Glimpse { pictures, beside }], &mut out).is_some());
            assert!(out.rgb().iter().all(|light| *light == 255), "{offset_m} m, {heading_rad}");
        }
    }
}

#[test]
fn two_pictures_of_a_place_tell_where_one_was_taken_beside_the_other() {
    let mut world = lake();
    let warp = Warp::new();
    for (s, first, second) in [
        (120.0, Beside::default(), Beside { offset_m: 0.8, ahead_m: 0.0, heading_rad: 0.0 }),
        (
            330.0,
            Beside { offset_m: -0.6, ahead_m: 0.0, heading_rad: 0.05 },
            Beside { offset_m: 0.9, ..Beside::default() },
        ),
        (
            560.0,
            Beside { offset_m: 0.5, ..Beside::default() },
            Beside { offset_m: -0.9, ahead_m: 0.0, heading_rad: -0.06 },
        ),
    ] {
        let [one, other] = [first, second].map(|at| seen(&mut world, s, at, &Camera::CENTER));
        let Again { beside, alike } = warp.again(&one, &other).unwrap();
        // Across the road, along which the first car may have been turned.
        let (right_m, ahead_m) = (beside.offset_m, beside.ahead_m);
        let across_m = right_m * first.heading_rad.cos() + ahead_m * first.heading_rad.sin();
        let expected = (second.offset_m - first.offset_m, second.heading_rad - first.heading_rad);
        println!(
            "{s}: {across_m:.3} of {:.3} m, {:.4} of {:.4} rad, {alike:.3}",
            expected.0, beside.heading_rad, expected.1
        );
        assert!((across_m - expected.0).abs() < 0.1 && (beside.heading_rad - expected.1).abs() < 0.02, "{beside:?}");
        assert!(alike > 0.5);
    }
    assert_eq!(warp.again(&Frame::default(), &Frame::default()), None);
}

#[test]
fn a_place_is_beside_another_as_it_was_reached_from_there() {
    let there = (DVec3::new(3.0, 0.0, -5.0), 1.1);
    let beside = Beside { offset_m: 0.7, ahead_m: -2.0, heading_rad: 0.2 };
    let back = Beside::between(beside.from(there), there);
    assert!((back.offset_m - 0.7).abs() < 1e-12 && (back.ahead_m + 2.0).abs() < 1e-12, "{back:?}");
    assert!((back.heading_rad - 0.2).abs() < 1e-12, "{back:?}");
}

#[test]
fn what_one_picture_does_not_show_another_from_further_back_does() {
    let mut world = lake();
    let beside = Beside { offset_m: 0.9, ahead_m: 0.0, heading_rad: 0.15 };
    let (s, back_m) = (330.0, 4.0);
    let pictures = [s, s - back_m].map(|s| seen(&mut world, s, Beside::default(), &Camera::CENTER));
    let glimpses = [0.0, back_m].map(|ahead_m| Beside { ahead_m, ..beside });
    let glimpse = |i: usize| Glimpse { pictures: [Some(&pictures[i]), None, None], beside: glimpses[i] };
    let (warp, mut alone, mut completed) = (Warp::new(), Frame::default(), Frame::default());
    let filled = (warp.render(&[glimpse(0)], &mut alone), warp.render(&[glimpse(0), glimpse(1)], &mut completed));
    let really = seen(&mut world, s, beside, &Camera::CENTER);
    let errors = (apart(&alone, &really), apart(&completed, &really));
    println!("{filled:?}, {errors:?}");
    assert!(filled.1 < filled.0 && errors.1 < errors.0, "filled in {filled:?}, errors {errors:?}");
}
