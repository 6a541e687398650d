//! The driver: perception, pilot and controllers as one synchronous function.
//!
//! ```text
//! Observation ─▶ base64 ▶ JPEG ▶ Frame ▶ Pilot ▶ steering ─┐
//!      ├────────▶ speed ───────────────▶ SpeedController ──┴─▶ (Guard) ─▶ Answer + Trace
//!      └────────▶ human, bad frame ────▶ hand-over, safe answer ──┘
//! ```
//! A guard, if there is one, sees the same frame as the pilot and may brake in its place.
//!
//! No I/O, no thread, no clock but the one handed in. The live bridge, the offline replay, the tests and the benches
//! call [`Driver::drive`], so what is measured is what drives. It always answers: a frame that cannot be read or driven
//! by gets a safe command.

mod directed;
mod watch;

use std::time::Duration;

pub use self::directed::Hands;

use self::{directed::Directed, watch::Watch};
use crate::{
    config::{self, Takeover},
    control::{Handover, KnownSpeed, Release, SpeedController, Standstill},
    guard::Guard,
    perception::{self, Frame, ImageError},
    pilot::{InEffect, Pilot, PilotError, View},
    protocol::{Answer, CameraImage, Command, Observation, Sight, Telemetry},
    turn::{By, EventRecord, Trace},
    units::{Clock, Mph, Steering, Throttle},
};

/// After this many bad frames in a row the car is braked to a standstill.
pub const BAD_FRAMES_TO_BRAKE: u32 = 5;

/// An observation in, an answer and its trace out.
pub struct Driver {
    pilot: Box<dyn Pilot>,
    speed: SpeedController,
    handover: Handover,
    clock: Clock,
    frame: Frame,
    last: Command,
    /// The last speed reported.
    speed_told: Option<Mph>,
    bad: BadFrames,
    watch: Option<Watch>,
    directed: Directed,
}

/// How long the driver has been without a frame that it could use.
#[derive(Default)]
struct BadFrames {
    in_a_row: u32,
    standstill: Standstill,
}

