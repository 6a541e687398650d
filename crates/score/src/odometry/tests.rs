use std::{f64::consts::TAU, sync::Arc};

use lapwing_core::{motion::Motion, perception::Frame};

use super::*;

/// A closed road whose heading is given by its share of the way around.
fn road(name: &str, length_m: f64, heading: impl Fn(f64) -> f64) -> Arc<Road> {
    let headings = (0..=500).map(|i| heading(f64::from(i) / 500.0)).collect();
    Arc::new(Road::new(name.into(), 0.0, length_m, None, headings))
}

/// A circle with a few bends of its own.
fn bends(name: &str, length_m: f64, phase: f64) -> Arc<Road> {
    road(name, length_m, move |share| {
        TAU * share + 0.8 * (3.0 * TAU * share + phase).sin() + 0.3 * (7.0 * TAU * share).sin()
    })
}

/// A drive along a road at 0.6 m a telemetry that weaves, in a car that turns less and drives further than it reports.
fn drive(road: &Road, from: f64, metres: f64, mut seen: impl FnMut(Motion)) {
    let steps = (metres / 0.6) as usize;
    for i in 0..steps {
        let s = |i: usize| from + 0.6 * i as f64;
        let weave = |i: usize| 0.05 * (s(i) / 3.0).sin();
        let turn = road.heading(s(i + 1)) - road.heading(s(i)) + weave(i + 1) - weave(i);
        seen(Motion { way_m: 0.6 * 0.99, turn_rad: turn * 1.07 });
    }
}

#[test]
fn headings_go_on_from_lap_to_lap() {
    let circle = road("circle", 100.0, |share| TAU * share);
    for s in [-30.0, 0.0, 12.5, 99.9, 100.0, 260.0] {
        assert!((circle.heading(s) - TAU * s / 100.0).abs() < 1e-9, "{s}");
    }
    // Given modulo a circle, as compasses do.
    let wrapped = road("wrapped", 100.0, |share| (TAU * share).rem_euclid(TAU));
    assert!((wrapped.heading(260.0) - TAU * 2.6).abs() < 0.02);
}

#[test]
fn a_car_that_begins_at_the_start_is_followed_over_laps_though_it_tells_its_way_wrongly() {
    let road = bends("a", 1000.0, 0.3);
    let mut filter = Filter::new(road.clone(), rand::SeedableRng::seed_from_u64(1));
    let mut way = 0.0;
    drive(&road, 0.0, 2300.0, |motion| {
        filter.step(motion);
        way += 0.6;
        let place = filter.place();
        assert!(way < 150.0 || (place.progress_m - way).abs() < 15.0, "{way}: {place:?}");
    });
    // One per cent of 2300 m is 23 m; the bends give a better estimate.
    assert!(
        (filter.place().progress_m - 2300.0).abs() < 8.0 && (filter.place().s_m - 300.0).abs() < 8.0,
        "{:?}",
        filter.place()
    );
}

#[test]
fn a_car_that_begins_anywhere_is_found_once_it_has_seen_some_bends() {
    let road = bends("a", 1000.0, 0.3);
    let mut filter = Filter::new(road.clone(), rand::SeedableRng::seed_from_u64(2));
    drive(&road, 620.0, 500.0, |motion| filter.step(motion));
    let Whereabouts { s_m, deviation_m, .. } = filter.place();
    let off = (s_m - 1120.0 + 500.0).rem_euclid(1000.0) - 500.0;
    assert!(off.abs() < 15.0 && deviation_m < 15.0, "{s_m} {deviation_m}");
}

#[test]
fn the_road_that_was_driven_explains_the_drive_best() {
    let roads = [bends("a", 1000.0, 0.3), bends("b", 1100.0, 2.5), bends("c", 900.0, 4.0)];
    for driven in &roads {
        for from in [0.0, 350.0] {
            let mut matcher = Matcher::new(roads.iter().cloned(), 3);
            drive(driven, from, 400.0, |motion| matcher.step(motion));
            let found = matcher.matches();
            assert_eq!(found[0].road.name, driven.name, "from {from}");
            assert!(found[0].explains && found[0].evidence - found[1].evidence > 3.0, "{found:?}");
        }
    }
}

#[test]
fn a_road_that_is_not_known_is_none_of_the_known_ones() {
    let mut matcher = Matcher::new([bends("a", 1000.0, 0.3), bends("b", 1100.0, 2.5)], 3);
    let other = road("other", 600.0, |share| -TAU * share + 1.5 * (9.0 * TAU * share).sin());
    drive(&other, 0.0, 600.0, |motion| matcher.step(motion));
    assert!(matcher.matches().iter().all(|found| !found.explains));
}

#[test]
fn who_weaves_from_verge_to_verge_is_followed() {
    let road = bends("a", 1000.0, 0.3);
    for seed in 0..6 {
        let mut matcher = Matcher::at_start(road.clone(), seed);
        let (mut s, mut way) = (0.0_f64, 0.0_f64);
        let error = |way: f64| 0.7 * (TAU * way / 25.0).sin();
        while s < 1000.0 {
            let along = 0.5 * (error(way) / 2.0 + error(way + 0.5) / 2.0).cos();
            let turn = road.heading(s + along) - road.heading(s) + error(way + 0.5) - error(way);
            matcher.step(Motion { way_m: 0.5, turn_rad: turn });
            (s, way) = (s + along, way + 0.5);
        }
        assert!(way > 1100.0, "{way}");
        let place = matcher.matches().remove(0).place;
        assert!((place.progress_m - 1000.0).abs() < 15.0, "seed {seed}: {place:?}");
    }
}

