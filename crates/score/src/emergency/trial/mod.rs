//! What a guard is worth in the closed loop: drives without and with it, counted.
//!
//! | figure | is |
//! |---|---|
//! | hit | drives in which something is hit, of all |
//! | avoidable | drives with a hit that a full brake would have avoided from the moment at which the hazard could be seen |
//! | avoided | drives without a hit with the guard, of the avoidable ones |
//! | impact | how fast the two met, the mean over the drives with a hit |
//! | reduction | by how much the car was slower, at the impact or at its slowest: the mean over all drives |
//! | activations | how often the guard braked where it should not, and how hard |

mod page;

use std::fmt;

use serde::Serialize;

use lapwing_core::{turn::EventRecord, words::count};

pub use page::{Film, render};

/// A drive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialDrive {
    /// What was played.
    pub case: String,
    /// Whether something is to be braked for.
    pub hazard: bool,
    /// In which layer.
    pub layer: String,
    /// On which road.
    pub track: String,
    /// How fast the car was to go, mph.
    pub speed_mph: f64,
    /// The drive's own seed.
    pub seed: u64,
    /// Laps, where they are driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub laps: Option<u32>,
    /// With nobody who brakes for hazards.
    pub without: TrialOutcome,
    /// Whether a full brake avoids the hit, from the moment at which the hazard can be seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub avoidable: Option<bool>,
    /// With the guard.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub with: Option<TrialOutcome>,
}

/// What a drive came to.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct TrialOutcome {
    /// How fast the two met, mph, if something was hit.
    pub impact_mph: Option<f64>,
    /// By how much the car was slower, mph.
    pub reduction_mph: f64,
    /// How often the guard braked.
    pub activations: u32,
    /// For how long in all, in seconds.
    pub braked_s: f64,
    /// The hardest deceleration while it did, in g.
    pub hardest_g: f64,
    /// How long the drive was, in seconds.
    pub time_s: f64,
}

/// A row of hazards: a case at a speed, or all cases of a group.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HazardRow {
    /// The case, or the layer.
    pub what: String,
    /// The speed; none over all of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_mph: Option<f64>,
    /// Drives.
    pub drives: usize,
    /// Of these, with a hit if nobody brakes.
    pub hit_without: usize,
    /// Of those, avoidable.
    pub avoidable: usize,
    /// With a hit in spite of the guard; none without a guard.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hit_with: Option<usize>,
    /// Avoided by the guard, of the avoidable ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub avoided: Option<usize>,
    /// Mean impact speed over the drives with a hit, mph: without the guard, and with it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub impact_without_mph: Option<f64>,
    /// The same with the guard.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub impact_with_mph: Option<f64>,
    /// Mean speed reduction with the guard, mph.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reduction_mph: Option<f64>,
    /// The same without the guard: the pilot does not brake for hazards, but slows down for bends.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reduction_without_mph: Option<f64>,
}

/// A row of harmless drives.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HarmlessRow {
    /// The case, or the laps of a road.
    pub what: String,
    /// Drives.
    pub drives: usize,
    /// Hours driven with the guard, or without it if there is none.
    pub hours: f64,
    /// Drives in which something was hit, without the guard.
    pub hit_without: usize,
    /// How often the guard braked; none without a guard.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub activations: Option<u32>,
    /// The hardest deceleration then, in g.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hardest_g: Option<f64>,
}

/// A guard that is tried.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialGuard {
    /// What it is and where it comes from.
    #[serde(rename = "guard")]
    pub name: String,
    /// From which value on it brakes, on its own scale.
    pub threshold: f64,
    /// SHA-256 of its file in lower-case hexadecimal, if it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// The result of a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialResult {
    /// The guard, if there is one.
    #[serde(flatten)]
    pub guard: Option<TrialGuard>,
    /// The part of the data whose roads, looks and weather the trial used.
    pub part: String,
    /// How many drives were planned.
    pub planned: usize,
    /// Whether it ended before all of them were driven.
    pub interrupted: bool,
    /// Each hazard at each speed.
    pub hazards: Vec<HazardRow>,
    /// Each hazard over all speeds.
    pub by_hazard: Vec<HazardRow>,
    /// Each layer over all hazards and speeds.
    pub by_layer: Vec<HazardRow>,
    /// What is harmless.
    pub harmless: Vec<HarmlessRow>,
    /// Every drive.
    pub drives: Vec<TrialDrive>,
}

