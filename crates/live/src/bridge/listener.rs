//! The TCP side: binding with helpful errors, `TCP_NODELAY`, and `TCP_QUICKACK` after every read.
//!
//! The simulator writes a telemetry in 21 pieces with Nagle on: its last piece waits until the piece before is
//! acknowledged, and Linux delays that by 40 ms. `TCP_QUICKACK` turns the delay off, but only for a while, so it is set
//! again after each read; setting it once at accept does not help (44 ms per frame instead of 0.2 ms).

use std::{
    io,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
    pin::Pin,
    task::{Context, Poll, ready},
    time::{Duration, Instant},
};

use socket2::SockRef;
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    time::{Sleep, sleep},
};

use super::{guests::Seat, throttled::Throttled};

/// Bytes read from one connection before others get their turn. A telemetry is 21 KB, which arrive in pieces.
const TURN: usize = 16 << 10;

/// A port that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BindError {
    /// Another program listens there.
    #[error("port {port} is taken{}choose another port with {choose}", taken_by(holder.as_ref()))]
    Taken {
        /// The port.
        port: u16,
        /// The process, if the system reports it.
        holder: Option<Holder>,
        /// How the user chooses another port.
        choose: &'static str,
    },
    /// Anything else.
    #[error("cannot listen on {address}: {source}")]
    Io {
        /// The address to listen on.
        address: SocketAddr,
        /// Why not.
        source: io::Error,
    },
}

/// Which process holds a port.
#[derive(Debug, PartialEq, Eq)]
pub enum Holder {
    /// This one, which was given the same port twice.
    ThisProgram,
    /// Another one: its number and command line.
    Process(String),
}

fn taken_by(holder: Option<&Holder>) -> String {
    match holder {
        None => ": end that program, or ".into(),
        Some(Holder::ThisProgram) => " by this very program: ".into(),
        Some(Holder::Process(process)) => format!(" by {process}: end that program, or "),
    }
}

/// Where programs on this machine reach who listens on an address.
pub fn reached_here(address: SocketAddr) -> SocketAddr {
    let ip = match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    SocketAddr::new(ip, address.port())
}

/// How another port for simulators is chosen.
const SIMULATORS: &str = "--port (the simulator connects only to port 4567)";

impl BindError {
    /// The port is another one than that for simulators, and this flag chooses it.
    #[must_use]
    pub fn with_flag(self, flag: &'static str) -> Self {
        match self {
            Self::Taken { port, holder, .. } => Self::Taken { port, holder, choose: flag },
            other => other,
        }
    }
}

/// A bound port.
pub struct Listener {
    inner: TcpListener,
    address: SocketAddr,
    troubles: Throttled,
}

impl Listener {
    /// Listens. Port 0 takes a free one, see [`Listener::address`].
    ///
    /// # Errors
    /// [`BindError`], with the process that holds the port, if Linux reports it.
    pub async fn bind(address: SocketAddr) -> Result<Self, BindError> {
        let inner = TcpListener::bind(address).await.map_err(|source| match source.kind() {
            io::ErrorKind::AddrInUse => {
                BindError::Taken { port: address.port(), holder: holder_of(address.port()), choose: SIMULATORS }
            }
            _ => BindError::Io { address, source },
        })?;
        let address = inner.local_addr().map_err(|source| BindError::Io { address, source })?;
        Ok(Self { inner, address, troubles: Throttled::default() })
    }

    /// The listening address.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Listener {
    /// The next connection.
    pub(super) async fn accept(&self) -> (QuickAck, SocketAddr) {
        loop {
            match self.inner.accept().await {
                Ok((stream, peer)) => {
                    // Fails only on a socket that is closed already; the read will say so.
                    let _ = stream.set_nodelay(true);
                    let stream = QuickAck { stream, seat: None, unbroken: 0, stalled: None };
                    stream.arm();
                    return (stream, peer);
                }
                Err(error) => {
                    if let Some(more) = self.troubles.due(Instant::now()) {
                        tracing::warn!("a connection could not be accepted: {error}{more}");
                    }
                    // Out of file handles, most likely: some will become free.
                    sleep(Duration::from_millis(50)).await;
                }
            }
        }
    }
}

/// A TCP stream that acknowledges at once whatever it reads, and gives others their turn.
pub(super) struct QuickAck {
    stream: TcpStream,
    /// Its place among the connections, kept for as long as it lasts, and how long it may leave answers unread.
    seat: Option<(Seat, Duration)>,
    /// Bytes read since a read found none.
    unbroken: usize,
    /// The deadline for the peer to take what waits to be written.
    stalled: Option<Pin<Box<Sleep>>>,
}

impl QuickAck {
    pub fn seated(self, seat: Seat, patience: Duration) -> Self {
        Self { seat: Some((seat, patience)), ..self }
    }

    /// A client that sends requests and never reads the answers would keep its place for good. WebSockets have their
    /// own rules: a paused simulator may be slow to read.
    fn patiently<T>(&mut self, cx: &mut Context<'_>, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        match &self.seat {
            Some((seat, patience)) if written.is_pending() && !seat.is_websocket() => {
                let stalled = self.stalled.get_or_insert_with(|| Box::pin(sleep(*patience)));
                ready!(stalled.as_mut().poll(cx));
                Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "the answers are not read")))
            }
            _ => {
                self.stalled = None;
                written
            }
        }
    }

    fn arm(&self) {
        #[cfg(target_os = "linux")]
        let _ = SockRef::from(&self.stream).set_tcp_quickack(true); // fails on a closed socket only
    }
}

