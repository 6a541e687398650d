//! The memory that messages use, from their first byte until they are answered.
//!
//! Half of the limit is divided among connections, so that an ordinary message always finds room; the other half is a
//! pool for large ones. A connection that finds the pool empty is dropped, and so is one whose large message does not
//! arrive in time: no connection can starve the others.

use std::{
    collections::HashMap,
    net::SocketAddr,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll},
    time::Duration,
};

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use hyper::body::{Frame, SizeHint};
use tokio::time::{Sleep, sleep};

use super::Bridge;
use lapwing_core::{config::Limits, words::first_five};

/// What a chunk of a body costs beside its bytes.
const PER_CHUNK: usize = 64;

/// Why a connection is dropped.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum Abuse {
    /// One message beyond the limit.
    #[error("message too large: expected at most {} KiB (bridge.limits.message_mib), got at least {} KiB", most >> 10, got.div_ceil(1024))]
    TooLarge {
        /// The limit, in bytes.
        most: usize,
        /// What is announced or was received, in bytes.
        got: u64,
    },
    /// All messages together beyond the limit.
    #[error("no room for a message of {} KiB: large messages may take up {} MiB together (half of bridge.limits.in_flight_mib), held now by {holders}", wanted >> 10, pool >> 20)]
    NoRoom {
        /// Bytes of the message so far, or announced.
        wanted: usize,
        /// Bytes that the pool has.
        pool: usize,
        /// Which connections hold them.
        holders: String,
    },
    /// A large message that arrives too slowly, holding room that others may need.
    #[error("message too slow: expected all of it within {0:?} (bridge.limits.patience_s)")]
    Slow(Duration),
    /// A message in tiny fragments.
    #[error("too many fragments: expected at most {most} for {bytes} bytes")]
    Crumbs {
        /// How many fragments are allowed for this many bytes.
        most: usize,
        /// Bytes so far.
        bytes: usize,
    },
    /// Work without content.
    #[error("too many pings and empty messages: expected at most {0} a second")]
    Chatter(u32),
    /// A ping, pong or close longer than allowed.
    #[error("control frame: expected at most 125 bytes, got {0}")]
    Control(u64),
}

/// The room for all messages.
#[derive(Debug)]
pub(super) struct InFlight {
    /// Bytes reserved for each connection.
    own: usize,
    /// Bytes of the pool.
    pool: usize,
    drawn: Mutex<LoadShares>,
}

#[derive(Debug, Default)]
struct LoadShares {
    bytes: usize,
    by: HashMap<u64, (SocketAddr, usize)>,
    next_id: u64,
}

/// The memory of one connection's messages; released when dropped.
#[derive(Debug)]
pub(super) struct Load {
    of: Arc<InFlight>,
    id: u64,
    peer: SocketAddr,
    /// Bytes in all.
    bytes: usize,
    /// Bytes among them from the pool.
    drawn: usize,
}

impl InFlight {
    pub fn new(limits: &Limits) -> Arc<Self> {
        // Each connection has a message that is being received, and its session has others that wait.
        let shares = 2 * limits.connections();
        let pool = limits.in_flight() / 2;
        Arc::new(Self { own: pool / shares, pool, drawn: Mutex::default() })
    }

    /// An empty load of this peer.
    pub fn load(self: &Arc<Self>, peer: SocketAddr) -> Load {
        let mut drawn = self.lock();
        drawn.next_id += 1;
        let id = drawn.next_id;
        drop(drawn);
        Load { of: self.clone(), id, peer, bytes: 0, drawn: 0 }
    }

    fn lock(&self) -> MutexGuard<'_, LoadShares> {
        self.drawn.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl LoadShares {
    /// `127.0.0.1:5000 4.0 MiB, …`, the largest first.
    fn who(&self) -> String {
        let mut by: Vec<_> = self.by.values().collect();
        by.sort_by_key(|(peer, bytes)| (usize::MAX - bytes, *peer));
        let who = by.iter().map(|(peer, bytes)| format!("{peer} {:.1} MiB", *bytes as f64 / (1 << 20) as f64));
        first_five(who.collect()).join(", ")
    }
}

impl Load {
    /// Sets the bytes in use, more or fewer than before.
    ///
    /// # Errors
    /// [`Abuse::NoRoom`]; the load is then as it was.
    pub fn hold(&mut self, bytes: usize) -> Result<(), Abuse> {
        let wanted = bytes.saturating_sub(self.of.own);
        if wanted != self.drawn {
            let mut drawn = self.of.lock();
            let others = drawn.bytes - self.drawn;
            if wanted > self.drawn && others + wanted > self.of.pool {
                return Err(Abuse::NoRoom { wanted: bytes, pool: self.of.pool, holders: drawn.who() });
            }
            drawn.bytes = others + wanted;
            match wanted {
                0 => drop(drawn.by.remove(&self.id)),
                wanted => drop(drawn.by.insert(self.id, (self.peer, wanted))),
            }
            self.drawn = wanted;
        }
        self.bytes = bytes;
        Ok(())
    }

    /// Uses more bytes.
    ///
    /// # Errors
    /// As [`hold`](Self::hold).
    pub fn grow(&mut self, bytes: usize) -> Result<(), Abuse> {
        self.hold(self.bytes.saturating_add(bytes))
    }

    /// Uses fewer bytes.
    pub fn shrink(&mut self, bytes: usize) {
        // Shrinking always succeeds.
        let _ = self.hold(self.bytes.saturating_sub(bytes));
    }

