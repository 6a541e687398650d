//! Pilots of different quality, the same ones on every machine.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::Result;
use lapwing_core::pilot::{Pilot, PilotError, Prediction, View};
use lapwing_learn::models;
use lapwing_learn::models::LoadedModel;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Seed of the noise.
const SEED: u64 = 20_161_121;
/// The noise forgets within this many frames: two thirds of a second.
const NOISE_FRAMES: f64 = 10.0;

/// What ails a pilot. As it comes: a gain of 1 and nothing else.
#[derive(Debug, Clone, Copy)]
pub struct Handicap {
    /// Of what it wants to steer it steers this share.
    gain: f64,
    /// And adds this.
    bias: f64,
    /// It steers what it wanted so many frames ago.
    late: usize,
    /// Standard deviation of an Ornstein-Uhlenbeck process that is added, in normalised steering.
    noise: f64,
}

const NONE: Handicap = Handicap { gain: 1.0, bias: 0.0, late: 0, noise: 0.0 };

/// What is tried of the built-in network.
const HANDICAPS: [(&str, Handicap); 11] = [
    ("gain 0.5", Handicap { gain: 0.5, ..NONE }),
    ("gain 0.4", Handicap { gain: 0.4, ..NONE }),
    ("gain 0.3", Handicap { gain: 0.3, ..NONE }),
    ("gain 0.2", Handicap { gain: 0.2, ..NONE }),
    ("bias 0.12 left", Handicap { bias: -0.12, ..NONE }),
    ("bias 0.25 left", Handicap { bias: -0.25, ..NONE }),
    ("0.4 s late", Handicap { late: 6, ..NONE }),
    ("noise 0.1", Handicap { noise: 0.1, ..NONE }),
    ("noise 0.14", Handicap { noise: 0.14, ..NONE }),
    ("noise 0.18", Handicap { noise: 0.18, ..NONE }),
    ("straight on", Handicap { gain: 0.0, ..NONE }),
];

/// A model and what ails it.
pub struct Handicapped {
    /// What it is called.
    pub name: String,
    model: LoadedModel,
    handicap: Handicap,
}

impl Handicapped {
    /// Ready for a drive.
    pub fn pilot(&self) -> Box<dyn Pilot> {
        let inner = self.model.pilot();
        let random = ChaCha8Rng::seed_from_u64(SEED);
        Box::new(Ailing { inner, handicap: self.handicap, wanted: vec![], random, noise: 0.0 })
    }
}

/// The shipped models, further ones, and the built-in one with each handicap.
pub fn all(further: &[PathBuf], quick: bool) -> Result<Vec<Handicapped>> {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let mut pilots = Vec::new();
    let mut add = |name: String, model: LoadedModel, handicap| pilots.push(Handicapped { name, model, handicap });
    if !quick {
        add("resnet50".into(), models::load(shipped.join("resnet50.safetensors"), Instant::now)?, NONE);
    }
    add("pilotnet".into(), models::built_in(Instant::now)?, NONE);
    add("cps".into(), models::load(shipped.join("cps.safetensors"), Instant::now)?, NONE);
    for path in further {
        let name = path.parent().and_then(Path::file_name).map_or_else(String::new, |n| n.to_string_lossy().into());
        add(name, models::load(path, Instant::now)?, NONE);
    }
    for (what, handicap) in HANDICAPS {
        add(format!("pilotnet, {what}"), models::built_in(Instant::now)?, handicap);
    }
    Ok(pilots)
}

/// A pilot that does not do quite what it wants to.
struct Ailing {
    inner: Box<dyn Pilot>,
    handicap: Handicap,
    wanted: Vec<f64>,
    random: ChaCha8Rng,
    noise: f64,
}

impl Ailing {
    /// From -1 to 1.
    fn uniform(&mut self) -> f64 {
        f64::from(self.random.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0
    }
}

impl Pilot for Ailing {
    fn steer(&mut self, view: &View<'_>) -> Result<Prediction, PilotError> {
        let prediction = self.inner.steer(view)?;
        let Handicap { gain, bias, late, noise } = self.handicap;
        self.wanted.push(prediction.steering);
        let then = self.wanted.len().saturating_sub(1 + late);
        let keep = (-1.0 / NOISE_FRAMES).exp();
        // The sum of three uniforms has a standard deviation of 1.
        let shock = self.uniform() + self.uniform() + self.uniform();
        self.noise = keep * self.noise + noise * (1.0 - keep * keep).sqrt() * shock;
        Ok(Prediction { steering: gain * self.wanted[then] + bias + self.noise, ..prediction })
    }

    fn reset(&mut self) {
        self.inner.reset();
        (self.wanted, self.noise) = (vec![], 0.0);
        self.random = ChaCha8Rng::seed_from_u64(SEED);
    }
}
