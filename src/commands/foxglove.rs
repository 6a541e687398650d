//! `lapwing drive --foxglove`: a drive as it happens, for Foxglove and Lichtblick.

use std::sync::Arc;

use super::{serve, server::Server};
use lapwing_core::config::Settings;
use lapwing_live::{
    bridge::{self, Bridge},
    viewers::{Feed, Viewers},
};
use lapwing_sim::world::Setup;

/// The viewers' server beside a world in this process.
pub(super) struct FoxgloveServer {
    viewers: Arc<Viewers>,
    server: Server,
}

impl FoxgloveServer {
    pub(super) fn start(settings: &Settings, port: u16) -> anyhow::Result<Self> {
        let (bridge, viewers) = (Bridge::new(settings.clone(), |_| ()), Viewers::new());
        let server = Server::start(serve::FOXGLOVE, (settings.bridge.bind, port).into(), |listener, shutdown| {
            serve::tell_viewers(&listener, &bridge)?;
            Ok(bridge::serve_foxglove(listener, bridge, viewers.clone(), shutdown))
        })?;
        Ok(Self { viewers, server })
    }

    /// The feed of a run that begins in this world.
    pub(super) fn feed(&self, setup: &Setup) -> Option<Feed> {
        self.viewers.feed(jiff::Timestamp::now(), [setup.track.roadway()].into())
    }

    /// Ends it, once viewers have what is left.
    pub(super) fn end(self) -> anyhow::Result<()> {
        self.server.end()
    }
}
