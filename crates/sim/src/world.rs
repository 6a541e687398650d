//! Road, car, traffic, judge and camera under one clock.
//!
//! A [`Simulation`] is a [`World`]: it shows a telemetry every 1/hz of its own time and advances by as much once it is
//! answered. Nothing in it reads a real clock, so the same [`Setup`] with the same answers gives the same bytes,
//! however fast it runs.

mod consequences;
mod sensor;
mod setup;

pub use setup::{Ending, Eyes, Human, Setup};

use std::{collections::VecDeque, convert::Infallible, time::Duration};

use bytes::Bytes;
use glam::DVec3;

use self::sensor::Sensor;
use super::{
    camera::{Camera, JPEG_QUALITY, JPEG_QUALITY_AGAIN, Renderer, Shot, encode_jpeg},
    collision_course::{in_the_way, time_to_collision},
    expert::{Expert, path_ahead},
    judge::{Judge, Verdict},
    scenario::ScenarioError,
    scene::Actor,
    track::Place,
    traffic::Traffic,
    vehicle::{self, Car, Ground},
};
use lapwing_core::{
    drive::Eventful,
    motion::turn,
    perception::Frame,
    protocol::{Answer, CameraImage, Command, Observation, Sight, Telemetry, Truth, World},
    turn::EventRecord,
    units::{Degrees, MPS_PER_MPH, Metres, Mph, Throttle},
};

/// Grip beside the road, as a share of the grip on it.
const GRIP_BESIDE: f64 = 0.6;
/// A car farther than this from the road's edge does not come back, in metres: 7.0 m from the middle in one of the
/// forks.
const LOST_M: f64 = 7.0;

/// The world.
pub struct Simulation {
    setup: Setup,
    car: Car,
    place: Place,
    traffic: Option<Traffic>,
    judge: Judge,
    expert: Expert,
    renderer: Renderer,
    eyes: Option<Box<dyn Eyes>>,
    frame: Frame,
    sensor: Sensor,
    /// In effect.
    command: Command,
    /// On their way: the step from which on each is in effect, the earliest first.
    late: VecDeque<(u64, Command)>,
    /// Steps of the physics so far.
    steps: u64,
    /// Telemetries so far.
    shown: u64,
    driven_m: f64,
    /// Until this step the car is stationary where it hit something.
    wrecked: Option<(u64, Ending)>,
    ending: Option<Ending>,
    announced_end: bool,
    verdicts: Vec<Verdict>,
    events: Vec<(Duration, EventRecord)>,
}

impl Simulation {
    /// A world with the car at rest at the track's start, or where the scenario puts it.
    ///
    /// # Errors
    /// [`ScenarioError`] if the scenario does not fit the track.
    pub fn new(mut setup: Setup) -> Result<Self, ScenarioError> {
        setup.scenario = setup.scenario.map(|scenario| scenario.settle(setup.seed));
        let track = &setup.track;
        let traffic = setup.scenario.as_ref().map(|s| Traffic::new(s, track, setup.seed)).transpose()?;
        let mut car = Car::default();
        let place;
        match &setup.scenario {
            Some(scenario) => {
                let (s, offset) = scenario.ego.start(track);
                place = track.locate(track.point(s, offset), Some(s));
                stand(&mut car, &place);
                car.speed = scenario.ego.speed_mph() * MPS_PER_MPH;
            }
            None => {
                let start = track.file().start;
                place = track.locate(DVec3::new(start.x, start.y, start.z), None);
                stand(&mut car, &place);
                car.yaw = start.yaw_deg.to_radians();
            }
        }
        let mut world = Self {
            judge: Judge::new(track, setup.rules.clone(), place.station.s),
            expert: Expert::default(),
            renderer: Renderer::new(setup.scenery.clone()),
            eyes: None,
            frame: Frame::default(),
            sensor: Sensor::new(setup.seed),
            car,
            place,
            traffic,
            command: Command::default(),
            late: VecDeque::new(),
            steps: 0,
            shown: 0,
            driven_m: 0.0,
            wrecked: None,
            ending: None,
            announced_end: false,
            verdicts: vec![],
            events: vec![],
            setup,
        };
        let track = &world.setup.track;
        world.events.push((
            Duration::ZERO,
            EventRecord::Course {
                track: track.file().name.clone(),
                length_m: track.length(),
                waypoints: world.judge.waypoints() as u32,
                laps: world.setup.laps,
                edge_m: track.half_width(),
                scenario: world.setup.scenario.as_ref().map(|scenario| scenario.name.clone()),
            },
        ));
        Ok(world)
    }

    /// The same world, of which the pilot sees what these eyes show, and where they show nothing, what is drawn.
    pub fn seen_by(self, eyes: impl Eyes + 'static) -> Self {
        Self { eyes: Some(Box::new(eyes)), ..self }
    }

