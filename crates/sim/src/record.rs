//! Training data by the expert: it drives, and the stock recorder's files are written.
//!
//! ```text
//! Simulation ─▶ three pictures ─────────────────────────┐
//!      └──────▶ Expert ─▶ label ────────────────────────┴─▶ DrivingLogWriter
//!                           └─▶ + noise ─▶ Simulation
//! ```
//! This is a loop of its own, beside [`drive::run`](lapwing_core::drive::run): there is no pilot to show a picture to
//! and no answer to record. The log holds what the expert would do, the car drives with noise added, and it is put
//! elsewhere between some rows.

use std::{f64::consts::TAU, time::Duration};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use lapwing_core::{
    motion::{steering_deg, turn},
    protocol::{Answer, Command, World},
    recording::{
        RecordingError,
        udacity::{DrivingLogWriter, NewRow},
    },
    units::{Degrees, MPS_PER_MPH, Mph, Steering},
};

use crate::{
    camera::Camera,
    vehicle,
    world::{Ending, Simulation},
};

/// Seconds from one disturbed start to the next, at least and at most.
const DISTURBED_EVERY_S: (f64, f64) = (4.0, 8.0);
/// How far from the line a disturbed start is, at most, as a share of the distance at which a wheel leaves the road.
const DISTURBED_REACH: f64 = 0.9;
/// How far from the road's direction a disturbed start faces, at most, in radians (10 degrees).
const DISTURBED_YAW: f64 = 0.175;
/// Steering noise: an Ornstein-Uhlenbeck process of this standard deviation (normalised steering) …
const NOISE: f64 = 0.12;
/// … and this correlation time, in seconds. Bojarski et al. (2016) and Codevilla et al. (2018) disturb similarly.
const NOISE_S: f64 = 0.7;

/// How long a weaving car takes from one side to the other and back, in seconds.
const SWING_S: f64 = 9.0;
/// How it gets there: radians askew per metre, at most, and degrees of the front wheels per radian. Chosen so that the
/// car follows the swing without leaving the road.
const ASKEW_PER_M: f64 = 0.2;
const MOST_ASKEW_RAD: f64 = 0.2;
const STEERED_DEG_PER_RAD: f64 = 30.0;

/// How the expert drives, and what is recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordOptions {
    /// How fast, if bends allow it.
    pub speed: Mph,
    /// Whether the car is sometimes put beside the line and askew, and its steering disturbed, so that a model learns
    /// to recover. Default no.
    pub recovery: bool,
    /// Whether the left and right cameras are recorded, too. Default yes.
    pub side_cameras: bool,
    /// How far the car weaves to each side of the line, in metres, as people do; the log holds what was steered, not what
    /// the expert would. Default 0.
    pub weave_m: f64,
}

impl RecordOptions {
    /// The three cameras of a drive along the line.
    pub fn at(speed: Mph) -> Self {
        Self { speed, recovery: false, side_cameras: true, weave_m: 0.0 }
    }
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordReport {
    /// Rows of the log.
    pub rows: u64,
    /// Laps completed.
    pub laps: u32,
    /// Why the drive ended.
    pub ending: Ending,
}

/// Lets the expert drive a world to its end and logs each moment at which telemetry would be sent. `watch` sees the
/// world after each row and may end it.
///
/// # Errors
/// [`RecordingError`] where the log or a picture cannot be written.
pub fn record(
    simulation: &mut Simulation,
    mut log: DrivingLogWriter,
    options: RecordOptions,
    mut watch: impl FnMut(&mut Simulation),
) -> Result<RecordReport, RecordingError> {
    let RecordOptions { speed, recovery, side_cameras, weave_m } = options;
    let (hz, seed) = (simulation.setup().hz, simulation.setup().seed);
    let mut disturbance = recovery.then(|| Disturbance::new(seed, hz));
    let mut frame = 0u64;
    let ending = loop {
        if let Some(ending) = simulation.ending() {
            break ending.clone();
        }
        if let Some(disturbance) = &mut disturbance
            && disturbance.is_due(simulation.time_s())
        {
            disturbance.strike(simulation);
            log.cut();
        }
        let mut label = simulation.expert(speed);
        if weave_m > 0.0 {
            label.steering = weaving(simulation, weave_m);
        }
        let center = simulation.picture(&Camera::CENTER);
        let sides = side_cameras.then(|| [&Camera::LEFT, &Camera::RIGHT].map(|camera| simulation.picture(camera)));
        log.row(&NewRow {
            at: Duration::from_secs_f64(frame as f64 / hz),
            center: &center,
            left: sides.as_ref().map(|[left, _]| &left[..]),
            right: sides.as_ref().map(|[_, right]| &right[..]),
            steering: label.steering,
            throttle: label.throttle,
            brake: (-label.throttle.get()).max(0.0),
            speed: Mph::saturating(simulation.car().speed.abs() / MPS_PER_MPH),
        })?;
        let noise = disturbance.as_mut().map_or(0.0, Disturbance::noise);
        let command = Command { steering: Steering::saturating(label.steering.get() + noise), ..label };
        frame += 1;
        simulation.apply(Answer::Steer(command));
        watch(simulation);
    };
    Ok(RecordReport { rows: log.finish()?, laps: simulation.laps(), ending })
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

/// Keeps the expert from driving perfectly, so that a model learns to recover.
struct Disturbance {
    random: ChaCha8Rng,
    next_s: f64,
    hz: f64,
    noise: f64,
}

impl Disturbance {
    fn new(seed: u64, hz: f64) -> Self {
        let mut disturbance =
            Self { random: ChaCha8Rng::seed_from_u64(seed ^ 0x7ec0_7e71), next_s: 0.0, hz, noise: 0.0 };
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

    fn is_due(&self, now_s: f64) -> bool {
        now_s >= self.next_s
    }

    /// Puts the car beside the line, askew.
    fn strike(&mut self, simulation: &mut Simulation) {
        let (s, speed) = (simulation.place().station.s, simulation.car().speed);
        let track = &simulation.setup().track;
        let line = track.file().driving_line_m;
        let reach = (track.half_width() - line.abs() - vehicle::BODY.x / 2.0).max(0.5) * DISTURBED_REACH;
        let (aside, askew) = (self.uniform() * reach, self.uniform() * DISTURBED_YAW);
        simulation.put(s, line + aside, askew, speed);
        self.noise = 0.0;
        self.next_s = simulation.time_s() + self.wait();
    }

    /// What is added to the steering in this step; its mean is 0.
    fn noise(&mut self) -> f64 {
        let keep = (-1.0 / (self.hz * NOISE_S)).exp();
        // Sum of three uniforms: standard deviation 1, bounded by 3.
        let shock = self.uniform() + self.uniform() + self.uniform();
        self.noise = keep * self.noise + NOISE * (1.0 - keep * keep).sqrt() * shock;
        self.noise
    }
}
