//! The drives of a run that reports no position: on which road each was, as far as that is found.

use std::{fmt, sync::Arc};

use serde::Serialize;

use super::Scorecard;
use crate::odometry::words;

/// A shorter drive went nowhere, in metres: it is what is left between rows that are out of order, or a car that stands.
pub(super) const SCRAP_M: f64 = 5.0;

/// How a car turned between two moments of a recording, by their pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turned {
    /// The earlier of the two telemetries, counted over the recording.
    pub after: usize,
    /// The later one.
    pub to: usize,
    /// Radians turned in between, clockwise.
    pub turn_rad: f64,
}

/// Looks at a recording's pictures, if anybody asks: in the order of the recording, how the car turned between them.
#[derive(Clone)]
pub(super) struct Sight(pub Arc<dyn Fn() -> Result<Vec<Turned>, String> + Send + Sync>);

impl fmt::Debug for Sight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Sight")
    }
}

/// One drive: all of a run, unless several were joined in it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveFound {
    /// Its first and its last telemetry, counted over the run from 0.
    pub moments: (usize, usize),
    /// Metres driven, by speed and time; `None` if its times are assumed.
    pub way_m: Option<f64>,
    /// What its turning was told from: `steering`, or `pictures` where the steering did not tell the road well enough.
    pub turned_by: &'static str,
    /// Where it was; absent if that is unknown.
    #[serde(flatten)]
    pub on: Option<OnRoad>,
    /// Why its road is unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown: Option<String>,
    /// All roads that were tried, each both ways round, the best first.
    pub roads: Vec<RoadTried>,
}

impl DriveFound {
    /// Whether it went nowhere, and so tells nothing.
    pub(super) fn is_scrap(&self) -> bool {
        self.way_m.is_some_and(|way_m| way_m < SCRAP_M)
    }
}

/// The road that a drive was on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OnRoad {
    /// Its name.
    pub track: String,
    /// Whether it was driven against the track's direction.
    pub reversed: bool,
    /// Whether a lap turns to the right, this way round.
    pub clockwise: bool,
    /// Laps driven, with what was driven of the last.
    pub laps: f64,
    /// How far off that may be.
    pub laps_uncertainty: f64,
}

/// How well a road explains a drive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RoadTried {
    /// Its name.
    pub track: String,
    /// Whether it was tried against the track's direction.
    pub reversed: bool,
    /// The log likelihood of what was driven, for each 10 m; 0 is a drive that is always in the road's middle.
    pub fit: f64,
    /// By how much the drive is less likely than on the best road, as a log likelihood over all of it.
    pub behind: f64,
    /// Whether that is well enough for the road to be the one.
    pub explains: bool,
    /// Whether it explains the drive about as well as the best.
    #[serde(skip)]
    pub is_near: bool,
}

impl fmt::Display for DriveFound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(on) = &self.on else {
            let why = self.unknown.as_deref().unwrap_or("it was not looked for");
            return write!(f, "unknown: {why}");
        };
        let round = if on.clockwise { "clockwise" } else { "anticlockwise" };
        let off = on.laps_uncertainty;
        // Two digits of how far off it may be, and at least one.
        let digits = if off < 0.095 { 3 } else { 2 };
        write!(f, "{}, {round}, {:.digits$} \u{b1} {off:.digits$} laps", words(&on.track, on.reversed), on.laps)
    }
}

impl fmt::Display for RoadTried {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = match (self.explains, self.is_near) {
            (false, _) => "does not explain the drive",
            (true, true) => "explains it best, or about as well",
            (true, false) => "explains it worse than another",
        };
        let Self { fit, behind, .. } = self;
        write!(f, "{}: {fit:.2} each 10 m, {behind:.0} behind: {verdict}", words(&self.track, self.reversed))
    }
}

impl Scorecard {
    /// The track, and the way round if it was not driven in its own direction.
    pub fn road(&self) -> Option<String> {
        let track = self.track.as_ref()?;
        let mut ways = self.drives.iter().filter_map(|drive| drive.on.as_ref()).map(|on| on.reversed);
        let first = ways.next().unwrap_or(false);
        Some(if ways.all(|way| way == first) { words(track, first) } else { format!("{track}, both ways round") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_says_its_road_the_way_round_and_its_laps_or_why_not() {
        let on = OnRoad { track: "lake".into(), reversed: true, clockwise: true, laps: 3.31, laps_uncertainty: 0.012 };
        let tried = |fit, behind, explains| RoadTried {
            track: "lake".into(),
            reversed: false,
            fit,
            behind,
            explains,
            is_near: behind < 5.0,
        };
        let roads = vec![tried(-0.5, 0.0, true), tried(-1.5, 60.0, true), tried(-3.0, 200.0, false)];
        let known =
            DriveFound { moments: (0, 9), way_m: Some(9.0), turned_by: "steering", on: Some(on), unknown: None, roads };
        assert_eq!(known.to_string(), "lake, the other way round, clockwise, 3.310 \u{b1} 0.012 laps");
        let said: Vec<String> = known.roads.iter().map(ToString::to_string).collect();
        assert_eq!(said[0], "lake: -0.50 each 10 m, 0 behind: explains it best, or about as well");
        assert_eq!(said[1], "lake: -1.50 each 10 m, 60 behind: explains it worse than another");
        assert_eq!(said[2], "lake: -3.00 each 10 m, 200 behind: does not explain the drive");
        let json = serde_json::to_value(&known).unwrap();
        assert_eq!((json["reversed"].as_bool(), json["laps"].as_f64()), (Some(true), Some(3.31)));
        let unknown = DriveFound { on: None, unknown: Some("no road is known".into()), ..known };
        assert_eq!(unknown.to_string(), "unknown: no road is known");
    }
}
