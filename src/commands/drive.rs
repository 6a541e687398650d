//! `lapwing drive`: a world, a driver, a run and its scorecard in one process.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use serde_json::{Value, json};

#[cfg(feature = "bridge")]
use super::foxglove::FoxgloveServer;
use super::{Ended, guards, recorded_world::Recorded, thresholds, world};
use crate::cli::{self, PilotKind};
#[cfg(feature = "bridge")]
use crate::real_time::RealTime;
use lapwing_core::{
    config::{ConfigError, Settings},
    drive::{DriveDigest, Observer},
    driver::Driver,
    guard::GuardModel,
    pilot::{Pilot, PurePursuit},
    protocol::Dialect,
    recording::{ModelId, Recorder, RecordingError, RecordingReport, RunHeader, RunKind},
    units::Mph,
    words::count,
};
use lapwing_score::judged::{self, Judged};
use lapwing_score::results::{InProcess, ScoredDrive, Seen, Simulated};
use lapwing_score::score::{self, Figure, against::RECORDED};
use lapwing_sim::world::{Setup, Simulation};

/// The expert's name in a run.
pub(super) const EXPERT: &str = "expert (pure pursuit on the known line)";

pub(super) fn run(arguments: cli::Drive, config: Option<&Path>) -> anyhow::Result<Ended> {
    let mut interrupted = super::interrupted();
    let settings = settings(&arguments, config)?;
    #[cfg(feature = "bridge")]
    if let Some(port) = arguments.page.page {
        return super::paged::drive(&arguments, settings, port, interrupted);
    }
    #[cfg(feature = "networks")]
    if arguments.pilot == PilotKind::Expert && arguments.driving.model.is_some() {
        let why = "expected --pilot model, got --pilot expert, which uses no network".into();
        return Err(ConfigError::Value { layer: "--model".into(), why }.into());
    }
    let mut settings = settings;
    let mut setup = world::spec(&arguments.world, arguments.laps).setup(&settings.simulator)?;
    setup.stock = arguments.stock;
    let mut recorded = match &arguments.recorded[..] {
        [] => None,
        recordings => Some(Recorded::open(recordings, &arguments.lane, arguments.world.track.as_deref(), &mut setup)?),
    };
    if arguments.driving.speed.is_none() {
        take_scenario_speed(&mut settings, &setup);
    }
    let (pilot, name, model): (Box<dyn Pilot>, _, _) = match arguments.pilot {
        PilotKind::Expert => (Box::new(PurePursuit::default()), EXPERT.to_owned(), None),
        #[cfg(feature = "networks")]
        PilotKind::Model => {
            let model = super::load_model(&settings)?;
            super::suits_our_cameras(&model)?;
            let id = ModelId::of(&model);
            (model.pilot(), model.name().to_owned(), Some(id))
        }
    };
    let guard = guards::load(&settings.brake)?;
    let sources = recorded.as_ref().map(Recorded::sources);
    let header =
        settings.recording.enabled.then(|| header(&settings, &setup, (&name, model), guard.as_deref(), json!(sources)));
    let kind = match arguments.pilot {
        PilotKind::Expert => "expert",
        #[cfg(feature = "networks")]
        PilotKind::Model => "network",
    };
    let mut pictures = world::Pictures::new(&arguments.pictures, &setup, kind)?;
    let mut driver = Driver::new(pilot, &settings.control, Instant::now).guarded(guard.map(|guard| guard.guard()));
    let mut simulation = Simulation::new(setup)?;
    if let Some(recorded) = &mut recorded {
        simulation = recorded.show(simulation);
    }
    #[cfg(feature = "bridge")]
    let viewers = arguments.foxglove.map(|port| FoxgloveServer::start(&settings, port)).transpose()?;
    #[cfg(feature = "bridge")]
    let mut feed = viewers.as_ref().and_then(|viewers| viewers.feed(simulation.setup()));
    // Last, so that an earlier failure leaves no run.
    let recorder = header.map(|header| record(&settings, simulation.setup(), header)).transpose()?;
    let mut bar = world::ProgressLine::new();
    let began = Instant::now();
    let mut recorded_by = recorder.as_ref();
    let mut observers: Vec<&mut dyn Observer<_>> = vec![&mut recorded_by, &mut bar, &mut interrupted, &mut pictures];
    #[cfg(feature = "bridge")]
    let mut real_time = arguments.foxglove.map(|_| RealTime::default());
    #[cfg(feature = "bridge")]
    observers.extend([&mut real_time as &mut dyn Observer<_>, &mut feed]);
    let judged = judged::run(&mut simulation, &mut driver, &mut observers);
    let wall = began.elapsed();
    // Whatever happened, the run is closed and can be read.
    let report = recorder.and_then(super::close);
    let Judged { card, driven } = judged?;
    let DriveDigest { fingerprint, frames, .. } = &driven;
    let (made, drawn) = pictures.finish(&simulation);
    #[cfg(feature = "bridge")]
    let served = viewers.map_or(Ok(()), FoxgloveServer::end);
    let seen = recorded.as_ref().map(Recorded::seen);
    let unseen = recorded.as_ref().and_then(Recorded::unseen);
    let missed = score::missed(&settings.thresholds, &card);
    let seed = simulation.setup().seed;
    let times_real_time = card.value(Figure::TimeS).unwrap_or(0.0) / wall.as_secs_f64().max(1e-9);
    let result = if arguments.json {
        let run = report.as_ref().map(|report| report.path.display().to_string());
        let (who, fingerprint) = (Simulated { pilot: &name, seed }, fingerprint.as_str());
        let how = InProcess { frames: *frames, fingerprint, times_real_time, seen, run };
        serde_json::to_string_pretty(&ScoredDrive { who, card: &card, how, missed: &missed })?
    } else {
        let pictures = if seen.is_some() { format!(", {RECORDED}") } else { String::new() };
        let title = format!("{name} on {}{pictures}, seed {seed}", simulation.setup().track.file().name);
        let mut text = format!("{title}\n{card}\n  {:<17} {frames} in {}", "frames", paced(wall, times_real_time));
        if let Some(seen) = &seen {
            text += &format!("\n  {:<17} {}", "recorded", shown(seen));
        }
        text += &format!("\n  {:<17} {}", "fingerprint", &fingerprint[..16]);
        if let Some(report) = &report {
            text += &format!("\n  {:<17} {}", "run", told(report));
        }
        for (what, place) in made {
            text += &format!("\n  {what:<17} {place}");
        }
        text
    };
    let printed = super::print(&result);
    let ended = thresholds::ended_whole(&card, &settings.thresholds, &missed);
    super::whole(report)?;
    #[cfg(feature = "bridge")]
    served?;
    drawn?;
    printed?;
    let ended = ended_seeing(ended, &driven);
    unseen.map_or(Ok(ended), |why| Err(anyhow::Error::msg(why)))
}

