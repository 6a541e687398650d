//! How good a braking network is on a part of a data set: the table of `lapwing brake evaluate`.

use std::fmt;

use serde::Serialize;

use super::{
    BrakingModel, BrakingTrainError, SpeedFailure, episodes,
    episodes::{Drive, Story},
    windows::FAILURES,
};
use lapwing_core::{guard::GuardModel, words::count};
use lapwing_score::{
    drawing::chart::{Axis, Chart, Marks, Series},
    emergency::{
        CountingRule, Episode, Evaluation,
        evaluation::{Lead, Rate},
    },
    score::aligned,
};
use lapwing_sim::{braking::Case, track::Track};

/// What a network should reach on episodes that it did not learn from, by the paper's counting: the project's own targets,
/// above the paper's pooled recall of 0.872 and precision of 0.704.
const LEAST_RECALL: f64 = 0.95;
const LEAST_PRECISION: f64 = 0.90;
/// How much lower the F1 may be where speeds fail.
const MOST_LOST: f64 = 0.05;
/// A guard must brake in vain less often than this an hour of laps on the three tracks.
const FALSE_ALARMS_PER_H: f64 = 1.0;
/// What the row of these laps is called.
const ON_KNOWN: &str = "lap: all three";

/// A row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Of which episodes, or with which speeds.
    pub name: String,
    /// How good the network is there.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

/// A target, and whether it is reached.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Target {
    /// Which.
    pub name: String,
    /// The least value, or the most for a loss.
    pub wanted: f64,
    /// What was found; none if it cannot be measured.
    pub got: Option<f64>,
    /// Whether that is enough.
    pub reached: bool,
}

/// How good a network is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BrakingReport {
    /// The network, and the SHA-256 of its file.
    pub model: String,
    /// In lower-case hexadecimal.
    pub sha256: String,
    /// On all episodes, with all speeds.
    pub all: Evaluation,
    /// On all of them, with half, four fifths and all of the speeds unknown.
    pub speed_failed: Vec<Row>,
    /// On those of each situation.
    pub scenarios: Vec<Row>,
    /// On laps of each of the three tracks, of all three together, and of other roads.
    pub laps: Vec<Row>,
    /// On those of each layer of robustness.
    pub layers: Vec<Row>,
    /// On hazards whose driver was quick, or slow: the paper's labels begin with the foot.
    pub reactions: Vec<Row>,
    /// What should be reached.
    pub targets: Vec<Target>,
}

impl BrakingReport {
    /// Judges a network on these drives at its own threshold. `seed` draws the intervals, and which speeds fail; `told` is
    /// told how many drives are done, and how many there are, each counted once for each share of failed speeds.
    ///
    /// # Errors
    /// [`BrakingTrainError`].
    pub fn of(
        model: &BrakingModel,
        drives: &[Drive],
        seed: u64,
        mut told: impl FnMut(usize, usize),
    ) -> Result<Self, BrakingTrainError> {
        let (network, limits) = (model.network(), model.limits());
        let rule = CountingRule::default();
        let judge = |episodes: &[Episode]| Evaluation::of(episodes, limits, rule, seed);
        let total = drives.len() * (1 + FAILURES.len());
        let whole = episodes(&network, drives, SpeedFailure::NONE, |done| told(done, total))?;
        let all = judge(&whole);
        let mut speed_failed = vec![];
        for (i, share) in FAILURES.into_iter().enumerate() {
            let failure = SpeedFailure { share, seed };
            let failed = episodes(&network, drives, failure, |done| told((i + 1) * drives.len() + done, total))?;
            let name =
                if share < 1.0 { format!("{:.0} % of speeds unknown", 100.0 * share) } else { "no speed".into() };
            speed_failed.push(Row { name, evaluation: judge(&failed) });
        }
        let by = |of: &dyn Fn(&Drive) -> String| -> Vec<Row> {
            let mut names: Vec<String> = drives.iter().map(of).collect();
            names.sort_unstable();
            names.dedup();
            let row = |name: String| {
                let those = drives.iter().zip(&whole).filter(|(drive, _)| of(drive) == name);
                let those: Vec<Episode> = those.map(|(_, episode)| episode.clone()).collect();
                Row { name, evaluation: judge(&those) }
            };
            names.into_iter().map(row).collect()
        };
        let (scenarios, layers) = (by(&|drive| drive.story.scenario.clone()), by(&|drive| drive.story.layer.clone()));
        let quickness = |story: &Story| if story.hazard { reaction(story.reaction_s) } else { "" };
        let mut reactions = by(&|drive| quickness(&drive.story).to_owned());
        let mut laps: Vec<Row> = [lap_on, lap_on_known].iter().flat_map(|on| by(&|drive| on(&drive.story))).collect();
        // Episodes that are no hazard, and no lap.
        [&mut reactions, &mut laps].into_iter().for_each(|rows| rows.retain(|row| !row.name.is_empty()));
        let targets = targets(&all, &speed_failed, &laps);
        Ok(Self {
            model: GuardModel::name(model).to_owned(),
            sha256: GuardModel::sha256(model).unwrap_or_default().to_owned(),
            all,
            speed_failed,
            scenarios,
            laps,
            layers,
            reactions,
            targets,
        })
    }

