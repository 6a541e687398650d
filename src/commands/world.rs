//! Shared by the verbs that simulate a world: making it, filming it, drawing its map.

use std::{
    io::{self, IsTerminal},
    path::PathBuf,
    time::Instant,
};

use indicatif::{ProgressBar, ProgressStyle};

use super::outputs;
use crate::{
    cli::{self, FilmView},
    film::{Film, FilmError, Moment},
    map::{self, DrivenPoint, Mark, MarkKind},
};
use lapwing_core::{
    config::{ConfigError, Layers},
    drive::{Observer, ObserverError},
    perception::{Frame, decode_jpeg},
    protocol::CameraImage,
    turn::{By, Turn},
    units::MPS_PER_MPH,
};
use lapwing_sim::{
    camera::{Camera, Renderer},
    spec::WorldSpec,
    world::{Setup, Simulation},
};

/// A film is shown at this size.
const FILM: (usize, usize) = (640, 360);
/// How wide a map is, in pixels.
const MAP: u32 = 1200;

/// How long a car may stand before it counts as stuck, where somebody may have stopped it, in seconds.
pub(super) const STOPPED_S: f64 = 600.0;

/// The flags of a world as settings.
pub(super) fn layers(mut layers: Layers, world: &cli::WorldFlags) -> Result<Layers, ConfigError> {
    if let Some(track) = &world.track {
        layers = layers.set("--track", "simulator.track", track.as_str())?;
    }
    if let Some(hz) = world.hz {
        layers = layers.set("--hz", "simulator.hz", hz)?;
    }
    if let Some(on_crash) = world.on_crash {
        layers = layers.set("--on-crash", "simulator.on_crash", on_crash)?;
    }
    Ok(layers)
}

/// The world that the flags name.
pub(super) fn spec(world: &cli::WorldFlags, laps: Option<u32>) -> WorldSpec {
    let cli::WorldFlags { track, seed, conditions, scenario, max_time, .. } = world.clone();
    WorldSpec { track, seed, conditions, scenario, laps, longest_s: max_time }
}

/// Pictures to look at afterwards.
pub(super) struct Pictures {
    /// The pilot's kind, as the film names it.
    pilot: &'static str,
    film: Option<(Film, Renderer, Camera, Frame)>,
    /// Whether the film shows what was sent to the pilot, where that is a picture.
    as_sent: bool,
    map: Option<PathBuf>,
    line: Vec<DrivenPoint>,
    marks: Vec<Mark>,
    /// Numbers of crashes and times off the road that are marked.
    marked: (u32, u32),
}

impl Pictures {
    /// `pilot` is what a film calls it: the network, the expert, the bridge.
    pub(super) fn new(arguments: &cli::PictureFlags, setup: &Setup, pilot: &'static str) -> anyhow::Result<Self> {
        outputs::check_apart([&arguments.video, &arguments.map].into_iter().flatten())?;
        arguments.map.as_deref().map_or(Ok(()), outputs::check_drawing)?;
        let film = match &arguments.video {
            None => None,
            Some(path) => {
                let camera = match arguments.view {
                    FilmView::Follow => Camera::follow(FILM.0, FILM.1),
                    FilmView::Top => Camera::top(FILM.0, FILM.1),
                    FilmView::Car => Camera::CENTER,
                };
                let film = Film::create(path, camera.lens.width, camera.lens.height, setup.hz)?;
                Some((film, Renderer::new(setup.scenery.clone()), camera, Frame::default()))
            }
        };
        Ok(Self {
            pilot,
            film,
            as_sent: arguments.view == FilmView::Car,
            map: arguments.map.clone(),
            line: vec![],
            marks: vec![],
            marked: (0, 0),
        })
    }

