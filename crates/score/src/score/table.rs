//! The scorecard for people, as a table.

use std::fmt;

use super::{DriveFound, Figure as F, Measure, RoadTried, STAGES, Scorecard, Unit, drives::SCRAP_M, guarded::BLIND};
use lapwing_core::words::count as counted;

/// Width of the names before the values.
const NAMES: usize = 17;
const UNKNOWN: &str = "not measurable: ";

/// Drives of a joined recording that are named one by one, of those that went anywhere.
const MOST_DRIVES: usize = 20;

impl Scorecard {
    /// A figure in words: its value with its uncertainty, or why there is none.
    pub fn words(&self, figure: F) -> String {
        match self.get(figure) {
            Measure::Unknown(why) => format!("{UNKNOWN}{why}"),
            Measure::Told(value) | Measure::Estimate { value, .. } => figure.unit().show(value) + &self.how(figure),
        }
    }

    /// The source of the lap times, likewise.
    pub(super) fn how_lap_times(&self) -> String {
        // No lap is so short that its time could be zero.
        let off = |off| estimated(self.lap_times_from, Unit::Seconds.show_off(f64::MAX, off));
        self.lap_times_off_s.map_or_else(String::new, off)
    }

    /// The source of an estimate, and how far off it may be; empty for a reported figure.
    pub(super) fn how(&self, figure: F) -> String {
        match self.get(figure) {
            Measure::Estimate { value, uncertainty, from } => {
                estimated(from, figure.unit().show_off(value, uncertainty))
            }
            Measure::Told(_) | Measure::Unknown(_) => String::new(),
        }
    }

    /// Figures that belong together, in one line, or why none of them is known.
    fn together(&self, parts: &[(F, &str)]) -> String {
        let known: Vec<_> = parts
            .iter()
            .filter(|(figure, _)| self.value(*figure).is_some())
            .map(|(figure, name)| format!("{}{name}", self.words(*figure)))
            .collect();
        if known.is_empty() { self.words(parts[0].0) } else { known.join(", ") }
    }

    /// Everything that is known, as names and words.
    pub fn known_rows(&self) -> Vec<(&'static str, String)> {
        self.rows().into_iter().filter(|(_, told)| !told.starts_with(UNKNOWN)).collect()
    }

