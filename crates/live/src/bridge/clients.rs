//! Every other Socket.IO client, by socketioxide: protocol 4 and 5, polling and
//! WebSocket, with the same events and the same session behind them.

use std::{
    fmt,
    net::SocketAddr,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use axum::Router;
use bytes::Bytes;
use serde::{
    Deserialize, Deserializer,
    de::{self, IgnoredAny, SeqAccess, Visitor},
};
use serde_json::value::RawValue;
use socketioxide::{
    ParserConfig, SocketIo,
    extract::{Event, SocketRef, TryData},
};
use tokio::sync::{Notify, mpsc};

use super::{Bridge, guests::Peer, load::Load, session::Session, throttled::Throttled};
use lapwing_core::protocol::{Answer, Dialect};

/// Messages of one client that may wait; if it sends more without waiting for answers, the rest are lost.
const WAITING: usize = 64;

/// Bytes of binary attachments that one client's event may have. No known event has any.
const ATTACHMENTS: usize = 64 << 10;

/// An event on its way to the client's session.
struct Incoming {
    received: Instant,
    name: String,
    /// Its text; absent if the event has no argument, or one that is not JSON.
    payload: Option<Box<RawValue>>,
}

/// An event's first argument as text: parsed into values it could take many times the memory.
struct Argument(Box<RawValue>);

impl<'de> Deserialize<'de> for Argument {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct FirstArgument;
        impl<'de> Visitor<'de> for FirstArgument {
            type Value = Argument;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an argument")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut arguments: A) -> Result<Argument, A::Error> {
                let first = arguments.next_element()?.ok_or_else(|| de::Error::invalid_length(0, &self))?;
                while arguments.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Argument(first))
            }
        }
        // The parser takes a tuple for the event's arguments, and anything else for one of them.
        deserializer.deserialize_tuple(1, FirstArgument)
    }
}

impl Incoming {
    /// The memory it uses while it waits, in bytes.
    fn bytes(&self) -> usize {
        size_of::<Self>() + self.name.len() + self.payload.as_ref().map_or(0, |payload| payload.get().len())
    }
}

/// The service for requests to `/socket.io`.
pub(super) fn service(bridge: Arc<Bridge>) -> Router {
    let most = bridge.settings.bridge.limits.message();
    let (layer, io) = SocketIo::builder()
        // A client that leaves silently is noticed after 20 s instead of 45, and the connections of a polling client
        // are never idle for long.
        .ping_interval(Duration::from_secs(5))
        .ping_timeout(Duration::from_secs(15))
        .max_payload(most as u64)
        .ws_max_message_size(most)
        .ws_max_frame_size(most)
        .with_parser(ParserConfig::common().max_incoming_binary_buf_size(ATTACHMENTS))
        .build_layer();
    // Before its future is spawned: a client that talks as soon as it is greeted would find nobody who listens.
    io.ns("/", move |socket: SocketRef| {
        connected(socket, bridge.clone());
        async {}
    });
    Router::new().layer(layer)
}

fn connected(socket: SocketRef, bridge: Arc<Bridge>) {
    let peer = socket.req_parts().extensions.get::<Peer>().map(|peer| peer.address);
    // It is absent only if the gate was bypassed, which no code of this crate does.
    let peer = peer.unwrap_or_else(|| ([0, 0, 0, 0], 0).into());
    let most = bridge.settings.bridge.limits.connections();
    if bridge.connections().len() >= most {
        bridge.turned_away(peer, format_args!("{most} drives are open (bridge.limits.connections)"));
        let _ = socket.disconnect(); // an error means that the client has left already
        return;
    }
    if let Some(more) = bridge.clients.due(Instant::now()) {
        let transport = socket.transport_type();
        tracing::info!("{peer}: a Socket.IO client has connected ({transport:?}){more}");
    }
    let (sender, incoming) = mpsc::channel(WAITING);
    let load = Arc::new(Mutex::new(bridge.in_flight.load(peer)));
    let queue = Arc::new(EventQueue { sender, load: load.clone(), peer, crowded: Throttled::default() });
    // socketioxide calls handlers in order but runs their futures at once; the queue keeps the order.
    socket.on_fallback(move |Event(name): Event, TryData(payload): TryData<Argument>| {
        queue.push(Incoming { received: Instant::now(), name, payload: payload.ok().map(|payload| payload.0) });
        async {}
    });
    // The queue does not show that the client has left: the socket's own handler holds its other end.
    let gone = Arc::<Notify>::default();
    let tell = gone.clone();
    socket.on_disconnect(move || {
        tell.notify_one();
        async {}
    });
    let session = Session::new(bridge.enter(peer, false), peer.to_string());
    tokio::spawn(serve(socket, session, incoming, load, gone));
}

/// Where a client's events wait for their turn.
struct EventQueue {
    sender: mpsc::Sender<Incoming>,
    load: Arc<Mutex<Load>>,
    peer: SocketAddr,
    /// Log lines about lost events.
    crowded: Throttled,
}

impl EventQueue {
    fn push(&self, event: Incoming) {
        let bytes = event.bytes();
        let queued = hold(&self.load).grow(bytes).map_err(|why| why.to_string()).and_then(|()| {
            self.sender.try_send(event).map_err(|_| {
                hold(&self.load).shrink(bytes);
                "it sends faster than it is answered".to_owned()
            })
        });
        if let Err(why) = queued
            && let Some(more) = self.crowded.due(Instant::now())
        {
            tracing::warn!("{}: a message is lost: {why}{more}", self.peer);
        }
    }
}

fn hold(load: &Mutex<Load>) -> MutexGuard<'_, Load> {
    load.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn serve(
    socket: SocketRef,
    mut session: Session,
    mut incoming: mpsc::Receiver<Incoming>,
    load: Arc<Mutex<Load>>,
    gone: Arc<Notify>,
) {
    let stopped = session.bridge().clone().stopped();
    tokio::pin!(stopped);
    let why = loop {
        tokio::select! {
            event = incoming.recv() => match event {
                None => break "the client has left",
                Some(event) => {
                    let bytes = event.bytes();
                    answer(&socket, &mut session, event);
                    hold(&load).shrink(bytes);
                }
            },
            () = gone.notified() => break "the client has left",
            () = &mut stopped => {
                if let Some((answer, dialect)) = session.farewell() {
                    let _ = emit(&socket, answer, dialect); // an error means that the client has left already
                }
                let _ = socket.disconnect(); // likewise
                break "the bridge was stopped";
            }
        }
    };
    tokio::task::block_in_place(|| session.finish(why));
}

fn answer(socket: &SocketRef, session: &mut Session, Incoming { received, name, payload }: Incoming) {
    let reply = session.aside(|session| {
        // The session takes the image as a slice of the text.
        let text = payload.map_or(Bytes::from_static(b"null"), |payload| {
            let text: Box<str> = payload.into();
            Bytes::from(text.into_string())
        });
        let payload: Option<&RawValue> = serde_json::from_slice(&text).ok();
        session.event(received, &text, &name, payload)
    });
    let Some(reply) = reply else { return };
    match emit(socket, reply.answer, reply.dialect) {
        Ok(()) => session.answered(reply, Instant::now()),
        Err(error) => tracing::debug!("a client took no answer: {error}"),
    }
}

fn emit(socket: &SocketRef, answer: Answer, dialect: Option<Dialect>) -> Result<(), socketioxide::SendError> {
    let (event, payload) = answer.event(dialect);
    let payload: serde_json::Value = serde_json::from_str(&payload).unwrap_or_default();
    socket.emit(event, &payload)
}
