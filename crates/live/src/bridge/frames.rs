//! Checks a WebSocket's bytes frame by frame before they are unpacked: how large a message grows, and whether it has
//! any content.
//!
//! Empty fragments and endless pings cost as much as telemetry without being any, so a client that sends them is
//! dropped. The simulator's own fragments hold 1016 bytes, its pings come 25 s apart.

use std::{
    io,
    net::SocketAddr,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::{Duration, Instant},
};

use bytes::{Buf, Bytes};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    time::{Sleep, sleep},
};

use super::{
    Bridge,
    load::{Abuse, Load},
};

/// Fragments that a message may have whatever their size.
const FREE_FRAGMENTS: usize = 64;
/// One more fragment is allowed per this many bytes.
const FRAGMENT: usize = 128;

/// A message of fewer bytes has no content: `2` is a ping, `41` a goodbye.
const SAYS_NOTHING: usize = 8;
/// How many of those are allowed per second, control frames included.
const CHATTER: u32 = 256;

/// Bytes that a control frame may have (RFC 6455, 5.5).
const CONTROL: u64 = 125;

/// Where in the stream of frames a connection is.
#[derive(Debug)]
struct FramePosition {
    /// The largest message, in bytes.
    most: usize,
    /// The header that is being read: 2 bytes, up to 8 of length, 4 of mask.
    head: [u8; 14],
    have: usize,
    /// Bytes of the frame's payload still to come.
    left: u64,
    /// Whether a message has begun whose last fragment has not.
    open: bool,
    /// Number of the message, and how many of its bytes and fragments were announced.
    number: u64,
    bytes: usize,
    fragments: usize,
    /// Messages without content, and since when they are counted.
    chatter: u32,
    since: Option<Instant>,
}

impl FramePosition {
    fn new(most: usize) -> Self {
        Self {
            most,
            head: [0; 14],
            have: 0,
            left: 0,
            open: false,
            number: 0,
            bytes: 0,
            fragments: 0,
            chatter: 0,
            since: None,
        }
    }

    /// Whether neither a message nor a frame is incomplete.
    fn at_rest(&self) -> bool {
        !self.open && self.left == 0 && self.have == 0
    }

    /// Follows what was read.
    fn read(&mut self, mut bytes: &[u8], now: Instant) -> Result<(), Abuse> {
        while !bytes.is_empty() {
            if self.left > 0 {
                let n = usize::try_from(self.left).unwrap_or(usize::MAX).min(bytes.len());
                self.left -= n as u64;
                bytes = &bytes[n..];
                continue;
            }
            self.head[self.have] = bytes[0];
            self.have += 1;
            bytes = &bytes[1..];
            if self.have == self.head_length() {
                self.have = 0;
                self.frame(now)?;
            }
        }
        Ok(())
    }

    /// How long the header is, as far as it is known.
    fn head_length(&self) -> usize {
        if self.have < 2 {
            return 2;
        }
        let mask = if self.head[1] & 0x80 == 0 { 0 } else { 4 };
        mask + match self.head[1] & 0x7f {
            126 => 4,
            127 => 10,
            _ => 2,
        }
    }

    /// A frame begins.
    fn frame(&mut self, now: Instant) -> Result<(), Abuse> {
        let [first, second, length @ ..] = self.head;
        self.left = match second & 0x7f {
            126 => u64::from(u16::from_be_bytes([length[0], length[1]])),
            127 => u64::from_be_bytes(std::array::from_fn(|i| length[i])),
            length => u64::from(length),
        };
        let (last, kind) = (first & 0x80 != 0, first & 0x0f);
        if kind >= 8 {
            // Ping, pong, close. Their bytes are not counted elsewhere, so there must be few.
            return if self.left > CONTROL { Err(Abuse::Control(self.left)) } else { self.says_nothing(now) };
        }
        if !self.open {
            (self.number, self.bytes, self.fragments) = (self.number + 1, 0, 0);
        }
        self.open = !last;
        let got = self.left.saturating_add(self.bytes as u64);
        self.bytes = match usize::try_from(got) {
            Ok(bytes) if bytes <= self.most => bytes,
            _ => return Err(Abuse::TooLarge { most: self.most, got }),
        };
        self.fragments += 1;
        let most = FREE_FRAGMENTS + self.bytes / FRAGMENT;
        if self.fragments > most {
            return Err(Abuse::Crumbs { most, bytes: self.bytes });
        }
        if last && self.bytes < SAYS_NOTHING { self.says_nothing(now) } else { Ok(()) }
    }

