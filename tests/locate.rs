//! Real pictures, located: three cameras took each moment, so where they sit on the car must come out.

use std::thread;

use lapwing_core::{
    motion::Motion,
    perception::decode_jpeg,
    recording::{Moment, Recording},
};
use lapwing_sim::{
    camera::{Camera, Scenery},
    locate::{Known, Located, Overlay, Pose},
    track::Track,
};

use crate::support::shared;

/// How the car came to each moment from the one before.
fn motions(moments: &[Moment]) -> Vec<Motion> {
    let motion = |i: usize| moments[i].motion_from(&moments[i.saturating_sub(1)]);
    (0..moments.len()).map(motion).collect()
}

/// What was found in the pictures of one camera, 0 to 2, each as if it were the centre one.
pub fn located(track: &str, start: Pose, moments: &[Moment], camera: usize) -> Vec<Located> {
    let track = Track::named(track).unwrap();
    let scenery = Scenery::new(&track);
    let mut overlay = Overlay::new(track.into(), scenery.into(), (320, 160));
    let picture = |i: usize, frame: &mut _| {
        let picture = moments[i].pictures[camera].as_ref().expect("three cameras");
        decode_jpeg(&picture.read().unwrap(), frame)
    };
    overlay.follow(&[Known { picture: 0, pose: start, deviation_m: 3.0 }], &motions(moments), picture).unwrap()
}

#[test]
fn on_the_real_lake_the_side_cameras_are_found_where_they_sit_on_the_car() {
    let Some(folder) = shared("recordings/lake") else { return };
    let moments: Vec<Moment> = Recording::open(folder).unwrap().take(700).map(Result::unwrap).collect();
    // Where the recording begins: it stands in the last bend before the first straight.
    let start = Pose { s_m: 1136.0, ..Pose::default() };
    let [center, left, right] = thread::scope(|scope| {
        let threads = [0, 1, 2].map(|camera| {
            let moments = &moments;
            scope.spawn(move || located("lake", start, moments, camera))
        });
        threads.map(|thread| thread.join().unwrap())
    });
    let mut errors = vec![];
    for (side, camera) in [(&left, Camera::LEFT), (&right, Camera::RIGHT)] {
        for (center, side) in center.iter().zip(side) {
            let beside = side.pose.offset_m - center.pose.offset_m;
            errors.push((beside - camera.mount.position.x * center.pose.heading_rad.cos()).abs());
        }
    }
    errors.sort_by(f64::total_cmp);
    let share = |share: f64| errors[(errors.len() as f64 * share) as usize];
    println!("median {:.3}, 80 % {:.3}, 95 % {:.3}, worst {:.2} m", share(0.5), share(0.8), share(0.95), share(0.9999));
    assert!(share(0.5) <= 0.10 && share(0.95) <= 0.25);
}
