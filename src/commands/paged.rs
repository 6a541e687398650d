//! `lapwing drive --page` and `lapwing record --page`: the headless simulator in real time, with a person at its page.

use std::{cell::RefCell, rc::Rc, sync::Arc, time::Instant};

use anyhow::Context;
use serde_json::Value;

use super::{Ended, Interrupted, drive, foxglove::FoxgloveServer, guards, serve, server::Server, thresholds, world};
use crate::{
    cli::{self, PilotKind},
    known::{self, Roads},
    staged::{self, Console, HandLog, Screen, Staged},
};
use lapwing_core::{
    config::{ConfigError, Layers, Settings},
    drive::Observer,
    driver::Driver,
    guard::GuardModel,
    pilot::PurePursuit,
    recording::udacity::DrivingLogWriter,
    units::Mph,
    words::count,
};
use lapwing_learn::models::LoadedModel;
use lapwing_live::{
    bridge::{self, Bridge},
    page::{Abilities, Explaining, Page, PilotChoice},
};
use lapwing_score::{
    judged::{self, Judged},
    results::{InProcess, ScoredDrive, Simulated},
    score::{self, Figure},
};
use lapwing_sim::{
    spec::WorldSpec,
    world::{Setup, Simulation},
};

/// What its tab is called.
const TITLE: &str = "headless simulator";

/// Those, then the flag that says where the page listens.
pub(super) fn layers(layers: Layers, page: &cli::PageFlags) -> Result<Layers, ConfigError> {
    match &page.bind {
        Some(bind) => layers.set("--bind", "bridge.bind", bind.as_str()),
        None => Ok(layers),
    }
}

pub(super) fn drive(
    arguments: &cli::Drive,
    settings: Settings,
    port: u16,
    interrupted: Interrupted,
) -> anyhow::Result<Ended> {
    let pictures = &arguments.pictures;
    for (flag, given) in [
        ("--world", !arguments.recorded.is_empty()),
        ("--video", pictures.video.is_some()),
        ("--map", pictures.map.is_some()),
    ] {
        if given {
            let why = format!("expected no {flag} beside it, got one: worlds come and go at the page");
            return Err(ConfigError::Value { layer: "--page".into(), why }.into());
        }
    }
    let stage = Stage {
        pilots: pilots(&settings, arguments.pilot, &arguments.page.also_model)?,
        spec: world::spec(&arguments.world, arguments.laps),
        ends: arguments.laps.is_some() || arguments.world.max_time.is_some(),
        has_speed: arguments.driving.speed.is_some(),
        stock: arguments.stock,
        json: arguments.json,
        foxglove: arguments.foxglove,
        settings,
    };
    let (ended, _) = stage.run(port, || Ok(None), interrupted)?;
    Ok(ended)
}

pub(super) fn record(
    arguments: &cli::Record,
    mut settings: Settings,
    port: u16,
    interrupted: Interrupted,
) -> anyhow::Result<Ended> {
    settings.control.speed_mph = Mph::saturating(arguments.speed);
    settings.recording.enabled = false;
    let stage = Stage {
        pilots: pilots(&settings, PilotKind::Expert, &arguments.page.also_model)?,
        spec: world::spec(&arguments.world, None),
        ends: arguments.world.max_time.is_some(),
        has_speed: true,
        stock: false,
        json: false,
        foxglove: None,
        settings,
    };
    let log = || Ok(Some(HandLog::new(DrivingLogWriter::create(&arguments.out, jiff::Zoned::now().datetime())?)));
    let (_, log) = stage.run(port, log, interrupted)?;
    let rows = log.map_or(Ok(0), HandLog::finish)?;
    super::print(&format!("{} driven by hand, in {}", count(rows, "row"), arguments.out.display()))?;
    Ok(if rows > 0 { Ended::Passed } else { Ended::Failed })
}

/// Who may drive: the one that was asked for first, then the other kind, then more models.
fn pilots(settings: &Settings, first: PilotKind, more: &[std::path::PathBuf]) -> anyhow::Result<Vec<PilotChoice>> {
    let expert = PilotChoice {
        name: drive::EXPERT.into(),
        sha256: None,
        make: Box::new(|| Box::new(PurePursuit::default())),
        explaining: Explaining::not("the expert drives by the road itself, not by the picture"),
    };
    let models = super::load_models(settings, more)?;
    models.iter().try_for_each(|model| super::suits_our_cameras(model))?;
    let choice = |model: Arc<LoadedModel>| {
        let how = super::explaining(&model);
        PilotChoice::of(model, how)
    };
    let mut all: Vec<_> = models.into_iter().map(choice).collect();
    all.insert(if first == PilotKind::Expert { 0 } else { all.len() }, expert);
    Ok(all)
}

/// All that does not change from world to world, and the first world.
struct Stage {
    settings: Settings,
    spec: WorldSpec,
    pilots: Vec<PilotChoice>,
    /// Whether the program ends when a run does.
    ends: bool,
    /// Whether the set speed was given; else a scenario's own holds.
    has_speed: bool,
    stock: bool,
    json: bool,
    foxglove: Option<u16>,
}

