//! Every other Socket.IO client, by socketioxide: protocol 4 and 5, polling and
//! WebSocket, with the same events and the same session behind them.

use std::{sync::Arc, time::Instant};

use axum::{Router, extract::ConnectInfo};
use bytes::Bytes;
use serde_json::value::RawValue;
use socketioxide::{
    SocketIo,
    extract::{Event, SocketRef, TryData},
};
use tokio::sync::{Notify, mpsc};

use super::{Bridge, gate::MAX_MESSAGE, listener::Peer, session::Session};

/// Messages of one client that may wait; one that sends more without waiting for answers loses the rest.
const WAITING: usize = 64;

/// An event on its way to the client's session.
struct Incoming {
    received: Instant,
    name: String,
    payload: Result<serde_json::Value, String>,
}

/// The service for requests to `/socket.io`.
pub(super) fn service(bridge: Arc<Bridge>) -> Router {
    let (layer, io) = SocketIo::builder()
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
    tracing::info!("{peer}: a Socket.IO client has connected ({:?})", socket.transport_type());
    let (sender, incoming) = mpsc::channel(WAITING);
    // socketioxide calls handlers in order but runs their futures at once; the queue keeps the order.
    socket.on_fallback(move |Event(name): Event, TryData(payload): TryData<serde_json::Value>| {
        let payload = payload.map_err(|e| e.to_string());
        let event = Incoming { received: Instant::now(), name, payload };
        if sender.try_send(event).is_err() {
            tracing::debug!("a client sends faster than it is answered; one message is lost");
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
                let _ = socket.disconnect(); // an error is a client that is gone already
                break "the bridge was stopped";
            }
        }
    };
    tokio::task::block_in_place(|| session.finish(why));
}

fn answer(socket: &SocketRef, session: &mut Session, Incoming { received, name, payload }: Incoming) {
    let turn = tokio::task::block_in_place(|| match payload.map(|p| serde_json::value::to_raw_value(&p)) {
        Ok(Ok(payload)) => {
            // The session slices the image out of the text that it lies in.
            let text = Bytes::from(String::from(Box::<str>::from(payload)));
            let payload: Option<&RawValue> = serde_json::from_slice(&text).ok();
            session.event(received, &text, &name, payload)
        }
        Ok(Err(error)) => Some(session.unreadable(received, name, error.to_string())),
        Err(error) => Some(session.unreadable(received, name, error)),
    });
    let Some(turn) = turn else { return };
    let (event, payload) = turn.answer.event(turn.dialect);
    let payload: Result<serde_json::Value, _> = serde_json::from_str(&payload);
    match payload.map(|payload| socket.emit(event, &payload)) {
        Ok(Ok(())) => session.answered(turn, Instant::now()),
        Ok(Err(error)) => tracing::debug!("a client took no answer: {error}"),
        Err(error) => tracing::error!("an answer of our own is no JSON: {error}"),
    }
}