impl TrialResult {
    /// Counts drives in one part's roads, looks and weather. They keep their order; it is as if no others had been planned.
    pub fn of(guard: Option<TrialGuard>, part: &str, drives: Vec<TrialDrive>) -> Self {
        let (hazards, harmless): (Vec<_>, Vec<_>) = drives.iter().partition(|drive| drive.hazard);
        let by = |key: &dyn Fn(&TrialDrive) -> (String, Option<u64>)| {
            grouped(&hazards, key)
                .into_iter()
                .map(|((what, mph), of)| HazardRow::of(what, mph.map(f64::from_bits), &of))
                .collect()
        };
        let named = |drive: &TrialDrive| {
            drive.laps.map_or(drive.case.clone(), |laps| format!("{} of {}", count(laps, "lap"), drive.track))
        };
        let rows = grouped(&harmless, &|drive| (named(drive), None));
        Self {
            guard,
            part: part.to_owned(),
            planned: drives.len(),
            interrupted: false,
            hazards: by(&|drive| (drive.case.clone(), Some(drive.speed_mph.to_bits()))),
            by_hazard: by(&|drive| (drive.case.clone(), None)),
            by_layer: by(&|drive| (drive.layer.clone(), None)),
            harmless: rows.into_iter().map(|((what, _), of)| HarmlessRow::of(what, &of)).collect(),
            drives,
        }
    }

    /// The guard and from which value on it brakes, in words.
    fn guarded_by(&self) -> String {
        self.guard.as_ref().map_or("none".into(), |TrialGuard { name, threshold, .. }| {
            format!("{name}, threshold {}", EventRecord::guard_value(name, *threshold))
        })
    }

    /// If it was interrupted, how far it got, in words.
    fn cut_short(&self) -> Option<String> {
        let (driven, planned) = (self.drives.len(), count(self.planned, "planned drive"));
        self.interrupted.then(|| format!("interrupted after {driven} of {planned}"))
    }

    /// The drive with a guard, or else without, that went worst among those of a case; none if there is none.
    pub fn worst(&self, case: &str) -> Option<&TrialDrive> {
        let badness = |drive: &TrialDrive| {
            let TrialOutcome { impact_mph, activations, hardest_g, reduction_mph, .. } =
                drive.with.unwrap_or(drive.without);
            let harmless = f64::from(activations) * 10.0 + hardest_g;
            // Of those that all avoid it, the one that had to brake most.
            if drive.hazard { impact_mph.map_or(reduction_mph - 1e3, |mph| mph) } else { harmless }
        };
        let of_it = self.drives.iter().filter(|drive| drive.case == case);
        of_it.max_by(|a, b| badness(a).total_cmp(&badness(b)))
    }
}

type Key = (String, Option<u64>);

/// Drives by a key, in the order of their first.
fn grouped<'a>(drives: &[&'a TrialDrive], key: &dyn Fn(&TrialDrive) -> Key) -> Vec<(Key, Vec<&'a TrialDrive>)> {
    let mut groups: Vec<(Key, Vec<&TrialDrive>)> = vec![];
    for drive in drives {
        let key = key(drive);
        match groups.iter_mut().find(|(known, _)| *known == key) {
            Some((_, group)) => group.push(drive),
            None => groups.push((key, vec![drive])),
        }
    }
    groups
}

/// The mean; none of nothing.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

impl HazardRow {
    fn of(what: String, speed_mph: Option<f64>, drives: &[&TrialDrive]) -> Self {
        let is_avoidable = |drive: &&&TrialDrive| drive.avoidable == Some(true) && drive.without.impact_mph.is_some();
        let with: Vec<TrialOutcome> = drives.iter().filter_map(|drive| drive.with).collect();
        let guarded = !with.is_empty();
        let hits =
            |outcomes: &mut dyn Iterator<Item = TrialOutcome>| outcomes.filter(|o| o.impact_mph.is_some()).count();
        let avoided = |drive: &&&TrialDrive| drive.with.is_some_and(|with| with.impact_mph.is_none());
        Self {
            what,
            speed_mph,
            drives: drives.len(),
            hit_without: hits(&mut drives.iter().map(|drive| drive.without)),
            avoidable: drives.iter().filter(is_avoidable).count(),
            hit_with: guarded.then(|| hits(&mut with.iter().copied())),
            avoided: guarded.then(|| drives.iter().filter(is_avoidable).filter(avoided).count()),
            impact_without_mph: mean(drives.iter().filter_map(|drive| drive.without.impact_mph)),
            impact_with_mph: mean(with.iter().filter_map(|outcome| outcome.impact_mph)),
            reduction_mph: mean(with.iter().map(|outcome| outcome.reduction_mph)),
            reduction_without_mph: mean(drives.iter().map(|drive| drive.without.reduction_mph)),
        }
    }

