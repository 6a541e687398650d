//! A world as the stock simulator's own client: same handshake, same fragments, same game of tokens, same numbers, and
//! the same habit of crashing or stalling when a bridge sends something that its parser does not take.

mod handshake;

use std::{
    collections::VecDeque,
    io,
    net::TcpStream,
    time::{Duration, Instant},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use tungstenite::{
    self, Message, WebSocket,
    protocol::frame::{
        Frame,
        coding::{Data, OpCode},
    },
};

use crate::{
    protocol::number::Culture,
    protocol::{Answer, CameraImage, Command, Packet, Sight, Telemetry, World, encode_superset, encode_telemetry},
    words::count,
};

/// websocket-sharp's `FragmentLength`: payload bytes in one frame.
const FRAGMENT: usize = 1016;

/// The simulator pings at once and then about this often.
const PING: Duration = Duration::from_secs(25);

/// Options of the client.
#[derive(Debug, Clone)]
pub struct ClientOptions {
    /// The player's culture, in which numbers are written and read.
    pub culture: Culture,
    /// Whether to send only what the stock build reports. Default no: a world's ground truth is sent as builds of the
    /// SelfOracle family send it, see [`encode_superset`].
    pub stock: bool,
    /// Silence after which a bridge counts as stalled. Default 10 s.
    pub stall: Duration,
    /// How long to wait for a bridge's greeting before the first telemetry. Default 100 ms.
    pub greeting: Duration,
}

impl Default for ClientOptions {
    fn default() -> Self {
        Self {
            culture: Culture::ALL[0],
            stock: false,
            stall: Duration::from_secs(10),
            greeting: Duration::from_millis(100),
        }
    }
}

/// What the bridge did.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ClientReport {
    /// Telemetries sent, those of a human driving included.
    pub telemetries: u64,
    /// Answers that the simulator would have taken.
    pub answers: u64,
    /// Answers that it would have swallowed, each losing a token.
    pub lost_tokens: u64,
    /// Time from a telemetry's first byte to its answer's last, in order, including swallowed answers.
    pub round_trips: Vec<Duration>,
}

/// Why a world could not be played to a bridge.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// No connection.
    #[error("cannot connect to {address}: {source}. Is a bridge running there (lapwing serve)?")]
    Connect {
        /// The address dialled.
        address: String,
        /// Why not.
        source: io::Error,
    },
    /// The simulator would not accept the answer to its WebSocket handshake.
    #[error("the simulator would not accept this handshake: expected {expected}, got {got:?}")]
    Handshake {
        /// What the simulator expects.
        expected: &'static str,
        /// What came.
        got: String,
    },
    /// The connection broke, or the bridge closed it.
    #[error("the connection broke after {}: {source}", count(*telemetries, "telemetry"))]
    Broken {
        /// How far it came.
        telemetries: u64,
        /// Why.
        source: tungstenite::Error,
    },
    /// The bridge sent something that crashes the simulator's client.
    #[error("the simulator would stop here, after {}: expected {expected}, got {got:?}", count(*telemetries, "telemetry"))]
    Death {
        /// How far it came.
        telemetries: u64,
        /// What the client takes.
        expected: &'static str,
        /// What came.
        got: String,
    },
    /// No answer came.
    #[error(
        "the simulator stalls here: no answer for {stall:?} after {} ({} swallowed)",
        count(*telemetries, "telemetry"),
        count(*lost_tokens, "answer")
    )]
    Stalled {
        /// How far it came.
        telemetries: u64,
        /// Answers that the simulator swallowed.
        lost_tokens: u64,
        /// How long nothing has come.
        stall: Duration,
    },
}