    /// Precision over recall at all thresholds, with all speeds and without.
    pub fn chart(&self) -> Chart {
        let line = |evaluation: &Evaluation| {
            let points = evaluation.curve.iter().filter_map(|point| Some((point.recall?, point.precision?)));
            Marks::Line(points.collect())
        };
        let mut series = vec![Series::new("all speeds known", line(&self.all))];
        series.extend(self.speed_failed.iter().map(|row| Series::new(row.name.clone(), line(&row.evaluation))));
        let here = self.all.recall.value.zip(self.all.precision.value).into_iter().collect();
        series.push(Series::new(format!("threshold {:.3}", self.all.threshold), Marks::Points(here)));
        let axis = |label: &str| Axis::new(label).from_to(0.0, 1.02);
        Chart {
            series,
            ..Chart::new(format!("Emergencies found by {}", self.model), axis("recall"), axis("precision"))
        }
    }
}

/// How quick a driver was, in words that sort by it.
fn reaction(reaction_s: f64) -> &'static str {
    match reaction_s {
        s if s < 0.7 => "reaction 0.4 to 0.7 s",
        s if s < 0.9 => "reaction 0.7 to 0.9 s",
        s if s < 1.2 => "reaction 0.9 to 1.2 s",
        _ => "reaction 1.2 to 1.6 s",
    }
}

/// The name of the row that counts an ordinary lap by its road; empty if the episode is no lap.
fn lap_on(story: &Story) -> String {
    match (story.scenario == Case::Lap.name(), story.track.as_deref()) {
        (false, _) => String::new(),
        (true, Some(track)) if Track::NAMES.contains(&track) => format!("lap: {track}"),
        (true, Some(_)) => "lap: other roads".into(),
        (true, None) => "lap: unknown road".into(),
    }
}

/// The name of the row for the laps of the three tracks together; empty for all else.
fn lap_on_known(story: &Story) -> String {
    let is_known = story.track.as_deref().is_some_and(|track| Track::NAMES.contains(&track));
    if is_known && !lap_on(story).is_empty() { ON_KNOWN.into() } else { String::new() }
}

/// What was found under a name, if there is such a row.
fn found<'a>(rows: &'a [Row], name: &str) -> Option<&'a Evaluation> {
    rows.iter().find(|row| row.name == name).map(|row| &row.evaluation)
}

/// What should be reached, and what was.
fn targets(all: &Evaluation, speed_failed: &[Row], laps: &[Row]) -> Vec<Target> {
    let least = |name: &str, wanted: f64, got: Option<f64>| Target {
        name: name.to_owned(),
        wanted,
        got,
        reached: got.is_some_and(|got| got >= wanted),
    };
    let lost = speed_failed.iter().map(|row| {
        // A network that finds nothing has no F1 to lose, so no loss is told.
        let with = all.f1.value.filter(|f1| *f1 > 0.0);
        let got = with.zip(row.evaluation.f1.value).map(|(with, without)| with - without);
        let reached = got.is_some_and(|lost| lost <= MOST_LOST);
        Target { name: format!("F1 lost, {}", row.name), wanted: MOST_LOST, got, reached }
    });
    let got = found(laps, ON_KNOWN).and_then(|laps| laps.false_alarms_per_h.value);
    let reached = got.is_some_and(|got| got < FALSE_ALARMS_PER_H);
    let name = "wrong activations an hour of laps on lake, jungle and mountain, below".to_owned();
    let mut all =
        vec![least("recall", LEAST_RECALL, all.recall.value), least("precision", LEAST_PRECISION, all.precision.value)];
    all.extend(lost);
    all.push(Target { name, wanted: FALSE_ALARMS_PER_H, got, reached });
    all
}

const HEADINGS: [&str; 10] = [
    "",
    "episodes",
    "found",
    "missed",
    "false",
    "precision",
    "recall",
    "F1",
    "activations right, wrong",
    "before the foot",
];

fn row(name: &str, of: &Evaluation) -> Vec<String> {
    let rate = |rate: Rate| match (rate.value, rate.interval) {
        (Some(value), Some([low, high])) => format!("{value:.3} [{low:.2}, {high:.2}]"),
        (Some(value), None) => format!("{value:.3}"),
        (None, _) => "-".into(),
    };
    let lead = of.before_pedal.map_or_else(|| "-".into(), |lead| format!("{:.2} s", lead.median));
    vec![
        name.to_owned(),
        of.episodes.to_string(),
        of.counts.true_positives.to_string(),
        of.counts.false_negatives.to_string(),
        of.counts.false_positives.to_string(),
        rate(of.precision),
        rate(of.recall),
        of.f1.value.map_or_else(|| "-".into(), |f1| format!("{f1:.3}")),
        format!("{}, {}", of.activations.true_positives, of.activations.false_positives),
        lead,
    ]
}

