//! The page's paths. Its files are in the program; what a path names is looked up in tables, never on a disk.

use std::sync::Arc;

use axum::{
    Router,
    body::{Body, to_bytes},
    extract::{Path, Request, State},
    http::{HeaderName, HeaderValue, Method, StatusCode, header},
    middleware::{self, Next},
    response::{IntoResponse, Response},
    routing::{get, post},
};
use serde::Serialize;
use serde_json::json;

use super::{
    Page, PilotChoice, Token, compared,
    control::{Control, Refused},
    explained, metrics,
    moment::{Facts, Happened, Status},
    runs_routes,
};
use lapwing_score::score::{
    Scorecard,
    page::{COLOURS, SHARED, UPLOT, UPLOT_STYLE},
};

/// Bytes of a request's body; a control has under 1 KiB.
const BODY: usize = 4 << 10;

/// What a program that is no browser is told at `/`.
pub const GREETING: &str = "Lapwing is here. Start the simulator in autonomous mode.\n";

const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

/// The page's files: path, content type, content.
const FILES: [(&str, &str, &str); 18] = [
    ("/page/colours.css", STYLE, COLOURS),
    ("/page/uplot.css", STYLE, UPLOT_STYLE),
    ("/page/page.css", STYLE, include_str!("assets/page.css")),
    ("/page/uplot.js", SCRIPT, UPLOT),
    ("/page/shared.js", SCRIPT, SHARED),
    ("/page/elements.js", SCRIPT, include_str!("assets/elements.js")),
    ("/page/gauges.js", SCRIPT, include_str!("assets/gauges.js")),
    ("/page/curves.js", SCRIPT, include_str!("assets/curves.js")),
    ("/page/map.js", SCRIPT, include_str!("assets/map.js")),
    ("/page/controls.js", SCRIPT, include_str!("assets/controls.js")),
    ("/page/wheel.js", SCRIPT, include_str!("assets/wheel.js")),
    ("/page/runs.js", SCRIPT, include_str!("assets/runs.js")),
    ("/page/together.js", SCRIPT, include_str!("assets/together.js")),
    ("/page/compared.js", SCRIPT, include_str!("assets/compared.js")),
    ("/page/run_curves.js", SCRIPT, include_str!("assets/run_curves.js")),
    ("/page/looks.js", SCRIPT, include_str!("assets/looks.js")),
    ("/page/player.js", SCRIPT, include_str!("assets/player.js")),
    ("/page/page.js", SCRIPT, include_str!("assets/page.js")),
];
const INDEX: &str = include_str!("assets/index.html");
const OPENAPI: &str = include_str!("openapi.json");

/// Nothing from elsewhere, no script in the text of the page, no frame around it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
     connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// All paths but `/live`, which needs the connection.
pub(crate) fn router(page: Arc<Page>) -> Router {
    let files = FILES.into_iter().fold(Router::new(), |router, (path, kind, content)| {
        router.route(path, get(move || async move { ([(header::CONTENT_TYPE, kind)], content) }))
    });
    let api = Router::new()
        .route("/", get(index))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/metrics", get(scrape))
        .route("/api/openapi.json", get(|| async { json_text(OPENAPI.to_owned()) }))
        .route("/api/state", get(state))
        .route("/api/drives/{id}", get(drive))
        .route("/api/drives/{id}/score", get(score))
        .route("/api/drives/{id}/picture", get(picture))
        .route("/api/drives/{id}/explained/{looks}", get(explained::of_drive))
        .route("/api/drives/{id}/control", post(control))
        .route("/api/runs/{name}/frames/{n}/explained/{looks}/{pilot}", get(explained::of_run))
        .route("/api/runs/{name}/compared/{pilot}", get(compared::with_model))
        .merge(runs_routes::router())
        .with_state(page);
    files.merge(api).layer(middleware::map_response(with_policy))
}