    /// Takes the world as it is now, the picture that the pilot was sent, and who steers.
    pub(super) fn take(&mut self, world: &Simulation, sent: Option<&CameraImage>, by: By) -> Result<(), FilmError> {
        if let Some((film, renderer, camera, frame)) = &mut self.film {
            let shows = match sent {
                Some(CameraImage::Jpeg(jpeg)) if self.as_sent => {
                    let size = (camera.lens.width, camera.lens.height);
                    decode_jpeg(jpeg, frame).is_ok() && (frame.width(), frame.height()) == size
                }
                _ => false,
            };
            if !shows {
                world.draw(renderer, camera, frame);
            }
            let (car, setup) = (world.car(), world.setup());
            let by = match by {
                By::Pilot => self.pilot,
                By::Human => "human",
                By::Safe | By::Off => "nobody",
            };
            let moment = Moment {
                mph: car.speed.abs() / MPS_PER_MPH,
                lap: world.laps() + 1,
                laps: setup.laps,
                cte_m: world.place().offset - setup.track.file().driving_line_m,
                by,
                steering_deg: car.steering.to_degrees(),
            };
            moment.draw(frame);
            film.frame(frame)?;
        }
        if self.map.is_some() {
            let (car, judge) = (world.car(), world.judge());
            let now = (judge.crashes(), judge.off_roads());
            for (kind, new) in [(MarkKind::Crash, now.0 > self.marked.0), (MarkKind::OffRoad, now.1 > self.marked.1)] {
                self.marks.extend(new.then_some(Mark { position: car.position, kind }));
            }
            self.marked = now;
            self.line.push(DrivenPoint { position: car.position, speed_mph: car.speed.abs() / MPS_PER_MPH });
        }
        Ok(())
    }

    /// Ends the film and draws the map; returns where they are, and what could not be made.
    pub(super) fn finish(mut self, world: &Simulation) -> (Vec<(&'static str, String)>, anyhow::Result<()>) {
        let mut made = vec![];
        let mut result = Ok(());
        if let Some((film, ..)) = self.film.take() {
            match film.finish() {
                Ok(place) => made.push(("film", place)),
                Err(error) => result = Err(error.into()),
            }
        }
        if let Some(path) = self.map {
            match map::draw(&world.setup().track, &self.line, &self.marks, &path, MAP) {
                Ok(()) => made.push(("map", path.display().to_string())),
                Err(error) => result = result.and(Err(error.into())),
            }
        }
        (made, result)
    }
}

impl Observer<Simulation> for Pictures {
    fn turn(&mut self, world: &Simulation, turn: &Turn) -> Result<(), ObserverError> {
        Ok(self.take(world, turn.telemetry().map(|telemetry| &telemetry.image), turn.trace.by)?)
    }
}

/// A live line of progress, if stderr is a terminal.
pub(super) struct ProgressLine {
    bar: ProgressBar,
    began: Instant,
}

impl ProgressLine {
    pub(super) fn new() -> Self {
        let bar = if io::stderr().is_terminal() { ProgressBar::new(1000) } else { ProgressBar::hidden() };
        let template = "{wide_bar} {percent}% {msg}, {elapsed}";
        bar.set_style(ProgressStyle::with_template(template).expect("the template is written here"));
        Self { bar, began: Instant::now() }
    }

    pub(super) fn show(&self, world: &Simulation) {
        self.bar.set_position((world.progress() * 1000.0) as u64);
        if !self.bar.is_hidden() {
            let times = world.time_s() / self.began.elapsed().as_secs_f64().max(1e-9);
            let (lap, mph) = (world.laps() + 1, world.car().speed.abs() / MPS_PER_MPH);
            self.bar.set_message(format!("lap {lap}, {mph:.1} mph, {times:.0}x real time"));
        }
    }

    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }
}

impl Observer<Simulation> for ProgressLine {
    fn turn(&mut self, world: &Simulation, _: &Turn) -> Result<(), ObserverError> {
        self.show(world);
        Ok(())
    }

    fn end(&mut self) {
        self.clear();
    }
}
