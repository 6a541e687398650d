//! `lapwing serve`: wait for simulators, drive them, record the runs.

use std::{
    io::{self, BufRead, IsTerminal},
    net::SocketAddr,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::Context;

use super::{
    Ended, guards, model,
    outputs::{self, Unprinted},
    terminal::Asked,
};
use crate::{cli, doctor};
use lapwing_core::{
    config::{ConfigError, Layers, Settings, Thresholds},
    pilot::Model,
};
use lapwing_learn::models::LoadedModel;
use lapwing_live::{
    bridge::{self, Bridge, Listener, Summary},
    page::Page,
    viewers::Viewers,
};

/// The flag for Foxglove and Lichtblick.
pub(super) const FOXGLOVE: &str = "--foxglove";

/// What else is to be known where others can reach the port.
const NO_TOKEN: &str = "Warning: the simulator cannot send a token, so anyone who reaches this port can connect as a simulator, be \
     driven and fill the folder of runs.";

pub(super) fn run(arguments: cli::Serve, config: Option<&Path>) -> anyhow::Result<Ended> {
    let mut layers = super::thinking_layers(config, &arguments.driving, &arguments.thinking)?;
    layers = self::layers(guards::layers(layers, &arguments.guard)?, &arguments.server)?;
    if !arguments.greet.is_empty() {
        layers = layers.set("--greet", "bridge.greet", arguments.greet.clone())?;
    }
    if arguments.no_recording {
        layers = layers.set("--no-recording", "recording.enabled", false)?;
    }
    let settings = layers.resolve()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().context("no runtime")?;
    let result = runtime.block_on(serve(settings, arguments));
    // Do not wait for a model that is still loading.
    runtime.shutdown_background();
    result
}

async fn serve(settings: Settings, arguments: cli::Serve) -> anyhow::Result<Ended> {
    let cli::Serve { also_model: also, foxglove, json, .. } = arguments;
    if settings.recording.enabled {
        let help = "name another folder with --recordings, or use --no-recording";
        outputs::check_folder(&settings.recording.dir).map_err(|error| anyhow::anyhow!("{error:#}; {help}"))?;
        if let Some(scarce) = doctor::scarce(&settings.recording.dir) {
            tracing::warn!("{scarce}");
        }
    }
    if settings.thresholds != Thresholds::default() {
        tracing::warn!("[thresholds] are not applied by serve: lapwing score applies them to its runs");
    }
    model::are_there(&settings, &also)?;
    let listener = Listener::bind(SocketAddr::new(settings.bridge.bind, settings.bridge.port)).await?;
    let asked = Asked::listen().context("cannot listen for Ctrl-C")?;
    let lost = Arc::new(AtomicBool::new(false));
    let bridge = Bridge::new(settings.clone(), {
        let (lost, wants_runs) = (lost.clone(), settings.recording.enabled);
        move |summary| {
            // The simulators are driven on; a lost result or run is reported at once, and by the exit status.
            let printed = print(summary, json);
            if let Err(error) = &printed {
                say!("error: {error}");
            }
            if printed.is_err() || wants_runs && !summary.is_recorded_whole() {
                lost.store(true, Ordering::Relaxed);
            }
        }
    });
    let page = address_of("http", listener.address(), bridge.page())?;
    say!("{}\n  Page: {page}", how_to_connect(listener.address()));
    if !listener.address().ip().is_loopback() {
        say!("  {NO_TOKEN}");
    }
    let (drives_are_over, over) = tokio::sync::oneshot::channel();
    let viewing = match foxglove {
        None => None,
        Some(port) => {
            let listener = Listener::bind(SocketAddr::new(settings.bridge.bind, port)).await;
            let listener = listener.map_err(|error| error.with_flag(FOXGLOVE))?;
            tell_viewers(&listener, &bridge)?;
            let viewers = Viewers::new();
            bridge.has_viewers(viewers.clone());
            let over = async move { over.await.unwrap_or_default() };
            Some(tokio::spawn(bridge::serve_foxglove(listener, bridge.clone(), viewers, over)))
        }
    };
    arm_on_enter(bridge.clone());
    let loading = tokio::task::spawn_blocking({
        let bridge = bridge.clone();
        move || {
            #[cfg(feature = "simulator")]
            {
                let roads = crate::known::Roads::default();
                bridge.page().has_courses(crate::known::courses(&roads)?);
                bridge.roadways_are_known(crate::known::roadways(&roads)?);
                bridge.roads_are_known(roads.known()?);
            }
            // Before the model, with which drives begin.
            if let Some(guard) = guards::load(&settings.brake)? {
                bridge.guard_is_ready(guard);
            }
            let models = super::load_models(&settings, &also)?;
            let explained = |model: Arc<LoadedModel>| {
                let how = super::explaining(&model);
                (model as Arc<dyn Model>, how)
            };
            bridge.models_are_ready(models.into_iter().map(explained).collect());
            Ok(())
        }
    });
    let (failed, failure) = tokio::sync::oneshot::channel();
    tokio::spawn(async move {
        let loaded = loading.await.context("loading the model was interrupted").and_then(|r| r);
        match loaded {
            Ok(()) => std::future::pending().await, // keeps `failed` from being dropped
            Err(error) => failed.send(error),
        }
    });
    let (ended, end) = tokio::sync::oneshot::channel();
    let shutdown = async move {
        let why = tokio::select! {
            () = end_asked_for(asked) => Ok(()),
            error = failure => Err(error.unwrap_or_else(|_| anyhow::anyhow!("the runtime is gone"))),
        };
        // The receiver waits below for as long as the bridge serves.
        let _ = ended.send(why);
    };
    bridge::serve(listener, bridge, shutdown).await.context("the server failed")?;
    if let Some(viewing) = viewing {
        // The receiver waits in the task below.
        let _ = drives_are_over.send(());
        viewing
            .await
            .context("the server for --foxglove was interrupted")?
            .context("the server for --foxglove failed")?;
    }
    if let Ok(why) = end.await {
        why?;
    }
    Ok(if lost.load(Ordering::Relaxed) { Ended::Failed } else { Ended::Passed })
}

/// Those, then the flags that say where the bridge listens and where its runs go.
pub(super) fn layers(mut layers: Layers, server: &cli::ServerFlags) -> Result<Layers, ConfigError> {
    let cli::ServerFlags { bind, port, recordings } = server;
    if let Some(bind) = bind {
        layers = layers.set("--bind", "bridge.bind", bind.as_str())?;
    }
    if let Some(port) = port {
        layers = layers.set("--port", "bridge.port", i64::from(*port))?;
    }
    if let Some(dir) = recordings {
        layers = super::recorded_in(layers, dir)?;
    }
    Ok(layers)
}

/// Waits until the program is asked to end. A second Ctrl-C ends it at once.
async fn end_asked_for(mut asked: Asked) {
    asked.first().await;
    say!("stopping: closing runs (press Ctrl-C again to exit at once)");
    tokio::spawn(async move { asked.again().await });
}

fn print(summary: &Summary, json: bool) -> Result<(), Unprinted> {
    if json {
        super::print(&serde_json::to_string(summary).expect("a summary is plain data"))
    } else {
        super::print(&summary.to_string())
    }
}

/// Enter in the terminal arms pilots that a takeover has switched off.
fn arm_on_enter(bridge: Arc<Bridge>) {
    if io::stdin().is_terminal() {
        std::thread::spawn(move || {
            for line in io::stdin().lock().lines() {
                if line.is_err() {
                    return;
                }
                bridge.arm();
            }
        });
    }
}

/// Tells the user which address to open in Foxglove or Lichtblick.
pub(super) fn tell_viewers(listener: &Listener, bridge: &Bridge) -> anyhow::Result<()> {
    say!("Foxglove, Lichtblick: {}", address_of("ws", listener.address(), bridge.page())?);
    Ok(())
}

/// Where the page is, or what else has its token where others can reach it.
pub(super) fn address_of(scheme: &str, address: SocketAddr, page: &Page) -> anyhow::Result<String> {
    let (ip, port) = (address.ip(), address.port());
    if ip.is_loopback() {
        return Ok(format!("{scheme}://{address}/"));
    }
    let host = if ip.is_unspecified() { format!("ADDRESS-OF-THIS-MACHINE:{port}") } else { address.to_string() };
    Ok(format!("{scheme}://{host}/?token={}", page.want_token()?.text()))
}

fn how_to_connect(address: SocketAddr) -> String {
    let port = address.port();
    let local = bridge::reached_here(address);
    let warning = if port == 4567 { "" } else { "\n  Note: the simulator connects only to port 4567." };
    let reachable = if address.ip().is_loopback() { " with lapwing serve --bind 0.0.0.0 here," } else { "" };
    format!(
        "Waiting for a simulator on {address}. Press Ctrl-C to stop.{warning}
  Simulator on this machine: start it and choose Autonomous Mode; it connects by itself.
  On another machine or in a VM it still connects to its own 127.0.0.1:4567, so bring that port here. Over there, run
    ssh -N -L 4567:{local} USER@THIS-MACHINE
  or, on Windows as administrator,{reachable}
    netsh interface portproxy add v4tov4 listenaddress=127.0.0.1 listenport=4567 connectaddress=THIS-MACHINE connectport={port}
  On Windows with Lapwing in WSL 2: Windows passes 127.0.0.1 on to WSL; if nothing arrives, use the netsh line with the
  address that `hostname -I` prints in WSL."
    )
}