    fn rows(&self) -> Vec<(&'static str, String)> {
        let count = |figure| self.value(figure).unwrap_or(0.0);
        let mut rows: Vec<(&str, String)> = vec![];
        if let Some(why) = &self.ended {
            rows.push(("ended", why.clone()));
        }
        match &self.drives[..] {
            [] => {}
            [drive] => rows.push(("road", drive.to_string())),
            drives => {
                rows.push(("drives", drives.len().to_string()));
                let long: Vec<_> = drives.iter().enumerate().filter(|(_, drive)| !drive.is_scrap()).collect();
                rows.extend(long.iter().take(MOST_DRIVES).map(|(i, drive)| {
                    let (first, last) = drive.moments;
                    let way = drive.way_m.map_or_else(String::new, |way_m| format!(", {way_m:.0} m"));
                    ("", format!("{}, telemetries {first} to {last}{way}: {drive}", i + 1))
                }));
                let more = long.len().saturating_sub(MOST_DRIVES);
                rows.extend((more > 0).then(|| ("", format!("and {more} more"))));
                let scraps = match drives.len() - long.len() {
                    0 => None,
                    1 => Some(format!("one of them is shorter than {SCRAP_M} m, which tells nothing")),
                    scraps if long.is_empty() => {
                        Some(format!("all {scraps} are shorter than {SCRAP_M} m, which tells nothing"))
                    }
                    scraps => Some(format!("{scraps} of them are shorter than {SCRAP_M} m, which tells nothing")),
                };
                rows.extend(scraps.map(|scraps| ("", scraps)));
            }
        }
        let laps = match (self.value(F::Laps), self.laps_asked) {
            (Some(laps), Some(asked)) if laps > f64::from(asked) => format!(", {laps:.0} laps, {asked} asked for"),
            (Some(laps), Some(asked)) => format!(", {laps:.0} of {}", counted(asked, "lap")),
            (Some(laps), None) => format!("; {}", counted(laps as u64, "lap")),
            (None, _) => String::new(),
        };
        match self.value(F::Completion) {
            // If the number of laps asked for is unknown.
            None if self.value(F::Laps).is_some() => {
                rows.push(("completion", self.words(F::Completion)));
                rows.push((F::Laps.label(), self.words(F::Laps)));
            }
            _ => rows.push(("completion", self.words(F::Completion) + &laps)),
        }
        if !self.lap_times_s.is_empty() {
            let times: Vec<_> = self.lap_times_s.iter().map(|t| format!("{t:.1}")).collect();
            rows.push(("lap times", format!("{} s{}", times.join(", "), self.how_lap_times())));
        }
        rows.push((
            "collisions",
            match count(F::Collisions) {
                n if n > 0.0 => {
                    let a_km =
                        self.value(F::CollisionsPerKm).map(|n| format!(", {}", F::CollisionsPerKm.unit().show(n)));
                    F::Collisions.unit().show(n) + &a_km.unwrap_or_default() + &self.how(F::Collisions)
                }
                _ => self.words(F::Collisions),
            },
        ));
        rows.push((
            "off the road",
            match self.value(F::OffRoads) {
                None => self.words(F::OffRoads),
                Some(0.0) => "never".into(),
                Some(n) => {
                    let times = times(n);
                    let how_long = self.value(F::OffRoadS).map(|_| format!(", {}", self.words(F::OffRoadS)));
                    times + &how_long.unwrap_or_default()
                }
            },
        ));
        for (name, figure) in [("stuck", F::Stuck), ("put back", F::Resets)] {
            if count(figure) > 0.0 {
                rows.push((name, times(count(figure)) + &self.how(figure)));
            }
        }
        let offsets =
            [(F::MeanCte, " mean"), (F::RmsCte, " RMS"), (F::P95Cte, " 95th percentile"), (F::MaxCte, " largest")];
        if let Some(share) = self.value(F::FromLane) {
            let [lane, path] = [share, 1.0 - share].map(|share| F::FromLane.unit().show(share));
            let from = format!("the lane's middle along {lane} of the way, the recorded path along {path}");
            rows.push(("measured from", from));
        }
        rows.push(("|cte|", self.together(&offsets)));
        if self.value(F::FromLane).is_some() || count(F::Interventions) > 0.0 {
            rows.push((
                "time off the line",
                self.together(&[(F::Beyond1m, " beyond 1 m"), (F::Beyond2m, " beyond 2 m")]),
            ));
        }
        rows.push((
            "autonomy",
            match self.value(F::Autonomy) {
                None => self.words(F::Autonomy),
                Some(_) => {
                    let (takeovers, put) = (count(F::Takeovers), count(F::Interventions));
                    let [takeovers, put] =
                        [(takeovers, "takeover"), (put, "intervention")].map(|(n, what)| counted(n as u64, what));
                    let a_km = self.value(F::InterventionsPerKm).filter(|n| *n > 0.0);
                    let a_km = a_km.map_or_else(String::new, |n| format!(", {}", F::InterventionsPerKm.unit().show(n)));
                    let why = format!(" ({takeovers}, {put}{a_km})");
                    let measured = if count(F::HumanS) > 0.0 {
                        format!(
                            "; {} measured, humans drove {}",
                            self.words(F::AutonomyMeasured),
                            self.words(F::HumanS)
                        )
                    } else {
                        String::new()
                    };
                    self.words(F::Autonomy) + &why + &measured
                }
            },
        ));
        if let Some(takeovers) = self.value(F::Takeovers).filter(|n| *n > 0.0) {
            let how_long = self.value(F::HumanS).map_or_else(String::new, |_| format!(", {}", self.words(F::HumanS)));
            rows.push((F::Takeovers.label(), F::Takeovers.unit().show(takeovers) + &how_long));
        }
        let scores = [(F::DrivingScore, " (CARLA 2.1)"), (F::DrivingScoreProduct, " (1.0)")];
        rows.push(("driving score", self.together(&scores)));
        let braking = [
            (F::BrakingAvoided, " avoided"),
            (F::Impact, " at impact"),
            (F::SpeedReduction, " taken off"),
            (F::MinTimeToCollision, " least time to collision"),
        ];
        if self.scenario.is_some() || self.value(F::MinTimeToCollision).is_some() {
            rows.push(("braking", self.together(&braking)));
        }
        if self.value(F::FalseAlarms).is_some() {
            rows.push((F::FalseAlarms.label(), self.words(F::FalseAlarms)));
        }
        if let Some(activations) = self.value(F::GuardActivations) {
            let braked = match activations {
                0.0 => "never braked".into(),
                n => format!(
                    "braked {}, {}, at most {}",
                    times(n),
                    self.words(F::GuardBrakedS),
                    self.words(F::GuardHardest)
                ),
            };
            rows.push(("guard", braked));
        } else if self.get(F::GuardActivations) == Measure::Unknown(BLIND) {
            rows.push(("guard", "could not watch".into()));
        }
        rows.push(("steering", self.together(&[(F::SteeringRate, " RMS"), (F::SteeringReversals, " reversed")])));
        if self.value(F::SteeringMae).is_some() {
            let errors = [(F::SteeringMae, " MAE"), (F::SteeringMse, " MSE"), (F::SteeringR, " r")];
            rows.push(("steering error", self.together(&errors)));
        }
        rows.push(("comfortable", self.words(F::Comfort)));
        rows.push(("jerk", self.together(&[(F::RmsJerk, " RMS")])));
        let time = self.value(F::TimeS).map(|_| format!(" in {}", self.words(F::TimeS)));
        let time = time.filter(|_| self.value(F::DistanceM).is_some());
        rows.push(("distance", self.words(F::DistanceM) + &time.unwrap_or_default()));
        rows.push(("speed", self.together(&[(F::MeanMph, " mean"), (F::MaxMph, " maximum")])));
        if self.value(F::SurvivalS).zip(self.value(F::TimeS)).is_some_and(|(survived, time)| survived < time) {
            rows.push((
                "first infraction",
                format!("after {}, {}", self.words(F::SurvivalS), self.words(F::SurvivalM)),
            ));
        }
        if self.value(F::FramesPerS).is_some() {
            rows.push((F::FramesPerS.label(), self.words(F::FramesPerS)));
        }
        for figure in [F::BadFrames, F::Kicks, F::MissedFrames] {
            if count(figure) > 0.0 {
                rows.push((figure.label(), self.words(figure)));
            }
        }
        rows.extend(self.latency_rows());
        rows.extend(self.notes.iter().map(|note| ("note", note.clone())));
        rows
    }

