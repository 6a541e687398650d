//! What is shown, against what a camera there would have taken: in the simulator the truth can be drawn.

use std::{ops::Range, path::Path, sync::Arc, time::Duration};

use super::{Beside, Glimpse, RecordedWorld, SIZE, Warp, Yaw, flow::luminance, warp::CAMERAS};
use crate::{
    camera::{Camera, JPEG_QUALITY, Renderer, Shot, encode_jpeg, tests::scenery},
    conditions::Conditions,
    expert::LaneExpert,
    locate::{Located, LocatedDrive, Pose},
    track::Track,
};
use lapwing_core::{
    perception::Frame,
    protocol::{Answer, Command, World},
    recording::udacity::{DrivingLogWriter, NewRow},
    units::{MPS_PER_MPH, Mph, Steering, Throttle},
};

/// The road is compared no farther ahead than this, in metres.
const FAR_M: f32 = 25.0;

/// The mean absolute errors of a picture, in grey levels.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Errors {
    /// Above the horizon.
    above: f64,
    /// Below it, beside the road.
    verge: f64,
    /// On the road.
    road: f64,
}

/// A known road and what is seen on it.
struct Place {
    track: Arc<Track>,
    renderer: Renderer,
    warp: Warp,
}

impl Place {
    fn on(name: &str) -> Self {
        let (track, scenery) = scenery(name);
        Self { track: Arc::new(track), renderer: Renderer::new(scenery), warp: Warp::new() }
    }

    /// The pose of a car beside another one.
    fn beside(&self, there: Pose, beside: Beside) -> Pose {
        let (at, yaw) = beside.from(there.in_world(&self.track));
        let found = self.track.locate(at.with_y(self.track.at(there.s_m).position.y), Some(there.s_m));
        let (s_m, offset_m) = (found.station.s, found.offset);
        Pose { s_m, offset_m, heading_rad: yaw - found.station.yaw, pitch_rad: 0.0 }
    }

    /// What a camera of a car takes there.
    fn taken(&mut self, pose: Pose, camera: &Camera) -> Frame {
        let (mut frame, conditions) = (Frame::default(), Conditions::default());
        let shot = Shot { car: &pose.car(&self.track), actors: &[], conditions: &conditions, seed: 1, time_s: 0.0 };
        self.renderer.render(camera, &shot, &mut frame);
        frame
    }

    /// How wrong a picture is of what the centre camera takes there.
    fn errors(&self, pose: Pose, shown: &Frame, truth: &Frame) -> Errors {
        let ((at, yaw), (mut sums, mut counts)) = (pose.in_world(&self.track), ([0.0; 3], [0_u32; 3]));
        let (shown, truth) = (shown.rgb().as_chunks().0, truth.rgb().as_chunks().0);
        for (i, point) in self.warp.points.iter().enumerate().filter(|(i, _)| i % 2 == i / SIZE.0 % 2) {
            let zone = match *point {
                None => continue,
                Some(to) if to.y >= 0.0 => 0,
                Some(to) if to.z > FAR_M => continue,
                Some(to) => {
                    let from = self.warp.cameras[0].position;
                    let (offset_m, ahead_m) = (f64::from(to.x + from.x), f64::from(to.z + from.z));
                    let (point, _) = Beside { offset_m, ahead_m, heading_rad: 0.0 }.from((at, yaw));
                    let offset_m = self.track.locate(point, Some(pose.s_m + ahead_m)).offset;
                    if offset_m.abs() < self.track.half_width() { 2 } else { 1 }
                }
            };
            sums[zone] += f64::from((luminance(&shown[i]) - luminance(&truth[i])).abs());
            counts[zone] += 1;
        }
        let [above, verge, road] = [0, 1, 2].map(|zone| sums[zone] / f64::from(counts[zone].max(1)));
        Errors { above, verge, road }
    }
}