impl fmt::Display for BrakingReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { model, all, .. } = self;
        let (episodes, hours, threshold) = (count(all.episodes, "episode"), all.hours, all.threshold);
        writeln!(f, "{model}: {episodes}, {hours:.2} h, threshold {threshold:.3}")?;
        let mut rows = vec![HEADINGS.map(str::to_owned).to_vec(), row("all", all)];
        for of in [&self.speed_failed, &self.scenarios, &self.laps, &self.layers, &self.reactions] {
            rows.extend(of.iter().map(|Row { name, evaluation }| row(name, evaluation)));
        }
        writeln!(f, "{}", aligned(&rows, 1))?;
        let rounded = |value: Option<f64>, digits: usize| value.map_or_else(|| "-".into(), |v| format!("{v:.digits$}"));
        writeln!(
            f,
            "accuracy {}, false positive rate {}; a predictor that never fires has an accuracy of {}",
            rounded(all.accuracy, 4),
            rounded(all.false_positive_rate, 5),
            rounded(all.silent_accuracy, 4),
        )?;
        let alarms = |of: &Evaluation| match (of.false_alarms_per_h.value, of.false_alarms_per_h.interval) {
            (Some(value), Some([low, high])) => format!("{value:.2} [{low:.2}, {high:.2}]"),
            (value, _) => rounded(value, 2),
        };
        write!(f, "activations: F1 {}, {} wrong ones an hour", rounded(all.event_f1.value, 3), alarms(all))?;
        for (name, laps) in [
            ("laps", found(&self.scenarios, Case::Lap.name())),
            ("laps on lake, jungle and mountain", found(&self.laps, ON_KNOWN)),
        ] {
            let Some(laps) = laps else { continue };
            write!(f, ", {} an hour of {name} ({:.2} h)", alarms(laps), laps.hours)?;
        }
        writeln!(f)?;
        for (name, lead) in [("the driver's foot", all.before_pedal), ("an impact of the driver's", all.before_impact)]
        {
            let Some(Lead { count, median, tenth }) = lead else { continue };
            writeln!(f, "before {name}: {median:.2} s (median of {count}, a tenth less than {tenth:.2} s)")?;
        }
        let told = self.targets.iter().map(|Target { name, wanted, got, reached }| {
            format!("  {name}: {} of {wanted:.2}, {}", rounded(*got, 3), if *reached { "reached" } else { "missed" })
        });
        write!(f, "targets\n{}", told.collect::<Vec<_>>().join("\n"))
    }
}

#[cfg(test)]
mod tests {
    use lapwing_core::control::BrakeLimits;

    use super::*;

    fn evaluation(change: impl FnOnce(&mut Evaluation)) -> Evaluation {
        let mut of = Evaluation::of(&[], BrakeLimits { fires: 0.5, releases: 0.25 }, CountingRule::default(), 0);
        change(&mut of);
        of
    }

    fn rate(value: f64) -> Rate {
        Rate { value: Some(value), interval: None }
    }

    fn reached(all: &Evaluation, without: Option<f64>, alarms: Option<f64>) -> Vec<bool> {
        let speed = evaluation(|of| of.f1.value = without);
        let speed = [Row { name: "no speed".into(), evaluation: speed }];
        let laps = alarms.map(|alarms| Row {
            name: ON_KNOWN.into(),
            evaluation: evaluation(|of| of.false_alarms_per_h = rate(alarms)),
        });
        targets(all, &speed, laps.as_slice()).iter().map(|target| target.reached).collect()
    }

    #[test]
    fn recall_and_precision_may_equal_their_targets_and_what_cannot_be_measured_misses_its_own() {
        let good = evaluation(|of| (of.recall, of.precision, of.f1) = (rate(0.95), rate(0.90), rate(0.92)));
        assert_eq!(reached(&good, Some(0.871), Some(0.99)), [true; 4]);
        assert_eq!(reached(&good, Some(0.869), Some(1.0)), [true, true, false, false]);
        assert_eq!(reached(&good, None, None), [true, true, false, false]);
        let bad = evaluation(|of| (of.recall, of.precision, of.f1) = (rate(0.949), rate(0.899), rate(0.0)));
        assert_eq!(reached(&bad, Some(0.0), Some(0.0)), [false, false, false, true]);
    }

    #[test]
    fn laps_of_the_three_tracks_are_told_apart_from_those_of_other_roads() {
        let story = |scenario: &str, track: Option<&str>| Story {
            name: "x".into(),
            part: lapwing_sim::braking::Part::HeldOut,
            scenario: scenario.into(),
            hazard: false,
            layer: "plain".into(),
            reaction_s: 1.0,
            track: track.map(str::to_owned),
            frames: None,
        };
        for track in Track::NAMES {
            let lap = story("lap", Some(track));
            assert_eq!([lap_on(&lap), lap_on_known(&lap)], [format!("lap: {track}"), ON_KNOWN.into()]);
        }
        for (scenario, track, name) in [
            ("lap", Some("random:9"), "lap: other roads"),
            ("lap", None, "lap: unknown road"),
            ("parked", Some("lake"), ""),
        ] {
            let other = story(scenario, track);
            assert_eq!([lap_on(&other), lap_on_known(&other)], [name, ""]);
        }
    }
}
