//! The loop that drives, and those who look on.
//!
//! ```text
//! World ─▶ Observation ─▶ Driver ─▶ Answer ─▶ World
//!               └──────────┬──────────┘
//!                        Turn ─▶ observers: recorder, scorer, film, progress
//! ```
//! [`run`] pairs a world in this process with a driver, in lock step. The live bridge, whose worlds are at the other end
//! of a wire, makes its turns by the same [`turn`] and shows them to the same [`Observer`]s; its world is [`Elsewhere`].

mod fingerprint;

use std::time::Duration;

pub use fingerprint::{DriveDigest, Fingerprint};

use crate::{
    driver::Driver,
    protocol::{Observation, World},
    recording::{Item, Recorder, RunKind},
    turn::{EventRecord, Turn},
};

/// A world that says what happens in it besides its telemetry, and can be asked to end.
pub trait Eventful: World {
    /// What has happened since the last call, in the order of time.
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)>;

    /// What a run of this world is a recording of.
    fn kind(&self) -> RunKind {
        RunKind::Driven
    }

    /// Whether a run of this world holds what it says: not where it plays one that says nothing.
    fn is_recorded(&self) -> bool {
        true
    }

    /// Somebody does not want to see more: there is no next observation.
    fn interrupt(&mut self);
}

/// A world in another process: there is nothing to be seen of it but its messages.
#[derive(Debug, Clone, Copy)]
pub struct Elsewhere;

/// Why an observer cannot look on any more. Observers are anybody's, and so are their errors.
pub type ObserverError = Box<dyn std::error::Error + Send + Sync>;

/// Is shown a drive, in the order in which things happened. Who only reads turns does so in any world `W`.
pub trait Observer<W: ?Sized> {
    /// A turn that is seen at this time is about to be driven: an observer that cannot keep pace waits here, for a world
    /// in this process can stand still.
    fn ready(&mut self, _at: Duration) {}

    /// A turn, and the world as it was in it.
    ///
    /// # Errors
    /// What makes the rest of the drive useless to whoever wanted this observer.
    fn turn(&mut self, world: &W, turn: &Turn) -> Result<(), ObserverError>;

    /// What happened between turns.
    fn event(&mut self, _at: Duration, _event: &EventRecord) {}

    /// What happened in a world whose runs do not hold what it says
    /// ([`Eventful::is_recorded`]): for who judges, not for who records.
    fn untold(&mut self, _at: Duration, _event: &EventRecord) {}

    /// Whether the drive is to end after this turn.
    fn has_seen_enough(&self) -> bool {
        false
    }

    /// The drive is over; nothing comes any more.
    fn end(&mut self) {}
}

/// Records: waits for the disk where the world can wait, and hands over each part of a turn with the turn's time, in the
/// order in which a reader joins them again.
impl<W: ?Sized> Observer<W> for &Recorder {
    fn ready(&mut self, _at: Duration) {
        self.wait_for_room();
    }

    fn turn(&mut self, _world: &W, turn: &Turn) -> Result<(), ObserverError> {
        let parts = turn.telemetry().cloned().map(Item::Telemetry).into_iter();
        let parts = parts.chain(turn.trace.jpeg.clone().map(Item::Frame)).chain(turn.command().map(Item::Command));
        let events = turn.trace.events.iter().cloned().map(Item::Event);
        parts.chain(events).for_each(|item| self.record(turn.at(), item));
        Ok(())
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        self.record(at, Item::Event(event.clone()));
    }
}

/// Looks on if it is there.
impl<W: ?Sized, O: Observer<W>> Observer<W> for Option<O> {
    fn ready(&mut self, at: Duration) {
        self.iter_mut().for_each(|observer| observer.ready(at));
    }

    fn turn(&mut self, world: &W, turn: &Turn) -> Result<(), ObserverError> {
        self.as_mut().map_or(Ok(()), |observer| observer.turn(world, turn))
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        self.iter_mut().for_each(|observer| observer.event(at, event));
    }

    fn untold(&mut self, at: Duration, event: &EventRecord) {
        self.iter_mut().for_each(|observer| observer.untold(at, event));
    }

    fn has_seen_enough(&self) -> bool {
        self.as_ref().is_some_and(Observer::has_seen_enough)
    }

    fn end(&mut self) {
        self.iter_mut().for_each(Observer::end);
    }
}

/// Looks at nothing, but ends the drive once this says so.
pub struct StopWhen<F>(pub F);

impl<W: ?Sized, F: Fn() -> bool> Observer<W> for StopWhen<F> {
    fn turn(&mut self, _world: &W, _turn: &Turn) -> Result<(), ObserverError> {
        Ok(())
    }

    fn has_seen_enough(&self) -> bool {
        self.0()
    }
}

/// Why a drive was broken off.
#[derive(Debug, thiserror::Error)]
pub enum TurnError<E> {
    /// The world cannot go on.
    #[error(transparent)]
    World(E),
    /// An observer cannot look on, such as a film that cannot be written.
    #[error(transparent)]
    Observer(ObserverError),
}

/// Drives one turn. Its answer is not out yet: anyone who sends it says how long that took.
pub fn turn(driver: &mut Driver, observation: Observation) -> Turn {
    let (answer, trace) = driver.drive(&observation);
    Turn { observation, answer, trace, latency: None }
}

/// Drives a world to its end before observers, in lock step: the world waits for each answer and each observer. A world
/// that says so ([`EventRecord::PilotArmed`]) arms the pilot.
///
/// # Errors
/// [`TurnError`]: what keeps the world or an observer from going on. Observers are told of the end in any case.
pub fn run<W: Eventful>(
    world: &mut W,
    driver: &mut Driver,
    observers: &mut [&mut dyn Observer<W>],
) -> Result<(), TurnError<W::Error>> {
    let ended = turns(world, driver, observers);
    observers.iter_mut().for_each(|observer| observer.end());
    ended
}

fn turns<W: Eventful>(
    world: &mut W,
    driver: &mut Driver,
    observers: &mut [&mut dyn Observer<W>],
) -> Result<(), TurnError<W::Error>> {
    loop {
        let seen = world.observe().map_err(TurnError::World)?;
        let is_recorded = world.is_recorded();
        // The course stands before the first telemetry, and what led to a telemetry before it.
        for (at, event) in world.take_events() {
            if event == EventRecord::PilotArmed {
                driver.arm();
            }
            observers.iter_mut().for_each(|observer| match is_recorded {
                true => observer.event(at, &event),
                false => observer.untold(at, &event),
            });
        }
        let Some(observation) = seen else { return Ok(()) };
        observers.iter_mut().for_each(|observer| observer.ready(observation.at));
        let mut turn = turn(driver, observation);
        // Nothing lies between this driver and this world.
        turn.latency = Some(turn.trace.total);
        for observer in observers.iter_mut() {
            observer.turn(world, &turn).map_err(TurnError::Observer)?;
        }
        if observers.iter().any(|observer| observer.has_seen_enough()) {
            world.interrupt();
        }
        world.apply(turn.answer);
    }
}

#[cfg(test)]
mod tests;
