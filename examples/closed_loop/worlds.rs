//! The road: a lap of it recorded, and driven with the replay's interventions.

use std::{
    convert::Infallible,
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

use anyhow::Result;
use lapwing_core::{
    config::{ControlSettings, OnCrash},
    drive::Eventful,
    driver::Driver,
    pilot::PurePursuit,
    protocol::{Answer, Observation, World},
    recording::udacity::DrivingLogWriter,
    turn::EventRecord,
};
use lapwing_sim::{
    along::FURTHEST_HEADING_DEG,
    camera::Scenery,
    locate::{Located, LocatedDrive, Pose},
    record::{self, RecordOptions},
    track::Track,
    world::{Setup, Simulation},
};

/// As the stock recorder.
const HZ: f64 = 15.0;

/// A road, and what stands beside it.
pub struct Road {
    /// The road.
    pub track: Arc<Track>,
    scenery: Arc<Scenery>,
}

impl Road {
    pub fn new(track: Track) -> Self {
        let scenery = Arc::new(Scenery::new(&track));
        Self { track: Arc::new(track), scenery }
    }

    fn simulation(&self, seconds: Option<f64>) -> Result<Simulation> {
        let fair = Setup::new(self.track.clone(), self.scenery.clone());
        Ok(Simulation::new(Setup { hz: HZ, longest_s: seconds, on_crash: OnCrash::Reset, ..fair })?)
    }

    /// The expert's lap in a Udacity folder, as `lapwing record` writes it, and where the car was.
    pub fn record(&self, seconds: Option<f64>, options: RecordOptions, folder: &Path) -> Result<LocatedDrive> {
        let mut world = self.simulation(seconds)?;
        let log = DrivingLogWriter::create(folder, jiff::civil::date(2026, 11, 22).at(8, 0, 0, 0))?;
        let mut places = vec![Some(Located::known(Pose::of(&world)))];
        // The expert in the simulation drives: this driver's answers do not count.
        let mut driver = Driver::new(Box::new(PurePursuit::default()), &ControlSettings::default(), Instant::now);
        let place = |world: &mut Simulation| places.push(Some(Located::known(Pose::of(world))));
        record::record(&mut world, &mut driver, log, options, place)?;
        places.pop(); // the car has arrived there, but no picture was taken
        Ok(LocatedDrive { track: self.track.clone(), places })
    }
}

/// A simulation whose car is put back on its line as the closed loop on a recording does it: beyond the limit, at once,
/// at its speed.
pub struct Kept {
    simulation: Simulation,
    limit_m: f64,
    events: Vec<(Duration, EventRecord)>,
}

impl Kept {
    /// It begins on the line, as a drive along a recording does; tracks begin where the stock simulator puts the car.
    pub fn new(road: &Road, limit_m: f64, seconds: Option<f64>) -> Result<Self> {
        let mut simulation = road.simulation(seconds)?;
        let (s, line) = (simulation.place().station.s, road.track.file().driving_line_m);
        simulation.put(s, line, 0.0, 0.0);
        Ok(Self { simulation, limit_m, events: vec![] })
    }
}

impl World for Kept {
    type Error = Infallible;

    fn observe(&mut self) -> Result<Option<Observation>, Infallible> {
        self.simulation.observe()
    }

    fn apply(&mut self, answer: Answer) {
        self.simulation.apply(answer);
        let (place, car) = (self.simulation.place(), self.simulation.car());
        let line = self.simulation.setup().track.file().driving_line_m;
        let askew = (car.yaw - place.station.yaw).cos() < FURTHEST_HEADING_DEG.to_radians().cos();
        if (place.offset - line).abs() > self.limit_m || askew {
            let (s, speed) = (place.station.s, car.speed);
            self.simulation.put(s, line, 0.0, speed);
            let at = Duration::from_secs_f64(self.simulation.time_s());
            self.events.push((at, EventRecord::Reset { waypoint: self.simulation.judge().waypoint() as u32 }));
        }
    }
}

impl Eventful for Kept {
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)> {
        let mut events = self.simulation.take_events();
        events.append(&mut self.events);
        events.sort_by_key(|(at, _)| *at);
        events
    }

    fn interrupt(&mut self) {
        self.simulation.interrupt();
    }
}
