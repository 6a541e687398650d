//! A fingerprint that says whether two drives were the same.

use sha2::{Digest, Sha256};

use super::{Observer, ObserverError, bad_frames::too_many_bad_frames};
use crate::{
    hash::hex,
    protocol::{Answer, CameraImage},
    turn::{By, Turn},
};

/// Takes the fingerprint of a drive.
#[derive(Debug, Default)]
pub struct Fingerprint {
    hash: Sha256,
    frames: u64,
    bad_frames: u64,
    first_bad: Option<String>,
}

/// The outcome of a drive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveDigest {
    /// SHA-256 over all frames and commands in order: equal where two drives were the same.
    pub fingerprint: String,
    /// Frames shown to the driver.
    pub frames: u64,
    /// Frames among them that no pilot could use.
    pub bad_frames: u64,
    /// Why the first of those is one.
    pub first_bad: Option<String>,
}

impl DriveDigest {
    /// Of bad frames, if there were any: how many, and why the first is one. An error if they are so many that the drive says too
    /// little about its driver.
    pub fn bad_in_words(&self) -> Option<Result<String, String>> {
        let (bad, all) = (self.bad_frames, self.frames);
        if bad == 0 {
            return None;
        }
        let why = self.first_bad.as_deref().unwrap_or("no reason given");
        Some(match too_many_bad_frames(bad, all) {
            Some(too_many) => Err(format!("{too_many}; the first: {why}")),
            None => Ok(format!("{bad} of {all} frames were bad; the first: {why}")),
        })
    }
}

impl Fingerprint {
    /// The outcome of what was seen so far.
    pub fn finish(self) -> DriveDigest {
        let fingerprint = hex(&self.hash.finalize());
        DriveDigest { fingerprint, frames: self.frames, bad_frames: self.bad_frames, first_bad: self.first_bad }
    }
}

impl<W: ?Sized> Observer<W> for Fingerprint {
    fn turn(&mut self, _world: &W, turn: &Turn) -> Result<(), ObserverError> {
        if let Some(telemetry) = turn.telemetry() {
            self.frames += 1;
            if turn.trace.by == By::Safe {
                self.bad_frames += 1;
                self.first_bad = self.first_bad.take().or_else(|| turn.trace.bad_frame().map(str::to_owned));
            }
            if let CameraImage::Jpeg(jpeg) = &telemetry.image {
                self.hash.update(jpeg);
            }
        }
        if let Answer::Steer(command) = turn.answer {
            self.hash.update(command.steering.get().to_le_bytes());
            self.hash.update(command.throttle.get().to_le_bytes());
        }
        Ok(())
    }
}
