//! Drives as they happen, for Foxglove and Lichtblick: the channels of a run, over the WebSocket protocol that both speak.
//!
//! ```text
//! session, or drive's loop ─▶ Feed ─▶ Messages ─┬─▶ ring of the newest ─┬─▶ a WebSocket for each viewer
//!                                               └─▶ newest picture ─────┘
//! ```
//! | file | holds |
//! |---|---|
//! | here | the driver's end: puts messages into the ring, and never waits for a viewer |
//! | `socket` | a viewer's end: what it subscribes to, as fast as it reads |
//!
//! The crate `foxglove` has a server of this protocol, too, but it lets every web page in: it looks at neither `Origin`
//! nor `Host`, and limits neither connections nor messages. Viewers only look: nothing that they send reaches a drive.

mod socket;

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use bytes::Bytes;
use tokio::sync::{broadcast, watch};

pub use socket::GREETINGS;
pub(crate) use socket::answer;

use crate::places::Places;
use lapwing_core::{
    drive::{self, Observer, ObserverError},
    recording::{Channel, EncodeError, EventRecord, Item, Messages, Roadway},
    turn::Turn,
};

/// Messages in the ring: about ten seconds of a simulator at 20 Hz. A viewer that is further behind skips the oldest.
const RING: usize = 1024;
/// Drives that have channels at a time; those beyond are not shown.
const DRIVES: usize = 16;

/// How long viewers have to take what is left once all ends.
const CLOSING: Duration = Duration::from_secs(1);

/// What viewers are told.
#[derive(Debug, Clone)]
enum News {
    Message(Arc<Published>),
    /// This drive has a picture, which is kept apart: a fork may send large ones, and only the newest is of use.
    Picture(usize),
    /// Nothing follows.
    End,
}

/// A message on its way to viewers.
#[derive(Debug)]
struct Published {
    id: ChannelId,
    time_ns: u64,
    data: Bytes,
}

/// A channel of one of the drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct ChannelId {
    drive: usize,
    channel: Channel,
}

impl ChannelId {
    /// As the protocol numbers it.
    fn number(self) -> usize {
        self.drive * Channel::ALL.len() + self.channel as usize
    }

    fn numbered(number: usize) -> Option<Self> {
        let drive = number / Channel::ALL.len();
        let channel = *Channel::ALL.get(number % Channel::ALL.len())?;
        (drive < DRIVES).then_some(Self { drive, channel })
    }

    /// The names of the first drive's channels are those in runs.
    fn topic(self) -> String {
        format!("{}{}", slash(&prefix(self.drive)), self.channel.topic())
    }
}

/// What the names of a drive's coordinate frames begin with.
fn prefix(drive: usize) -> String {
    if drive == 0 { String::new() } else { format!("{}/", drive + 1) }
}

/// The same for topics, which begin with a slash and have one behind that.
fn slash(prefix: &str) -> String {
    prefix.strip_suffix('/').map_or_else(String::new, |number| format!("/{number}"))
}

/// All viewers, and all drives that they may see.
#[derive(Debug)]
pub struct Viewers {
    news: broadcast::Sender<News>,
    /// How many drives have had channels at a time: so many are offered.
    offered: watch::Sender<usize>,
    drives: Mutex<[bool; DRIVES]>,
    /// The newest picture of each drive, and its scene, which is told once.
    kept: Mutex<HashMap<ChannelId, Arc<Published>>>,
    /// Viewers that look now.
    open: Places<{ socket::VIEWERS }>,
}

impl Viewers {
    /// Nobody yet, and nothing to see.
    pub fn new() -> Arc<Self> {
        Arc::new(Self {
            news: broadcast::Sender::new(RING),
            offered: watch::Sender::new(1),
            drives: Mutex::default(),
            kept: Mutex::default(),
            open: Places::default(),
        })
    }

    /// A drive begins, on one of these roads if it tells its track. None if too many are shown already.
    pub fn feed(self: &Arc<Self>, started: jiff::Timestamp, roads: Arc<[Roadway]>) -> Option<Feed> {
        let drive = {
            let mut drives = lock(&self.drives);
            let free = drives.iter().position(|taken| !taken)?;
            drives[free] = true;
            free
        };
        lock(&self.kept).retain(|id, _| id.drive != drive);
        self.offered.send_if_modified(|offered| {
            let more = drive >= *offered;
            *offered = (*offered).max(drive + 1);
            more
        });
        Some(Feed { viewers: self.clone(), drive, messages: Messages::new(started, roads, &prefix(drive)) })
    }

    fn publish(&self, message: Published) {
        let message = Arc::new(message);
        let id = message.id;
        if matches!(id.channel, Channel::Camera | Channel::Scene) {
            lock(&self.kept).insert(id, message.clone());
        }
        let news = if id.channel == Channel::Camera { News::Picture(id.drive) } else { News::Message(message) };
        // An error means that nobody looks.
        let _ = self.news.send(news);
    }

    /// Lets viewers have what is left, and go.
    pub(crate) async fn end(&self) {
        let _ = self.news.send(News::End);
        // Those who do not read are not waited for.
        let _ = tokio::time::timeout(CLOSING, self.open.all_free()).await;
    }

    /// The newest message of a channel of which that is kept.
    fn kept(&self, id: ChannelId) -> Option<Arc<Published>> {
        lock(&self.kept).get(&id).cloned()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One drive's end, held by whoever drives.
#[derive(Debug)]
pub struct Feed {
    viewers: Arc<Viewers>,
    drive: usize,
    messages: Messages,
}

impl Feed {
    fn item(&mut self, at: Duration, item: Item) {
        let Self { viewers, drive, messages } = self;
        let told = messages.of(at, &item.lean(), |message| {
            let id = ChannelId { drive: *drive, channel: message.channel };
            viewers.publish(Published { id, time_ns: message.time_ns, data: Bytes::copy_from_slice(message.data) });
            Ok::<_, EncodeError>(())
        });
        if let Err(error) = told {
            tracing::error!("viewers could not be told something: {error}");
        }
    }
}

/// Shows what a run holds.
impl<W: ?Sized> Observer<W> for Feed {
    fn turn(&mut self, _world: &W, turn: &Turn) -> Result<(), ObserverError> {
        drive::items(turn).for_each(|item| self.item(turn.at(), item));
        Ok(())
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        self.item(at, Item::Event(event.clone()));
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        lock(&self.viewers.drives)[self.drive] = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_of_the_first_drive_are_named_as_in_runs_and_each_has_a_number_of_its_own() {
        let topic = |drive, channel| ChannelId { drive, channel }.topic();
        assert_eq!((&*topic(0, Channel::Camera), &*topic(1, Channel::Camera)), ("/camera/center", "/2/camera/center"));
        assert_eq!(prefix(1), "2/");
        for number in 0..DRIVES * Channel::ALL.len() {
            assert_eq!(ChannelId::numbered(number).unwrap().number(), number);
        }
        assert_eq!(ChannelId::numbered(DRIVES * Channel::ALL.len()), None);
    }

    #[test]
    fn a_drive_that_ends_leaves_its_channels_to_the_next_one() {
        let viewers = Viewers::new();
        let feed = || viewers.feed(jiff::Timestamp::UNIX_EPOCH, Arc::default());
        let (first, second) = (feed().unwrap(), feed().unwrap());
        assert_eq!((first.drive, second.drive, *viewers.offered.borrow()), (0, 1, 2));
        drop(first);
        let mut all = vec![second];
        all.extend(std::iter::from_fn(feed));
        assert_eq!((all.len(), all[1].drive, *viewers.offered.borrow()), (DRIVES, 0, DRIVES));
    }
}
