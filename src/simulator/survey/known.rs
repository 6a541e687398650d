//! A track as a road that drives are found on again.

use std::sync::Arc;

use glam::DVec3;

use crate::{
    odometry::{Look, Road},
    perception::Frame,
    simulator::{
        camera::{Camera, Renderer, Scenery},
        track::Track,
        world::{Setup, Simulation},
    },
};

/// The road of a track, with what one sees at its start.
pub fn known_road(track: Track) -> Road {
    let (name, length_m, file) = (track.file().name.clone(), track.length(), track.file().start);
    let start = track.locate(DVec3::new(file.x, file.y, file.z), None).station.s;
    let headings = track.stations().iter().chain(track.stations().first()).map(|station| station.yaw).collect();
    let scenery = Arc::new(Scenery::new(&track));
    let setup = Setup::new(Arc::new(track), scenery.clone());
    let mut frame = Frame::default();
    let look = Simulation::new(setup).ok().and_then(|world| {
        world.draw(&mut Renderer::new(scenery), &Camera::CENTER, &mut frame);
        Look::of(&frame)
    });
    Road::new(name, start, length_m, look, headings)
}
