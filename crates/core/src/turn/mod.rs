//! One turn of a drive and the records of it: the vocabulary that driver, recorder, scorer and other observers share.
//!
//! ```text
//! Observation ─▶ Driver ─▶ Answer + Trace ─▶ Turn ─▶ observers
//! ```
//! A turn is made once, by [`drive::turn`](crate::drive::turn), whether the world is in this process or at the other
//! end of a wire. Its own parts are recorded, by reference: the telemetry, the JPEG bytes, [`command`](Turn::command)
//! and the events of its trace. [`CommandRecord`] and [`EventRecord`] are what runs hold, as JSON.

mod command;
mod event;
mod told;

use std::time::Duration;

use bytes::Bytes;

pub use command::{By, CommandRecord};
pub use event::{EventRecord, LimitEdge, MeasuredLine};
pub use told::Severity;

use crate::{
    control::ThrottleOutput,
    protocol::{Answer, Observation, Sight, Telemetry},
};

/// What the driver reports about one answer.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// Who made the answer.
    pub by: By,
    /// The JPEG bytes as received, if the base64 could be read.
    pub jpeg: Option<Bytes>,
    /// The pilot's raw output, not clamped.
    pub prediction: Option<f64>,
    /// The speed controller's terms.
    pub throttle: Option<ThrottleOutput>,
    /// How much an emergency brake is due, as a guard sees it, on its own scale.
    pub brake_due: Option<f64>,
    /// Time of the guard, if one watched.
    pub guard: Option<Duration>,
    /// How far ahead of its picture the road was shown to the network.
    pub ahead: Duration,
    /// Time from base64 to pixels.
    pub decode: Duration,
    /// Time from pixels to the network's input.
    pub preprocess: Duration,
    /// Time of the forward pass.
    pub forward: Duration,
    /// Time of the whole answer.
    pub total: Duration,
    /// What happened along with it, in order: each an event in the run and a line in the log.
    pub events: Vec<EventRecord>,
}

impl Trace {
    /// Why the telemetry or picture could not be used, if it could not.
    pub fn bad_frame(&self) -> Option<&str> {
        self.events.iter().find_map(|event| match event {
            EventRecord::BadFrame { why, .. } => Some(why.as_str()),
            _ => None,
        })
    }
}

/// One turn of a drive: what was seen, what was answered, and how that came about.
#[derive(Debug, Clone)]
pub struct Turn {
    /// What was seen, and when.
    pub observation: Observation,
    /// What was answered.
    pub answer: Answer,
    /// What the driver reports about the answer.
    pub trace: Trace,
    /// From message in to answer out, once the answer is out; none for an answer that never went out.
    pub latency: Option<Duration>,
}

impl Turn {
    /// Time since the run began.
    pub fn at(&self) -> Duration {
        self.observation.at
    }

    /// What the simulator reported, if that could be read.
    pub fn telemetry(&self) -> Option<&Telemetry> {
        match &self.observation.sight {
            Sight::Telemetry(telemetry) => Some(telemetry),
            Sight::HumanDrives | Sight::Unreadable(_) => None,
        }
    }

    /// The command that went out, as a run holds it; none if a human drove or no answer was sent.
    pub fn command(&self) -> Option<CommandRecord> {
        let (Answer::Steer(command), Some(latency)) = (self.answer, self.latency) else { return None };
        let ns = |duration: Duration| duration.as_nanos().try_into().unwrap_or(u64::MAX);
        let trace = &self.trace;
        Some(CommandRecord {
            by: trace.by,
            steering: command.steering,
            throttle: command.throttle,
            prediction: trace.prediction,
            p: trace.throttle.map(|t| t.p),
            i: trace.throttle.map(|t| t.i),
            saturated: trace.throttle.is_some_and(|t| t.saturated),
            brake_due: trace.brake_due,
            ahead_ns: (trace.ahead > Duration::ZERO).then(|| ns(trace.ahead)),
            guard_ns: trace.guard.map(ns),
            decode_ns: ns(trace.decode),
            preprocess_ns: ns(trace.preprocess),
            forward_ns: ns(trace.forward),
            driver_ns: ns(trace.total),
            latency_ns: Some(ns(latency)),
        })
    }
}
