//! The driving loop and its observers.
//!
//! ```text
//! World ─▶ Observation ─▶ Driver ─▶ Answer ─▶ World
//!               └──────────┬──────────┘
//!                        Turn ─▶ observers: recorder, scorer, film, progress
//! ```
//! [`run`] pairs a world in this process with a driver, in lock step. The live bridge, whose worlds are at the other
//! end of a connection, makes its turns with the same [`turn`] and shows them to the same [`Observer`]s; its world is
//! [`Elsewhere`].

mod bad_frames;
mod fingerprint;

use std::time::Duration;

pub use bad_frames::too_many_bad_frames;
pub use fingerprint::{DriveDigest, Fingerprint};

use crate::{
    driver::Driver,
    protocol::{Observation, World},
    recording::{Item, Recorder, RunKind},
    turn::{EventRecord, Turn},
};

/// A world that reports events besides its telemetry, and can be asked to end.
pub trait Eventful: World {
    /// The events since the last call, in order of time.
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)>;

    /// What a run of this world is a recording of.
    fn kind(&self) -> RunKind {
        RunKind::Driven
    }

    /// Whether runs of this world contain its events: not if it plays the stock build, which sends none.
    fn is_recorded(&self) -> bool {
        true
    }

    /// A person at this world changes how it is driven, from the turn at this time on: returns what changed, as events.
    fn direct(&mut self, _at: Duration, _driver: &mut Driver) -> Vec<EventRecord> {
        vec![]
    }

    /// Ends the world: there is no next observation.
    fn interrupt(&mut self);
}

/// A world in another process: only its messages can be seen.
#[derive(Debug, Clone, Copy)]
pub struct Elsewhere;

/// Why an observer cannot continue. Anyone may write an observer, so its error may be of any type.
pub type ObserverError = Box<dyn std::error::Error + Send + Sync>;

/// Is shown a drive, in the order in which things happened. An observer that only reads turns works in any world `W`.
pub trait Observer<W: ?Sized> {
    /// The turn at this time is about to be driven. An observer that cannot keep up waits here, as a world in this
    /// process can stand still.
    fn ready(&mut self, _at: Duration) {}

    /// A turn, and the world as it was in it.
    ///
    /// # Errors
    /// Any failure that makes the rest of the drive useless to this observer.
    fn turn(&mut self, world: &W, turn: &Turn) -> Result<(), ObserverError>;

    /// An event between turns.
    fn event(&mut self, _at: Duration, _event: &EventRecord) {}

    /// An event of a world whose runs do not contain its events ([`Eventful::is_recorded`]): for scorers, not for
    /// recorders.
    fn untold(&mut self, _at: Duration, _event: &EventRecord) {}

    /// Whether the drive should end after this turn.
    fn has_seen_enough(&self) -> bool {
        false
    }

    /// The drive is over; nothing follows.
    fn end(&mut self) {}
}

/// What a run holds of a turn, in the order in which a reader joins it.
pub fn items(turn: &Turn) -> impl Iterator<Item = Item> {
    let parts = turn.telemetry().cloned().map(Item::Telemetry).into_iter();
    let parts = parts.chain(turn.trace.jpeg.clone().map(Item::Frame)).chain(turn.command().map(Item::Command));
    parts.chain(turn.trace.events.iter().cloned().map(Item::Event))
}

/// Records: waits for the disk if the world can wait, and hands over each part of a turn with the turn's time, in the
/// order in which a reader joins them.
impl<W: ?Sized> Observer<W> for &Recorder {
    fn ready(&mut self, _at: Duration) {
        self.wait_for_room();
    }

    fn turn(&mut self, _world: &W, turn: &Turn) -> Result<(), ObserverError> {
        items(turn).for_each(|item| self.record(turn.at(), item));
        Ok(())
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        self.record(at, Item::Event(event.clone()));
    }
}

/// Observes if present.
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

/// Ends the drive once this function returns true.
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
    /// The world cannot continue.
    #[error(transparent)]
    World(E),
    /// An observer cannot continue: a film cannot be written, for example.
    #[error(transparent)]
    Observer(ObserverError),
}

/// Drives one turn. Its answer is not sent yet: whoever sends it fills in how long that took.
pub fn turn(driver: &mut Driver, observation: Observation) -> Turn {
    let (answer, trace) = driver.drive(&observation);
    Turn { observation, answer, trace, latency: None }
}

/// Drives a world to its end and shows it to observers, in lock step: the world waits for each answer and each
/// observer. A world arms the pilot with [`EventRecord::PilotArmed`].
///
/// # Errors
/// [`TurnError`] if the world or an observer cannot continue. Observers are told of the end in any case.
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
        // The course comes before the first telemetry, and the events that led to a telemetry come before it.
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
        for event in world.direct(observation.at, driver) {
            observers.iter_mut().for_each(|observer| observer.event(observation.at, &event));
        }
        observers.iter_mut().for_each(|observer| observer.ready(observation.at));
        let mut turn = turn(driver, observation);
        // No connection lies between this driver and this world.
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
