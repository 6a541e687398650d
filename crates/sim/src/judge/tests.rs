use std::f64::consts::PI;

use glam::DVec3;

use super::*;
use crate::{obstacles::FRONT_M, track::Stretch, vehicle::STEP_S};

fn lake() -> Track {
    Track::named("lake").unwrap()
}

/// A judge and its clock.
struct Court<'a> {
    track: &'a Track,
    judge: Judge,
    t: f64,
    verdicts: Vec<(f64, Verdict)>,
}

impl<'a> Court<'a> {
    fn new(track: &'a Track, rules: Rules, start_s: f64) -> Self {
        Self { track, judge: Judge::new(track, rules, start_s), t: 0.0, verdicts: vec![] }
    }

    fn see(&mut self, car: &Car, actors: &[Actor]) {
        let place = self.track.locate(car.position, None);
        let mut out = vec![];
        self.t += STEP_S;
        self.judge.step(self.t, self.track, car, &place, actors, &mut out);
        self.verdicts.extend(out.into_iter().map(|verdict| (self.t, verdict)));
    }

    /// Drives along the road from one `s` to another at 13 m/s, backwards where that is smaller.
    fn drive(&mut self, from: f64, to: f64, offset: f64) {
        let steps = ((to - from).abs() / (13.0 * STEP_S)).round() as usize;
        for i in 1..=steps {
            let car = on_road(self.track, from + (to - from) * i as f64 / steps as f64, offset, 13.0);
            self.see(&car, &[]);
        }
    }

    fn wait(&mut self, seconds: f64, car: &Car, actors: &[Actor]) {
        for _ in 0..(seconds / STEP_S).round() as usize {
            self.see(car, actors);
        }
    }

    /// Everything but waypoints.
    fn said(&self) -> Vec<Verdict> {
        let other = |verdict: &Verdict| !matches!(verdict, Verdict::Waypoint(_));
        self.verdicts.iter().map(|&(_, verdict)| verdict).filter(other).collect()
    }
}

fn on_road(track: &Track, s: f64, offset: f64, speed: f64) -> Car {
    Car { position: track.point(s, offset), yaw: track.at(s).yaw, speed, ..Car::default() }
}

/// A car that is told to drive.
fn driving(car: Car) -> Car {
    Car { throttle: 0.3, ..car }
}

fn actor(track: &Track, kind: ActorKind, s: f64, offset: f64, speed: f64) -> Actor {
    Actor { kind, position: track.point(s, offset), yaw: track.at(s).yaw, speed, look: 0 }
}

#[test]
fn a_lap_counts_once_where_the_drive_began_and_says_its_time() {
    let track = lake();
    let start = 300.0;
    let mut court = Court::new(&track, Rules::default(), start);
    court.drive(start, start + 2.5 * track.length(), 0.0);
    let expected = track.length() / 13.0;
    assert_eq!(court.judge.laps(), 2);
    for &time in court.judge.lap_times() {
        assert!((time - expected).abs() < 0.01, "{time} s, expected {expected}");
    }
    let laps: Vec<f64> =
        court.verdicts.iter().filter(|(_, v)| matches!(v, Verdict::Lap { .. })).map(|&(t, _)| t).collect();
    assert!((laps[0] - expected).abs() < 0.03 && (laps[1] - 2.0 * expected).abs() < 0.03, "{laps:?}");
    assert!((court.judge.progress_m() - 2.5 * track.length()).abs() < 0.01, "{}", court.judge.progress_m());
    assert_eq!(court.said().len(), 2);
}

#[test]
fn waypoints_come_in_order() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    court.drive(0.0, track.length() + 1.0, 1.0);
    let passed: Vec<usize> = court
        .verdicts
        .iter()
        .filter_map(|(_, verdict)| if let Verdict::Waypoint(number) = verdict { Some(*number) } else { None })
        .collect();
    let expected: Vec<usize> = (1..court.judge.waypoints()).chain([0]).collect();
    assert_eq!(passed, expected);
    assert_eq!(court.judge.waypoints(), 57); // 1137.5 m by 20 m
    assert!((court.judge.next_waypoint_s(&track) - track.length() / 57.0).abs() < 1e-9);
}

