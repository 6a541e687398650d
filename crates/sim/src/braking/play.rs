//! A drive with a [`Human`] at the wheel.

use std::time::Duration;

use super::human::Human;
use crate::{
    track::Place,
    vehicle::Car,
    world::{Eyes, Simulation},
};
use lapwing_core::{
    drive::Eventful,
    perception::Frame,
    protocol::{Answer, CameraImage, Sight, World},
    turn::{By, EventRecord, Trace, Turn},
};

/// What a drive came to.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Played {
    /// Telemetries.
    pub frames: u64,
    /// When something was hit, in seconds of the run.
    pub hit_s: Option<f64>,
    /// When the driver's foot went down in an emergency, in seconds of the run.
    pub pressed_s: Option<f64>,
}

/// Something of a drive, in order.
pub enum Shown<'a> {
    /// A turn, and the world at it.
    Turn(&'a Turn, &'a Simulation),
    /// An event between turns, and when.
    Event(Duration, EventRecord),
}

/// Drives a world to its end, or until something is hit, and shows it. The brake in the telemetry is the driver's pedal, not the
/// throttle that it takes on the stock car.
///
/// # Errors
/// Those of whoever is shown it.
pub fn play<E>(
    world: &mut Simulation,
    human: &mut Human,
    mut show: impl FnMut(Shown<'_>) -> Result<(), E>,
) -> Result<Played, E> {
    let (mut frames, mut hit_s) = (0, None);
    let dt_s = world.setup().hz.recip();
    loop {
        let seen = match world.observe() {
            Ok(seen) => seen,
            Err(never) => match never {},
        };
        for (at, event) in world.take_events() {
            show(Shown::Event(at, event))?;
        }
        let Some(mut observation) = seen else { break };
        let mut trace = Trace { by: By::Human, ..Trace::default() };
        if let Sight::Telemetry(telemetry) = &mut observation.sight {
            telemetry.truth.brake = telemetry.truth.brake.map(|_| human.pedal());
            if let CameraImage::Jpeg(jpeg) = &telemetry.image {
                trace.jpeg = Some(jpeg.clone());
            }
        }
        frames += 1;
        hit_s = (world.judge().crashes() > 0).then(|| world.time_s());
        let answer = Answer::Steer(human.drive(world, dt_s));
        let turn = Turn { observation, answer, trace, latency: Some(Duration::ZERO) };
        show(Shown::Turn(&turn, world))?;
        if hit_s.is_some() {
            break;
        }
        world.apply(answer);
    }
    Ok(Played { frames, hit_s, pressed_s: human.pressed_s() })
}

/// Eyes that see nothing: for worlds that are driven by their truth alone, a hundred times as fast.
#[derive(Debug, Clone, Copy)]
pub struct Blind;

impl Eyes for Blind {
    fn see(&mut self, _: &Car, _: &Place, frame: &mut Frame) -> bool {
        frame.resize(1, 1);
        true
    }
}
