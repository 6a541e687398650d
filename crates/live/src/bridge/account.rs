//! The account of a drive: its run's file and scorecard while it lasts, and its summary at the end.

use std::{fmt, path::PathBuf, time::Duration};

use serde::Serialize;

use super::Bridge;
use crate::{page::RunFileStatus, viewers::Feed};
use lapwing_core::{
    config::RecordingSettings,
    drive::{Elsewhere, Observer, ObserverError},
    protocol::{Answer, Dialect},
    recording::{Recorder, RecorderOptions, RunHeader},
    turn::{EventRecord, Turn},
    words::count,
};
use lapwing_score::score::{self, Figure, Scorecard, Scorer};

/// A drive, counted, scored and recorded.
pub(super) struct Account {
    dialect: Option<Dialect>,
    /// None if no file is wanted, or if it could not be made.
    recorder: Option<Recorder>,
    /// Why it could not be made.
    unrecorded: Option<String>,
    /// What viewers see of it.
    feed: Option<Feed>,
    scorer: Scorer,
    steers: u64,
    manuals: u64,
}

impl Account {
    pub fn new(peer: &str, header: RunHeader, settings: &RecordingSettings, bridge: &Bridge) -> Self {
        let dialect = header.dialect;
        let roads = bridge.roadways.get().cloned().unwrap_or_default();
        let feed = bridge.viewers.get().and_then(|viewers| viewers.feed(header.started, roads.clone()));
        let recorder = settings.enabled.then(|| {
            Recorder::create(&settings.dir, header, RecorderOptions { queue: settings.queue, roads })
                .inspect_err(|error| tracing::error!("{peer}: this drive is not recorded: {error}"))
                .map_err(|error| error.to_string())
        });
        let (recorder, unrecorded) = match recorder {
            Some(Err(why)) => (None, Some(why)),
            made => (made.and_then(Result::ok), None),
        };
        Self { dialect, recorder, unrecorded, feed, scorer: Scorer::live(bridge.roads()), steers: 0, manuals: 0 }
    }

    /// The score so far.
    pub fn scorer(&self) -> &Scorer {
        &self.scorer
    }

    /// How its file is doing; none where none is wanted.
    pub fn file(&self) -> Option<RunFileStatus> {
        self.recorder
            .as_ref()
            .map(RunFileStatus::from)
            .or_else(|| self.unrecorded.as_deref().map(RunFileStatus::unmade))
    }

    /// Closes the file and returns the summary.
    pub fn finish(self, simulator: String) -> Summary {
        let run = self.recorder.map(|recorder| {
            let report = recorder.finish();
            Recorded {
                not_recorded: report.lost(),
                path: report.path,
                frames: report.frames,
                error: report.error.map(|error| error.to_string()),
            }
        });
        let (telemetries, human_messages) = (self.steers, self.manuals);
        let mut card = self.scorer.finish();
        card.notes.extend(self.unrecorded.map(|why| format!("this drive is not recorded: {why}")));
        Summary { simulator, dialect: self.dialect, telemetries, human_messages, card, run }
    }
}

/// Counts what it is shown, and passes it on to the scorer, the viewers and the recorder.
impl Observer<Elsewhere> for Account {
    fn turn(&mut self, world: &Elsewhere, turn: &Turn) -> Result<(), ObserverError> {
        match turn.answer {
            Answer::Steer(_) => self.steers += 1,
            Answer::Manual => self.manuals += 1,
        }
        self.scorer.turn(world, turn)?;
        self.feed.turn(world, turn)?;
        self.recorder.as_ref().turn(world, turn)
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        self.scorer.event(at, event);
        Observer::<Elsewhere>::event(&mut self.feed, at, event);
        Observer::<Elsewhere>::event(&mut self.recorder.as_ref(), at, event);
    }
}

/// The file of a run, and how complete it is.
#[derive(Debug, Clone, Serialize)]
pub struct Recorded {
    /// The file.
    pub path: PathBuf,
    /// Frames in it.
    pub frames: u64,
    /// Frames and other items that did not make it into the file.
    pub not_recorded: u64,
    /// What kept the file from being whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// What is reported about a drive at its end. Its figures are those of the scorecard that `lapwing score` makes from
/// the run's file.
///
/// As JSON it is one object: `simulator`, `dialect`, `telemetries`, `human_messages`, all keys of a [`Scorecard`], `run`.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// Address of the simulator or client.
    pub simulator: String,
    /// Which simulator it was.
    pub dialect: Option<Dialect>,
    /// Messages answered with a command, including those that could not be read.
    pub telemetries: u64,
    /// Messages that were left to the human who drove.
    pub human_messages: u64,
    /// The judgement, as far as it is possible without the whole run.
    #[serde(flatten)]
    pub card: Scorecard,
    /// The recorded run.
    pub run: Option<Recorded>,
}

impl Summary {
    /// Whether the whole drive is in a file; false if none was made.
    pub fn is_recorded_whole(&self) -> bool {
        self.run.as_ref().is_some_and(|run| run.not_recorded == 0 && run.error.is_none())
    }

    /// A count from the scorecard; 0 if it has none.
    pub fn count(&self, figure: Figure) -> u64 {
        self.card.value(figure).map_or(0, |count| count as u64)
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let dialect = self.dialect.map_or("unknown simulator".into(), |d| d.to_string());
        let mut rows = self.card.known_rows();
        rows.push((
            "messages",
            format!("{} with telemetry, {} more while a human drove", self.telemetries, self.human_messages),
        ));
        match &self.run {
            None => rows.push(("run", "not recorded".into())),
            Some(Recorded { path, frames, not_recorded, error }) => {
                rows.push(("run", format!("{} ({})", path.display(), count(*frames, "frame"))));
                if *not_recorded > 0 {
                    rows.push(("not recorded", format!("{not_recorded} frames and other items")));
                }
                rows.extend(error.as_ref().map(|error| ("recording error", error.clone())));
            }
        }
        write!(f, "drive of {} ({dialect})\n{}", self.simulator, score::lines(&rows))
    }
}
