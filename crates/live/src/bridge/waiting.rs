//! Before a drive: the model is still loading, or the simulator is not identified yet. The car may arrive at any speed,
//! so it is braked to a standstill.

use std::time::Instant;

use lapwing_core::{
    control::{KnownSpeed, Standstill},
    protocol::{Answer, Command, Sight},
    units::{Mph, Steering},
};

/// What is known about a waiting car.
pub(super) struct Waiting {
    since: Instant,
    human_since: Option<Instant>,
    standstill: Standstill,
    /// The last speed reported.
    speed_told: Option<Mph>,
    /// The steering with which it arrived. Not what it reports now: term 2 adds a bias to the steering that it is sent.
    steering: Option<Steering>,
}

impl Waiting {
    pub fn new(now: Instant) -> Self {
        Self { since: now, human_since: None, standstill: Standstill::default(), speed_told: None, steering: None }
    }

    /// Since when a human has been driving, as far as is known: until the simulator is identified, it may just as well
    /// be waiting to be started.
    pub fn human_since(&self) -> Option<Instant> {
        self.human_since
    }

    /// The answer to the simulator meanwhile.
    pub fn answer(&mut self, now: Instant, sight: &Sight) -> Answer {
        let speed = match sight {
            Sight::HumanDrives => {
                self.human_since.get_or_insert(now);
                self.standstill = Standstill::default();
                return Answer::Manual;
            }
            Sight::Telemetry(telemetry) => {
                self.human_since = None;
                self.speed_told = Some(telemetry.speed);
                self.steering.get_or_insert(telemetry.steering.steering());
                KnownSpeed::Now(telemetry.speed)
            }
            // This does not mean that the human has let go.
            Sight::Unreadable(_) if self.human_since.is_some() => return Answer::Manual,
            Sight::Unreadable(_) => KnownSpeed::Last(self.speed_told),
        };
        let at = now.saturating_duration_since(self.since);
        Answer::Steer(Command {
            steering: self.steering.unwrap_or(Steering::ZERO),
            throttle: self.standstill.update(at, speed),
        })
    }
}
