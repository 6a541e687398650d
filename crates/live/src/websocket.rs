//! The opening of a WebSocket, by hand: the simulator refuses every answer that offers an extension. And what pages and
//! viewers have in common after it.

use std::{io, time::Duration};

use axum::{
    body::Body,
    extract::Request,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use futures_util::SinkExt;
use hyper_util::rt::TokioIo;
use tokio::time::{Instant, timeout};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        self, Message,
        handshake::derive_accept_key,
        protocol::{CloseFrame, frame::coding::CloseCode},
    },
};

/// A connection that has left HTTP.
pub(crate) type Socket = TokioIo<hyper::upgrade::Upgraded>;

/// Answers the handshake, and hands the connection over once the answer is out.
pub(crate) fn open<F, Fut>(mut request: Request, then: F) -> Response
where
    F: FnOnce(Socket) -> Fut + Send + 'static,
    Fut: Future<Output = ()> + Send,
{
    let upgrade = hyper::upgrade::on(&mut request);
    let key = request.headers().get(header::SEC_WEBSOCKET_KEY).map(HeaderValue::as_bytes).unwrap_or_default();
    let accept = derive_accept_key(key);
    tokio::spawn(async move {
        match upgrade.await {
            Ok(upgraded) => then(TokioIo::new(upgraded)).await,
            Err(error) => tracing::debug!("a WebSocket handshake broke off: {error}"),
        }
    });
    let headers =
        [(header::UPGRADE, "websocket"), (header::CONNECTION, "Upgrade"), (header::SEC_WEBSOCKET_ACCEPT, &accept)];
    (StatusCode::SWITCHING_PROTOCOLS, headers, Body::empty()).into_response()
}

/// Whether a request is such a handshake.
pub(crate) fn is_asked(request: &Request) -> bool {
    let upgrade = request.headers().get(header::UPGRADE).and_then(|value| value.to_str().ok()).unwrap_or("");
    request.method() == axum::http::Method::GET
        && upgrade.eq_ignore_ascii_case("websocket")
        && request.headers().contains_key(header::SEC_WEBSOCKET_KEY)
}

/// Sends a message to somebody who is gone if it is not taken within this time.
pub(crate) async fn send(
    socket: &mut WebSocketStream<Socket>,
    message: Message,
    takes: Duration,
) -> Result<(), tungstenite::Error> {
    match timeout(takes, socket.send(message)).await {
        Ok(sent) => sent,
        Err(_) => Err(io::Error::from(io::ErrorKind::TimedOut).into()),
    }
}

/// Counts what somebody says, second by second.
pub(crate) struct Chatter {
    most: u32,
    second: Instant,
    said: u32,
}

impl Chatter {
    /// Of somebody who may say so much within a second.
    pub fn of(most: u32) -> Self {
        Self { most, second: Instant::now(), said: 0 }
    }

    /// One more message has come; whether that is too many.
    pub fn is_too_much(&mut self) -> bool {
        if self.second.elapsed() > Duration::from_secs(1) {
            (self.second, self.said) = (Instant::now(), 0);
        }
        self.said += 1;
        self.said > self.most
    }
}

/// Turns somebody away who does not keep to the rules.
pub(crate) async fn turn_away(
    socket: &mut WebSocketStream<Socket>,
    why: &'static str,
) -> Result<(), tungstenite::Error> {
    socket.close(Some(CloseFrame { code: CloseCode::Policy, reason: why.into() })).await
}