/// Laps of one stretch of road that weave, each in its own way: as a recording that jumps back to the stretch's start.
struct Laps {
    /// Where the recording is, and how many pictures each lap has.
    dir: tempfile::TempDir,
    located: LocatedDrive,
    /// The pictures of the centre camera.
    taken: Vec<Frame>,
}

/// Rows of a lap, a metre apart, and metres a second.
const ROWS: usize = 110;
const MPS: f64 = 10.0;
const LAPS: usize = 3;

impl Laps {
    /// With one camera or three; on the lane's middle from `from_m` on, weaving around it.
    fn record(place: &mut Place, from_m: f64, cameras: usize) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut log = DrivingLogWriter::create(dir.path(), jiff::civil::date(2026, 11, 26).at(8, 0, 0, 0)).unwrap();
        let (mut places, mut taken) = (vec![], vec![]);
        let lane_m = place.track.file().driving_line_m;
        for (lap, row) in (0..LAPS).flat_map(|lap| (0..ROWS).map(move |row| (lap, row))) {
            let (weave_m, per_m) = (1.2, std::f64::consts::TAU / ROWS as f64);
            let phase = per_m * row as f64 + std::f64::consts::TAU * lap as f64 / LAPS as f64;
            let pose = Pose {
                s_m: from_m + row as f64,
                offset_m: lane_m + weave_m * phase.sin(),
                heading_rad: (weave_m * per_m * phase.cos()).atan(),
                pitch_rad: 0.0,
            };
            let frames = CAMERAS.map(|camera| place.taken(pose, &camera));
            let jpegs = frames.each_ref().map(|frame| encode_jpeg(frame, JPEG_QUALITY));
            let side = |i: usize| Some(&jpegs[i][..]).filter(|_| cameras == CAMERAS.len());
            log.row(&NewRow {
                // Between two laps time is missing.
                at: Duration::from_secs_f64((row + lap * (ROWS + 40)) as f64 / MPS),
                center: &jpegs[0],
                left: side(1),
                right: side(2),
                steering: Steering::ZERO,
                throttle: Throttle::ZERO,
                brake: 0.0,
                speed: Mph::saturating(MPS / MPS_PER_MPH),
            })
            .unwrap();
            places.push(Some(Located::known(pose)));
            taken.extend(frames.into_iter().take(1));
        }
        log.finish().unwrap();
        Self { dir, located: LocatedDrive { track: Arc::clone(&place.track), places }, taken }
    }

    /// Drives in the lane's middle along all laps, each shown only its own pictures, or those of all.
    fn judge(&self, place: &mut Place, of_all: bool) -> Judged {
        let mut judged = Judged::default();
        let parts = if of_all { 1 } else { LAPS };
        let rows = LAPS * ROWS / parts;
        for rows in (0..parts).map(|part| part * rows..(part + 1) * rows) {
            let path: &Path = self.dir.path();
            let mut world = RecordedWorld::within(path, rows, None, Yaw::Pictures, Some(self.located.clone())).unwrap();
            let mut expert = LaneExpert::new(Arc::clone(&place.track)).unwrap();
            let mut apart_m = 0.0;
            while world.observe().unwrap().is_some() {
                let row = world.picture_number().unwrap();
                let here = place.beside(self.located.places[row].unwrap().pose, world.beside());
                let truth = place.taken(here, &Camera::CENTER);
                judged.seen.push(Seen {
                    apart_m: world.sights().apart_m - apart_m,
                    shown: place.errors(here, world.picture(), &truth),
                    unwarped: place.errors(here, &self.taken[row], &truth),
                });
                apart_m = world.sights().apart_m;
                let steering = expert.steering(here, Mph::saturating(MPS / MPS_PER_MPH));
                world.apply(Answer::Steer(Command { steering, throttle: Throttle::ZERO }));
            }
            judged.of_another_lap += world.of_another_lap();
            judged.filled += world.sights().filled.0;
            assert_eq!(world.interventions(), 0);
        }
        judged
    }
}

