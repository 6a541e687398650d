//! A track as a known road, on which drives are located: the line to drive, and the view at its start.

use std::sync::Arc;

use glam::DVec3;
use lapwing_core::{
    motion::around,
    perception::{Frame, decode_jpeg},
};

use crate::{
    camera::{Camera, Renderer, Scenery},
    track::{Track, TrackError},
    world::{Setup, Simulation},
};

/// Metres between headings.
const STEP_M: f64 = 0.5;

/// Views at the starts of [`Track::NAMES`] in fair weather, along the road and the other way, stored because building a scenery
/// takes a second. `cargo test --release draws_the_starts -- --ignored` draws them again.
const STARTS: [[&[u8]; 2]; 3] = [
    [include_bytes!("starts/lake.jpg"), include_bytes!("starts/lake-back.jpg")],
    [include_bytes!("starts/jungle.jpg"), include_bytes!("starts/jungle-back.jpg")],
    [include_bytes!("starts/mountain.jpg"), include_bytes!("starts/mountain-back.jpg")],
];

/// A track, as those who drive it know it.
#[derive(Debug, Clone)]
pub struct KnownRoad {
    /// What the track calls itself.
    pub name: String,
    /// The line to drive.
    pub line: Line,
    /// The line to drive the other way round, and for each of its headings how far along the other one that is, in metres, without
    /// jumps. Where the track has a lane on the right, that is another line.
    pub back: (Line, Vec<f64>),
    /// The view at the start, along the road and the other way.
    pub starts: [Frame; 2],
}

/// A line to drive.
#[derive(Debug, Clone)]
pub struct Line {
    /// Where drives begin, in metres along the line.
    pub start_m: f64,
    /// Length of a lap, in metres.
    pub length_m: f64,
    /// Headings in radians, clockwise, evenly spaced from 0 to the whole length, both ends included.
    pub headings: Vec<f64>,
}

impl Line {
    fn of(track: &Track) -> Self {
        let (length_m, start) = (track.driving_line_length(), track.file().start);
        let start_m = travelled(track, DVec3::new(start.x, start.y, start.z));
        let headings = spaced(length_m).map(|at_m| track.on_driving_line(at_m).yaw).collect();
        Self { start_m, length_m, headings }
    }
}

/// Evenly spaced over a whole length, both ends included.
fn spaced(length_m: f64) -> impl Iterator<Item = f64> {
    let steps = (length_m / STEP_M).ceil().max(2.0);
    (0..=steps as u32).map(move |i| length_m * f64::from(i) / steps)
}

/// How far along its line to drive a track is nearest to a point, in metres.
fn travelled(track: &Track, point: DVec3) -> f64 {
    let line = track.driving_line();
    let nearest =
        line.iter().min_by(|a, b| a.position.distance_squared(point).total_cmp(&b.position.distance_squared(point)));
    nearest.map_or(0.0, |point| point.travelled)
}

impl KnownRoad {
    /// The known road of a track.
    ///
    /// # Errors
    /// Those of [`Track::reversed`].
    pub fn of(track: Track) -> Result<Self, TrackError> {
        let (line, other) = (Line::of(&track), track.reversed()?);
        let back = Line::of(&other);
        // Neighbouring places are far less than half a lap apart, so the shorter way around is the right one.
        let mut last = track.driving_line_length();
        let place = |at_m: f64| {
            let beside = travelled(&track, other.on_driving_line(at_m).position);
            last += around(beside - last, line.length_m);
            last
        };
        let places = spaced(back.length_m).map(place).collect();
        // No road of one's own may be called as one of those.
        let name = track.file().name.clone();
        let starts = match Track::NAMES.iter().position(|shipped| *shipped == name) {
            Some(i) => STARTS[i].map(|jpeg| {
                let mut frame = Frame::default();
                decode_jpeg(jpeg, &mut frame).unwrap_or_default();
                frame
            }),
            None => see_starts(track, other),
        };
        Ok(Self { name, line, back: (back, places), starts })
    }
}

/// What the camera sees at a track's start, and, in the same scenery, the other way.
pub fn see_starts(track: Track, reversed: Track) -> [Frame; 2] {
    let scenery = Arc::new(Scenery::new(&track));
    [track, reversed].map(|track| {
        let mut frame = Frame::default();
        if let Ok(world) = Simulation::new(Setup::new(Arc::new(track), scenery.clone())) {
            world.draw(&mut Renderer::new(scenery.clone()), &Camera::CENTER, &mut frame);
        }
        frame
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::encode_jpeg;
    use lapwing_core::motion::turn;

    #[test]
    fn a_road_is_as_long_as_its_line_and_is_headed_as_it_at_both_ends() {
        let road = KnownRoad::of(Track::named("lake").unwrap()).unwrap();
        let track = Track::named("lake").unwrap();
        assert_eq!((road.name.as_str(), road.line.length_m), ("lake", track.driving_line_length()));
        let [first, .., last] = road.line.headings[..] else { panic!("{road:?}") };
        assert!(turn(last - first).abs() < 1e-3, "{first} and {last}");
        assert_eq!(road.starts.map(|start| (start.width(), start.height())), [(320, 160); 2]);
    }

    #[test]
    fn the_way_back_is_that_of_the_lane_there_beside_the_same_places_of_the_road() {
        for name in Track::NAMES {
            let KnownRoad { line, back: (back, places), .. } = KnownRoad::of(Track::open(name).unwrap()).unwrap();
            let track = Track::named(name).unwrap();
            assert_eq!(places.len(), back.headings.len(), "{name}");
            let around_m = places[0] - places[places.len() - 1];
            assert!((around_m - line.length_m).abs() < 1.0, "{name}: {around_m} m around");
            for (heading, place) in back.headings.iter().zip(&places) {
                let against = turn(heading - track.on_driving_line(*place).yaw - std::f64::consts::PI);
                assert!(against.abs() < 0.5, "{name}, {place} m: {against} rad");
            }
            let other = track.reversed().unwrap();
            let step_m = back.length_m / (places.len() - 1) as f64;
            let apart = |(i, place): (usize, &f64)| {
                let there = other.on_driving_line(i as f64 * step_m).position;
                (there - track.on_driving_line(*place).position).with_y(0.0).length()
            };
            let apart_m = places.iter().enumerate().map(apart).sum::<f64>() / places.len() as f64;
            let lanes_m = 2.0 * track.file().driving_line_m;
            assert!((apart_m - lanes_m).abs() < 0.3, "{name}: {apart_m} m apart, lanes {lanes_m} m");
        }
    }

    #[test]
    #[ignore = "writes the pictures that STARTS includes"]
    fn draws_the_starts() {
        for name in Track::NAMES {
            let track = Track::named(name).unwrap();
            let back = track.reversed().unwrap();
            for (frame, way) in see_starts(track, back).into_iter().zip(["", "-back"]) {
                std::fs::write(format!("src/starts/{name}{way}.jpg"), encode_jpeg(&frame, 85)).unwrap();
            }
        }
    }
}