/// Drives as fast as the scenario asks for, if it does.
pub(super) fn take_scenario_speed(settings: &mut Settings, setup: &Setup) {
    if let Some(scenario) = &setup.scenario {
        settings.control.speed_mph = Mph::saturating(scenario.ego.target_mph());
    }
}

/// What a telemetry of this world is like.
pub(super) fn dialect(setup: &Setup) -> Dialect {
    if setup.stock { Dialect::Term1 } else { Dialect::SelfOracle }
}

/// What a run of the headless simulator says of itself: its settings, its world, and who drives and watches.
pub(super) fn header(
    settings: &Settings,
    setup: &Setup,
    (pilot, model): (&str, Option<ModelId>),
    guard: Option<&dyn GuardModel>,
    recordings: Value,
) -> RunHeader {
    let world = json!({
        "track": setup.track.file().name, "laps": setup.laps, "hz": setup.hz,
        "conditions": setup.conditions, "scenario": setup.scenario, "pilot": pilot,
        "recordings": recordings,
    });
    let config = match guards::told(guard) {
        Some(guard) => json!({ "settings": settings, "world": world, "guard": guard }),
        None => json!({ "settings": settings, "world": world }),
    };
    RunHeader {
        name_hint: Some(setup.track.file().name.clone()),
        dialect: Some(dialect(setup)),
        model,
        seed: Some(setup.seed),
        ..RunHeader::new(RunKind::Driven, config, jiff::Timestamp::now())
    }
}

/// Begins the run of a drive in this world.
pub(super) fn record(settings: &Settings, setup: &Setup, header: RunHeader) -> Result<Recorder, RecordingError> {
    Recorder::create(&settings.recording.dir, header, setup.recorder(settings.recording.queue))
}

/// The settings of a drive in this process.
pub(super) fn settings(arguments: &cli::Drive, config: Option<&Path>) -> anyhow::Result<Settings> {
    let layers = world::layers(super::layers(config, &arguments.driving)?, &arguments.world)?;
    let layers = guards::layers(layers, &arguments.guard)?;
    let mut layers = thresholds::layers(layers, &arguments.thresholds)?;
    #[cfg(feature = "bridge")]
    {
        layers = super::paged::layers(layers, &arguments.page)?;
    }
    if let Some(dir) = &arguments.recordings {
        layers = super::recorded_in(layers, dir)?;
    }
    if arguments.no_recording {
        layers = layers.set("--no-recording", "recording.enabled", false)?;
    }
    let mut settings = layers.resolve()?;
    // libtorch rounds differently with another number of threads, and the same seed must give the same bytes
    // everywhere.
    settings.model.threads = 1;
    Ok(settings)
}

/// How a drive ends that would end so if no frame had been bad. Says how many were, and why the first was one.
pub(super) fn ended_seeing(ended: Ended, driven: &DriveDigest) -> Ended {
    match driven.bad_in_words() {
        None => ended,
        Some(Ok(some)) => {
            say!("{some}");
            ended
        }
        Some(Err(too_many)) => {
            say!("{too_many}");
            if matches!(ended, Ended::Passed) { Ended::Failed } else { ended }
        }
    }
}

fn paced(wall: Duration, times: f64) -> String {
    format!("{:.1} s, {times:.0} times real time", wall.as_secs_f64())
}

/// What recordings showed.
fn shown(seen: &Seen) -> String {
    let Seen { recorded, drawn, apart_m, covered, filled_mean, filled_most, .. } = *seen;
    let covered = 100.0 * covered;
    let how = match (apart_m, filled_mean, filled_most) {
        (Some(apart_m), Some(mean), Some(most)) => {
            let [mean, most] = [mean, most].map(|share| 100.0 * share);
            format!(", taken {apart_m:.2} m away, {mean:.1} % filled in ({most:.1} % at most)")
        }
        _ => String::new(),
    };
    let drawn =
        if drawn > 0 { format!("; {drawn} drawn where no recorded picture could be used") } else { String::new() };
    format!("{}{how}{drawn}; {covered:.1} % of the road shown", count(recorded as usize, "picture"))
}

pub(super) fn told(report: &RecordingReport) -> String {
    let lost = report.lost();
    let lost = if lost > 0 { format!(", {} could not be recorded", count(lost, "item")) } else { String::new() };
    format!("{} ({}{lost})", report.path.display(), count(report.frames, "frame"))
}
