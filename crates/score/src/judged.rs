//! A drive with a scorer among its observers.

use std::time::Duration;

use lapwing_core::{
    drive::{self, Observer},
    driver::Driver,
    protocol::{Answer, Observation},
    recording::{EventRecord, Eventful, Item, Recorder},
};

use crate::score::{Scorecard, Scorer};

impl Observer for Scorer {
    fn item(&mut self, at: Duration, item: &Item) {
        Scorer::item(self, at, item);
    }

    fn untold(&mut self, at: Duration, event: &EventRecord) {
        self.event(at, event);
    }
}

/// What became of a drive, and what it was worth.
#[derive(Debug)]
pub struct Drive {
    /// The judgement.
    pub card: Scorecard,
    /// SHA-256 over all frames and commands in order: equal where two drives were the same.
    pub fingerprint: String,
    /// Frames that were there to drive by.
    pub frames: u64,
    /// Those of them that no pilot could drive by.
    pub bad_frames: u64,
}

/// Drives a world to its end, recorded if wanted, and judges it. `watch` sees each turn before the world moves on.
///
/// # Errors
/// What keeps the world from going on.
pub fn run<W: Eventful>(
    world: &mut W,
    driver: &mut Driver,
    recorder: Option<&Recorder>,
    watch: impl FnMut(&mut W, &Observation, Answer) -> Result<(), Box<dyn std::error::Error + Send + Sync>>,
) -> Result<Drive, Box<dyn std::error::Error + Send + Sync>> {
    let mut scorer = Scorer::default().of_kind(world.kind());
    let mut recorder = recorder;
    let mut observers: Vec<&mut dyn Observer> = vec![&mut scorer];
    observers.extend(recorder.as_mut().map(|recorder| recorder as &mut dyn Observer));
    let drive::Driven { fingerprint, frames, bad_frames } = drive::run(world, driver, &mut observers, watch)?;
    Ok(Drive { card: scorer.finish(), fingerprint, frames, bad_frames })
}
