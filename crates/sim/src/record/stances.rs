//! Pictures of a car that stands somewhere on the road, anyhow: to learn where in its lane a car is. They show what a
//! drive hardly ever does, such as a car at the road's edge and askew, and each of them another place.

use std::{sync::Arc, time::Duration};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    RecordError,
    log::{Moment, Rows},
};
use crate::{
    camera::{Camera, JPEG_QUALITY, Renderer, Shot, encode_jpeg},
    conditions::Conditions,
    expert::LaneExpert,
    locate::Pose,
    world::Setup,
};
use lapwing_core::{
    perception::Frame,
    protocol::Command,
    recording::udacity::DrivingLogWriter,
    units::{Mph, Throttle},
};

/// Half of the stances are anywhere between the road's edges and this far beyond them, in metres.
const BEYOND_M: f64 = 0.6;
/// The others are this far from the line, in metres: a standard deviation.
const NEAR_M: f64 = 0.9;
/// Most degrees askew; small angles are more frequent.
const ASKEW_DEG: f64 = 22.0;
/// Most degrees nose up or down from the road's slope, as a car that brakes or speeds up; small angles are more frequent.
const PITCH_DEG: f64 = 1.2;
/// Stances in the same weather: another sun lights the whole scenery anew, which takes as long as some pictures.
const IN_ONE_WEATHER: u64 = 20;
/// Speed at which the log says what the expert would steer.
const SPEED: Mph = Mph::constant(20.0);
/// Seconds between two stances, in the log: there is rain and noise of each moment.
const APART: Duration = Duration::from_millis(100);

/// Which stances are recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StanceOptions {
    /// How many.
    pub count: u64,
    /// Whether the weather changes all the time, as [`Conditions::random`]; otherwise it is the setup's.
    pub every_weather: bool,
}

/// Records the centre camera's pictures of that many stances, drawn by the setup's seed, on the setup's road, in both
/// directions. The log holds what the expert would steer there, and no row continues from the last one. `go_on` is asked
/// before each; returns how many were recorded.
///
/// # Errors
/// [`RecordError`] where the log or a picture cannot be written.
pub fn stances(
    setup: &Setup,
    log: DrivingLogWriter,
    options: StanceOptions,
    mut go_on: impl FnMut() -> bool,
) -> Result<u64, RecordError> {
    let track = &setup.track;
    let mut expert = LaneExpert::new(Arc::clone(track))?;
    let mut renderer = Renderer::new(Arc::clone(&setup.scenery));
    let mut random = ChaCha8Rng::seed_from_u64(setup.seed ^ 0x57a9_ce00);
    let mut rows = Rows::new(log);
    let mut frame = Frame::default();
    let mut conditions = setup.conditions.clone();
    for number in 0..options.count {
        if !go_on() {
            break;
        }
        if options.every_weather && number % IN_ONE_WEATHER == 0 {
            conditions = Conditions::random(random.random());
        }
        let pose = stance(setup, &mut random);
        let car = pose.car(track);
        let at = APART * u32::try_from(number).unwrap_or(u32::MAX);
        let shot = Shot { car: &car, actors: &[], conditions: &conditions, seed: setup.seed, time_s: at.as_secs_f64() };
        renderer.render(&Camera::CENTER, &shot, &mut frame);
        rows.cut();
        rows.write(&Moment {
            at,
            center: &encode_jpeg(&frame, JPEG_QUALITY),
            sides: None,
            label: Command { steering: expert.steering(pose, SPEED), throttle: Throttle::ZERO },
            speed: SPEED,
            track,
            pose,
        })?;
    }
    rows.finish()
}

