//! One turn of a drive as the items of a run.

use std::time::Duration;

use crate::{
    driver::{By, Happening, Trace},
    protocol::{Answer, Command, Telemetry},
    recording::{self, CommandRecord, EventRecord, Item},
};

/// What was seen, what was answered and what happened, in the order in which a reader joins them again.
///
/// `latency` is the time from telemetry to answer; without one the answer never went out and is no item.
pub fn items(
    telemetry: Option<Telemetry>,
    answer: Answer,
    trace: Trace,
    latency: Option<Duration>,
) -> impl Iterator<Item = Item> {
    let jpeg = trace.jpeg.clone();
    let command = match (answer, latency) {
        (Answer::Steer(command), Some(latency)) => Some(record_of(command, &trace, latency)),
        _ => None,
    };
    let events = trace.happenings.into_iter().flat_map(events_of);
    let seen = telemetry.map(Item::Telemetry).into_iter().chain(jpeg.map(Item::Frame));
    seen.chain(command.map(Item::Command)).chain(events.map(Item::Event))
}

fn events_of(happening: Happening) -> Vec<EventRecord> {
    match happening {
        Happening::TakeoverBegan => vec![EventRecord::TakeoverBegan],
        Happening::TakeoverEnded { after, pilot_off } => {
            let off = EventRecord::PilotOff { why: "a human drove; the pilot waits to be armed".into() };
            let ended = EventRecord::TakeoverEnded { duration_s: after.as_secs_f64() };
            std::iter::once(ended).chain(pilot_off.then_some(off)).collect()
        }
        Happening::BadFrame { why, in_a_row } => vec![EventRecord::BadFrame { why, count_in_row: in_a_row }],
        Happening::BrakingToStandstill => vec![EventRecord::BrakingToStandstill],
    }
}

fn record_of(command: Command, trace: &Trace, latency: Duration) -> CommandRecord {
    let ns = |duration: Duration| duration.as_nanos().try_into().unwrap_or(u64::MAX);
    CommandRecord {
        by: match trace.by {
            By::Pilot => recording::By::Pilot,
            By::Human => recording::By::Human,
            By::Safety => recording::By::Safe,
            By::Nobody => recording::By::Off,
        },
        steering: command.steering,
        throttle: command.throttle,
        prediction: trace.prediction,
        p: trace.throttle.map(|t| t.p),
        i: trace.throttle.map(|t| t.i),
        saturated: trace.throttle.is_some_and(|t| t.saturated),
        decode_ns: ns(trace.decode),
        preprocess_ns: ns(trace.preprocess),
        forward_ns: ns(trace.forward),
        driver_ns: ns(trace.total),
        latency_ns: Some(ns(latency)),
    }
}
