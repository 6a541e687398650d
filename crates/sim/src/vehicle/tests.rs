use super::*;
use lapwing_core::units::{Steering, Throttle};

const FULL: f64 = 1.0;

fn command(steering: f64, throttle: f64) -> Command {
    Command { steering: Steering::saturating(steering), throttle: Throttle::saturating(throttle) }
}

fn at_mph(mph: f64) -> Car {
    Car { speed: mph * MPS_PER_MPH, ..Car::default() }
}

fn slope(grade: f64) -> Ground {
    Ground { grade, ..Ground::default() }
}

/// Drives for `seconds`, or until something holds; returns the seconds it took.
fn drive(car: &mut Car, seconds: f64, command: Command, ground: Ground, until: impl Fn(&Car) -> bool) -> f64 {
    let mut steps = 0;
    while f64::from(steps) < (seconds / STEP_S).round() && !until(car) {
        car.step(command, ground);
        steps += 1;
    }
    f64::from(steps) * STEP_S
}

fn for_seconds(car: &mut Car, seconds: f64, steering: f64, throttle: f64, ground: Ground) {
    drive(car, seconds, command(steering, throttle), ground, |_| false);
}

#[test]
fn from_standstill_to_30_mph_takes_as_long_as_in_closed_form_and_in_the_recording() {
    let mut car = Car::default();
    let time = drive(&mut car, 20.0, command(0.0, FULL), Ground::default(), |car| car.speed >= TOP_SPEED);
    let thrust = DRIVE_NM / 4.0 * WHEELS_PER_M / INERTIAL_MASS_KG;
    let drag = DRAG + WHEEL_DAMPING / INERTIAL_MASS_KG;
    let closed = -(1.0 - TOP_SPEED * drag / thrust).ln() / drag;
    assert!((time - closed).abs() < 0.04, "{time} s, in closed form {closed} s");
    // The mountain recording takes 2.66 s from 1.48 to 29.91 mph.
    let mut car = at_mph(1.483);
    let time = drive(&mut car, 20.0, command(0.0, FULL), Ground::default(), |car| car.telemetry_speed().get() >= 29.9);
    assert!((2.4..2.75).contains(&time), "{time} s");
}

#[test]
fn at_full_throttle_the_telemetry_shows_the_recordings_30_19_mph() {
    let mut car = Car::default();
    for_seconds(&mut car, 20.0, 0.0, FULL, Ground::default());
    assert!((car.telemetry_speed().get() - 30.19).abs() < 0.02, "{}", car.telemetry_speed());
    for_seconds(&mut car, 20.0, 0.0, FULL, slope(-0.3));
    assert!(car.telemetry_speed().get() < 30.6, "downhill: {}", car.telemetry_speed());
}

#[test]
fn brakes_lock_the_wheels_and_stop_from_30_mph_like_the_recording() {
    // The lake recording falls from 24.06 to 4.36 mph in 1.276 s.
    let mut car = at_mph(24.06272);
    let time = drive(&mut car, 9.0, command(0.0, -FULL), Ground::default(), |car| car.speed <= 4.364 * MPS_PER_MPH);
    assert!((time - 1.276).abs() < 0.15, "{time} s");
    let mut car = at_mph(30.0);
    drive(&mut car, 9.0, command(0.0, -FULL), Ground::default(), |car| car.speed <= REVERSE_BELOW);
    let distance = car.position.z;
    let sliding = SLIDING_DECELERATION;
    let closed = (TOP_SPEED * TOP_SPEED - REVERSE_BELOW * REVERSE_BELOW) / (2.0 * sliding);
    assert!(distance < closed && distance > 0.7 * closed, "{distance} m, without drag and downforce {closed} m");
}

/// Deceleration with locked wheels, without drag or downforce, in metres per second squared.
const SLIDING_DECELERATION: f64 = tyre::SLIDING * GRAVITY * MASS_KG / INERTIAL_MASS_KG;

#[test]
fn at_walking_speed_full_lock_turns_on_wheelbase_over_tan_25_degrees() {
    for direction in [-1.0, 1.0] {
        let mut car = at_mph(2.0);
        let mut turned = 0.0;
        let mut rolled = 0.0;
        for i in 0..200 {
            let before = (car.position, car.yaw);
            car.step(command(direction, 0.05), Ground::default());
            if i >= 50 {
                rolled += car.position.distance(before.0);
                turned += car.yaw - before.1;
            }
        }
        let radius = rolled / turned * direction;
        // The rear axle's circle; the origin between the axles runs on a wider one.
        let rear = WHEELBASE_M / 25.0_f64.to_radians().tan();
        let expected = rear.hypot(REAR_AXLE_M);
        assert!((radius / expected - 1.0).abs() < 0.03, "radius {radius} m, expected {expected} m");
    }
}