#[test]
fn turning_round_at_the_line_gives_no_lap() {
    let track = lake();
    for turns in [
        vec![300.0, 330.0, 270.0, 330.0, 270.0, 340.0], // over the line and back
        vec![300.0, 300.0 - track.length() - 50.0, 290.0], // once around backwards, and back
        vec![300.0, 250.0, 300.0 + track.length() - 5.0], // once around except for the last metres
    ] {
        let mut court = Court::new(&track, Rules::default(), 300.0);
        for leg in turns.windows(2) {
            court.drive(leg[0], leg[1], 0.0);
        }
        assert_eq!(court.judge.laps(), 0, "{turns:?}");
        let end = turns[turns.len() - 1] - 300.0;
        assert!((court.judge.progress_m() - end).abs() < 0.01, "{turns:?}: {}", court.judge.progress_m());
    }
}

#[test]
fn a_short_cut_gives_no_lap_until_the_waypoints_left_out_are_driven() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    court.drive(0.0, 200.0, 0.0);
    court.drive(700.0, track.length() + 150.0, 0.0);
    assert_eq!(court.judge.laps(), 0);
    let waypoint = court.judge.waypoint();
    court.drive(track.length() + 150.0, 2.0 * track.length() + 1.0, 0.0);
    assert_eq!((waypoint, court.judge.laps()), (10, 1));
}

#[test]
fn leaving_the_road_counts_once_until_it_is_well_inside_again() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    for (i, offset) in [0.0, 3.3, 3.4, 3.6, 3.3, 3.36, 3.2, 3.1, 3.3, -3.4].into_iter().enumerate() {
        court.see(&on_road(&track, 50.0 + 0.3 * i as f64, offset, 13.0), &[]);
    }
    let [Verdict::OffRoad { offset_m: a }, Verdict::BackOnRoad { after_s }, Verdict::OffRoad { offset_m: b }] =
        court.said()[..]
    else {
        panic!("{:?}", court.said())
    };
    assert!((a - 3.4).abs() < 0.01 && (b + 3.4).abs() < 0.01 && (after_s - 5.0 * STEP_S).abs() < 1e-9);
    assert_eq!((court.judge.off_roads(), court.judge.off_road()), (2, true));
    let mut lenient = Court::new(&track, Rules { off_road_m: Some(7.0), ..Rules::default() }, 0.0);
    lenient.see(&on_road(&track, 50.0, 6.9, 13.0), &[]);
    assert_eq!(lenient.judge.off_roads(), 0);
}

#[test]
fn one_collision_while_touching_and_another_after_a_second_apart() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    let lead = actor(&track, ActorKind::Car, 60.0, 0.0, 4.0);
    let touching = 60.0 - FRONT_M - 2.2 + 0.1;
    let at = |back: f64| on_road(&track, touching - back, 0.0, 10.0);
    court.wait(0.5, &at(1.0), &[lead]);
    assert_eq!(court.judge.crashes(), 0);
    for (back, seconds, crashed, crashes) in
        [(0.0, 3.0, true, 1), (0.5, 0.9, false, 1), (0.0, 0.1, true, 1), (0.5, 1.1, false, 1), (0.0, 0.1, true, 2)]
    {
        court.wait(seconds, &at(back), &[lead]);
        assert_eq!((court.judge.crashed(), court.judge.crashes()), (crashed, crashes), "{back} m for {seconds} s");
    }
    let hit = Verdict::Collision { with: Hit::Actor { kind: ActorKind::Car, index: 0 }, speed: 6.0 };
    let said = court.said();
    assert!(matches!(said[0], Verdict::Collision { speed, .. } if (speed - 6.0).abs() < 0.01), "{said:?}");
    assert!(
        matches!((hit, said[1]), (Verdict::Collision { with: a, .. }, Verdict::Collision { with: b, .. }) if a == b)
    );
}

