//! Tells simulators from ordinary Socket.IO clients.
//!
//! The stock simulator is recognised by its user agent. Other builds are recognised because they talk first: an
//! ordinary client of Engine.IO 4 waits for the server's OPEN packet before it sends anything; a simulator that only
//! claims `EIO=4` does not. So a WebSocket with an unknown user agent is opened here and listened to for a moment. If
//! it stays silent, it is passed to socketioxide: its server reads the same request head again from the same
//! connection, and the second `101` is withheld from the client, which has had one. All WebSockets of ordinary clients
//! take this route, so that their bytes are checked before they are unpacked.

use std::{
    future::poll_fn,
    io,
    pin::{Pin, pin},
    sync::Arc,
    task::{Context, Poll},
    time::{Duration, Instant},
};

use axum::{
    Extension, Router,
    body::{Body, HttpBody},
    extract::{Request, State},
    http::{Method, StatusCode, Version, header},
    response::{IntoResponse, Response},
};
use bytes::{Buf, Bytes, BytesMut};
use hyper_util::{rt::TokioIo, service::TowerToHyperService};
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, ReadBuf},
    task::block_in_place,
};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::protocol::{Role as End, WebSocketConfig},
};
use tower::ServiceExt;

use super::{
    Bridge, clients,
    frames::Watched,
    guests::{Peer, Role},
    load::{Abuse, Counted},
    simulator,
};
use crate::websocket::{Socket, is_asked, open};

/// How long an unknown WebSocket is listened to. A simulator talks within a game frame or two; an ordinary client that
/// connects without polling first is delayed by this much.
const LISTEN: Duration = Duration::from_millis(250);

/// Bytes of a simulator's WebSocket that are unpacked before other connections get their turn.
const READ: usize = 16 << 10;

#[derive(Clone)]
struct Gate {
    bridge: Arc<Bridge>,
    clients: Router,
}

/// The service for every path that is not one of our pages.
pub(super) fn service(bridge: Arc<Bridge>) -> Router {
    let clients = clients::service(bridge.clone());
    Router::new().fallback(enter).with_state(Gate { bridge, clients })
}

async fn enter(State(gate): State<Gate>, Extension(peer): Extension<Peer>, request: Request) -> Response {
    match Caller::of(&request) {
        Caller::Simulator => open(request, move |socket| play(socket, Bytes::new(), gate, peer)),
        Caller::Unknown => {
            let head = head(&request);
            open(request, move |socket| listen(socket, head, gate, peer))
        }
        Caller::Client => {
            let head = head(&request);
            open(request, move |socket| pass_on(socket, head, Bytes::new(), gate, peer))
        }
        Caller::Http => http(request, gate, &peer).await,
    }
}

/// A request without a WebSocket: a polling client, or a stray request.
async fn http(request: Request, gate: Gate, peer: &Peer) -> Response {
    peer.is(Role::Http);
    // socketioxide would open a WebSocket whatever `Upgrade` asks for, and its frames would not be checked.
    if query(&request).any(|part| part.starts_with("transport=websocket")) {
        let why = "expected Upgrade: websocket and a Sec-WebSocket-Key";
        return refuse(&gate.bridge, peer, StatusCode::BAD_REQUEST, why);
    }
    let limits = &gate.bridge.settings.bridge.limits;
    let announced = request.body().size_hint().lower();
    if announced > limits.message() as u64 {
        let why = Abuse::TooLarge { most: limits.message(), got: announced };
        return refuse(&gate.bridge, peer, StatusCode::PAYLOAD_TOO_LARGE, &why.to_string());
    }
    let opens = request.uri().path().starts_with("/socket.io")
        && request.method() == Method::GET
        && !query(&request).any(|part| part.starts_with("sid="));
    if opens && !gate.bridge.guests.may_poll(Instant::now()) {
        let why = format!("{} sessions were opened in 20 s (bridge.limits.connections)", limits.connections);
        return refuse(&gate.bridge, peer, StatusCode::SERVICE_UNAVAILABLE, &why);
    }
    let posts = request.method() == Method::POST;
    let request = request.map(|body| Body::new(Counted::new(body, gate.bridge.clone(), peer.address)));
    let mut answer = pin!(gate.clients.oneshot(request));
    // A body may hold thousands of messages, which are all handled at once.
    let answer =
        poll_fn(|cx| if posts { block_in_place(|| answer.as_mut().poll(cx)) } else { answer.as_mut().poll(cx) });
    match answer.await {
        Ok(response) => response,
        Err(infallible) => match infallible {},
    }
}