/// Draws a stance: place, offset, direction, heading and pitch.
fn stance(setup: &Setup, random: &mut ChaCha8Rng) -> Pose {
    let track = &setup.track;
    let mut uniform = || random.random::<f64>();
    let s_m = uniform() * track.length();
    let reversed = uniform() < 0.5;
    // The sum of two uniform numbers: from -1 to 1, the middle most often.
    let askew_deg = (uniform() + uniform() - 1.0) * ASKEW_DEG;
    let pitch_deg = (uniform() + uniform() - 1.0) * PITCH_DEG;
    let (half, line_m) = (track.half_width() + BEYOND_M, track.file().driving_line_m);
    let anywhere_m = (2.0 * uniform() - 1.0) * half - line_m;
    let near_m = (uniform() + uniform() + uniform() + uniform() - 2.0) * 3f64.sqrt() * NEAR_M;
    let offset_m = if uniform() < 0.5 { anywhere_m } else { near_m.clamp(-half - line_m, half - line_m) };
    let pose = Pose::from_lane(track, s_m, reversed, offset_m, askew_deg.to_radians());
    Pose { pitch_rad: pitch_deg.to_radians(), ..pose }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{camera::Scenery, locate::LaneTable, track::Track};

    fn recorded(count: u64, every_weather: bool) -> (tempfile::TempDir, LaneTable) {
        let track = Arc::new(Track::named("jungle").unwrap());
        let scenery = Arc::new(Scenery::new(&track));
        let setup = Setup { seed: 5, ..Setup::new(track, scenery) };
        let dir = tempfile::tempdir().unwrap();
        let log = DrivingLogWriter::create(dir.path(), jiff::civil::date(2026, 11, 23).at(8, 0, 0, 0)).unwrap();
        assert_eq!(stances(&setup, log, StanceOptions { count, every_weather }, || true).unwrap(), count);
        let table = LaneTable::read(&dir.path().join(super::super::LANE_NAME), Track::open).unwrap();
        (dir, table)
    }

    #[test]
    fn stances_are_all_over_the_road_askew_and_in_both_directions() {
        let track = Track::named("jungle").unwrap();
        let scenery = Arc::new(Scenery::new(&track));
        let setup = Setup::new(Arc::new(track), scenery);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let drawn: Vec<_> = (0..2000).map(|_| stance(&setup, &mut random)).collect();
        let lanes: Vec<_> = drawn.iter().map(|pose| pose.in_lane(&setup.track)).collect();
        let share =
            |of: &dyn Fn(&crate::locate::InLane) -> bool| lanes.iter().filter(|l| of(l)).count() as f64 / 2000.0;
        assert!(share(&|lane| lane.offset_m > lane.edges_m.1) > 0.02, "beyond the right edge");
        assert!(share(&|lane| lane.offset_m < lane.edges_m.0) > 0.02, "beyond the left edge");
        assert!(share(&|lane| lane.offset_m.abs() < 1.0) > 0.4, "near the line");
        assert!(share(&|lane| lane.heading_rad.to_degrees() > 12.0) > 0.05, "askew to the right");
        assert!(share(&|lane| lane.heading_rad.to_degrees() < -12.0) > 0.05, "askew to the left");
        let back = drawn.iter().filter(|pose| pose.direction() < 0.0).count();
        assert!((900..1100).contains(&back), "{back} of 2000 against the track's direction");
    }

    #[test]
    fn the_table_holds_the_stances_of_the_pictures_which_do_not_follow_each_other() {
        let (dir, table) = recorded(3, true);
        let again = recorded(3, true).1;
        assert_eq!((table.rows.len(), &table.rows), (3, &again.rows), "the seed decides");
        let recording = lapwing_core::recording::Recording::open(dir.path()).unwrap();
        let moments: Vec<_> = recording.map(Result::unwrap).collect();
        assert_eq!(moments.len(), 3);
        assert!(moments[1..].iter().all(|moment| moment.broken.is_some()));
        assert!(moments.iter().all(|moment| moment.pictures[0].is_some() && moment.pictures[1].is_none()));
        let held = LaneTable::of(dir.path(), &dir.path().join("lane.csv"), Track::open).unwrap();
        assert_eq!(held.rows, table.rows, "what reads the recording finds its table");
    }
}
