//! `/live`: a drive as it happens.
//!
//! To the page go JSON texts, told apart by `kind`: `drives` (the tabs), `status`, `course`, `minute` (the turns of the
//! last minute, once, when the page begins to watch a drive), `events`, `score` and `moment`; a picture follows its
//! moment as a binary message, the JPEG bytes as they came. `wheel` tells a page that wants to drive by hand that
//! another one does. The page says `{"watch":id}`, `{"seen":n}` for each moment, and
//! `{"hand":{"steering":…,"throttle":…}}` or `{"hand":null}`.
//!
//! A moment is sent only once the page has seen the one before the last: a slow reader gets the newest and skips the
//! rest, and a stalled one costs nothing.

use std::{
    sync::{Arc, PoisonError, atomic::Ordering},
    time::Duration,
};

use axum::{
    extract::Request,
    http::StatusCode,
    response::{IntoResponse, Response},
};
use bytes::Bytes;
use futures_util::StreamExt;
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::{
    sync::watch,
    time::{Instant, sleep_until},
};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        self, Message,
        protocol::{Role, WebSocketConfig},
    },
};

use super::{
    Page, PilotChoice,
    control::ByHand,
    course::Place as CarPlace,
    minute::Past,
    moment::{Facts, Moment},
    routes::scored,
    showing::Drive,
};
use crate::{
    places::Place,
    websocket::{self, Chatter, Socket},
};

/// Pages that may look at a time.
pub(super) const PAGES: u32 = 16;
/// Bytes of a page's message.
const LARGEST: usize = 1 << 10;
/// Messages that a page may send within a second; one that drives by hand sends about 90.
const CHATTY: u32 = 300;
/// Moments on their way.
const IN_FLIGHT: u64 = 2;
/// Time between two moments: 60 a second.
const EVERY: Duration = Duration::from_micros(16_600);
/// A page that takes nothing, or says nothing, for this long is gone.
const GONE: Duration = Duration::from_secs(60);
const TAKES: Duration = Duration::from_secs(5);

/// What a page says.
#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Said {
    /// A moment's number.
    Seen(u64),
    /// A drive's number.
    Watch(u64),
    Hand(Option<ByHand>),
}

/// Answers a request for `/live`.
pub(crate) fn live(page: Arc<Page>, request: Request) -> Response {
    if !websocket::is_asked(&request) {
        return (StatusCode::UPGRADE_REQUIRED, "expected Upgrade: websocket\n").into_response();
    }
    let Some(place) = page.open.take() else {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{PAGES} pages look already\n")).into_response();
    };
    websocket::open(request, move |socket| async move {
        if let Err(error) = serve(socket, page, place).await {
            tracing::debug!("a page is gone: {error}");
        }
    })
}

async fn serve(socket: Socket, page: Arc<Page>, _place: Place) -> Result<(), tungstenite::Error> {
    let config = WebSocketConfig::default().read_buffer_size(4 << 10).max_message_size(Some(LARGEST));
    let socket = WebSocketStream::from_raw_socket(socket, Role::Server, Some(config)).await;
    let id = page.looked.fetch_add(1, Ordering::Relaxed) + 1;
    let mut viewer = Viewer { socket, page, id, watched: None, refused: false };
    let ended = viewer.run().await;
    viewer.let_go();
    ended
}

struct Viewer {
    socket: WebSocketStream<Socket>,
    page: Arc<Page>,
    /// Its number, from 1.
    id: u64,
    watched: Option<Watched>,
    /// Whether it was refused the wheel, which another page has, and was told so.
    refused: bool,
}

/// The drive that a page looks at, and what it has seen of it.
struct Watched {
    drive: Arc<Drive>,
    newest: watch::Receiver<Arc<Moment>>,
    /// The number of the last moment sent, and of the last one that the page has seen, in messages.
    sent: u64,
    seen: u64,
    last: Arc<Moment>,
    happened: u64,
    /// The name of the course that its map shows.
    course: Option<String>,
    is_new: bool,
}

