use glam::DVec2;

use super::*;
use crate::{
    judge::{Hit, Judge, Verdict},
    obstacles::{Box2, ahead, flat},
    track::TrackFile,
    vehicle::STEP_S,
};
use lapwing_core::config::Rules;

/// A ring of two straights of 400 m and two half circles, so that geometry is known to the centimetre.
fn ring() -> Track {
    let mut points = vec![];
    for i in 0..20 {
        points.push([0.0, 0.0, f64::from(i) * 20.0]);
    }
    for i in 0..12 {
        let angle = std::f64::consts::PI * f64::from(i) / 12.0;
        points.push([80.0 - 80.0 * angle.cos(), 0.0, 400.0 + 80.0 * angle.sin()]);
    }
    for i in 0..20 {
        points.push([160.0, 0.0, 400.0 - f64::from(i) * 20.0]);
    }
    for i in 0..12 {
        let angle = std::f64::consts::PI * f64::from(i) / 12.0;
        points.push([80.0 + 80.0 * angle.cos(), 0.0, -80.0 * angle.sin()]);
    }
    let lake = Track::named("lake").unwrap();
    let file = TrackFile { control_points: points, stretches: vec![], ..lake.file().clone() };
    Track::new(file).unwrap()
}

/// What our car does: metres a second squared from what it sees.
type FollowLaw = fn(speed: f64, ahead: &[SeenAhead]) -> f64;

/// An actor from the car's front: metres ahead of it, metres to the right, and their speeds.
struct SeenAhead {
    ahead: f64,
    right: f64,
    closing: f64,
    drifting: f64,
    half: f64,
}

fn goes_on(_: f64, _: &[SeenAhead]) -> f64 {
    0.0
}

/// Brakes hard when it would hit something within 1.3 s.
fn brakes(_: f64, seen: &[SeenAhead]) -> f64 {
    let threat = |other: &SeenAhead| {
        let until = other.ahead / other.closing;
        let then = other.right + other.drifting * until;
        other.ahead > -1.0 && (0.0..1.3).contains(&until) && then.abs() < BODY.x / 2.0 + other.half + 0.2
    };
    if seen.iter().any(threat) { -8.0 } else { 0.0 }
}

#[derive(Debug)]
struct Impact {
    index: usize,
    speed: f64,
    /// Share of our car's width, from its right side.
    share: f64,
    t: f64,
}

/// Our car along the road, and its place.
fn on_rails(track: &Track, s: f64, offset: f64, speed: f64) -> (Car, Place) {
    let station = track.at(s);
    (Car { position: track.point(s, offset), yaw: station.yaw, speed, ..Car::default() }, Place { station, offset })
}

/// Our car on rails through a scenario until it hits something.
fn drive(scenario: &Scenario, track: &Track, seed: u64, dt: f64, driver: FollowLaw) -> Option<Impact> {
    let (start, offset) = scenario.ego.start(track);
    let mut s = start;
    let mut speed = scenario.ego.speed_kmh.value() * MPS_PER_KMH;
    let mut traffic = Traffic::new(scenario, track, seed).unwrap();
    let mut judge = Judge::new(track, Rules::default(), start);
    let mut out = vec![];
    for i in 0..(scenario.duration_s / dt) as usize {
        let t = i as f64 * dt;
        let (car, place) = on_rails(track, s, offset, speed);
        let (station, position) = (place.station, car.position);
        out.clear();
        judge.step(t, track, &car, &place, traffic.actors(), &mut out);
        for verdict in &out {
            let Verdict::Collision { with: Hit::Actor { index, .. }, speed } = *verdict else { continue };
            let right = flat(station.right());
            let lateral = (flat(traffic.actors()[index].position) - flat(position)).dot(right);
            return Some(Impact { index, speed, share: 0.5 - lateral / BODY.x, t });
        }
        let seen: Vec<SeenAhead> = traffic
            .actors()
            .iter()
            .map(|actor| {
                let (forward, right) = (ahead(station.yaw), flat(station.right()));
                let away = flat(actor.position) - flat(position);
                let moves = ahead(actor.yaw) * actor.speed;
                let reach = |axis: DVec2| {
                    let corners = Box2::of_actor(actor).corners();
                    corners.iter().map(|corner| (corner - flat(actor.position)).dot(axis)).fold(0.0, f64::max)
                };
                SeenAhead {
                    ahead: away.dot(forward) - FRONT_M - reach(forward),
                    right: away.dot(right),
                    closing: speed - moves.dot(forward),
                    drifting: moves.dot(right),
                    half: reach(right),
                }
            })
            .collect();
        let acceleration = driver(speed, &seen);
        speed = (speed + acceleration * dt).max(0.0);
        s = forward(track, s, offset, speed * dt);
        let (car, place) = on_rails(track, s, offset, speed);
        traffic.step(t + dt, dt, track, &car, &place);
    }
    None
}

