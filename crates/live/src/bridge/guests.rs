//! Counts TCP connections from accept to close, and limits how many there are at a time.

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    fmt,
    net::{IpAddr, SocketAddr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::sync::Notify;

use super::throttled::Throttled;
use lapwing_core::words::first_five;

/// How long a newcomer waits for a place before it is turned away. Only one waits at a time: a simulator that redials
/// as soon as it is turned away costs one try a second, not thousands.
const WAIT: Duration = Duration::from_secs(1);

/// How long a polling client's session lives if it is opened and never used again.
const FORGOTTEN: Duration = Duration::from_secs(20);

/// What a connection has turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    /// It has not asked for anything yet.
    Silent,
    /// It uses HTTP, as polling clients do.
    Http,
    Simulator,
    /// The WebSocket of an ordinary Socket.IO client.
    Client,
    /// The WebSocket of a page that shows the drives.
    Page,
    /// The WebSocket of Foxglove or Lichtblick.
    Viewer,
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Silent => "silent",
            Self::Http => "HTTP",
            Self::Simulator => "simulator",
            Self::Client => "Socket.IO",
            Self::Page => "page",
            Self::Viewer => "viewer",
        })
    }
}

/// All who are connected.
#[derive(Debug)]
pub(super) struct Guests {
    most: usize,
    present: Mutex<Present>,
    /// A place has become free.
    left: Notify,
    /// Log lines about newcomers that found no place.
    full: Throttled,
}

#[derive(Debug, Default)]
struct Present {
    guests: HashMap<u64, (IpAddr, Role)>,
    next_id: u64,
    /// When polling clients recently opened their sessions.
    sessions: VecDeque<Instant>,
}

/// A connection's place; free again when dropped.
#[derive(Debug)]
pub(super) struct Seat {
    id: u64,
    guests: Arc<Guests>,
}

/// The peer of a connection; accompanies each of its requests.
#[derive(Debug, Clone)]
pub(super) struct Peer {
    pub address: SocketAddr,
    id: u64,
    guests: Arc<Guests>,
}

impl Guests {
    pub fn new(most: usize) -> Arc<Self> {
        Arc::new(Self { most, present: Mutex::default(), left: Notify::new(), full: Throttled::default() })
    }

    /// A place for a newcomer, now or within a second.
    pub async fn admit(self: &Arc<Self>, address: SocketAddr) -> Option<(Seat, Peer)> {
        if let Some(seat) = self.seat(address) {
            return Some(seat);
        }
        if let Some(more) = self.full.due(Instant::now()) {
            tracing::warn!(
                "{address} found no place: {} connections are open, as many as bridge.limits.connections allows ({}){more}",
                self.most,
                self.who()
            );
        }
        let free = async {
            loop {
                self.left.notified().await;
                if let Some(seat) = self.seat(address) {
                    return seat;
                }
            }
        };
        tokio::time::timeout(WAIT, free).await.ok()
    }

    fn seat(self: &Arc<Self>, address: SocketAddr) -> Option<(Seat, Peer)> {
        let mut present = self.lock();
        if present.guests.len() >= self.most {
            return None;
        }
        let id = present.next_id;
        present.next_id += 1;
        present.guests.insert(id, (address.ip(), Role::Silent));
        Some((Seat { id, guests: self.clone() }, Peer { address, id, guests: self.clone() }))
    }

    /// Whether one more session may be opened by polling: sessions outlive the connections that open them.
    pub fn may_poll(&self, now: Instant) -> bool {
        let sessions = &mut self.lock().sessions;
        while sessions.front().is_some_and(|opened| now.saturating_duration_since(*opened) > FORGOTTEN) {
            sessions.pop_front();
        }
        let may = sessions.len() < self.most;
        if may {
            sessions.push_back(now);
        }
        may
    }

    /// Who holds the places: `127.0.0.1: 60 silent, 4 simulator`.
    fn who(&self) -> String {
        let mut by_address = BTreeMap::<IpAddr, BTreeMap<Role, usize>>::new();
        for (address, role) in self.lock().guests.values() {
            *by_address.entry(*address).or_default().entry(*role).or_default() += 1;
        }
        let roles = |roles: BTreeMap<Role, usize>| {
            roles.into_iter().map(|(role, count)| format!("{count} {role}")).collect::<Vec<_>>().join(", ")
        };
        let who = by_address.into_iter().map(|(ip, counts)| format!("{ip}: {}", roles(counts)));
        first_five(who.collect()).join("; ")
    }

    fn lock(&self) -> MutexGuard<'_, Present> {
        self.present.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Peer {
    /// Records what the connection has turned out to be.
    pub fn is(&self, role: Role) {
        if let Some((_, known)) = self.guests.lock().guests.get_mut(&self.id) {
            *known = role;
        }
    }
}

impl Seat {
    /// Whether the connection has become a WebSocket.
    pub fn is_websocket(&self) -> bool {
        matches!(
            self.guests.lock().guests.get(&self.id),
            Some((_, Role::Simulator | Role::Client | Role::Page | Role::Viewer))
        )
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.guests.lock().guests.remove(&self.id);
        self.guests.left.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from(last: u8) -> SocketAddr {
        ([127, 0, 0, last], 5000).into()
    }

    #[tokio::test]
    async fn a_newcomer_too_many_waits_a_second_and_is_turned_away() {
        let guests = Guests::new(2);
        let _first = guests.admit(from(1)).await.unwrap();
        let _second = guests.admit(from(1)).await.unwrap();
        let began = Instant::now();
        assert!(guests.admit(from(2)).await.is_none());
        assert!(began.elapsed() >= WAIT);
    }

    #[tokio::test]
    async fn a_place_that_becomes_free_is_taken_at_once() {
        let guests = Guests::new(1);
        let first = guests.admit(from(1)).await.unwrap();
        let began = Instant::now();
        let (second, ()) = tokio::join!(guests.admit(from(2)), async { drop(first) });
        assert!(second.is_some());
        assert!(began.elapsed() < WAIT);
    }

    #[tokio::test]
    async fn it_is_known_who_holds_the_places() {
        let guests = Guests::new(9);
        let (_a, a) = guests.admit(from(1)).await.unwrap();
        let _b = guests.admit(from(1)).await.unwrap();
        let _c = guests.admit(from(1)).await.unwrap();
        let (_d, d) = guests.admit(from(2)).await.unwrap();
        a.is(Role::Simulator);
        d.is(Role::Client);
        assert_eq!(guests.who(), "127.0.0.1: 2 silent, 1 simulator; 127.0.0.2: 1 Socket.IO");
    }

    #[test]
    fn sessions_opened_by_polling_are_limited_as_long_as_they_live() {
        let (guests, start) = (Guests::new(2), Instant::now());
        let may = |s| guests.may_poll(start + Duration::from_secs(s));
        assert_eq!([may(0), may(10), may(15), may(21), may(22)], [true, true, false, true, false]);
    }
}
