//! The steering of another model on the frames of a recorded run, beside the recorded one.
//!
//! It is computed as it is read: a page that is slow makes it slow, and one that is gone ends it. The answer is one JSON
//! object a line: `{"model":…,"moments":…}`, then pieces `{"t":[…],"recorded":[…],"steering":[…]}` with the agreement so
//! far, and at the end one with `"done":true`.

use std::{
    convert::Infallible,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    body::Body,
    extract::{Path, State},
    http::header,
    response::{IntoResponse, Response},
};
use bytes::Bytes;
use futures_util::stream::unfold;
use serde::Serialize;
use serde_json::json;

use super::{Page, control::Refused, explained::NoLayer, runs_routes::read};
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    pilot::{Pilot, View},
    recording::{Moment, Recording, RecordingError},
    stats::Agreement,
    units::Steering,
};

/// A piece has so many frames at most, and ends after this time if a network is slow.
const PIECE: usize = 24;
const PIECE_TIME: Duration = Duration::from_millis(100);
/// Comparisons that may be under way at a time, each of which holds a pilot and an open file.
pub(super) const AT_A_TIME: u32 = 4;

/// Answers with the comparison.
pub(super) async fn with_model(
    State(page): State<Arc<Page>>,
    Path((name, pilot)): Path<(String, usize)>,
) -> Result<Response, NoLayer> {
    let choice = page.pilot(pilot)?;
    if let Some(why) = choice.why_blind() {
        return Err(Refused::Cannot(why.into()).into());
    }
    let place = page.comparisons.take().ok_or(Refused::Comparing(AT_A_TIME))?;
    let (path, _) = read(page.clone(), move |runs, _| runs.find(&name)).await?;
    let (model, pilot) = (choice.name.clone(), (choice.make)());
    // Opened before the answer begins, so that what is no run is an error of its own.
    let opened =
        page.desk.work(move || Compared::open(path, pilot)).await.map_err(|gone| NoLayer::Failed(gone.into()))?;
    let compared = opened.map_err(|error| NoLayer::Run(error.into()))?;
    let head = json!({ "model": model, "moments": compared.recording.left() });
    let pieces = unfold((Some(compared), Some(head), page, place), async |(compared, head, page, place)| {
        if let Some(head) = head {
            return Some((line(&head), (compared, None, page, place)));
        }
        let mut compared = compared?;
        let next = page.desk.work(move || {
            let piece = compared.next();
            (compared, piece)
        });
        match next.await {
            Ok((compared, piece)) => {
                let goes_on = !piece.done && piece.error.is_none();
                Some((line(&piece), (goes_on.then_some(compared), None, page, place)))
            }
            Err(gone) => Some((line(&json!({ "error": gone.to_string() })), (None, None, page, place))),
        }
    });
    Ok(([(header::CONTENT_TYPE, "application/x-ndjson")], Body::from_stream(pieces)).into_response())
}

fn line(value: &impl Serialize) -> Result<Bytes, Infallible> {
    let text = serde_json::to_string(value).unwrap_or_else(|error| json!({ "error": error.to_string() }).to_string());
    Ok(Bytes::from(text + "\n"))
}

/// A run that is being shown to a pilot.
struct Compared {
    recording: Recording,
    pilot: Box<dyn Pilot>,
    frame: Frame,
    /// Where both steered: the pilot, and what was recorded.
    pairs: Vec<(f64, f64)>,
}

/// What a page is told at a time; all steering is normalised, positive to the right.
#[derive(Debug, Default, Serialize)]
struct Piece {
    /// Seconds of the run.
    t: Vec<f64>,
    /// What was commanded; null where nobody steered.
    recorded: Vec<Option<f64>>,
    /// What the model steers, as a car takes it; null where it cannot.
    steering: Vec<Option<f64>>,
    /// So far; null before both have steered.
    agreement: Option<Agreement>,
    done: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<&'static str>,
}

impl Compared {
    fn open(path: PathBuf, mut pilot: Box<dyn Pilot>) -> Result<Self, RecordingError> {
        pilot.reset();
        Ok(Self { recording: Recording::open(path)?, pilot, frame: Frame::default(), pairs: vec![] })
    }

    /// The next frames.
    fn next(&mut self) -> Piece {
        let (mut piece, began) = (Piece::default(), Instant::now());
        while piece.t.len() < PIECE && began.elapsed() < PIECE_TIME {
            match self.recording.next() {
                Some(Ok(moment)) if moment.is_seen() => self.take(&moment, &mut piece),
                Some(Ok(_)) => {}
                Some(Err(error)) => {
                    tracing::warn!("a run could not be shown to a model: {error}");
                    piece.error = Some("the run cannot be read any further");
                    break;
                }
                None => {
                    piece.done = true;
                    break;
                }
            }
        }
        piece.agreement = Agreement::of(self.pairs.iter().copied());
        piece
    }

    fn take(&mut self, moment: &Moment, piece: &mut Piece) {
        if moment.broken.is_some() {
            self.pilot.reset();
        }
        let (recorded, steering) = (moment.steering().map(Steering::get), self.steers(moment));
        self.pairs.extend(steering.zip(recorded));
        piece.t.push(moment.at.as_secs_f64());
        piece.recorded.push(recorded.map(shorter));
        piece.steering.push(steering.map(shorter));
    }

    fn steers(&mut self, moment: &Moment) -> Option<f64> {
        let jpeg = moment.pictures[0].as_ref()?.read().ok()?;
        decode_jpeg(&jpeg, &mut self.frame).ok()?;
        let view = View { speed: moment.telemetry.speed, ..View::of(&self.frame) };
        Some(Steering::saturating(self.pilot.steer(&view).ok()?.steering).get())
    }
}

/// A page draws fewer digits than a number has.
fn shorter(steering: f64) -> f64 {
    (steering * 1e5).round() / 1e5
}
