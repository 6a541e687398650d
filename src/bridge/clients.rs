//! Every other Socket.IO client, by socketioxide: protocol 4 and 5, polling and
//! WebSocket, with the same events and the same session behind them.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{Router, extract::ConnectInfo};
use bytes::Bytes;
use serde_json::value::RawValue;
use socketioxide::{
    SocketIo,
    extract::{Event, SocketRef, TryData},
};
use tokio::sync::{Notify, mpsc};

use super::{
    Bridge,
    gate::MAX_MESSAGE,
    listener::Peer,
    session::Session,
    throttled::{Throttled, held_back},
};
use crate::protocol::{Answer, Dialect};

/// Messages of one client that may wait; one that sends more without waiting for answers loses the rest.
const WAITING: usize = 64;

/// An event on its way to the client's session.
struct Incoming {
    received: Instant,
    name: String,
    /// Absent where the event has no argument, or none that JSON can say.
    payload: Option<serde_json::Value>,
}

/// The service for requests to `/socket.io`.
pub(super) fn service(bridge: Arc<Bridge>) -> Router {
    let (layer, io) = SocketIo::builder()
        // A client that leaves without a word is missed after 20 s instead of 45.
        .ping_interval(Duration::from_secs(10))
        .ping_timeout(Duration::from_secs(10))
        .max_payload(MAX_MESSAGE as u64)
        .ws_max_message_size(MAX_MESSAGE)
        .ws_max_frame_size(MAX_MESSAGE)
        .build_layer();
    io.ns("/", move |socket: SocketRef| connected(socket, bridge.clone()));
    Router::new().layer(layer)
}

async fn connected(socket: SocketRef, bridge: Arc<Bridge>) {
    let peer = socket.req_parts().extensions.get::<ConnectInfo<Peer>>().map(|c| c.0.0);
    // Without it the gate has been left out, as no code of this crate does.
    let peer = peer.unwrap_or_else(|| ([0, 0, 0, 0], 0).into());
    if let Some(held) = bridge.clients.due(Instant::now()) {
        let transport = socket.transport_type();
        tracing::info!("{peer}: a Socket.IO client has connected ({transport:?}){}", held_back(held));
    }
    let crowded = Arc::<Throttled>::default();
    let (sender, incoming) = mpsc::channel(WAITING);
    // socketioxide calls handlers in order but runs their futures at once; the queue keeps the order.
    socket.on_fallback(move |Event(name): Event, TryData(payload): TryData<serde_json::Value>| {
        let event = Incoming { received: Instant::now(), name, payload: payload.ok() };
        if sender.try_send(event).is_err()
            && let Some(held) = crowded.due(Instant::now())
        {
            tracing::warn!("{peer} sends faster than it is answered: a message is lost{}", held_back(held));
        }
        async {}
    });
    // The queue does not tell that the client has left: the socket's own handler holds its other end.
    let gone = Arc::<Notify>::default();
    let tell = gone.clone();
    socket.on_disconnect(move || {
        tell.notify_one();
        async {}
    });
    let session = Session::new(bridge.enter(peer, false), peer.to_string());
    tokio::spawn(serve(socket, session, incoming, gone));
}

async fn serve(socket: SocketRef, mut session: Session, mut incoming: mpsc::Receiver<Incoming>, gone: Arc<Notify>) {
    let stopped = session.bridge().clone().stopped();
    tokio::pin!(stopped);
    let why = loop {
        tokio::select! {
            event = incoming.recv() => match event {
                None => break "the client has left",
                Some(event) => answer(&socket, &mut session, event),
            },
            () = gone.notified() => break "the client has left",
            () = &mut stopped => {
                if let Some((answer, dialect)) = session.farewell() {
                    let _ = emit(&socket, answer, dialect); // an error is a client that is gone already
                }
                let _ = socket.disconnect(); // likewise
                break "the bridge was stopped";
            }
        }
    };
    tokio::task::block_in_place(|| session.finish(why));
}

fn answer(socket: &SocketRef, session: &mut Session, Incoming { received, name, payload }: Incoming) {
    let turn = session.aside(|session| {
        // The session slices the image out of the text that it lies in.
        let text = Bytes::from(payload.map_or_else(|| "null".to_owned(), |payload| payload.to_string()));
        let payload: Option<&RawValue> = serde_json::from_slice(&text).ok();
        session.event(received, &text, &name, payload)
    });
    let Some(turn) = turn else { return };
    match emit(socket, turn.answer, turn.dialect) {
        Ok(()) => session.answered(turn, Instant::now()),
        Err(error) => tracing::debug!("a client took no answer: {error}"),
    }
}

fn emit(socket: &SocketRef, answer: Answer, dialect: Option<Dialect>) -> Result<(), socketioxide::SendError> {
    let (event, payload) = answer.event(dialect);
    let payload: serde_json::Value = serde_json::from_str(&payload).unwrap_or_default();
    socket.emit(event, &payload)
}
