//! Compares runs with a baseline: did they get worse?
//!
//! Runs are compared with those of the same [`setting`]: taken over all tracks together, a lap lost on one would look
//! like the scatter between tracks.

use std::{
    collections::BTreeMap,
    fmt, fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    Better, Figure, Scorecard, Spread, Unit,
    figure::wrong_figure,
    report::SCHEMA,
    summary::{ROUNDING, student},
};
use lapwing_core::recording::RunHeader;

/// A file that cannot be used as a baseline.
#[derive(Debug, thiserror::Error)]
pub enum BaselineError {
    /// It cannot be read.
    #[error("{}: cannot be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// It is not the JSON of a [`Report`](super::report::Report).
    #[error("{}: expected the JSON of lapwing score", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: serde_json::Error,
    },
    /// A figure of a run in it is none.
    #[error("{}: run {run}: {what}", path.display())]
    Figure {
        /// The file.
        path: PathBuf,
        /// Which run, from 1.
        run: usize,
        /// What is wrong.
        what: String,
    },
    /// It has nothing to compare with.
    #[error("{}: expected at least one figure of a run, got none: nothing could be compared with it", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A run in it is not whole.
    #[error("{}: run {run}: expected a whole run, got a damaged one: make the baseline from whole runs", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Which run, from 1.
        run: usize,
    },
    /// It is that of another version.
    #[error("{}: expected schema {SCHEMA}, got {got:?}", path.display())]
    Schema {
        /// The file.
        path: PathBuf,
        /// The schema that it names.
        got: String,
    },
}

/// A difference is not due to chance if it is this many times the half width of its confidence interval at 95 %: some
/// forty figures are compared, and one of them would often lie outside the interval itself.
const CERTAIN: f64 = 2.0;
/// If the baseline's runs do not scatter, or are a single one, its noise is unknown; a relative change of this size is
/// taken as real.
const ALONE: f64 = 0.05;
/// The same of what is counted a minute: whether the wheel turned back far enough to count hangs on so little that the same network
/// on the same lap comes to 14.5 times on one kind of processor and 18.3 on another.
const ALONE_PER_MINUTE: f64 = 0.5;

/// Which way a figure went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Trend {
    /// Better beyond noise.
    Better,
    /// Within noise.
    Same,
    /// Worse beyond noise, or not measurable any more.
    Worse,
}

/// A figure before and now.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// The setting of its runs.
    pub setting: String,
    /// Its key.
    pub figure: &'static str,
    /// Over the baseline's runs.
    pub before: Spread,
    /// Over these; `None` if they do not report it.
    pub now: Option<Spread>,
    /// How far apart the means may lie by chance.
    pub noise: f64,
    /// Which way it went.
    pub turn: Trend,
    #[serde(skip)]
    unit: Unit,
}

/// The part of a baseline (the JSON of `lapwing score`) that runs are compared with.
#[derive(Debug, Clone, Deserialize)]
pub struct Baseline {
    /// Which JSON it is.
    pub schema: String,
    runs: Vec<Before>,
}

#[derive(Debug, Clone, Deserialize)]
struct Before {
    setting: Option<String>,
    track: Option<String>,
    model: Option<String>,
    laps_asked: Option<u32>,
    #[serde(default)]
    damaged: bool,
    #[serde(flatten)]
    figures: BTreeMap<String, Value>,
}

/// The result of comparing runs with a baseline.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Each figure of the baseline that has a better and a worse, before and now. Figures that the baseline does not
    /// have are new and left out.
    pub changes: Vec<Change>,
    /// Settings of the baseline that no run has.
    pub missing: Vec<String>,
    /// Settings that the baseline does not have.
    pub new: Vec<String>,
    /// Settings with a run that is damaged now: the lost part may have been worse.
    pub damaged: Vec<String>,
}

/// A run that is compared with a baseline.
#[derive(Debug, Clone)]
pub struct ComparedRun<'a> {
    /// Its [`setting`].
    pub setting: String,
    /// Its model's name.
    pub model: Option<&'a str>,
    /// Its figures.
    pub card: &'a Scorecard,
}

/// The runs of one setting, before and now.
type Group<'a> = (Vec<&'a Before>, Vec<&'a ComparedRun<'a>>);

