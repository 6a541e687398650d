//! A track as a road that drives are found on again.

use std::sync::Arc;

use glam::DVec3;

use crate::{
    odometry::{Look, Road},
    perception::Frame,
    simulator::{
        camera::{Camera, Renderer, Scenery},
        track::{Track, turn},
        world::{Setup, Simulation},
    },
};

/// Metres between headings.
const STEP_M: f64 = 0.5;

/// The road of a track by the line that one drives on it, with what one sees at its start.
pub fn known_road(track: Track) -> Road {
    let (name, length_m, file) = (track.file().name.clone(), track.driving_line_length(), track.file().start);
    let line = track.driving_line();
    let at = DVec3::new(file.x, file.y, file.z);
    let start = line.iter().min_by(|a, b| a.position.distance_squared(at).total_cmp(&b.position.distance_squared(at)));
    let start = start.map_or(0.0, |point| point.travelled);
    let steps = (length_m / STEP_M).ceil().max(2.0);
    let heading = |i: u32| {
        let travelled = length_m * f64::from(i) / steps;
        let after = line.partition_point(|point| point.travelled <= travelled);
        let before = line[after.saturating_sub(1)];
        // The last point's way to the first is a part of the road as well.
        let (next, until) = line.get(after).map_or((line[0], length_m), |point| (*point, point.travelled));
        let part = (travelled - before.travelled) / (until - before.travelled).max(1e-9);
        before.yaw + part.min(1.0) * turn(next.yaw - before.yaw)
    };
    let headings = (0..=steps as u32).map(heading).collect();
    let scenery = Arc::new(Scenery::new(&track));
    let setup = Setup::new(Arc::new(track), scenery.clone());
    let mut frame = Frame::default();
    let look = Simulation::new(setup).ok().and_then(|world| {
        world.draw(&mut Renderer::new(scenery), &Camera::CENTER, &mut frame);
        Look::of(&frame)
    });
    Road::new(name, start, length_m, look, headings)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::odometry::{Filter, Motion};

    #[test]
    fn who_drives_a_tracks_line_is_followed_to_its_end() {
        for name in ["jungle", "lake"] {
            let track = Track::named(name).unwrap();
            let line = track.driving_line().to_vec();
            let road = Arc::new(known_road(track));
            assert!(road.start.is_some());
            let first = line.iter().position(|point| point.travelled >= road.start_m).unwrap();
            let mut filter = Filter::at_start(road.clone(), rand_chacha::ChaCha8Rng::seed_from_u64(3));
            let mut driven = 0.0;
            for i in first..first + line.len() / 2 {
                let (here, next) = (line[i % line.len()], line[(i + 1) % line.len()]);
                let way_m = (next.position - here.position).with_y(0.0).length();
                filter.step(Motion { way_m, turn_rad: turn(next.yaw - here.yaw) });
                driven += way_m;
            }
            let place = filter.found().place;
            assert!((place.progress_m - driven).abs() < 8.0, "{name}: {place:?}, driven {driven}");
        }
    }
}