/// Why a frame could not be used.
#[derive(Debug, thiserror::Error)]
enum Unusable {
    #[error("image: {0}")]
    Image(#[from] ImageError),
    #[error("pilot: {0}")]
    Pilot(#[from] PilotError),
}

impl Driver {
    /// A driver at rest.
    pub fn new(pilot: Box<dyn Pilot>, settings: &config::ControlSettings, clock: Clock) -> Self {
        Self {
            pilot,
            speed: directed::controller(settings),
            handover: Handover::new(settings.takeover == Takeover::Latch),
            clock,
            frame: Frame::default(),
            last: Command::default(),
            speed_told: None,
            bad: BadFrames::default(),
            watch: None,
            directed: Directed::by(settings.clone()),
        }
    }

    /// The same driver, watched over by this guard; by none if there is none.
    pub fn guarded(self, guard: Option<Box<dyn Guard>>) -> Self {
        Self { watch: guard.map(Watch::new), ..self }
    }

    /// Answers one observation.
    pub fn drive(&mut self, observation: &Observation) -> (Answer, Trace) {
        let began = (self.clock)();
        let mut trace = Trace::default();
        let at = observation.at;
        let answer = match &observation.sight {
            Sight::HumanDrives => {
                trace.events.extend(self.handover.human_drives(at).map(EventRecord::from));
                // Pilot and integral are held, not reset: they continue when the human lets go.
                self.bad = BadFrames::default();
                self.rest_guard(at, &mut trace);
                trace.by = By::Human;
                Answer::Manual
            }
            Sight::Telemetry(telemetry) => {
                self.speed_told = Some(telemetry.speed);
                match self.directed.by_hand {
                    Some(_) => trace.events.extend(self.handover.human_drives(at).map(EventRecord::from)),
                    None => self.human_let_go(at, &mut trace),
                }
                let command = match self.steer(at, telemetry, &mut trace) {
                    Ok(command) => {
                        self.bad = BadFrames::default();
                        command
                    }
                    Err(why) => self.safe(at, KnownSpeed::Now(telemetry.speed), &why.to_string(), &mut trace),
                };
                Answer::Steer(command)
            }
            // This does not mean that the human has let go.
            Sight::Unreadable(why) if self.handover.is_human() && self.directed.by_hand.is_none() => {
                trace.events.push(EventRecord::BadFrame { why: why.to_string(), count_in_row: 1 });
                trace.by = By::Human;
                Answer::Manual
            }
            Sight::Unreadable(why) => {
                Answer::Steer(self.safe(at, KnownSpeed::Last(self.speed_told), &why.to_string(), &mut trace))
            }
        };
        let answer = match answer {
            Answer::Steer(command) => {
                let command = self.braked(at, &observation.sight, command);
                Answer::Steer(self.stopped(at, &observation.sight, command))
            }
            other => other,
        };
        if let Answer::Steer(command) = answer {
            self.last = command;
        }
        trace.total = (self.clock)() - began;
        (answer, trace)
    }

    /// Whether a human drives, as far as last reported.
    pub fn human_drives(&self) -> bool {
        self.handover.is_human()
    }

    /// Back to rest, between runs.
    pub fn reset(&mut self) {
        self.pilot.reset();
        self.speed.reset();
        self.handover.reset();
        self.bad = BadFrames::default();
        self.last = Command::default();
        self.speed_told = None;
        self.directed.reset();
        if let Some(watch) = &mut self.watch {
            watch.reset();
        }
    }

    fn human_let_go(&mut self, at: Duration, trace: &mut Trace) {
        if let Some(change) = self.handover.command_asked(at) {
            trace.events.push(change.into());
            if self.handover.is_off() {
                trace.events.push(EventRecord::PilotOff { why: "a human drove; the pilot waits to be armed".into() });
            }
        }
    }

    /// The guard lets go and forgets what it saw: it is not its turn.
    fn rest_guard(&mut self, at: Duration, trace: &mut Trace) {
        if let Some(watch) = &mut self.watch {
            watch.rest(at, self.speed_told, Release::HandedOver, trace);
        }
    }

    /// The command with the guard's throttle, if it brakes.
    fn braked(&mut self, at: Duration, sight: &Sight, command: Command) -> Command {
        let Some(watch) = &mut self.watch else { return command };
        let speed = known_speed(sight, self.speed_told);
        watch.throttle(at, speed).map_or(command, |throttle| Command { throttle, ..command })
    }

    /// Answers a good frame.
    fn steer(&mut self, at: Duration, telemetry: &Telemetry, trace: &mut Trace) -> Result<Command, Unusable> {
        let began = (self.clock)();
        let jpeg = match &telemetry.image {
            CameraImage::Jpeg(jpeg) => jpeg.clone(),
            CameraImage::Base64(text) => perception::decode_base64(text)?,
        };
        trace.jpeg = Some(jpeg.clone());
        if self.handover.is_off() {
            self.rest_guard(at, trace);
            trace.by = By::Off;
            return Ok(Command::default()); // wheels straight, the car rolls out
        }
        if let Some(command) = self.directed.by_hand {
            self.rest_guard(at, trace);
            trace.by = By::Human;
            return Ok(command);
        }
        if self.pilot.needs_picture() || self.watch.as_ref().is_some_and(Watch::needs_picture) {
            perception::decode_jpeg(&jpeg, &mut self.frame)?;
        }
        trace.decode = (self.clock)() - began;
        if let Some(watch) = &mut self.watch {
            watch.look(at, &self.frame, telemetry, self.clock, trace);
        }
        let in_effect = self.settings().compensate_latency.then_some(InEffect { at, steering: telemetry.steering });
        let view = View { frame: &self.frame, speed: telemetry.speed, path: &telemetry.truth.path, in_effect };
        let prediction = self.pilot.steer(&view)?;
        trace.ahead = prediction.ahead;
        trace.preprocess = prediction.preprocess;
        trace.forward = prediction.forward;
        trace.prediction = Some(prediction.steering);
        let steering = Steering::saturating(prediction.steering);
        let output = self.speed.update(steering, telemetry.speed, prediction.speed_limit);
        trace.throttle = Some(output);
        trace.by = By::Pilot;
        Ok(Command { steering, throttle: output.throttle })
    }

    /// Answers a bad one: keep the last steering and coast, and stop if it stays bad.
    fn safe(&mut self, at: Duration, speed: KnownSpeed, why: &str, trace: &mut Trace) -> Command {
        trace.by = By::Safe;
        self.bad.in_a_row += 1;
        let count_in_row = self.bad.in_a_row;
        trace.events.push(EventRecord::BadFrame { why: why.to_owned(), count_in_row });
        if count_in_row == BAD_FRAMES_TO_BRAKE {
            trace.events.push(EventRecord::BrakingToStandstill);
        }
        let throttle =
            if count_in_row < BAD_FRAMES_TO_BRAKE { Throttle::ZERO } else { self.bad.standstill.update(at, speed) };
        Command { steering: self.last.steering, throttle }
    }
}

fn known_speed(sight: &Sight, told: Option<Mph>) -> KnownSpeed {
    match sight {
        Sight::Telemetry(telemetry) => KnownSpeed::Now(telemetry.speed),
        Sight::HumanDrives | Sight::Unreadable(_) => KnownSpeed::Last(told),
    }
}
