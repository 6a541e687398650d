//! The page: what drives, shown in a browser, and what a person there may change.
//!
//! ```text
//! session, or drive's loop ─▶ Showing ─▶ newest moment ─▶ WebSocket, /api, /metrics
//!            ▲                                                   │
//!            └────── next frame ◀─ box of requests ◀─ checked ◀──┘
//! ```
//! | file | holds |
//! |---|---|
//! | `showing` | the driver's end: shows turns, takes requests; never waits for a page |
//! | `moment` | what is shown of one moment |
//! | `minute` | the last minute of turns, for a page that begins to watch |
//! | `control` | what may be asked for, and who can do it |
//! | `routes` | the paths: the page's files, `/api`, `/metrics`, `/healthz` |
//! | `runs`, `runs_routes` | recorded runs: listed, looked at, downloaded |
//! | `compared` | the steering of another model on the frames of a recorded run |
//! | `explained` | what networks look at, live and in recorded runs |
//! | `desk` | work that may take its time, on a thread of low priority |
//! | `socket` | `/live`: the newest moment and picture, as often as the reader keeps up |
//! | `course` | roads from above, for the map; where on them a car without a position seems to be |
//! | `counts`, `metrics` | numbers for Prometheus |
//! | `token` | the secret that is wanted where others can reach the port |
//! | `assets/` | the page's own files, as browsers get them |
//!
//! Who may connect at all is the bridge's business. No text of a request becomes a path: names are compared with those that
//! there are.

mod compared;
mod control;
mod counts;
mod course;
mod desk;
mod explained;
mod metrics;
mod minute;
mod moment;
mod routes;
mod runs;
mod runs_routes;
mod showing;
mod socket;
mod token;

use std::{
    fmt,
    net::IpAddr,
    path::Path,
    sync::{
        Arc, Mutex, OnceLock, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use serde::Serialize;
use tokio::sync::watch;

pub use control::{Abilities, Control, FASTEST_MPH, Offered, Refused, WeatherRange, WorldChoice};
pub use course::Course;
pub use explained::{Explaining, Explains, Layer, Looks};
pub use moment::RunFileStatus;
pub use routes::GREETING;
pub use showing::Showing;
pub use token::{NoToken, Token};

pub(crate) use routes::{ask_token, router};
pub(crate) use socket::live;

use crate::places::Places;
use counts::Counts;
use desk::Desk;
use lapwing_core::{
    pilot::{Model, Pilot},
    recording::ModelId,
};
use moment::{Moment, Status};
use runs::Runs;
use showing::Drive;

/// A drive and its moment.
type DriveNow = (Arc<Drive>, Arc<Moment>);

/// Makes a pilot anew.
type MakePilot = Box<dyn Fn() -> Box<dyn Pilot> + Send + Sync>;

/// A pilot that pages may switch to.
pub struct PilotChoice {
    /// Its name.
    pub name: String,
    /// SHA-256 of its file, if it has one.
    pub sha256: Option<String>,
    /// Makes one for one car.
    pub make: MakePilot,
    /// How it is shown what it looks at.
    pub explaining: Explaining,
}

/// Why a pilot is not shown pictures.
const BLIND: &str = "it does not look at the picture";

/// A pilot as pages are told of it.
#[derive(Serialize)]
struct PilotTold<'a> {
    name: &'a str,
    sha256: Option<&'a str>,
    /// Why recorded pictures are not shown to it; null if they can be.
    blind: Option<&'static str>,
    /// Why it cannot be shown what it looks at; null if it can be.
    unexplained: Option<&'a str>,
}

impl PilotChoice {
    /// As runs name their model; none if it has no file.
    pub fn id(&self) -> Option<ModelId> {
        let Self { name, sha256, .. } = self;
        Some(ModelId { name: name.clone(), sha256: sha256.clone()? })
    }

    /// Pilots of a model, which is explained so.
    pub fn of(model: Arc<dyn Model>, explaining: Explaining) -> Self {
        Self {
            name: model.name().to_owned(),
            sha256: Some(model.sha256().to_owned()),
            make: Box::new(move || model.pilot()),
            explaining,
        }
    }

    /// Why recorded pictures are not shown to it, if it does not look at any.
    fn why_blind(&self) -> Option<&'static str> {
        (!(self.make)().needs_picture()).then_some(BLIND)
    }

    fn told(&self) -> PilotTold<'_> {
        PilotTold {
            name: &self.name,
            sha256: self.sha256.as_deref(),
            blind: self.why_blind(),
            unexplained: self.explaining.why_not(),
        }
    }
}