impl Viewer {
    async fn run(&mut self) -> Result<(), tungstenite::Error> {
        let mut drives = self.page.drives.subscribe();
        drives.mark_changed();
        let mut due = Instant::now();
        let mut heard = Instant::now();
        let mut chatter = Chatter::of(CHATTY);
        loop {
            let ready = self.watched.as_ref().is_some_and(|watched| watched.sent < watched.seen + IN_FLIGHT);
            let changed = async {
                sleep_until(due).await;
                match &mut self.watched {
                    // What is watched is kept here, and with it the sender.
                    Some(watched) => drop(watched.newest.changed().await),
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                message = self.socket.next() => {
                    let text = match message {
                        None | Some(Ok(Message::Close(_))) => return Ok(()),
                        Some(Err(error)) => return Err(error),
                        Some(Ok(Message::Text(text))) => Some(text),
                        Some(Ok(_)) => None,
                    };
                    if chatter.is_too_much() {
                        return self.close("expected fewer messages").await;
                    }
                    let Some(text) = text else { continue };
                    heard = Instant::now();
                    match serde_json::from_str(&text) {
                        Ok(said) => self.hear(said).await?,
                        Err(_) => return self.close("expected seen, watch or hand, as JSON").await,
                    }
                }
                changed = drives.changed() => {
                    if changed.is_err() {
                        return Ok(());
                    }
                    drives.borrow_and_update();
                    self.tabs().await?;
                }
                () = changed, if ready => {
                    due = Instant::now() + EVERY;
                    self.moment().await?;
                }
                () = sleep_until(heard + GONE) => return self.close("nothing was heard for a minute").await,
            }
        }
    }

    async fn hear(&mut self, said: Said) -> Result<(), tungstenite::Error> {
        match (said, &mut self.watched) {
            (Said::Seen(n), Some(watched)) => watched.seen = watched.seen.max(n.min(watched.sent)),
            (Said::Watch(id), _) => {
                if let Ok(drive) = self.page.drive(id) {
                    self.let_go();
                    self.watch(drive);
                }
            }
            (Said::Hand(hand), Some(watched)) => {
                let is_mine = watched.drive.by_hand(self.id, hand.map(ByHand::command));
                let told = std::mem::replace(&mut self.refused, hand.is_some() && !is_mine);
                if self.refused && !told {
                    self.say(&json!({ "kind": "wheel", "why": "another page drives by hand" })).await?;
                }
            }
            (Said::Seen(_) | Said::Hand(_), None) => {}
        }
        Ok(())
    }

    fn watch(&mut self, drive: Arc<Drive>) {
        let mut newest = drive.newest.subscribe();
        newest.mark_changed();
        let last = Arc::default();
        self.watched = Some(Watched { drive, newest, sent: 0, seen: 0, last, happened: 0, course: None, is_new: true });
    }

    /// A page that leaves takes no wheel along.
    fn let_go(&mut self) {
        self.refused = false;
        if let Some(watched) = &self.watched {
            watched.drive.by_hand(self.id, None);
        }
    }

    /// Tells which drives there are; looks at the last if at none yet, or at one that has left.
    async fn tabs(&mut self) -> Result<(), tungstenite::Error> {
        let drives = self.page.drives();
        let is_there = |watched: &Watched| drives.iter().any(|drive| drive.id == watched.drive.id);
        if !self.watched.as_ref().is_some_and(is_there)
            && let Some(drive) = drives.last()
        {
            self.let_go();
            self.watch(drive.clone());
        }
        let tabs: Vec<_> =
            drives.iter().map(|drive| json!({ "id": drive.id, "title": drive.now().status.title })).collect();
        let watched = self.watched.as_ref().map(|watched| watched.drive.id);
        self.say(&json!({ "kind": "drives", "drives": tabs, "watched": watched })).await
    }

    /// Sends the newest moment, and what has changed with it.
    async fn moment(&mut self) -> Result<(), tungstenite::Error> {
        let Some(watched) = &mut self.watched else { return Ok(()) };
        let now = watched.newest.borrow_and_update().clone();
        let mut texts = vec![];
        let id = watched.drive.id;
        let is_new = std::mem::take(&mut watched.is_new);
        if is_new || now.status != watched.last.status {
            let pilots: Vec<_> = self.page.pilots().iter().map(PilotChoice::told).collect();
            texts.push(text(&json!({ "kind": "status", "drive": id, "status": &*now.status, "pilots": pilots })));
        }
        let courses = self.page.courses();
        // A road to be found takes a while, and other tasks need not wait for it.
        let (place, course) = tokio::task::block_in_place(|| {
            let mut located = watched.drive.located.lock().unwrap_or_else(PoisonError::into_inner);
            (located.take(&courses, &now), located.course)
        });
        let course = course.and_then(|course| courses.get(course));
        let name = course.map(|course| &*course.name);
        if name != watched.course.as_deref() {
            watched.course = name.map(str::to_owned);
            texts.push(text(&json!({ "kind": "course", "course": course })));
        }
        if is_new {
            texts.push(text(&Before { kind: "minute", drive: id, turns: watched.drive.minute.until(&now) }));
        }
        let events: Vec<_> = now.events.iter().filter(|event| event.n > watched.happened).collect();
        if let Some(last) = events.last() {
            texts.push(text(&json!({ "kind": "events", "drive": id, "events": events })));
            watched.happened = last.n;
        }
        let is_scored = |now: &Moment| now.scorer.as_ref().map(Arc::as_ptr);
        if is_scored(&now) != is_scored(&watched.last)
            && let Some(scorer) = &now.scorer
        {
            let card = (**scorer).clone().finish();
            texts.push(text(&json!({ "kind": "score", "score": scored(&card) })));
        }
        let is_same = |a: &Bytes, b: &Bytes| a.as_ptr() == b.as_ptr() && a.len() == b.len();
        let shown = watched.last.jpeg.as_ref();
        let jpeg = now.jpeg.clone().filter(|jpeg| !shown.is_some_and(|shown| is_same(shown, jpeg)));
        watched.sent += 1;
        let message = Shown { kind: "moment", message: watched.sent, turn: &now.turn, place, picture: jpeg.is_some() };
        texts.push(text(&message));
        watched.last = now;
        for text in texts {
            self.send(Message::text(text)).await?;
        }
        match jpeg {
            Some(jpeg) => self.send(Message::Binary(jpeg)).await,
            None => Ok(()),
        }
    }

    async fn say(&mut self, value: &serde_json::Value) -> Result<(), tungstenite::Error> {
        self.send(Message::text(value.to_string())).await
    }

    async fn send(&mut self, message: Message) -> Result<(), tungstenite::Error> {
        websocket::send(&mut self.socket, message, TAKES).await
    }

    async fn close(&mut self, why: &'static str) -> Result<(), tungstenite::Error> {
        websocket::turn_away(&mut self.socket, why).await
    }
}

/// What was driven before a page began to watch.
#[derive(Serialize)]
struct Before {
    kind: &'static str,
    drive: u64,
    turns: Vec<Past>,
}

#[derive(Serialize)]
struct Shown<'a> {
    kind: &'static str,
    /// Its number on this connection.
    message: u64,
    turn: &'a Option<Facts>,
    /// Where the car is, or seems to be.
    place: Option<CarPlace>,
    /// Whether a picture follows.
    picture: bool,
}

fn text(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_else(|error| {
        tracing::error!("a page could not be told something: {error}");
        r#"{"kind":"nothing"}"#.to_owned()
    })
}