    /// How well each road explains each drive, a line each; nothing if no road had to be found. Of several drives, those that went
    /// nowhere are left out.
    pub fn roads_tried(&self) -> String {
        let several = self.drives.len() > 1;
        let of = |(i, drive): (usize, &DriveFound)| {
            let name = if several { format!("roads, drive {}", i + 1) } else { "roads tried".to_owned() };
            let by = format!("by how the car turned, told from its {}", drive.turned_by);
            let roads = drive.roads.iter().map(RoadTried::to_string);
            lines(
                &std::iter::once(by)
                    .chain(roads)
                    .zip(0..)
                    .map(|(told, i)| (if i == 0 { &name } else { "" }, told))
                    .collect::<Vec<_>>(),
            )
        };
        let told = self
            .drives
            .iter()
            .enumerate()
            .filter(|(_, drive)| !(drive.roads.is_empty() || several && drive.is_scrap()));
        told.map(of).collect::<Vec<_>>().join("\n")
    }

    fn latency_rows(&self) -> Option<(&'static str, String)> {
        // The others are in the JSON.
        let told =
            STAGES.into_iter().zip(self.latency).filter(|(stage, _)| ["forward", "answer", "ahead"].contains(stage));
        let stages: Vec<_> = told
            .filter_map(|(stage, latency)| {
                let latency = latency?;
                Some(format!("{stage} {:.2}, {:.2}, {:.2}", latency.p50, latency.p95, latency.p99))
            })
            .collect();
        (!stages.is_empty()).then(|| ("latency", format!("{} ms (p50, p95, p99)", stages.join("; "))))
    }
}

fn times(n: f64) -> String {
    if n == 1.0 { "once".into() } else { format!("{n:.0} times") }
}

fn estimated(from: &str, off: Option<String>) -> String {
    format!(" (estimated from {from}{})", off.map_or_else(String::new, |off| format!(", {off}")))
}

impl fmt::Display for Scorecard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&lines(&self.rows()))
    }
}

/// Names and words, under one another.
pub fn lines(rows: &[(&str, String)]) -> String {
    let rows: Vec<_> = rows.iter().map(|(name, told)| format!("  {name:<NAMES$} {told}")).collect();
    rows.join("\n")
}

/// Rows under one another, columns aligned: the first `left` of them to the left, the others to the right.
pub fn aligned(rows: &[Vec<String>], left: usize) -> String {
    let columns = rows.first().map_or(0, Vec::len);
    let width = |i: usize| rows.iter().map(|row| row[i].chars().count()).max().unwrap_or(0);
    let widths: Vec<_> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate();
        let cell = |(i, (cell, &width)): (usize, (&String, &usize))| {
            if i < left { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
        };
        cells.map(cell).collect::<Vec<_>>().join("  ")
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}
