//! A world driven in this process: driver, recorder and scorer around it, without a socket.
//!
//! ```text
//! World ─▶ Observation ─▶ Driver ─▶ Answer ─▶ World
//!               └──────────┬──────────┘
//!                      Recorder, Scorer
//! ```
//! A turn here and one of the live bridge are the same items ([`items`]), for the recorder and for the scorer.

mod turn;

use sha2::{Digest, Sha256};

pub use turn::items;

use crate::{
    driver::{By, Driver},
    protocol::{Answer, CameraImage, Observation, Sight},
    recording::{Eventful, Item, Recorder},
    score::{Scorecard, Scorer},
};

/// What became of a drive.
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

/// Drives a world to its end. `watch` sees each turn before the world moves on.
///
/// # Errors
/// What keeps the world from going on.
pub fn run<W: Eventful>(
    world: &mut W,
    driver: &mut Driver,
    recorder: Option<&Recorder>,
    mut watch: impl FnMut(&mut W, &Observation, Answer) -> Result<(), Box<dyn std::error::Error + Send + Sync>>,
) -> Result<Drive, Box<dyn std::error::Error + Send + Sync>> {
    let mut scorer = Scorer::default();
    let mut hash = Sha256::new();
    let (mut frames, mut bad_frames) = (0, 0);
    loop {
        let seen = world.observe()?;
        let events = world.take_events();
        // The course stands before the first telemetry, and what led to a telemetry before it.
        for (at, event) in events {
            scorer.event(at, &event);
            if let Some(recorder) = recorder.filter(|_| world.is_recorded()) {
                recorder.record(at, Item::Event(event));
            }
        }
        let Some(observation) = seen else { break };
        if let Some(recorder) = recorder {
            recorder.wait_for_room(); // this world can stand still
        }
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
            scorer.item(at, &item);
            if let Some(recorder) = recorder {
                recorder.record(at, item);
            }
        }
    }
    let fingerprint = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Drive { card: scorer.finish(), fingerprint, frames, bad_frames })
}