#[test]
fn negative_throttle_brakes_above_5_mph_and_reverses_below() {
    let one = |mph: f64| {
        let mut car = at_mph(mph);
        car.step(command(0.0, -FULL), Ground::default());
        (mph * MPS_PER_MPH - car.speed) / STEP_S
    };
    assert!(one(5.1) > 6.5, "above: {} m/s2", one(5.1));
    // 150 Nm a wheel: the lake recording loses 4.0 mph/s there.
    assert!((one(4.9) - 1.8).abs() < 0.2, "below: {} m/s2", one(4.9));
    let mut car = Car::default();
    for_seconds(&mut car, 5.0, 0.0, -FULL, Ground::default());
    assert!(car.speed < -2.5 * REVERSE_BELOW, "backwards it does not brake at 5 mph: {} m/s", car.speed);
    assert!(car.telemetry_speed().get() > 12.0, "telemetry has no sign");
    assert!(car.position.z < -5.0);
}

#[test]
fn negative_throttle_does_not_brake_a_car_that_slides_at_over_50_degrees() {
    let sliding = |degrees: f64| {
        let angle = degrees.to_radians();
        Car { speed: 8.0 * angle.cos(), lateral_speed: 8.0 * angle.sin(), ..Car::default() }
    };
    assert!(sliding(49.0).brakes_at(8.0));
    assert!(sliding(-49.0).brakes_at(8.0));
    assert!(!sliding(51.0).brakes_at(8.0));
    assert!(!sliding(180.0).brakes_at(8.0));
}

#[test]
fn full_brake_held_turns_into_reverse_without_standing_still() {
    let mut car = at_mph(30.0);
    let time = drive(&mut car, 20.0, command(0.0, -FULL), Ground::default(), |car| car.speed < -1.0);
    assert!((2.5..4.5).contains(&time), "{time} s");
}

#[test]
fn standing_still_stays_still() {
    for steering in [0.0, 1.0, -0.3] {
        let mut car = Car::standing(DVec3::new(3.0, 0.0, -2.0), 0.7);
        for_seconds(&mut car, 60.0, steering, 0.0, Ground::default());
        assert_eq!((car.position, car.yaw), (DVec3::new(3.0, 0.0, -2.0), 0.7));
    }
}

#[test]
fn a_rolling_car_comes_to_rest_without_trembling() {
    for steering in [0.0, 1.0] {
        let mut car = at_mph(3.0);
        let mut before = (car.speed, f64::INFINITY);
        let mut time = 0.0;
        while car.speed != 0.0 && time < 60.0 {
            car.step(command(steering, 0.0), Ground::default());
            assert!(car.speed <= before.0 && car.speed >= 0.0, "it sped up to {} at {time} s", car.speed);
            if time > 2.0 {
                assert!(car.yaw_rate.abs() <= before.1 + 1e-9, "it trembles at {time} s");
                before.1 = car.yaw_rate.abs();
            }
            before.0 = car.speed;
            time += STEP_S;
        }
        assert!((5.0..40.0).contains(&time), "rest after {time} s");
        assert_eq!((car.speed, car.lateral_speed, car.yaw_rate), (0.0, 0.0, 0.0));
    }
}

#[test]
fn coasting_slows_down_as_in_the_recordings() {
    // Jungle rows 21 to 27, on the level at full lock: 3.486 to 3.143 mph in 0.662 s.
    let mut car = Car { yaw_rate: -0.27, ..at_mph(3.486262) };
    for_seconds(&mut car, 0.66, -1.0, 0.0, Ground::default());
    assert!((car.telemetry_speed().get() - 3.1427).abs() < 0.15, "{}", car.telemetry_speed());
    // Lake rows 2 to 8, straight: 0.6229 to 0.5984 mph in 0.413 s.
    let mut car = at_mph(0.6229097);
    for_seconds(&mut car, 0.42, 0.0, 0.0, Ground::default());
    assert!((car.telemetry_speed().get() - 0.59835).abs() < 0.01, "{}", car.telemetry_speed());
}

#[test]
fn slopes_cost_gravity_times_grade() {
    for grade in [-0.3, -0.1, 0.1, 0.3] {
        let (mut level, mut tilted) = (at_mph(15.0), at_mph(15.0));
        for_seconds(&mut level, 0.2, 0.0, 0.3, Ground::default());
        for_seconds(&mut tilted, 0.2, 0.0, 0.3, slope(grade));
        let cost = (level.speed - tilted.speed) / 0.2;
        let expected = GRAVITY * f64::atan(grade).sin() * MASS_KG / INERTIAL_MASS_KG;
        assert!((cost - expected).abs() < 0.06, "grade {grade}: {cost} m/s2, expected {expected}");
        assert!((tilted.pitch - grade.atan()).abs() < 1e-12);
    }
    let mut car = Car::default();
    for_seconds(&mut car, 2.0, 0.0, 0.0, slope(0.2));
    assert!(car.speed < -2.0, "nothing holds it on a hill: {} m/s", car.speed);
    let mut car = Car::default();
    for_seconds(&mut car, 4.0, 0.0, FULL, slope(0.3));
    assert!(car.speed > 5.0, "it climbs the jungle's steepest hill: {} m/s", car.speed);
}