#[test]
fn each_thing_hit_is_a_collision_of_its_own_and_another_level_is_not_hit() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    let mut above = actor(&track, ActorKind::Barrier, 50.0, 0.0, 0.0);
    above.position.y += 6.0;
    let cones = [-1.0, 1.0].map(|offset| actor(&track, ActorKind::Cone, 50.0, offset, 0.0));
    court.wait(0.1, &on_road(&track, 50.0, 0.0, 5.0), &[above, cones[0], cones[1]]);
    let indices: Vec<usize> = court
        .said()
        .iter()
        .map(|verdict| match verdict {
            Verdict::Collision { with: Hit::Actor { index, .. }, .. } => *index,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(indices, [1, 2]);
}

#[test]
fn a_wall_is_hit_where_it_stands_and_on_its_side_only() {
    let walled = |edge, side| {
        let mut file = lake().file().clone();
        file.stretches = vec![Stretch { from_m: 270.0, to_m: 330.0, side, edge }];
        Track::new(file).unwrap()
    };
    for edge in [Edge::Bridge, Edge::Blocks, Edge::Rock, Edge::Water] {
        for sign in [-1.0, 1.0] {
            let track = walled(edge, if sign > 0.0 { Side::Right } else { Side::Left });
            let touch = track.half_width() + edge.stands_off_m() - 2.43 / 2.0;
            for (s, offset, expected) in [
                (300.0, touch + 0.03, edge != Edge::Water), // which is not hit
                (300.0, touch - 0.03, false),
                (340.0, touch + 0.03, false),
                (300.0, -touch - 0.1, false),
            ] {
                let mut court = Court::new(&track, Rules::default(), 0.0);
                court.see(&on_road(&track, s, sign * offset, 8.0), &[]);
                let hit = court.said().contains(&Verdict::Collision { with: Hit::Wall(edge), speed: 8.0 });
                assert_eq!(hit, expected, "{edge:?} at {s} m, {} m off", sign * offset);
            }
        }
    }
    // A corner that sticks out of a car across the road is enough.
    let track = walled(Edge::Bridge, Side::Both);
    let mut court = Court::new(&track, Rules::default(), 0.0);
    let mut car = on_road(&track, 300.0, track.half_width() + Edge::Bridge.stands_off_m() - 1.95, 8.0);
    court.see(&car, &[]);
    assert_eq!(court.judge.crashes(), 0);
    car.yaw += 0.5;
    court.see(&car, &[]);
    assert_eq!(court.judge.crashes(), 1);
}

#[test]
fn standing_under_throttle_is_stuck_after_two_seconds_but_not_at_the_start() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    let standing = driving(on_road(&track, 50.0, 0.0, 0.4)); // 0.9 mph
    court.wait(6.9, &standing, &[]);
    assert!(!court.judge.stuck());
    court.wait(0.3, &standing, &[]);
    assert!(court.judge.stuck());
    court.wait(0.1, &on_road(&track, 50.0, 0.0, 0.5), &[]);
    court.wait(1.9, &standing, &[]);
    assert_eq!(court.said(), [Verdict::Stuck, Verdict::Moving]);
    court.wait(0.2, &standing, &[]);
    assert_eq!(court.said(), [Verdict::Stuck, Verdict::Moving, Verdict::Stuck]);
}