    fn says_nothing(&mut self, now: Instant) -> Result<(), Abuse> {
        if self.since.is_none_or(|since| now.saturating_duration_since(since) > Duration::from_secs(1)) {
            (self.since, self.chatter) = (Some(now), 0);
        }
        self.chatter += 1;
        if self.chatter > CHATTER { Err(Abuse::Chatter(CHATTER)) } else { Ok(()) }
    }
}

/// A WebSocket's stream that ends with an error if its frames are abusive.
pub(super) struct Watched<S> {
    socket: S,
    /// What was read of it before.
    ahead: Bytes,
    frames: FramePosition,
    load: Load,
    /// The number of a large message, and when it must be complete.
    deadline: Option<(u64, Pin<Box<Sleep>>)>,
    patience: Duration,
    peer: SocketAddr,
    bridge: Arc<Bridge>,
}

impl<S> Watched<S> {
    /// `ahead` is what was read from the socket since its handshake.
    pub fn new(socket: S, ahead: Bytes, bridge: Arc<Bridge>, peer: SocketAddr) -> Self {
        let limits = &bridge.settings.bridge.limits;
        let (frames, patience) = (FramePosition::new(limits.message()), limits.patience());
        Self { socket, ahead, frames, load: bridge.in_flight.load(peer), deadline: None, patience, peer, bridge }
    }

    fn look(&mut self, read: &[u8]) -> Result<(), Abuse> {
        self.frames.read(read, Instant::now())?;
        self.load.hold(self.frames.bytes)?;
        if !self.load.is_large() {
            self.deadline = None;
        } else if self.deadline.as_ref().is_none_or(|(number, _)| *number != self.frames.number) {
            self.deadline = Some((self.frames.number, Box::pin(sleep(self.patience))));
        }
        Ok(())
    }

    fn turned_away(&self, why: Abuse) -> io::Error {
        self.bridge.turned_away(self.peer, &why);
        io::Error::other(why)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = &mut *self;
        if this.frames.at_rest() {
            // The reader has finished with the previous bytes, which must not count towards a ping that comes next.
            this.frames.bytes = 0;
            this.load.shrink(usize::MAX);
            this.deadline = None;
        }
        let before = buf.filled().len();
        if this.ahead.is_empty() {
            match Pin::new(&mut this.socket).poll_read(cx, buf)? {
                Poll::Ready(()) => {}
                Poll::Pending => {
                    let late = this.deadline.as_mut().is_some_and(|(_, until)| until.as_mut().poll(cx).is_ready());
                    return if late {
                        Poll::Ready(Err(this.turned_away(Abuse::Slow(this.patience))))
                    } else {
                        Poll::Pending
                    };
                }
            }
        } else {
            let n = this.ahead.len().min(buf.remaining());
            buf.put_slice(&this.ahead[..n]);
            this.ahead.advance(n);
        }
        Poll::Ready(this.look(&buf.filled()[before..]).map_err(|why| this.turned_away(why)))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.socket).poll_write(cx, buf)
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
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;
    use lapwing_core::config::Settings;

    const MOST: usize = 4 << 20;

    /// A masked frame.
    fn frame(first: u8, payload: usize) -> Vec<u8> {
        let mut bytes = vec![first];
        match payload {
            n @ 0..=125 => bytes.push(0x80 | n as u8),
            n @ 126..=65535 => {
                bytes.push(0x80 | 126);
                bytes.extend((n as u16).to_be_bytes());
            }
            n => {
                bytes.push(0x80 | 127);
                bytes.extend((n as u64).to_be_bytes());
            }
        }
        bytes.extend([7; 4]);
        bytes.resize(bytes.len() + payload, 0x82); // looks like a header but is not one
        bytes
    }

    /// A message in fragments of a given size.
    fn message(bytes: usize, fragment: usize) -> Vec<u8> {
        let count = bytes.div_ceil(fragment).max(1);
        let part = |i: usize| {
            let first = if i == 0 { 1 } else { 0 } | if i + 1 == count { 0x80 } else { 0 };
            frame(first, fragment.min(bytes - i * fragment))
        };
        (0..count).flat_map(part).collect()
    }