impl Stage {
    /// Drives one world after the other; returns how the last one ended, and the log.
    fn run(
        self,
        port: u16,
        log: impl FnOnce() -> anyhow::Result<Option<HandLog>>,
        interrupted: Interrupted,
    ) -> anyhow::Result<(Ended, Option<HandLog>)> {
        let Self { settings, mut spec, pilots, ends, has_speed, stock, json, foxglove } = self;
        let mut setup = set_up(&spec, &settings, stock)?;
        let guard = guards::load(&settings.brake)?;
        let shipped = known::courses(&Roads::default())?;
        let bridge = Bridge::new(settings.clone(), |_| ());
        let page = bridge.page().clone();
        let server = Server::start("--page", (settings.bridge.bind, port).into(), |listener, shutdown| {
            say!("Page: {}", serve::address_of("http", listener.address(), bridge.page())?);
            Ok(bridge::serve_page(listener, bridge, shutdown))
        })?;
        let foxglove = foxglove.map(|port| FoxgloveServer::start(&settings, port)).transpose()?;
        // Last, so that an earlier failure leaves no log.
        let log = log()?;
        page.has_pilots(pilots);
        let can = Abilities::of_the_simulator(log.is_some());
        let pressed = interrupted.clone();
        let console = Console::new(page.show(TITLE, can), log, move || pressed.is_pressed());
        console.borrow_mut().offers(staged::offered());
        let ended = loop {
            let mut settings = settings.clone();
            if !has_speed {
                drive::take_scenario_speed(&mut settings, &setup);
            }
            if let Some(control) = console.borrow().settings() {
                settings.control = control.clone();
            }
            // The roads of recorded runs, and the one of this world.
            let mut courses = shipped.clone();
            let track = &setup.track;
            if !courses.iter().any(|course| course.name == track.file().name) {
                let ways = known::known_road((**track).clone())?;
                courses.push(known::course(track, ways.map(Arc::new)));
            }
            page.has_courses(courses);
            let foxglove = foxglove.as_ref();
            let run = Run { settings: &settings, guard: guard.as_deref(), page: &page, json, foxglove };
            let (ended, asked) = run.drive(setup, &console, interrupted.clone())?;
            if interrupted.is_pressed() || (ends && !asked) {
                break ended;
            }
            let next = loop {
                let Some(choice) = console.borrow_mut().wait_for_next() else { break None };
                let next = staged::chosen(&spec, &choice);
                match set_up(&next, &settings, stock) {
                    Ok(setup) => break Some((next, setup)),
                    // A scenario may not fit a track: something else is asked for.
                    Err(error) => say!("this world cannot be: {}", super::told(&error)),
                }
            };
            let Some(next) = next else { break ended };
            (spec, setup) = next;
        };
        let log = console.borrow_mut().take_log();
        drop(console);
        foxglove.map_or(Ok(()), FoxgloveServer::end)?;
        server.end()?;
        Ok((ended, log))
    }
}

/// A world; without laps to drive it lasts until a person ends it, even while the car stands.
fn set_up(spec: &WorldSpec, settings: &Settings, stock: bool) -> anyhow::Result<Setup> {
    let setup = spec.setup(&settings.simulator)?;
    Ok(Setup { laps: spec.laps, idle_s: spec.laps.map(|_| world::STOPPED_S), stock, ..setup })
}

/// One run.
struct Run<'a> {
    settings: &'a Settings,
    guard: Option<&'a dyn GuardModel>,
    page: &'a Page,
    json: bool,
    foxglove: Option<&'a FoxgloveServer>,
}

impl Run<'_> {
    /// Drives it, and prints its score; returns how it ended, and whether a person asked for another world.
    fn drive(
        &self,
        setup: Setup,
        console: &Rc<RefCell<Console>>,
        mut interrupted: Interrupted,
    ) -> anyhow::Result<(Ended, bool)> {
        let Self { settings, guard, page, json, foxglove } = *self;
        let pilot = page.pilots().get(console.borrow().pilot()).context("no pilot")?;
        let dialect = drive::dialect(&setup);
        let who = (pilot.name.as_str(), pilot.id());
        let header = settings.recording.enabled.then(|| drive::header(settings, &setup, who, guard, Value::Null));
        let mut driver = Driver::new((pilot.make)(), &settings.control, Instant::now).guarded(guard.map(|g| g.guard()));
        let mut feed = foxglove.and_then(|server| server.feed(&setup));
        let simulation = Simulation::new(setup)?;
        console.borrow_mut().run_begins(dialect, &settings.control);
        let recorder = header.map(|header| drive::record(settings, simulation.setup(), header)).transpose()?;
        let mut staged = Staged::new(simulation, console.clone());
        let mut screen = Screen::new(console.clone(), recorder.as_ref());
        let began = Instant::now();
        let observers: &mut [&mut dyn Observer<_>] =
            &mut [&mut recorder.as_ref(), &mut screen, &mut feed, &mut interrupted];
        let judged = judged::run(&mut staged, &mut driver, observers);
        let wall = began.elapsed();
        // Whatever happened, the run is closed and can be read.
        let report = recorder.and_then(super::close);
        if let Some(report) = &report {
            console.borrow_mut().has_lost(report.lost());
        }
        let Judged { card, driven } = judged?;
        let missed = score::missed(&settings.thresholds, &card);
        let setup = staged.simulation().setup();
        let seed = setup.seed;
        let text = if json {
            let run = report.as_ref().map(|report| report.path.display().to_string());
            let times_real_time = card.value(Figure::TimeS).unwrap_or(0.0) / wall.as_secs_f64().max(1e-9);
            let how =
                InProcess { frames: driven.frames, fingerprint: &driven.fingerprint, times_real_time, seen: None, run };
            serde_json::to_string(&ScoredDrive {
                who: Simulated { pilot: &pilot.name, seed },
                card: &card,
                how,
                missed: &missed,
            })?
        } else {
            let run = report.as_ref().map(|report| format!("\n  {:<17} {}", "run", drive::told(report)));
            format!("{} on {}, seed {seed}\n{card}{}", pilot.name, setup.track.file().name, run.unwrap_or_default())
        };
        super::print(&text)?;
        super::whole(report)?;
        let asked = console.borrow().is_asked_on();
        let ended = thresholds::ended_whole(&card, &settings.thresholds, &missed);
        Ok((drive::ended_seeing(ended, &driven), asked))
    }
}