#[test]
fn a_car_that_is_told_to_stand_waits_and_one_that_is_told_to_drive_and_does_not_is_stuck() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    let waiting = on_road(&track, 50.0, 0.0, 0.0);
    court.wait(15.0, &waiting, &[]);
    court.wait(5.0, &Car { throttle: -1.0, ..waiting }, &[]);
    for _ in 0..5 {
        court.wait(1.5, &driving(waiting), &[]);
        court.wait(0.1, &waiting, &[]);
    }
    assert_eq!(court.said(), []);
    assert!((court.judge.stood_s(court.t) - 23.0).abs() < 0.05, "{} s since the start", court.judge.stood_s(court.t));
    court.wait(1.9, &driving(waiting), &[]);
    assert_eq!(court.said(), []);
    court.wait(0.3, &driving(waiting), &[]);
    assert_eq!(court.said(), [Verdict::Stuck]);
    court.wait(0.1, &on_road(&track, 50.0, 0.0, 5.0), &[]);
    assert_eq!((court.said().len(), court.judge.stood_s(court.t)), (2, 0.0));
}

#[test]
fn standing_behind_something_is_waiting_unless_it_was_run_into() {
    let track = lake();
    for (name, gap, offset, stuck) in [
        ("2 m behind a car", 2.0, 0.0, false),
        ("5.9 m behind a car", 5.9, 0.0, false),
        ("far behind a car", 6.3, 0.0, true),
        ("a car beside the way", 2.0, 2.5, true),
        ("a car whose side is in the way", 2.0, 2.0, false),
        ("touching a car", -0.05, 0.0, true),
        ("a car behind", -12.0, 0.0, true),
    ] {
        let mut court = Court::new(&track, Rules::default(), 0.0);
        let lead = actor(&track, ActorKind::Car, 60.0, offset, 0.0);
        court.wait(20.0, &driving(on_road(&track, 60.0 - 2.2 - gap - FRONT_M, 0.0, 0.0)), &[lead]);
        assert_eq!(court.judge.stuck(), stuck, "{name}");
    }
}

#[test]
fn facing_against_the_road_for_a_second_is_the_wrong_way() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    let turned = |degrees: f64| {
        let mut car = on_road(&track, 50.0, 0.0, 5.0);
        car.yaw += degrees.to_radians();
        car
    };
    court.wait(3.0, &turned(89.0), &[]);
    court.wait(0.9, &turned(-95.0), &[]);
    court.wait(0.1, &turned(80.0), &[]);
    assert_eq!(court.said(), []);
    court.wait(1.1, &turned(180.0 + 720.0), &[]);
    assert_eq!(court.said(), [Verdict::WrongWay]);
    court.wait(0.5, &turned(0.0), &[]);
    court.wait(0.5, &turned(170.0), &[]);
    assert!(court.judge.wrong_way());
    court.wait(1.1, &turned(-360.0), &[]);
    assert_eq!(court.said(), [Verdict::WrongWay, Verdict::RightWay]);
    court.wait(2.0, &Car { speed: -2.0, ..turned(0.0) }, &[]);
    assert_eq!(court.said().len(), 2, "reversing faces the right way");
    assert!((turned(180.0).yaw - turned(0.0).yaw - PI).abs() < 1e-12);
}

#[test]
fn a_car_put_on_its_next_waypoint_has_reached_it_and_gets_time_to_start() {
    let track = lake();
    let mut court = Court::new(&track, Rules::default(), 0.0);
    court.drive(0.0, 50.0, 0.0);
    let cone = actor(&track, ActorKind::Cone, 51.0, 0.0, 0.0);
    court.wait(0.1, &on_road(&track, 50.0, 0.0, 3.0), &[cone]);
    let next = court.judge.next_waypoint_s(&track);
    assert_eq!(court.judge.waypoint(), 2);
    let put = driving(on_road(&track, next + 1e-6, 0.0, 0.0));
    court.wait(4.9, &put, &[cone]);
    assert_eq!((court.judge.waypoint(), court.judge.stuck(), court.judge.crashes()), (3, false, 1));
    court.wait(2.2, &put, &[]);
    assert!(court.judge.stuck());
    // Too near to be noticed as a leap, so the judge is told.
    let near = driving(on_road(&track, next + 1.0, 0.0, 0.0));
    court.judge.put(court.t);
    court.wait(4.9, &near, &[]);
    assert!(!court.judge.stuck());
    court.wait(2.2, &near, &[]);
    assert_eq!(court.said()[1..], [Verdict::Stuck, Verdict::Stuck]);
}