/// Why a world was not played to its end.
#[derive(Debug, thiserror::Error)]
pub enum PlayError<E> {
    /// There is no bridge, or none that the simulator would play with.
    #[error(transparent)]
    Bridge(#[from] ClientError),
    /// The world could not continue.
    #[error(transparent)]
    World(E),
}

/// Plays a world to the bridge at `address` (`HOST:PORT`) until the world ends.
/// `progress` is called after each answer.
///
/// # Errors
/// [`PlayError`]: if there is no bridge, or one that the simulator would not play with, or if the world cannot
/// continue.
pub fn play<W: World>(
    world: &mut W,
    address: &str,
    options: &ClientOptions,
    mut progress: impl FnMut(&ClientReport),
) -> Result<ClientReport, PlayError<W::Error>> {
    let mut client = Client {
        socket: handshake::connect(address)?,
        options,
        tokens: 1, // the WebSocket's own "open"
        report: ClientReport::default(),
        in_flight: VecDeque::new(),
        last_progress: Instant::now(),
        heard: 0,
        opened: false,
        swallowed: false,
    };
    client.send("2")?;
    // Some bridges (drive.py) greet with a `steer` of their own, which answers nothing.
    client.drain(options.greeting)?;
    let mut next_ping = Instant::now() + PING;
    let mut world_goes_on = true;
    while world_goes_on || !client.in_flight.is_empty() {
        if Instant::now() >= next_ping {
            client.send("2")?;
            next_ping += PING;
        }
        if client.tokens > 0 && world_goes_on {
            match world.observe().map_err(PlayError::World)? {
                Some(observation) => {
                    if client.in_flight.is_empty() {
                        // Kicks of a bridge that has waited for long, as in slow replays.
                        client.drain(Duration::ZERO)?;
                    }
                    client.observed(&observation.sight)?;
                }
                None => world_goes_on = false,
            }
            continue;
        }
        let answer = client.receive(next_ping)?;
        if std::mem::take(&mut client.swallowed) {
            world.unanswered();
        }
        if let Some(answer) = answer {
            world.apply(answer);
            progress(&client.report);
        }
    }
    client.send("41")?;
    client.send("1")?;
    // The bridge may have hung up on the goodbye already.
    let _ = client.socket.close(None).and_then(|()| client.socket.flush());
    Ok(client.report)
}

struct Client<'a> {
    socket: WebSocket<TcpStream>,
    options: &'a ClientOptions,
    tokens: u32,
    report: ClientReport,
    /// When the telemetries without an answer were sent.
    in_flight: VecDeque<Instant>,
    last_progress: Instant,
    /// Messages received.
    heard: u64,
    /// Whether an OPEN packet came since the last check.
    opened: bool,
    /// Whether an answer since the last check could not be read.
    swallowed: bool,
}