fn refuse(bridge: &Bridge, peer: &Peer, status: StatusCode, why: &str) -> Response {
    bridge.turned_away(peer.address, why);
    (status, [(header::CONNECTION, "close")], format!("{why}\n")).into_response()
}

enum Caller {
    Simulator,
    /// A WebSocket that is not identified yet.
    Unknown,
    /// An ordinary client's WebSocket.
    Client,
    /// Not a WebSocket.
    Http,
}

impl Caller {
    fn of(request: &Request) -> Self {
        let header = |name| request.headers().get(name).and_then(|v| v.to_str().ok()).unwrap_or("");
        let dials = is_asked(request) && request.uri().path().starts_with("/socket.io");
        match () {
            () if !dials => Self::Http,
            // Polling began this client's session, which its WebSocket continues.
            () if query(request).any(|part| part.starts_with("sid=")) => Self::Client,
            () if header(header::USER_AGENT).starts_with("websocket-sharp/") => Self::Simulator,
            // No build of the simulator sends an origin.
            () if request.headers().contains_key(header::ORIGIN) => Self::Client,
            () if query(request).any(|part| part == "EIO=4") => Self::Unknown,
            () => Self::Client,
        }
    }
}

fn query(request: &Request) -> impl Iterator<Item = &str> {
    request.uri().query().unwrap_or("").split('&')
}

async fn websocket<S>(socket: Watched<S>, bridge: &Bridge) -> WebSocketStream<Watched<S>>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let most = Some(bridge.settings.bridge.limits.message());
    let config = WebSocketConfig::default().read_buffer_size(READ).max_message_size(most).max_frame_size(most);
    WebSocketStream::from_raw_socket(socket, End::Server, Some(config)).await
}

/// Waits for the first bytes of an unknown WebSocket and passes it on accordingly.
async fn listen(mut socket: Socket, head: Bytes, gate: Gate, peer: Peer) {
    let mut read = BytesMut::with_capacity(4096);
    let first = tokio::time::timeout(LISTEN, async {
        loop {
            match socket.read_buf(&mut read).await {
                Ok(0) | Err(_) => return Opening::Gone,
                Ok(_) => {}
            }
            match first_words(&read) {
                Some([b'4', b'0']) => return Opening::Connect,
                Some(_) => return Opening::Talks,
                None => {} // not yet a whole frame header
            }
        }
    });
    match first.await {
        Ok(Opening::Gone) => {}
        Ok(Opening::Talks) => {
            if let Some(more) = gate.bridge.strangers.due(Instant::now()) {
                let peer = peer.address;
                tracing::info!("{peer} talks before it is greeted: served as a simulator{more}");
            }
            play(socket, read.freeze(), gate, peer).await;
        }
        Ok(Opening::Connect) | Err(_) => pass_on(socket, head, read.freeze(), gate, peer).await,
    }
}

/// Serves a simulator; `read` is what it has sent so far.
async fn play(socket: Socket, read: Bytes, gate: Gate, peer: Peer) {
    peer.is(Role::Simulator);
    let socket = Watched::new(socket, read, gate.bridge.clone(), peer.address);
    simulator::run(websocket(socket, &gate.bridge).await, gate.bridge, peer.address).await;
}

