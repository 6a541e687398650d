//! What keeps the expert from driving perfectly, so that a model learns to recover.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{vehicle, world::Simulation};

/// Seconds from one disturbed start to the next, at least and at most.
const DISTURBED_EVERY_S: (f64, f64) = (4.0, 8.0);
/// How far from the line a disturbed start is, at most, as a share of the distance at which a wheel leaves the road.
const DISTURBED_REACH: f64 = 0.9;
/// How far from the road's direction a disturbed start faces, at most, in radians (10 degrees).
const DISTURBED_YAW: f64 = 0.175;
/// Correlation time of the steering noise, an Ornstein-Uhlenbeck process, in seconds. Bojarski et al. (2016) and
/// Codevilla et al. (2018) disturb similarly.
const NOISE_S: f64 = 0.7;

/// Puts the car beside the line now and then, and adds noise to its steering.
pub(super) struct Disturbance {
    random: ChaCha8Rng,
    next_s: f64,
    hz: f64,
    /// The noise's standard deviation, normalised steering.
    deviation: f64,
    noise: f64,
}

impl Disturbance {
    pub fn new(seed: u64, hz: f64, deviation: f64) -> Self {
        let random = ChaCha8Rng::seed_from_u64(seed ^ 0x7ec0_7e71);
        let mut disturbance = Self { random, next_s: 0.0, hz, deviation, noise: 0.0 };
        disturbance.next_s = disturbance.wait();
        disturbance
    }

    fn wait(&mut self) -> f64 {
        let (least, most) = DISTURBED_EVERY_S;
        least + (most - least) * (self.uniform() + 1.0) / 2.0
    }

    /// From -1 to 1.
    fn uniform(&mut self) -> f64 {
        f64::from(self.random.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0
    }

    pub fn is_due(&self, now_s: f64) -> bool {
        now_s >= self.next_s
    }

    /// Puts the car beside the line, askew: on `whole` roads anywhere, otherwise as far to the one side as to the other, and
    /// so in its own lane.
    pub fn strike(&mut self, simulation: &mut Simulation, whole: bool) {
        let (s, speed) = (simulation.place().station.s, simulation.car().speed);
        let track = &simulation.setup().track;
        let line = track.file().driving_line_m;
        let room = |side_m: f64| (track.half_width() - side_m - vehicle::BODY.x / 2.0).max(0.5) * DISTURBED_REACH;
        let (share, askew) = (self.uniform(), self.uniform() * DISTURBED_YAW);
        let reach = match whole {
            true if share < 0.0 => room(-line),
            true => room(line),
            false => room(line.abs()),
        };
        simulation.put(s, line + share * reach, askew, speed);
        self.noise = 0.0;
        self.next_s = simulation.time_s() + self.wait();
    }

    /// What is added to the steering in this step; its mean is 0.
    pub fn noise(&mut self) -> f64 {
        let keep = (-1.0 / (self.hz * NOISE_S)).exp();
        // Sum of three uniforms: standard deviation 1, bounded by 3.
        let shock = self.uniform() + self.uniform() + self.uniform();
        self.noise = keep * self.noise + self.deviation * (1.0 - keep * keep).sqrt() * shock;
        self.noise
    }
}