impl Client<'_> {
    fn observed(&mut self, sight: &Sight) -> Result<(), ClientError> {
        let text = match sight {
            Sight::Telemetry(telemetry) => {
                let encode = if self.options.stock { encode_telemetry } else { encode_superset };
                encode(telemetry, &base64_of(telemetry), self.options.culture)
            }
            // A message that could not be read when it was recorded is not in the recording.
            Sight::HumanDrives | Sight::Unreadable(_) => r#"42["telemetry",null]"#.to_owned(),
        };
        self.tokens -= 1;
        self.in_flight.push_back(Instant::now());
        self.report.telemetries += 1;
        self.send(&text)?;
        self.last_progress = Instant::now();
        Ok(())
    }

    /// One text message in masked fragments, one write each.
    fn send(&mut self, text: &str) -> Result<(), ClientError> {
        let bytes = text.as_bytes();
        let last = bytes.len().div_ceil(FRAGMENT).max(1) - 1;
        for i in 0..=last {
            let part = &bytes[i * FRAGMENT..((i + 1) * FRAGMENT).min(bytes.len())];
            let kind = if i == 0 { Data::Text } else { Data::Continue };
            let frame = Frame::message(part.to_vec(), OpCode::Data(kind), i == last);
            self.socket.send(Message::Frame(frame)).map_err(|source| self.broken(source))?;
        }
        Ok(())
    }

    fn broken(&self, source: tungstenite::Error) -> ClientError {
        ClientError::Broken { telemetries: self.report.telemetries, source }
    }

    fn death(&self, expected: &'static str, got: &str) -> ClientError {
        let got = got.chars().take(60).collect();
        ClientError::Death { telemetries: self.report.telemetries, expected, got }
    }

    /// Takes unrequested messages from the bridge for this long. The simulator would answer each with another
    /// telemetry; here every telemetry must have an answer of its own, so they are ignored.
    fn drain(&mut self, time: Duration) -> Result<(), ClientError> {
        let (tokens, until) = (self.tokens, Instant::now() + time);
        self.last_progress = Instant::now(); // nobody owes anything
        loop {
            let (before, now) = (self.heard, Instant::now());
            self.receive(until.max(now))?;
            if self.heard == before && Instant::now() >= until {
                break;
            }
        }
        self.tokens = tokens + u32::from(std::mem::take(&mut self.opened));
        Ok(())
    }

    /// Waits for one message, until `deadline` at the latest; `Some` is an answer.
    fn receive(&mut self, deadline: Instant) -> Result<Option<Answer>, ClientError> {
        let stalls_at = self.last_progress + self.options.stall;
        let wait = deadline.min(stalls_at).saturating_duration_since(Instant::now());
        // A timeout of zero would mean no timeout, and one of a microsecond takes a tick of the kernel.
        let stream = self.socket.get_ref();
        let set = if wait.is_zero() {
            stream.set_nonblocking(true)
        } else {
            stream.set_nonblocking(false).and_then(|()| stream.set_read_timeout(Some(wait)))
        };
        set.map_err(|e| self.broken(e.into()))?;
        let read = self.socket.read();
        if wait.is_zero() {
            self.socket.get_ref().set_nonblocking(false).map_err(|e| self.broken(e.into()))?;
        }
        match read {
            Ok(Message::Text(text)) => {
                self.heard += 1;
                self.text(&text)
            }
            Ok(Message::Binary(bytes)) => Err(self.death("text", &format!("{} bytes of binary", bytes.len()))),
            Ok(Message::Close(_)) => Err(self.broken(tungstenite::Error::ConnectionClosed)),
            Ok(_) => Ok(None),
            Err(tungstenite::Error::Io(e))
                if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) =>
            {
                if Instant::now() < stalls_at {
                    return Ok(None);
                }
                let ClientReport { telemetries, lost_tokens, .. } = self.report;
                Err(ClientError::Stalled { telemetries, lost_tokens, stall: self.options.stall })
            }
            Err(source) => Err(self.broken(source)),
        }
    }

    fn text(&mut self, text: &str) -> Result<Option<Answer>, ClientError> {
        const EVENT: &str = r#"["name"] or ["name",{…}]"#;
        let packet = Packet::parse(text).map_err(|_| self.death("an Engine.IO packet or an event", text))?;
        match packet {
            Packet::Open(json) => {
                let sid = serde_json::from_str::<serde_json::Value>(json).is_ok_and(|open| open.get("sid").is_some());
                if !sid {
                    return Err(self.death("an OPEN packet with sid", text));
                }
                self.tokens += 1; // the second "open"
                self.opened = true;
            }
            Packet::Ping(_) => self.send("3")?,
            Packet::Event(event) => {
                if event.arguments > 1 || event.payload.is_some_and(|p| !p.get().starts_with('{')) {
                    return Err(self.death(EVENT, text));
                }
                let answer = match &*event.name {
                    "manual" => Answer::Manual,
                    "steer" => match Command::parse_as_simulator(event.payload, self.options.culture) {
                        Ok(command) => Answer::Steer(command),
                        Err(error) => {
                            tracing::warn!("{error}");
                            self.report.lost_tokens += 1;
                            if let Some(sent) = self.in_flight.pop_front() {
                                self.report.round_trips.push(sent.elapsed());
                                self.swallowed = true;
                            }
                            return Ok(None);
                        }
                    },
                    _ => return Ok(None),
                };
                self.tokens += 1;
                self.report.answers += 1;
                self.last_progress = Instant::now();
                if let Some(sent) = self.in_flight.pop_front() {
                    self.report.round_trips.push(sent.elapsed());
                    return Ok(Some(answer));
                }
            }
            Packet::Close => return Err(self.death("no close packet: the simulator stalls for good", text)),
            Packet::Pong | Packet::Connect | Packet::Disconnect | Packet::Other => {}
        }
        Ok(None)
    }
}

fn base64_of(telemetry: &Telemetry) -> String {
    match &telemetry.image {
        CameraImage::Jpeg(jpeg) => STANDARD.encode(jpeg),
        CameraImage::Base64(text) => String::from_utf8_lossy(text).into_owned(),
    }
}

#[cfg(test)]
mod tests;