async fn with_policy(mut response: Response) -> Response {
    let headers: [(HeaderName, &'static str); 5] = [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
    ];
    for (name, value) in headers {
        // A report has a policy of its own.
        response.headers_mut().entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
}

/// Asks for the token, where there is one: for all that shows a picture or a drive, and for all that changes something.
/// The simulator's own path cannot have one.
pub(crate) async fn ask_token(State(token): State<Option<Token>>, request: Request, next: Next) -> Response {
    let known = |token: &Token| token.is_known(request.uri(), request.headers());
    if is_open(request.method(), request.uri().path()) || token.as_ref().is_none_or(known) {
        return next.run(request).await;
    }
    let why = "expected the token that was printed at the start, as Authorization: Bearer TOKEN or ?token=TOKEN\n";
    (StatusCode::UNAUTHORIZED, [(header::WWW_AUTHENTICATE, "Bearer")], why).into_response()
}

fn is_open(method: &Method, path: &str) -> bool {
    let shows_nothing = ["/", "/healthz", "/api/openapi.json"];
    path.starts_with("/socket.io")
        || (method.is_safe() && (shows_nothing.contains(&path) || FILES.iter().any(|(file, ..)| *file == path)))
}

/// The page, for a browser; others are greeted.
async fn index(request: Request) -> Response {
    let accepts = request.headers().get(header::ACCEPT).and_then(|value| value.to_str().ok()).unwrap_or("");
    match accepts.contains("text/html") {
        true => ([(header::CONTENT_TYPE, "text/html; charset=utf-8")], INDEX).into_response(),
        false => GREETING.into_response(),
    }
}

pub(super) fn json_text(text: String) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], text).into_response()
}

pub(super) fn json_of(value: &impl Serialize) -> Response {
    match serde_json::to_string(value) {
        Ok(text) => json_text(text),
        Err(error) => {
            tracing::error!("an answer of /api could not be written: {error}");
            StatusCode::INTERNAL_SERVER_ERROR.into_response()
        }
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        let status = match &self {
            Self::Cannot(_) => StatusCode::CONFLICT,
            Self::Value { .. } | Self::Unknown(_) => StatusCode::BAD_REQUEST,
            Self::Gone(_) => StatusCode::NOT_FOUND,
            Self::Busy(_) | Self::Comparing(_) => StatusCode::SERVICE_UNAVAILABLE,
        };
        (status, json_text(json!({ "error": self.to_string() }).to_string())).into_response()
    }
}

/// A drive as `/api` shows it.
#[derive(Serialize)]
struct Shown<'a> {
    id: u64,
    status: &'a Status,
    turn: &'a Option<Facts>,
    events: &'a [Happened],
}

async fn scrape(State(page): State<Arc<Page>>) -> Response {
    match metrics::text(&page).await {
        Ok(text) => ([(header::CONTENT_TYPE, metrics::TYPE)], text).into_response(),
        Err(error) => {
            tracing::error!("the metrics could not be written: {error}");
            StatusCode::INTERNAL_SERVER_ERROR.into_response()
        }
    }
}

async fn state(State(page): State<Arc<Page>>) -> Response {
    let drives: Vec<_> = page.drives().iter().map(|drive| (drive.id, drive.now())).collect();
    let shown = |(id, now): &(u64, Arc<super::moment::Moment>)| json!({ "id": id, "title": now.status.title, "dialect": now.status.dialect, "phase": now.status.phase });
    let pilots: Vec<_> = page.pilots().iter().map(PilotChoice::told).collect();
    let version = env!("CARGO_PKG_VERSION");
    let drives: Vec<_> = drives.iter().map(shown).collect();
    json_of(&json!({ "version": version, "drives": drives, "pilots": pilots }))
}

async fn drive(State(page): State<Arc<Page>>, Path(id): Path<u64>) -> Result<Response, Refused> {
    let now = page.drive(id)?.now();
    Ok(json_of(&Shown { id, status: &now.status, turn: &now.turn, events: &now.events }))
}

/// The score so far, and its rows for people.
pub(super) fn scored(card: &Scorecard) -> serde_json::Value {
    json!({ "card": card, "rows": card.known_rows() })
}

async fn score(State(page): State<Arc<Page>>, Path(id): Path<u64>) -> Result<Response, Refused> {
    let scorer = page.drive(id)?.scorer().await.ok_or_else(|| Refused::Cannot("nothing has been driven yet".into()))?;
    Ok(json_of(&scored(&(*scorer).clone().finish())))
}

async fn picture(State(page): State<Arc<Page>>, Path(id): Path<u64>) -> Result<Response, Refused> {
    let jpeg = page.drive(id)?.now().jpeg.clone();
    let jpeg = jpeg.ok_or_else(|| Refused::Cannot("no picture has come yet".into()))?;
    Ok(([(header::CONTENT_TYPE, "image/jpeg")], Body::from(jpeg)).into_response())
}

async fn control(State(page): State<Arc<Page>>, Path(id): Path<u64>, body: Body) -> Result<Response, Refused> {
    let most = |_| Refused::Unknown(format!("a body of at most {BODY} bytes"));
    let control = Control::read(&to_bytes(body, BODY).await.map_err(most)?)?;
    page.drive(id)?.ask(&page, control)?;
    Ok((StatusCode::ACCEPTED, json_text(json!({ "asked": true }).to_string())).into_response())
}