#[test]
fn a_car_that_is_known_to_begin_at_the_start_is_followed_off_the_road_too() {
    let road = bends("a", 1000.0, 0.3);
    let mut matcher = Matcher::at_start(road.clone(), 6);
    drive(&road, 0.0, 300.0, |motion| matcher.step(motion));
    (0..100).for_each(|_| matcher.step(Motion { way_m: 0.5, turn_rad: 0.05 }));
    let found = matcher.matches().remove(0);
    assert!(found.explains && (280.0..345.0).contains(&found.place.progress_m), "{found:?}");
}

#[test]
fn who_stands_learns_nothing() {
    let mut filter = Filter::new(bends("a", 1000.0, 0.3), rand::SeedableRng::seed_from_u64(5));
    let before = filter.place();
    (0..1000).for_each(|_| filter.step(Motion::default()));
    assert_eq!((filter.place(), filter.evidence()), (before, 0.0));
}

/// Many places along a road look a little like its start: two in five along the lake.
#[test]
fn a_drive_that_only_looks_as_if_it_began_at_the_start_is_found_by_its_bends() {
    let rgb = (0..320 * 160).flat_map(|i: usize| [(i % 320 / 2) as u8, (i / 320) as u8, (i % 97) as u8]).collect();
    let look = Look::of(&Frame::new(320, 160, rgb).unwrap()).unwrap();
    let Road { name, headings, .. } = (*bends("a", 1000.0, 0.3)).clone();
    let road = Arc::new(Road::new(name, 0.0, 1000.0, Some(look.clone()), headings));
    for (from, at_rest, by_start) in [(0.0, true, true), (0.0, false, false), (620.0, true, false)] {
        let mut legs = vec![];
        if at_rest {
            legs.push(Leg { motion: Motion::default(), apart_s: 2.0, broken: None });
        }
        drive(&road, from, 500.0, |motion| legs.push(Leg { motion, apart_s: 0.067, broken: None }));
        let found = find(&legs, Some(&look), std::slice::from_ref(&road));
        assert_eq!(found.by_start, by_start, "from {from}, at rest: {at_rest}");
        let s_m = found.sure().unwrap().place.s_m;
        let off = (s_m - from - 500.0 + 500.0).rem_euclid(1000.0) - 500.0;
        assert!(off.abs() < 15.0, "from {from}: {s_m}");
    }
}

#[test]
fn a_start_that_looks_alike_names_no_road_that_bends_otherwise_and_none_of_two_that_bend_alike() {
    let rgb = (0..320 * 160).flat_map(|i: usize| [(i % 320 / 2) as u8, (i / 320) as u8, (i % 97) as u8]).collect();
    let look = Look::of(&Frame::new(320, 160, rgb).unwrap()).unwrap();
    let beginning = |name: &str, like: &Road| {
        Arc::new(Road::new(name.into(), 0.0, 1000.0, Some(look.clone()), like.headings.clone()))
    };
    let driven = bends("a", 1000.0, 0.3);
    let other = road("b", 1000.0, |share| -TAU * share + 1.5 * (15.0 * TAU * share).sin());
    let mut legs = vec![Leg { motion: Motion::default(), apart_s: 2.0, broken: None }];
    drive(&driven, 0.0, 600.0, |motion| legs.push(Leg { motion, apart_s: 0.067, broken: None }));
    let names = |roads: &[Arc<Road>]| {
        let found = find(&legs, Some(&look), roads);
        (found.sure().map(|on| on.road.name.clone()), found.by_start)
    };
    assert_eq!(names(&[beginning("b", &other)]), (None, false));
    assert_eq!(names(&[beginning("b", &other), beginning("a", &driven)]), (Some("a".into()), true));
    assert_eq!(names(&[beginning("a", &driven), beginning("b", &other)]), (Some("a".into()), true));
    assert_eq!(names(&[beginning("a", &driven), beginning("copy", &driven)]), (None, true));
}

#[test]
fn a_drive_ends_wherever_the_road_bends_as_it_did_and_nowhere_else() {
    let ends = |road: &Arc<Road>| {
        let mut legs = vec![];
        drive(road, 100.0, 200.0, |motion| legs.push(Leg { motion, apart_s: 0.05, broken: None }));
        ends(road, &legs)
    };
    let beside = |ends: &[f64], s_m: f64| ends.iter().filter(|end| (*end - s_m).abs() < 25.0).count();
    let once = ends(&bends("once", 1000.0, 0.3));
    assert!(!once.is_empty() && beside(&once, 300.0) == once.len(), "{once:?}");
    let twice = ends(&road("twice", 1000.0, |share| {
        TAU * share + 0.8 * (6.0 * TAU * share).sin() + 0.5 * (2.0 * TAU * share).cos()
    }));
    let (here, there) = (beside(&twice, 300.0), beside(&twice, 800.0));
    assert!(here > 0 && there > 0 && here + there == twice.len(), "{twice:?}");
}
