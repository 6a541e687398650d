//! A simulator's WebSocket, from its first word to its last.
//!
//! No OPEN packet is sent, so one token is in flight and not two. Nothing is
//! ever sent that the simulator's client dies of: no binary frame, no text that
//! is no packet.

use std::{
    io,
    net::SocketAddr,
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
    session::{Session, Turn},
    throttled::held_back,
};
use crate::protocol::{Answer, Dialect, Packet};

/// After a kick a telemetry is held back so long: if another comes before its
/// answer, there is a token too many, and only the later one is answered.
const SETTLE: Duration = Duration::from_millis(250);

/// A simulator that takes no answer for so long is gone.
const SEND: Duration = Duration::from_secs(10);

/// Serves one simulator until either side leaves.
pub(super) async fn run<S>(socket: WebSocketStream<S>, bridge: Arc<Bridge>, peer: SocketAddr)
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    // A simulator that is turned away dials thousands of times a second.
    if let Some(held) = bridge.redials.due(Instant::now()) {
        tracing::info!("{peer}: a simulator has connected{}", held_back(held));
    }
    let silence = Duration::from_secs_f64(bridge.settings.bridge.kick_after_s);
    let session = Session::new(bridge.enter(peer, true), peer.to_string());
    let liveness = Liveness::new(Instant::now(), silence);
    let mut simulator = Simulator { socket, session, liveness, held: None, surplus: 0 };
    let why = match simulator.play().await {
        Ok(why) => why.to_owned(),
        Err(error) => error.to_string(),
    };
    block_in_place(|| simulator.session.finish(&why));
}

struct Simulator<S> {
    socket: WebSocketStream<S>,
    session: Session,
    liveness: Liveness,
    /// A telemetry that waits whether another one comes, and until when.
    held: Option<(Turn, Instant)>,
    /// How many telemetries may still be swallowed.
    surplus: u32,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Simulator<S> {
    /// Plays until the connection ends; says why it did.
    async fn play(&mut self) -> Result<&'static str, tungstenite::Error> {
        let signals = self.session.signals().clone();
        let bridge = self.session.bridge().clone();
        let stopped = bridge.clone().stopped();
        tokio::pin!(stopped);
        for event in &bridge.settings.bridge.greet {
            self.send_text(format!("42{event}").into()).await?;
        }
        loop {
            let (when, due) = match &self.held {
                Some((_, until)) => (*until, None),
                None => {
                    let (when, due) = self.liveness.next();
                    (when, Some(due))
                }
            };
            tokio::select! {
                // What has arrived comes before what is due because nothing has.
                biased;
                () = &mut stopped => {
                    if let Some((answer, dialect)) = self.session.farewell() {
                        let _ = self.send(answer, dialect).await; // it may have left by now
                    }
                    let _ = tokio::time::timeout(Duration::from_secs(1), self.socket.close(None)).await;
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
                () = tokio::time::sleep_until(when.into()) => match due {
                    None => self.release().await?,
                    Some(Due::Kick) => {
                        let now = Instant::now();
                        let (answer, dialect) = self.session.kick(now);
                        self.send(answer, dialect).await?;
                        self.liveness.kicked(now);
                    }
                    Some(Due::Ghost) => return Ok("nothing came for 60 s: it has left the scene"),
                    Some(Due::Superseded) => return Ok("it has left the scene and dialled anew"),
                },
            }
        }
    }

    /// Takes one message; says why the simulator leaves if it does.
    async fn message(&mut self, message: Message) -> Result<Option<&'static str>, tungstenite::Error> {
        let received = Instant::now();
        let session = &mut self.session;
        let turn = match message {
            Message::Text(text) => match Packet::parse(&text) {
                Ok(Packet::Ping(rest)) => {
                    self.liveness.ping(received);
                    let pong = format!("3{rest}");
                    self.send_text(pong.into()).await?;
                    return Ok(None);
                }
                Ok(Packet::Event(event)) => {
                    let message: Bytes = text.clone().into();
                    session.aside(|session| session.event(received, &message, &event.name, event.payload))
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
        if self.surplus == 0 {
            self.surplus = self.liveness.surplus();
        }
        if let Some((earlier, _)) = self.held.take() {
            // Two telemetries and no answer between: one token too many. The earlier goes unanswered.
            self.surplus -= 1;
            self.session.swallowed(earlier, Instant::now());
        }
        let (human, timer_driven) = (turn.is_human(), self.session.is_timer_driven());
        if self.surplus > 0 {
            self.held = Some((turn, Instant::now() + SETTLE));
        } else {
            self.answer(turn).await?;
        }
        // From now on the simulator owes the next one.
        self.liveness.telemetry(Instant::now(), human, timer_driven);
        Ok(None)
    }

    /// Nothing more came: the held telemetry is the only one.
    async fn release(&mut self) -> Result<(), tungstenite::Error> {
        self.surplus = 0;
        match self.held.take() {
            Some((turn, _)) => self.answer(turn).await,
            None => Ok(()),
        }
    }

    async fn answer(&mut self, turn: Turn) -> Result<(), tungstenite::Error> {
        self.send(turn.answer, turn.dialect).await?;
        self.session.answered(turn, Instant::now());
        Ok(())
    }

    async fn send(&mut self, answer: Answer, dialect: Option<Dialect>) -> Result<(), tungstenite::Error> {
        self.send_text(answer.encode(dialect).into()).await
    }

    async fn send_text(&mut self, text: Utf8Bytes) -> Result<(), tungstenite::Error> {
        match tokio::time::timeout(SEND, self.socket.send(Message::Text(text))).await {
            Ok(sent) => sent,
            Err(_) => Err(io::Error::new(io::ErrorKind::TimedOut, "the simulator took no answer for 10 s").into()),
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
