//! The server: one port for every build of the simulator and for every ordinary
//! Socket.IO client.
//!
//! ```text
//! Listener (TCP_QUICKACK) ─▶ door ─▶ gate ─┬─▶ simulator: our own WebSocket handler ─┬─▶ Session ─▶ Driver
//!                                          └─▶ clients: socketioxide ────────────────┘       └────▶ Account: Recorder, Scorer
//! ```
//! | file | holds |
//! |---|---|
//! | `listener`, `guests` | the port; how many connections it has |
//! | `door` | refuses web pages other than our own |
//! | `foxglove` | the port for viewers |
//! | `gate` | tells simulators from other clients by what they send first |
//! | `frames`, `load` | watch what arrives: its size, and the memory it takes |
//! | `simulator`, `liveness`, `tokens` | a simulator's WebSocket, its silences, its game of tokens |
//! | `clients` | every other Socket.IO client |
//! | `session`, `waiting` | one connection's drive: dialect, driver state, run; answers before it begins |
//! | `account` | the run's file, scorecard and summary |
//! | `throttled` | log lines that may come thousands of times a second |
//!
//! All sessions share the weights.

mod account;
mod clients;
mod door;
mod foxglove;
mod frames;
mod gate;
mod guests;
mod listener;
mod liveness;
mod load;
mod session;
mod simulator;
mod throttled;
mod tokens;
mod waiting;

pub use account::Summary;
pub use foxglove::serve_foxglove;
pub use listener::{BindError, Holder, Listener, reached_here};

