//! A fingerprint that says whether two drives were the same.

use sha2::{Digest, Sha256};

use super::{Observer, ObserverError};
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
}

impl Fingerprint {
    /// The outcome of what was seen so far.
    pub fn finish(self) -> DriveDigest {
        let fingerprint = hex(&self.hash.finalize());
        DriveDigest { fingerprint, frames: self.frames, bad_frames: self.bad_frames }
    }
}

impl<W: ?Sized> Observer<W> for Fingerprint {
    fn turn(&mut self, _world: &W, turn: &Turn) -> Result<(), ObserverError> {
        if let Some(telemetry) = turn.telemetry() {
            self.frames += 1;
            self.bad_frames += u64::from(turn.trace.by == By::Safe);
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
