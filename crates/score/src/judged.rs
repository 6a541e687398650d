//! A drive with a scorer among its observers.

use std::time::Duration;

use lapwing_core::{
    drive::{self, DriveDigest, Eventful, Fingerprint, Observer, ObserverError, TurnError},
    driver::Driver,
    turn::{EventRecord, Turn},
};

use crate::score::{Scorecard, Scorer};

/// Takes the parts of a turn in the order in which a run of it holds them.
impl<W: ?Sized> Observer<W> for Scorer {
    fn turn(&mut self, _world: &W, turn: &Turn) -> Result<(), ObserverError> {
        if let Some(telemetry) = turn.telemetry() {
            self.telemetry(turn.at(), telemetry);
        }
        if let Some(jpeg) = &turn.trace.jpeg {
            self.frame(jpeg);
        }
        if let Some(command) = turn.command() {
            self.command(&command);
        }
        turn.trace.events.iter().for_each(|event| self.event(turn.at(), event));
        Ok(())
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        Self::event(self, at, event);
    }

    fn untold(&mut self, at: Duration, event: &EventRecord) {
        Self::event(self, at, event);
    }
}

/// The outcome of a drive and its score.
#[derive(Debug)]
pub struct Judged {
    /// The judgement.
    pub card: Scorecard,
    /// Its fingerprint and how many frames were seen.
    pub driven: DriveDigest,
}

/// Drives a world to its end, shows it to these observers and a scorer, and judges it.
///
/// # Errors
/// [`TurnError`] if the world or an observer cannot continue.
pub fn run<W: Eventful>(
    world: &mut W,
    driver: &mut Driver,
    observers: &mut [&mut dyn Observer<W>],
) -> Result<Judged, TurnError<W::Error>> {
    let (mut scorer, mut fingerprint) = (Scorer::default().of_kind(world.kind()), Fingerprint::default());
    let mut all: Vec<&mut dyn Observer<W>> = vec![&mut scorer, &mut fingerprint];
    all.extend(observers.iter_mut().map(|observer| &mut **observer as &mut dyn Observer<W>));
    drive::run(world, driver, &mut all)?;
    Ok(Judged { card: scorer.finish(), driven: fingerprint.finish() })
}
