//! The camera's delay and losses.

use std::collections::VecDeque;

use bytes::Bytes;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::conditions::Conditions;

/// Applies latency and dropped frames.
pub(super) struct Sensor {
    /// Pictures with the time that they were taken, oldest first.
    pictures: VecDeque<(f64, Bytes)>,
    random: ChaCha8Rng,
}

impl Sensor {
    /// A sensor for the run with this seed.
    pub(super) fn new(seed: u64) -> Self {
        Self { pictures: VecDeque::new(), random: ChaCha8Rng::seed_from_u64(seed ^ 0x5e15_0d0f_5e15_0d0f) }
    }

    /// The picture that arrives now, given the one taken now.
    pub(super) fn see(&mut self, t: f64, taken: Bytes, conditions: &Conditions) -> Bytes {
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