/// What runs must have in common to be compared: the track, whether its pictures were recorded or drawn, the scenario,
/// and the speed that was asked for, to 0.01 mph; of a drive along a recording, which goes at the recorded speed, the
/// rules in place of the speed. All that as far as the run reports it. Weather and seeds may differ, but for the runs of
/// a suite, whose pilot and conditions are part of their setting.
pub fn setting(header: &RunHeader, card: &Scorecard) -> String {
    let track = card.road().unwrap_or_else(|| UNKNOWN.to_owned());
    let recorded = is_in_recorded_pictures(header).then(|| RECORDED.to_owned());
    let mut parts: Vec<String> = [Some(track), recorded, card.scenario.clone()].into_iter().flatten().collect();
    match header.config.get("world").filter(|world| world.get("closed_loop_on").is_some()) {
        Some(world) => parts.extend(rules_along(world)),
        None => parts.extend(asked_mph(header)),
    }
    let of_cell = |key: &str| header.config.pointer(&format!("/cell/{key}")).and_then(Value::as_str);
    parts.extend(["pilot", "conditions"].into_iter().filter_map(of_cell).map(str::to_owned));
    parts.join(", ")
}

/// The speed that was asked for.
fn asked_mph(header: &RunHeader) -> Option<String> {
    // `drive` stores the settings beside the world; `serve` stores nothing else.
    let settings = header.config.get("settings").unwrap_or(&header.config);
    let mph = settings.pointer("/control/speed_mph").and_then(Value::as_f64)?;
    Some(format!("{} mph", (100.0 * mph).round() / 100.0))
}

/// The rules of a drive along a recording: where the car is put back, how the drive goes on, what it is measured from,
/// and which rows were driven, if not all. Earlier versions stored fewer of them.
fn rules_along(world: &Value) -> impl Iterator<Item = String> {
    let text = |key: &str| world.get(key).and_then(Value::as_str);
    let is = |key: &str| world.get(key).and_then(Value::as_bool).unwrap_or(false);
    let limit = match text("limit") {
        Some("road") => Some("limit road".to_owned()),
        _ => world.get("limit_m").and_then(Value::as_f64).map(|metres| format!("limit {metres} m")),
    };
    let row = |place: &str| world.pointer(place).and_then(Value::as_u64);
    let rows = row("/rows/0").zip(row("/rows/1")).map(|(first, end)| format!("rows {first}..{end}"));
    let rules = [
        limit,
        text("protocol").map(str::to_owned),
        is("from_path").then(|| "from the recorded path".to_owned()),
        is("by_steering").then(|| "turned by steering".to_owned()),
        rows,
    ];
    rules.into_iter().flatten()
}

const UNKNOWN: &str = "unknown track";
/// How a title says that a pilot saw pictures of recordings along the road, in place of drawn ones.
pub const RECORDED: &str = "in recorded pictures";

/// Whether the pilot of a run in the headless simulator saw pictures of recordings, in place of drawn ones.
pub(super) fn is_in_recorded_pictures(header: &RunHeader) -> bool {
    let recordings = header.config.pointer("/world/recordings").and_then(Value::as_array);
    recordings.is_some_and(|recordings| !recordings.is_empty())
}

impl Baseline {
    /// Reads an earlier result.
    ///
    /// # Errors
    /// [`BaselineError`].
    pub fn read(path: &Path) -> Result<Self, BaselineError> {
        let text = fs::read_to_string(path).map_err(|source| BaselineError::Read { path: path.to_owned(), source })?;
        let content = |source| BaselineError::Content { path: path.to_owned(), source };
        let baseline: Self = serde_json::from_str(text.trim_start_matches('\u{feff}')).map_err(content)?;
        if baseline.schema != SCHEMA {
            return Err(BaselineError::Schema { path: path.to_owned(), got: baseline.schema });
        }
        for (i, run) in baseline.runs.iter().enumerate() {
            let wrong = |what| BaselineError::Figure { path: path.to_owned(), run: i + 1, what };
            wrong_figure(|key| run.figures.get(key)).map_or(Ok(()), |what| Err(wrong(what)))?;
            if run.damaged {
                return Err(BaselineError::Damaged { path: path.to_owned(), run: i + 1 });
            }
        }
        let has_any = |run: &Before| Figure::ALL.iter().any(|f| run.figures.get(f.key()).is_some_and(Value::is_number));
        if baseline.runs.iter().any(has_any) {
            Ok(baseline)
        } else {
            Err(BaselineError::Empty { path: path.to_owned() })
        }
    }

