//! The driver that knows the road. It drives recordings and acts as the scripted human, and its path is what telemetry
//! reports to [`PurePursuit`] as a pilot.

mod lane;

pub use lane::LaneExpert;

use super::{
    track::{Place, Track},
    vehicle::Car,
};
use lapwing_core::{
    car::GRAVITY,
    pilot::PurePursuit,
    protocol::Command,
    units::{MetresPerSecond, Mph, PathPoint, Steering, Throttle},
};

/// Points of the reported path, a metre apart: enough to brake from 30 mph to 5 at 3 m/s² (29 m).
const POINTS: usize = 41;

/// Throttle per m/s below the set speed.
const THROTTLE_GAIN: f64 = 0.6;
/// What full throttle gives, in m/s²: 2000 Nm on wheels of 0.35 m and 1000 kg.
pub(super) const FULL_THROTTLE_MPS2: f64 = 5.7;
/// What drag takes, in m/s² for each m/s.
pub(super) const DRAG_PER_S: f64 = 0.1;
/// Throttle taken off per m/s above the set speed: brakes of 20000 Nm a wheel lock at 0.04 of full command.
const BRAKE_GAIN: f64 = 0.06;

/// Fills `out` with the line to drive as the car sees it: a point every metre beginning beside the car, 41 in all.
/// `place` is where the car is.
pub fn path_ahead(track: &Track, place: &Place, car: &Car, out: &mut Vec<PathPoint>) {
    out.clear();
    let (line, length) = (track.driving_line(), track.driving_line_length());
    let n = line.len();
    let (sin, cos) = car.yaw.sin_cos();
    // The point of the line beside the car: from the one beside its station, along the line's direction.
    let mut i = ((place.station.s / track.length() * n as f64) as usize).min(n - 1);
    let from_line = car.position - line[i].position;
    let (line_sin, line_cos) = line[i].yaw.sin_cos();
    let lateral = from_line.x * line_cos - from_line.z * line_sin;
    let bend = (1.0 - line[i].curvature * lateral).max(0.2); // nearer the centre of a bend, a metre of line is less
    let along = (from_line.x * line_sin + from_line.z * line_cos) / bend;
    let mut wanted = line[i].travelled + along.clamp(-5.0, 5.0);
    if wanted < 0.0 {
        wanted += length;
        i = n - 1;
    }
    while i > 0 && line[i].travelled > wanted {
        i -= 1;
    }
    let mut laps = 0.0; // metres of whole laps before line[i]
    for _ in 0..POINTS {
        // To the last point not beyond the wanted one, past the line's beginning if need be.
        let (mut begin, mut end, mut on);
        loop {
            on = if i + 1 < n { i + 1 } else { 0 };
            begin = laps + line[i].travelled;
            end = if on > 0 { laps + line[on].travelled } else { laps + length };
            if end > wanted {
                break;
            }
            i = on;
            if on == 0 {
                laps += length;
            }
        }
        let share = (wanted - begin) / (end - begin);
        let (a, b) = (&line[i], &line[on]);
        let to = a.position.lerp(b.position, share) - car.position;
        out.push(PathPoint {
            ahead_m: to.x * sin + to.z * cos,
            right_m: to.x * cos - to.z * sin,
            curvature_per_m: a.curvature + share * (b.curvature - a.curvature),
        });
        wanted += 1.0;
    }
}

/// Drives by the line.
#[derive(Debug, Clone, Default)]
pub struct Expert {
    pursuit: PurePursuit,
    path: Vec<PathPoint>,
}

impl Expert {
    /// Steering and throttle for a car at `place`, which drives at `set_speed` if bends allow it.
    pub fn drive(&mut self, track: &Track, place: &Place, car: &Car, set_speed: Mph) -> Command {
        path_ahead(track, place, car, &mut self.path);
        let Some(pursuit) = self.pursuit.pursue(&self.path, MetresPerSecond::saturating(car.speed)) else {
            return Command::default();
        };
        let slower = if pursuit.speed_limit < set_speed { pursuit.speed_limit } else { set_speed };
        let missing = slower.metres_per_second().get() - car.speed;
        let gain = if missing > 0.0 { THROTTLE_GAIN } else { BRAKE_GAIN };
        // Compensates drag and slope, so that little error remains once the speed is reached.
        let uphill = GRAVITY * place.station.grade * (car.yaw - place.station.yaw).cos();
        let held = ((DRAG_PER_S * car.speed + uphill) / FULL_THROTTLE_MPS2).clamp(0.0, 1.0);
        let lowest = if car.speed > 2.5 { -1.0 } else { 0.0 }; // below 5 mph the brake is the reverse gear
        Command {
            steering: Steering::saturating(pursuit.steering),
            throttle: Throttle::saturating((held + gain * missing).max(lowest)),
        }
    }

