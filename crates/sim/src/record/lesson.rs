//! A simulation in which the expert and a driver take turns at the wheel.

use std::{convert::Infallible, f64::consts::TAU, time::Duration};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Disagreement, RecordOptions, disturbance::Disturbance};
use crate::world::Simulation;
use lapwing_core::{
    drive::Eventful,
    motion::{steering_deg, turn},
    protocol::{Answer, Command, Observation, World},
    turn::EventRecord,
    units::{Degrees, Steering},
};

/// How long a weaving car takes from one side to the other and back, in seconds.
const SWING_S: f64 = 9.0;
/// How it gets there: radians askew per metre, at most, and degrees of the front wheels per radian. Chosen so that the
/// car follows the swing without leaving the road.
const ASKEW_PER_M: f64 = 0.2;
const MOST_ASKEW_RAD: f64 = 0.2;
const STEERED_DEG_PER_RAD: f64 = 30.0;

/// How long the same one drives, in seconds.
const STINT_S: f64 = 4.0;
/// A driver that faces further from the road's direction than this, in radians (60 degrees), has left the road.
const LOST_RAD: f64 = 1.05;

/// A world that says at each moment what the expert would do, and obeys the expert or the driver.
pub struct Lesson<'a, F> {
    world: &'a mut Simulation,
    options: RecordOptions,
    watch: F,
    disturbance: Option<Disturbance>,
    random: ChaCha8Rng,
    /// Whether the expert drives, and until when.
    stint: (bool, f64),
    label: Command,
    /// Whether the car was put elsewhere before this moment.
    cut: bool,
    put_back: u32,
    apart: Disagreement,
}

impl<'a, F: FnMut(&mut Simulation)> Lesson<'a, F> {
    /// A lesson in this simulation; `watch` sees it after each moment.
    pub fn new(world: &'a mut Simulation, options: RecordOptions, watch: F) -> Self {
        let (hz, seed) = (world.setup().hz, world.setup().seed);
        let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x1e55_0000_1e55_0000);
        if options.anywhere {
            let track = &world.setup().track;
            let (s, line_m) = (random.random::<f64>() * track.length(), track.file().driving_line_m);
            world.put(s, line_m, 0.0, 0.0);
        }
        Self {
            disturbance: options.recovery.then(|| Disturbance::new(seed, hz, options.noise)),
            random,
            stint: (true, if options.expert < 1.0 { 0.0 } else { f64::INFINITY }),
            label: Command::default(),
            cut: false,
            put_back: 0,
            apart: Disagreement::default(),
            world,
            options,
            watch,
        }
    }

    /// Puts the car elsewhere where that is due.
    fn prepare(&mut self) {
        let now_s = self.world.time_s();
        self.cut = false;
        if let Some(disturbance) = self.disturbance.as_mut().filter(|disturbance| disturbance.is_due(now_s)) {
            // A network may come to where the expert never is, such as the other lane, and stay there.
            disturbance.strike(self.world, self.options.expert < 1.0);
            self.cut = true;
        } else if self.options.expert < 1.0 && self.is_lost() {
            let (s, line_m) = (self.world.place().station.s, self.world.setup().track.file().driving_line_m);
            self.world.put(s, line_m, 0.0, self.world.car().speed);
            self.cut = true;
            self.put_back += 1;
        }
        while now_s >= self.stint.1 {
            self.stint = (self.random.random::<f64>() < self.options.expert, self.stint.1 + STINT_S);
        }
    }

    fn is_lost(&self) -> bool {
        let place = self.world.place();
        place.offset.abs() > self.world.setup().track.half_width()
            || turn(self.world.car().yaw - place.station.yaw).abs() > LOST_RAD
    }
}

impl<F> Lesson<'_, F> {
    /// The simulation, as it is.
    pub fn simulation(&self) -> &Simulation {
        self.world
    }

    /// What the expert would do now.
    pub fn label(&self) -> Command {
        self.label
    }

    /// Whether this moment does not continue from the last one: the car was put elsewhere.
    pub fn is_cut(&self) -> bool {
        self.cut
    }

    /// How often the car was put back on the road.
    pub fn put_back(&self) -> u32 {
        self.put_back
    }

    /// The root of the mean square of the distance between the driver's steering and the expert's, while the driver
    /// drove.
    pub fn disagreement(&self) -> Option<f64> {
        self.apart.rms()
    }
}

/// Steers towards a place that swings to both sides of the line.
fn weaving(simulation: &Simulation, weave_m: f64) -> Steering {
    let (place, line_m) = (simulation.place(), simulation.setup().track.file().driving_line_m);
    let wanted_m = line_m + weave_m * (simulation.time_s() / SWING_S * TAU).sin();
    let wanted_rad = (ASKEW_PER_M * (wanted_m - place.offset)).clamp(-MOST_ASKEW_RAD, MOST_ASKEW_RAD);
    let askew_rad = turn(simulation.car().yaw - place.station.yaw);
    let bend_deg = steering_deg(place.station.curvature);
    Degrees::saturating(bend_deg + STEERED_DEG_PER_RAD * (wanted_rad - askew_rad)).steering()
}

impl<F: FnMut(&mut Simulation)> World for Lesson<'_, F> {
    type Error = Infallible;

    fn observe(&mut self) -> Result<Option<Observation>, Infallible> {
        if self.world.ending().is_none() {
            self.prepare();
            self.label = self.world.expert(self.options.speed);
            if self.options.weave_m > 0.0 {
                self.label.steering = weaving(self.world, self.options.weave_m);
            }
        }
        self.world.observe()
    }

    fn apply(&mut self, answer: Answer) {
        let noise = self.disturbance.as_mut().map_or(0.0, Disturbance::noise);
        let (expert_drives, _) = self.stint;
        let command = match answer {
            Answer::Steer(command) if !expert_drives => {
                self.apart.add(command.steering, self.label.steering);
                command
            }
            _ => Command { steering: Steering::saturating(self.label.steering.get() + noise), ..self.label },
        };
        self.world.apply(Answer::Steer(command));
        (self.watch)(self.world);
    }
}

impl<F: FnMut(&mut Simulation)> Eventful for Lesson<'_, F> {
    fn take_events(&mut self) -> Vec<(Duration, EventRecord)> {
        self.world.take_events()
    }

    fn interrupt(&mut self) {
        self.world.interrupt();
    }
}