use std::{
    collections::{HashMap, HashSet},
    convert::Infallible,
    fmt, io,
    net::{IpAddr, SocketAddr},
    sync::{
        Arc, Mutex, OnceLock, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use axum::{
    Extension, Router,
    extract::{self, State},
    http::{Request, StatusCode},
    middleware,
    response::{IntoResponse, Response},
    routing::{get, post},
};
use guests::{Guests, Peer, Role};
use hyper::{body::Incoming, server::conn::http1};
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use load::InFlight;
use tokio::sync::{Notify, watch};
use tower::ServiceExt;

use crate::{
    page::{self, Page, PilotChoice},
    viewers::Viewers,
};
use lapwing_core::{
    config::Settings, guard::GuardModel, pilot::Model, protocol::Dialect, recording::Roadway, words::count,
};
use lapwing_score::odometry::Road;

/// How many simulators may be introduced in the log within ten seconds.
const NEWCOMERS: u64 = 64;

/// How long connections may take to close their runs once the bridge stops.
const CLOSING: Duration = Duration::from_secs(10);

/// The largest head of a request, in bytes; a browser's is under 2 KiB.
const HEAD: usize = 32 << 10;

/// The state shared by all connections.
pub struct Bridge {
    settings: Settings,
    models: OnceLock<Vec<Arc<dyn Model>>>,
    page: Arc<Page>,
    guard: OnceLock<Box<dyn GuardModel>>,
    roads: OnceLock<Vec<Arc<Road>>>,
    roadways: OnceLock<Arc<[Roadway]>>,
    viewers: OnceLock<Arc<Viewers>>,
    on_summary: Box<dyn Fn(&Summary) + Send + Sync>,
    connections: Mutex<HashMap<u64, Connection>>,
    guests: Arc<Guests>,
    in_flight: Arc<InFlight>,
    next_id: AtomicU64,
    stop: watch::Sender<bool>,
    all_closed: Notify,
    /// Addresses of simulators whose last connection ended with kicks that may not have been read; these become tokens
    /// of the next one.
    kicked: Mutex<HashSet<IpAddr>>,
    /// Log lines about simulators that connected and sent something.
    newcomers: throttled::Throttled,
    /// Log lines about those recognised because they talk first.
    strangers: throttled::Throttled,
    /// Log lines about other clients that connected.
    clients: throttled::Throttled,
    /// Log lines about connections that ended without a telemetry.
    wordless: throttled::Throttled,
    /// Log lines about requests that were refused.
    refused: throttled::Throttled,
    /// Log lines about clients that asked for too much.
    dropped: throttled::Throttled,
}

/// What the bridge knows about a connection outside its task.
#[derive(Clone)]
struct Connection {
    peer: IpAddr,
    simulator: bool,
    /// Known from its first telemetry.
    dialect: Option<Dialect>,
    signals: Arc<Signals>,
}

/// Signals from others to a connection.
#[derive(Default)]
struct Signals {
    /// Let the pilot drive again.
    arm: AtomicBool,
    /// A newer connection from the same address plays the same simulator.
    newer: Notify,
}

/// A connection's place among the others; leaves when dropped.
struct Presence {
    bridge: Arc<Bridge>,
    id: u64,
    simulator: bool,
    signals: Arc<Signals>,
}

impl Bridge {
    /// A bridge without a model yet: until [`Bridge::model_is_ready`] cars are braked to a standstill.
    /// `on_summary` is called at the end of each run.
    pub fn new(settings: Settings, on_summary: impl Fn(&Summary) + Send + Sync + 'static) -> Arc<Self> {
        let limits = &settings.bridge.limits;
        let page = Page::new();
        if settings.recording.enabled {
            page.has_runs(&settings.recording.dir);
        }
        Arc::new(Self {
            guests: Guests::new(limits.connections()),
            in_flight: InFlight::new(limits),
            settings,
            models: OnceLock::new(),
            page,
            guard: OnceLock::new(),
            roads: OnceLock::new(),
            roadways: OnceLock::new(),
            viewers: OnceLock::new(),
            on_summary: Box::new(on_summary),
            connections: Mutex::default(),
            next_id: AtomicU64::new(1),
            stop: watch::Sender::new(false),
            all_closed: Notify::new(),
            kicked: Mutex::default(),
            newcomers: throttled::Throttled::of(NEWCOMERS),
            strangers: throttled::Throttled::default(),
            clients: throttled::Throttled::default(),
            wordless: throttled::Throttled::default(),
            refused: throttled::Throttled::default(),
            dropped: throttled::Throttled::default(),
        })
    }

    /// The page on which its drives are shown.
    pub fn page(&self) -> &Arc<Page> {
        &self.page
    }

    /// Hands the model to all connections, present and future. A second one is ignored.
    pub fn model_is_ready(&self, model: impl Model + 'static) {
        self.models_are_ready(vec![(Arc::new(model), page::Explaining::not("nobody said how"))]);
    }

    /// The same with several, each with how it is explained, of which the first drives until a person at the page chooses
    /// another.
    pub fn models_are_ready(&self, models: Vec<(Arc<dyn Model>, page::Explaining)>) {
        self.page.has_pilots(models.iter().cloned().map(|(model, how)| PilotChoice::of(model, how)).collect());
        let _ = self.models.set(models.into_iter().map(|(model, _)| model).collect());
    }

    /// Sets the guard that may brake in place of the pilot, for drives that begin from now on: those that should have it
    /// begin with the model, so hand it over before that. A second one is ignored.
    pub fn guard_is_ready(&self, guard: Box<dyn GuardModel>) {
        let _ = self.guard.set(guard);
    }

    /// Sets the known roads, whose lengths show where laps end, for drives that begin from now on. A second call is
    /// ignored.
    pub fn roads_are_known(&self, roads: Vec<Arc<Road>>) {
        let _ = self.roads.set(roads);
    }

    fn roads(&self) -> &[Arc<Road>] {
        self.roads.get().map_or(&[], Vec::as_slice)
    }

    /// Sets the roads that runs hold for viewers if a drive tells its track and positions. A second call is ignored.
    pub fn roadways_are_known(&self, roadways: Arc<[Roadway]>) {
        let _ = self.roadways.set(roadways);
    }

    /// Shows its drives to viewers, too, from those that begin from now on. A second call is ignored.
    pub fn has_viewers(&self, viewers: Arc<Viewers>) {
        let _ = self.viewers.set(viewers);
    }

    /// Arms the pilots that a human's takeover has switched off (`--takeover latch`), from their next telemetry on.
    pub fn arm(&self) {
        for connection in self.connections().values() {
            connection.signals.arm.store(true, Ordering::Relaxed);
        }
    }

    /// Resolves once the bridge stops.
    async fn stopped(self: Arc<Self>) {
        // An error means that the sender is gone, which is this bridge itself.
        let _ = self.stop.subscribe().wait_for(|stop| *stop).await;
    }

    fn connections(&self) -> std::sync::MutexGuard<'_, HashMap<u64, Connection>> {
        self.connections.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn kicked(&self) -> std::sync::MutexGuard<'_, HashSet<IpAddr>> {
        self.kicked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Logs that a client exceeds its limits or sends something that is not allowed.
    fn turned_away(&self, peer: SocketAddr, why: impl fmt::Display) {
        if let Some(more) = self.dropped.due(Instant::now()) {
            tracing::warn!("{peer} is turned away: {why}{more}");
        }
    }

    /// Registers a new connection.
    fn enter(self: &Arc<Self>, peer: SocketAddr, simulator: bool) -> Presence {
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let signals = Arc::<Signals>::default();
        let connection = Connection { peer: peer.ip(), simulator, dialect: None, signals: signals.clone() };
        self.connections().insert(id, connection);
        Presence { bridge: self.clone(), id, simulator, signals }
    }
}

impl Presence {
    /// This connection plays. Older ones from its address that play the same simulator are notified: a silent one may
    /// belong to the same simulator, which has left the scene and come back.
    fn plays(&self, dialect: Dialect) {
        let mut connections = self.bridge.connections();
        let Some(this) = connections.get_mut(&self.id).filter(|this| this.simulator) else { return };
        this.dialect = Some(dialect);
        let peer = this.peer;
        let same = |c: &Connection| c.simulator && c.peer == peer && c.dialect == Some(dialect);
        for (_, older) in connections.iter().filter(|(id, other)| **id < self.id && same(other)) {
            older.signals.newer.notify_one();
        }
    }
}

impl Drop for Presence {
    fn drop(&mut self) {
        let mut connections = self.bridge.connections();
        connections.remove(&self.id);
        if connections.is_empty() {
            self.bridge.all_closed.notify_waiters();
        }
    }
}

/// Serves until `shutdown` is ready, then ends all runs and returns. On an address that others can reach, the page and
/// all that changes something wants [a token](Page::want_token).
///
/// # Errors
/// If runs could not be closed in time because a disk does not respond, or if there is no token. Errors of single connections are handled there.
pub async fn serve(
    listener: Listener,
    bridge: Arc<Bridge>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> io::Result<()> {
    let simulators = gate::service(bridge.clone());
    serve_with(listener, bridge, simulators, shutdown).await
}

/// Serves the page alone: no simulator may connect.
///
/// # Errors
/// Those of [`serve`].
pub async fn serve_page(
    listener: Listener,
    bridge: Arc<Bridge>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> io::Result<()> {
    let nobody = Router::new().fallback(|| async { StatusCode::NOT_FOUND });
    serve_with(listener, bridge, nobody, shutdown).await
}

async fn serve_with(
    listener: Listener,
    bridge: Arc<Bridge>,
    others: Router,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> io::Result<()> {
    let address = listener.address().ip();
    let token = bridge.page.token_at(address).map_err(io::Error::other)?;
    let door = door::Door { bridge: bridge.clone(), bound: address, port: door::Port::Bridge };
    let app = Router::new()
        .route("/arm", post(arm))
        .route("/live", get(live))
        .with_state(bridge.clone())
        .merge(page::router(bridge.page.clone()))
        .fallback_service(others)
        .layer(middleware::from_fn_with_state(token, page::ask_token))
        .layer(middleware::from_fn_with_state(door, door::ask));
    let stop = bridge.clone();
    let ended = async move {
        shutdown.await;
        stop.stop.send_replace(true);
    };
    tokio::select! {
        never = accept(&listener, &app, &bridge) => match never {},
        () = ended => {}
    }
    bridge.page.rests().await;
    let deadline = Instant::now() + CLOSING;
    loop {
        let closed = bridge.all_closed.notified();
        let left = bridge.connections().len();
        if left == 0 {
            return Ok(());
        }
        if Instant::now() > deadline {
            let why = format!(
                "{} not closed within {CLOSING:?}; what is in the files so far can be read",
                count(left, "run")
            );
            return Err(io::Error::new(io::ErrorKind::TimedOut, why));
        }
        let _ = tokio::time::timeout(Duration::from_millis(200), closed).await;
    }
}

/// Accepts every connection.
async fn accept(listener: &Listener, app: &Router, bridge: &Bridge) -> Infallible {
    // Not axum's own loop, which waits forever for a request's head, and for the next request.
    let mut http = http1::Builder::new();
    let limits = &bridge.settings.bridge.limits;
    http.timer(TokioTimer::new()).header_read_timeout(limits.patience()).max_buf_size(HEAD);
    loop {
        let (stream, address) = listener.accept().await;
        let Some((seat, peer)) = bridge.guests.admit(address).await else { continue };
        let service = app.clone().map_request(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(peer.clone());
            request
        });
        let connection = http
            .serve_connection(TokioIo::new(stream.seated(seat, limits.patience())), TowerToHyperService::new(service))
            .with_upgrades();
        tokio::spawn(async move {
            if let Err(error) = connection.await {
                tracing::debug!("{address}: {error}");
            }
        });
    }
}

/// A page that looks; its connection may be as quiet as a simulator's.
async fn live(
    State(bridge): State<Arc<Bridge>>,
    Extension(peer): Extension<Peer>,
    request: extract::Request,
) -> Response {
    let response = page::live(bridge.page.clone(), request);
    if response.status() == StatusCode::SWITCHING_PROTOCOLS {
        peer.is(Role::Page);
    }
    response.into_response()
}

async fn arm(State(bridge): State<Arc<Bridge>>) -> &'static str {
    bridge.arm();
    "armed\n"
}
