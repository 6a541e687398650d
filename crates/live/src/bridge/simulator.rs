//! A simulator's WebSocket, from its first message to its last.
//!
//! No OPEN packet is sent, so one token is in flight and not two. Nothing is ever sent that crashes the simulator's
//! client: no binary frame, no text that is not a packet.

use std::{
    io,
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    task::block_in_place,
};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{self, Message, Utf8Bytes},
};

use super::{
    Bridge,
    liveness::{Due, Liveness},
    session::{Reply, Session},
    tokens::Tokens,
};
use lapwing_core::protocol::{Answer, Dialect, Packet};

/// A simulator that takes no answer for this long is gone. Less than the bridge's own wait at its end.
const SEND: Duration = Duration::from_secs(5);

/// How long the last words may take …
const LAST_WORDS: Duration = Duration::from_secs(1);
/// … and how long incoming bytes are still read: a socket that is closed with unread bytes is reset, and the reset may
/// overtake them.
const HEARD_OUT: Duration = Duration::from_millis(250);

/// Serves one simulator until either side leaves.
pub(super) async fn run<S>(socket: WebSocketStream<S>, bridge: Arc<Bridge>, peer: SocketAddr)
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let silence = Duration::from_secs_f64(bridge.settings.bridge.kick_after_s);
    let session = Session::new(bridge.enter(peer, true), peer.to_string());
    let now = Instant::now();
    let (liveness, tokens) = (Liveness::new(now, silence), Tokens::new(now));
    let mut simulator =
        SimulatorSocket { socket, session, liveness, tokens, peer: peer.ip(), heard: false, held: None };
    let why = match simulator.play().await {
        Ok(why) => why.to_owned(),
        Err(tungstenite::Error::Io(error)) => error.to_string(),
        Err(error) => error.to_string(),
    };
    if let Some((reply, _)) = simulator.held.take() {
        simulator.session.swallowed(reply, Instant::now());
    }
    if simulator.heard && simulator.liveness.has_kicks_open() {
        bridge.kicked().insert(simulator.peer);
    }
    block_in_place(|| simulator.session.finish(&why));
}

struct SimulatorSocket<S> {
    socket: WebSocketStream<S>,
    session: Session,
    liveness: Liveness,
    tokens: Tokens,
    peer: IpAddr,
    /// Whether a telemetry came.
    heard: bool,
    /// The answer that goes out next, and when, unless another telemetry comes before.
    held: Option<(Reply, Instant)>,
}