#[test]
fn the_helper_carries_30_mph_through_25_m_but_not_through_full_lock_on_dirt() {
    let curve = |steering: f64, grip: f64| {
        let mut car = at_mph(30.0);
        for_seconds(&mut car, 1.5, steering, FULL, Ground { grip, ..Ground::default() });
        let path = car.velocity().length() / (car.yaw_rate.abs() + 1e-9);
        (car, path)
    };
    let held = f64::atan(WHEELBASE_M / 25.0) / 25.0_f64.to_radians();
    let (car, radius) = curve(held, 1.0);
    assert!((radius / 25.0 - 1.0).abs() < 0.2, "radius {radius} m");
    assert!(car.lateral_speed.abs() < 0.15 * car.speed);
    let (_, asphalt) = curve(1.0, 1.0);
    let (_, dirt) = curve(1.0, 0.3);
    let geometric = WHEELBASE_M / 25.0_f64.to_radians().tan();
    assert!(dirt > 1.5 * geometric, "on dirt it pushes outward: radius {dirt} m, of the wheels {geometric} m");
    assert!(dirt > 1.3 * asphalt, "dirt {dirt} m, asphalt {asphalt} m");
}

#[test]
fn the_yaw_rate_lags_the_steering_more_the_faster_the_car_is() {
    let lag = |mph: f64| {
        let mut car = at_mph(mph);
        let mut yaw = Vec::new();
        for _ in 0..100 {
            car.speed = mph * MPS_PER_MPH;
            car.step(command(0.2, 0.0), Ground::default());
            yaw.push(car.yaw_rate);
        }
        let settled = yaw[99];
        STEP_S * yaw.iter().position(|&rate| rate > 0.632 * settled).unwrap() as f64
    };
    assert!((0.08..0.22).contains(&lag(30.0)), "{} s at 30 mph", lag(30.0));
    assert!(lag(10.0) < 0.7 * lag(30.0), "{} s at 10 mph", lag(10.0));
}

#[test]
fn loose_ground_holds_back_and_makes_the_wheels_spin() {
    let dirt = Ground { grip: 0.5, ..Ground::default() };
    let (mut road, mut verge) = (at_mph(20.0), at_mph(20.0));
    for_seconds(&mut road, 1.0, 0.0, 0.0, Ground::default());
    for_seconds(&mut verge, 1.0, 0.0, 0.0, dirt);
    assert!((road.speed - verge.speed - 0.1 * GRAVITY).abs() < 0.15, "{} and {} m/s", road.speed, verge.speed);
    let mut car = Car::default();
    for_seconds(&mut car, 1.0, 0.0, FULL, dirt);
    assert!(car.torque_cut > 50.0, "traction control takes {} Nm", car.torque_cut);
    for_seconds(&mut car, 5.0, 0.0, FULL, Ground::default());
    assert_eq!(car.torque_cut, 0.0);
    for_seconds(&mut car, 60.0, 0.0, 0.0, dirt);
    assert_eq!(car.speed, 0.0);
}

#[test]
fn nothing_leaves_the_finite_or_the_speed_cap() {
    let mut car = Car::default();
    let mut state = 1_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24) * 2.0 - 1.0
    };
    for _ in 0..200 {
        let (held, ground) =
            (command(2.0 * next(), 2.0 * next()), Ground { height: 0.0, grade: 0.5 * next(), grip: next().abs() });
        for _ in 0..50 {
            car.step(held, ground);
            assert!(car.position.is_finite() && car.yaw.is_finite());
            assert!(car.telemetry_speed().get() < 31.0, "{car:?}");
            assert!(car.yaw_rate.abs() < 4.0, "{car:?}");
        }
    }
}

#[test]
fn the_same_commands_give_the_same_bits() {
    let drive = || {
        let mut car = Car::standing(DVec3::new(-40.62, 2.6, 108.73), -2.16);
        for i in 0..20_000 {
            let phase = f64::from(i) * 0.01;
            car.step(command(phase.sin() * 0.6, (phase * 0.37).cos()), slope(0.1 * (phase * 0.2).sin()));
        }
        [car.position.x, car.position.z, car.yaw, car.speed, car.lateral_speed, car.yaw_rate].map(f64::to_bits)
    };
    assert_eq!(drive(), drive());
}