/// A picture that was shown.
#[derive(Debug, Clone, Copy)]
struct Seen {
    /// From the nearest camera that took it, in metres.
    apart_m: f64,
    shown: Errors,
    /// The errors of the recorded picture, as it is.
    unwarped: Errors,
}

#[derive(Debug, Default)]
struct Judged {
    seen: Vec<Seen>,
    of_another_lap: u32,
    filled: f64,
}

impl Judged {
    fn mean(&self, of: impl Fn(&Seen) -> f64, from: Range<f64>) -> f64 {
        let seen: Vec<f64> = self.seen.iter().filter(|seen| from.contains(&seen.apart_m)).map(of).collect();
        seen.iter().sum::<f64>() / seen.len() as f64
    }

    fn errors(&self, of: impl Fn(&Seen) -> Errors, from: Range<f64>) -> [f64; 3] {
        let zone = |zone: fn(&Errors) -> f64| self.mean(|seen| zone(&of(seen)), from.clone());
        [zone(|errors| errors.above), zone(|errors| errors.verge), zone(|errors| errors.road)]
    }
}

const ANY: Range<f64> = 0.0..f64::MAX;

#[test]
fn of_any_lap_pictures_are_nearer_to_what_is_seen_there_than_of_the_same() {
    let mut place = Place::on("jungle");
    let laps = Laps::record(&mut place, 320.0, 1);
    let [film, world] = [false, true].map(|of_all| laps.judge(&mut place, of_all));
    assert_eq!((film.seen.len(), world.seen.len()), (LAPS * ROWS, LAPS * ROWS));
    let apart = [&film, &world].map(|judged| judged.mean(|seen| seen.apart_m, ANY));
    let (before, after) = (film.errors(|seen| seen.shown, ANY), world.errors(|seen| seen.shown, ANY));
    let unwarped = film.errors(|seen| seen.unwarped, ANY);
    println!("{apart:.2?} m; unwarped {unwarped:.1?}, of the same lap {before:.1?}, of any {after:.1?}");
    assert_eq!(film.of_another_lap, 0);
    assert!((100..300).contains(&world.of_another_lap), "{}", world.of_another_lap);
    assert!(apart[1] < 0.6 * apart[0], "{apart:?}");
    for zone in 0..3 {
        assert!(
            after[zone] < 0.93 * before[zone] && before[zone] < 0.9 * unwarped[zone],
            "{zone}: {after:?}, {before:?}, {unwarped:?}"
        );
    }
    assert!(world.filled <= film.filled, "{} of {}", world.filled, film.filled);
}

#[test]
fn what_stands_beside_the_road_is_moved_aside_as_the_car_moves() {
    let mut place = Place::on("lake");
    let beside = Beside { offset_m: 0.4, ..Beside::default() };
    let (mut warped, mut unwarped) = (0.0, 0.0);
    for s_m in [120.0, 330.0, 560.0, 800.0] {
        let there = Pose { s_m, ..Pose::default() };
        let (recorded, here) = (place.taken(there, &Camera::CENTER), place.beside(there, beside));
        let (truth, mut shown) = (place.taken(here, &Camera::CENTER), Frame::default());
        place.warp.render(&[Glimpse { pictures: [Some(&recorded), None, None], beside }], &mut shown).unwrap();
        warped += place.errors(here, &shown, &truth).above;
        unwarped += place.errors(here, &recorded, &truth).above;
    }
    assert!(warped < 0.85 * unwarped, "above the horizon: {warped:.1} against {unwarped:.1}");
}