impl<S: AsyncRead + AsyncWrite + Unpin> SimulatorSocket<S> {
    /// Plays until the connection ends; returns why it did.
    async fn play(&mut self) -> Result<&'static str, tungstenite::Error> {
        let signals = self.session.signals().clone();
        let bridge = self.session.bridge().clone();
        let stopped = bridge.clone().stopped();
        tokio::pin!(stopped);
        for event in &bridge.settings.bridge.greet {
            self.send_text(format!("42{event}").into()).await?;
        }
        loop {
            // Others get their turn, even if this simulator never pauses.
            tokio::task::coop::consume_budget().await;
            let (when, due) = match &self.held {
                Some((_, until)) => (*until, None),
                None => {
                    let (when, due) = self.liveness.next();
                    (when, Some(due))
                }
            };
            let wait = async move {
                // A timer takes a millisecond even if there is nothing to wait for.
                if when > Instant::now() {
                    tokio::time::sleep_until(when.into()).await;
                }
            };
            tokio::select! {
                // Messages that have arrived come before actions that are due because none has: a telemetry that
                // arrives before the last one is answered is one too many.
                biased;
                () = &mut stopped => {
                    let last_words = async {
                        if let Some((answer, dialect)) = self.session.farewell() {
                            self.send(answer, dialect).await?;
                        }
                        self.socket.close(None).await
                    };
                    // An error means that the simulator has left by now.
                    let _ = tokio::time::timeout(LAST_WORDS, last_words).await;
                    let heard_out = async { while let Some(Ok(_)) = self.socket.next().await {} };
                    let _ = tokio::time::timeout(HEARD_OUT, heard_out).await;
                    return Ok("the bridge was stopped");
                }
                message = self.socket.next() => match message {
                    None => return Ok("the simulator hung up"),
                    Some(Err(error)) if is_gone(&error) => return Ok("the simulator is gone"),
                    Some(Err(error)) => return Err(error),
                    Some(Ok(message)) => if let Some(why) = self.message(message).await? {
                        return Ok(why);
                    },
                },
                () = signals.newer.notified() => self.liveness.newer(Instant::now()),
                () = wait => match due {
                    None => self.release().await?,
                    Some(Due::Kick) => {
                        let now = Instant::now();
                        let (answer, dialect) = self.session.kick(now);
                        self.send(answer, dialect).await?;
                        self.liveness.kicked(now);
                        self.tokens.kicked();
                    }
                    Some(Due::Ghost) => return Ok("neither telemetry nor ping came for 60 s"),
                    Some(Due::Superseded) => return Ok(
                        "neither telemetry nor ping came for 30 s, while a newer connection from its address plays",
                    ),
                },
            }
        }
    }

    /// Takes one message; returns why the simulator leaves, if it does.
    async fn message(&mut self, message: Message) -> Result<Option<&'static str>, tungstenite::Error> {
        let received = Instant::now();
        let session = &mut self.session;
        let mut bytes = Bytes::new();
        let turn = match message {
            Message::Text(text) => match Packet::parse(&text) {
                Ok(Packet::Ping(rest)) => {
                    self.liveness.ping(received);
                    let pong = format!("3{rest}");
                    self.send_text(pong.into()).await?;
                    return Ok(None);
                }
                Ok(Packet::Event(event)) => {
                    bytes = text.clone().into();
                    session.aside(|session| session.event(received, &bytes, &event.name, event.payload))
                }
                Ok(Packet::Close | Packet::Disconnect) => return Ok(Some("the simulator said goodbye")),
                Ok(Packet::Open(_) | Packet::Pong | Packet::Connect | Packet::Other) => return Ok(None),
                Err(error) => {
                    let got = text.chars().take(40).collect();
                    Some(session.aside(|session| session.unreadable(received, got, error.to_string())))
                }
            },
            Message::Binary(bytes) => {
                let got = format!("{} bytes of binary", bytes.len());
                Some(session.aside(|session| session.unreadable(received, got, "a simulator sends text".into())))
            }
            Message::Close(_) => return Ok(Some("the simulator hung up")),
            Message::Ping(_) | Message::Pong(_) | Message::Frame(_) => return Ok(None), // answered by the library
        };
        let Some(turn) = turn else { return Ok(None) };
        self.telemetry(turn, &bytes).await?;
        Ok(None)
    }

    /// Answers a telemetry, or holds its answer back until it is clear whether another one comes.
    async fn telemetry(&mut self, reply: Reply, message: &[u8]) -> Result<(), tungstenite::Error> {
        let now = Instant::now();
        if !std::mem::replace(&mut self.heard, true) && self.bridge().kicked().remove(&self.peer) {
            self.tokens.kicked();
        }
        if let Some((earlier, _)) = self.held.take() {
            self.tokens.one_too_many();
            self.session.swallowed(earlier, now);
            if self.tokens.are_unasked() {
                self.session.sends_unasked();
            }
        }
        let unasked = self.session.is_timer_driven() || self.tokens.are_unasked();
        // From now on the simulator owes the next one.
        self.liveness.telemetry(now, reply.is_human(), unasked);
        if unasked {
            return self.answer(reply).await;
        }
        let wait = self.tokens.telemetry(now, message, !reply.is_human());
        self.held = Some((reply, now + wait));
        Ok(())
    }

    /// Nothing more came: the held answer goes out.
    async fn release(&mut self) -> Result<(), tungstenite::Error> {
        let taken_out = self.tokens.settled();
        if taken_out > 0 {
            self.session.took_out(taken_out);
        }
        match self.held.take() {
            Some((reply, _)) => self.answer(reply).await,
            None => Ok(()),
        }
    }

    fn bridge(&self) -> &Bridge {
        self.session.bridge()
    }

    async fn answer(&mut self, reply: Reply) -> Result<(), tungstenite::Error> {
        self.send(reply.answer, reply.dialect).await?;
        self.session.answered(reply, Instant::now());
        Ok(())
    }

    async fn send(&mut self, answer: Answer, dialect: Option<Dialect>) -> Result<(), tungstenite::Error> {
        self.send_text(answer.encode(dialect).into()).await
    }

    async fn send_text(&mut self, text: Utf8Bytes) -> Result<(), tungstenite::Error> {
        match tokio::time::timeout(SEND, self.socket.send(Message::Text(text))).await {
            Ok(sent) => sent,
            Err(_) => Err(io::Error::new(io::ErrorKind::TimedOut, "the simulator took no answer for 5 s").into()),
        }
    }
}

/// A connection that ended without a goodbye, as the simulator's does when its window is closed.
fn is_gone(error: &tungstenite::Error) -> bool {
    use tungstenite::{Error, error::ProtocolError};
    match error {
        Error::ConnectionClosed | Error::AlreadyClosed => true,
        Error::Protocol(ProtocolError::ResetWithoutClosingHandshake) => true,
        Error::Io(e) => matches!(e.kind(), io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe),
        _ => false,
    }
}