    /// The line as it was reported for the last command.
    pub fn path(&self) -> &[PathPoint] {
        &self.path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        track::RandomTrack,
        vehicle::{BODY, Ground, STEP_S},
    };

    /// What a drive was like.
    #[derive(Debug, Default)]
    struct LineKept {
        seconds: f64,
        top_mph: f64,
        /// Metres from the driving line: mean and worst.
        mean: f64,
        worst: f64,
        /// The farthest that the car's origin was beyond the road's edge, in metres (negative: on the road).
        origin_beyond: f64,
        /// The same for the body's farthest corner.
        corner_beyond: f64,
    }

    /// Drives laps with an answer every `every` steps, which takes effect `late` steps later.
    fn drive(track: &Track, laps: u32, mph: f64, every: u32, late: u32) -> LineKept {
        let start = track.driving_line()[0];
        let car = Car { position: start.position, yaw: start.yaw, ..Car::default() };
        drive_from(track, car, f64::from(laps) * track.length(), mph, every, late).0
    }

    /// Drives this many metres; also returns how far from the line it ended.
    fn drive_from(track: &Track, mut car: Car, metres: f64, mph: f64, every: u32, late: u32) -> (LineKept, f64) {
        let mut expert = Expert::default();
        let mut drive = LineKept { origin_beyond: -9.9, corner_beyond: -9.9, ..LineKept::default() };
        let (mut place, mut gone, mut sum, mut steps) = (track.locate(car.position, None), 0.0, 0.0, 0u32);
        let mut queue = std::collections::VecDeque::from(vec![Command::default(); late as usize]);
        let (mut answer, mut last) = (Command::default(), 0.0);
        while gone < metres {
            if steps % every == 0 {
                answer = expert.drive(track, &place, &car, Mph::new(mph).unwrap());
            }
            queue.push_back(answer);
            let command = queue.pop_front().unwrap();
            let station = place.station;
            let along = (car.yaw - station.yaw).cos();
            car.step(command, Ground { height: station.position.y, grade: station.grade * along, grip: 1.0 });
            let next = track.locate(car.position, Some(place.station.s));
            let moved = track.ahead(place.station.s, next.station.s);
            gone += if moved > track.length() / 2.0 { moved - track.length() } else { moved };
            place = next;

            let n = track.stations().len();
            let i = ((place.station.s / track.length() * n as f64).round() as usize) % n;
            let off = (place.offset - track.driving_line()[i].offset).abs();
            (sum, last) = (sum + off, off);
            drive.worst = drive.worst.max(off);
            drive.top_mph = drive.top_mph.max(car.speed / 0.447_04);
            drive.origin_beyond = drive.origin_beyond.max(place.offset.abs() - track.half_width());
            let (ahead, right) = ((car.yaw.sin(), car.yaw.cos()), (car.yaw.cos(), -car.yaw.sin()));
            for (forward, side) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                let (f, r) = (forward * BODY.z / 2.0, side * BODY.x / 2.0);
                let corner = car.position + glam::DVec3::new(ahead.0 * f + right.0 * r, 0.0, ahead.1 * f + right.1 * r);
                let corner = track.locate(corner, Some(place.station.s));
                drive.corner_beyond = drive.corner_beyond.max(corner.offset.abs() - track.half_width());
            }
            steps += 1;
            drive.seconds = f64::from(steps) * STEP_S;
            assert!(drive.seconds < 10.0 + metres / 1.5, "{}: too slow: {drive:?}", track.file().name);
            assert!(drive.origin_beyond < 3.0, "{} at {:.0} m: left the road", track.file().name, place.station.s);
        }
        drive.mean = sum / f64::from(steps);
        (drive, last)
    }

    /// Laps at 50 Hz as the simulator itself drives, and as a pilot does: at 16.7 Hz, the answer a frame late.
    fn drives_well(track: &Track, laps: u32, what: fn(&LineKept) -> bool) {
        for mph in [20.0, 30.0] {
            for (every, late) in [(1, 0), (3, 3)] {
                let drive = drive(track, laps, mph, every, late);
                let how = format!("{} at {mph} mph, every {every}, {late} late: {drive:.3?}", track.file().name);
                println!("{how}");
                assert!(drive.corner_beyond < 0.0 && drive.origin_beyond < 0.0, "off the road: {how}");
                assert!(what(&drive), "{how}");
            }
        }
    }

    #[test]
    fn ten_laps_of_the_lake_stay_within_a_hand_of_the_line() {
        drives_well(&Track::named("lake").unwrap(), 10, |drive| {
            drive.mean < 0.1 && drive.worst < 0.3 && drive.top_mph > 19.5
        });
    }

    #[test]
    fn ten_laps_of_the_jungle_stay_on_the_road() {
        drives_well(&Track::named("jungle").unwrap(), 10, |drive| drive.mean < 0.15 && drive.worst < 0.6);
    }

    #[test]
    fn ten_laps_of_the_mountain_stay_on_the_road() {
        drives_well(&Track::named("mountain").unwrap(), 10, |drive| drive.mean < 0.15 && drive.worst < 0.6);
    }

    #[test]
    fn three_laps_of_each_of_twenty_random_roads_stay_on_the_road() {
        for seed in 0..20 {
            let track = Track::open(&format!("random:{seed}")).unwrap();
            drives_well(&track, 3, |drive| drive.mean < 0.15 && drive.worst < 0.6);
        }
    }

    #[test]
    fn a_lap_of_each_of_six_random_roads_with_lanes_and_crests_stays_on_the_road() {
        for seed in 0..6 {
            let track = Track::open(&format!("random-lanes:{seed}")).unwrap();
            drives_well(&track, 1, |drive| drive.mean < 0.15 && drive.worst < 0.6);
        }
    }

    #[test]
    fn a_road_that_crosses_itself_is_driven_over_and_under_its_bridge() {
        let file = RandomTrack { seed: 7, crossings: true, ..RandomTrack::default() }.build().unwrap();
        drives_well(&Track::new(file).unwrap(), 3, |drive| drive.mean < 0.15 && drive.worst < 0.6);
    }

    #[test]
    fn from_beside_the_line_it_finds_back_without_leaving_the_road() {
        for name in ["lake", "jungle", "mountain"] {
            let track = Track::named(name).unwrap();
            for (start, offset, turned) in [
                (0.2, -1.3, 0.0),
                (0.4, 1.3, 0.0),
                (0.5, 0.0, 0.25),
                (0.6, 0.0, -0.25),
                (0.8, 0.9, 0.15),
                (0.9, -0.9, -0.15),
            ] {
                let n = track.stations().len();
                let at = track.driving_line()[(start * n as f64) as usize];
                let right = glam::DVec3::new(at.yaw.cos(), 0.0, -at.yaw.sin());
                let car =
                    Car { position: at.position + right * offset, yaw: at.yaw + turned, speed: 4.0, ..Car::default() };
                let (drive, last) = drive_from(&track, car, 80.0, 20.0, 3, 3);
                let how =
                    format!("{name} at {start}, {offset} m and {turned} rad beside: {drive:.3?}, at last {last:.3} m");
                println!("{how}");
                assert!(drive.origin_beyond < -0.5 && last < 0.3, "{how}");
            }
        }
    }

    #[test]
    fn the_path_begins_beside_the_car_and_has_a_point_each_metre() {
        for name in Track::NAMES {
            let track = Track::named(name).unwrap();
            let mut path = vec![];
            for i in 0..2000 {
                let s = track.length() * f64::from(i) / 2000.0;
                let place = track.locate(track.point(s, 0.3), Some(s));
                let car = Car { position: track.point(s, 0.3), yaw: place.station.yaw + 0.1, ..Car::default() };
                path_ahead(&track, &place, &car, &mut path);
                assert_eq!(path.len(), POINTS);
                let (a, b) = (path[0], path[1]);
                let along = a.ahead_m * (b.ahead_m - a.ahead_m) + a.right_m * (b.right_m - a.right_m);
                assert!(along.abs() < 0.2, "{name} {s:.1} m: {along:.2} m from beside the car: {a:?}");
                for pair in path.windows(2) {
                    let apart = (pair[1].ahead_m - pair[0].ahead_m).hypot(pair[1].right_m - pair[0].right_m);
                    assert!((0.97..1.001).contains(&apart), "{name} {s:.1} m: {apart}");
                }
            }
        }
    }
}
