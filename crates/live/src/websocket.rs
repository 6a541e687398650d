//! The opening of a WebSocket, by hand: the simulator refuses every answer that offers an extension.

use axum::{
    body::Body,
    extract::Request,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use hyper_util::rt::TokioIo;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;

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
