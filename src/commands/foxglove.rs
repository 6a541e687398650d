//! `--foxglove`: drives as they happen, for Foxglove and Lichtblick.

use std::{
    io,
    sync::Arc,
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow};
use tokio::{runtime::Runtime, sync::oneshot, task::JoinHandle};

use super::serve;
use lapwing_core::{
    config::Settings,
    drive::{Observer, ObserverError},
    recording::Roadway,
    turn::{EventRecord, Turn},
};
use lapwing_live::{
    bridge::{self, BindError, Bridge, Listener},
    viewers::{Feed, Viewers},
};

/// A world that is later than this does not hurry to catch up.
const LATE: Duration = Duration::from_millis(250);

/// Listens at this port.
pub(super) async fn listen(settings: &Settings, port: u16, bridge: &Bridge) -> anyhow::Result<Listener> {
    let listener = Listener::bind((settings.bridge.bind, port).into()).await.map_err(|error| match error {
        // Its own advice is about the port for simulators.
        BindError::Taken { port, holder } => {
            let holder = holder.map(|holder| format!(" by {holder}")).unwrap_or_default();
            anyhow!("port {port} is taken{holder}: end that program, or name another port after --foxglove")
        }
        other => other.into(),
    })?;
    say!("Foxglove, Lichtblick: {}", serve::address_of("ws", listener.address(), bridge.page())?);
    Ok(listener)
}

/// The viewers' server beside a world in this process, on threads of its own.
pub(super) struct FoxgloveServer {
    runtime: Runtime,
    viewers: Arc<Viewers>,
    stop: oneshot::Sender<()>,
    task: JoinHandle<io::Result<()>>,
}

impl FoxgloveServer {
    pub(super) fn start(settings: &Settings, port: u16) -> anyhow::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.context("no runtime")?;
        let (bridge, viewers) = (Bridge::new(settings.clone(), |_| ()), Viewers::new());
        let listener = runtime.block_on(listen(settings, port, &bridge))?;
        let (stop, stopped) = oneshot::channel();
        let shutdown = async move { stopped.await.unwrap_or_default() };
        let task = runtime.spawn(bridge::serve_foxglove(listener, bridge, viewers.clone(), shutdown));
        Ok(Self { runtime, viewers, stop, task })
    }

    /// The feed of a run that begins, on this road.
    pub(super) fn feed(&self, started: jiff::Timestamp, road: &Roadway) -> Option<Feed> {
        self.viewers.feed(started, [road.clone()].into())
    }

    /// Ends it, once viewers have what is left.
    pub(super) fn end(self) -> anyhow::Result<()> {
        let Self { runtime, stop, task, .. } = self;
        // An error means that it has ended already, of which the task tells.
        let _ = stop.send(());
        let served = runtime.block_on(task).context("the server for --foxglove was interrupted")?;
        runtime.shutdown_background();
        served.context("the server for --foxglove failed")
    }
}

/// Lets a drive go no faster than time, and shows it.
pub(super) struct InRealTime {
    feed: Feed,
    began: Option<Instant>,
}

impl InRealTime {
    pub(super) fn new(feed: Feed) -> Self {
        Self { feed, began: None }
    }
}

impl<W: ?Sized> Observer<W> for InRealTime {
    fn ready(&mut self, at: Duration) {
        let now = Instant::now();
        let due = *self.began.get_or_insert(now) + at;
        if now > due + LATE {
            self.began = Some(self.began.unwrap_or(now) + (now - due));
        } else {
            sleep(due.saturating_duration_since(now));
        }
    }

    fn turn(&mut self, world: &W, turn: &Turn) -> Result<(), ObserverError> {
        self.feed.turn(world, turn)
    }

    fn event(&mut self, at: Duration, event: &EventRecord) {
        Observer::<W>::event(&mut self.feed, at, event);
    }
}