fn kmh(speed: f64) -> f64 {
    speed * MPS_PER_KMH
}

#[test]
fn a_car_that_goes_on_hits_as_fast_as_the_protocols_geometry_says() {
    // Closing speed of a car that keeps its speed on one whose braking builds up evenly over a second: the speed
    // difference is d (t - 1/2), the gap has shrunk by d ((t - 1/2)^2 / 2 + 1/24).
    let rear_end = |ego: f64, gap: f64, d: f64| f64::min((2.0 * d * (gap - d / 24.0)).sqrt(), ego);
    // In bends the cars do not face the same way; the jungle's are of 11 m radius.
    for (track, within) in
        [(ring(), 0.06), (Track::named("lake").unwrap(), 0.3), (Track::named("jungle").unwrap(), 1.5)]
    {
        for name in ["ccrs", "ccrm", "ccrb"] {
            for case in Scenario::named(name).unwrap().cases() {
                let ego = kmh(case.ego.speed_kmh.value());
                let expected = match &case.actors[0] {
                    Script::Parked { .. } => ego,
                    Script::Cruise { speed_kmh, .. } => ego - kmh(speed_kmh.value()),
                    Script::Lead { gap_m, deceleration, .. } => rear_end(ego, gap_m.value(), deceleration.value()),
                    other => panic!("{other:?}"),
                };
                let impact = drive(&case, &track, 1, STEP_S, goes_on);
                let Some(impact) = impact else { panic!("{name} at {ego} m/s on {}: no hit", track.file().name) };
                assert!((impact.speed - expected).abs() < within, "{name} {ego} m/s: {impact:?}, expected {expected}");
            }
        }
    }
}

#[test]
fn a_car_that_brakes_hits_nothing() {
    for track in [ring(), Track::named("lake").unwrap()] {
        for name in Scenario::NAMES {
            for case in Scenario::named(name).unwrap().cases() {
                let impact = drive(&case, &track, 1, STEP_S, brakes);
                assert!(impact.is_none(), "{name} at {} km/h: {impact:?}", case.ego.speed_kmh);
            }
        }
    }
}

#[test]
fn a_crosser_meets_the_car_at_its_share_of_the_width() {
    for (track, dt, within_m) in [
        (ring(), 0.001, 0.003),                        // nothing but the geometry
        (ring(), STEP_S, 0.035),                       // it walks 2.8 cm in a step
        (Track::named("lake").unwrap(), STEP_S, 0.06), // in a bend of 180 m radius
    ] {
        for name in ["cpna", "child"] {
            for case in Scenario::named(name).unwrap().cases() {
                let Script::Cross { share, .. } = &case.actors[0] else { panic!("{case:?}") };
                let share = share.as_ref().unwrap().value();
                let impact = drive(&case, &track, 1, dt, goes_on).unwrap();
                let off = (impact.share - share) * BODY.x;
                let speed = kmh(case.ego.speed_kmh.value());
                assert!(off.abs() < within_m, "{name} {share} at {speed} m/s, step {dt}: {off:.4} m off");
                assert!((impact.speed - speed.hypot(kmh(5.0))).abs() < 0.01, "{impact:?}");
                assert_eq!(impact.index, 0);
            }
        }
    }
}

#[test]
fn a_crosser_from_the_left_and_one_that_just_misses_are_timed_as_well() {
    let crossing = |from: f64, share: f64| {
        Scenario::parse(&format!(
            "name = \"x\"\ndescription = \"\"\nduration_s = 20\n[ego]\nspeed_kmh = 40\noffset_m = 0.8\n[[actor]]\n\
             script = \"cross\"\nahead_m = 60\nfrom_m = {from}\nto_m = {}\nspeed_kmh = 5\nshare = {share}",
            -from
        ))
        .unwrap()
    };
    let track = ring();
    let left = drive(&crossing(-3.0, 0.25), &track, 0, STEP_S, goes_on).unwrap();
    assert!((left.share - 0.75).abs() < 0.015, "a quarter from the left: {left:?}");
    // 0.3 m, half its length, before our right side; and so far behind it that our car is past.
    assert!(drive(&crossing(3.0, 0.0), &track, 0, STEP_S, goes_on).is_some());
    assert!(drive(&crossing(3.0, 1.5), &track, 0, STEP_S, goes_on).is_none());
    assert!(drive(&crossing(3.0, -1.0), &track, 0, STEP_S, goes_on).is_none());
}

