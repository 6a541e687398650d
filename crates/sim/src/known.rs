//! A track as a known road, on which drives are located: the line to drive, and the view at its start.

use std::sync::Arc;

use glam::DVec3;
use lapwing_core::perception::{Frame, decode_jpeg};

use crate::{
    camera::{Camera, Renderer, Scenery},
    track::{Track, TrackError},
    world::{Setup, Simulation},
};

/// Metres between headings.
const STEP_M: f64 = 0.5;

/// Views at the starts of [`Track::NAMES`] in fair weather, stored because building a scenery takes a second. `cargo
/// test --release draws_the_starts -- --ignored` draws them again.
const STARTS: [&[u8]; 3] =
    [include_bytes!("starts/lake.jpg"), include_bytes!("starts/jungle.jpg"), include_bytes!("starts/mountain.jpg")];

/// The line to drive on a track.
#[derive(Debug, Clone)]
pub struct KnownRoad {
    /// What the track calls itself.
    pub name: String,
    /// Where drives begin, in metres along the line.
    pub start_m: f64,
    /// Length of a lap, in metres.
    pub length_m: f64,
    /// Headings in radians, clockwise, evenly spaced from 0 to the whole length, both ends included.
    pub headings: Vec<f64>,
    /// The view at the start.
    pub start: Frame,
}

impl KnownRoad {
    /// The known road of a track, named as for [`Track::open`].
    ///
    /// # Errors
    /// Those of [`Track::open`].
    pub fn of(name: &str) -> Result<Self, TrackError> {
        let track = Track::open(name)?;
        let (length_m, file) = (track.driving_line_length(), track.file().start);
        let line = track.driving_line();
        let at = DVec3::new(file.x, file.y, file.z);
        let start =
            line.iter().min_by(|a, b| a.position.distance_squared(at).total_cmp(&b.position.distance_squared(at)));
        let start_m = start.map_or(0.0, |point| point.travelled);
        let steps = (length_m / STEP_M).ceil().max(2.0);
        let heading = |i: u32| track.on_driving_line(length_m * f64::from(i) / steps).yaw;
        let headings = (0..=steps as u32).map(heading).collect();
        let name_of_its_own = track.file().name.clone();
        let mut seen = Frame::default();
        match Track::NAMES.iter().position(|shipped| *shipped == name) {
            Some(i) => decode_jpeg(STARTS[i], &mut seen).unwrap_or_default(),
            None => see_start(track, &mut seen),
        }
        Ok(Self { name: name_of_its_own, start_m, length_m, headings, start: seen })
    }
}

/// What the camera sees at a track's start.
pub fn see_start(track: Track, frame: &mut Frame) {
    let scenery = Arc::new(Scenery::new(&track));
    if let Ok(world) = Simulation::new(Setup::new(Arc::new(track), scenery.clone())) {
        world.draw(&mut Renderer::new(scenery), &Camera::CENTER, frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::encode_jpeg;
    use lapwing_core::motion::turn;

    #[test]
    fn a_road_is_as_long_as_its_line_and_is_headed_as_it_at_both_ends() {
        let road = KnownRoad::of("lake").unwrap();
        let track = Track::named("lake").unwrap();
        assert_eq!((road.name.as_str(), road.length_m), ("lake", track.driving_line_length()));
        let [first, .., last] = road.headings[..] else { panic!("{road:?}") };
        assert!(turn(last - first).abs() < 1e-3, "{first} and {last}");
        assert_eq!((road.start.width(), road.start.height()), (320, 160));
    }

    #[test]
    #[ignore = "writes the pictures that STARTS includes"]
    fn draws_the_starts() {
        for name in Track::NAMES {
            let mut frame = Frame::default();
            see_start(Track::named(name).unwrap(), &mut frame);
            std::fs::write(format!("src/starts/{name}.jpg"), encode_jpeg(&frame, 85)).unwrap();
        }
    }
}
