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

fn simulation(track: &Track, seconds: Option<f64>) -> Result<Simulation> {
    let scenery = Arc::new(Scenery::new(track));
    let fair = Setup::new(Arc::new(track.clone()), scenery);
    Ok(Simulation::new(Setup { hz: HZ, longest_s: seconds, on_crash: OnCrash::Reset, ..fair })?)
}

/// The expert's lap in a Udacity folder, as `lapwing record` writes it, and where the car was.
pub fn record(track: &Track, seconds: Option<f64>, options: RecordOptions, folder: &Path) -> Result<LocatedDrive> {
    let mut world = simulation(track, seconds)?;
    let log = DrivingLogWriter::create(folder, jiff::civil::date(2026, 11, 22).at(8, 0, 0, 0))?;
    let mut places = vec![Some(Located::known(Pose::of(&world)))];
    // The expert in the simulation drives: this driver's answers do not count.
    let mut driver = Driver::new(Box::new(PurePursuit::default()), &ControlSettings::default(), Instant::now);
    record::record(&mut world, &mut driver, log, options, |world| places.push(Some(Located::known(Pose::of(world)))))?;
    places.pop(); // the car has arrived there, but no picture was taken
    Ok(LocatedDrive { track: Arc::new(track.clone()), places })
}

/// A simulation whose car is put back on its line as the closed loop on a recording does it: beyond the limit, at once,
/// at its speed.
pub struct Kept {
    simulation: Simulation,
    limit_m: f64,
    events: Vec<(Duration, EventRecord)>,
}

impl Kept {
    pub fn new(track: &Track, limit_m: f64, seconds: Option<f64>) -> Result<Self> {
        Ok(Self { simulation: simulation(track, seconds)?, limit_m, events: vec![] })
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