    /// Its cells, in words; a dash where there is nothing.
    fn cells(&self) -> [String; 10] {
        let number = |value: Option<f64>| value.map_or("–".into(), |value| format!("{value:.1}"));
        let count = |value: Option<usize>| value.map_or("–".into(), |value| value.to_string());
        let share = self
            .avoided
            .filter(|_| self.avoidable > 0)
            .map(|n| format!("{:.0} %", 100.0 * n as f64 / self.avoidable as f64));
        [
            self.speed_mph.map_or("all".into(), |mph| format!("{mph}")),
            self.drives.to_string(),
            self.hit_without.to_string(),
            count(self.hit_with),
            self.avoidable.to_string(),
            share.unwrap_or("–".into()),
            number(self.impact_without_mph),
            number(self.impact_with_mph),
            number(self.reduction_without_mph),
            number(self.reduction_mph),
        ]
    }
}

impl HarmlessRow {
    fn of(what: String, drives: &[&TrialDrive]) -> Self {
        let outcomes: Vec<TrialOutcome> = drives.iter().map(|drive| drive.with.unwrap_or(drive.without)).collect();
        let guarded = || drives.iter().filter_map(|drive| drive.with);
        let has_guard = guarded().next().is_some();
        Self {
            what,
            drives: drives.len(),
            hours: outcomes.iter().map(|outcome| outcome.time_s).sum::<f64>() / 3600.0,
            hit_without: drives.iter().filter(|drive| drive.without.impact_mph.is_some()).count(),
            activations: has_guard.then(|| guarded().map(|outcome| outcome.activations).sum()),
            hardest_g: has_guard.then(|| guarded().map(|outcome| outcome.hardest_g).fold(0.0, f64::max)),
        }
    }

    fn cells(&self) -> [String; 4] {
        let none = || "–".to_owned();
        let hardest = self.hardest_g.filter(|_| self.activations > Some(0));
        [
            self.drives.to_string(),
            format!("{:.2}", self.hours),
            self.activations.map_or_else(none, |times| times.to_string()),
            hardest.map_or_else(none, |g| format!("{g:.2} g")),
        ]
    }
}

const HAZARD_HEADS: [&str; 10] = [
    "mph",
    "drives",
    "hit without",
    "hit with",
    "avoidable",
    "avoided",
    "impact without",
    "impact with",
    "slower without",
    "slower with",
];
const HARMLESS_HEADS: [&str; 4] = ["drives", "hours", "activations", "hardest"];