/// The tables of docs/explanation/closed-loop.md.
#[test]
#[ignore = "prints tables"]
fn how_near_the_pictures_are_to_the_truth_by_distance() {
    let told = |[above, verge, road]: [f64; 3]| format!("{above:.1}, {verge:.1}, {road:.1}");
    let mut by_distance = vec![String::new(); 4];
    for (name, from_m) in [("lake", 300.0), ("jungle", 320.0), ("mountain", 700.0)] {
        let mut place = Place::on(name);
        for cameras in [1, 3] {
            let laps = Laps::record(&mut place, from_m, cameras);
            let [film, world] = [false, true].map(|of_all| laps.judge(&mut place, of_all));
            let unwarped = told(film.errors(|seen| seen.unwarped, ANY));
            let [same, any] = [&film, &world].map(|judged| {
                let apart_m = judged.mean(|seen| seen.apart_m, ANY);
                format!("{} | {apart_m:.2} m", told(judged.errors(|seen| seen.shown, ANY)))
            });
            let (shown, pictures) = (world.of_another_lap, world.seen.len());
            println!("| {name}, {cameras} | {unwarped} | {same} | {any} | {shown} of {pictures} |");
            if cameras == 1 {
                let both = Judged { seen: [film.seen, world.seen].concat(), ..Judged::default() };
                for (line, from) in by_distance.iter_mut().zip([0.0..0.3, 0.3..0.6, 0.6..1.0, 1.0..2.0]) {
                    let (unwarped, shown) = (both.errors(|s| s.unwarped, from.clone()), both.errors(|s| s.shown, from));
                    *line += &format!(" {} | {} |", told(unwarped), told(shown));
                }
            }
        }
    }
    println!("by distance, one camera:\n{}", by_distance.join("\n"));
}

/// What a picture costs that was taken elsewhere: the weights of what is nearest come from here.
#[test]
#[ignore = "prints a table"]
fn what_a_warp_costs_by_offset_heading_and_way() {
    for name in ["lake", "jungle", "mountain"] {
        let mut place = Place::on(name);
        let length_m = place.track.length();
        let spots: Vec<f64> = (0..12).map(|i| (f64::from(i) + 0.5) / 12.0 * length_m).collect();
        let mut line = |what: String, beside: Beside| {
            let mut mean = [Errors::default(); 3];
            for s_m in &spots {
                let lane_m = place.track.file().driving_line_m;
                let there = Pose { s_m: *s_m, offset_m: lane_m, ..Pose::default() };
                let here = place.beside(there, beside);
                let pictures = CAMERAS.map(|camera| place.taken(there, &camera));
                let truth = place.taken(here, &Camera::CENTER);
                for (k, mean) in mean.iter_mut().enumerate() {
                    let mut shown = pictures[0].clone();
                    let sides = |i: usize| Some(&pictures[i]).filter(|_| k == 2);
                    if k > 0 {
                        let glimpse = Glimpse { pictures: [Some(&pictures[0]), sides(1), sides(2)], beside };
                        place.warp.render(&[glimpse], &mut shown).unwrap();
                    }
                    let errors = place.errors(here, &shown, &truth);
                    let n = spots.len() as f64;
                    mean.above += errors.above / n;
                    mean.verge += errors.verge / n;
                    mean.road += errors.road / n;
                }
            }
            let told = mean.map(|e| format!("{:5.1} {:5.1} {:5.1}", e.above, e.verge, e.road));
            println!("{name:9} {what:14} not warped {}  one camera {}  three {}", told[0], told[1], told[2]);
        };
        for offset_m in [0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, -0.3, -0.8] {
            line(format!("{offset_m} m aside"), Beside { offset_m, ..Beside::default() });
        }
        for heading_deg in [0.5_f64, 1.0, 2.0, 4.0, 8.0, -4.0] {
            let heading_rad = heading_deg.to_radians();
            line(format!("{heading_deg} degrees"), Beside { heading_rad, ..Beside::default() });
        }
        for ahead_m in [0.1, 0.25, 0.5, 1.0, 2.0, 3.0, -1.0, -3.0] {
            line(format!("{ahead_m} m ahead"), Beside { ahead_m, ..Beside::default() });
        }
    }
}
