//! What networks look at: a layer over a picture, of a drive as it happens and of a recorded run.
//!
//! `live` knows no networks: whoever starts it says of each pilot how it is explained, or why it cannot be.

use std::{
    error::Error,
    fmt,
    io::Cursor,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use axum::{
    extract::{Path, State},
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use bytes::Bytes;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde::Deserialize;
use serde_json::json;
use tokio::time::{Instant, sleep_until};

use super::{
    Page, PilotChoice,
    control::Refused,
    routes::json_text,
    runs::{Runs, RunsError},
    runs_routes::read,
};
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    units::Mph,
};

/// Least time between two layers of one drive. One that takes longer to make is followed by as long a rest.
const EVERY: Duration = Duration::from_millis(250);

/// How it is found out what a network looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Looks {
    /// What its convolutions react to (Bojarski et al. 2016).
    VisualBackProp,
    /// What turns the car to the right and to the left (Sundararajan et al. 2017).
    IntegratedGradients,
}

/// What is drawn over a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// In pixels, as the picture.
    pub width: usize,
    /// In pixels, as the picture.
    pub height: usize,
    /// Red, green, blue and opacity of each pixel, row by row.
    pub rgba: Vec<u8>,
}

/// Says what a network looks at in a picture.
pub trait Explains: Send {
    /// The layer for a picture that is seen at this speed.
    ///
    /// # Errors
    /// If the network does not take the picture, or fails.
    fn explain(&mut self, frame: &Frame, speed: Mph, looks: Looks) -> Result<Layer, Box<dyn Error + Send + Sync>>;
}

/// How a pilot is explained, or why it cannot be, for people.
#[derive(Clone)]
pub struct Explaining(Result<Arc<Mutex<dyn Explains>>, String>);

impl fmt::Debug for Explaining {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.why_not().unwrap_or("explained"))
    }
}

impl Explaining {
    /// By this.
    pub fn by(explainer: impl Explains + 'static) -> Self {
        Self(Ok(Arc::new(Mutex::new(explainer))))
    }

    /// Not at all.
    pub fn not(why: impl Into<String>) -> Self {
        Self(Err(why.into()))
    }

    /// Why not.
    pub(super) fn why_not(&self) -> Option<&str> {
        self.0.as_ref().err().map(String::as_str)
    }
}

/// A layer of a drive.
#[derive(Debug)]
pub(super) struct Last {
    pilot: usize,
    looks: Looks,
    png: Bytes,
    /// No other is made before.
    until: Instant,
}

/// Why no layer is shown.
#[derive(Debug, thiserror::Error)]
pub(super) enum NoLayer {
    #[error(transparent)]
    Refused(#[from] Refused),
    #[error(transparent)]
    Run(#[from] RunsError),
    #[error("the picture cannot be explained: {0}")]
    Failed(Box<dyn Error + Send + Sync>),
}

impl IntoResponse for NoLayer {
    fn into_response(self) -> Response {
        match self {
            Self::Refused(why) => why.into_response(),
            Self::Run(why) => why.into_response(),
            failed @ Self::Failed(_) => {
                let text = json_text(json!({ "error": failed.to_string() }).to_string());
                (StatusCode::INTERNAL_SERVER_ERROR, text).into_response()
            }
        }
    }
}

/// What the pilot of a drive looks at in its newest picture.
pub(super) async fn of_drive(
    State(page): State<Arc<Page>>,
    Path((id, looks)): Path<(u64, Looks)>,
) -> Result<Response, NoLayer> {
    let drive = page.drive(id)?;
    let mut last = drive.explained.lock().await;
    let is_shown = |last: &Last| last.until > Instant::now() && (last.pilot, last.looks) == (pilot_of(&drive), looks);
    if let Some(last) = last.as_ref().filter(|last| is_shown(last)) {
        return Ok(png(last.png.clone()));
    }
    if let Some(last) = last.as_ref() {
        sleep_until(last.until).await;
    }
    let (now, pilot) = (drive.now(), pilot_of(&drive));
    let jpeg = now.jpeg.clone().ok_or_else(|| Refused::Cannot("no picture has come yet".into()))?;
    let speed = now.turn.and_then(|turn| turn.speed_mph).map_or(Mph::ZERO, Mph::saturating);
    let began = Instant::now();
    let made = layer(&page, pilot, (jpeg, speed), looks).await?;
    let until = Instant::now() + began.elapsed().max(EVERY);
    *last = Some(Last { pilot, looks, png: made.clone(), until });
    Ok(png(made))
}

fn pilot_of(drive: &super::showing::Drive) -> usize {
    drive.now().status.pilot
}

/// What a pilot looks at in a picture of a recorded run.
pub(super) async fn of_run(
    State(page): State<Arc<Page>>,
    Path((name, n, looks, pilot)): Path<(String, usize, Looks, usize)>,
) -> Result<Response, NoLayer> {
    page.pilot(pilot)?;
    let of = move |runs: &Runs, courses: &[super::Course]| {
        let opened = runs.open(&name, courses)?;
        Ok((opened.frame(n)?, opened.speed(n)))
    };
    let seen = read(page.clone(), of).await?;
    Ok(png(layer(&page, pilot, seen, looks).await?))
}

async fn layer(page: &Page, pilot: usize, (jpeg, speed): (Bytes, Mph), looks: Looks) -> Result<Bytes, NoLayer> {
    let PilotChoice { explaining, .. } = page.pilot(pilot)?;
    let explainer = explaining.0.clone().map_err(Refused::Cannot)?;
    let made = page.desk.work(move || {
        let mut frame = Frame::default();
        decode_jpeg(&jpeg, &mut frame)?;
        encoded(&explainer.lock().unwrap_or_else(PoisonError::into_inner).explain(&frame, speed, looks)?)
    });
    made.await.unwrap_or_else(|gone| Err(gone.into())).map_err(NoLayer::Failed)
}

fn encoded(layer: &Layer) -> Result<Bytes, Box<dyn Error + Send + Sync>> {
    let (width, height) = (u32::try_from(layer.width)?, u32::try_from(layer.height)?);
    let expected = layer.width * layer.height * 4;
    if layer.rgba.len() != expected {
        return Err(format!("a layer: expected {expected} bytes, got {}", layer.rgba.len()).into());
    }
    let mut png = Cursor::new(vec![]);
    PngEncoder::new(&mut png).write_image(&layer.rgba, width, height, ExtendedColorType::Rgba8)?;
    Ok(png.into_inner().into())
}

fn png(bytes: Bytes) -> Response {
    ([(header::CONTENT_TYPE, "image/png")], bytes).into_response()
}
