//! Road, car, traffic, judge and camera under one clock.
//!
//! A [`Simulation`] is a [`World`]: it shows a telemetry each 1/hz of its own
//! time and moves on by as much once it is answered. Nothing in it asks for the
//! time of day, so the same [`Setup`] under the same answers is the same to the
//! last byte, however fast it runs.

use std::{convert::Infallible, fmt, sync::Arc, time::Duration};

use bytes::Bytes;
use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    camera::{Camera, JPEG_QUALITY, Renderer, Scenery, Shot, encode_jpeg},
    collision_course::time_to_collision,
    conditions::Conditions,
    expert::{Expert, path_ahead},
    judge::{Hit, Judge, Verdict},
    scenario::{Scenario, ScenarioError},
    track::{Place, Track},
    traffic::Traffic,
    vehicle::{self, Car, Ground},
};
use lapwing_core::{
    config::{OnCrash, Rules},
    drive::Eventful,
    motion::turn,
    perception::Frame,
    protocol::{Answer, CameraImage, Command, Observation, Sight, Telemetry, Truth, World},
    turn::EventRecord,
    units::{Degrees, MPS_PER_MPH, Metres, Mph, Throttle},
};

/// Grip beside the road, as a share of the grip on it.
const GRIP_BESIDE: f64 = 0.6;
/// How long a car that hit something stands there before the run ends or it is put back, in seconds.
const WRECKED_S: f64 = 1.0;
/// Beyond this far from the road's edge nobody comes back, in metres: 7.0 m from the middle in one of the forks.
const LOST_M: f64 = 7.0;

/// A human who takes the wheel once: the expert, behind the wheel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Human {
    /// When, in seconds of the run.
    pub from_s: f64,
    /// For how long, in seconds.
    pub for_s: f64,
    /// How fast.
    pub speed: Mph,
}

/// Everything that a run depends on but the answers.
#[derive(Debug, Clone)]
pub struct Setup {
    /// The road.
    pub track: Arc<Track>,
    /// What stands along it. Built once for any number of runs: [`Scenery::new`].
    pub scenery: Arc<Scenery>,
    /// Other traffic.
    pub scenario: Option<Scenario>,
    /// Light, weather, and what ails the camera.
    pub conditions: Conditions,
    /// Of everything random.
    pub seed: u64,
    /// Telemetries a second of the run.
    pub hz: f64,
    /// Laps after which it ends.
    pub laps: Option<u32>,
    /// Time after which it ends, in seconds of the run.
    pub longest_s: Option<f64>,
    /// What happens after a crash.
    pub on_crash: OnCrash,
    /// What counts as one.
    pub rules: Rules,
    /// A human who takes the wheel.
    pub human: Option<Human>,
    /// Tell only what the stock build reports.
    pub stock: bool,
}

impl Setup {
    /// One lap in fair weather, without other traffic.
    pub fn new(track: Arc<Track>, scenery: Arc<Scenery>) -> Self {
        Self {
            track,
            scenery,
            scenario: None,
            conditions: Conditions::default(),
            seed: 0,
            hz: 15.0,
            laps: Some(1),
            longest_s: None,
            on_crash: OnCrash::Stop,
            rules: Rules::default(),
            human: None,
            stock: false,
        }
    }
}

/// Why a run ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Ending {
    /// All laps are driven.
    LapsDone,
    /// The time limit is reached.
    TimeOver,
    /// The car hit something.
    Collision(String),
    /// The car went further off the road than anyone comes back from.
    Lost,
    /// The car does not get away.
    Stuck,
    /// Somebody pressed Ctrl-C.
    Interrupted,
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LapsDone => write!(f, "all laps driven"),
            Self::TimeOver => write!(f, "time limit reached"),
            Self::Collision(with) => write!(f, "collision with {with}"),
            Self::Lost => write!(f, "far off the road"),
            Self::Stuck => write!(f, "stuck"),
            Self::Interrupted => write!(f, "interrupted"),
        }
    }
}

/// The world.
pub struct Simulation {
    setup: Setup,
    car: Car,
    place: Place,
    traffic: Option<Traffic>,
    judge: Judge,
    expert: Expert,
    renderer: Renderer,
    frame: Frame,
    sensor: Sensor,
    command: Command,
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

/// What ails the camera in time: latency and dropped frames.
struct Sensor {
    /// Pictures with the time that they were taken, oldest first.
    pictures: std::collections::VecDeque<(f64, Bytes)>,
    random: ChaCha8Rng,
}

impl Simulation {
    /// A world with the car at rest at the track's start, or where the scenario puts it.
    ///
    /// # Errors
    /// [`ScenarioError`] where the scenario does not fit the track.
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
            frame: Frame::default(),
            sensor: Sensor {
                pictures: Default::default(),
                random: ChaCha8Rng::seed_from_u64(setup.seed ^ 0x5e15_0d0f_5e15_0d0f),
            },
            car,
            place,
            traffic,
            command: Command::default(),
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

