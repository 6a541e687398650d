//! The scorecard for scripts, as JSON; [`super::table`] is for people.

use std::collections::BTreeMap;

use serde::{
    Serialize, Serializer,
    ser::{Error, SerializeMap},
};

use super::{DriveFound, Figure, Latency, Measure, STAGES, Unit};

/// The schema of a scorecard's JSON. A key's meaning never changes under one number; new keys may be added.
pub const SCHEMA: &str = "lapwing.scorecard/1";

/// The score of a run.
///
/// As JSON it is one object: `schema`; `track`, `scenario`, `ended`, `laps_asked`, each a value or null; `drives`, the [`DriveFound`]s of a run without positions; a number or null
/// under the key of each [`Figure`]; `lap_times_s`; `latency_ms` with p50, p95 and p99 of each of the [`STAGES`] that were
/// measured; `estimates`, which names the figures, and lap times, that are estimates with `uncertainty` and `from`; `not_measurable`,
/// which gives the reason of each null; `damaged`, where parts of the file cannot be read; and `notes` in words.
#[derive(Debug, Clone, PartialEq)]
pub struct Scorecard {
    /// The track, if the run reports it.
    pub track: Option<String>,
    /// The script of the other traffic.
    pub scenario: Option<String>,
    /// Why the run ended.
    pub ended: Option<String>,
    /// Laps asked for.
    pub laps_asked: Option<u32>,
    /// Of a run that reports no position: its drives, and on which road each seems to have been.
    pub drives: Vec<DriveFound>,
    /// How long each lap took, in seconds.
    pub lap_times_s: Vec<f64>,
    /// How far off each of them may be, in seconds, if they are estimates.
    pub lap_times_off_s: Option<f64>,
    /// The source of such estimates.
    pub(super) lap_times_from: &'static str,
    /// Where the car was on a known track, for a map, in a run without positions: seconds of the run, and metres along
    /// the track's driving line. These are estimates, and not part of the JSON.
    pub whereabouts: Vec<(f64, f64)>,
    /// Of each of the [`STAGES`].
    pub latency: [Option<Latency>; STAGES.len()],
    /// The run's file is cut off, or part of it cannot be read: the figures are those of the rest.
    pub damaged: bool,
    /// What else a reader should know: a file that is cut off, messages that cannot be read.
    pub notes: Vec<String>,
    /// In the order of [`Figure::ALL`].
    pub(super) figures: [Measure; Figure::ALL.len()],
}

impl Scorecard {
    /// What the run says about a figure.
    pub fn get(&self, figure: Figure) -> Measure {
        self.figures[figure as usize]
    }

    /// The value of a figure, reported or estimated.
    pub fn value(&self, figure: Figure) -> Option<f64> {
        self.get(figure).value()
    }
}

/// A scorecard's figures while they are collected.
pub(super) struct Figures([Measure; Figure::ALL.len()]);

impl Figures {
    pub(super) fn unknown(why: &'static str) -> Self {
        Self([Measure::Unknown(why); Figure::ALL.len()])
    }

    /// A scorecard of them and nothing else.
    pub(super) fn card(self) -> Scorecard {
        Scorecard {
            track: None,
            scenario: None,
            ended: None,
            laps_asked: None,
            drives: vec![],
            lap_times_s: vec![],
            lap_times_off_s: None,
            lap_times_from: "",
            whereabouts: vec![],
            latency: Default::default(),
            damaged: false,
            notes: vec![],
            figures: self.0,
        }
    }

    pub(super) fn set(&mut self, figure: Figure, measure: Measure) {
        self.0[figure as usize] = measure;
    }

    pub(super) fn get(&self, figure: Figure) -> Measure {
        self.0[figure as usize]
    }

    /// Takes a finding about a figure that the run does not report.
    pub(super) fn suggest(&mut self, figure: Figure, measure: Measure) {
        if self.get(figure).value().is_none() && measure.value().is_some() {
            self.set(figure, measure);
        }
    }

    pub(super) fn told(&mut self, figure: Figure, value: Option<f64>, why: &'static str) {
        self.set(figure, Measure::told(value, why));
    }
}

impl Serialize for Scorecard {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Estimate {
            uncertainty: f64,
            from: &'static str,
        }
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("schema", SCHEMA)?;
        map.serialize_entry("track", &self.track)?;
        map.serialize_entry("scenario", &self.scenario)?;
        map.serialize_entry("ended", &self.ended)?;
        map.serialize_entry("laps_asked", &self.laps_asked)?;
        map.serialize_entry("drives", &self.drives)?;
        let (mut estimates, mut unknown) = (BTreeMap::new(), BTreeMap::new());
        for figure in Figure::ALL {
            let measure = self.get(figure);
            match measure {
                Measure::Told(_) => {}
                Measure::Estimate { uncertainty, from, .. } => {
                    estimates.insert(figure.key(), Estimate { uncertainty, from });
                }
                Measure::Unknown(why) => {
                    unknown.insert(figure.key(), why);
                }
            }
            match measure.value() {
                Some(value) if !value.is_finite() => {
                    return Err(S::Error::custom(format!("{} is {value}", figure.key())));
                }
                Some(value) if figure.unit() == Unit::Count => map.serialize_entry(figure.key(), &(value as u64))?,
                value => map.serialize_entry(figure.key(), &value)?,
            }
        }
        map.serialize_entry("lap_times_s", &self.lap_times_s)?;
        if let Some(uncertainty) = self.lap_times_off_s {
            estimates.insert("lap_times_s", Estimate { uncertainty, from: self.lap_times_from });
        }
        let latency: BTreeMap<_, _> = STAGES.into_iter().zip(self.latency).filter_map(|(s, l)| Some((s, l?))).collect();
        map.serialize_entry("latency_ms", &latency)?;
        map.serialize_entry("estimates", &estimates)?;
        map.serialize_entry("not_measurable", &unknown)?;
        map.serialize_entry("damaged", &self.damaged)?;
        map.serialize_entry("notes", &self.notes)?;
        map.end()
    }
}