    /// Runs of one setting and as many laps, before and now. Where several models drove before, each is a group.
    fn groups<'a>(&'a self, runs: &'a [ComparedRun<'a>]) -> BTreeMap<String, Group<'a>> {
        // Lapwing 0.1 wrote no settings at first.
        let by_track = self.runs.iter().any(|run| run.setting.is_none());
        let track = |track: &Option<String>| track.clone().unwrap_or_else(|| UNKNOWN.to_owned());
        let with_laps = |setting: String, laps: Option<u32>| match laps {
            Some(laps @ 2..) => format!("{setting}, {laps} laps"),
            _ => setting,
        };
        let mut groups: BTreeMap<String, Group> = BTreeMap::new();
        for run in &self.runs {
            let setting = run.setting.clone().filter(|_| !by_track).unwrap_or_else(|| track(&run.track));
            groups.entry(with_laps(setting, run.laps_asked)).or_default().0.push(run);
        }
        for run in runs {
            let setting = if by_track { track(&run.card.track) } else { run.setting.clone() };
            groups.entry(with_laps(setting, run.card.laps_asked)).or_default().1.push(run);
        }
        let mut by_model: BTreeMap<String, Group> = BTreeMap::new();
        for (setting, (before, now)) in groups {
            let has_several = before.iter().any(|run| run.model != before[0].model);
            let of = |model: Option<&str>| match model {
                _ if !has_several => setting.clone(),
                Some(model) => format!("{setting}, {model}"),
                None => format!("{setting}, without a model"),
            };
            for run in before {
                by_model.entry(of(run.model.as_deref())).or_default().0.push(run);
            }
            for run in now {
                by_model.entry(of(run.model)).or_default().1.push(run);
            }
        }
        by_model
    }

    /// Compares runs with it.
    pub fn compare(&self, runs: &[ComparedRun<'_>]) -> Comparison {
        let groups = self.groups(runs);
        let mut comparison = Comparison::default();
        for (setting, (before, now)) in groups {
            if now.is_empty() {
                comparison.missing.push(setting);
            } else if before.is_empty() {
                comparison.new.push(setting);
            } else {
                if now.iter().any(|run| run.card.damaged) {
                    comparison.damaged.push(setting.clone());
                }
                let change = |figure: Figure| {
                    let values: Vec<f64> =
                        before.iter().filter_map(|run| run.figures.get(figure.key())?.as_f64()).collect();
                    let now: Vec<f64> = now.iter().filter_map(|run| run.card.value(figure)).collect();
                    change(&setting, figure, Spread::of(&values)?, Spread::of(&now))
                };
                comparison.changes.extend(Figure::ALL.into_iter().filter_map(change));
            }
        }
        comparison
    }
}

impl Comparison {
    /// What got worse, in words: figures, settings without a run, and those with a damaged one.
    pub fn worse(&self) -> impl Iterator<Item = String> {
        let worse = self.changes.iter().filter(|change| change.turn == Trend::Worse).map(Change::to_string);
        let missing = self.missing.iter().map(|setting| format!("{setting} has no run, but the baseline does"));
        let damaged =
            self.damaged.iter().map(|setting| format!("{setting} has a damaged run, and what is lost may be worse"));
        worse.chain(missing).chain(damaged)
    }
}

fn change(setting: &str, figure: Figure, before: Spread, now: Option<Spread>) -> Option<Change> {
    let sign = match figure.better() {
        Better::Higher => 1.0,
        Better::Lower => -1.0,
        Better::Neither => return None,
    };
    let noise = now.map_or(0.0, |now| noise(figure.unit(), &before, &now));
    let turn = match now.map(|now| sign * (now.mean - before.mean)) {
        Some(gain) if gain > noise => Trend::Better,
        Some(gain) if gain >= -noise => Trend::Same,
        _ => Trend::Worse,
    };
    Some(Change { setting: setting.to_owned(), figure: figure.key(), before, now, noise, turn, unit: figure.unit() })
}

/// How far apart the means may lie by chance.
///
/// The scatter is that of both together, but not more than the baseline's alone: of three drives of which one leaves the
/// road, the scatter is as large as the loss, and would hide it.
fn noise(unit: Unit, before: &Spread, now: &Spread) -> f64 {
    let each = 1.0 / before.runs as f64 + 1.0 / now.runs as f64;
    let margin = |squares: f64, freedom: usize| CERTAIN * student(freedom) * (squares / freedom as f64 * each).sqrt();
    let chance = match before.deviation.filter(|deviation| *deviation > ROUNDING * before.mean.abs()) {
        Some(deviation) => {
            let (freedom, more) = (before.runs - 1, now.runs - 1);
            let squares = deviation.powi(2) * freedom as f64;
            let now_squares = now.deviation.map_or(0.0, |deviation| deviation.powi(2) * more as f64);
            margin(squares, freedom).min(margin(squares + now_squares, freedom + more))
        }
        // Drives that are all the same are one drive, of which one more collision counts.
        None => match unit {
            Unit::Count => 0.0,
            Unit::PerMinute => ALONE_PER_MINUTE * before.mean.abs(),
            _ => ALONE * before.mean.abs(),
        },
    };
    chance.max(trifle(unit))
}