#[test]
fn a_crosser_with_a_time_sets_off_then_and_stops_on_the_other_side() {
    let scenario = Scenario::parse(
        "name = \"x\"\ndescription = \"\"\nduration_s = 20\n[ego]\n[[actor]]\nscript = \"cross\"\nkind = \"child\"\n\
         ahead_m = 60\nfrom_m = 4\nto_m = -2\nspeed_kmh = 7.2\nrun_up_m = 1\nat_s = 2.01",
    )
    .unwrap();
    let track = ring();
    let (start, line) = scenario.ego.start(&track);
    let (car, place) = on_rails(&track, start, line, 0.0);
    let mut traffic = Traffic::new(&scenario, &track, 0).unwrap();
    let mut seen = vec![];
    for i in 1..=400 {
        traffic.step(f64::from(i) * STEP_S, STEP_S, &track, &car, &place);
        let child = traffic.actors()[0];
        seen.push((track.locate(child.position, None).offset - line, child.speed));
    }
    assert_eq!(seen[99].1, 0.0);
    assert!((seen[99].0 - 4.0).abs() < 1e-6, "waits until 2 s");
    // One metre of run-up takes 1 s to 2 m/s; from 3.01 s on 2 m/s.
    assert!((seen[200].0 - (4.0 - 1.0 - 2.0 * 1.01)).abs() < 1e-3, "{:?} at 4.02 s", seen[200]);
    assert!((seen[200].1 - 2.0).abs() < 1e-9);
    assert!((seen[399].0 + 2.0).abs() < 1e-6 && seen[399].1 == 0.0, "{:?}", seen[399]);
}

#[test]
fn a_lead_car_keeps_its_gap_until_it_brakes() {
    let scenario = Scenario::parse(
        "name = \"x\"\ndescription = \"\"\nduration_s = 20\n[ego]\nspeed_kmh = 36\n[[actor]]\nscript = \"lead\"\n\
         gap_m = 15\nonset_s = 12\ndeceleration = 4\nfinal_kmh = 18",
    )
    .unwrap();
    for track in [ring(), Track::named("lake").unwrap()] {
        let (mut s, line) = scenario.ego.start(&track);
        let mut traffic = Traffic::new(&scenario, &track, 0).unwrap();
        let gap = |traffic: &Traffic, s| traffic.movers[0].s - s - FRONT_M - 2.2;
        for i in 1..=1000 {
            let t = f64::from(i) * STEP_S;
            // Our car swings between 8 and 12 m/s for a while, as a poor speed controller does.
            let speed = if t < 6.0 { 10.0 + 2.0 * (t * 0.8).sin() } else { 10.0 };
            s += speed * STEP_S;
            let (car, place) = on_rails(&track, s, line, speed);
            traffic.step(t, STEP_S, &track, &car, &place);
            let within = if t < 11.0 { 2.5 } else { 0.2 };
            if t < 12.0 {
                assert!((gap(&traffic, s) - 15.0).abs() < within, "{} m at {t:.2} s", gap(&traffic, s));
            }
        }
        assert!((traffic.actors()[0].speed - 5.0).abs() < 1e-9, "{}", traffic.actors()[0].speed);
    }
}

#[test]
fn an_oncoming_car_comes_on_its_side_and_faces_us() {
    let scenario = |offset: f64| {
        Scenario::parse(&format!(
            "name = \"x\"\ndescription = \"\"\nduration_s = 10\n[ego]\nspeed_kmh = 36\n[[actor]]\nscript = \"cruise\"\n\
             ahead_m = 100\noffset_m = {offset}\nspeed_kmh = 54\noncoming = true"
        ))
        .unwrap()
    };
    let track = ring();
    let impact = drive(&scenario(0.0), &track, 0, STEP_S, goes_on).unwrap();
    assert!((impact.speed - 25.0).abs() < 1e-3, "{impact:?}");
    assert!((impact.t - (100.0 - FRONT_M - 2.2) / 25.0).abs() < 0.03, "{impact:?}");
    assert!(drive(&scenario(-2.5), &track, 0, STEP_S, goes_on).is_none());
}