impl fmt::Display for TrialResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { hazards, by_hazard, by_layer, harmless, .. } = self;
        let line = |f: &mut fmt::Formatter<'_>, what: &str, cells: &[String], heads: &[&str]| {
            write!(f, "{what:<22}")?;
            cells
                .iter()
                .zip(heads)
                .try_for_each(|(cell, head)| write!(f, "  {cell:>0$}", head.chars().count().max(5)))?;
            writeln!(f)
        };
        let heads = |heads: &[&str]| heads.iter().map(|head| (*head).to_owned()).collect::<Vec<_>>();
        if !hazards.is_empty() {
            line(f, "hazard", &heads(&HAZARD_HEADS), &HAZARD_HEADS)?;
            let mut all: Vec<&HazardRow> = vec![];
            for total in by_hazard {
                all.extend(hazards.iter().filter(|row| row.what == total.what));
                all.push(total);
            }
            all.into_iter().chain(by_layer).try_for_each(|row| line(f, &row.what, &row.cells(), &HAZARD_HEADS))?;
        }
        if !harmless.is_empty() {
            line(f, "harmless", &heads(&HARMLESS_HEADS), &HARMLESS_HEADS)?;
            harmless.iter().try_for_each(|row| line(f, &row.what, &row.cells(), &HARMLESS_HEADS))?;
        }
        if let Some(cut_short) = self.cut_short() {
            writeln!(f, "{cut_short}")?;
        }
        let guard = self.guarded_by();
        write!(f, "guard: {guard}; roads, looks and weather: {}; speeds in mph", self.part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(hazard: bool, speed_mph: f64, without: Option<f64>, avoidable: bool, with: Option<f64>) -> TrialDrive {
        let outcome = |impact_mph: Option<f64>| TrialOutcome {
            impact_mph,
            reduction_mph: speed_mph - impact_mph.unwrap_or(0.0),
            activations: 1,
            time_s: 36.0,
            hardest_g: 0.7,
            ..TrialOutcome::default()
        };
        TrialDrive {
            case: if hazard { "ccrs" } else { "parked" }.into(),
            hazard,
            layer: "plain".into(),
            track: "lake".into(),
            speed_mph,
            seed: 0,
            laps: None,
            without: outcome(without),
            avoidable: hazard.then_some(avoidable),
            with: Some(outcome(with)),
        }
    }

    #[test]
    fn what_is_avoided_is_counted_of_what_is_avoidable() {
        let drives = vec![
            drive(true, 20.0, Some(20.0), true, None),
            drive(true, 20.0, Some(17.0), true, Some(6.0)),
            drive(true, 20.0, Some(20.0), false, None),
            drive(true, 30.0, Some(28.0), true, Some(18.0)),
            drive(false, 30.0, None, false, None),
        ];
        let guard = TrialGuard { name: "brake-live".into(), threshold: 0.725, sha256: Some("00ff".into()) };
        let result = TrialResult::of(Some(guard), "held-out", drives);
        let [slow, fast] = &result.hazards[..] else { panic!("{result:?}") };
        assert_eq!((slow.drives, slow.hit_without, slow.avoidable), (3, 3, 2));
        assert_eq!((slow.hit_with, slow.avoided), (Some(1), Some(1)));
        assert_eq!((slow.impact_with_mph, slow.impact_without_mph), (Some(6.0), Some(19.0)));
        assert_eq!((fast.avoided, fast.reduction_mph), (Some(0), Some(12.0)));
        assert_eq!((slow.reduction_without_mph, fast.reduction_without_mph), (Some(1.0), Some(2.0)));
        let [all] = &result.by_hazard[..] else { panic!("{result:?}") };
        assert_eq!((all.drives, all.avoidable, all.avoided), (4, 3, Some(1)));
        let [harmless] = &result.harmless[..] else { panic!("{result:?}") };
        assert_eq!((harmless.activations, harmless.hardest_g, harmless.hours), (Some(1), Some(0.7), 0.01));
        assert_eq!(result.worst("ccrs").map(|drive| drive.speed_mph), Some(30.0));
        let text = result.to_string();
        assert!(
            text.contains("ccrs")
                && text.contains("50 %")
                && text
                    .ends_with("guard: brake-live, threshold 0.725; roads, looks and weather: held-out; speeds in mph"),
            "{text}"
        );
    }

    #[test]
    fn which_guard_it_was_is_told_with_its_threshold_and_the_sum_of_its_file() {
        let of = |name: &str, threshold, sha256: Option<&str>| {
            let guard = TrialGuard { name: name.into(), threshold, sha256: sha256.map(str::to_owned) };
            TrialResult::of(Some(guard), "train", vec![])
        };
        let network = of("brake-live", 0.725, Some("00ff"));
        let json = serde_json::to_string(&network).unwrap();
        assert!(json.starts_with(r#"{"guard":"brake-live","threshold":0.725,"sha256":"00ff","part""#), "{json}");
        assert!(render(&network, &[]).contains("guard: brake-live, threshold 0.725;"));
        let ttc = of("time to collision", 1.4_f64.recip(), None);
        assert!(ttc.to_string().starts_with("guard: time to collision, threshold 1.40 s; "), "{ttc}");
        assert!(!serde_json::to_string(&ttc).unwrap().contains("sha256"));
    }

    #[test]
    fn a_trial_that_was_interrupted_says_so_wherever_it_is_told() {
        let whole = TrialResult::of(None, "train", vec![drive(true, 20.0, Some(20.0), true, None)]);
        assert_eq!((whole.planned, whole.interrupted), (1, false));
        assert!(!whole.to_string().contains("interrupted") && !render(&whole, &[]).contains("interrupted"));
        let part = TrialResult { planned: 6, interrupted: true, ..whole };
        assert!(part.to_string().contains("\ninterrupted after 1 of 6 planned drives\nguard: none"), "{part}");
        assert!(render(&part, &[]).contains("<p>interrupted after 1 of 6 planned drives</p>"));
        assert!(serde_json::to_string(&part).unwrap().contains("\"planned\":6,\"interrupted\":true"));
    }

    #[test]
    fn without_a_guard_nothing_is_told_of_one() {
        let alone = |hazard| TrialDrive { with: None, ..drive(hazard, 20.0, Some(20.0), true, None) };
        let drives = vec![alone(true), alone(false)];
        let result = TrialResult::of(None, "train", drives);
        assert_eq!((result.hazards[0].hit_with, result.hazards[0].avoided), (None, None));
        assert_eq!(result.harmless[0].cells()[2..], ["–", "–"]);
        let json = serde_json::to_value(&result).unwrap();
        let has = |row: &serde_json::Value, key: &str| row.as_object().unwrap().contains_key(key);
        for key in ["guard", "threshold", "sha256"] {
            assert!(!has(&json, key), "{key}");
        }
        assert!(!has(&json["hazards"][0], "hit_with") && has(&json["harmless"][0], "hours"));
        assert!(!has(&json["harmless"][0], "activations") && !has(&json["harmless"][0], "hardest_g"));
    }
}