    /// The setup that it was made of.
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

    /// What the drive is judged to be so far.
    pub fn judge(&self) -> &Judge {
        &self.judge
    }

    /// Seconds of the run.
    pub fn time_s(&self) -> f64 {
        self.steps as f64 * vehicle::STEP_S
    }

    /// Share of the asked laps that are driven; of one lap where none is asked for.
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
        if self.setup.longest_s.is_some_and(|longest| t >= longest - 1e-9) {
            self.end(Ending::TimeOver);
        }
    }

    fn judged(&mut self, t: f64, verdict: Verdict) {
        let at = Duration::from_secs_f64(t);
        let event = match verdict {
            Verdict::Waypoint(_) => return,
            Verdict::Lap { number, time_s } => {
                if self.setup.laps.is_some_and(|laps| number >= laps) {
                    self.end(Ending::LapsDone);
                }
                EventRecord::Lap { number, time_s }
            }
            Verdict::Collision { with, speed } => {
                let with = name_of(&with);
                let own_mph = Some(std::mem::take(&mut self.car.speed).abs() / MPS_PER_MPH);
                if self.wrecked.is_none() {
                    let until = self.steps + (WRECKED_S / vehicle::STEP_S) as u64;
                    self.wrecked = Some((until, Ending::Collision(with.clone())));
                }
                EventRecord::Collision { with, speed_mph: speed / MPS_PER_MPH, own_mph }
            }
            Verdict::OffRoad { offset_m } => {
                if self.setup.on_crash == OnCrash::Reset && self.wrecked.is_none() {
                    self.wrecked = Some((self.steps + 1, Ending::Lost));
                }
                EventRecord::OffRoad { offset_m }
            }
            Verdict::BackOnRoad { after_s } => EventRecord::BackOnRoad { after_s },
            Verdict::Stuck => {
                if self.wrecked.is_none() {
                    self.wrecked = Some((self.steps + 1, Ending::Stuck));
                }
                EventRecord::Stuck
            }
            Verdict::Moving => EventRecord::Moving,
            Verdict::WrongWay => EventRecord::WrongWay,
            Verdict::RightWay => EventRecord::RightWay,
        };
        self.events.push((at, event));
    }

    /// After a crash: the end, or the next waypoint.
    fn crashed(&mut self, why: Ending) {
        self.wrecked = None;
        match self.setup.on_crash {
            OnCrash::Stop => self.end(why),
            OnCrash::Reset => {
                let s = self.judge.next_waypoint_s(&self.setup.track);
                let waypoint = (self.judge.waypoint() + 1) % self.judge.waypoints();
                let offset = self.setup.track.file().driving_line_m;
                self.place = self.setup.track.locate(self.setup.track.point(s, offset), Some(s));
                self.car = Car::default();
                stand(&mut self.car, &self.place);
                self.judge.put(self.time_s());
                let at = Duration::from_secs_f64(self.time_s());
                self.events.push((at, EventRecord::Reset { waypoint: waypoint as u32 }));
            }
        }
    }

    fn telemetry(&mut self) -> Telemetry {
        let taken = self.picture(&Camera::CENTER);
        let image = self.sensor.see(self.time_s(), taken, &self.setup.conditions);
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

    /// On to the next telemetry under the command in force.
    fn advance(&mut self) {
        self.shown += 1;
        let until = (self.shown as f64 / self.setup.hz / vehicle::STEP_S + 1e-9) as u64;
        while self.steps < until && self.ending.is_none() {
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
            (_, Some(human)) => self.command = self.expert(human.speed),
            (Answer::Steer(command), None) => self.command = command,
            (Answer::Manual, None) => {} // the stock build drives on as it was told last
        }
        self.advance();
    }
}

impl Sensor {
    /// What arrives now of a picture taken now.
    fn see(&mut self, t: f64, taken: Bytes, conditions: &Conditions) -> Bytes {
        if conditions.latency_ms <= 0.0 && conditions.dropped <= 0.0 {
            return taken;
        }
        let chance = f64::from(self.random.next_u32()) / f64::from(u32::MAX);
        if self.pictures.is_empty() || chance >= conditions.dropped {
            self.pictures.push_back((t, taken));
        }
        let newest_allowed = t - conditions.latency_ms / 1000.0;
        while self.pictures.len() > 1 && self.pictures[1].0 <= newest_allowed + 1e-9 {
            self.pictures.pop_front();
        }
        self.pictures[0].1.clone()
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

fn name_of(hit: &Hit) -> String {
    match hit {
        Hit::Actor { kind, .. } => kind.to_string(),
        Hit::Wall(edge) => edge.to_string(),
    }
}
