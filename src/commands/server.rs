//! Servers beside a world in this process: its page, and the port for Foxglove and Lichtblick.

use std::{io, net::SocketAddr, pin::Pin};

use anyhow::Context;
use tokio::{runtime::Runtime, sync::oneshot, task::JoinHandle};

use lapwing_live::bridge::Listener;

/// Threads that serve. A drive needs the others.
const THREADS: usize = 2;

/// Ready once a server should end.
pub(super) type Shutdown = Pin<Box<dyn Future<Output = ()> + Send>>;

/// A server on threads of its own.
pub(super) struct Server {
    /// The flag that asked for it.
    flag: &'static str,
    /// None once it has ended.
    serving: Option<Serving>,
}

struct Serving {
    runtime: Runtime,
    stop: oneshot::Sender<()>,
    task: JoinHandle<io::Result<()>>,
}

impl Server {
    /// Listens at the port that came with `flag`, and serves as the future of `serve` does.
    pub(super) fn start<F>(
        flag: &'static str,
        address: SocketAddr,
        serve: impl FnOnce(Listener, Shutdown) -> anyhow::Result<F>,
    ) -> anyhow::Result<Self>
    where
        F: Future<Output = io::Result<()>> + Send + 'static,
    {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(THREADS).enable_all().build();
        let runtime = runtime.context("no runtime")?;
        let listener = runtime.block_on(Listener::bind(address)).map_err(|error| error.with_flag(flag))?;
        let (stop, stopped) = oneshot::channel();
        let task = runtime.spawn(serve(listener, Box::pin(async { stopped.await.unwrap_or_default() }))?);
        Ok(Self { flag, serving: Some(Serving { runtime, stop, task }) })
    }

    /// Ends it, once it has done what it has begun.
    pub(super) fn end(mut self) -> anyhow::Result<()> {
        self.stop()
    }

    fn stop(&mut self) -> anyhow::Result<()> {
        let Some(Serving { runtime, stop, task }) = self.serving.take() else { return Ok(()) };
        // An error means that it has ended already, of which the task tells.
        let _ = stop.send(());
        let served = runtime.block_on(task).with_context(|| format!("the server for {} was interrupted", self.flag))?;
        runtime.shutdown_background();
        served.with_context(|| format!("the server for {} failed", self.flag))
    }
}

/// Also where a drive fails: the page may be at work, and the program must not end before that is done.
impl Drop for Server {
    fn drop(&mut self) {
        if let Err(error) = self.stop() {
            tracing::warn!("{error:#}");
        }
    }
}