    /// The setup that it was made from.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// The car.
    pub fn car(&self) -> &Car {
        &self.car
    }

    /// Where on the road the car is.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// Puts the car somewhere else, at some speed: disturbed starts for recovery.
    pub fn put(&mut self, s: f64, offset: f64, yaw_error: f64, speed: f64) {
        let track = &self.setup.track;
        self.place = track.locate(track.point(s, offset), Some(s));
        self.car = Car::default();
        stand(&mut self.car, &self.place);
        self.car.yaw += yaw_error;
        self.car.speed = speed;
        self.judge.put(self.steps as f64 * vehicle::STEP_S);
    }

    /// Everything else on the road.
    pub fn actors(&self) -> &[Actor] {
        self.traffic.as_ref().map_or(&[], Traffic::actors)
    }

    /// The judgement of the drive so far.
    pub fn judge(&self) -> &Judge {
        &self.judge
    }

    /// Seconds of the run.
    pub fn time_s(&self) -> f64 {
        self.steps as f64 * vehicle::STEP_S
    }

    /// Share of the laps asked for that is driven; of one lap if none is asked for.
    pub fn progress(&self) -> f64 {
        let laps = f64::from(self.setup.laps.unwrap_or(1));
        (self.judge.progress_m() / (laps * self.setup.track.length())).clamp(0.0, 1.0)
    }

    /// Laps driven.
    pub fn laps(&self) -> u32 {
        self.judge.laps()
    }

    /// Why the run ended, once it has.
    pub fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    /// Ends the run at the next telemetry.
    pub fn end(&mut self, why: Ending) {
        self.ending.get_or_insert(why);
    }

    /// What the expert would do now.
    pub fn expert(&mut self, speed: Mph) -> Command {
        self.expert.drive(&self.setup.track, &self.place, &self.car, speed)
    }

    /// Draws the world as it is now, for a person or another camera.
    pub fn draw(&self, renderer: &mut Renderer, camera: &Camera, frame: &mut Frame) {
        renderer.render(camera, &self.shot(), frame);
    }

    /// A camera's picture as it is now, as JPEG.
    pub fn picture(&mut self, camera: &Camera) -> Bytes {
        let shot = shot(&self.setup, &self.car, &self.traffic, self.steps);
        self.renderer.render(camera, &shot, &mut self.frame);
        encode_jpeg(&self.frame, JPEG_QUALITY).into()
    }

    /// What the pilot is shown now, as JPEG.
    fn seen(&mut self) -> Bytes {
        let shown = self.eyes.as_mut().is_some_and(|eyes| eyes.see(&self.car, &self.place, &mut self.frame));
        if shown { encode_jpeg(&self.frame, JPEG_QUALITY_AGAIN).into() } else { self.picture(&Camera::CENTER) }
    }

