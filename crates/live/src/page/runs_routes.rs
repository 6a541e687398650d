//! The paths of recorded runs: `/api/runs` and below.

use std::{fs::File, io::Read, sync::Arc};

use axum::{
    Router,
    body::Body,
    extract::{Path, State},
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
    routing::get,
};
use bytes::Bytes;
use futures_util::stream::try_unfold;
use serde_json::json;
use tokio::task::spawn_blocking;

use super::{
    Course, Page,
    routes::{json_of, json_text},
    runs::{Runs, RunsError},
};

/// Bytes of a file that are read at a time.
const CHUNK: usize = 256 << 10;

/// A report is a page of its own, with its scripts in it; it gets no access to ours.
const REPORT_POLICY: &str =
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:";

pub(super) fn router() -> Router<Arc<Page>> {
    Router::new()
        .route("/api/runs", get(list))
        .route("/api/runs/{name}", get(opened))
        .route("/api/runs/{name}/glance", get(glance))
        .route("/api/runs/{name}/glance/picture", get(glance_picture))
        .route("/api/runs/{name}/frames/{n}", get(frame))
        .route("/api/runs/{name}/file", get(file))
        .route("/api/runs/{name}/report", get(report))
}

impl IntoResponse for RunsError {
    fn into_response(self) -> Response {
        let status = match &self {
            Self::None | Self::Unknown | Self::Frame { .. } => StatusCode::NOT_FOUND,
            Self::Folder(_) | Self::File(_) | Self::Recording(_) | Self::Report(_) => StatusCode::INTERNAL_SERVER_ERROR,
        };
        // Not with the path of the folder, which is nobody's business.
        let why = match &self {
            Self::Recording(error) => without_folder(&error.to_string()),
            other => other.to_string(),
        };
        if status == StatusCode::INTERNAL_SERVER_ERROR {
            tracing::warn!("the page could not show a run: {self}");
        }
        (status, json_text(json!({ "error": why }).to_string())).into_response()
    }
}

/// What is wrong with a run, with its name alone in place of its path.
fn without_folder(error: &str) -> String {
    let end = error.find(".mcap").unwrap_or_default();
    let start = error[..end].rfind(['/', std::path::MAIN_SEPARATOR]).map_or(0, |at| at + 1);
    if end == 0 { "the run cannot be read".to_owned() } else { error[start..].to_owned() }
}

/// Reads from the folder of runs where that delays nobody, one after the other.
pub(super) async fn read<T: Send + 'static>(
    page: Arc<Page>,
    work: impl FnOnce(&Runs, &[Course]) -> Result<T, RunsError> + Send + 'static,
) -> Result<T, RunsError> {
    let runs = page.runs().ok_or(RunsError::None)?;
    // It is never closed; if it were, all could read at once.
    let _turn = runs.reading.acquire().await.ok();
    let reader = page.clone();
    let read = spawn_blocking(move || reader.runs().map_or(Err(RunsError::None), |runs| work(runs, &reader.courses())));
    read.await.unwrap_or_else(|error| Err(RunsError::File(error.into())))
}

async fn list(State(page): State<Arc<Page>>) -> Result<Response, RunsError> {
    Ok(json_of(&read(page, |runs, _| runs.list()).await?))
}

async fn glance(State(page): State<Arc<Page>>, Path(name): Path<String>) -> Result<Response, RunsError> {
    Ok(json_of(&*read(page, move |runs, _| runs.glance(&name)).await?))
}

async fn glance_picture(State(page): State<Arc<Page>>, Path(name): Path<String>) -> Result<Response, RunsError> {
    let picture = read(page, move |runs, _| Ok(runs.glance(&name)?.picture.clone())).await?;
    picture.map(jpeg).ok_or(RunsError::Frame { last: 0, got: 0 })
}

async fn opened(State(page): State<Arc<Page>>, Path(name): Path<String>) -> Result<Response, RunsError> {
    Ok(json_of(&*read(page, move |runs, courses| runs.open(&name, courses)).await?))
}

async fn frame(State(page): State<Arc<Page>>, Path((name, n)): Path<(String, usize)>) -> Result<Response, RunsError> {
    let frame = read(page, move |runs, courses| runs.open(&name, courses)?.frame(n)).await?;
    Ok(jpeg(frame))
}

fn jpeg(bytes: Bytes) -> Response {
    ([(header::CONTENT_TYPE, "image/jpeg")], Body::from(bytes)).into_response()
}

async fn report(State(page): State<Arc<Page>>, Path(name): Path<String>) -> Result<Response, RunsError> {
    let html = read(page, move |runs, courses| runs.report(&name, courses)).await?;
    let headers =
        [(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, REPORT_POLICY)];
    Ok((headers, html).into_response())
}

/// The run's file, as it is now.
async fn file(State(page): State<Arc<Page>>, Path(name): Path<String>) -> Result<Response, RunsError> {
    let (path, bytes) = {
        let name = name.clone();
        read(page, move |runs, _| runs.find(&name)).await?
    };
    let opened = spawn_blocking(move || File::open(path)).await.unwrap_or_else(|error| Err(error.into()));
    let file = opened.map_err(RunsError::File)?;
    // A run that is being recorded grows; what is sent is as long as was said.
    let chunks = try_unfold((file, bytes), |(mut file, left)| async move {
        let chunk = spawn_blocking(move || {
            let mut chunk = vec![0; CHUNK.min(usize::try_from(left).unwrap_or(CHUNK))];
            let read = file.read(&mut chunk)?;
            chunk.truncate(read);
            Ok::<_, std::io::Error>((chunk, file))
        });
        let (chunk, file) = chunk.await.unwrap_or_else(|error| Err(error.into()))?;
        let left = left - chunk.len() as u64;
        Ok::<_, std::io::Error>((!chunk.is_empty()).then(|| (Bytes::from(chunk), (file, left))))
    });
    let mut response = (
        [(header::CONTENT_TYPE, "application/octet-stream"), (header::CONTENT_DISPOSITION, "attachment")],
        Body::from_stream(chunks),
    )
        .into_response();
    response.headers_mut().insert(header::CONTENT_LENGTH, HeaderValue::from(bytes));
    let is_plain = name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
    if let (true, Ok(named)) = (is_plain, HeaderValue::from_str(&format!("attachment; filename=\"{name}\""))) {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, named);
    }
    Ok(response)
}
