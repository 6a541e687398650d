//! `lapwing record`: the expert drives, and the stock recorder's files are written.

use std::path::Path;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Ended, Interrupted, world};
use crate::cli;
use lapwing_core::{
    protocol::{Answer, Command, World},
    recording::udacity::{DrivingLogWriter, NewRow},
    units::{MPS_PER_MPH, Mph, Steering},
    words::count,
};
use lapwing_sim::{
    camera::Camera,
    vehicle,
    world::{Ending, Simulation},
};

/// Seconds from one disturbed start to the next, at least and at most.
const DISTURBED_EVERY_S: (f64, f64) = (4.0, 8.0);
/// How far from the line a disturbed start is, at most, as a share of the way to where a wheel leaves the road.
const DISTURBED_REACH: f64 = 0.9;
/// How far from the road's direction a disturbed start faces, at most, in radians (10 degrees).
const DISTURBED_YAW: f64 = 0.175;
/// Steering noise: an Ornstein-Uhlenbeck process of this standard deviation (normalised steering) …
const NOISE: f64 = 0.12;
/// … which forgets within this time, in seconds. Bojarski et al. (2016) and Codevilla et al. (2018) disturb alike.
const NOISE_S: f64 = 0.7;

pub(super) fn run(arguments: &cli::Record, config: Option<&Path>) -> anyhow::Result<Ended> {
    let Recorded { rows, laps, track, ending } = record(arguments, config, &super::interrupted())?;
    let ended = if laps >= arguments.laps { Ended::Passed } else { Ended::Failed };
    let laps = format!("{laps} of {}", count(arguments.laps, "lap"));
    super::print(&format!("{}, {laps} of {track} ({ending}), in {}", count(rows, "row"), arguments.out.display()))?;
    Ok(ended)
}

/// What was recorded.
pub(super) struct Recorded {
    rows: u64,
    /// Laps driven to their end.
    pub(super) laps: u32,
    track: String,
    /// Why it ended.
    pub(super) ending: Ending,
}

/// Drives and records until all laps are driven, or nothing goes on.
pub(super) fn record(
    arguments: &cli::Record,
    config: Option<&Path>,
    interrupted: &Interrupted,
) -> anyhow::Result<Recorded> {
    let settings = world::layers(super::undriven_layers(config)?, &arguments.world)?.resolve()?;
    let setup = world::spec(&arguments.world, Some(arguments.laps)).setup(&settings.simulator)?;
    let (hz, seed) = (setup.hz, setup.seed);
    let mut simulation = Simulation::new(setup)?;
    // Last, for whatever fails before leaves no log.
    let mut log = DrivingLogWriter::create(&arguments.out, jiff::Zoned::now().datetime())?;
    let mut disturbance = arguments.recovery.then(|| Disturbance::new(seed, hz));
    let bar = world::Progress::new();
    let speed = Mph::saturating(arguments.speed);
    let mut frame = 0u64;
    let ending = loop {
        if let Some(ending) = simulation.ending() {
            break ending.clone();
        }
        if let Some(disturbance) = &mut disturbance
            && disturbance.is_due(simulation.time_s())
        {
            disturbance.strike(&mut simulation);
            log.cut();
        }
        let label = simulation.expert(speed);
        let [center, left, right] = [&Camera::CENTER, &Camera::LEFT, &Camera::RIGHT].map(|c| simulation.picture(c));
        log.row(&NewRow {
            at: std::time::Duration::from_secs_f64(frame as f64 / hz),
            center: &center,
            left: Some(&left),
            right: Some(&right),
            steering: label.steering,
            throttle: label.throttle,
            brake: (-label.throttle.get()).max(0.0),
            speed: Mph::saturating(simulation.car().speed.abs() / MPS_PER_MPH),
        })?;
        let noise = disturbance.as_mut().map_or(0.0, Disturbance::noise);
        let command = Command { steering: Steering::saturating(label.steering.get() + noise), ..label };
        frame += 1;
        simulation.apply(Answer::Steer(command));
        bar.show(&simulation);
        interrupted.end(&mut simulation);
    };
    bar.clear();
    let (laps, track) = (simulation.laps(), simulation.setup().track.file().name.clone());
    Ok(Recorded { rows: log.finish()?, laps, track, ending })
}

/// What keeps the expert from driving perfectly, so that a model learns to come back.
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

    /// The car finds itself beside the line, askew.
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