impl fmt::Debug for PilotChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

/// What all pages share.
#[derive(Debug, Default)]
pub struct Page {
    drives: watch::Sender<Vec<Arc<Drive>>>,
    next_id: AtomicU64,
    pilots: OnceLock<Vec<PilotChoice>>,
    courses: watch::Sender<Arc<Vec<Course>>>,
    token: OnceLock<Token>,
    runs: OnceLock<Runs>,
    /// Counts of the drives that are over.
    ended: Mutex<Counts>,
    /// Pages that look now.
    open: Places<{ socket::PAGES }>,
    /// Pages that have looked so far, which numbers them.
    looked: AtomicU64,
    /// Recorded runs that are being shown to models.
    comparisons: Places<{ compared::AT_A_TIME }>,
    /// Where what is not urgent is done.
    desk: Desk,
}

impl Page {
    /// A page on which nothing drives yet.
    pub fn new() -> Arc<Self> {
        Arc::default()
    }

    /// The pilots that pages may switch among; the first one drives unless told otherwise. A second call is ignored.
    pub fn has_pilots(&self, pilots: Vec<PilotChoice>) {
        let _ = self.pilots.set(pilots);
    }

    /// The roads whose maps are drawn, and on which cars without a position are looked for.
    pub fn has_courses(&self, courses: Vec<Course>) {
        self.courses.send_replace(Arc::new(courses));
    }

    /// The folder whose runs are shown. A second call is ignored.
    pub fn has_runs(&self, dir: &Path) {
        let _ = self.runs.set(Runs::of(dir.to_owned()));
    }

    /// Takes no more work beside the drives, and waits until what was begun is done: until then the program must not end.
    pub(crate) async fn rests(&self) {
        self.desk.close().await;
    }

    fn runs(&self) -> Option<&Runs> {
        self.runs.get()
    }

    /// The token that is wanted where others can reach the port; made at the first call.
    ///
    /// # Errors
    /// [`NoToken`].
    pub fn want_token(&self) -> Result<&Token, NoToken> {
        if let Some(token) = self.token.get() {
            return Ok(token);
        }
        let token = Token::random()?;
        Ok(self.token.get_or_init(|| token))
    }

    /// The token that is wanted at this address; none where only this machine reaches it. Whoever can reach a port could
    /// look or steer, so it is not left to the caller.
    pub(crate) fn token_at(&self, address: IpAddr) -> Result<Option<Token>, NoToken> {
        if address.is_loopback() { Ok(None) } else { self.want_token().cloned().map(Some) }
    }

    /// A drive begins to be shown, as a tab of this name.
    pub fn show(self: &Arc<Self>, title: &str, can: Abilities) -> Showing {
        let id = self.next_id.fetch_add(1, Ordering::Relaxed) + 1;
        let status = Status { title: title.to_owned(), can, ..Status::default() };
        let showing = Showing::new(self.clone(), id, status);
        self.drives.send_modify(|drives| drives.push(showing.drive().clone()));
        showing
    }

    fn leaves(&self, drive: &Drive, counts: &Counts) {
        // Both at once: who reads the counts would miss the drive, or count it twice.
        let mut ended = self.ended.lock().unwrap_or_else(PoisonError::into_inner);
        self.drives.send_modify(|drives| drives.retain(|other| other.id != drive.id));
        ended.add(counts);
    }

    /// The counts of the drives that are over, and the others with their moments.
    fn counted(&self) -> (Counts, Vec<DriveNow>) {
        let ended = self.ended.lock().unwrap_or_else(PoisonError::into_inner);
        (*ended, self.drives().into_iter().map(|drive| (drive.clone(), drive.now())).collect())
    }

    fn drives(&self) -> Vec<Arc<Drive>> {
        self.drives.borrow().clone()
    }

    fn drive(&self, id: u64) -> Result<Arc<Drive>, Refused> {
        self.drives.borrow().iter().find(|drive| drive.id == id).cloned().ok_or(Refused::Gone(id))
    }

    /// The pilots that pages may switch among; none while they are loaded.
    pub fn pilots(&self) -> &[PilotChoice] {
        self.pilots.get().map_or(&[], Vec::as_slice)
    }

    fn pilot(&self, index: usize) -> Result<&PilotChoice, Refused> {
        self.pilots().get(index).ok_or_else(|| Refused::no_pilot(index, self.pilots().len()))
    }

    fn courses(&self) -> Arc<Vec<Course>> {
        self.courses.borrow().clone()
    }
}

#[cfg(test)]
mod tests;