#[test]
fn the_same_seed_plays_the_same_traffic_and_another_seed_another() {
    let scenario = Scenario::parse(
        "name = \"x\"\ndescription = \"\"\nduration_s = 10\n[ego]\nspeed_kmh = [20, 40]\n\
         [[actor]]\nscript = \"lead\"\ngap_m = [8, 30]\nonset_s = [1, 4]\ndeceleration = [2, 6]\n\
         [[actor]]\nscript = \"parked\"\nkind = \"cone\"\nahead_m = [20, 60]\noffset_m = { one_of = [-3, 3] }\n",
    )
    .unwrap();
    let track = ring();
    let played = |seed, settled_before: bool| {
        let scenario = if settled_before { scenario.settle(seed) } else { scenario.clone() };
        let mut traffic = Traffic::new(&scenario, &track, seed).unwrap();
        let (s, line) = scenario.ego.start(&track);
        let (car, place) = on_rails(&track, s, line, 8.0);
        let mut all = vec![];
        for i in 1..=300 {
            traffic.step(f64::from(i) * STEP_S, STEP_S, &track, &car, &place);
            all.extend_from_slice(traffic.actors());
        }
        all
    };
    assert_eq!(played(5, false), played(5, false));
    assert_eq!(played(5, false), played(5, true), "settling first changes nothing");
    assert_ne!(played(5, false), played(6, false));
    assert_ne!(played(5, false)[1].position, played(6, false)[1].position);
}

#[test]
fn a_start_beyond_the_tracks_end_is_refused() {
    let scenario = Scenario::parse("name = \"x\"\ndescription = \"\"\nduration_s = 10\n[ego]\ns_m = 5000").unwrap();
    let error = Traffic::new(&scenario, &Track::named("lake").unwrap(), 0).unwrap_err().to_string();
    assert!(error.starts_with("scenario x: ego: s_m: expected 0 to 11") && error.ends_with("got 5000"), "{error}");
}

#[test]
fn a_crosser_that_could_not_make_it_is_refused_with_the_distance_it_needs() {
    let crossing = |ahead: f64| {
        let mut scenario = Scenario::named("cpna").unwrap().cases().pop().unwrap(); // 48.2 km/h, 75%
        let Script::Cross { ahead_m, .. } = &mut scenario.actors[0] else { panic!("{scenario:?}") };
        *ahead_m = Draw::Exactly(ahead);
        scenario
    };
    let track = ring();
    let error = Traffic::new(&crossing(40.0), &track, 0).unwrap_err().to_string();
    // 4.61 m on foot and the run-up's metre once more take 4.04 s, 54.1 m at 48.2 km/h, and the front's 2.07 m.
    let expected = "scenario cpna: actor 0: ahead_m: expected at least 56.4, or it sets off too late, got 40.0";
    assert_eq!(error, expected);
    assert!(Traffic::new(&crossing(56.3), &track, 0).is_err());
    let impact = drive(&crossing(56.5), &track, 0, STEP_S, goes_on).unwrap();
    assert!((impact.share - 0.75).abs() < 0.015, "{impact:?}");
}

#[test]
fn the_child_is_hidden_until_it_steps_out_between_the_parked_cars() {
    let track = ring();
    for case in Scenario::named("child").unwrap().cases() {
        let (mut s, line) = case.ego.start(&track);
        let speed = kmh(case.ego.speed_kmh.value());
        let mut traffic = Traffic::new(&case, &track, 0).unwrap();
        let mut stepped_out = 0;
        for i in 1.. {
            s += speed * STEP_S;
            let (car, place) = on_rails(&track, s, line, speed);
            traffic.step(f64::from(i) * STEP_S, STEP_S, &track, &car, &place);
            let [child, parked @ ..] = traffic.actors() else { panic!() };
            let (place, away) = (track.locate(child.position, None), flat(child.position - car.position));
            // From the camera, a metre ahead of the car's origin, to the child's middle.
            let (camera, target) = (flat(car.position) + ahead(car.yaw), flat(child.position));
            let sight = Box2 {
                centre: (camera + target) / 2.0,
                half: DVec2::new(0.0, camera.distance(target) / 2.0),
                yaw: (target - camera).x.atan2((target - camera).y),
            };
            let hidden = parked.iter().any(|parked| sight.touches(&Box2::of_actor(parked)));
            let right = place.offset - line;
            if away.dot(ahead(car.yaw)) < 5.0 || right < 1.0 {
                break;
            }
            if right > 2.5 && away.length() > 12.0 {
                assert!(hidden, "seen at {right:.2} m, {:.1} m ahead, {speed} m/s", away.length());
            } else if right < 1.9 {
                assert!(!hidden, "not seen at {right:.2} m, {:.1} m ahead, {speed} m/s", away.length());
                stepped_out += 1;
            }
        }
        assert!(stepped_out > 10, "{stepped_out} steps at {speed} m/s");
    }
}