impl AsyncRead for QuickAck {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        // Reading an endless stream would never yield this thread.
        if self.unbroken >= TURN {
            self.unbroken = 0;
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
        let before = buf.filled().len();
        let result = Pin::new(&mut self.stream).poll_read(cx, buf);
        if result.is_ready() {
            self.unbroken += buf.filled().len() - before;
            self.arm();
        } else {
            self.unbroken = 0;
        }
        result
    }
}

impl AsyncWrite for QuickAck {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, buf);
        self.patiently(cx, written)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, bufs);
        self.patiently(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

/// The process that listens on a port, by Linux's /proc; `None` if that does not show it (another system, or a process
/// of another user).
fn holder_of(port: u16) -> Option<Holder> {
    let listening = |table: &str| {
        let text = std::fs::read_to_string(table).ok()?;
        text.lines().skip(1).find_map(|line| {
            let fields: Vec<&str> = line.split_whitespace().collect();
            let local = fields.get(1)?.rsplit_once(':')?.1;
            let is_it = u16::from_str_radix(local, 16) == Ok(port) && *fields.get(3)? == "0A"; // LISTEN
            is_it.then(|| fields.get(9).map(|inode| format!("socket:[{inode}]")))?
        })
    };
    let socket = listening("/proc/net/tcp").or_else(|| listening("/proc/net/tcp6"))?;
    std::fs::read_dir("/proc").ok()?.flatten().find_map(|process| {
        let pid: u32 = process.file_name().to_str()?.parse().ok()?;
        let holds = std::fs::read_dir(process.path().join("fd"))
            .ok()?
            .flatten()
            .any(|fd| std::fs::read_link(fd.path()).is_ok_and(|link| link.as_os_str() == socket.as_str()));
        holds.then(|| {
            if pid == std::process::id() {
                return Holder::ThisProgram;
            }
            let command = std::fs::read(process.path().join("cmdline")).unwrap_or_default();
            Holder::Process(format!("process {pid} ({})", command_line(&command)))
        })
    })
}

/// A command line for a message: others wrote it, and it may hold line breaks and escape codes.
fn command_line(arguments: &[u8]) -> String {
    let text = String::from_utf8_lossy(arguments).replace(char::is_control, " ");
    text.trim().chars().take(100).collect()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::{
        super::guests::{Guests, Role},
        *,
    };

    #[tokio::test]
    async fn a_port_that_this_program_holds_already_is_told_so() {
        let first = Listener::bind(([127, 0, 0, 1], 0).into()).await.unwrap();
        let error = Listener::bind(first.address()).await.err().unwrap().with_flag("--foxglove").to_string();
        let port = first.address().port();
        let expected = format!("port {port} is taken by this very program: choose another port with --foxglove");
        assert_eq!(error, expected);
    }

    #[test]
    fn the_command_line_of_another_program_breaks_no_message() {
        assert_eq!(command_line(b"python\0-c\0import a\nrun()\x1b[31m\0"), "python -c import a run() [31m");
        assert_eq!(command_line(&[b'x'; 200]).len(), 100);
    }

    /// The option does not stay set: the kernel clears it as soon as data flows both ways.
    #[tokio::test]
    async fn acknowledgements_are_quick_again_after_every_read() {
        use tokio::io::{AsyncReadExt, AsyncWriteExt};
        let listener = Listener::bind(([127, 0, 0, 1], 0).into()).await.unwrap();
        let mut client = TcpStream::connect(listener.address()).await.unwrap();
        let (mut server, _) = listener.accept().await;
        let mut left = 0;
        for _ in 0..50 {
            client.write_all(&[7; 500]).await.unwrap();
            server.read_exact(&mut [0; 500]).await.unwrap();
            assert!(SockRef::from(&server.stream).tcp_quickack().unwrap());
            server.write_all(&[7; 100]).await.unwrap();
            left += u32::from(!SockRef::from(&server.stream).tcp_quickack().unwrap());
            client.read_exact(&mut [0; 100]).await.unwrap();
        }
        assert!(left > 0, "this kernel does not leave the mode, so this test shows nothing");
    }

    #[tokio::test]
    async fn who_reads_no_answers_is_waited_for_and_then_gone_unless_it_is_a_websocket() {
        use tokio::io::AsyncWriteExt;
        let (gone, waited_for) = (Some(io::ErrorKind::TimedOut), None);
        for (role, expected) in [(Role::Http, gone), (Role::Simulator, waited_for), (Role::Client, waited_for)] {
            let listener = Listener::bind(([127, 0, 0, 1], 0).into()).await.unwrap();
            let _deaf = TcpStream::connect(listener.address()).await.unwrap();
            let (stream, address) = listener.accept().await;
            let (seat, peer) = Guests::new(1).admit(address).await.unwrap();
            peer.is(role);
            let mut stream = stream.seated(seat, Duration::from_millis(100));
            let failed = async {
                loop {
                    if let Err(error) = stream.write_all(&[0; 1 << 16]).await {
                        return error.kind();
                    }
                }
            };
            assert_eq!(tokio::time::timeout(Duration::from_secs(1), failed).await.ok(), expected, "{role}");
        }
    }

    #[tokio::test]
    async fn an_address_of_another_machine_is_an_error_that_names_it() {
        let error = Listener::bind(([192, 0, 2, 1], 4567).into()).await.err().unwrap().to_string();
        assert!(error.starts_with("cannot listen on 192.0.2.1:4567: "), "{error}");
    }
}
