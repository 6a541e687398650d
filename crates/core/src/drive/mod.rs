//! A world driven in this process, without a socket.
//!
//! ```text
//! World ─▶ Observation ─▶ Driver ─▶ Answer ─▶ World
//!               └──────────┬──────────┘
//!                 observers: recorder, scorer
//! ```
//! A turn here and one of the live bridge are the same items ([`items`]), for whoever looks on.

mod turn;

use std::time::Duration;

use sha2::{Digest, Sha256};

pub use turn::items;

use crate::{
    driver::{By, Driver},
    hash::hex,
    protocol::{Answer, CameraImage, Observation, Sight},
    recording::{EventRecord, Eventful, Item, Recorder},
};

/// Is shown a drive, in the order in which things happened.
pub trait Observer {
    /// Another turn comes: an observer that cannot keep pace waits here, for this world can stand still.
    fn ready(&mut self) {}

    /// An item of the run.
    fn item(&mut self, at: Duration, item: &Item);

    /// What happened in a world whose runs do not hold what it says
    /// ([`Eventful::is_recorded`]): for who judges, not for who records.
    fn untold(&mut self, _at: Duration, _event: &EventRecord) {}
}

impl Observer for &Recorder {
    fn ready(&mut self) {
        self.wait_for_room();
    }

    fn item(&mut self, at: Duration, item: &Item) {
        self.record(at, item.clone());
    }
}

/// What became of a drive.
#[derive(Debug)]
pub struct Driven {
    /// SHA-256 over all frames and commands in order: equal where two drives were the same.
    pub fingerprint: String,
    /// Frames that were there to drive by.
    pub frames: u64,
    /// Those of them that no pilot could drive by.
    pub bad_frames: u64,
}

/// Drives a world to its end before observers. `watch` sees each turn before the world moves on.
///
/// # Errors
/// What keeps the world from going on.
pub fn run<W: Eventful>(
    world: &mut W,
    driver: &mut Driver,
    observers: &mut [&mut dyn Observer],
    mut watch: impl FnMut(&mut W, &Observation, Answer) -> Result<(), Box<dyn std::error::Error + Send + Sync>>,
) -> Result<Driven, Box<dyn std::error::Error + Send + Sync>> {
    let mut hash = Sha256::new();
    let (mut frames, mut bad_frames) = (0, 0);
    loop {
        let seen = world.observe()?;
        let is_recorded = world.is_recorded();
        // The course stands before the first telemetry, and what led to a telemetry before it.
        for (at, event) in world.take_events() {
            if is_recorded {
                let item = Item::Event(event);
                observers.iter_mut().for_each(|observer| observer.item(at, &item));
            } else {
                observers.iter_mut().for_each(|observer| observer.untold(at, &event));
            }
        }
        let Some(observation) = seen else { break };
        observers.iter_mut().for_each(|observer| observer.ready());
        let (answer, trace) = driver.drive(&observation);
        watch(world, &observation, answer)?;
        world.apply(answer);
        let at = observation.at;
        let telemetry = match observation.sight {
            Sight::Telemetry(telemetry) => {
                frames += 1;
                bad_frames += u64::from(trace.by == By::Safety);
                if let CameraImage::Jpeg(jpeg) = &telemetry.image {
                    hash.update(jpeg);
                }
                Some(telemetry)
            }
            Sight::HumanDrives | Sight::Unreadable(_) => None,
        };
        if let Answer::Steer(command) = answer {
            hash.update(command.steering.get().to_le_bytes());
            hash.update(command.throttle.get().to_le_bytes());
        }
        let took = trace.total;
        for item in items(telemetry, answer, trace, Some(took)) {
            observers.iter_mut().for_each(|observer| observer.item(at, &item));
        }
    }
    let fingerprint = hex(&hash.finalize());
    Ok(Driven { fingerprint, frames, bad_frames })
}