/// Passes a WebSocket that is already open to socketioxide; `read` is what it has sent so far.
async fn pass_on(socket: Socket, head: Bytes, read: Bytes, gate: Gate, peer: Peer) {
    peer.is(Role::Client);
    let address = peer.address;
    let socket = Watched::new(socket, read, gate.bridge.clone(), address);
    let socket = ReplayedHead { incoming: head, head: Vec::new(), head_is_over: false, socket };
    let clients = gate.clients.layer(Extension(peer)).into_service::<hyper::body::Incoming>();
    let server = hyper::server::conn::http1::Builder::new()
        .serve_connection(TokioIo::new(socket), TowerToHyperService::new(clients))
        .with_upgrades();
    if let Err(error) = server.await {
        tracing::debug!("{address}: {error}");
    }
}

enum Opening {
    Gone,
    /// An impatient client of Engine.IO 4: `40` without waiting for OPEN.
    Connect,
    Talks,
}

/// The first two bytes of the first WebSocket frame's payload, unmasked.
fn first_words(bytes: &[u8]) -> Option<[u8; 2]> {
    let length = *bytes.get(1)?;
    let mask_at = match length & 0x7f {
        126 => 4,
        127 => 10,
        0 | 1 => return bytes.get(6).map(|b| [b ^ bytes[2], 0]), // a ping, `2`
        _ => 2,
    };
    let mask = bytes.get(mask_at..mask_at + 4)?;
    let payload = bytes.get(mask_at + 4..mask_at + 6)?;
    Some([payload[0] ^ mask[0], payload[1] ^ mask[1]])
}

/// The request's text as received, for a server that has not seen it.
fn head(request: &Request) -> Bytes {
    let mut text = Vec::with_capacity(512);
    let version = if request.version() == Version::HTTP_10 { "1.0" } else { "1.1" };
    let target = request.uri().path_and_query().map_or("/", |p| p.as_str());
    text.extend_from_slice(format!("{} {target} HTTP/{version}\r\n", request.method()).as_bytes());
    for (name, value) in request.headers() {
        text.extend_from_slice(name.as_str().as_bytes());
        text.extend_from_slice(b": ");
        text.extend_from_slice(value.as_bytes());
        text.extend_from_slice(b"\r\n");
    }
    text.extend_from_slice(b"\r\n");
    text.into()
}

/// A connection whose request head can be read again and whose first response head is withheld.
struct ReplayedHead {
    incoming: Bytes,
    head: Vec<u8>,
    head_is_over: bool,
    socket: Watched<Socket>,
}

impl AsyncRead for ReplayedHead {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.incoming.is_empty() {
            return Pin::new(&mut self.socket).poll_read(cx, buf);
        }
        let n = self.incoming.len().min(buf.remaining());
        buf.put_slice(&self.incoming[..n]);
        self.incoming.advance(n);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for ReplayedHead {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        if self.head_is_over {
            return Pin::new(&mut self.socket).poll_write(cx, buf);
        }
        let before = self.head.len();
        self.head.extend_from_slice(buf);
        let Some(end) = self.head.windows(4).position(|w| w == b"\r\n\r\n").map(|at| at + 4) else {
            return Poll::Ready(Ok(buf.len()));
        };
        if !self.head.starts_with(b"HTTP/1.1 101") {
            return Poll::Ready(Err(io::Error::other("the client was refused after its WebSocket was opened")));
        }
        self.head_is_over = true;
        Poll::Ready(Ok(end - before)) // the next call writes what follows the head
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_words_are_read_through_the_mask() {
        let mask = [1u8, 2, 3, 4];
        let frame = |payload: &[u8]| {
            let mut bytes = vec![0x81];
            match payload.len() {
                n @ 0..=125 => bytes.push(0x80 | n as u8),
                n => {
                    bytes.push(0x80 | 126);
                    bytes.extend((n as u16).to_be_bytes());
                }
            }
            bytes.extend(mask);
            bytes.extend(payload.iter().enumerate().map(|(i, b)| b ^ mask[i % 4]));
            bytes
        };
        assert_eq!(first_words(&frame(b"40")), Some(*b"40"));
        assert_eq!(first_words(&frame(&[b"42".as_slice(), &[b'x'; 1000]].concat())), Some(*b"42"));
        assert_eq!(first_words(&frame(b"2")), Some([b'2', 0]));
        for n in 0..7 {
            assert_eq!(first_words(&frame(b"40")[..n]), None);
        }
    }
}