    fn shot(&self) -> Shot<'_> {
        shot(&self.setup, &self.car, &self.traffic, self.steps)
    }

    /// Time of the run at which telemetry `n` is shown.
    fn at(&self, n: u64) -> Duration {
        Duration::from_secs_f64(n as f64 / self.setup.hz)
    }

    /// One step of the physics under a command, judged.
    pub fn step(&mut self, command: Command) {
        let track = &self.setup.track;
        self.steps += 1;
        let t = self.time_s();
        let before = self.car.position;
        if let Some((until, why)) = &self.wrecked {
            if self.steps >= *until {
                let why = why.clone();
                self.crashed(why);
            }
        } else {
            let along = (self.car.yaw - self.place.station.yaw).cos();
            let on_road = self.place.offset.abs() <= track.half_width();
            let ground = Ground {
                height: self.place.station.position.y,
                grade: self.place.station.grade * along,
                grip: if on_road { 1.0 } else { GRIP_BESIDE },
            };
            self.car.step(command, ground);
            self.place = track.locate(self.car.position, Some(self.place.station.s));
            self.driven_m += DVec3::new(self.car.position.x - before.x, 0.0, self.car.position.z - before.z).length();
        }
        if let Some(traffic) = &mut self.traffic {
            traffic.step(t, vehicle::STEP_S, &self.setup.track, &self.car, &self.place);
        }
        let actors = self.traffic.as_ref().map_or(&[][..], Traffic::actors);
        let mut verdicts = std::mem::take(&mut self.verdicts);
        self.judge.step(t, &self.setup.track, &self.car, &self.place, actors, &mut verdicts);
        for verdict in verdicts.drain(..) {
            self.judged(t, verdict);
        }
        self.verdicts = verdicts;
        if self.place.offset.abs() > self.setup.track.half_width() + LOST_M && self.wrecked.is_none() {
            self.crashed(Ending::Lost);
        }
        self.watch_idle(t);
        if self.setup.longest_s.is_some_and(|longest| t >= longest - 1e-9) {
            self.end(Ending::TimeOver);
        }
    }

    fn telemetry(&mut self) -> Telemetry {
        let taken = self.seen();
        let image = self.sensor.see(taken, &self.setup.conditions);
        let track = &self.setup.track;
        let mut truth = Truth::default();
        path_ahead(track, &self.place, &self.car, &mut truth.path);
        if !self.setup.stock {
            let Place { station, offset } = self.place;
            let error = turn(self.car.yaw - station.yaw);
            let position = self.car.position;
            truth = Truth {
                cte: Some(Metres::saturating(offset - track.file().driving_line_m)),
                lap: Some(self.judge.laps()),
                waypoint: Some(self.judge.waypoint() as u32),
                crashed: Some(self.judge.crashed()),
                out_of_bounds: Some(self.judge.off_roads()),
                crashes: Some(self.judge.crashes()),
                brake: Some((-self.command.throttle.get()).max(0.0)),
                distance: Some(Metres::saturating(self.driven_m)),
                sim_time_s: Some(self.time_s()),
                time_to_collision_s: self.traffic.as_ref().map(|traffic| {
                    time_to_collision(track, &self.car, &self.place, traffic.actors()).min(Truth::CLEAR_S)
                }),
                gap: self.traffic.as_ref().map(|traffic| {
                    let found = in_the_way(track, &self.car, &self.place, traffic.actors(), 0.0);
                    Metres::saturating(found.map_or(Truth::CLEAR_M, |found| found.gap_m.clamp(0.0, Truth::CLEAR_M)))
                }),
                heading_error: Some(Degrees::saturating(error.to_degrees())),
                position: Some([position.x, position.y, position.z].map(Metres::saturating)),
                ..truth
            };
        }
        Telemetry {
            steering: self.command.steering.degrees(),
            throttle: Throttle::saturating(self.command.throttle.get().max(0.0)),
            speed: Mph::saturating(self.car.speed.abs() / MPS_PER_MPH),
            image: CameraImage::Jpeg(image),
            truth,
        }
    }

    /// Advances to the next telemetry under the command in force.
    fn advance(&mut self) {
        self.shown += 1;
        let until = (self.shown as f64 / self.setup.hz / vehicle::STEP_S + 1e-9) as u64;
        while self.steps < until && self.ending.is_none() {
            while let Some((_, command)) = self.late.pop_front_if(|(from, _)| *from <= self.steps) {
                self.command = command;
            }
            self.step(self.command);
        }
    }

    fn human_now(&self) -> Option<Human> {
        let t = self.shown as f64 / self.setup.hz;
        self.setup.human.filter(|human| (human.from_s..human.from_s + human.for_s).contains(&t))
    }
}

impl Eventful for Simulation {
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)> {
        std::mem::take(&mut self.events)
    }

    fn is_recorded(&self) -> bool {
        !self.setup.stock
    }

    fn interrupt(&mut self) {
        self.end(Ending::Interrupted);
    }
}

impl World for Simulation {
    type Error = Infallible;

    fn observe(&mut self) -> Result<Option<Observation>, Infallible> {
        if let Some(ending) = &self.ending {
            if !std::mem::replace(&mut self.announced_end, true) {
                let at = Duration::from_secs_f64(self.time_s());
                self.events.push((at, EventRecord::RunEnded { why: ending.to_string() }));
            }
            return Ok(None);
        }
        let sight = match self.human_now() {
            Some(_) => Sight::HumanDrives,
            None => Sight::Telemetry(self.telemetry()),
        };
        Ok(Some(Observation { at: self.at(self.shown), sight }))
    }

    fn apply(&mut self, answer: Answer) {
        match (answer, self.human_now()) {
            (_, Some(human)) => {
                self.command = self.expert(human.speed);
                self.late.clear();
            }
            (Answer::Steer(command), None) => {
                let late = (self.setup.conditions.latency_ms / 1000.0 / vehicle::STEP_S).round() as u64;
                self.late.push_back((self.steps + late, command));
            }
            (Answer::Manual, None) => {} // the stock build keeps the last command
        }
        self.advance();
    }
}

fn shot<'a>(setup: &'a Setup, car: &'a Car, traffic: &'a Option<Traffic>, steps: u64) -> Shot<'a> {
    Shot {
        car,
        actors: traffic.as_ref().map_or(&[], Traffic::actors),
        conditions: &setup.conditions,
        seed: setup.seed,
        time_s: steps as f64 * vehicle::STEP_S,
    }
}

/// Stands a car on the road, facing along it.
fn stand(car: &mut Car, place: &Place) {
    let station = place.station;
    car.position = station.position + station.right() * place.offset;
    car.yaw = station.yaw;
    car.pitch = station.grade.atan();
}
