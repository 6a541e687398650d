//! Events in words, for pages and viewers.

use super::{EventRecord, LimitEdge, MeasuredLine};
use crate::{
    control::{Release, TIME_TO_COLLISION},
    words::count as counted,
};

/// How much an event matters to a person who watches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// It belongs to the drive.
    Info,
    /// It should not happen in a good drive.
    Warning,
    /// The drive, or what is judged of it, has failed.
    Error,
}

impl EventRecord {
    /// Its kind, as in runs: `bad-frame`.
    pub fn kind(&self) -> String {
        let value = serde_json::to_value(self).ok();
        value.and_then(|value| Some(value.get("kind")?.as_str()?.to_owned())).unwrap_or_default()
    }

    /// How much it matters.
    pub fn severity(&self) -> Severity {
        match self {
            Self::Collision { .. } | Self::BrakingToStandstill | Self::EmergencyStop => Severity::Error,
            Self::TakeoverBegan
            | Self::BadFrame { .. }
            | Self::GuardBrakes { .. }
            | Self::FramesNotRecorded { .. }
            | Self::PilotOff { .. }
            | Self::OffRoad { .. }
            | Self::Stuck
            | Self::WrongWay
            | Self::Reset { .. } => Severity::Warning,
            Self::TakeoverEnded { .. }
            | Self::GuardReleases { .. }
            | Self::Break { .. }
            | Self::Kick
            | Self::PilotArmed
            | Self::SpeedSet { .. }
            | Self::SpeedLawSet { .. }
            | Self::PilotSet { .. }
            | Self::Simulator { .. }
            | Self::Course { .. }
            | Self::Lap { .. }
            | Self::MeasuredFrom { .. }
            | Self::BackOnRoad { .. }
            | Self::Moving
            | Self::RightWay
            | Self::Note { .. }
            | Self::RunEnded { .. } => Severity::Info,
        }
    }

    /// A guard's value, or a limit of it, as people read it: seconds of the one that brakes by the time to collision, whose own
    /// scale is its inverse; three decimals of any other.
    pub fn guard_value(guard: &str, value: f64) -> String {
        if guard == TIME_TO_COLLISION { format!("{:.2} s", value.recip()) } else { format!("{value:.3}") }
    }

    /// By which value a guard brakes, and where an emergency begins: `time to collision 1.30 s, brakes at 1.40 s or less`,
    /// `brake-live: 0.810, from 0.725 on`.
    pub fn guard_words(guard: &str, value: f64, fires: f64) -> String {
        let (value, fires) = (Self::guard_value(guard, value), Self::guard_value(guard, fires));
        match guard == TIME_TO_COLLISION {
            true => format!("{guard} {value}, brakes at {fires} or less"),
            false => format!("{guard}: {value}, from {fires} on"),
        }
    }

    /// What it says to people; none if a page has no use for it.
    pub fn in_words(&self) -> Option<String> {
        Some(match self {
            Self::TakeoverBegan => "a human took the wheel".into(),
            Self::TakeoverEnded { duration_s } => format!("the human gave the wheel back after {duration_s:.1} s"),
            Self::BadFrame { why, .. } => format!("bad frame: {why}"),
            Self::BrakingToStandstill => "too many bad frames: braking to a standstill".into(),
            Self::GuardBrakes { guard, value, fires, speed_mph } => {
                format!("emergency brake at {speed_mph:.1} mph ({})", Self::guard_words(guard, *value, *fires))
            }
            Self::GuardReleases { after_s, why, speed_mph } => {
                let why = match why {
                    Release::Calm => "the danger is past",
                    Release::Stood => "the car has stood for a while",
                    Release::HandedOver => "someone else is driving",
                };
                let at = speed_mph.map_or_else(String::new, |mph| format!(" at {mph:.1} mph"));
                format!("the emergency brake releases after {after_s:.1} s{at}: {why}")
            }
            Self::FramesNotRecorded { count } => format!("{} not recorded", counted(*count, "picture")),
            Self::PilotOff { why } => format!("the pilot was switched off: {why}"),
            Self::PilotArmed => "the pilot was switched on".into(),
            Self::EmergencyStop => "emergency stop".into(),
            Self::SpeedSet { mph } => format!("set speed {mph} mph"),
            Self::SpeedLawSet { law } => format!("speed law {law}"),
            Self::PilotSet { name, .. } => format!("pilot {name}"),
            Self::Break { .. } => "what comes next does not continue from what came before".into(),
            Self::Lap { number, time_s } => format!("lap {number} in {time_s:.1} s"),
            Self::Collision { with, speed_mph, .. } => format!("collision with {with} at {speed_mph:.1} mph"),
            Self::MeasuredFrom { line, edge, left_m, right_m } => {
                let line = match line {
                    MeasuredLine::Lane => "the lane's middle",
                    MeasuredLine::RecordedPath => "the recorded path",
                };
                let edge = match edge {
                    LimitEdge::Road => "the road's edge",
                    LimitEdge::Metres => "the limit",
                };
                format!(
                    "offsets are measured from {line}; {edge} is {:.1} m to the left, {right_m:.1} m to the right",
                    -left_m
                )
            }
            Self::OffRoad { offset_m } => format!("out of bounds, {:.1} m from the middle", offset_m.abs()),
            Self::BackOnRoad { after_s } => format!("back in bounds after {after_s:.1} s"),
            Self::Stuck => "stuck".into(),
            Self::Moving => "moving again".into(),
            Self::WrongWay => "driving the wrong way".into(),
            Self::RightWay => "driving the right way again".into(),
            Self::Reset { waypoint } => format!("put back on the road at waypoint {waypoint}"),
            Self::Note { text } => text.clone(),
            Self::RunEnded { why } => format!("the run ended: {why}"),
            Self::Kick | Self::Simulator { .. } | Self::Course { .. } => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_to_collision_is_told_in_seconds_and_a_networks_value_as_it_is() {
        let words = |guard: &str, value: f64, fires: f64| {
            let brakes = EventRecord::GuardBrakes { guard: guard.into(), value, fires, speed_mph: 12.0 };
            brakes.in_words().unwrap()
        };
        assert_eq!(
            words(TIME_TO_COLLISION, 1.3_f64.recip(), 1.4_f64.recip()),
            "emergency brake at 12.0 mph (time to collision 1.30 s, brakes at 1.40 s or less)"
        );
        assert_eq!(words("brake-live", 0.81, 0.725), "emergency brake at 12.0 mph (brake-live: 0.810, from 0.725 on)");
    }
}