    #[test]
    fn telemetries_pass_in_whatever_pieces_they_are_read() {
        let (now, telemetry) = (Instant::now(), message(20_600, 1016));
        for piece in [1, 2, 3, 7, 1000, 4096, usize::MAX] {
            let mut frames = FramePosition::new(MOST);
            for _ in 0..3 {
                for part in telemetry.chunks(piece) {
                    frames.read(part, now).unwrap();
                }
                assert!(frames.at_rest(), "{piece}");
                assert_eq!((frames.bytes, frames.fragments), (20_600, 21));
            }
            assert_eq!(frames.number, 3);
        }
    }

    #[test]
    fn a_message_beyond_the_limit_is_refused_as_soon_as_it_is_announced() {
        let now = Instant::now();
        FramePosition::new(MOST).read(&message(MOST, 1 << 20), now).unwrap();
        let whole = FramePosition::new(MOST).read(&frame(0x81, MOST + 1)[..14], now);
        assert_eq!(whole, Err(Abuse::TooLarge { most: MOST, got: MOST as u64 + 1 }));
        let in_parts = FramePosition::new(MOST).read(&message(MOST + 1, 1016), now);
        assert!(matches!(in_parts, Err(Abuse::TooLarge { .. })), "{in_parts:?}");
        let absurd = [0x81, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1, 2, 3, 4];
        assert!(matches!(FramePosition::new(MOST).read(&absurd, now), Err(Abuse::TooLarge { got: u64::MAX, .. })));
    }

    #[test]
    fn fragments_with_little_or_nothing_in_them_are_refused_after_some() {
        let now = Instant::now();
        let mut empty = frame(1, 0);
        for _ in 0..FREE_FRAGMENTS - 1 {
            empty.extend(frame(0, 0));
        }
        let mut frames = FramePosition::new(MOST);
        frames.read(&empty, now).unwrap();
        assert_eq!(frames.read(&frame(0, 0), now), Err(Abuse::Crumbs { most: 64, bytes: 0 }));
        assert!(FramePosition::new(MOST).read(&message(20_600, 1), now).is_err());
        assert!(
            FramePosition::new(MOST).read(&message(20_600, 125), now).is_ok(),
            "small ones, yet worth their header"
        );
    }

    #[test]
    fn more_pings_than_anybody_needs_are_refused_and_a_second_later_there_are_new_ones() {
        let now = Instant::now();
        for ping in [frame(0x89, 0), message(1, 10), message(0, 10)] {
            let mut frames = FramePosition::new(MOST);
            for _ in 0..CHATTER {
                frames.read(&ping, now).unwrap();
            }
            frames.read(&message(21, 1016), now).unwrap();
            assert_eq!(frames.read(&ping, now), Err(Abuse::Chatter(CHATTER)));
            frames.read(&ping, now + Duration::from_millis(1001)).unwrap();
        }
    }

    #[test]
    fn a_control_frame_of_more_bytes_than_one_may_have_is_refused_as_soon_as_it_is_announced() {
        let now = Instant::now();
        for first in [0x88, 0x89, 0x8a] {
            FramePosition::new(MOST).read(&frame(first, 125), now).unwrap();
            assert_eq!(FramePosition::new(MOST).read(&frame(first, 126)[..8], now), Err(Abuse::Control(126)));
            assert_eq!(FramePosition::new(MOST).read(&frame(first, MOST)[..14], now), Err(Abuse::Control(MOST as u64)));
        }
    }

    #[tokio::test]
    async fn a_ping_after_a_large_message_takes_up_nothing() {
        let bridge = Bridge::new(Settings::default(), |_| ());
        let (large, ping) = (message(MOST, 1 << 20), frame(0x89, 4));
        let (mut simulator, socket) = tokio::io::duplex(64);
        let mut watched = Watched::new(socket, large.clone().into(), bridge, ([127, 0, 0, 1], 5000).into());
        watched.read_exact(&mut vec![0; large.len()]).await.unwrap();
        assert!(watched.load.is_large());
        simulator.write_all(&ping).await.unwrap();
        watched.read_exact(&mut vec![0; ping.len()]).await.unwrap();
        assert!(!watched.load.is_large());
    }

    #[test]
    fn a_ping_amid_a_message_leaves_the_message_as_it_is() {
        let now = Instant::now();
        let mut frames = FramePosition::new(MOST);
        frames.read(&frame(1, 1016), now).unwrap();
        frames.read(&frame(0x89, 4), now).unwrap();
        assert!(!frames.at_rest());
        frames.read(&frame(0x80, 100), now).unwrap();
        assert!(frames.at_rest());
        assert_eq!((frames.bytes, frames.fragments, frames.number), (1116, 2, 1));
    }
}