    /// Whether it holds a part of the pool.
    pub fn is_large(&self) -> bool {
        self.drawn > 0
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.shrink(self.bytes);
    }
}

/// A request's body, counted as it comes.
pub(super) struct Counted {
    body: Body,
    bridge: Arc<Bridge>,
    load: Load,
    bytes: u64,
    most: usize,
    patience: Duration,
    deadline: Pin<Box<Sleep>>,
}

impl Counted {
    pub fn new(body: Body, bridge: Arc<Bridge>, peer: SocketAddr) -> Self {
        let limits = &bridge.settings.bridge.limits;
        let (most, patience) = (limits.message(), limits.patience());
        let load = bridge.in_flight.load(peer);
        Self { body, bridge, load, bytes: 0, most, patience, deadline: Box::pin(sleep(patience)) }
    }

    fn count(&mut self, frame: &Frame<Bytes>) -> Result<(), Abuse> {
        let bytes = frame.data_ref().map_or(0, Bytes::len);
        self.bytes += bytes as u64;
        if self.bytes > self.most as u64 {
            return Err(Abuse::TooLarge { most: self.most, got: self.bytes });
        }
        self.load.grow(bytes + PER_CHUNK)
    }

    fn turned_away(&self, why: Abuse) -> axum::Error {
        self.bridge.turned_away(self.load.peer, &why);
        axum::Error::new(why)
    }
}

impl HttpBody for Counted {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        match Pin::new(&mut this.body).poll_frame(cx) {
            Poll::Ready(Some(Ok(frame))) => {
                Poll::Ready(Some(this.count(&frame).map(|()| frame).map_err(|why| this.turned_away(why))))
            }
            Poll::Pending if this.deadline.as_mut().poll(cx).is_ready() => {
                Poll::Ready(Some(Err(this.turned_away(Abuse::Slow(this.patience)))))
            }
            other => other,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use lapwing_core::config::Settings;

    const MIB: usize = 1 << 20;

    fn peer(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    fn room(in_flight_mib: u32, connections: u32) -> Arc<InFlight> {
        InFlight::new(&Limits { in_flight_mib, connections, ..Limits::default() })
    }

    #[test]
    fn an_ordinary_message_finds_room_whatever_the_others_hold() {
        let room = room(64, 64);
        let mut greedy: Vec<_> = (0..9).map(|i| room.load(peer(5000 + i))).collect();
        let refused = greedy.iter_mut().filter_map(|load| load.hold(4 * MIB).err()).next_back().unwrap();
        let words = refused.to_string();
        assert!(
            words.contains("32 MiB") && words.contains("127.0.0.1:5001 3.8 MiB") && words.contains("3 more"),
            "{words}"
        );
        let mut good = room.load(peer(6000));
        good.hold(256 << 10).unwrap();
        assert!(good.hold(4 * MIB).is_err() && !good.is_large());
        greedy.clear();
        good.hold(4 * MIB).unwrap();
        assert!(good.is_large());
    }

    #[test]
    fn all_together_stay_within_the_limit() {
        let room = room(16, 8);
        let mut loads: Vec<_> = (0..16).map(|i| room.load(peer(i))).collect();
        let mut total = 0;
        for load in &mut loads {
            for step in 1..=64 {
                if load.hold(step * MIB / 16).is_err() {
                    break;
                }
            }
            total += load.bytes;
        }
        assert!((15 * MIB..=16 * MIB).contains(&total), "{total}");
        loads.clear();
        let drawn = room.lock();
        assert_eq!((drawn.bytes, drawn.by.len()), (0, 0));
    }

    #[tokio::test]
    async fn a_body_is_cut_off_where_it_is_too_large_too_slow_or_finds_no_room() {
        use futures_util::StreamExt;
        let bridge = || {
            let mut settings = Settings::default();
            settings.bridge.limits = Limits { message_mib: 1, in_flight_mib: 2, patience_s: 0.2, ..Limits::default() };
            Bridge::new(settings, |_| ())
        };
        let last = async |chunks: Vec<usize>, never_ends: bool| {
            let chunks = futures_util::stream::iter(chunks).map(|n| Ok::<_, axum::Error>(Bytes::from(vec![0; n])));
            let rest = futures_util::stream::iter((!never_ends).then_some(())).map(|()| Ok(Bytes::new()));
            let open = futures_util::stream::pending();
            let body =
                if never_ends { Body::from_stream(chunks.chain(open)) } else { Body::from_stream(chunks.chain(rest)) };
            let bridge = bridge();
            let mut body = Body::new(Counted::new(body, bridge.clone(), peer(1))).into_data_stream();
            let mut last = Ok(());
            while let Some(chunk) = body.next().await {
                last = chunk.map(drop).map_err(|e| e.to_string());
                if last.is_err() {
                    break;
                }
            }
            let told = bridge.dropped.due(Instant::now()).is_none();
            assert_eq!(told, last.is_err(), "who is cut off is named in the log");
            last
        };
        assert_eq!(last(vec![MIB / 4; 3], false).await, Ok(()));
        assert!(last(vec![MIB / 4; 5], false).await.unwrap_err().contains("at most 1024 KiB"));
        assert!(
            last(vec![1; 20_000], false).await.unwrap_err().contains("no room for a message"),
            "tiny fragments cost more than their bytes"
        );
        assert!(last(vec![1; 10], true).await.unwrap_err().contains("within 200ms"));
    }
}