/// Differences too small to matter.
fn trifle(unit: Unit) -> f64 {
    match unit {
        Unit::Count => 0.0,
        Unit::Share | Unit::Lock => 0.001,
        Unit::LockSquared => 0.0001,
        Unit::PerKm | Unit::Metres | Unit::Correlation => 0.01,
        Unit::Mph | Unit::Points | Unit::Seconds | Unit::DegreesPerSecond => 0.1,
        Unit::PerMinute | Unit::PerSecond | Unit::PerHour => 0.5,
        Unit::Gravities | Unit::Jerk => 0.05,
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let show = |mean: f64| self.unit.show_mean(mean);
        let now = self.now.map_or_else(|| "not measurable".into(), |now| show(now.mean));
        let Self { setting, figure, before, noise, .. } = self;
        write!(f, "{setting}: {figure}: {} before, {now} now, noise {}", show(before.mean), show(*noise))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::{card::Figures, report::JudgedRun};
    use lapwing_core::recording::RunKind;

    fn changed(figure: Figure, before: &[f64], now: &[f64]) -> Trend {
        change("lake", figure, Spread::of(before).unwrap(), Spread::of(now)).unwrap().turn
    }

    /// A run's card: its track, and how much of it was driven.
    fn card(track: &str, completion: f64) -> Scorecard {
        let mut figures = Figures::unknown("");
        figures.told(Figure::Completion, Some(completion), "");
        Scorecard { track: Some(track.into()), ..figures.card() }
    }

    fn compared<'a>(setting: &str, card: &'a Scorecard) -> ComparedRun<'a> {
        ComparedRun { setting: setting.to_owned(), model: None, card }
    }

    fn baseline(runs: &[(&str, &Scorecard)]) -> Baseline {
        let run = |(setting, card): &(&str, &Scorecard)| {
            let mut run = serde_json::to_value(card).unwrap();
            run["setting"] = (*setting).into();
            run
        };
        let json = serde_json::json!({ "schema": "", "runs": runs.iter().map(run).collect::<Vec<_>>() });
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn a_baseline_without_a_figure_or_with_a_wrong_one_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let read = |change: fn(&mut Value)| {
            let mut run = serde_json::to_value(card("lake", 0.9)).unwrap();
            change(&mut run);
            let path = dir.path().join("score.json");
            let json = serde_json::json!({ "schema": SCHEMA, "runs": [run] });
            // As some editors write it.
            fs::write(&path, format!("\u{feff}{json}")).unwrap();
            Baseline::read(&path).map(drop).map_err(|error| error.to_string())
        };
        assert_eq!(read(|_| ()), Ok(()));
        let none = read(|run| run["completion"] = Value::Null).unwrap_err();
        assert!(
            none.ends_with(
                "score.json: expected at least one figure of a run, got none: nothing could be compared with it"
            ),
            "{none}"
        );
        let damaged = read(|run| run["damaged"] = true.into()).unwrap_err();
        assert!(damaged.contains("score.json: run 1: expected a whole run, got a damaged one"), "{damaged}");
        let wrong = read(|run| run["collisions"] = "zero".into()).unwrap_err();
        assert!(wrong.contains("score.json: run 1: collisions: expected a number"), "{wrong}");
    }

    #[test]
    fn each_track_is_held_against_itself() {
        let (lake, jungle, mountain) = (card("lake", 1.0), card("jungle", 1.0), card("mountain", 1.0));
        let before = baseline(&[("lake", &lake), ("jungle", &jungle), ("mountain", &mountain)]);
        let (slow, lost) = (card("lake", 0.526), card("jungle", 0.122));
        let runs = [compared("lake", &slow), compared("jungle", &lost), compared("mountain", &mountain)];
        let worse: Vec<_> = before.compare(&runs).worse().collect();
        assert_eq!(worse.len(), 2, "{worse:?}");
        assert!(worse[0].starts_with("jungle: completion: 100 % before, 12.2 % now"), "{worse:?}");
    }

    #[test]
    fn drawn_pictures_of_a_track_are_another_setting_than_recorded_ones() {
        let run = |recordings: Value| {
            let config = serde_json::json!({ "world": { "recordings": recordings } });
            let header = RunHeader::new(RunKind::Driven, config, "2026-11-26T12:00:00Z".parse().unwrap());
            let run = JudgedRun { path: "run.mcap".into(), header, card: card("lake", 1.0), checks: vec![] };
            [run.setting(), run.title()]
        };
        let recorded = run(serde_json::json!(["data/lake"]));
        assert_eq!(recorded, ["lake, in recorded pictures", "run.mcap on lake, in recorded pictures"]);
        assert_eq!(run(Value::Null), ["lake", "run.mcap on lake"]);
    }

    fn setting_of(config: Value) -> String {
        let header = RunHeader::new(RunKind::RecordedPath, config, "2026-11-26T12:00:00Z".parse().unwrap());
        setting(&header, &card("lake", 1.0))
    }

    #[test]
    fn a_drive_along_a_recording_has_its_rules_in_its_setting_and_no_speed() {
        let along = |world: Value| {
            let settings = serde_json::json!({ "control": { "speed_mph": 9.0 } });
            setting_of(serde_json::json!({ "settings": settings, "world": world }))
        };
        let on_rows = serde_json::json!({
            "closed_loop_on": "lake", "limit": "metres", "limit_m": 0.3, "protocol": "dave2",
            "from_path": false, "by_steering": false, "rows": [1000, 1300],
        });
        assert_eq!(along(on_rows), "lake, limit 0.3 m, dave2, rows 1000..1300");
        let from_path = serde_json::json!({
            "closed_loop_on": "lake", "limit": "metres", "limit_m": 2.0, "protocol": "rally-estonia",
            "from_path": true, "by_steering": true, "rows": null,
        });
        let expected = "lake, limit 2 m, rally-estonia, from the recorded path, turned by steering";
        assert_eq!(along(from_path), expected);
        let at_the_edge = serde_json::json!({ "closed_loop_on": "lake", "limit": "road", "limit_m": 1.0 });
        assert_eq!(along(at_the_edge), "lake, limit road");
        assert_eq!(along(serde_json::json!({ "closed_loop_on": "lake" })), "lake", "an earlier version's run");
    }

    #[test]
    fn a_speed_in_a_setting_has_two_decimals_at_most() {
        for (mph, expected) in [(24.854_847_689_493_358, "lake, 24.85 mph"), (20.0, "lake, 20 mph")] {
            assert_eq!(setting_of(serde_json::json!({ "control": { "speed_mph": mph } })), expected);
        }
    }

    #[test]
    fn a_setting_without_a_run_is_worse_and_a_new_one_is_named() {
        let (lake, jungle) = (card("lake", 1.0), card("jungle", 1.0));
        let compared = baseline(&[("lake, 20 mph", &lake)]).compare(&[compared("jungle, 20 mph", &jungle)]);
        assert_eq!(
            (&compared.missing[..], &compared.new[..]),
            (&["lake, 20 mph".to_owned()][..], &["jungle, 20 mph".to_owned()][..])
        );
        assert_eq!(compared.worse().count(), 1);
    }

    #[test]
    fn a_baseline_without_settings_is_compared_by_track() {
        let mut before = baseline(&[("", &card("lake", 1.0))]);
        before.runs[0].setting = None;
        let now = card("lake", 0.5);
        let compared = before.compare(&[compared("lake, 20 mph", &now)]);
        assert_eq!((compared.worse().count(), compared.missing.len()), (1, 0));
    }

    #[test]
    fn what_lies_within_the_scatter_of_the_runs_is_no_change() {
        let before = [0.20, 0.24, 0.28];
        assert_eq!(changed(Figure::MeanCte, &before, &[0.22, 0.26, 0.30]), Trend::Same);
        assert_eq!(changed(Figure::MeanCte, &before, &[0.42, 0.46, 0.50]), Trend::Worse, "5.6 times 0.033");
        assert_eq!(changed(Figure::MeanCte, &before, &[0.05, 0.06, 0.07]), Trend::Better);
    }

    #[test]
    fn drives_that_fail_now_and_then_are_worse_than_drives_that_never_do() {
        // Two of three leave the road: their own scatter is as large as the loss.
        assert_eq!(changed(Figure::OffRoads, &[0.0; 3], &[0.0, 1.0, 1.0]), Trend::Worse);
        assert_eq!(changed(Figure::Autonomy, &[1.0; 3], &[1.0, 0.0, 0.0]), Trend::Worse);
        assert_eq!(changed(Figure::MeanCte, &[0.073, 0.074, 0.075], &[0.073, 3.4, 3.7]), Trend::Worse);
        // Three of ten.
        let now = [0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0];
        assert_eq!(changed(Figure::OffRoads, &[0.0; 10], &now), Trend::Worse);
        assert_eq!(changed(Figure::OffRoads, &now, &now), Trend::Same);
        assert_eq!(changed(Figure::OffRoads, &[0.0; 10], &[0.0; 3]), Trend::Same);
        // The last digits of equal values differ.
        assert_eq!(changed(Figure::MeanCte, &[0.1 + 0.2, 0.3, 0.3], &[0.31]), Trend::Same);
    }

    #[test]
    fn laps_models_and_the_cells_of_a_suite_are_not_mixed() {
        let mut two = card("lake", 1.0);
        two.laps_asked = Some(2);
        let one = card("lake", 0.5);
        let split = baseline(&[("lake, 20 mph", &two)]).compare(&[compared("lake, 20 mph", &one)]);
        assert_eq!(
            (&split.missing[..], &split.new[..]),
            (&["lake, 20 mph, 2 laps".into()][..], &["lake, 20 mph".into()][..])
        );

        let (good, bad) = (card("lake", 1.0), card("lake", 0.1));
        let mut before = baseline(&[("lake", &good), ("lake", &bad)]);
        (before.runs[0].model, before.runs[1].model) = (Some("good".into()), Some("bad".into()));
        let by = |model, card| ComparedRun { model: Some(model), ..compared("lake", card) };
        let same = before.compare(&[by("good", &good), by("bad", &bad)]);
        assert_eq!((same.worse().count(), same.changes.len()), (0, 2), "{same:?}");
        let worse: Vec<_> = before.compare(&[by("good", &bad), by("bad", &bad)]).worse().collect();
        assert!(
            worse.len() == 1 && worse[0].starts_with("lake, good: completion: 100 % before, 10 % now"),
            "{worse:?}"
        );
        // A single model is compared with its successor, whatever that is called.
        before.runs.truncate(1);
        assert_eq!(before.compare(&[by("better", &good)]).changes.len(), 1);

        let cell = serde_json::json!({ "pilot": "mine", "conditions": "rain=0.5" });
        let settings = serde_json::json!({ "control": { "speed_mph": 25.0 } });
        assert_eq!(
            setting_of(serde_json::json!({ "settings": settings, "cell": cell })),
            "lake, 25 mph, mine, rain=0.5"
        );
    }

    #[test]
    fn a_damaged_run_is_not_known_to_be_as_good() {
        let (whole, mut damaged) = (card("lake", 1.0), card("lake", 1.0));
        damaged.damaged = true;
        let worse: Vec<_> = baseline(&[("lake", &whole)]).compare(&[compared("lake", &damaged)]).worse().collect();
        assert_eq!(worse, ["lake has a damaged run, and what is lost may be worse"]);
    }

    #[test]
    fn a_collision_more_is_worse_even_in_a_single_run() {
        assert_eq!(changed(Figure::Collisions, &[0.0], &[1.0]), Trend::Worse);
        assert_eq!(changed(Figure::Collisions, &[1.0], &[1.0]), Trend::Same);
        assert_eq!(changed(Figure::Completion, &[1.0], &[0.9]), Trend::Worse);
        assert_eq!(changed(Figure::Completion, &[0.98], &[1.0]), Trend::Same, "within 5 %");
    }

    #[test]
    fn a_single_run_on_another_processor_is_not_worse_by_how_often_its_wheel_turns_back() {
        assert_eq!(changed(Figure::SteeringReversals, &[14.5], &[18.3]), Trend::Same);
        assert_eq!(changed(Figure::SteeringReversals, &[14.5, 14.5], &[18.3, 18.3]), Trend::Same);
        assert_eq!(changed(Figure::SteeringReversals, &[14.5], &[29.0]), Trend::Worse);
    }

    #[test]
    fn one_run_is_held_against_the_scatter_of_many() {
        let before = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0];
        assert_eq!(changed(Figure::Collisions, &before, &[1.0]), Trend::Same);
        assert_eq!(changed(Figure::Collisions, &before, &[3.0]), Trend::Worse);
    }

    #[test]
    fn what_is_not_measurable_any_more_is_worse() {
        assert_eq!(changed(Figure::MeanCte, &[0.2], &[]), Trend::Worse);
    }
}
