use std::{
    sync::{Arc, Mutex},
    time::Instant,
};

use super::*;
use crate::{
    camera::{
        Camera, Renderer,
        tests::{apart, scenery},
    },
    conditions::Conditions,
    world::{Setup, Simulation},
};
use lapwing_core::{
    config::ControlSettings,
    driver::Driver,
    pilot::{ConstantPilot, PurePursuit},
    protocol::World,
};

/// What the pilot was shown.
type Seen = Arc<Mutex<Vec<Frame>>>;

/// Follows the path, as a pilot does that looks at pictures, and keeps those.
struct Onlooker(PurePursuit, Seen);

impl Pilot for Onlooker {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        self.1.lock().unwrap().push(view.frame.clone());
        self.0.steer(view)
    }

    fn reset(&mut self) {}
}

/// Eight seconds around the jungle's bends at 20 mph: for each telemetry the picture shown, how far ahead, and what is seen
/// two pictures later, in 133 ms.
fn driven(latency_ms: f64, compensate_latency: bool) -> Vec<(Frame, f64, Frame)> {
    let (track, scenery) = scenery("jungle");
    let mut renderer = Renderer::new(scenery.clone());
    let conditions = Conditions { latency_ms, ..Conditions::default() };
    let setup = Setup { conditions, longest_s: Some(8.0), ..Setup::new(Arc::new(track), scenery) };
    let mut world = Simulation::new(setup).unwrap();
    world.put(100.0, 0.0, 0.0, 9.0);
    let seen = Seen::default();
    let pilot = Ahead::of(Box::new(Onlooker(PurePursuit::default(), seen.clone())), Instant::now);
    let settings = ControlSettings { speed_mph: Mph::constant(20.0), compensate_latency, ..Default::default() };
    let mut driver = Driver::new(Box::new(pilot), &settings, Instant::now);
    let (mut ahead, mut really) = (vec![], vec![]);
    while let Some(observation) = world.observe().unwrap() {
        let mut frame = Frame::default();
        world.draw(&mut renderer, &Camera::CENTER, &mut frame);
        really.push(frame);
        let (answer, trace) = driver.drive(&observation);
        ahead.push(trace.ahead.as_secs_f64());
        world.apply(answer);
    }
    let seen = seen.lock().unwrap().clone();
    seen.into_iter().zip(ahead).zip(really.into_iter().skip(2)).map(|((seen, s), really)| (seen, s, really)).collect()
}

#[test]
fn the_picture_shows_the_road_from_where_the_car_will_be() {
    let mean = |seen: &[(Frame, f64, Frame)]| {
        seen[20..].iter().map(|(seen, _, really)| apart(seen, really)).sum::<f64>() / (seen.len() - 20) as f64
    };
    let (late, as_it_is) = (driven(200.0, true), driven(200.0, false));
    // 200 ms are three pictures; 0.7 of them about two.
    assert!(late[20..].iter().all(|(_, ahead_s, _)| (ahead_s - 0.14).abs() < 0.01), "{:?}", late[40].1);
    assert!(as_it_is.iter().all(|(_, ahead_s, _)| *ahead_s == 0.0));
    let (late, as_it_is) = (mean(&late), mean(&as_it_is));
    println!("warped {late:.2}, as it is {as_it_is:.2}");
    assert!(late < 0.8 * as_it_is, "warped {late:.2}, as it is {as_it_is:.2}");
}

#[test]
fn where_commands_take_effect_at_once_pictures_stay_as_they_are() {
    assert!(driven(0.0, true).iter().all(|(_, ahead_s, _)| *ahead_s == 0.0));
}

#[test]
fn a_command_that_was_given_several_times_tells_no_delay() {
    let mut ahead = Ahead::of(Box::new(ConstantPilot::new(Steering::saturating(0.1))), Instant::now);
    let frame = Frame::default();
    for i in 0..40 {
        let steering = if i < 3 { Degrees::ZERO } else { Degrees::saturating(2.5) };
        let in_effect = Some(InEffect { at: Duration::from_millis(67 * i), steering });
        ahead.steer(&View { in_effect, ..View::of(&frame) }).unwrap();
        assert_eq!(ahead.late_s(), None);
    }
}

/// Gives another command each time.
struct Turning(f64);

impl Pilot for Turning {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        self.0 += 0.01;
        ConstantPilot::new(Steering::saturating(self.0)).steer(view)
    }

    fn reset(&mut self) {}
}

#[test]
fn commands_that_somebody_elses_steering_equals_by_chance_tell_no_delay() {
    // How many commands ago the one was given that is reported: always three, or anything from two to eleven.
    for (ago, late_s) in [([3; 10], Some(0.134)), ([2, 9, 5, 11, 3, 8, 6, 10, 4, 7], None)] {
        let mut ahead = Ahead::of(Box::new(Turning(-0.5)), Instant::now);
        let frame = Frame::default();
        for i in 0..60_u64 {
            let given = ahead.sent.len().checked_sub(ago[i as usize % 10]).map(|k| ahead.sent[k].1);
            let steering = given.map_or(Degrees::ZERO, |steering| steering.degrees());
            let in_effect = Some(InEffect { at: Duration::from_millis(67 * i), steering });
            ahead.steer(&View { in_effect, ..View::of(&frame) }).unwrap();
        }
        match (ahead.late_s(), late_s) {
            (Some(found), Some(late_s)) => assert!((found - late_s).abs() < 0.01, "{found}"),
            (found, late_s) => assert_eq!(found, late_s),
        }
    }
}

/// As in a replay that comes as fast as it is answered: many of our commands lie close together, and now and then one is equal.
#[test]
fn commands_that_are_equal_by_chance_and_as_old_as_one_another_tell_no_delay_among_others_that_are_not() {
    let mut ahead = Ahead::of(Box::new(Turning(0.0)), Instant::now);
    for i in 0..200_u32 {
        let at = Duration::from_millis(u64::from(20 * i));
        ahead.sent.push_back((at, Degrees::saturating(f64::from(i % 97) / 10.0 + 0.05).steering()));
        // One of four is what was sent a fifth of a second before.
        let ours = ahead.sent.iter().rev().nth(10).filter(|_| i % 4 == 0).map(|(_, sent)| sent.degrees());
        let steering = ours.unwrap_or(Degrees::saturating(-f64::from(i % 89) / 10.0 - 0.03));
        ahead.told(InEffect { at, steering }, Mph::saturating(20.0));
        assert_eq!(ahead.late_s(), None, "{i}");
    }
}

#[test]
fn after_a_long_pause_the_car_begins_anew_at_rest() {
    let mut ahead = Ahead::of(Box::new(ConstantPilot::new(Steering::ZERO)), Instant::now);
    let frame = Frame::default();
    let mut steer = |at| {
        let in_effect = Some(InEffect { at, steering: Degrees::saturating(10.0) });
        ahead.steer(&View { in_effect, speed: Mph::constant(20.0), ..View::of(&frame) }).unwrap();
        (ahead.car.yaw_rate, ahead.sent.len())
    };
    for i in 0..10 {
        steer(Duration::from_millis(67 * i));
    }
    let (yaw_rate, sent) = steer(Duration::from_millis(700));
    assert!(yaw_rate > 0.1 && sent == 11, "{yaw_rate} {sent}");
    // A day later, and then a clock that goes back.
    assert_eq!(steer(Duration::from_secs(86_400)), (0.0, 1));
    assert_eq!(steer(Duration::from_secs(60)), (0.0, 1));
}