#[test]
fn rules_that_make_no_sense_are_refused_with_expected_and_got() {
    assert_eq!(Rules::default().check(), Ok(()));
    let nan = Rules { stuck_s: f64::NAN, ..Rules::default() };
    assert_eq!(nan.check().unwrap_err().to_string(), "rule stuck_s: expected 0.1 to 3600, got NaN");
    let zero = Rules { waypoint_spacing_m: 0.0, ..Rules::default() };
    assert!(zero.check().is_err());
    assert!(toml::from_str::<Rules>("stuck = 1.0").is_err());
    assert_eq!(toml::from_str::<Rules>("off_road_m = 7").unwrap().off_road_m, Some(7.0));
}

#[test]
fn no_corner_is_further_away_than_the_reach() {
    let corners = Box2::of_car(&Car { position: DVec3::ZERO, ..Car::default() }).corners();
    assert!(corners.iter().all(|corner| corner.length() < REACH_M), "{corners:?}");
}

#[test]
fn verdicts_are_written_as_they_are_read() {
    let with = Hit::Actor { kind: ActorKind::Pedestrian, index: 3 };
    let hit = Verdict::Collision { with, speed: 1.5 };
    let text = serde_json::to_string(&hit).unwrap();
    assert_eq!(text, r#"{"collision":{"with":{"actor":{"kind":"pedestrian","index":3}},"speed":1.5}}"#);
    assert_eq!(serde_json::from_str::<Verdict>(&text).unwrap(), hit);
    assert_eq!(serde_json::to_string(&Verdict::OffRoad { offset_m: 4.0 }).unwrap(), r#"{"off-road":{"offset_m":4.0}}"#);
    assert_eq!(serde_json::to_string(&Verdict::Waypoint(3)).unwrap(), r#"{"waypoint":3}"#);
}

#[test]
fn walls_in_bends_are_found_as_if_every_corner_were_looked_up() {
    for name in Track::NAMES {
        let mut file = Track::named(name).unwrap().file().clone();
        let stretch = |from_m, to_m, side, edge| Stretch { from_m, to_m, side, edge };
        file.stretches = vec![
            stretch(0.0, 400.0, Side::Both, Edge::Bridge),
            stretch(300.0, 900.0, Side::Left, Edge::Blocks),
            stretch(700.0, 100.0, Side::Right, Edge::Rock),
        ];
        let track = Track::new(file).unwrap();
        let mut hits = 0;
        for i in 0..6000_u32 {
            // Places and angles that do not repeat: multiples of irrational numbers.
            let part = |by: f64| (f64::from(i) * by).fract();
            let s = part(0.618_034) * track.length();
            let mut car = on_road(&track, s, (part(0.414_214) - 0.5) * (track.half_width() + 2.0) * 2.0, 5.0);
            car.yaw += (part(0.732_051) - 0.5) * 1.5;
            let place = track.locate(car.position, Some(s));
            let expected = Box2::of_car(&car).corners().into_iter().find_map(|corner| {
                let there = track.locate(DVec3::new(corner.x, car.position.y, corner.y), Some(s));
                let side = if there.offset > 0.0 { Side::Right } else { Side::Left };
                let beyond = |edge: &Edge| there.offset.abs() > track.half_width() + edge.stands_off_m();
                WALLS.into_iter().filter(beyond).find(|&edge| track.file().has(edge, side, there.station.s))
            });
            let mut court = Court::new(&track, Rules::default(), 0.0);
            court.judge.step(0.0, &track, &car, &place, &[], &mut vec![]);
            assert_eq!(court.judge.crashed(), expected.is_some(), "{name} at {s:.1} m, {place:?}");
            hits += u32::from(expected.is_some());
        }
        assert!((600..5400).contains(&hits), "{name}: {hits} hits"); // both answers are put to the test
    }
}
